"""libfranka's rules: plans, splices and stops of the Panda as 1 kHz streams of commands.

A problem has a random scene of `studies.arms` and its motion. During the motion the goal changes (a splice), or the arm
stops; the stream is what a controller sends: the running motion until the new one takes over, then that one. The
robot's limits are the documented ones times `SCALE`, because a limit must not be reached exactly; jerks times
`JERK_SCALE`, because the cubics between the samples of a stop exceed the planned jerk by up to 2 %.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import numpy as np
from studies.arms import random_scene
from studies.harness import Row, Study, StudyConfig

import hplan
from hplan.apps.execution.franka_rules import PANDA, PERIOD_S, StreamCheck, check_stream
from hplan.base.arrays import FloatArray
from hplan.errors import HplanError
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal
from hplan.trajectory.trajectory import Trajectory

#: Fractions of the documented limits to plan with; time from a change to the splice, and to the stop [s].
SCALE, JERK_SCALE, AHEAD_S, STOP_S = 0.99, 0.95, 0.15, 0.05

#: Number of problems: each gives a motion, most a splice, and every second one a stop.
COUNT = 1200


@functools.cache
def panda() -> Robot:
    """The Panda with limits a little below the documented ones."""
    names = [f"panda_joint{number}" for number in range(1, 8)]
    rows = ["format: hplan-limits/1"]
    limits = {
        "velocity_rad_s": SCALE * PANDA.velocity,
        "acceleration_rad_s2": SCALE * PANDA.acceleration,
        "jerk_rad_s3": JERK_SCALE * PANDA.jerk,
    }
    for key, values in limits.items():
        rows += [f"{key}:", *(f"  {name}: {value}" for name, value in zip(names, values.tolist(), strict=True))]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "panda.limits.yaml")
        file.write_text("\n".join(rows) + "\n", encoding="utf-8")
        return load_robot("panda", limits=file)


def stream(*parts: tuple[Trajectory, float]) -> FloatArray:
    """(n, dof) commands of motions that begin at times of one clock [s]; each runs from its begin on."""
    begins = [begin for _, begin in parts]
    end = parts[-1][1] + parts[-1][0].duration
    clock = np.append(np.arange(begins[0], end, PERIOD_S), end)
    which = np.searchsorted(begins, clock, side="right") - 1
    found = np.empty((len(clock), len(parts[0][0].joint_names)))
    for number, (trajectory, begin) in enumerate(parts):
        mine = which == number
        found[mine] = trajectory.positions(np.clip(clock[mine] - begin, 0.0, trajectory.duration))
    return found


def _checked(name: str, kind: str, check: StreamCheck) -> Row:
    return {
        "name": f"{name} {kind}",
        "kind": kind,
        "accepted": check.is_accepted,
        "velocity": check.velocity,
        "acceleration": check.acceleration,
        "jerk": check.jerk,
        "violations": ", ".join(words.split()[0] for words in check.violations) or None,
        "fault": not check.is_accepted,
    }


def _rows(config: StudyConfig, number: int) -> list[Row]:
    robot, rng = panda(), np.random.default_rng([config.seed, number])
    scene = random_scene(robot, config.seed, number)
    planner = hplan.Planner(robot, scene, hplan.PlanOptions(effort=config.effort))
    try:
        motion = planner.plan(begins_s=0.0)
    except HplanError:
        return []
    rows = [_checked(scene.name, "motion", check_stream(stream((motion.trajectory, 0.0))))]
    duration = motion.trajectory.duration
    now = float(rng.uniform(0.1, 0.6)) * duration
    if number % 2 == 0 and now + STOP_S < duration:
        stop = planner.stop_at(now + STOP_S, now=now)
        rows.append(_checked(scene.name, "stop", check_stream(stream((stop.trajectory, 0.0)))))
    if now + AHEAD_S < duration:
        goal = scene.goal.configuration + rng.uniform(-0.3, 0.3, robot.dof)
        goal = np.clip(goal, robot.lower + 1e-3, robot.upper - 1e-3)
        planner.aim(goal=Goal(joints_rad=tuple(goal.tolist())))
        try:
            spliced = planner.replan(at=now + AHEAD_S, now=now)
        except HplanError:
            return rows
        if not spliced.is_kept:
            parts = (motion.trajectory, 0.0), (spliced.trajectory, spliced.begins_s)
            rows.append(_checked(scene.name, "splice", check_stream(stream(*parts))))
    return rows


FRANKA = Study(
    "franka",
    "plans, splices and stops of the Panda as 1 kHz streams, by libfranka's rules",
    _rows,
    ("accepted", "velocity", "acceleration", "jerk", "violations"),
    by="kind",
    count=(COUNT, 3),
    peers=(),
)
