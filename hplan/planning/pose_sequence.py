"""Certified motions through tool poses, straight or free, with bounded tilt.

On a straight segment the joints follow the tool from the previous configuration. If the joints have a choice (seven
joints, or several configurations at the end of a preceding free motion), the planner picks one that allows all straight
segments up to the next free motion. A free motion comes from `hplan.planning.solver`. The arm stops at each pose.
Deviation and tilt of the timed motion are bounded at all times (`hplan.certificate.tool_bounds`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import number as checked_number
from hplan.base.arguments import truth
from hplan.base.arrays import FloatArray, frozen, numbers, readonly
from hplan.base.deadline import Cancel, TimeIsUpError, check_deadline, time_limit
from hplan.certificate.tool_bounds import ToolBounds, tool_bounds
from hplan.errors import (
    BlockedError,
    CertificationError,
    ConfigurationInCollisionError,
    HplanError,
    InputError,
    MovingObstacleError,
    NotFoundError,
    TimingError,
)
from hplan.geometry.polyline import stations
from hplan.geometry.rotation import quaternion_rotation
from hplan.kinematics.inverse_kinematics import checked_pose
from hplan.kinematics.straight_line import line_to
from hplan.optimization.smooth_path import SMALLEST_FRACTION
from hplan.planning.finish import given_path, scene_along
from hplan.planning.motion import Motion, Plan, certified_trajectory
from hplan.planning.options import PlanOptions
from hplan.planning.plan import check_task, plan_result
from hplan.planning.pose_goal import configurations_at, goal_at
from hplan.planning.problem import Problem, merge_problems
from hplan.planning.result import PlanResult
from hplan.planning.solver import best_motion
from hplan.planning.stages import Progress, no_progress, stage, stage_clock
from hplan.robot.model import Robot
from hplan.robot.upright import UprightTool
from hplan.scene.model import QUATERNION_LENGTH, Scene
from hplan.scene.upright import Upright
from hplan.trajectory.spline import SplinePath

#: Maximum number of poses.
_MOST_SEQUENCE_POSES = 10_000

#: A joint with a smaller change from pose to pose counts as unmoved [rad, m].
_STILL = 1e-9


class _Leg(NamedTuple):
    """Leg to the next pose: samples, path and motion.

    `rows` are the samples to be timed, `path` is the smooth path of a straight leg.
    """

    number: int
    problem: Problem
    rows: FloatArray
    path: SplinePath | None = None
    motion: Motion | None = None
    bounds: ToolBounds | None = None


@dataclass(frozen=True, eq=False)
class _PoseTask:
    """A task of `plan_poses`.

    Attributes:
        tool: The tool axis whose tilt is reported.
        upright: The same if the tool has to stay upright; None for free orientation.
    """

    problem: Problem
    poses: tuple[FloatArray, ...]
    straight: tuple[bool, ...]
    deviation_m: float
    tool: UprightTool
    upright: UprightTool | None


def plan_poses(
    robot: Robot,
    scene: Scene,
    poses: ArrayLike,
    options: PlanOptions | None = None,
    *,
    straight: bool | Sequence[bool] = True,
    tilt_rad: float | None = None,
    deviation_m: float = 1e-3,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> PlanResult:
    """Plan a certified motion from the scene's start through tool poses.

    Args:
        robot: The arm. With fewer than six joints it reaches few poses, and follows few straight lines.
        scene: Start, obstacles, required clearance, locked joints. Its goal is ignored; a fruit that is its goal is an
            obstacle like the others.
        poses: (n, 4, 4) poses of the tool frame in `base_link` [m].
        options: How to plan.
        straight: Whether the tool moves to each pose on a straight line with evenly changing orientation, or freely;
            one value for each pose, or one for all.
        tilt_rad: Maximum angle, at any time, between the vertical and the tool direction that is vertical at the start;
            rotation about the vertical does not count. None for the scene's `upright`, or free orientation.
        deviation_m: Maximum deviation of the tool from the straight lines.
        progress: Called with the name of each stage as it starts.
        cancel: A function or an event that says whether the motion is cancelled.

    Returns:
        The motion as a plan result, with a phase `pose N` to each pose, for the scene with the motion's ends as start
        and goal. Its report has `poses`: for each phase, certified bounds on deviation and tilt at all times, tracking
        errors included.

    Raises:
        InputError: The poses are invalid, or tilted beyond the limit; the start is not collision-free, or in motion.
        UnreachableError: No configuration with the tool at a pose was found.
        BlockedError: Obstacles block a pose.
        NotFoundError: No motion was found.
        TimingError: The path cannot be timed.
        CertificationError: The motion failed certification, or exceeds the allowed deviation or tilt.
        MovingObstacleError: An obstacle in the scene moves.
        NotInTimeError: The deadline passed before a motion was found.
        PlanCancelledError: Planning was cancelled.
    """
    check_task(robot, scene, options, progress)
    options = PlanOptions() if options is None else options
    if scene.moves:
        raise MovingObstacleError(scene.first_moving)
    matrices = numbers("poses", poses, (None, 4, 4))
    if not 0 < len(matrices) <= _MOST_SEQUENCE_POSES:
        raise InputError(f"poses: expected 1 to {_MOST_SEQUENCE_POSES}, got {len(matrices)}", count=len(matrices))
    ways = [straight] * len(matrices) if isinstance(straight, bool) else list(straight)
    if len(ways) != len(matrices):
        raise InputError(f"straight: expected one for each of {len(matrices)} poses, got {len(ways)}")
    if tilt_rad is not None:
        checked_number("tilt_rad", tilt_rad, "None, or an angle in (0, pi/2)", lambda tilt: 0.0 < tilt < 0.5 * math.pi)
    checked_number("deviation_m", deviation_m, "a number of metres >= 1e-5", lambda off: 1e-5 <= off <= 1.0)
    with stage_clock(progress) as clock, time_limit(options.deadline_s, cancel) as limit:
        try:
            if tilt_rad is not None:
                scene = scene.with_values(upright=Upright(max_tilt_deg=math.degrees(tilt_rad)))
            problem = Problem.from_scene(robot, scene, options)
            begin = problem.start
            problem.world.check_base()
            problem.world.check_clear(begin, "start")
            checked = tuple(checked_pose(matrix, f"poses[{k}]") for k, matrix in enumerate(matrices))
            upright = problem.world.upright
            lines = tuple(truth("straight", way) for way in ways)
            if upright is not None:
                _check_upright(checked, upright)
            tool = upright or UprightTool.vertical_at(robot, begin, math.pi)
            task = _PoseTask(problem, checked, lines, deviation_m, tool, upright)
            return _finished_result(task, _find_legs(task, begin, 0))
        except TimeIsUpError:
            raise limit.error(clock.describe()) from None


def pose_matrices(rows: FloatArray) -> FloatArray:
    """Return (n, 4, 4) matrices of (n, 7) positions and quaternions.

    Quaternions are in the order (x, y, z, w).

    Raises:
        InputError: A quaternion is not of unit length.
    """
    lengths = np.linalg.norm(rows[:, 3:], axis=1)
    for row in np.flatnonzero(~(np.abs(lengths - 1.0) <= QUATERNION_LENGTH)).tolist():
        raise InputError(f"pose {row + 1}: expected a quaternion of length 1, got length {lengths[row]:.6g}", pose=row)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    for pose, row in zip(poses, rows, strict=True):
        pose[:3, :3], pose[:3, 3] = quaternion_rotation(row[3:].tolist()), row[:3]
    return poses


def _check_upright(poses: Sequence[FloatArray], tool: UprightTool) -> None:
    """Refuse poses that do not hold the tool upright.

    Raises:
        InputError: A pose is tilted too far.
    """
    for k, pose in enumerate(poses):
        tilt = tool.tilt_of(pose)
        if not tilt < tool.max_tilt_rad:
            most = math.degrees(tool.max_tilt_rad)
            raise InputError(
                f"poses[{k}]: tilted by {math.degrees(tilt):.4g} deg from upright; allowed: {most:.4g} deg",
                pose=k,
                tilt_rad=tilt,
            )


def _find_legs(task: _PoseTask, begin: FloatArray, number: int) -> list[_Leg]:
    """Return certified legs from a configuration through the remaining poses.

    Raises:
        HplanError: No legs were found; the error explains the failure of the first attempt.
    """
    if number == len(task.poses):
        return []
    failure: HplanError | None = None
    for leg in _lines(task, begin, number) if task.straight[number] else _find_free_legs(task, begin, number):
        try:
            found = _certify_leg(task, leg)
            return [found, *_find_legs(task, leg.rows[-1], number + 1)]
        except (NotFoundError, BlockedError, TimingError, CertificationError) as error:
            failure = failure or error
    raise failure or NotFoundError(
        [f"motions {'straight' if task.straight[number] else 'of trees'} to pose {number + 1}"], pose=number
    )


def _lines(task: _PoseTask, begin: FloatArray, number: int) -> Iterator[_Leg]:
    """Yield straight legs to a pose, the one with minimum motion first.

    The others move a redundant arm towards each configuration at the pose.
    """
    problem, pose = task.problem, task.poses[number]
    locked = problem.scene.locked_joints
    longest = 0.0
    for towards in _ways_there(task, begin, number):
        check_deadline()
        with stage("grasps"):
            rows, part = line_to(problem.robot, begin, pose, towards, locked=locked)
        longest = max(longest, part)
        if part < 1.0:
            continue
        with suppress(ConfigurationInCollisionError):
            leg = _Leg(number, problem.from_configurations(begin, rows[-1]), rows)
            if len(_drop_repeats(rows)) < 2:
                yield leg
                continue
            path, robot = _interpolate(rows), problem.robot
            is_within = (path.pieces >= robot.lower).all() and (path.pieces <= robot.upper).all()
            if is_within and path.is_clear(problem.field, _margin(leg.problem)):
                yield leg._replace(path=path)
    if longest < 1.0:
        raise NotFoundError(
            [f"the straight line to pose {number + 1}, of which a fraction of {longest:.3g} was reached"], pose=number
        )


def _ways_there(task: _PoseTask, begin: FloatArray, number: int) -> Iterator[FloatArray | None]:
    yield None
    with suppress(HplanError):
        yield from _ends(task, begin, number)


def _find_free_legs(task: _PoseTask, begin: FloatArray, number: int) -> Iterator[_Leg]:
    """Yield free legs to configurations that allow the following straight segments.

    The nearest configurations come first.
    """
    problem = task.problem
    ends = [end for end in _ends(task, begin, number) if _goes_on(task, end, number + 1)]
    if not ends:
        tried = f"configurations at pose {number + 1}; the next straight lines were found from none of them"
        raise NotFoundError([tried], pose=number)
    tasks = []
    for end in ends[: problem.effort.pose_goals]:
        with suppress(ConfigurationInCollisionError):
            tasks.append(problem.from_configurations(begin, end))
    still = [to for to in tasks if to.is_empty]
    yield from (_Leg(number, to, np.stack([begin, to.goal])) for to in still)
    tasks = [to for to in tasks if not to.is_empty]
    while tasks:
        at, motion = best_motion(merge_problems(tasks))
        yield _Leg(number, tasks[at], motion.trajectory.position[[0, -1]], motion=motion)
        del tasks[at]


def _goes_on(task: _PoseTask, begin: FloatArray, number: int) -> bool:
    """True if the following straight segments are feasible."""
    if number == len(task.poses) or not task.straight[number]:
        return True
    with suppress(NotFoundError):
        return any(_goes_on(task, leg.rows[-1], number + 1) for leg in _lines(task, begin, number))
    return False


def _ends(task: _PoseTask, begin: FloatArray, number: int) -> FloatArray:
    """Collision-free configurations at a pose, the nearest first; errors as `configurations_at`."""
    problem = task.problem
    with stage("grasps"):
        goal = goal_at(task.poses[number])
        return configurations_at(problem.world, goal, begin, problem.scene.locked_joints)


def _margin(to: Problem) -> float:
    return 0.5 * SMALLEST_FRACTION * to.margin


def _drop_repeats(rows: FloatArray) -> FloatArray:
    """The samples that differ from their predecessor."""
    moving: FloatArray = rows[np.append(True, np.abs(np.diff(rows, axis=0)).max(axis=1) > _STILL)]
    return moving


def _interpolate(rows: FloatArray) -> SplinePath:
    """Return the cubic spline that interpolates the configurations."""
    points = _drop_repeats(rows)
    if len(points) < 4:
        points = np.vstack([np.linspace(low, high, 4)[:-1] for low, high in pairwise(points)] + [points[-1:]])
    from scipy.interpolate import make_interp_spline

    spline = make_interp_spline(stations(points), points, k=3)
    return SplinePath(readonly(spline.c), readonly(spline.t))


def _finished_result(task: _PoseTask, legs: Sequence[_Leg]) -> PlanResult:
    """Assemble the plan result from certified legs."""
    robot, rows = task.problem.robot, np.vstack([leg.rows for leg in legs])
    along = scene_along(robot, task.problem.scene, given_path(robot, rows))
    # A leg without a motion starts and ends at the same configuration.
    moved = [(leg, leg.motion, leg.bounds) for leg in legs if leg.motion is not None and leg.bounds is not None]
    told = [
        {
            "phase": motion.name,
            "straight": task.straight[leg.number],
            "deviation_m": bounds.deviation_m if task.straight[leg.number] else None,
            "tilt_deg": math.degrees(bounds.tilt_rad),
        }
        for leg, motion, bounds in moved
    ]
    first, *others = (motion for _, motion, _ in moved)
    whole = Plan(
        replace(first, problem=replace(first.problem, scene=along)),
        tuple(others),
    )
    allowed = None if task.upright is None else math.degrees(task.upright.max_tilt_rad)
    found = {"allowed_deviation_m": task.deviation_m, "allowed_tilt_deg": allowed, "phases": told}
    return replace(plan_result(whole), told={"poses": found})


def _certify_leg(task: _PoseTask, leg: _Leg) -> _Leg:
    """Return the leg with its certified motion.

    If the arm is already there, the leg has no motion.

    Raises:
        TimingError: The path cannot be timed.
        CertificationError: The motion is not certified, or not within the allowed deviation.
    """
    to, name, motion = leg.problem, f"pose {leg.number + 1}", leg.motion
    if motion is None:
        if leg.path is None:
            return leg
        trajectory, certificate = certified_trajectory(to, leg.path)
        motion = Motion(name, trajectory, certificate, to, frozen(np.array(leg.rows)), leg.path, "direct")
    with stage("certificate"):
        tracking = task.problem.options.certified_tracking
        bounds = tool_bounds(to.robot, motion.trajectory, task.tool, tracking)
    if task.straight[leg.number] and bounds.deviation_m > task.deviation_m:
        raise CertificationError(
            f"to pose {leg.number + 1} the deviation of the tool is bounded by {1e3 * bounds.deviation_m:.4g} mm from "
            f"its line, which is more than allowed",
            pose=leg.number,
            **bounds._asdict(),
        )
    return leg._replace(motion=replace(motion, name=name), bounds=bounds)
