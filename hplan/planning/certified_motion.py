"""Motions along given paths: smoothed, timed, certified."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, Record
from hplan.errors import CertificationError, TimingError
from hplan.optimization.minimize_time import Effort, Level
from hplan.optimization.several_starts import NEAR, StartsEffort, fastest_motions, optimization_starts
from hplan.optimization.time_problem import TimeProblem
from hplan.optimization.timed_spline import BoundaryState
from hplan.planning.grid_route import Route
from hplan.planning.task import PlanningContext, PlanningTask
from hplan.robot.limits import GeometricPath, Limits
from hplan.smoothing.minimize_duration import estimated_duration
from hplan.smoothing.options import PostprocessOptions
from hplan.smoothing.smooth_path import fast_path, is_straight, near_field
from hplan.smoothing.spline import SplinePath
from hplan.timing.retime import time_path
from hplan.timing.speed_ceiling import SpeedCeiling, averaging_s
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import Certificate, Stretch, certify_among

_COARSE = Level(piece_s=0.08, pieces=(20, 40), steps=20, gain=2e-3, trust=0.2)

#: What may be spent on the optimisation of a motion, by the option.
EFFORTS: dict[str, StartsEffort | None] = {
    "quick": None,
    "default": StartsEffort(
        Effort((_COARSE, Level(piece_s=0.03, pieces=(50, 120), steps=3, gain=5e-3, trust=0.05))),
        rough=4,
        others=1,
        finished=2,
    ),
    "best": StartsEffort(
        Effort((_COARSE, Level(piece_s=0.012, pieces=(60, 300), steps=20, gain=1e-4, trust=0.2))),
        rough=8,
        others=4,
        finished=2,
    ),
}

#: The same of robots that are no planar arms, whose clearances take longer.
EFFORTS_OF_BODIES: dict[str, StartsEffort | None] = {
    **EFFORTS,
    "default": StartsEffort(
        Effort(
            (
                replace(_COARSE, enough=7e-3),
                Level(piece_s=0.03, pieces=(50, 120), steps=2, gain=5e-3, trust=0.05, enough=2e-3),
            ),
            between_rows=True,
        ),
        rough=2,
        others=0,
        finished=1,
    ),
}

#: Where the base is locked a rough motion costs little: of more than so many polylines, so many and so many others are
#: made at least (`StartsEffort`).
MANY, PLANAR_ROUGH, PLANAR_OTHERS = 4, 6, 4

#: Of so many polylines at a time smooth paths are compared where none can be optimised with its timing.
SMOOTHED = 3

#: Fractions of the clearance that sway may take which comes with speed, tried in turn until a motion is certified.
CEILINGS = (0.75, 0.5, 0.2)

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
    if optimized is not None or (math.isfinite(quicker_than_s) and effort_of(task) is not None):
        return optimized
    batches = (polylines[first : first + SMOOTHED] for first in range(0, len(polylines), SMOOTHED))
    smoothed = (_quickest_smoothed(task, batch, margin) for batch in batches)
    return next((motion for motion in smoothed if motion is not None), None)


def _quickest_smoothed(task: PlanningTask, polylines: Sequence[Polyline], margin: float) -> PlannedMotion | None:
    """The certified motion along the smooth path of least estimated duration, or length; None where there is none."""
    options = replace(smoothing_options(task, margin), starts=1)
    found: list[tuple[Polyline, SplinePath]] = []
    with task.stage("postprocess"):
        for polyline in polylines:
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


def effort_of(context: PlanningContext) -> StartsEffort | None:
    """What may be spent on the optimisation of a motion; None where motions are not optimised with their timing."""
    options = context.options
    optimized = options.objective == "duration" and options.tracking.delay_s == 0.0
    efforts = EFFORTS_OF_BODIES if context.robot.planar is None else EFFORTS
    return efforts[options.effort] if optimized else None


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
        motion_limits(task), task.robot.dynamics, task.options.rate_hz, ends,
    )  # fmt: skip


def _optimized(
    task: PlanningTask, polylines: Sequence[Polyline], margin: float, quicker_than_s: float = math.inf
) -> PlannedMotion | None:
    """The quickest motion near some polylines that was optimised with its timing and is certified.

    None where the straight one is as good, or none was found or is asked for.
    """
    effort, options = effort_of(task), task.options
    if effort is None:
        return None
    if not task.problem.turns and len(polylines) > MANY:
        rough, others = max(effort.rough, PLANAR_ROUGH), max(effort.others, PLANAR_OTHERS)
        effort = replace(effort, rough=rough, others=others)
    processing, paths = smoothing_options(task, margin), [polyline.waypoints for polyline in polylines]
    limits, dynamics = motion_limits(task), task.robot.dynamics
    with task.stage("postprocess"):
        if is_straight(paths[0], task.field, processing):
            return None
        problem = TimeProblem(task.field, task.field, processing, limits, dynamics, options.rate_hz)
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

    Where tracking errors grow with speed, tight places are run slowly, and where that is not enough, more slowly.

    Args:
        context: Arm, obstacles and options.
        path: The path.
        among: The obstacles that a trajectory along it is certified among; those of the context where this is None.
        grid: Path parameters at which its speed is chosen, as `hplan.timing.retime.time_path` takes them.

    Raises:
        TimingError: There is none within the limits.
        CertificationError: It is asked for, and something was not shown.
    """
    for fraction in CEILINGS if context.options.tracking.delay_s > 0.0 else (0.0,):
        trajectory = timed(context, path, fraction, grid)
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
    context: PlanningContext, path: GeometricPath, fraction: float = 0.0, grid: FloatArray | None = None
) -> Trajectory:
    """The fastest trajectory along a path under the robot's limits.

    Args:
        context: Arm, obstacles and options.
        path: The path.
        fraction: Fraction of the clearance that the sway may take which comes with speed; 0 if speed is not to care.
        grid: Path parameters at which the speed is chosen; None for those that suit any path.

    Raises:
        TimingError: There is none.
    """
    robot, options, delay_s = context.robot, context.options, context.options.tracking.delay_s
    with context.stage("timing"):
        limits = motion_limits(context)
        if fraction > 0.0:
            averaged_s = averaging_s(limits, options.rate_hz)
            limits = replace(limits, path_speed=SpeedCeiling(robot, path, context.field, delay_s, fraction, averaged_s))
        return time_path(path, robot.dynamics, limits, rate_hz=options.rate_hz, grid=grid)


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
