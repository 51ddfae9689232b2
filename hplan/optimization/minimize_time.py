"""The fastest motion near a given one, by linear programs in sequence over a spline in time.

A motion at its limits everywhere on its path is not the fastest: another path may allow more. Here path and timing move
together. Each step is the best one to first order (`hplan.optimization.first_order`), or as much of it as is shown
clear; the last has its pieces meet at rows, so that the rows are the motion exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, frozen
from hplan.optimization.time_problem import TimeProblem
from hplan.optimization.timed_spline import (
    RESTING,
    MotionBetween,
    TimedSpline,
    breaks_at_rows,
    even_breaks,
)
from hplan.optimization.torque_rows import ALLOWED
from hplan.trajectory.cubics import accelerations, hermite_pieces
from hplan.trajectory.retime import KEPT

#: How near to the best time scale the last step comes; others come as near as this part of the gain that is too little
#: to go on: with more, of motions that take the same time one on a longer path may be found.
_EXACT, _NEAR = 1e-6, 0.02

#: Largest change of a control point in a joint where pieces come to meet at rows [rad]; and what a step that was not
#: clear as a whole leaves of it for the next.
_SMALL_TRUST, _SHRINK = 0.03, 0.5

#: Steps of which no more than this part is clear, or nothing, are stalled; after so many no more are tried.
_STALLED, _STALLS = 1.0 / 8.0, 2

#: Longest motion that is looked at; longer ones begin on a path on which the arm has to stop [s].
LONGEST_S = 600.0

#: How often the rows of a motion are counted anew until they are enough.
_TRIES = 4

#: Of a motion at its limits of torque pieces need not meet at rows where it takes no more than so many times as long.
_AS_QUICK = 1.01

#: Where an end is in motion, more than this much slower is no remedy for a step that passes limits: the next step is.
_REPAIRED = 1.02


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
        enough: The last step is one that leaves no more than this part to what pieces this long allow at best
            (`TimeProblem.least_duration`); 0 where that is not looked at.
    """

    piece_s: float
    pieces: tuple[int, int]
    steps: int
    gain: float
    trust: float
    enough: float = 0.0

    def pieces_of(self, duration_s: float, rate_hz: float) -> int:
        """Number of pieces of a motion; no more than half as many as it has rows."""
        wanted = min(max(round(duration_s / self.piece_s), self.pieces[0]), self.pieces[1])
        return min(wanted, int(duration_s * rate_hz) // 2)


@dataclass(frozen=True)
class Effort:
    """What may be spent on a motion.

    Attributes:
        levels: From coarse to fine; the last has its pieces meet at rows.
    """

    levels: tuple[Level, ...]


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
    """
    return _of_level(start, _without_torque(problem), effort.levels[0])


def minimize_time(
    start: TimedMotion, problem: TimeProblem, effort: Effort, *, rough: TimedSpline | None = None
) -> TimedSpline | None:
    """The fastest motion near a given one, clear and within all limits.

    Its pieces meet at rows, unless it is at its limits of torque and as quick without.

    Args:
        start: A clear motion from rest to rest, about within the limits, between the same positions.
        rough: What `rough_motion` makes of the start, if that is known.

    Returns:
        The motion, or None where none was found.
    """
    levels = effort.levels if rough is None else effort.levels[1:] or effort.levels
    found = _minimized(start if rough is None else rough, problem, levels, _without_torque(problem))
    if found is None or problem.torque_scale(found) <= 1.0:
        return found
    return _minimized(start, problem, effort.levels, problem)


def _without_torque(problem: TimeProblem) -> TimeProblem:
    return replace(problem, limits=replace(problem.limits, torque=None))


def _minimized(
    start: TimedMotion, problem: TimeProblem, levels: Sequence[Level], programs: TimeProblem
) -> TimedSpline | None:
    """As `minimize_time`, level by level.

    Between ends at rest limits of torque are in the programs from where a motion passes them. Between others they may
    be passed in the end.

    Args:
        programs: What the first programs ask for: the problem, or that without the limits of torque.
    """
    found: TimedSpline | None = start if isinstance(start, TimedSpline) else None
    quickest = found
    for level in levels:
        if found is not None and programs is not problem and _torque_scale(found, problem) > 1.0:
            quickest, programs = None, problem
        found = _of_level(found or start, programs, level) or found
        if found is not None and (quickest is None or found.duration < quickest.duration):
            quickest = found
    if found is None:
        return None
    if programs is not problem:
        over = _torque_scale(found, problem)
        on_rows = None if over > 1.0 else _on_rows(found, programs, levels[-1])
        over = over if on_rows is None else _torque_scale(on_rows, problem)
        if over > 1.0:
            return _minimized((on_rows or found).at_time_scale(over), problem, levels[-1:], problem)
        return _between_rows(quickest, problem) if on_rows is None and problem.ends is None else on_rows
    between = None if problem.ends is not None else _between_rows(quickest, problem)
    if between is not None and quickest is not None and between.duration <= _AS_QUICK * quickest.duration:
        return between
    on_rows = _on_rows(found, problem, levels[-1])
    made = [motion for motion in (on_rows, between) if motion is not None]
    return made[ties.argmin([motion.duration for motion in made])] if made else None


def _torque_scale(spline: TimedSpline, problem: TimeProblem) -> float:
    """By what times have to be multiplied for the limits of torque; 1 where they are kept, or an end is in motion."""
    return 1.0 if problem.ends is not None else problem.torque_scale(spline, ALLOWED)


def _between_rows(spline: TimedSpline | None, problem: TimeProblem) -> TimedSpline | None:
    """The motion in a whole number of rows, wherever its pieces meet; None where that passes limits.

    Between two rows it is not one cubic then: what a certificate takes it for is another motion by a little.
    """
    if spline is None:
        return None
    time_scale = 1.0 + KEPT
    for _ in range(_TRIES):
        rows = math.ceil(time_scale * spline.duration * problem.rate_hz)
        slower = spline.at_time_scale(rows / problem.rate_hz / spline.duration)
        use = _use_between_rows(slower, problem)
        if use <= 1.0 + KEPT and (use := problem.torque_scale(slower)) <= 1.0:
            return slower
        time_scale *= use
    return None


def _use_between_rows(spline: TimedSpline, problem: TimeProblem) -> float:
    """By what the times of the cubics between a spline's rows have to be multiplied to keep the limits there."""
    step_s, (speed, push, jerk) = 1.0 / problem.rate_hz, problem.arrays.rates
    clock = np.linspace(0.0, spline.duration, round(spline.duration * problem.rate_hz) + 1)
    velocity = spline.path.evaluate(clock, 1)
    bent = accelerations(*hermite_pieces(clock, spline.positions(clock), velocity))
    moved = problem.options.movable
    uses = (np.abs(velocity) / speed, np.abs(bent) / push, np.abs(np.diff(bent, axis=1)) / step_s / jerk)
    largest = (float(use[..., moved].max()) for use in uses)
    return max(math.pow(use, 1.0 / order) for order, use in enumerate(largest, 1))


def _of_level(start: TimedMotion, problem: TimeProblem, level: Level) -> TimedSpline | None:
    """The fastest motion near a given one with the pieces of a level; None where no step was clear."""
    if not start.duration < LONGEST_S:
        return None
    pieces = level.pieces_of(start.duration, problem.rate_hz)
    if pieces < 2 * RESTING:
        return None
    spline = _first(start, problem, even_breaks(start.duration, pieces))
    enough_s = _enough(spline, problem, level)
    best, trust, stalled = None, level.trust, 0
    for _ in range(level.steps):
        step = _step(spline, problem, trust, _NEAR * level.gain)
        trust = trust * _SHRINK if step is None or step.part < 1.0 else min(trust / _SHRINK, level.trust)
        stalled += step is None or step.part <= _STALLED
        if step is not None:
            time_scale = problem.time_scale(step.spline)
            if spline.ends is not None and time_scale > _REPAIRED:
                spline = step.spline
                continue
            # Faster than its program says it would sway into what is near.
            moved = step.spline.at_time_scale(time_scale if problem.sway is None else max(time_scale, 1.0))
            # Torques beyond their limits are the next program's, which loses less time than slower times would.
            over = _torque_scale(moved, problem)
            kept = moved if over == 1.0 else moved.at_time_scale(over)
            before = math.inf if best is None else best.duration
            if kept.duration < before:
                best, spline = kept, moved
            if kept.duration > (1.0 - level.gain * step.part) * before or kept.duration <= enough_s:
                break
        if stalled == _STALLS:
            break
    return best


def _enough(spline: TimedSpline, problem: TimeProblem, level: Level) -> float:
    """The duration that leaves no more than a level's `enough` to be gained [s]; 0 where that is not looked at."""
    if level.enough == 0.0 or spline.ends is not None:
        return 0.0
    turn = spline.control[-1] - spline.control[0]
    return (1.0 + level.enough) * problem.least_duration(turn, len(spline.control) - 3)


def _first(start: TimedMotion, problem: TimeProblem, breaks: FloatArray) -> TimedSpline:
    """The spline to begin with: between states of motion one that leaves the start no farther than is clear."""
    # A motion that sways into what is near is slowed down so much, so often at most, before the first step.
    slower, slowed = 1.5, 9
    if problem.ends is None or (isinstance(start, TimedSpline) and start.ends is not None):
        spline = TimedSpline.near(start.positions, breaks, problem.ends)
        for _ in range(slowed if problem.sway is not None else 0):
            if problem.is_clear(spline):
                break
            spline = spline.at_time_scale(slower)
        return spline
    # Within these times, tried in turn, a motion is blended into the state of motion at its end: with more it leaves
    # its path for a longer distance, with less it is farther beyond the limits [s].
    for within_s in (0.2, 0.1, 0.05):
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
    rows, trust = math.ceil(spline.duration * problem.rate_hz - 1e-6), _SMALL_TRUST
    found: TimedSpline | None = None
    most, failed = math.inf, 0
    enough_rows = math.ceil(_enough(spline, problem, level) * problem.rate_hz)
    for _ in range(_TRIES):
        breaks = breaks_at_rows(rows, pieces, problem.rate_hz)
        slower = spline.at_time_scale(breaks[-1] / spline.duration)
        near = TimedSpline.near(slower.positions, breaks, problem.ends)
        step = _step(near, problem, trust, _EXACT, on_rows=True)
        if step is None and problem.sway is not None and found is None:
            rows = math.ceil(rows * _REPAIRED)
            continue
        if step is None:
            break
        spline, time_scale = step.spline, problem.time_scale(step.spline)
        kept = 1e-6 if spline.ends is None else KEPT
        over = problem.torque_scale(spline) if time_scale <= 1.0 + kept else 1.0
        if time_scale <= 1.0 + kept and over <= 1.0:
            found, most = spline, rows
        elif over > 1.0 or level.enough > 0.0:
            failed = max(failed, rows)
        if step.part < 1.0:
            trust *= _SHRINK
        if spline.ends is not None and time_scale > 1.0 + kept:
            time_scale = max(step.time_scale, 1.0 + KEPT)
        # The next step takes account of torques: half of what they ask for is enough.
        rows = math.ceil(rows * (math.sqrt(over) if over > 1.0 else time_scale) - 1e-6)
        if rows >= most or rows <= failed or most <= enough_rows:
            break
    return found


class _Step(NamedTuple):
    """A motion after a step.

    Attributes:
        time_scale: The time scale that its program gives.
    """

    spline: TimedSpline
    part: float
    time_scale: float


def _step(
    spline: TimedSpline, problem: TimeProblem, trust: float, gap: float, *, on_rows: bool = False
) -> _Step | None:
    """The best step, or as much of it as is clear; None where there is none.

    The time scale is left as it was, unless an end is in motion, which changes the pieces there with the time scale, or
    tracking errors grow with speed.
    """
    free = spline.ends is None and problem.sway is None
    # Least time scale of a step where an end is in motion, or tracking errors grow with speed: neither is linear in the
    # time scale.
    least = None if free else 1.0 if on_rows else 0.75
    found = problem.step(spline, trust, gap, least=least)
    if found is None:
        return None
    change = np.zeros_like(spline.control)
    change[RESTING:-RESTING, problem.options.movable], time_scale = found
    # A step is halved so often at most until it is clear.
    parts = (0.5**halving for halving in range(5 + 1))
    tried = (
        _Step(
            _taken(spline, part * change, 1.0 if on_rows or free else 1.0 + part * (time_scale - 1.0)), part, time_scale
        )
        for part in parts
    )
    return next((step for step in tried if problem.is_clear(step.spline)), None)


def _taken(spline: TimedSpline, change: FloatArray, time_scale: float) -> TimedSpline:
    """The motion after a change of its control points and of its time scale."""
    moved = TimedSpline(frozen(spline.control + change), spline.knots, spline.ends)
    return moved if time_scale == 1.0 else moved.at_time_scale(time_scale)
