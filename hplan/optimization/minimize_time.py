"""The fastest motion near a given one, by linear programs in sequence over a spline in time.

A motion at its limits everywhere on its path is not the fastest: another path may allow more. Here path and timing move
together. Each step is the best one to first order (`hplan.optimization.first_order`), or as much of it as is shown
clear; the last has its pieces meet at rows, so that the rows are the motion exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from hplan.base.arrays import FloatArray, Record, frozen
from hplan.base.deadline import look, until
from hplan.collision.clearance_field import ClearanceField
from hplan.optimization.first_order import MotionArrays, MotionLimits, first_order, least_pace
from hplan.optimization.interior_point import ProgramRows, solve
from hplan.optimization.timed_spline import (
    RESTING,
    BoundaryState,
    MotionBetween,
    TimedSpline,
    breaks_at_rows,
    even_breaks,
)
from hplan.optimization.torque_rows import ALLOWED, NEAR_LIMIT, TorqueUse, torque_rows, with_rows
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.limits import Limits
from hplan.smoothing.options import PostprocessOptions
from hplan.smoothing.spline import FIRST, MovableSpline, pieces_are_clear
from hplan.timing.retime import KEPT

#: Fraction of the margin asked for wherever the proof of a step looks; the programs ask for all of it at their places.
PROVED = 0.05

#: A step is halved so often at most until it is clear.
HALVINGS = 5

#: How near to the best pace steps come, and the last one.
COARSE, EXACT = 1e-5, 1e-8

#: Largest change of a control point in a joint where pieces come to meet at rows [rad]; and what a step that was not
#: clear as a whole leaves of it for the next.
SMALL_TRUST, SHRINK = 0.03, 0.5

#: Steps of which no more than this part is clear, or nothing, are stalled; after so many no more are tried.
STALLED, STALLS = 1.0 / 8.0, 2

#: Longest motion that is looked at; longer ones begin on a path on which the arm has to stop [s].
LONGEST_S = 600.0

#: How often the rows of a motion are counted anew until they are enough.
TRIES = 4

#: Within these times, tried in turn, a motion is led over into the state of motion at its end: with more it leaves its
#: path for a longer distance, with less it is farther beyond the limits [s].
LED_OVER_S = (0.2, 0.1, 0.05)

#: Least pace of a step where an end is in motion: the pieces there are no linear functions of the pace.
LEAST_PACE = 0.75

#: Where an end is in motion, more than this much slower is no remedy for a step that passes limits: the next step is.
REPAIRED = 1.02

#: How often the pace of a motion is looked at anew whose ends do not slow down with it.
PACES = 4


@dataclass(frozen=True)
class Level:
    """How fine a spline is, and what may be spent on it.

    Attributes:
        piece_s: About how long a piece lasts [s].
        pieces: Fewest and most pieces.
        steps: Most steps.
        gain: The last step is the first one that makes the motion quicker by less than this part; in proportion where
            only a part of a step was clear.
        trust: Largest change of a control point in a joint in the first step [rad].
    """

    piece_s: float
    pieces: tuple[int, int]
    steps: int
    gain: float
    trust: float

    def pieces_of(self, duration_s: float, rate_hz: float) -> int:
        """Number of pieces of a motion; no more than half as many as it has rows."""
        wanted = min(max(round(duration_s / self.piece_s), self.pieces[0]), self.pieces[1])
        return min(wanted, int(duration_s * rate_hz) // 2)


@dataclass(frozen=True)
class Effort:
    """What may be spent on a motion: levels from coarse to fine, of which the last has its pieces meet at rows."""

    levels: tuple[Level, ...]


@dataclass(frozen=True, eq=False)
class TimeProblem(Record):
    """What a fastest motion has to keep.

    Attributes:
        field: Arm and obstacles.
        near: What is near the motion to begin with.
        options: Joint limits, movable joints and margin.
        limits: Velocity, acceleration, torque and jerk limits.
        dynamics: Torques of the arm's motions.
        rate_hz: Rows per second.
        ends: The states in which it begins and ends; None where both are at rest.
    """

    field: ClearanceField
    near: ClearanceField
    options: PostprocessOptions
    limits: Limits
    dynamics: InverseDynamics
    rate_hz: float
    ends: tuple[BoundaryState, BoundaryState] | None = None

    @cached_property
    def arrays(self) -> MotionLimits:
        """The limits for kernels."""
        limits, options = self.limits, self.options
        jerk = np.full_like(limits.velocity, np.inf) if limits.jerk is None else limits.jerk
        rates = np.stack([limits.velocity, limits.acceleration, jerk])
        return MotionLimits(options.lower, options.upper, rates, options.movable)

    def is_clear(self, spline: TimedSpline) -> bool:
        """True if the whole motion is shown clear."""
        moved, pieces = MovableSpline(np.array(spline.control), spline.knots), len(spline.control) - 3
        clear = pieces_are_clear(moved, FIRST, pieces - 1, self.field.arrays, PROVED * self.options.margin, 0.0)
        look()
        return bool(clear)

    def pace(self, spline: TimedSpline) -> float:
        """By what the motion's times have to be multiplied to keep velocity, acceleration and jerk."""
        pace = float(least_pace(np.array(spline.control), spline.knots, self.arrays))
        if spline.ends is None:
            return pace
        # The states at the ends stay as they are: with the pace the pieces there change their shape. That may take more
        # pace than it gives, so that only what has to be slower is slowed down.
        total, more = 1.0, pace
        for _ in range(PACES):
            if more <= 1.0:
                break
            total *= more
            slower = spline.at_pace(total)
            more = float(least_pace(np.array(slower.control), slower.knots, self.arrays))
        return total * max(1.0, more)

    def torque_use(self, spline: TimedSpline) -> TorqueUse | None:
        """The use of the torque limits; None without any."""
        limit = self.limits.torque
        return None if limit is None else TorqueUse.of(spline, self.dynamics, limit)

    def keeps_torque(self, spline: TimedSpline) -> bool:
        """True if the torques looked at are within their limits."""
        use = self.torque_use(spline)
        return use is None or use.largest <= 1.0

    def step(
        self, spline: TimedSpline, trust: float, gap: float, *, least: float | None = None
    ) -> tuple[FloatArray, float] | None:
        """The step that is best to first order; None where none is found.

        Args:
            spline: The motion.
            trust: Largest change [rad].
            gap: How near to the best pace.
            least: Least pace; None where there is none.

        Returns:
            (inner, movable) changes of the inner control points, and the pace.
        """
        arrays, options = self.arrays, self.options
        motion = MotionArrays(np.array(spline.control), spline.knots, spline.drift)
        rows = first_order(motion, arrays, self.near.arrays, options.margin, trust)
        look()
        if least is not None:
            rows = with_rows(rows, _at_least(least))
        use = self.torque_use(spline)
        if use is not None and use.largest > NEAR_LIMIT:
            rows = with_rows(rows, torque_rows(use, spline, self.dynamics, arrays))
        joints = len(options.movable)
        inner = len(spline.control) - 2 * RESTING
        found, unknowns = solve(rows, inner * joints, 4 * joints - 1, gap, until())
        look()
        return (unknowns[:-1].reshape(inner, joints), float(unknowns[-1])) if found else None


def _at_least(pace: float) -> ProgramRows:
    """The row of a program that asks for a pace."""
    nothing = np.zeros(0, dtype=np.int32)
    alone = np.array([-1.0])
    return ProgramRows(np.zeros(2, dtype=np.int32), nothing, np.empty(0), alone, pace * alone, np.empty(0))


class TimedMotion(Protocol):
    """A motion that an optimiser may begin with."""

    @property
    def duration(self) -> float:
        """How long it takes [s]."""

    def positions(self, clock: FloatArray) -> FloatArray:
        """(k, dof) configurations at times."""


def rough_motion(start: TimedMotion, problem: TimeProblem, effort: Effort) -> TimedSpline | None:
    """The motion of the first level, whose torques and rows are not looked at; None where none was found.

    Args:
        start: A clear motion from rest to rest, about within the limits.
        problem: What is to be kept.
        effort: What may be spent.
    """
    return _of_level(start, _without_torque(problem), effort.levels[0])


def minimize_time(
    start: TimedMotion, problem: TimeProblem, effort: Effort, *, rough: TimedSpline | None = None
) -> TimedSpline | None:
    """The fastest motion near a given one, clear and within all limits, its pieces meeting at rows.

    Args:
        start: A clear motion from rest to rest, about within the limits, between the same positions.
        problem: What is to be kept.
        effort: What may be spent.
        rough: What `rough_motion` makes of the start, if that is known.

    Returns:
        The motion, or None where none was found.
    """
    limit, free = problem.limits.torque, _without_torque(problem)
    found = _minimized(start, free, effort.levels) if rough is None else _minimized(rough, free, effort.levels[1:])
    if found is None or limit is None or TorqueUse.of(found, problem.dynamics, limit).largest <= ALLOWED:
        return found
    return _minimized(start, problem, effort.levels)


def _without_torque(problem: TimeProblem) -> TimeProblem:
    return replace(problem, limits=replace(problem.limits, torque=None))


def _minimized(start: TimedMotion, problem: TimeProblem, levels: Sequence[Level]) -> TimedSpline | None:
    """As `minimize_time`, with the limits of torque in the programs if the problem has any."""
    found: TimedSpline | None = None
    for level in levels:
        found = _of_level(found or start, problem, level) or found
    found = found or (start if isinstance(start, TimedSpline) else None)
    return None if found is None else _on_rows(found, problem, levels[-1])


def _of_level(start: TimedMotion, problem: TimeProblem, level: Level) -> TimedSpline | None:
    """The fastest motion near a given one with the pieces of a level; None where no step was clear."""
    if not start.duration < LONGEST_S:
        return None
    pieces = level.pieces_of(start.duration, problem.rate_hz)
    if pieces < 2 * RESTING:
        return None
    spline = _first(start, problem, even_breaks(start.duration, pieces))
    best, trust, stalled = None, level.trust, 0
    for _ in range(level.steps):
        step = _step(spline, problem, trust, COARSE)
        if step is None or step.part < 1.0:
            trust *= SHRINK
        stalled += step is None or step.part <= STALLED
        if step is not None:
            pace = problem.pace(step.spline)
            if spline.ends is not None and pace > REPAIRED:
                spline = step.spline
                continue
            moved = step.spline.at_pace(pace)
            before = math.inf if best is None else best.duration
            if moved.duration < before:
                best = spline = moved
            if moved.duration > (1.0 - level.gain * step.part) * before:
                break
        if stalled == STALLS:
            break
    return best


def _first(start: TimedMotion, problem: TimeProblem, breaks: FloatArray) -> TimedSpline:
    """The spline to begin with: between states of motion one that leaves the start no farther than is clear."""
    if problem.ends is None or (isinstance(start, TimedSpline) and start.ends is not None):
        return TimedSpline.near(start.positions, breaks, problem.ends)
    for within_s in LED_OVER_S:
        between = MotionBetween(start.positions, start.duration, problem.ends, within_s)
        spline = TimedSpline.near(between.positions, breaks, problem.ends)
        if problem.is_clear(spline):
            break
    return spline


def _on_rows(spline: TimedSpline, problem: TimeProblem, level: Level) -> TimedSpline | None:
    """The fastest motion near a given one with pieces that meet at rows; None where none was found."""
    pieces = level.pieces_of(spline.duration, problem.rate_hz)
    if pieces < 2 * RESTING:
        return None
    rows, trust = math.ceil(spline.duration * problem.rate_hz - 1e-6), SMALL_TRUST
    found: TimedSpline | None = None
    most = math.inf
    for _ in range(TRIES):
        breaks = breaks_at_rows(rows, pieces, problem.rate_hz)
        slower = spline.at_pace(breaks[-1] / spline.duration)
        near = TimedSpline.near(slower.positions, breaks, problem.ends)
        step = _step(near, problem, trust, EXACT, on_rows=True)
        if step is None:
            break
        spline, pace = step.spline, problem.pace(step.spline)
        kept = 1e-6 if spline.ends is None else KEPT
        if pace <= 1.0 + kept and problem.keeps_torque(spline):
            found, most = spline, rows
        if step.part < 1.0:
            trust *= SHRINK
        if spline.ends is not None and pace > 1.0 + kept:
            pace = max(step.pace, 1.0 + KEPT)
        rows = math.ceil(rows * pace - 1e-6)
        if rows >= most:
            break
    return found


class _Step(NamedTuple):
    """A motion after a step.

    Attributes:
        spline: The motion.
        part: How much of the step was taken.
        pace: The pace that its program gives.
    """

    spline: TimedSpline
    part: float
    pace: float


def _step(
    spline: TimedSpline, problem: TimeProblem, trust: float, gap: float, *, on_rows: bool = False
) -> _Step | None:
    """The best step, or as much of it as is clear; None where there is none.

    The pace is left as it was, unless an end is in motion, which changes the pieces there with the pace.
    """
    least = None if spline.ends is None else 1.0 if on_rows else LEAST_PACE
    found = problem.step(spline, trust, gap, least=least)
    if found is None:
        return None
    change = np.zeros_like(spline.control)
    change[RESTING:-RESTING, problem.options.movable], pace = found
    parts = (0.5**halving for halving in range(HALVINGS + 1))
    tried = (
        _Step(_taken(spline, part * change, 1.0 if on_rows else 1.0 + part * (pace - 1.0)), part, pace)
        for part in parts
    )
    return next((step for step in tried if problem.is_clear(step.spline)), None)


def _taken(spline: TimedSpline, change: FloatArray, pace: float) -> TimedSpline:
    """The motion after a change of its control points and, where an end is in motion, of its pace."""
    moved = TimedSpline(frozen(spline.control + change), spline.knots, spline.ends)
    return moved if spline.ends is None else moved.at_pace(pace)
