"""Other planners: OMPL with hplan's distances, roboplan, toppra on a spline, straight segments with stops at corners.

They do not limit the jerk, as hplan does if the robot has jerk limits.
"""

from __future__ import annotations

import importlib
import logging
import time
from functools import cache
from typing import Any

import numpy as np
from studies.harness import Row, StudyConfig
from studies.measure import or_error, ratio, timed
from studies.outside import TimedMotion, contacts, findings

from hplan.adapters.ompl import MARGIN_M, Validity
from hplan.base.arrays import FloatArray
from hplan.base.lazy_import import extra
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import HplanError
from hplan.geometry.polyline import stations
from hplan.optimization.shortcut import shorten
from hplan.planning.finish import finish
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene.model import Scene

#: CPU time limits for finding and for simplifying a path [s].
PATIENCE_S, SIMPLIFY_S = 10.0, 1.0

#: Use of a limit that counts as a violation: cubics between a peer's samples of 5 ms add up to a tenth.
_OVER = 1.2

#: OMPL's default step along motions, as a fraction of the space's extent.
RESOLUTION = 0.01

#: Numbers of shortcuts after which a polyline is tried with stops at its corners.
_SHORTCUTS = (0, 5, 10, 20, 40, 80, 200)

#: Number of grid points of toppra's path speed: on the whole path, and on each of its segments.
_GRID_POINTS, _GRID_POINTS_EACH = 300, 10


@cache
def ompl() -> tuple[Any, Any, Any]:
    """OMPL's modules `base`, `geometric` and `util`.

    Raises:
        InputError: OMPL is not installed.
    """
    with extra("bench", "a peer needs OMPL"):
        base, geometric, util = (importlib.import_module(f"ompl.{name}") for name in ("base", "geometric", "util"))
    util.setLogLevel(util.LOG_ERROR)
    return base, geometric, util


@cache
def seed_ompl(seed: int) -> None:
    """Seed OMPL's random numbers, once a process."""
    ompl()[2].RNG.setSeed(max(1, seed))


def ompl_path(
    world: World,
    scene: Scene,
    goal: FloatArray,
    *,
    planner: str = "RRTConnect",
    seconds: float = PATIENCE_S,
    resolution: float | None = None,
) -> FloatArray | None:
    """(m, dof) the simplified path of a planner; None if not found in time.

    Args:
        world: Arm and obstacles.
        scene: Start and locked joints.
        goal: (dof,) configuration.
        planner: RRTConnect stops at its first path, BITstar at the time limit.
        seconds: CPU time to find the path.
        resolution: Distance between checked configurations, as a fraction of the space's extent, as in OMPL; a path may
            then be in contact between them. None to verify each motion with hplan's kernel.
    """
    base, geometric, _ = ompl()
    robot, begin = world.robot, scene.start.configuration
    joints = np.flatnonzero(~robot.locked_mask(scene.locked_joints)).tolist()
    space, bounds = base.RealVectorStateSpace(len(joints)), base.RealVectorBounds(len(joints))
    for axis, joint in enumerate(joints):
        bounds.setLow(axis, float(robot.lower[joint]))
        bounds.setHigh(axis, float(robot.upper[joint]))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    validity = Validity(world, begin, robot.locked_mask(scene.locked_joints))
    setup.setStateValidityChecker(validity.is_valid)
    information = setup.getSpaceInformation()
    validator = validity.motion_validator(information)
    if resolution is None:
        information.setMotionValidator(validator)
    else:
        information.setStateValidityCheckingResolution(resolution)
    ends = [space.allocState(), space.allocState()]
    for state, end in zip(ends, (begin, goal), strict=True):
        for axis, joint in enumerate(joints):
            state[axis] = float(end[joint])
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(getattr(geometric, planner)(information))
    world.field.is_clear(np.stack([begin, begin]), MARGIN_M)  # compile before OMPL's time starts
    world.field.spare_clearance(begin)
    # If an end is in collision OMPL sleeps without CPU time: a wall-clock limit wakes it.
    until_s, patience_s = time.thread_time() + seconds, time.monotonic() + 1.5 * seconds
    setup.solve(
        base.PlannerTerminationCondition(lambda: time.thread_time() >= until_s or time.monotonic() >= patience_s)
    )
    if not setup.haveExactSolutionPath():
        return None
    setup.simplifySolution(SIMPLIFY_S)
    states = setup.getSolutionPath().getStates()
    path = np.repeat(begin[None], len(states), axis=0)
    path[:] = [validity.configuration(state) for state in states]
    path[0], path[-1] = begin, goal
    return path


def world_of(robot: Robot, scene: Scene) -> World:
    """The arm among all obstacles and fruit of a scene."""
    return World.build(robot, scene.solids_with_goal, clearance=scene.clearance)


def peer_row(
    config: StudyConfig, robot: Robot, scene: Scene, duration_s: float | None, seconds: float = PATIENCE_S
) -> Row:
    """Results of a peer for a scene.

    `to_spline` is the ratio of the duration of hplan's motion to toppra's on a cubic spline through the peer's path,
    with or without contact, `to_peer` to hplan's motion along the peer's path.
    """
    if config.peer is None:
        return {}
    world, planner = world_of(robot, scene), config.peer
    seed_ompl(config.seed + 1)
    path, ms = timed(lambda: ompl_path(world, scene, scene.goal.configuration, planner=planner, seconds=seconds))
    if path is None:
        return {"peer_solved": False, "peer_ms": ms}
    spline = toppra_motion(robot, path)
    finished = or_error(lambda: finish(robot, scene, path))
    return {
        "peer_solved": True,
        "peer_ms": ms,
        "to_peer": None if isinstance(finished, HplanError) else ratio(duration_s, finished.trajectory.duration),
        "to_spline": None if spline is None else ratio(duration_s, spline.duration),
        "spline_touches": None if spline is None else any(contacts(robot, scene, spline)),
    }


def roboplan_row(config: StudyConfig, robot: Robot, scene: Scene, duration_s: float | None) -> Row:
    """Results of roboplan for a scene; the CPU time includes path, shortcuts and timing, not loading the arm."""
    from studies.roboplan_peer import RoboplanArm

    arm = RoboplanArm(robot, scene, config.seed + 1)
    motion, ms = timed(lambda: arm.motion(scene.start.configuration, scene.goal.configuration))
    row = {"peer_solved": motion is not None, "peer_ms": ms}
    if motion is None:
        return row
    seen = findings(robot, scene, motion)
    return row | {
        "to_peer": ratio(duration_s, motion.duration),
        "peer_touches": seen["contacts"] > 0,
        "peer_over_limits": max(seen["velocity"], seen["acceleration"]) > _OVER,
    }


def toppra_motion(robot: Robot, path: FloatArray, *, defaults: bool = False) -> TimedMotion | None:
    """A cubic spline through waypoints, timed by toppra under velocity, acceleration and torque limits, or None.

    Args:
        path: (m, dof) waypoints.
        defaults: toppra's defaults: parameters 0 to 1 in equal parts, `ParametrizeSpline`, torque by collocation. Else
            as its documentation advises: parameters by length, waypoints among the grid points,
            `ParametrizeConstAccel`, all by interpolation.
    """
    import pinocchio as pin
    import toppra
    from toppra import algorithm, constraint

    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    length = np.linalg.norm(np.diff(path, axis=0), axis=1)
    path = path[np.concatenate([[True], length > 1e-9])]
    station = stations(path)
    spline = toppra.SplineInterpolator(np.linspace(0.0, 1.0, len(path)) if defaults else station, path)
    data = robot.model.createData()

    def inverse_dynamics(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        return np.array(pin.rnea(robot.model, data, q, v, a))

    limits = [np.stack([-limit, limit], axis=1) for limit in
              (robot.velocity_limit, robot.acceleration_limit, robot.torque_limit)]  # fmt: skip
    scheme: Any = {} if defaults else {"discretization_scheme": constraint.DiscretizationType.Interpolation}
    constraints = [
        constraint.JointVelocityConstraint(limits[0]),
        constraint.JointAccelerationConstraint(limits[1], **scheme),
        constraint.JointTorqueConstraint(inverse_dynamics, limits[2], np.zeros(robot.dof), **scheme),
    ]
    options: Any = {}
    if not defaults:
        share = np.arange(_GRID_POINTS_EACH) / _GRID_POINTS_EACH
        each = (station[:-1, None] + np.diff(station)[:, None] * share).ravel()
        grid = np.union1d(np.linspace(0.0, station[-1], _GRID_POINTS), each)
        grid = grid[np.diff(grid, prepend=-np.inf) > 1e-6 * station[-1]]
        grid[-1] = station[-1]
        options = {"parametrizer": "ParametrizeConstAccel", "gridpoints": grid}
    trajectory = algorithm.TOPPRA(constraints, spline, **options).compute_trajectory()
    if trajectory is None:
        return None
    end = float(trajectory.duration)
    return TimedMotion(end, lambda t: np.asarray(trajectory(np.clip(t, 0.0, end))))


def quickest_polyline(robot: Robot, path: FloatArray, field: ClearanceField) -> FloatArray:
    """The shortened path that is fastest with stops at its corners, after different numbers of shortcuts.

    Many shortcuts give the shortest path, but many corners; without any it goes from each waypoint to the farthest
    visible one.
    """
    polylines = [shorten(path, field, margin=MARGIN_M, rounds=rounds) for rounds in _SHORTCUTS]
    return min(polylines, key=lambda polyline: stopping_duration(robot, polyline))


def stopping_duration(robot: Robot, path: FloatArray) -> float:
    """Duration of straight motions from waypoint to waypoint, at rest at each [s].

    Each is the time-optimal trapezoid under velocity and acceleration limits; torque is ignored.
    """
    total = 0.0
    for turn in np.abs(np.diff(path, axis=0)):
        moves = turn > 1e-12
        if moves.any():
            speed = float((robot.velocity_limit[moves] / turn[moves]).min())
            acceleration = float((robot.acceleration_limit[moves] / turn[moves]).min())
            total += 2.0 / np.sqrt(acceleration) if speed**2 >= acceleration else 1.0 / speed + speed / acceleration
    return total
