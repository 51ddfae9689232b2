"""Fruit of the shipped scenes and of measured trees, planned with deadlines."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from studies.harness import Asked, Row, Study
from studies.measure import planned, ratio
from studies.trees import measured_orchards, motions_in

from hplan.base.data_files import scenes_dir
from hplan.planning.options import PlanOptions
from hplan.scene.file import load_scene
from hplan.scene.model import Goal, Scene

#: Deadlines [ms], and the multiple of a deadline beyond it counts as late.
DEADLINES_MS, LATE = (20.0, 50.0, 100.0), 1.1


class FruitProblem(NamedTuple):
    """A motion to plan: its name, its group, and the scene."""

    name: str
    group: str
    scene: Scene


def _to_fruit(group: str, name: str, scene: Scene) -> list[FruitProblem]:
    goals = [(f"{name}: {fruit.name}", Goal(fruit=fruit.name)) for fruit in scene.fruits]
    return [FruitProblem(title, group, scene.with_(goal=goal)) for title, goal in goals]


def _shipped(asked: Asked) -> list[FruitProblem]:
    robot = asked.arm()
    scenes = [load_scene(path) for path in sorted(scenes_dir().glob("*.yaml"))]
    ours = [scene for scene in scenes if (scene.robot or "harvester") == robot.name]
    return [problem for scene in ours for problem in _to_fruit("fruit", scene.name, scene)]


def _deadline_problems(asked: Asked) -> Iterable[FruitProblem]:
    """Fruit of the shipped scenes; with measured trees fruit on them, and motions among them."""
    robot, found = asked.arm(), _shipped(asked)
    for orchard in () if asked.trees is None else measured_orchards(robot, asked.trees):
        found += _to_fruit("tree fruit", orchard.name, orchard.scene)
        found += [FruitProblem(one.name, "tree motions", one.scene) for one in motions_in(robot, orchard)]
    every = max(1, len(found) // asked.count) if asked.count else 1
    return found[::every]


@contextmanager
def _deadlines_in_cpu_time() -> Iterator[None]:
    """Count deadlines on the CPU time of the thread: the machine has other work too."""
    from hplan.base import deadline

    before = deadline.CLOCK
    deadline.CLOCK = time.CLOCK_THREAD_CPUTIME_ID
    try:
        yield
    finally:
        deadline.CLOCK = before


def _deadline_row(asked: Asked, problem: FruitProblem) -> Row:
    """Plans without and with each deadline: success in time, return time, duration."""
    robot = asked.arm()
    with _deadlines_in_cpu_time():
        _, row = planned(robot, problem.scene)
        row |= {"name": problem.name, "group": problem.group}
        for ms in asked.values.get("deadlines", DEADLINES_MS):
            found, told = planned(robot, problem.scene, PlanOptions(deadline_s=1e-3 * ms))
            row |= {
                f"{ms:g}_ms_in_time": told["certified"] if row["solved"] else None,
                f"{ms:g}_ms_back_ms": told["ms"],
                f"{ms:g}_ms_late": told["ms"] > LATE * ms,
                f"{ms:g}_ms_first_ms": None if found is None else 1e3 * found.report["deadline"]["first_s"],
                f"{ms:g}_ms_to_none": ratio(told.get("duration_s"), row.get("duration_s")),
            }
            row["fault"] = row.get("fault", False) or told.get("fault", False)
    return row


DEADLINES = Study(
    "deadlines",
    "fruit of the shipped scenes and of measured trees (--trees), without a deadline and with some",
    _deadline_row,
    (
        *("certified", "ms"),
        *(f"{ms:g}_ms_{what}" for ms in DEADLINES_MS for what in ("in_time", "first_ms", "back_ms", "late", "to_none")),
    ),
    problems=_deadline_problems,
    by="group",
    count=(None, 6),
    warm=8,
)
