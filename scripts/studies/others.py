"""Motions of other planners: verdicts of `hplan ros judge` beside an outside judge.

In the random scenes of `studies.arms`, OMPL's planners and roboplan plan motions between random configurations. OMPL
checks configurations at MoveIt's default resolution; its path is simplified, filled in to `FILL_RAD` and timed by
toppra. roboplan shortens and times its path itself. What a controller would receive is a `JointTrajectory` with
positions and velocities at 100 Hz; it runs the cubics between them. Both judges look at these cubics: hplan at all
times, with its shapes of the arm, and Pinocchio and coal every half millisecond, with the meshes of the URDF.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np
from studies.arms import KINDS, free_ends, random_scene, reach_of, scene_between
from studies.harness import Row, Study, StudyConfig
from studies.outside import TimedMotion, _found, arm_of, obstacles_of
from studies.peers import ompl_path, seed_ompl, toppra_motion, world_of
from studies.validation.judge import TICK_S, SampledMotion

from hplan.apps.ros.joint_messages import from_joint_trajectory
from hplan.apps.ros.judge import Judge, JudgeOptions, Verdict
from hplan.base.arrays import FloatArray
from hplan.planning.world import World
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Scene
from hplan.trajectory.trajectory import Trajectory

ROBOTS, PLANNERS = ("panda", "ur5"), ("RRTConnect", "BITstar", "roboplan")

#: MoveIt's default distance between checked configurations, as a fraction of the space's extent.
MOVEIT_RESOLUTION = 0.005

#: Motions of each planner in a scene.
MOTIONS = 5

#: CPU time to find a path [s]: BIT* uses all of it. Spacing of waypoints for toppra [rad]. Samples of a message [1/s].
FIND_S, FILL_RAD, RATE_HZ = {"RRTConnect": 0.5, "BITstar": 0.15}, 0.1, 100.0

#: Distance that a refused motion must have to count as free [m], and the time around the refusal that is measured [s].
SPARE_M, AROUND_S = 1e-3, 0.02


#: Time limit of a verdict [s]: far more than it takes on a busy machine, so that the rows do not depend on it.
DECIDED_S = 60.0


#: Robot, number of the scene, planner, and number of the motion.
_Problem: TypeAlias = tuple[str, int, str, int]


def _problems(config: StudyConfig) -> Iterable[_Problem]:
    """The problems of the chosen planners and arms; roboplan takes no clouds."""
    found = itertools.product(config.numbers, config.chosen(ROBOTS), config.chosen(PLANNERS), range(MOTIONS))
    return [
        (robot, number, planner, motion)
        for number, robot, planner, motion in found
        if planner != "roboplan" or not KINDS[number % len(KINDS)][3]
    ]


@functools.cache
def _robot(name: str) -> Robot:
    return load_robot(name)


@functools.lru_cache(maxsize=1)
def _scenes(name: str, seed: int, number: int) -> list[Scene]:
    """A random scene with the ends of each motion; fewer if too few configurations are free."""
    robot = _robot(name)
    scene = random_scene(robot, seed, number)
    found, rng = [scene], np.random.default_rng([seed, number, MOTIONS])
    extent = reach_of(robot, rng)
    for motion in range(1, MOTIONS):
        ends = free_ends(robot, rng, scene.obstacles, extent)
        if ends is not None:
            found.append(scene_between(f"{scene.name}, {motion}", *ends, scene.obstacles))
    return found


@functools.lru_cache(maxsize=1)
def _world(name: str, seed: int, number: int) -> World:
    return world_of(_robot(name), _scenes(name, seed, number)[0])


@functools.lru_cache(maxsize=1)
def _roboplan(name: str, seed: int, number: int) -> Any:
    from studies.roboplan_peer import RoboplanArm

    return RoboplanArm(_robot(name), _scenes(name, seed, number)[0], seed + number + 1)


def _motion(config: StudyConfig, scene: Scene, problem: _Problem) -> TimedMotion | None:
    """The motion of a planner; None if it finds none."""
    name, number, planner, _ = problem
    robot, goal = _robot(name), scene.goal.configuration
    if planner == "roboplan":
        motion: TimedMotion | None = _roboplan(name, config.seed, number).motion(scene.start.configuration, goal)
        return motion
    seed_ompl(1)
    world = _world(name, config.seed, number)
    path = ompl_path(world, scene, goal, planner=planner, seconds=FIND_S[planner], resolution=MOVEIT_RESOLUTION)
    return None if path is None else toppra_motion(robot, _filled(path))


def _filled(path: FloatArray) -> FloatArray:
    """The path with waypoints at most `FILL_RAD` apart: toppra's spline then stays near the straight lines."""
    parts = [
        np.linspace(a, b, max(1, math.ceil(np.linalg.norm(b - a) / FILL_RAD)), endpoint=False)
        for a, b in itertools.pairwise(path)
    ]
    return np.concatenate([*parts, path[-1:]])


def _message(robot: Robot, motion: TimedMotion) -> dict[str, object]:
    """The motion as a controller receives it."""
    count = max(2, math.ceil(motion.duration * RATE_HZ) + 1)
    clock = np.linspace(0.0, motion.duration, count)
    q = motion.positions(clock)
    velocity = np.gradient(q, clock, axis=0, edge_order=2 if count > 2 else 1)
    velocity[[0, -1]] = 0.0
    stamps = np.round(1e9 * clock).astype(np.int64).tolist()
    points = [
        {"positions": p, "velocities": v, "time_from_start": {"sec": at // 10**9, "nanosec": at % 10**9}}
        for p, v, at in zip(q.tolist(), velocity.tolist(), stamps, strict=True)
    ]
    return {"joint_names": list(robot.joint_names), "points": points}


def _sampled(robot: Robot, motion: Trajectory, clock: FloatArray) -> SampledMotion:
    return SampledMotion(robot.joint_names, clock, motion.positions(clock))


def _is_near(robot: Robot, scene: Scene, motion: Trajectory, verdict: Verdict) -> bool:
    """True if the arm is within `SPARE_M` of anything around the time of a refusal, by the URDF's meshes."""
    at_s = verdict.time_s or 0.0
    clock = np.clip(np.arange(at_s - AROUND_S, at_s + AROUND_S, 2.0 * TICK_S), 0.0, motion.duration)
    arm, obstacles = arm_of(robot), obstacles_of(scene)
    sampled = _sampled(robot, motion, clock)
    for q in arm.configurations(sampled.names, sampled.values):
        places = arm.places(q)
        if any(arm.own_distance(pair, places, SPARE_M) <= SPARE_M for pair in arm.own_pairs):
            return True
        for obstacle in obstacles:
            at = obstacle.poses(None, np.zeros(1))[0]
            if any(arm.obstacle_distance(k, places[k], obstacle, at, SPARE_M) <= SPARE_M for k in range(len(places))):
                return True
    return False


def _row(config: StudyConfig, problem: _Problem) -> Row | None:
    """Both judges on one motion of a planner; None if the scene has too few free configurations."""
    name, number, planner, chosen = problem
    robot, scenes = _robot(name), _scenes(name, config.seed, number)
    if chosen >= len(scenes):
        return None
    scene = scenes[chosen]
    motion = _motion(config, scene, problem)
    row: Row = {"name": f"{name} {scene.name} {planner}", "planner": f"{planner}, {name}", "solved": motion is not None}
    if motion is None:
        return row
    message = _message(robot, motion)
    verdict = Judge(robot, scene, JudgeOptions(limits=(), moving_ends=True, deadline_s=DECIDED_S)).judge(message)
    controlled = from_joint_trajectory(message, robot=robot)
    ticks = np.append(np.arange(0.0, controlled.duration, TICK_S), controlled.duration)
    found = _found(robot, scene, _sampled(robot, controlled, ticks))
    free = not verdict.verified and not found and not _is_near(robot, scene, controlled, verdict)
    return row | {
        "verified": verdict.verified,
        "collides": bool(found),
        "depth_mm": 1e3 * max(contact.depth_m for contact in found) if found else None,
        "false_verified": verdict.verified and bool(found),
        "refused": not verdict.verified and not found,
        "refused_free": free,
        "judged_ms": verdict.judged_ms,
        "duration_s": controlled.duration,
        "fault": verdict.verified and bool(found),
    }


OTHERS = Study(
    "others",
    "motions of OMPL and roboplan in random scenes: verdicts beside coal every half millisecond",
    _row,
    (
        *("solved", "verified", "collides", "depth_mm", "false_verified", "refused", "refused_free", "judged_ms"),
        "duration_s",
    ),
    problems=_problems,
    by="planner",
    count=(200, 1),
    peers=(),
    choices=(ROBOTS, PLANNERS),
)
