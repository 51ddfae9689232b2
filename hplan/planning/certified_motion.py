"""Motions along given paths: smoothed, timed, certified."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, Record, frozen
from hplan.certificate.certificate import Certificate, Stretch, certify_among
from hplan.collision.reach import largest_sway
from hplan.errors import CertificationError, TimingError
from hplan.optimization.minimize_time import Effort, minimize_time
from hplan.optimization.options import PostprocessOptions
from hplan.optimization.several_starts import NEAR, fastest_motions, optimization_starts
from hplan.optimization.smooth_path import clear_path, is_straight, near_field, short_path
from hplan.optimization.time_problem import TimeProblem
from hplan.optimization.timed_spline import BoundaryState
from hplan.planning.effort import optimization_of
from hplan.planning.grid_route import Route
from hplan.planning.task import PlanningContext, PlanningTask
from hplan.robot.limits import GeometricPath, Limits
from hplan.trajectory.retime import time_path
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.trajectory import Trajectory

#: Where the base is locked a rough motion costs little: of more than so many polylines, so many and so many others are
#: made at least (`StartsEffort`).
MANY, PLANAR_ROUGH, PLANAR_OTHERS = 4, 6, 4

#: Where tracking errors grow with speed, motions make room for so many times as much, tried in turn until one is
#: certified; a motion on a given path is run at these fractions of its own speed.
SWAYS = (1.0, 1.6, 2.5)
SPEEDS = (1.0, 0.7, 0.5, 0.35, 0.25, 0.17, 0.12, 0.08, 0.05, 0.03)

#: Steps of the linear programs by which a motion is made quicker, in turn.
STEPS = (3, 6, 12, 20)

#: No joint that moves is asked to be slower than this [rad/s].
SLOWEST = 1e-3

#: Configurations of a motion between which obstacles are looked for that are near it.
ALONG = 33

#: A motion is empty, straight, along a path found by trees or on a grid, along that of an earlier motion,
#: an earlier motion, or along a path that was given.
Origin: TypeAlias = Literal["none", "direct", "trees", "search", "mended", "kept", "given"]


class Polyline(NamedTuple):
    """A clear path of straight motions.

    Attributes:
        waypoints: (m, dof) its waypoints.
        origin: Where they come from.
    """

    waypoints: FloatArray
    origin: Origin


class Part(NamedTuple):
    """A motion of a plan or a tour.

    Attributes:
        name: The name of its phase.
        trajectory: The timed motion.
        certificate: What was shown of it.
    """

    name: str
    trajectory: Trajectory
    certificate: Certificate

    @property
    def reversed(self) -> Part:
        """The same backwards: the same distances, and the same torques."""
        return self._replace(trajectory=self.trajectory.reversed, certificate=self.certificate.reversed)


@dataclass(frozen=True, eq=False)
class PlannedMotion(Record):
    """A certified motion from configuration to configuration.

    Attributes:
        task: What was asked.
        route: The path over the grid; None where none was needed.
        waypoints: (m, dof) the polyline before post-processing.
        path: The smooth path; None for an empty motion. Of a motion optimised with its timing the parameter is time.
        trajectory: The timed motion.
        certificate: What was shown of it.
        origin: Where the waypoints come from.
    """

    task: PlanningTask
    route: Route | None
    waypoints: FloatArray
    path: SplinePath | None
    trajectory: Trajectory
    certificate: Certificate
    origin: Origin

    @property
    def transit(self) -> Part:
        """The motion as a part of a plan or a tour."""
        return Part("transit", self.trajectory, self.certificate)


def smooth_and_certify(
    task: PlanningTask,
    waypoints: FloatArray,
    margin: float,
    origin: Origin,
    route: Route | None = None,
    rivals: Sequence[Polyline] = (),
) -> PlannedMotion:
    """The certified motion along a polyline.

    Args:
        task: What is asked.
        waypoints: (m, dof) the polyline, clear.
        margin: Clearance asked for beyond the one to keep [m].
        origin: Where the polyline comes from.
        route: The path over a grid that it comes from; None for none.
        rivals: Other polylines between the same ends; one of them is taken where it promises a quicker motion.

    Raises:
        CertificationError: There is none, or none can be certified.
        TimingError: It cannot be timed.
    """
    polylines = [Polyline(waypoints, origin), *rivals]
    found = _optimized(task, polylines, margin) or _quickest_along(task, polylines[0], margin)
    return replace(found, route=route)


def quickest_certified(
    task: PlanningTask, polylines: Sequence[Polyline], margin: float, *, quicker_than_s: float = math.inf
) -> PlannedMotion | None:
    """The quickest certified motion near some polylines; None where there is none.

    Where none can be optimised with its timing, that along the first of them that leads to one.

    Args:
        task: What is asked.
        polylines: Clear polylines between the same ends.
        margin: Clearance asked for beyond the one to keep [m].
        quicker_than_s: Longest duration of a motion that is of use [s].
    """
    optimized = _optimized(task, polylines, margin, quicker_than_s) if polylines else None
    if optimized is not None or (math.isfinite(quicker_than_s) and optimization_of(task) is not None):
        return optimized
    for polyline in polylines:
        with suppress(CertificationError, TimingError):
            return _quickest_along(task, polyline, margin)
    return None


def _quickest_along(task: PlanningTask, polyline: Polyline, margin: float) -> PlannedMotion:
    """The last of `ever_quicker` motions that begin along a polyline; errors as `along`."""
    found = along(task, polyline, margin)
    for quicker in ever_quicker(found):
        found = quicker
    return found


def along(task: PlanningTask, polyline: Polyline, margin: float) -> PlannedMotion:
    """The certified motion along the first smooth path near a polyline that is verified collision-free.

    Raises:
        CertificationError: There is none, or none can be certified.
        TimingError: It cannot be timed.
    """
    options = smoothing_options(task, margin)
    with task.stage("postprocess"):
        smooth_path = short_path if task.options.objective == "length" else clear_path
        path = smooth_path(polyline.waypoints, task.field, options)
    return PlannedMotion(task, None, polyline.waypoints, path, *certified_trajectory(task, path), polyline.origin)


def ever_quicker(motion: PlannedMotion) -> Iterator[PlannedMotion]:
    """Quicker and quicker motions near one, each certified; none where a short path is asked for, or it is straight."""
    task, effort = motion.task, optimization_of(motion.task)
    start = motion.trajectory
    if (
        effort is None
        or start.samples == 1
        or is_straight(motion.waypoints, task.field, smoothing_options(task, task.margin()))
    ):
        return
    level = effort.optimization.levels[0]
    with task.stage("timing"):
        problem = time_problem(task, start)
    best_s = start.duration
    for steps in STEPS:
        with task.stage("timing"):
            spline = minimize_time(start, problem, Effort((replace(level, steps=steps),)))
        if spline is None or spline.duration >= (1.0 - level.gain) * best_s:
            return
        trajectory = spline.trajectory(problem.dynamics, problem.rate_hz)
        certificate = certificate_of(task, trajectory)
        if not certificate.verified:
            return
        start, best_s = trajectory, trajectory.duration
        yield replace(motion, path=spline.path, trajectory=trajectory, certificate=certificate)


def smoothing_options(task: PlanningTask, margin: float) -> PostprocessOptions:
    """Options of post-processing for a task, with a clearance beyond the one to keep [m]."""
    robot, problem = task.robot, task.problem
    return PostprocessOptions(
        lower=problem.lower,
        upper=problem.upper,
        velocity=robot.velocity_limit,
        acceleration=robot.acceleration_limit,
        movable=problem.movable,
        margin=margin,
    )


def sway_of(context: PlanningContext) -> FloatArray | None:
    """(links, dof) what each link sways by for a unit of each joint's speed [m s/rad]; None if it does not."""
    robot, delay_s = context.robot, context.options.tracking.delay_s
    if delay_s == 0.0:
        return None
    each = delay_s * np.eye(robot.dof)
    if robot.planar is not None:
        return frozen(robot.planar.sway(each).T)
    return frozen(np.tile(largest_sway(robot, each), (len(context.field.chain), 1)))


def time_problem(
    task: PlanningTask, motion: Trajectory, ends: tuple[BoundaryState, BoundaryState] | None = None
) -> TimeProblem:
    """What the fastest motion near a given one has to keep.

    Args:
        task: What is asked.
        motion: The motion to begin with.
        ends: The states in which the fastest one begins and ends; None where both are at rest.
    """
    along = motion.position[np.linspace(0, motion.samples - 1, ALONG).astype(int)]
    return TimeProblem(
        task.field, near_field(along, task.field, NEAR), smoothing_options(task, task.margin()),
        motion_limits(task), task.robot.dynamics, task.options.rate_hz, ends, sway_of(task),
    )  # fmt: skip


def _optimized(
    task: PlanningTask, polylines: Sequence[Polyline], margin: float, quicker_than_s: float = math.inf
) -> PlannedMotion | None:
    """The quickest motion near some polylines that was optimised with its timing and is certified.

    None where the straight one is as good, or none was found or is asked for.
    """
    effort, options = optimization_of(task), task.options
    if effort is None:
        return None
    if not task.problem.turns and len(polylines) > MANY:
        rough, others = max(effort.rough, PLANAR_ROUGH), max(effort.others, PLANAR_OTHERS)
        effort = replace(effort, rough=rough, others=others)
    processing, paths = smoothing_options(task, margin), [polyline.waypoints for polyline in polylines]
    limits, dynamics, sway = motion_limits(task), task.robot.dynamics, sway_of(task)
    if sway is None and is_straight(paths[0], task.field, processing):
        return None
    for times in (0.0,) if sway is None else SWAYS:
        with task.stage("postprocess"):
            problem = TimeProblem(
                task.field, task.field, processing, limits, dynamics, options.rate_hz,
                sway=None if sway is None else times * sway,
            )  # fmt: skip
            starts = optimization_starts(paths, problem)
        with task.stage("timing"):
            motions = fastest_motions(starts, effort, quicker_than_s=quicker_than_s)
        for number, motion in motions:
            trajectory = motion.trajectory(dynamics, options.rate_hz)
            certificate = certificate_of(task, trajectory)
            if certificate.verified:
                waypoints, origin = polylines[number]
                return PlannedMotion(task, None, waypoints, motion.path, trajectory, certificate, origin)
    return None


def certified_trajectory(
    context: PlanningContext,
    path: GeometricPath,
    among: Callable[[Trajectory], Sequence[Stretch]] | None = None,
    grid: FloatArray | None = None,
) -> tuple[Trajectory, Certificate]:
    """The fastest certified trajectory along a path.

    Where tracking errors grow with speed it is run as slowly as it has to be.

    Args:
        context: Arm, obstacles and options.
        path: The path.
        among: The obstacles that a trajectory along it is certified among; those of the context where this is None.
        grid: Path parameters at which its speed is chosen, as `hplan.trajectory.retime.time_path` takes them.

    Raises:
        TimingError: There is none within the limits.
        CertificationError: It is asked for, and something was not shown.
    """
    limits, largest = motion_limits(context), np.empty(0)
    for speed in SPEEDS if context.options.tracking.delay_s > 0.0 else SPEEDS[:1]:
        if speed < 1.0:
            limits = replace(limits, velocity=np.minimum(limits.velocity, np.maximum(speed * largest, SLOWEST)))
        trajectory = timed(context, path, limits, grid)
        largest = np.abs(trajectory.velocity).max(axis=0) if speed == 1.0 else largest
        certificate = certificate_of(context, trajectory, None if among is None else among(trajectory))
        if certificate.verified:
            break
    return trajectory, required(context, certificate)


def motion_limits(context: PlanningContext) -> Limits:
    """What motions of a context may use of the robot's limits."""
    robot = context.robot
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    return limits.scaled(context.options.speed)


def timed(
    context: PlanningContext, path: GeometricPath, limits: Limits | None = None, grid: FloatArray | None = None
) -> Trajectory:
    """The fastest trajectory along a path.

    Args:
        context: Arm, obstacles and options.
        path: The path.
        limits: What it may use; those of the context where this is None.
        grid: Path parameters at which the speed is chosen; None for those that suit any path.

    Raises:
        TimingError: There is none.
    """
    limits, rate_hz = motion_limits(context) if limits is None else limits, context.options.rate_hz
    with context.stage("timing"):
        return time_path(path, context.robot.dynamics, limits, rate_hz=rate_hz, grid=grid)


def certificate_of(
    context: PlanningContext,
    trajectory: Trajectory,
    among: Sequence[Stretch] | None = None,
    *,
    rest_to_rest: bool = True,
) -> Certificate:
    """The certificate of a trajectory, whatever it says.

    Args:
        context: Arm, obstacles and options.
        trajectory: The timed motion.
        among: The obstacles that it is certified among, stretch by stretch; those of the context where this is None.
        rest_to_rest: Whether it has to begin and end at rest.
    """
    options = context.options
    with context.stage("certificate"):
        return certify_among(
            context.robot,
            trajectory,
            [(slice(0, max(1, trajectory.samples - 1)), context.world.checker)] if among is None else among,
            clearance=context.scene.clearance,
            tracking=options.certified_tracking,
            rest_to_rest=rest_to_rest,
        )


def required(context: PlanningContext, certificate: Certificate) -> Certificate:
    """The same certificate.

    Raises:
        CertificationError: The options ask for one, and something was not shown.
    """
    if context.options.certify and not certificate.verified:
        raise CertificationError(
            f"the motion is not certified: {'; '.join(certificate.violations)}",
            violations=list(certificate.violations),
        )
    return certificate
