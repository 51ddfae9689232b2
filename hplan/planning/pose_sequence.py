"""Certified motions through tool poses, straight or free, with bounded tilt.

On a straight segment the joints follow the tool from the previous configuration. If the joints have a choice (seven
joints, or several configurations at the end of a preceding free motion), the planner picks one that allows all straight
segments up to the next free motion. A free motion comes from `hplan.planning.solver`; if the tool has to stay upright,
it comes from trees with upright nodes (`hplan.kinematics.damped_steps.UPRIGHT`). The arm stops at each pose. Deviation
and tilt of the timed motion are bounded at all times (`hplan.certificate.tool_bounds`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin
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
from hplan.geometry.polyline import path_length, stations
from hplan.geometry.rotation import quaternion_rotation
from hplan.kinematics.damped_steps import UPRIGHT, Chain, follow
from hplan.kinematics.inverse_kinematics import chain_of, checked_pose, with_direction
from hplan.kinematics.straight_line import line_to
from hplan.optimization.smooth_path import SMALLEST_FRACTION
from hplan.planning.finish import given_path, scene_along
from hplan.planning.motion import Motion, Plan, best_of, certified_trajectory, improve
from hplan.planning.options import PlanOptions
from hplan.planning.path_finder import Origin
from hplan.planning.plan import check_task, plan_result
from hplan.planning.pose_goal import configurations_at
from hplan.planning.problem import Problem, merge_problems
from hplan.planning.result import PlanResult
from hplan.planning.rrt_connect import tree_path
from hplan.planning.solver import best_motion
from hplan.planning.stages import Progress, no_progress, stage, stage_clock
from hplan.robot.model import Robot
from hplan.scene.model import QUATERNION_LENGTH, Goal, Scene
from hplan.trajectory.spline import SplinePath

#: Maximum number of poses.
_MOST_SEQUENCE_POSES = 10_000

#: Tree nodes and the paths between them use at most this fraction of the allowed tilt; the rest covers the timed curve.
_OF_TILT = 0.7

#: Upright motions longer than this multiple of the duration bound are optimized; during that, the samples tilt by at
#: most this fraction of the allowed tilt.
_FAST, _OPTIMIZED = 1.02, 0.98

#: Approximate spacing of the samples of an upright motion [rad]; smoother paths with fewer samples are tried first.
_ROW, _COARSER = 0.05, (12, 6, 3, 1)

#: Number of shortcuts tried in a tree path, and evaluation budgets of the successive tree searches.
_SHORTCUTS, _TREES = 100, (2_000, 2_000, 8_000, 8_000)

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
        upright: Unit vector pointing up, in `base_link`.
        direction: The same vector at the start, in the tool frame.
        tilt_rad: Maximum tilt; None for free orientation [rad].
        chain: The upright constraint for kernels, with the maximum tilt of tree nodes; None for free orientation.
    """

    problem: Problem
    poses: tuple[FloatArray, ...]
    straight: tuple[bool, ...]
    deviation_m: float
    upright: FloatArray
    direction: FloatArray
    tilt_rad: float | None
    chain: Chain | None


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
            rotation about the vertical does not count. None for free orientation.
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
            problem = Problem.from_scene(robot, scene, options)
            begin = problem.start
            problem.world.check_base()
            problem.world.check_clear(begin, "start")
            checked = tuple(checked_pose(matrix, f"poses[{k}]") for k, matrix in enumerate(matrices))
            gravity = np.array(robot.model.gravity.linear)
            up = -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])
            direction = robot.forward_kinematics(begin)[:3, :3].T @ up
            chain = None
            if tilt_rad is not None:
                _check_upright(checked, up, direction, _OF_TILT * tilt_rad)
                chain = _upright_chain(robot, scene, up, direction, _OF_TILT * tilt_rad)
            lines = tuple(truth("straight", way) for way in ways)
            task = _PoseTask(problem, checked, lines, deviation_m, up, direction, tilt_rad, chain)
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


def _upright_chain(robot: Robot, scene: Scene, up: FloatArray, direction: FloatArray, lean: float) -> Chain:
    """Return the chain of the tool frame with z along `direction`."""
    z = np.array([0.0, 0.0, 1.0])
    pose = np.eye(4)
    pose[:3, :3] = pin.Quaternion.FromTwoVectors(z, up).toRotationMatrix()
    chain = with_direction(chain_of(robot, pose, UPRIGHT), direction)
    moves = np.where(robot.locked_mask(scene.locked_joints), 0.0, chain.moves)
    return chain._replace(moves=moves, free_turn=np.array([UPRIGHT, lean]))


def _restrict(chain: Chain, to: Problem) -> Chain:
    """Return a chain within the joint ranges of a motion."""
    return chain._replace(lower=np.array(to.lower[0]), upper=np.array(to.upper[0]))


def _check_upright(poses: Sequence[FloatArray], up: FloatArray, direction: FloatArray, most: float) -> None:
    """Refuse poses tilted beyond the tilt limit of the trees.

    Raises:
        InputError: A pose is tilted too far.
    """
    for k, pose in enumerate(poses):
        lean = math.acos(min(1.0, float(up @ pose[:3, :3] @ direction)))
        if lean > most:
            raise InputError(
                f"poses[{k}]: tilted by {math.degrees(lean):.4g} deg from the orientation of the tool at the start; "
                f"poses may use at most {_OF_TILT:g} of tilt_rad, {math.degrees(most):.4g} deg",
                pose=k,
                tilt_rad=lean,
            )


def _find_legs(task: _PoseTask, begin: FloatArray, number: int) -> list[_Leg]:
    """Return certified legs from a configuration through the remaining poses.

    Raises:
        HplanError: No legs were found; the error explains the failure of the first attempt.
    """
    if number == len(task.poses):
        return []
    failure: HplanError | None = None
    given_up: list[Problem] = []
    for leg in _lines(task, begin, number) if task.straight[number] else _find_free_legs(task, begin, number, given_up):
        try:
            found = _certify_leg(task, leg)
            given_up.append(leg.problem)  # no continuation exists from its end
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


def _find_free_legs(task: _PoseTask, begin: FloatArray, number: int, given_up: Sequence[Problem]) -> Iterator[_Leg]:
    """Yield free legs to configurations that allow the following straight segments.

    The nearest configurations come first.

    Args:
        given_up: Problems to skip from now on; the caller may append to it.
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
    if task.chain is not None:
        yield from _upright(task.chain, tasks, number, given_up)
        return
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
    problem, pose = task.problem, task.poses[number]
    quaternion = tuple(pin.Quaternion(pose[:3, :3]).coeffs().tolist())
    goal = Goal(position=tuple(pose[:3, 3].tolist()), quaternion_xyzw=quaternion)
    with stage("grasps"):
        return configurations_at(problem.world, goal, begin, problem.scene.locked_joints)


def _upright(chain: Chain, tasks: Sequence[Problem], number: int, given_up: Sequence[Problem]) -> Iterator[_Leg]:
    """Yield upright paths to configurations: direct in joint space, or from trees.

    Raises:
        NotFoundError: No path was found.
    """
    if not tasks:
        return
    field, reached = tasks[0].field, False
    for to in tasks:
        rows = _follow_upright(chain, to, to.start, to.goal)
        if rows is not None and field.is_clear(rows, 0.1 * to.margin):
            reached = True
            yield _Leg(number, to, rows)
    first, least = tasks[0], 0.1 * min(to.margin for to in tasks)
    # Longest edge of upright trees for a tilt of one radian [s]; it scales with the square root of the tilt.
    edge_s, upright = 0.1 * math.sqrt(chain.free_turn[1]), _restrict(chain, first)
    for seed, evaluations in enumerate(_TREES):
        left = [to for to in tasks if to not in given_up]
        if not left:
            return
        goals = np.array([to.goal for to in left])
        with stage("trees"):
            path, _ = tree_path(
                first, least, evaluations, first.effort.seed + seed, goals=goals, upright=upright, edge_s=edge_s
            )
        if path is not None:
            reached, to = True, left[int((goals == path[-1]).all(axis=1).argmax())]
            yield _Leg(number, to, _shorten_upright(chain, to, path))
    if not reached:
        tried = f"trees of upright configurations, with {sum(_TREES)} evaluations, to pose {number + 1}"
        raise NotFoundError([tried], pose=number)


def _follow_upright(chain: Chain, to: Problem, begin: FloatArray, end: FloatArray) -> FloatArray | None:
    """(m, dof) closely spaced upright configurations between two; None if infeasible."""
    count = max(2, math.ceil(float(np.abs(end - begin).max()) / _ROW) + 1)
    chain = _restrict(chain, to)
    rows, poses = np.repeat(begin[None], count, axis=0), np.repeat(chain.pose[None], count, axis=0)
    most = np.full(rows.shape, 4.0 * _ROW)
    reached = follow(poses, most, np.array(end), 1.0, chain, rows)
    if reached < count or np.abs(rows[-1] - end).max() > _STILL:
        return None
    rows[-1] = end
    return rows


def _shorten_upright(chain: Chain, to: Problem, path: FloatArray) -> FloatArray:
    """Return the path with upright shortcuts."""
    parts = [np.linspace(*pair, max(2, math.ceil(float(np.abs(pair[1] - pair[0]).max()) / _ROW) + 1))[1:]
             for pair in pairwise(path)]  # fmt: skip
    rows, draw = np.vstack([path[:1], *parts]), np.random.Generator(np.random.PCG64(to.effort.seed))
    with stage("postprocess"):
        for _ in range(_SHORTCUTS):
            low, high = np.sort(draw.integers(0, len(rows), 2))
            if high - low < 2:
                continue
            between = _follow_upright(chain, to, rows[low], rows[high])
            if (
                between is not None
                and path_length(between) < path_length(rows[low : high + 1])
                and to.field.is_clear(between, 0.1 * to.margin)
            ):
                rows = np.vstack([rows[:low], between, rows[high + 1 :]])
    return rows


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


def _smooth(leg: _Leg) -> Iterator[SplinePath]:
    """Yield paths to be timed, the smoothest first.

    A straight leg has one path.
    """
    if leg.path is not None:
        yield leg.path
        return
    points = _drop_repeats(leg.rows)
    for coarser in _COARSER:
        count = max(4, math.ceil((len(points) - 1) / coarser) + 1)
        station = stations(points)
        even = np.linspace(0.0, station[-1], count)
        control = np.stack([np.interp(even, station, joint) for joint in points.T], axis=1)
        with suppress(InputError):
            path = SplinePath.from_control_points(control)
            if path.is_clear(leg.problem.field, _margin(leg.problem)):
                yield path


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
    allowed = None if task.tilt_rad is None else math.degrees(task.tilt_rad)
    found = {"allowed_deviation_m": task.deviation_m, "allowed_tilt_deg": allowed, "phases": told}
    return replace(plan_result(whole), told={"poses": found})


def _certify_leg(task: _PoseTask, leg: _Leg) -> _Leg:
    """Return the leg with its certified motion.

    If the arm is already there, the leg has no motion.

    Raises:
        TimingError: The path cannot be timed.
        CertificationError: No motion was certified within the allowed deviation and tilt.
    """
    to, name, failure = leg.problem, f"pose {leg.number + 1}", None
    if leg.motion is not None:
        return leg._replace(motion=replace(leg.motion, name=name), bounds=_tool_bounds(task, leg.motion))
    if len(_drop_repeats(leg.rows)) < 2:
        return leg
    for path in _smooth(leg):
        try:
            trajectory, certificate = certified_trajectory(to, path)
        except (TimingError, CertificationError) as error:
            failure = failure or error
            continue
        origin: Origin = "direct" if task.straight[leg.number] else "trees"
        motion = Motion(name, trajectory, certificate, to, frozen(np.array(leg.rows)), path, origin)
        with stage("certificate"):
            bounds = _tool_bounds(task, motion)
        tilted = task.tilt_rad is not None and bounds.tilt_rad > task.tilt_rad
        if not tilted and (not task.straight[leg.number] or bounds.deviation_m <= task.deviation_m):
            motion, bounds = (motion, bounds) if task.straight[leg.number] else _optimize_upright(task, motion, bounds)
            return leg._replace(motion=motion, bounds=bounds)
        failure = failure or CertificationError(
            f"to pose {leg.number + 1} the deviation of the tool is bounded by {1e3 * bounds.deviation_m:.4g} mm from "
            f"its line and {math.degrees(bounds.tilt_rad):.4g} deg from upright, which is more than allowed",
            pose=leg.number,
            **bounds._asdict(),
        )
    raise failure or CertificationError(f"the path to pose {leg.number + 1} cannot be smoothed within its clearance")


def _optimize_upright(task: _PoseTask, motion: Motion, bounds: ToolBounds) -> tuple[Motion, ToolBounds]:
    """Return an optimized upright motion, or the given one.

    The given one is kept if it is close to its duration bound, or if the optimized one tilts too far.
    """
    is_fast = motion.trajectory.duration <= _FAST * motion.problem.least_duration
    if task.tilt_rad is None or task.chain is None or is_fast:
        return motion, bounds
    chain = _restrict(task.chain, motion.problem)
    quicker = best_of(improve(motion, chain._replace(free_turn=np.array([UPRIGHT, _OPTIMIZED * task.tilt_rad]))))
    with stage("certificate"):
        found = _tool_bounds(task, quicker)
    return (quicker, found) if found.tilt_rad <= task.tilt_rad else (motion, bounds)


def _tool_bounds(task: _PoseTask, motion: Motion) -> ToolBounds:
    options = task.problem.options
    return tool_bounds(task.problem.robot, motion.trajectory, task.direction, task.upright, options.certified_tracking)
