"""Plans from a start in motion: blended, or stopped first.

The fastest motion in free space (`hplan.optimization.arrival`) is the plan if it is certified. Otherwise a draft from
rest at the end of a stop is overlapped with that stop, as early as is collision-free, and both are optimized together
(`hplan.optimization.minimize_time`). Motions to fruit are planned from the current configuration at rest and blended
with the initial state of motion. If this fails or does not apply, the arm stops as quickly as is collision-free,
each joint on its own or on the path of the running motion, and a plan continues from there. Position, velocity and
acceleration are continuous at the initial state in all cases.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.certificate.certificate import LIMIT_TOLERANCE, Certificate, all_of
from hplan.certificate.goal_contact import REST
from hplan.certificate.start_state import start_state
from hplan.errors import (
    ConfigurationInCollisionError,
    HplanError,
    NoPathError,
    NotFoundError,
    ObstacleInTimeError,
    OptionError,
    UnavoidableContactError,
)
from hplan.optimization.arrival import fastest_arrival
from hplan.optimization.minimize_time import Level, TimedMotion, minimize_time
from hplan.optimization.time_problem import TimeProblem
from hplan.optimization.timed_spline import RESTING, BoundaryState, TimedSpline, even_breaks
from hplan.planning.motion import Motion, Plan, Solver, best_of, certificate_of, motion_limits, time_problem
from hplan.planning.plans import goal_of
from hplan.planning.problem import Problem
from hplan.planning.stages import stage
from hplan.robot.limits import Limits, least_duration_between
from hplan.robot.model import Robot
from hplan.trajectory.braking import braking
from hplan.trajectory.cubics import Rows
from hplan.trajectory.trajectory import Trajectory, join_trajectories

#: Computes a motion to rest when it is needed.
StopMaker: TypeAlias = Callable[[], Trajectory]

#: Fractions of the acceleration limits for stops, tried in turn.
_PUSHES: Final = (1.0, 0.7, 0.4, 0.2)

#: When a draft from the end of a stop begins, as fractions of the stop, tried in turn until both together are
#: collision-free.
_OVERLAPS: Final = (0.0, 0.5, 1.0)

#: Extra acceleration of a joint that stops together with the slowest one [rad/s^2].
_EXTRA_ACCELERATION: Final = 1e-3


def from_motion(solve: Solver, stop: StopMaker | None = None) -> Solver:
    """A solver that also solves problems with a start in motion.

    Its plans are not necessarily each faster than before.

    Args:
        solve: Solver of problems with a start at rest.
        stop: Returns a motion from the state to rest, tried before others; None for none.
    """

    def solver(problem: Problem) -> Iterator[Plan]:
        state = start_state(problem.robot, problem.scene)
        if state is None:
            return solve(problem)
        if problem.options.bound:
            raise OptionError("bound", True, "False if the start is in motion")
        return _plans_in_motion(problem, state, solve, stop)

    return solver


def _plans_in_motion(problem: Problem, state: BoundaryState, solve: Solver, stop: StopMaker | None) -> Iterator[Plan]:
    """Plans from a state of motion.

    Raises:
        UnavoidableContactError: Neither a motion nor a stop was certified.
        HplanError: No motion was found, as raised by `solve`.
    """
    is_found, failure = False, None
    options = problem.options
    may_be_blended = options.objective == "duration" and _is_within(problem, state)
    if may_be_blended:
        try:
            # A motion to joints is certified once it is blended: its start, from rest, is a draft.
            is_draft = problem.scene.goal.has_joints and problem.scene.wood is None
            found = goal_of(problem) if is_draft else None
            goal = found if isinstance(found, Problem) else None
            direct = None if goal is None else _move_directly(goal, state)
            if direct is not None:
                yield Plan(direct)
                return
            # For a first motion at once, a stop and a plan from its end are certified before both are blended.
            if not options.at_once:
                for plan in _drafts_blended(problem, goal, state, solve, stop):
                    is_found = True
                    yield plan
        except HplanError as error:
            if isinstance(error, ConfigurationInCollisionError) and error.which == "start":
                raise
            failure = error.with_traceback(None)
        if is_found and problem.effort.compared == 1:
            return

    def plan_onward(stopped: Trajectory, certificate: Certificate) -> Plan:
        if failure is not None and _is_out_of_reach(failure):
            raise failure
        planned = solve(replace(problem, start=stopped.position[-1]))
        return _stopping_first(stopped, certificate, next(planned) if problem.effort.at_once else best_of(planned))

    try:
        stopping = after_stop(
            stops(problem.robot, state, 1.0 / options.rate_hz, stop),
            lambda motion: certificate_of(problem, motion, rest_to_rest=False),
            plan_onward,
            certify=options.certify,
        )
    except HplanError as error:
        if is_found:
            return
        raise error if failure is None or isinstance(error, UnavoidableContactError) else failure from None
    yield stopping
    blended = _blend_start(stopping, state) if may_be_blended else None
    if blended is not None:
        yield blended


def _drafts_blended(
    problem: Problem, goal: Problem | None, state: BoundaryState, solve: Solver, stop: StopMaker | None
) -> Iterator[Plan]:
    """Plans from rest, blended with a state of motion; those of a goal given as joints are drafts before.

    Args:
        goal: The problem with its goal configuration; None if the goal is not given as joints, or wood is compliant.

    Raises:
        HplanError: No plan from rest was found, as raised by `solve`.
    """
    is_draft, options = goal is not None, problem.options
    stopped = None if goal is None else _stop_before(problem, goal, state, stop)
    start = problem.start if stopped is None else stopped.position[-1]
    planned = solve(replace(problem, is_draft=is_draft, start=start))
    # With an effort to which every motion is close enough, the first draft is, too.
    takes_first = is_draft and math.isinf(problem.effort.close)
    is_timed = options.deadline_s is not None
    for plan in islice(planned, 1) if takes_first else planned if is_timed else [best_of(planned)]:
        whole = plan if stopped is None or goal is None else _with_start(plan, goal)
        blended = _blend_start(whole, state, stopped)
        if blended is not None:
            yield blended


def _is_within(problem: Problem, state: BoundaryState) -> bool:
    """True if a state is within the motion limits, as certificates count them.

    States of the fastest motions are at their limits, up to rounding.
    """
    limits = motion_limits(problem)
    fast = np.abs(state.velocity) > LIMIT_TOLERANCE * limits.velocity
    return not (fast | (np.abs(state.acceleration) > LIMIT_TOLERANCE * limits.acceleration)).any()


def _stop_before(problem: Problem, goal: Problem, state: BoundaryState, given: StopMaker | None) -> Trajectory | None:
    """The first stop from a state, if a motion can go on from its end; otherwise None."""
    found = next(stops(problem.robot, state, 1.0 / problem.options.rate_hz, given), None)
    if found is None:
        return None
    end = found.position[-1]
    is_within = ((goal.lower[0] <= end) & (end <= goal.upper[0])).all()
    return None if not is_within or goal.field.in_collision(end[None], margin=goal.margin)[0] else found


def _blend_start(plan: Plan, state: BoundaryState, stopped: Trajectory | None = None) -> Plan | None:
    """A plan with its transit blended with a state, or None.

    A transit that already begins in motion is optimized.

    Args:
        plan: The plan; with a stop its transit is from rest at the end of the stop.
        state: State at the start.
        stopped: Motion from the state to rest; None for a plan from the state's position, or from the state itself.
    """
    problem, transit = replace(plan.transit.problem, is_draft=False), plan.transit.trajectory
    if transit.samples == 1:
        return None
    ends = state, BoundaryState.of_row(transit, -1)
    is_from_rest = np.abs(transit.velocity[0]).max() <= REST
    if is_from_rest and not plan.transit.problem.is_draft and np.abs(ends[1].velocity).max() <= REST:
        direct = _move_directly(problem, state)
        if direct is not None:
            return replace(plan, transit=direct)
    with stage("timing"):
        program = _admitting(time_problem(problem, ends, plan.transit.near), state)
        program = _with_constant_sway(program, transit)
        effort = problem.effort.begun
        slow = _slow_down(transit, state, program.limits) if is_from_rest else transit
        start: TimedMotion | None = slow
        if stopped is not None:
            start = _first_clear([_Overlapped(stopped, slow, part) for part in _OVERLAPS], program, effort.levels[0])
        elif not is_from_rest:
            start = _first_clear([slow], program, effort.levels[0])
        spline = None if start is None else minimize_time(start, program, effort)
    if spline is None:
        return None
    trajectory = spline.trajectory(problem.robot.dynamics, problem.options.rate_hz)
    certificate = certificate_of(problem, trajectory, rest_to_rest=False, measured=False)
    if not certificate.verified:
        return None
    blended = replace(
        plan.transit, trajectory=trajectory, certificate=certificate, problem=problem, path=spline.path, near=None
    )
    return replace(plan, transit=blended)


def _with_start(plan: Plan, goal: Problem) -> Plan:
    """A draft from the end of a stop as the plan of the problem with the stop's start.

    Its margin is the smaller one of both.
    """
    transit = plan.transit
    spare = frozen(np.minimum(transit.problem.spare_clearances, goal.spare_clearances))
    problem = replace(transit.problem, start=goal.start, spare_clearances=spare)
    waypoints = frozen(np.vstack([goal.start, transit.waypoints]))
    return replace(plan, transit=replace(transit, problem=problem, waypoints=waypoints))


@dataclass(frozen=True, eq=False)
class _Overlapped:
    """A stop, and a motion from rest at its end that begins before the stop ends.

    Attributes:
        stop: Motion to rest.
        onward: Motion from rest at its end.
        part: Start of that motion as a fraction of the stop's duration.
    """

    stop: Trajectory
    onward: Trajectory
    part: float

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return max(self.stop.duration, self.part * self.stop.duration + self.onward.duration)

    def positions(self, clock: FloatArray) -> FloatArray:
        """(k, dof) configurations at (k,) times [s]: the displacements add up."""
        since = np.clip(clock - self.part * self.stop.duration, 0.0, self.onward.duration)
        found: FloatArray = self.onward.positions(since) - self.onward.position[0]
        found += self.stop.positions(np.minimum(clock, self.stop.duration))
        return found


def _first_clear(motions: Sequence[TimedMotion], program: TimeProblem, level: Level) -> TimedSpline | None:
    """The first of some motions that is collision-free, or the last one, as a spline between the program's states.

    None if it is too short.
    """
    for motion in motions:
        pieces = level.pieces_of(motion.duration, program.rate_hz)
        if pieces < 2 * RESTING:
            return None
        spline = TimedSpline.approximate(motion.positions, even_breaks(motion.duration, pieces), program.ends)
        if motion is motions[-1] or program.is_clear(spline):
            return spline
    return None


def _move_directly(problem: Problem, state: BoundaryState) -> Motion | None:
    """The fastest motion in free space from a state to the goal, if it is certified."""
    options = problem.options
    with stage("timing"):
        spline = fastest_arrival(state, problem.goal, motion_limits(problem), options.rate_hz)
        if spline is None:
            return None
        trajectory = spline.trajectory(problem.robot.dynamics, options.rate_hz)
        program = _with_constant_sway(time_problem(problem), trajectory)
        if not program.is_clear(spline):
            return None
    certificate = certificate_of(problem, trajectory, rest_to_rest=False, measured=False)
    if not certificate.verified:
        return None
    waypoints = frozen(np.stack([problem.start, problem.goal]))
    return Motion("transit", trajectory, certificate, problem, waypoints, spline.path, "direct")


def _slow_down(motion: Trajectory, state: BoundaryState, limits: Limits) -> Trajectory:
    """The motion, slowed down to the minimum duration between a state and its end.

    In less time a program has no solution, or one far from its start. Torques are not scaled.
    """
    turn = motion.position[-1] - state.position
    speeds = state.velocity, motion.velocity[-1]
    least_s = float(least_duration_between(turn, speeds, limits.velocity, limits.acceleration).max())
    slower = least_s / motion.duration
    if slower <= 1.0:
        return motion
    time, position, velocity, acceleration, torque = motion.rows
    return motion.copy_unchecked(Rows(slower * time, position, velocity / slower, acceleration / slower**2, torque))


def _with_constant_sway(program: TimeProblem, motion: Trajectory) -> TimeProblem:
    """The program with the maximum displacement of a motion by tracking errors as part of its margin.

    Rows for a displacement that grows with velocity take several times as long. The certificate covers the true one.
    """
    if program.sway is None:
        return program
    sway = float((program.sway @ np.abs(motion.velocity).max(axis=0)).max())
    return replace(program, options=replace(program.options, margin=program.options.margin + sway), sway=None)


def _admitting(program: TimeProblem, state: BoundaryState) -> TimeProblem:
    """A program whose limits include a state that exceeds them by rounding."""
    limits = program.limits
    velocity, acceleration = np.abs(state.velocity), np.abs(state.acceleration)
    return replace(
        program,
        limits=replace(
            limits,
            velocity=frozen(np.maximum(limits.velocity, velocity)),
            acceleration=frozen(np.maximum(limits.acceleration, acceleration)),
        ),
    )


def _stopping_first(stop: Trajectory, certificate: Certificate, plan: Plan) -> Plan:
    """Join a stop and the plan from its end into one plan."""
    transit = plan.transit
    trajectory = join_trajectories([stop, transit.trajectory])
    waypoints = frozen(np.vstack([stop.position[:1], transit.waypoints]))
    certificate = all_of([certificate, transit.certificate])
    whole = replace(transit, waypoints=waypoints, trajectory=trajectory, certificate=certificate)
    return replace(plan, transit=whole)


def after_stop(
    motions: Iterable[Trajectory],
    certificate_of_stop: Callable[[Trajectory], Certificate],
    onward: Callable[[Trajectory, Certificate], Plan | None],
    *,
    certify: bool = True,
) -> Plan:
    """The plan after the first certified stop that has one.

    Args:
        motions: Motions to rest, in the order in which they are tried.
        certificate_of_stop: Returns the certificate of a stop.
        onward: Returns the plan that starts with a stop and its certificate; None or an error if there is no such plan.
        certify: True if the stop must be certified.

    Raises:
        UnavoidableContactError: No certified stop has a plan, and `onward` raised no error; holds the stop with the
            largest clearance.
        HplanError: As raised by `onward` for the first certified stop.
    """
    failure: HplanError | None = None
    tried: list[tuple[Trajectory, Certificate]] = []
    for motion in motions:
        certificate = certificate_of_stop(motion)
        tried.append((motion, certificate))
        if not certificate.verified and certify:
            continue
        try:
            plan = onward(motion, certificate)
        except HplanError as error:
            if _is_out_of_reach(error):
                raise
            failure = failure or error.with_traceback(None)
            continue
        if plan is not None:
            return plan
    if failure is not None:
        raise failure
    best, certificate = max(tried, key=lambda stop: stop[1].min_clearance_m)
    clearance = certificate.min_clearance_m
    raise UnavoidableContactError(
        certificate.violations, len(tried), clearance if np.isfinite(clearance) else None, best
    )


def _is_out_of_reach(error: HplanError) -> bool:
    """True if the search found no path to the goal; from another stop it would hardly find one."""
    return isinstance(error, NoPathError | NotFoundError) and not isinstance(error, ObstacleInTimeError)


def stops(robot: Robot, state: BoundaryState, period: float, given: StopMaker | None) -> Iterator[Trajectory]:
    """Motions from a state to rest, in order of preference.

    The given one first; then, for decreasing accelerations, each joint as quickly as it can, and all joints together.

    Args:
        period: Sampling period [s].
        given: Returns a stop to try first; None for none.
    """
    if given is not None:
        yield given()
    for part in _PUSHES:
        push = part * robot.acceleration_limit
        with np.errstate(divide="ignore", invalid="ignore"):
            slowest = float(np.nan_to_num(np.abs(state.velocity) / push, posinf=0.0).max())
        together = push if slowest == 0.0 else np.minimum(push, np.abs(state.velocity) / slowest + _EXTRA_ACCELERATION)
        for pushes in (push, together):
            found = braking(robot, state.position, state.velocity, state.acceleration, period, pushes)
            if found is not None:
                yield found
