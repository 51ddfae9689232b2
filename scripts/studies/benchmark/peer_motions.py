"""Motions in the manner of many: RRTConnect's path, simplified, a cubic spline through it, timed by toppra.

The same scene, limits of velocity, acceleration and torque; the limit of jerk, which toppra does not have, is hplan's
alone. OMPL asks hplan's compiled distances (`studies.benchmark.ompl_paths`). Nobody checks the motion, which leaves the
path between its waypoints, before it is looked at from outside.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from studies.benchmark.motions import toppra_motion
from studies.benchmark.ompl_paths import RESOLUTION, ompl_path
from studies.benchmark.outside_check import OutsideCheck

from hplan.problem.world import World
from hplan.robot.model import Robot
from hplan.scene.model import Scene


@dataclass(frozen=True)
class PeerMotion:
    """One problem.

    Attributes:
        waypoints: How many the path has; 0 where none was found.
        path_s: CPU time to the path, simplified, or until time was up [s].
        timing_s: CPU time of toppra [s].
        length_rad: Length of the path; NaN without one.
        duration_s: Duration of the motion; None without one [s].
        contacts: Configurations at which it touches an obstacle, and the robot itself.
    """

    waypoints: int
    path_s: float
    timing_s: float = 0.0
    length_rad: float = float("nan")
    duration_s: float | None = None
    contacts: tuple[int, int] = (0, 0)


def peer_motion(robot: Robot, scene: Scene, check: OutsideCheck, resolution: float = RESOLUTION) -> PeerMotion:
    """The motion of RRTConnect and toppra for a scene whose goal is a configuration.

    Args:
        robot: The arm.
        scene: Start, goal, obstacles and clearance.
        check: What looks at the motion.
        resolution: As `ompl_path` takes it.
    """
    began, goal = time.process_time(), scene.goal.configuration
    world = World.of(robot, scene.solids_with_goal, clearance=scene.clearance)
    path = ompl_path(world, scene, goal, resolution)
    path_s = time.process_time() - began
    if path is None:
        return PeerMotion(0, path_s)
    began = time.process_time()
    motion = toppra_motion(robot, path)
    timing_s = time.process_time() - began
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    if motion is None:
        return PeerMotion(len(path), path_s, timing_s, length)
    return PeerMotion(len(path), path_s, timing_s, length, motion.duration, check.contacts(motion))
