"""Motions that begin in motion: led over into one that is planned from rest, or brought to rest first.

A motion from where the arm is, planned as if it were at rest, is led over into the state of motion and optimised with
its timing (`hplan.optimization.minimize_time`). Where that is not to be had, or not asked for, the arm stops as quickly
as is clear, each joint on its own or on the path of the running motion, and a motion goes on from there. Both go on
from the state without a jump of position, velocity or acceleration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.certificate.certificate import REST, Certificate, all_of
from hplan.errors import (
    ConfigurationInCollisionError,
    HplanError,
    NotInTimeError,
    PlanCancelledError,
    UnavoidableContactError,
)
from hplan.optimization.minimize_time import TimedMotion, minimize_time
from hplan.optimization.timed_spline import RESTING, BoundaryState, TimedSpline, even_breaks
from hplan.planning.certified_motion import (
    Part,
    PlannedMotion,
    certificate_of,
    motion_limits,
    time_problem,
)
from hplan.planning.effort import effort_of
from hplan.planning.grasps import Grasp
from hplan.planning.task import PlanningContext
from hplan.robot.model import Robot
from hplan.trajectory.braking import braking
from hplan.trajectory.trajectory import Trajectory, joined

#: Parts of the acceleration limits with which stops are tried in turn.
PUSHES = (1.0, 0.7, 0.4, 0.2)

#: A joint that is to stop with the slowest one gets so much more acceleration than its part [rad/s^2].
TOGETHER = 1e-3


class Parts(NamedTuple):
    """The motions of a plan.

    Attributes:
        grasp: Where they lead to; None for joints.
        motion: The first one, the transit, with all that it was made from.
        parts: All of them.
    """

    grasp: Grasp | None
    motion: PlannedMotion
    parts: Sequence[Part]

    @property
    def duration(self) -> float:
        """How long all motions take together [s]."""
        return sum(part.trajectory.duration for part in self.parts)


class Stop(NamedTuple):
    """A motion to rest, and what was shown of it."""

    trajectory: Trajectory
    certificate: Certificate


def leaving(
    context: PlanningContext,
    state: BoundaryState,
    parts_from: Callable[[FloatArray], Parts],
    stop: Trajectory | None = None,
) -> Parts:
    """The motions of a plan that begins in motion.

    Args:
        context: Arm, obstacles and options.
        state: How it begins.
        parts_from: The motions of a plan that begins at rest at a configuration; raises where there is none.
        stop: A motion from the state to rest to be tried before others; None for none.

    Raises:
        UnavoidableContactError: Neither a motion nor a stop was found that is certified.
        HplanError: No motion was found; what `parts_from` raises where the arm would begin at rest.
    """
    led: Parts | None = None
    refused: HplanError | None = None
    options = context.options
    may_be_led = options.objective == "duration" and options.tracking.delay_s == 0.0 and _is_within(context, state)
    if may_be_led:
        try:
            led = _led_over(parts_from(state.position), state)
        except HplanError as error:
            if isinstance(error, ConfigurationInCollisionError) and error.which == "start":
                raise
            refused = error.with_traceback(None)
        if led is not None and options.effort != "best":
            return led
    try:
        rested = _after_stop(context, state, parts_from, stop)
    except UnavoidableContactError:
        if led is None:
            raise
        return led
    except HplanError as error:
        if led is None:
            raise (refused or error) from None
        return led
    if may_be_led:
        smooth = _led_over(rested, state)
        rested = smooth if smooth is not None and smooth.duration < rested.duration else rested
    return led if led is not None and led.duration <= rested.duration else rested


def _is_within(context: PlanningContext, state: BoundaryState) -> bool:
    """True if motions of the context may be as fast as a state."""
    limits = motion_limits(context)
    fast = np.abs(state.velocity) > limits.velocity
    return not (fast | (np.abs(state.acceleration) > limits.acceleration)).any()


def _led_over(planned: Parts, state: BoundaryState) -> Parts | None:
    """A plan whose first motion is led over into a state, or optimised if it begins so; None if none is certified."""
    motion, transit = planned.motion, planned.parts[0].trajectory
    task = motion.task
    if transit.samples == 1:
        return None
    ends = state, BoundaryState.of_row(transit, -1)
    with task.stage("timing"):
        problem = time_problem(task, transit, ends)
        effort = effort_of(task).begun
        start: TimedMotion = transit
        if np.abs(transit.velocity[0]).max() > REST:
            pieces = effort.levels[0].pieces_of(transit.duration, task.options.rate_hz)
            if pieces < 2 * RESTING:
                return None
            start = TimedSpline.near(transit.positions, even_breaks(transit.duration, pieces), ends)
        spline = minimize_time(start, problem, effort)
    if spline is None:
        return None
    trajectory = spline.trajectory(task.robot.dynamics, task.options.rate_hz)
    certificate = certificate_of(task, trajectory, rest_to_rest=False)
    if not certificate.verified:
        return None
    led = replace(motion, path=spline.path, trajectory=trajectory, certificate=certificate)
    return Parts(planned.grasp, led, [Part(planned.parts[0].name, trajectory, certificate), *planned.parts[1:]])


def _after_stop(
    context: PlanningContext,
    state: BoundaryState,
    parts_from: Callable[[FloatArray], Parts],
    stop: Trajectory | None,
) -> Parts:
    """A plan whose first motion comes to rest and goes on from there.

    Raises:
        UnavoidableContactError: No stop is certified.
        HplanError: As `parts_from`.
    """
    return after_stop(
        stops(context.robot, state, 1.0 / context.options.rate_hz, stop),
        lambda motion: certificate_of(context, motion, rest_to_rest=False),
        lambda stopped: _one_after_the_other(stopped, parts_from(stopped.trajectory.position[-1])),
        certify=context.options.certify,
    )


_Whole = TypeVar("_Whole")


def after_stop(
    motions: Iterable[Trajectory],
    certificate_of_stop: Callable[[Trajectory], Certificate],
    onward: Callable[[Stop], _Whole | None],
    *,
    certify: bool = True,
) -> _Whole:
    """What goes on from the end of the first stop that is certified and from which anything does.

    Args:
        motions: Motions to rest, in the order in which they are tried.
        certificate_of_stop: What is shown of one of them.
        onward: A stop with what goes on from it; None, or an error, where there is nothing.
        certify: Whether stops have to be certified.

    Raises:
        UnavoidableContactError: No stop is certified; holds the one with the most clearance.
        HplanError: As `onward` from the end of the first stop that is.
    """
    refused: HplanError | None = None
    tried: list[Stop] = []
    for motion in motions:
        tried.append(Stop(motion, certificate_of_stop(motion)))
        if not tried[-1].certificate.verified and certify:
            continue
        try:
            whole = onward(tried[-1])
        except (NotInTimeError, PlanCancelledError):
            raise
        except HplanError as error:
            refused = refused or error.with_traceback(None)
            continue
        if whole is not None:
            return whole
    if refused is not None:
        raise refused
    best = max(tried, key=lambda stop: stop.certificate.min_clearance_m)
    clearance = best.certificate.min_clearance_m
    raise UnavoidableContactError(
        best.certificate.violations, len(tried), clearance if np.isfinite(clearance) else None, best.trajectory
    )


def _one_after_the_other(stop: Stop, planned: Parts) -> Parts:
    """A stop and a plan from there as one."""
    first, motion = planned.parts[0], planned.motion
    trajectory = joined([stop.trajectory, first.trajectory])
    certificate = all_of([stop.certificate, first.certificate])
    waypoints = frozen(np.vstack([stop.trajectory.position[:1], motion.waypoints]))
    whole = replace(motion, waypoints=waypoints, trajectory=trajectory, certificate=certificate)
    return Parts(planned.grasp, whole, [Part(first.name, trajectory, certificate), *planned.parts[1:]])


def stops(robot: Robot, state: BoundaryState, period: float, given: Trajectory | None) -> Iterator[Trajectory]:
    """Motions from a state to rest: the given one, each joint as quickly as it can, all joints at once; then slower.

    Args:
        robot: The arm.
        state: How they begin.
        period: Time between their rows [s].
        given: The one to be tried before others; None for none.
    """
    if given is not None:
        yield given
    for part in PUSHES:
        push = part * robot.acceleration_limit
        with np.errstate(divide="ignore", invalid="ignore"):
            slowest = float(np.nan_to_num(np.abs(state.velocity) / push, posinf=0.0).max())
        together = push if slowest == 0.0 else np.minimum(push, np.abs(state.velocity) / slowest + TOGETHER)
        for pushes in (push, together):
            found = braking(robot, state.position, state.velocity, state.acceleration, period, pushes)
            if found is not None:
                yield found
