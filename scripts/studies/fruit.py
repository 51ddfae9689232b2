"""Fruit of the shipped scenes and of measured trees: plans with deadlines, and motions that are tracked badly."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from studies.harness import Asked, Row, Study
from studies.measure import planned, ratio
from studies.trees import measured_orchards, motions_in

from hplan.apps.execution.plant import Plant
from hplan.apps.execution.simulation import execute
from hplan.base.data_files import scenes_dir
from hplan.online.warm_up import warm_up
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.file import load_scene
from hplan.scene.model import Goal, Scene, Start

#: Deadlines [ms], and by which share of one an answer is late.
DEADLINES_MS, LATE = (20.0, 50.0, 100.0), 1.1

#: Short deadlines [ms], by how much a call may be late [ms], how far starts are shifted [rad].
RETURN_MS, LATE_MS, SHIFTED = (1.0, 5.0, 20.0), 5.0, 0.05

#: Tracking error at rest [deg] and what comes to it with the velocity [ms]; masses of the simulated arms as multiples
#: of those that the controller knows, by how much it is late [ms], natural frequencies of its loop [rad/s].
TRACKING, MASSES, COMMAND_DELAY_MS, BANDWIDTHS = (0.02, 3.0), (0.8, 1.2), 1.0, (200.0, 40.0)


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
    """A plan without a deadline, and one with each: whether it is there in time, when it comes back, how long it is."""
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


def _return_problems(asked: Asked) -> Iterable[tuple[float, int, FruitProblem, Robot]]:
    """So many calls with each deadline, of one robot: what is known of it is there."""
    found, robot = _shipped(asked), asked.arm()
    deadlines = asked.values.get("deadlines", RETURN_MS)
    return [(ms, number, found[number % len(found)], robot) for ms in deadlines for number in asked.numbers]


_load_once = functools.cache(warm_up)


def _return_row(asked: Asked, problem: tuple[float, int, FruitProblem, Robot]) -> Row:
    """A call with a deadline, and by how much it is late."""
    ms, number, (name, _, scene), robot = problem
    _load_once(robot)  # what a short deadline never gets to is not loaded by the calls before
    rng = np.random.default_rng([asked.seed, number])
    start = robot.joints_of(scene.start, "start") + rng.uniform(-SHIFTED, SHIFTED, robot.dof)
    start = np.clip(start, robot.lower, robot.upper)
    scene = scene.with_(start=Start(joints_rad=tuple(start.tolist())))
    with _deadlines_in_cpu_time():
        found, row = planned(robot, scene, PlanOptions(deadline_s=1e-3 * ms))
    late_ms = row["ms"] - ms
    told = {"certified": found is not None, "late_ms": late_ms, f"late_by_{LATE_MS:g}_ms": late_ms > LATE_MS}
    return {"name": f"{ms:g} ms, {number}: {name}", "group": f"{ms:g} ms", "origin": row["origin"], **told}


RETURNS = Study(
    "returns",
    "calls with deadlines of 1, 5 and 20 ms: how late they return",
    _return_row,
    ("certified", "late_ms", f"late_by_{LATE_MS:g}_ms"),
    problems=_return_problems,
    by="group",
    count=(2000, 6),
    warm=30,
)


def _tracking_problems(asked: Asked) -> Iterable[FruitProblem]:
    return _shipped(asked)[: asked.count]


def _tracking_row(asked: Asked, problem: FruitProblem) -> Row | None:
    """A fruit that can be picked without a tracking error: with one, and by arms in MuJoCo of other masses."""
    robot: Robot = asked.arm()
    error_deg, delay_ms = asked.values.get("tracking", TRACKING)
    tracking, options = TrackingModel(math.radians(error_deg), 1e-3 * delay_ms), PlanOptions(effort=asked.effort)
    before, _ = planned(robot, problem.scene, options)
    if before is None:
        return None
    allowing = replace(options, tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s)
    found, row = planned(robot, problem.scene, allowing)
    row |= {"name": problem.name}
    if found is None:
        return row
    row["longer"] = found.trajectory.duration / before.trajectory.duration
    for bandwidth in BANDWIDTHS:
        plants = [Plant(mass, 1e-3 * COMMAND_DELAY_MS, bandwidth, decoupled=True) for mass in MASSES]
        runs = [execute(robot, problem.scene, found.trajectory, plant) for plant in plants]
        within = [run.is_within(tracking) for run in runs]
        touching = [bool(run.contacts) for run in runs]
        row[f"within_at_{bandwidth:g}"], row[f"touching_at_{bandwidth:g}"] = all(within), any(touching)
        row["fault"] |= any(kept and touched for kept, touched in zip(within, touching, strict=True))
    return row


TRACKED = Study(
    "tracking",
    "fruit with a tracking error, executed in MuJoCo late and with other masses; at 200 and 40 rad/s",
    _tracking_row,
    ("certified", "longer", *(f"{what}_at_{one:g}" for one in BANDWIDTHS for what in ("within", "touching"))),
    problems=_tracking_problems,
    count=(None, 3),
)
