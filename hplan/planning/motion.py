"""Certified motions made of paths: smoothed or optimized, timed and certified."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeAlias, TypeVar

import numpy as np

from hplan.base.arrays import FloatArray, Record, frozen
from hplan.certificate.certificate import Certificate, Stretch, all_of, certify_among, stretches
from hplan.certificate.goal_displacement import contacts_to_slow
from hplan.certificate.limb_loads import gentle_speeds
from hplan.certificate.limit_use import LimitUse
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import CertificationError, TimingError
from hplan.optimization.coarse_profile import coarse_profile
from hplan.optimization.minimize_time import LONGEST_MOTION_S, OptimizerEffort, TimedMotion, minimize_time, rough_motion
from hplan.optimization.options import PostprocessOptions
from hplan.optimization.several_starts import fastest_motions, optimization_starts
from hplan.optimization.smooth_path import (
    FIRST_CONTROL_POINTS,
    FIRST_SHORTCUTS,
    clear_path,
    is_straight,
    short_path,
)
from hplan.optimization.time_problem import TimeProblem
from hplan.optimization.timed_spline import BoundaryState
from hplan.planning.grasps import Grasp
from hplan.planning.path_finder import GridSearchRecord, Origin, Path
from hplan.planning.problem import Problem
from hplan.planning.stages import stage
from hplan.robot.limits import GeometricPath, Limits
from hplan.trajectory.retime import time_path
from hplan.trajectory.speed_profile import parameter_grid
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.trajectory import Phase, Trajectory, join_trajectories

_T = TypeVar("_T")

#: Samples per second of a draft.
_DRAFT_HZ = 100.0

#: Number of grid points for the speed of a first motion at once, in addition to the knots.
_FIRST_GRID_POINTS = 200

#: A draft that takes longer than this multiple of the lower bound on its duration is optimized coarsely.
_SLOW_DRAFT = 3.0

#: Certificate of a draft: nothing is proved about it.
_NONE = Certificate(False, -math.inf, None, LimitUse(*[math.inf] * 4), 0, ("the motion is a draft",))
_Whole: TypeAlias = tuple[tuple[Phase, ...], Trajectory, Certificate]


@dataclass(frozen=True, eq=False)
class Motion(Record):
    """A certified motion: a phase of a plan or of a tour.

    Attributes:
        name: Name of the phase.
        trajectory: The timed motion.
        certificate: The certificate of the trajectory.
        problem: Arm, world and options; of a transit also its start, goal and joint limits.
        waypoints: (m, dof) the polyline before post-processing; m = 0 for an approach, a retreat or a rest.
        path: The smooth path; None for an empty or reversed motion. If path and timing were optimized together, its
            parameter is time.
        origin: The source of the polyline.
        search: The grid search that found the polyline; None for none.
        near: Clearances without pairs that stay apart along a draft, for the optimizer of its blended motion; None for
            another motion.
    """

    name: str
    trajectory: Trajectory
    certificate: Certificate
    problem: Problem
    waypoints: FloatArray = field(default_factory=lambda: frozen(np.zeros((0, 0))))
    path: SplinePath | None = None
    origin: Origin = "none"
    search: GridSearchRecord | None = None
    near: ClearanceField | None = None

    @property
    def reversal(self) -> Motion:
        """The motion reversed in time, with the same distances and torques."""
        return replace(
            self, trajectory=self.trajectory.reversal, certificate=self.certificate.reversal,
            waypoints=frozen(self.waypoints[::-1].copy()), path=None, search=None,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Plan(Record):
    """Certified motions, one after the other.

    Attributes:
        transit: The first motion.
        others: The motions after it: the approach to a grasp and, from a fruit, the retreat.
        grasp: The goal of the transit; None for a goal given as joints.
        run: Phases, trajectory and certificate to run among moving obstacles, in place of `whole`; None if nothing
            moves.
        told: Additional report sections.
    """

    transit: Motion
    others: tuple[Motion, ...] = ()
    grasp: Grasp | None = None
    run: _Whole | None = None
    told: Mapping[str, Any] = field(default_factory=dict)

    @property
    def motions(self) -> tuple[Motion, ...]:
        """The transit and the motions after it."""
        return (self.transit, *self.others)

    @property
    def duration(self) -> float:
        """Total duration [s]."""
        return seconds(self.motions) if self.run is None else self.run[1].duration

    @cached_property
    def join_phases(self) -> _Whole:
        """Phases, trajectory and certificate of the whole plan."""
        return in_sequence(self.motions) if self.run is None else self.run


#: Finds certified plans for a problem, each faster than the one before. Wrappers take a solver and return one that also
#: solves problems with a start in motion (`start_in_motion`) or moving obstacles (`in_time`).
Solver: TypeAlias = Callable[[Problem], Iterator[Plan]]


def best_of(found: Iterable[_T]) -> _T:
    """The last item of an anytime search, which has at least one."""
    *_, best = found
    return best


def seconds(motions: Sequence[Motion]) -> float:
    """Total duration of motions [s]."""
    return sum(motion.trajectory.duration for motion in motions)


def in_sequence(motions: Sequence[Motion], begin_s: float = 0.0) -> _Whole:
    """Phases, trajectory and certificate of consecutive motions from a start time on."""
    ends = np.cumsum([begin_s, *(motion.trajectory.duration for motion in motions)]).tolist()
    phases = tuple(Phase(motion.name, *span) for motion, span in zip(motions, pairwise(ends), strict=True))
    return (
        phases,
        join_trajectories([motion.trajectory for motion in motions]),
        all_of([motion.certificate for motion in motions]),
    )


def quickest(problem: Problem, polylines: Sequence[Path], margin: float, *, quicker_than_s: float = math.inf) -> Motion:
    """The fastest certified motion near some polylines.

    If the optimizer finds none or the objective is a short path, the motion along the first polyline that admits a
    certified one.

    Args:
        problem: The problem with one goal.
        polylines: Clear polylines between the same ends, at least one.
        margin: Clearance required of the motion beyond the scene's own [m].
        quicker_than_s: Maximum useful duration [s].

    Raises:
        CertificationError: No motion was found or certified; the error of the first polyline.
        TimingError: The first polyline's path cannot be timed.
    """
    if problem.is_draft:
        return _draft(problem, polylines, margin)
    effort = problem.optimization
    optimized = None if effort is None else _optimize(problem, polylines, margin, effort, quicker_than_s)
    if optimized is not None:
        return optimized
    failures: list[CertificationError | TimingError] = []
    for polyline in polylines if effort is None or math.isinf(quicker_than_s) else ():
        try:
            found = best_of(improve(motion_along(problem, polyline, margin)))
        except (CertificationError, TimingError) as error:
            failures.append(error.with_traceback(None))
        else:
            return found
    raise failures[0] if failures else CertificationError("no motion is faster than the known one")


def _draft(problem: Problem, polylines: Sequence[Path], margin: float) -> Motion:
    """A motion near one of some polylines that is about the fastest along its path, not certified.

    The optimizer of the blended motion moves its path, and times it within the limits.

    Raises:
        CertificationError: No smooth path is verified collision-free.
        TimingError: The motion takes too long.
    """
    robot, field, limits = problem.robot, problem.field, motion_limits(problem)
    processing = replace(smoothing_options(problem, margin), velocity=limits.velocity, acceleration=limits.acceleration)
    near: ClearanceField | None = None
    with stage("postprocess"):
        paths = [polyline.waypoints for polyline in polylines]
        program = TimeProblem(field, field, processing, limits, robot.dynamics, problem.options.rate_hz)
        starts = [] if is_straight(paths[0], field, processing) else optimization_starts(paths, program)
        if starts:
            number, near = starts[0].number, starts[0].problem.near
            profile: TimedMotion = starts[0].profile
            if problem.optimization is not None and profile.duration > _SLOW_DRAFT * problem.least_duration:
                # From rest to rest programs are smaller than between states in motion.
                profile = rough_motion(profile, starts[0].problem, problem.optimization) or profile
        else:
            number, profile = 0, coarse_profile(clear_path(paths[0], field, processing), processing)
    if not profile.duration < LONGEST_MOTION_S:
        raise TimingError(f"the motion takes {profile.duration:.4g} s", cause="duration")
    clock = np.linspace(0.0, profile.duration, max(2, math.ceil(_DRAFT_HZ * profile.duration)) + 1)
    position = profile.positions(clock)
    velocity, still = np.gradient(position, clock, axis=0), np.zeros_like(position)
    velocity[[0, -1]] = 0.0
    trajectory = Trajectory(robot.joint_names, clock, position, velocity, still, still, robot.slides)
    polyline = polylines[number]
    return Motion(
        "transit", trajectory, _NONE, problem, polyline.waypoints, None, polyline.origin, polyline.search, near
    )


def motion_along(problem: Problem, polyline: Path, margin: float) -> Motion:
    """The certified motion along the first clear smooth path near a polyline.

    Raises:
        CertificationError: No smooth path is verified collision-free, or the motion is not certified.
        TimingError: The path cannot be timed.
    """
    options = smoothing_options(problem, margin)
    at_once, grid = problem.options.at_once, None
    with stage("postprocess"):
        if problem.options.objective == "length":
            path = short_path(polyline.waypoints, problem.field, options)
        elif at_once:
            path = clear_path(polyline.waypoints, problem.field, options, FIRST_CONTROL_POINTS, FIRST_SHORTCUTS)
        else:
            path = clear_path(polyline.waypoints, problem.field, options)
    if at_once:
        grid = parameter_grid(path, _FIRST_GRID_POINTS)
    return _transit(problem, polyline, path, *certified_trajectory(problem, path, grid=grid))


def improve(motion: Motion) -> Iterator[Motion]:
    """A certified motion, then a faster certified one near it, if any.

    There is no second motion if the objective is a short path, if the first is straight, or if the effort requires a
    first motion as soon as possible and it is close to the fastest.
    """
    yield motion
    problem, effort, start = motion.problem, motion.problem.optimization, motion.trajectory
    if (
        effort is None
        or (problem.effort.at_once and start.duration <= problem.effort.close * problem.least_duration)
        or start.samples == 1
        or is_straight(motion.waypoints, problem.field, smoothing_options(problem, problem.margin))
    ):
        return
    with stage("timing"):
        program = time_problem(problem)
        spline = minimize_time(start, program, effort)
    if spline is not None and spline.duration < start.duration:
        quicker, certificate = certify_gently(problem, spline.trajectory(program.dynamics, program.rate_hz))
        if certificate.verified and quicker.duration < start.duration:
            yield replace(motion, trajectory=quicker, certificate=certificate, path=spline.path)


def _transit(
    problem: Problem, polyline: Path, path: SplinePath, trajectory: Trajectory, certificate: Certificate
) -> Motion:
    return Motion(
        "transit", trajectory, certificate, problem, polyline.waypoints, path, polyline.origin, polyline.search
    )


def smoothing_options(problem: Problem, margin: float) -> PostprocessOptions:
    """Post-processing options of a problem.

    Args:
        margin: Clearance required beyond the scene's own [m].
    """
    robot = problem.robot
    return PostprocessOptions(
        lower=problem.lower[0],
        upper=problem.upper[0],
        velocity=robot.velocity_limit,
        acceleration=robot.acceleration_limit,
        movable=problem.movable,
        margin=margin,
    )


def sway_of(problem: Problem) -> FloatArray | None:
    """(moving bodies, dof) tracking displacement bound per joint speed [m s/rad].

    None without a tracking delay.
    """
    delay_s = problem.options.tracking.delay_s
    if delay_s == 0.0:
        return None
    return frozen(delay_s * problem.field.reaches)


def time_problem(
    problem: Problem, ends: tuple[BoundaryState, BoundaryState] | None = None, near: ClearanceField | None = None
) -> TimeProblem:
    """Constraints of the fastest motion.

    Args:
        ends: Boundary states of the fastest motion; None for rest at both ends.
        near: Clearances without pairs that stay apart; None for all of the problem's.
    """
    return TimeProblem(
        problem.field, problem.field if near is None else near, smoothing_options(problem, problem.margin),
        motion_limits(problem), problem.robot.dynamics, problem.options.rate_hz, ends, sway_of(problem),
    )  # fmt: skip


def _optimize(
    problem: Problem, polylines: Sequence[Path], margin: float, effort: OptimizerEffort, quicker_than_s: float
) -> Motion | None:
    """The fastest certified motion near some polylines from the optimizer.

    None if the straight motion is as good, or no motion was found.
    """
    processing, paths = smoothing_options(problem, margin), [polyline.waypoints for polyline in polylines]
    limits, dynamics, sway, rate_hz = (
        motion_limits(problem),
        problem.robot.dynamics,
        sway_of(problem),
        problem.options.rate_hz,
    )
    if sway is None and is_straight(paths[0], problem.field, processing):
        return None
    # With a velocity-dependent tracking error, retry with larger clearance margins until a motion is certified.
    for room in [None] if sway is None else [times * sway for times in (1.0, 1.6, 2.5)]:
        with stage("postprocess"):
            program = TimeProblem(problem.field, problem.field, processing, limits, dynamics, rate_hz, sway=room)
            starts = optimization_starts(paths, program)
        with stage("timing"):
            motions = fastest_motions(starts, effort, quicker_than_s=quicker_than_s)
        for number, motion in motions:
            trajectory, certificate = certify_gently(problem, motion.trajectory(dynamics, rate_hz))
            if certificate.verified:
                return _transit(problem, polylines[number], motion.path, trajectory, certificate)
    return None


def certified_trajectory(
    problem: Problem,
    path: GeometricPath,
    among: Callable[[Trajectory], Sequence[Stretch]] | None = None,
    grid: FloatArray | None = None,
) -> tuple[Trajectory, Certificate]:
    """The fastest certified trajectory along a path.

    With a velocity-dependent tracking error the speed is reduced until the motion is certified.

    Args:
        among: Returns the segments and obstacles to certify a trajectory against; None for the obstacles of the
            problem.
        grid: Path parameters of the speed profile, as in `hplan.trajectory.retime.time_path`.

    Raises:
        TimingError: No timing satisfies the limits.
        CertificationError: A certificate is required, and the motion is not certified.
    """
    limits, largest = motion_limits(problem), np.empty(0)
    # Fractions of the path's maximum speed, tried in turn until the motion is certified.
    speeds = (1.0, 0.7, 0.5, 0.35, 0.25, 0.17, 0.12, 0.08, 0.05, 0.03)
    tried = speeds if problem.options.tracking.delay_s > 0.0 else speeds[:1]
    for speed in tried:
        if speed < 1.0:
            limits = replace(limits, velocity=np.minimum(limits.velocity, np.maximum(speed * largest, 1e-3)))
        trajectory = time_along(problem, path, limits, grid)
        largest = np.abs(trajectory.velocity).max(axis=0) if speed == 1.0 else largest
        # A slower motion may follow, so nothing is said of this one.
        measured = speed == tried[-1]
        trajectory, certificate = certify_gently(problem, trajectory, among, measured=measured)
        if certificate.verified:
            break
    return trajectory, require_certificate(problem, certificate)


def motion_limits(problem: Problem) -> Limits:
    """The robot's limits, scaled by the speed option."""
    robot = problem.robot
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    return limits.scale(problem.options.speed)


def time_along(
    problem: Problem, path: GeometricPath, limits: Limits | None = None, grid: FloatArray | None = None
) -> Trajectory:
    """The fastest trajectory along a path.

    Args:
        limits: Limits to satisfy; None for the problem's limits.
        grid: Path parameters of the speed profile; None for the default ones.

    Raises:
        TimingError: No timing satisfies the limits.
    """
    limits, rate_hz = motion_limits(problem) if limits is None else limits, problem.options.rate_hz
    with stage("timing"):
        return time_path(path, problem.robot.dynamics, limits, rate_hz=rate_hz, grid=grid)


def certify_gently(
    problem: Problem,
    trajectory: Trajectory,
    among: Callable[[Trajectory], Sequence[Stretch]] | None = None,
    *,
    measured: bool = True,
) -> tuple[Trajectory, Certificate]:
    """A trajectory and its certificate, verified or not; slower where impacts on limbs require it.

    Args:
        among: Returns the segments and obstacles to certify a trajectory against; None for the obstacles of the
            problem.
        measured: Whether the minimum distance is searched if the clearance is not proved.
    """
    quick = trajectory
    certificate = certificate_of(problem, quick, None if among is None else among(quick), measured=measured)
    for ease_s in _EASE_S:
        if certificate.verified or certificate.subject is None or not certificate.subject.has_limbs:
            break
        slower = contacts_to_slow(certificate.subject)
        if slower is None:
            break
        speeds = gentle_speeds(certificate.pushes_by_segment, trajectory.duration, ease_s, slower)
        if speeds is None or np.trapezoid(1.0 / speeds[:, 1], speeds[:, 0]) > _MOST_SLOWED * quick.duration:
            break
        with suppress(TimingError):
            # It begins where the motion does, and takes over from no running one.
            gentle = replace(trajectory.scale_speed(speeds, problem.robot), takes_over_s=quick.takes_over_s)
            found = certificate_of(problem, gentle, None if among is None else among(gentle))
            trajectory, certificate = gentle, found
    return (trajectory if certificate.verified else quick), certificate


#: Maximum duration of a motion that is slowed down for impacts, as a multiple of the quickest one on its path.
_MOST_SLOWED = 5.0

#: Times before and after a contact in which a motion is slowed down, tried in turn [s].
_EASE_S = (0.15, 0.4, math.inf, math.inf)


def certificate_of(
    problem: Problem,
    trajectory: Trajectory,
    among: Sequence[Stretch] | None = None,
    *,
    rest_to_rest: bool = True,
    measured: bool = True,
) -> Certificate:
    """The certificate of a trajectory, verified or not.

    Args:
        among: The segments and obstacles to certify against; None for the obstacles of the problem.
        rest_to_rest: True if the trajectory must begin and end at rest.
        measured: Whether the minimum distance is searched if the clearance is not proved.
    """
    options = problem.options
    with stage("certificate"):
        return certify_among(
            problem.robot,
            trajectory,
            stretches(problem.world.checker, trajectory.time, ()) if among is None else among,
            clearance=problem.scene.clearance,
            tracking=options.certified_tracking,
            rest_to_rest=rest_to_rest,
            measured=measured,
        )


def require_whole(problem: Problem, plan: Plan) -> Plan:
    """A plan of certified motions, if it is verified as a whole or need not be.

    A fruit that is grasped counts what earlier motions have pushed.

    Raises:
        CertificationError: The options require a certificate, and that of the whole is not verified.
    """
    if plan.others and problem.scene.wood is not None and not problem.is_draft:
        require_certificate(problem, plan.join_phases[2])
    return plan


def require_certificate(problem: Problem, certificate: Certificate) -> Certificate:
    """The given certificate, if it is verified or need not be.

    Raises:
        CertificationError: The options require a certificate, and it is not verified.
    """
    if problem.options.certify and not certificate.verified:
        nearest = None if certificate.nearest is None else certificate.nearest.obstacle
        named = nearest is not None and any(nearest in words for words in certificate.violations)
        raise CertificationError(
            f"the motion is not certified: {'; '.join(certificate.violations)}",
            violations=list(certificate.violations),
            obstacle=nearest if named else None,
        )
    return certificate
