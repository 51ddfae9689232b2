"""Motions along given paths: smoothed, timed, certified."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeAlias

from hplan.base import ties
from hplan.base.arrays import FloatArray, Record
from hplan.errors import CertificationError, TimingError
from hplan.optimization.minimize_time import Effort, Level, TimeProblem, minimize_time, rough_motion
from hplan.optimization.timed_spline import TimedSpline
from hplan.planning.grid_route import Route
from hplan.planning.task import PlanningContext, PlanningTask
from hplan.robot.limits import GeometricPath, Limits
from hplan.robot.tracking import TrackingModel
from hplan.smoothing.minimize_duration import coarse_profile, estimated_duration
from hplan.smoothing.options import PostprocessOptions
from hplan.smoothing.smooth_path import clear_start, fast_path, is_straight, near_field
from hplan.smoothing.spline import SplinePath
from hplan.timing.retime import time_path
from hplan.timing.speed_ceiling import SpeedCeiling, averaging_s
from hplan.timing.speed_profile import SpeedProfile
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import Certificate, Stretch, certify_among


@dataclass(frozen=True)
class MotionEffort:
    """What may be spent on a motion along one of several polylines.

    Attributes:
        optimization: Of one motion.
        rough: Of so many polylines, those with the quickest splines, rough motions are made where the base turns.
        planar: As many where it is locked.
        finished: So many of them, the quickest, are optimised to the end.
    """

    optimization: Effort
    rough: int
    planar: int
    finished: int


_COARSE = Level(piece_s=0.08, pieces=(20, 40), steps=20, gain=2e-3, trust=0.2)

#: What may be spent on the optimisation of a motion, by the option.
EFFORTS: dict[str, MotionEffort | None] = {
    "quick": None,
    "default": MotionEffort(
        Effort((_COARSE, Level(piece_s=0.03, pieces=(50, 120), steps=3, gain=5e-3, trust=0.05))),
        rough=4,
        planar=1,
        finished=2,
    ),
    "best": MotionEffort(
        Effort((_COARSE, Level(piece_s=0.012, pieces=(60, 300), steps=20, gain=1e-4, trust=0.2))),
        rough=8,
        planar=8,
        finished=3,
    ),
}

#: A rough motion comes out quicker by no more than about this part.
LEFT_TO_GAIN = 0.1

#: Obstacles farther than this from a path are left out of the programs that move it [m].
OPTIMIZED = 0.4

#: Of so many polylines smooth paths are compared where none can be optimised with its timing.
SMOOTHED = 3

#: Fractions of the clearance that sway may take which comes with speed, tried in turn until a motion is certified.
CEILINGS = (0.75, 0.5, 0.2)

#: A motion is empty, straight, along a path found in a roadmap, by trees or on a grid, along that of an earlier motion,
#: or an earlier motion.
Origin: TypeAlias = Literal["none", "direct", "roadmap", "trees", "search", "mended", "kept"]


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
        rivals: Other polylines between the same ends; the motion along one of them is taken where it is quicker.

    Raises:
        CertificationError: There is none, or none can be certified.
        TimingError: It cannot be timed.
    """
    optimized = _optimized(task, [Polyline(waypoints, origin), *rivals], margin)
    if optimized is not None:
        return replace(optimized, route=route)
    with task.stage("postprocess"):
        path = fast_path(waypoints, task.field, smoothing_options(task, margin))
    return PlannedMotion(task, route, waypoints, path, *certified_trajectory(task, path), origin)


def quickest_certified(
    task: PlanningTask, polylines: Sequence[Polyline], margin: float, *, quicker_than_s: float = math.inf
) -> PlannedMotion | None:
    """The quickest certified motion near some polylines; None where there is none.

    Where none can be optimised with its timing, that along the smooth path of least estimated duration, or length.

    Args:
        task: What is asked.
        polylines: Clear polylines between the same ends.
        margin: Clearance asked for beyond the one to keep [m].
        quicker_than_s: Longest duration of a motion that is of use [s].
    """
    if not polylines:
        return None
    optimized = _optimized(task, polylines, margin, quicker_than_s)
    if optimized is not None or math.isfinite(quicker_than_s):
        return optimized
    options = replace(smoothing_options(task, margin), starts=1)
    found: list[tuple[Polyline, SplinePath]] = []
    with task.stage("postprocess"):
        for polyline in polylines[:SMOOTHED]:
            with suppress(CertificationError):
                found.append((polyline, fast_path(polyline.waypoints, task.field, options)))
    by_time = options.objective == "duration"
    aims = [estimated_duration(path, options) if by_time else path.length for _, path in found]
    for number in ties.argsort(aims).tolist():
        with suppress(CertificationError, TimingError):
            (waypoints, origin), path = found[number]
            return PlannedMotion(task, None, waypoints, path, *certified_trajectory(task, path), origin)
    return None


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
        objective=task.options.objective,
    )


class _Start(NamedTuple):
    """What an optimiser begins with.

    Attributes:
        polyline: What it comes from.
        problem: What is to be kept.
        profile: About the fastest motion along a smooth path near the polyline.
    """

    polyline: Polyline
    problem: TimeProblem
    profile: SpeedProfile


def _optimized(
    task: PlanningTask, polylines: Sequence[Polyline], margin: float, quicker_than_s: float = math.inf
) -> PlannedMotion | None:
    """The quickest motion near some polylines that was optimised with its timing and is certified.

    None where the straight one is as good, or none was found or is asked for.
    """
    effort, options = EFFORTS[task.options.effort], task.options
    if effort is None or options.objective != "duration" or options.tracking.delay_s > 0.0:
        return None
    processing = smoothing_options(task, margin)
    with task.stage("postprocess"):
        if is_straight(polylines[0].waypoints, task.field, processing):
            return None
        starts = [start for polyline in polylines if (start := _start(task, polyline, processing)) is not None]
    with task.stage("timing"):
        splines = _splines(starts, effort, effort.rough if task.problem.turns else effort.planar, quicker_than_s)
    for (waypoints, origin), spline in splines:
        trajectory = spline.trajectory(task.robot.dynamics, options.rate_hz)
        certificate = certificate_of(task, trajectory)
        if certificate.verified:
            return PlannedMotion(task, None, waypoints, spline.path, trajectory, certificate, origin)
    return None


def _start(task: PlanningTask, polyline: Polyline, processing: PostprocessOptions) -> _Start | None:
    """What an optimiser begins with near a polyline; None where no smooth path near it is found clear at once."""
    near = near_field(polyline.waypoints, task.field, OPTIMIZED)
    spline = clear_start(polyline.waypoints, near, processing)
    if spline is None:
        return None
    limits, rate_hz = motion_limits(task), task.options.rate_hz
    problem = TimeProblem(task.field, near, processing, limits, task.robot.dynamics, rate_hz)
    return _Start(polyline, problem, coarse_profile(spline, processing))


def _splines(
    starts: Sequence[_Start], effort: MotionEffort, most: int, quicker_than_s: float
) -> list[tuple[Polyline, TimedSpline]]:
    """The quickest motions that come of some starts, each with its polyline; the quickest first."""
    order = ties.argsort([start.profile.duration for start in starts])[:most]
    chosen: list[tuple[_Start, TimedSpline | None]] = [(starts[number], None) for number in order.tolist()]
    optimization = effort.optimization
    if len(chosen) > 1:
        chosen = [(start, rough_motion(start.profile, start.problem, optimization)) for start, _ in chosen]
        times = [math.inf if rough is None else rough.duration for _, rough in chosen]
        enough = min(quicker_than_s, min(times)) / (1.0 - LEFT_TO_GAIN)
        order = ties.argsort(times)[: effort.finished]
        chosen = [chosen[number] for number in order.tolist() if times[number] <= enough]
    found = [
        (start.polyline, spline)
        for start, rough in chosen
        if (spline := minimize_time(start.profile, start.problem, optimization, rough=rough)) is not None
    ]
    return [found[number] for number in ties.argsort([spline.duration for _, spline in found]).tolist()]


def certified_trajectory(
    context: PlanningContext, path: GeometricPath, among: Callable[[Trajectory], Sequence[Stretch]] | None = None
) -> tuple[Trajectory, Certificate]:
    """The fastest certified trajectory along a path.

    Where tracking errors grow with speed, tight places are run slowly, and where that is not enough, more slowly.

    Args:
        context: Arm, obstacles and options.
        path: The path.
        among: The obstacles that a trajectory along it is certified among; those of the context where this is None.

    Raises:
        TimingError: There is none within the limits.
        CertificationError: It is asked for, and something was not shown.
    """
    for fraction in CEILINGS if context.options.tracking.delay_s > 0.0 else (0.0,):
        trajectory = timed(context, path, fraction)
        certificate = certificate_of(context, trajectory, None if among is None else among(trajectory))
        if certificate.verified:
            break
    return trajectory, required(context, certificate)


def motion_limits(context: PlanningContext) -> Limits:
    """What motions of a context may use of the robot's limits."""
    robot = context.robot
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    return limits.scaled(context.options.speed)


def timed(context: PlanningContext, path: GeometricPath, fraction: float = 0.0) -> Trajectory:
    """The fastest trajectory along a path under the robot's limits.

    Args:
        context: Arm, obstacles and options.
        path: The path.
        fraction: Fraction of the clearance that the sway may take which comes with speed; 0 if speed is not to care.

    Raises:
        TimingError: There is none.
    """
    robot, options, delay_s = context.robot, context.options, context.options.tracking.delay_s
    with context.stage("timing"):
        limits = motion_limits(context)
        if fraction > 0.0:
            averaged_s = averaging_s(limits, options.rate_hz)
            limits = replace(limits, path_speed=SpeedCeiling(robot, path, context.field, delay_s, fraction, averaged_s))
        return time_path(path, robot.dynamics, limits, rate_hz=options.rate_hz)


def certificate_of(
    context: PlanningContext, trajectory: Trajectory, among: Sequence[Stretch] | None = None
) -> Certificate:
    """The certificate of a trajectory, whatever it says.

    Args:
        context: Arm, obstacles and options.
        trajectory: The timed motion.
        among: The obstacles that it is certified among, stretch by stretch; those of the context where this is None.
    """
    options = context.options
    with context.stage("certificate"):
        return certify_among(
            context.robot,
            trajectory,
            [(slice(0, max(1, trajectory.samples - 1)), context.world.checker)] if among is None else among,
            clearance=context.scene.clearance,
            tracking=TrackingModel(options.tracking_error, options.tracking_delay_s),
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
