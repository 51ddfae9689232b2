"""New goals for an arm in motion: time to a certified stop and to a certified splice, and how fast the splice is.

A problem has a random scene of `studies.arms`, every other one among a cloud of `BALLS` balls as well, and a motion
through it. Several times the goal changes while the arm moves, to a free configuration near the start or near the goal
of the scene. Each change gives a row: CPU times of the stop (`Planner.aim`) and of the splice with effort `quick`, and
the duration of that splice relative to one with the effort of the run.
The motion that the arm follows is judged from outside, with its limits and the seams.
"""

from __future__ import annotations

import itertools

import numpy as np
from studies.arms import FARTHEST, NEAREST, random_scene, reach_of
from studies.harness import Row, Study, StudyConfig
from studies.measure import or_error, ratio, timed
from studies.outside import contacts
from studies.validation.random_worlds import direction

from hplan.base.arrays import FloatArray
from hplan.certificate.configuration_check import check
from hplan.errors import HplanError
from hplan.online.planner import Planner
from hplan.planning.options import EffortName, PlanOptions
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene
from hplan.scene.obstacles import PointCloud

#: The arms; the number of changes in each problem.
ARMS, CHANGES = ("harvester", "ur5", "panda"), 4

#: Number of balls of a cloud, in shells with so many balls each, and their radius [m].
BALLS, SHELL, RADIUS_M = 300_000, 15_000, 4e-3

#: Time from the change of the goal to the seam [s]; distance of the new goal from an end in each joint [rad, m].
AHEAD_S, ASIDE = 0.06, 0.4

#: Largest jump of position [rad, m] and velocity, as a fraction of its limit, at a seam.
JUMP = 1e-6


def _rows(config: StudyConfig, number: int) -> list[Row]:
    robot = load_robot(ARMS[number % len(ARMS)])
    rng = np.random.default_rng([config.seed, number])
    scene, arm = random_scene(robot, config.seed, number), robot.name
    if number // len(ARMS) % 2:
        scene, arm = _among_balls(robot, scene, rng), f"{robot.name}, {BALLS:,} balls"
    planner = Planner(robot, scene, PlanOptions(effort="quick"))
    rows, running = list[Row](), or_error(lambda: planner.plan(begins_s=0.0))
    for change in range(CHANGES):
        if isinstance(running, HplanError) or running.trajectory.duration < 4.0 * AHEAD_S:
            break
        now = running.begins_s + float(rng.uniform(0.1, 0.6)) * running.trajectory.duration
        goal = _free_goal(robot, scene, rng, (scene.start, scene.goal)[change % 2].configuration)
        row, running = _changed(planner, running, goal, now, config.effort)
        rows.append({"name": f"{scene.name} {change}", "arm": arm, **row})
    return rows


def _among_balls(robot: Robot, scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with more obstacles: shells of balls, clear of its start and goal."""
    reach_m, shells = reach_of(robot, rng), list[PointCloud]()
    while len(shells) < BALLS // SHELL:
        rays = rng.normal(size=(SHELL, 3))
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        points = direction(rng) * reach_m * rng.uniform(NEAREST, FARTHEST) + rays * rng.uniform(0.05, 0.25, 3)
        shell = PointCloud.from_thinned(f"shell {len(shells)}", points, RADIUS_M)
        alone = scene.with_values(obstacles=(shell,))
        if all(check(robot, alone, end.configuration).valid for end in (scene.start, scene.goal)):
            shells.append(shell)
    return scene.with_values(obstacles=(*scene.obstacles, *shells))


def _free_goal(robot: Robot, scene: Scene, rng: np.random.Generator, near: FloatArray) -> Goal:
    """A goal near an end of the scene, clear of everything."""
    low, high = np.maximum(robot.lower, near - ASIDE), np.minimum(robot.upper, near + ASIDE)
    drawn = (rng.uniform(low, high) for _ in itertools.count())
    return Goal(joints_rad=tuple(next(q for q in drawn if check(robot, scene, q).valid).tolist()))


def _changed(
    planner: Planner, running: PlanResult, goal: Goal, now: float, effort: EffortName
) -> tuple[Row, PlanResult | HplanError]:
    """Row of a change of the goal, and the motion that the arm follows then."""
    robot, at = planner.robot, min(now + AHEAD_S, running.begins_s + running.trajectory.duration)
    stop, stop_ms = timed(lambda: planner.aim(goal=goal, now=now, at=at))
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
