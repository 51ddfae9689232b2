"""New goals for an arm in motion: time to a certified stop and to a certified splice, and how fast the splice is.

A problem has a random scene of `studies.arms` and a motion through it. Several times the goal changes while the arm
moves, to a free configuration near the start or near the goal of the scene. Each change gives a row: CPU times of the
stop and of the splice with effort `quick`, and the duration of that splice relative to one with the effort of the run.
The motion that the arm follows is judged from outside, with its limits and the seams.
"""

from __future__ import annotations

import itertools

import numpy as np
from studies.arms import random_scene
from studies.harness import Row, Study, StudyConfig
from studies.measure import or_error, ratio, timed
from studies.outside import contacts

from hplan.base.arrays import FloatArray
from hplan.certificate.configuration_check import check
from hplan.errors import HplanError
from hplan.online.planner import Planner
from hplan.planning.options import EffortName, PlanOptions
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene

#: The arms; the number of changes in each problem.
ARMS, CHANGES = ("harvester", "ur5", "panda"), 4

#: Time from the change of the goal to the seam [s]; distance of the new goal from an end in each joint [rad, m].
AHEAD_S, ASIDE = 0.06, 0.4

#: Largest jump of position [rad, m] and velocity, as a fraction of its limit, at a seam.
JUMP = 1e-6


def _rows(config: StudyConfig, number: int) -> list[Row]:
    robot = load_robot(ARMS[number % len(ARMS)])
    rng = np.random.default_rng([config.seed, number])
    scene = random_scene(robot, config.seed, number)
    planner = Planner(robot, scene, PlanOptions(effort="quick"))
    rows, running = list[Row](), or_error(lambda: planner.plan(begins_s=0.0))
    for change in range(CHANGES):
        if isinstance(running, HplanError) or running.trajectory.duration < 4.0 * AHEAD_S:
            break
        now = running.begins_s + float(rng.uniform(0.1, 0.6)) * running.trajectory.duration
        planner.aim(goal=_free_goal(robot, scene, rng, (scene.start, scene.goal)[change % 2].configuration))
        row, running = _changed(planner, running, now, config.effort)
        rows.append({"name": f"{scene.name} {change}", "arm": robot.name, **row})
    return rows


def _free_goal(robot: Robot, scene: Scene, rng: np.random.Generator, near: FloatArray) -> Goal:
    """A goal near an end of the scene, clear of everything."""
    low, high = np.maximum(robot.lower, near - ASIDE), np.minimum(robot.upper, near + ASIDE)
    drawn = (rng.uniform(low, high) for _ in itertools.count())
    return Goal(joints_rad=tuple(next(q for q in drawn if check(robot, scene, q).valid).tolist()))


def _changed(
    planner: Planner, running: PlanResult, now: float, effort: EffortName
) -> tuple[Row, PlanResult | HplanError]:
    """Row of a change of the goal, and the motion that the arm follows then."""
    robot, at = planner.robot, min(now + AHEAD_S, running.begins_s + running.trajectory.duration)
    stop, stop_ms = timed(lambda: planner.stop_at(at, now=now))
    found, splice_ms = timed(lambda: or_error(lambda: planner.replan(at=at, now=now)))
    row: Row = {"stop": stop.certificate.verified, "stop_ms": stop_ms, "splice_ms": splice_ms}
    row["fault"] = not stop.certificate.verified
    if isinstance(found, HplanError):
        return row | {"splice": type(found).__name__}, found
    # The same change for a planner with more effort, from the same motion.
    other = Planner(robot, planner.scene, PlanOptions(effort=effort))
    other.last = running
    better = or_error(lambda: other.replan(at=at, now=now))
    q, velocity, _ = running.trajectory.state_at(found.begins_s - running.begins_s)
    off = np.abs(found.trajectory.velocity[0] - velocity) / robot.velocity_limit
    row |= {"splice": "kept" if found.is_kept else "certified", "jump": float(off.max())}
    row["contacts"] = sum(contacts(robot, planner.scene, found.trajectory))
    row["fault"] |= row["contacts"] > 0 or not found.certificate.verified or row["jump"] > JUMP
    row["fault"] |= bool(np.abs(found.trajectory.position[0] - q).max() > JUMP)
    if not isinstance(better, HplanError):
        row["to_better"] = ratio(found.trajectory.duration, better.trajectory.duration)
    return row, found


RETARGETS = Study(
    "retargets",
    "new goals for arms in motion: CPU time to a certified stop and to a certified splice",
    _rows,
    ("splice", "stop", "stop_ms", "splice_ms", "to_better", "contacts", "jump"),
    by="arm",
    count=(300, 3),
    peers=(),
    warm=3,
)
