"""Fruit of the shipped scenes and of measured trees, planned with deadlines."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from studies.harness import Row, Study, StudyConfig
from studies.measure import planned, ratio
from studies.trees import measured_orchards, motions_in

from hplan.base.data_files import scenes_dir
from hplan.planning.options import PlanOptions
from hplan.scene.file import load_scene
from hplan.scene.model import Goal, Scene

#: Deadlines [ms]; a plan is late after this multiple of its deadline.
DEADLINES_MS, LATE = (20.0, 50.0, 100.0), 1.1


class FruitProblem(NamedTuple):
    """A motion to plan: its name, its group, and the scene."""

    name: str
    group: str
    scene: Scene


def _to_fruit(group: str, scene: Scene) -> list[FruitProblem]:
    goals = {f"{scene.name}: {fruit.name}": Goal(fruit=fruit.name) for fruit in scene.fruits}
    return [FruitProblem(name, group, scene.with_values(goal=goal)) for name, goal in goals.items()]


def _problems(config: StudyConfig) -> Iterable[FruitProblem]:
    """Fruit of the shipped scenes; with measured trees fruit on them, and motions among them."""
    robot, found = config.arm(), list[FruitProblem]()
    for scene in map(load_scene, sorted(scenes_dir().glob("*.yaml"))):
        if (scene.robot or "harvester") == robot.name:
            found += _to_fruit("fruit", scene)
    for orchard in () if config.trees is None else measured_orchards(robot, config.trees):
        found += _to_fruit("tree fruit", orchard.scene)
        found += [FruitProblem(one.name, "tree motions", one.scene) for one in motions_in(robot, orchard)]
    return found[:: max(1, len(found) // config.count) if config.count else 1]


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


def _row(config: StudyConfig, problem: FruitProblem) -> Row:
    """Plans without and with each deadline: success in time, return time, duration."""
    robot = config.arm()
    with _deadlines_in_cpu_time():
        _, row = planned(robot, problem.scene)
        row |= {"name": problem.name, "group": problem.group}
        for ms in config.values.get("deadlines", DEADLINES_MS):
            found, limited = planned(robot, problem.scene, PlanOptions(deadline_s=1e-3 * ms))
            row |= {
                f"{ms:g}_ms_in_time": limited["certified"] if row["solved"] else None,
                f"{ms:g}_ms_back_ms": limited["ms"],
                f"{ms:g}_ms_late": limited["ms"] > LATE * ms,
                f"{ms:g}_ms_first_ms": None if found is None else 1e3 * found.report["deadline"]["first_s"],
                f"{ms:g}_ms_to_none": ratio(limited.get("duration_s"), row.get("duration_s")),
            }
            row["fault"] = row.get("fault", False) or limited.get("fault", False)
    return row


DEADLINES = Study(
    "deadlines",
    "fruit of the shipped scenes and of measured trees (--trees), without a deadline and with some",
    _row,
    (
        *("certified", "ms"),
        *(f"{ms:g}_ms_{key}" for ms in DEADLINES_MS for key in ("in_time", "first_ms", "back_ms", "late", "to_none")),
    ),
    problems=_problems,
    by="group",
    count=(None, 6),
    warm=8,
)
