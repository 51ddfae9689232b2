"""Minimizes a motion's duration by sequential linear programming over a timed spline.

A motion that is time-optimal on its path is not the fastest: another path may allow higher speeds. Here path and timing
are optimized together. Each step is optimal to first order (`hplan.optimization.first_order`), or the largest fraction
of it that is verified collision-free. In the last step the spline's pieces meet at samples, so the samples represent
the motion exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, frozen
from hplan.optimization.constraint_rows import ALLOWED, with_rows
from hplan.optimization.time_problem import TimeProblem
from hplan.optimization.timed_spline import (
    RESTING,
    MotionBetween,
    TimedSpline,
    breaks_at_rows,
    even_breaks,
)
from hplan.trajectory.cubics import accelerations, hermite_pieces
from hplan.trajectory.retime import KEPT

#: Accuracy of the time scale in the last step; in other steps as a fraction of the gain below which a level ends, and
#: of the gain of the step, whichever is larger. A coarser accuracy can select a longer path among motions of equal
#: duration.
_EXACT, _NEAR, _OF_STEP = 1e-5, 0.02, 0.005

#: Initial trust region when pieces are moved to meet at samples [rad], and the factor that shrinks it after a step that
#: is not collision-free as a whole.
_SMALL_TRUST, _SHRINK = 0.03, 0.5

#: A step is stalled if at most this fraction of it is collision-free; a level ends after `_STALLS` stalled steps.
_STALLED, _STALLS = 1.0 / 8.0, 2

#: Maximum duration of an optimized motion; longer ones start from a path on which the arm has to stop [s].
LONGEST_MOTION_S = 600.0

#: Maximum number of times the number of samples is recomputed, and minimum fraction of them that one more time has to
#: save.
_TRIES, _WORTH_ROWS = 4, 2e-3

#: A torque-limited motion is accepted with pieces that do not meet at samples if its duration is within this factor of
#: the fastest.
_AS_QUICK = 1.01

#: If an end state is in motion, larger time-scaling factors are not applied; the next step restores the limits.
_REPAIRED = 1.02


#: Within which time a motion is blended into its boundary state: a longer time leaves the path for a longer distance, a
#: shorter time exceeds the limits more. Tried in order: multiples of the time in which a joint can stop, and minimum
#: times [s].
_BLENDED = ((2.0, 0.2), (1.5, 0.1), (1.0, 0.05))

#: A blended motion that would have to be slowed down by more than this factor is far from its limits, so that
#: its first step may change control points by this much [rad].
_FAR_FROM_LIMITS, _FAR_TRUST = 4.0, 1.0


@dataclass(frozen=True)
class Level:
    """Resolution of the spline and optimization budget of one level.

    Attributes:
        piece_s: Approximate duration of a piece [s].
        pieces: Minimum and maximum number of pieces.
        steps: Maximum number of steps.
        gain: The level ends after the first step that shortens the motion by less than this fraction, scaled by the
            fraction of the step that was collision-free; also the first step of a level that starts from the result of
            the level before.
        trust: Maximum change of a control point in a joint in the first step [rad].
        is_brief: True to solve few programs: a step as a whole from within the limits that changes the duration by less
            than `gain` ends the level even if it is the first, and the last step is less accurate, with as many pieces.
        enough: The level ends when the duration is within this fraction of the lower bound for pieces of this length
            (`TimeProblem.least_duration`); 0 to ignore the lower bound.
    """

    piece_s: float
    pieces: tuple[int, int]
    steps: int
    gain: float
    trust: float
    enough: float = 0.0
    is_brief: bool = False

    def pieces_of(self, duration_s: float, rate_hz: float) -> int:
        """Number of pieces; at most half the number of samples."""
        wanted = min(max(round(duration_s / self.piece_s), self.pieces[0]), self.pieces[1])
        return min(wanted, int(duration_s * rate_hz) // 2)


@dataclass(frozen=True)
class OptimizerEffort:
    """Optimization budget of a motion.

    Attributes:
        levels: Levels from coarse to fine; in the last level the pieces meet at samples.
        rough: Of several paths, maximum number of coarsely optimized motions; they start from the paths with the
            fastest splines, one of each homotopy class.
        others: Minimum number of coarsely optimized motions if paths suffice; with fewer classes, further paths of the
            same classes fill up.
        finished: Maximum number of these motions, the fastest, that are optimized fully.
    """

    levels: tuple[Level, ...]
    rough: int = 1
    others: int = 0
    finished: int = 1


class TimedMotion(Protocol):
    """Motion that an optimizer can start from."""

    @property
    def duration(self) -> float:
        """Duration [s]."""

    def positions(self, clock: FloatArray) -> FloatArray:
        """(k, dof) configurations at (k,) times [s]."""


def rough_motion(start: TimedMotion, problem: TimeProblem, effort: OptimizerEffort) -> TimedSpline | None:
    """Optimize a motion on the first level only; None if not found.

    Torques are not limited, and pieces need not meet at samples.

    Args:
        start: Collision-free motion from rest to rest, approximately within the limits.
        problem: Constraints of the motion.
        effort: Optimization budget.
    """
    return _of_level(start, _without_torque(problem), effort.levels[0])


def minimize_time(
    start: TimedMotion, problem: TimeProblem, effort: OptimizerEffort, *, rough: TimedSpline | None = None
) -> TimedSpline | None:
    """Fastest motion near a given one, collision-free and within all limits.

    Its pieces meet at samples, unless the motion is torque-limited and about as fast without this condition.

    Args:
        start: Collision-free motion from rest to rest with the same start and goal, approximately within the limits.
        problem: Constraints of the motion.
        effort: Optimization budget.
        rough: Result of `rough_motion` for the start; None if not computed.

    Returns:
        The motion, or None if none was found.
    """
    levels = effort.levels if rough is None else effort.levels[1:] or effort.levels
    found = _minimize_levels(start if rough is None else rough, problem, levels, _without_torque(problem))
    if found is None or problem.torque_scale(found) <= 1.0:
        return found
    return _minimize_levels(start, problem, effort.levels, problem)


def _without_torque(problem: TimeProblem) -> TimeProblem:
    return replace(problem, limits=replace(problem.limits, torque=None))


def _minimize_levels(
    start: TimedMotion, problem: TimeProblem, levels: Sequence[Level], programs: TimeProblem
) -> TimedSpline | None:
    """Optimize level by level, adding torque limits when they are violated.

    Between states of rest, the programs include torque limits as soon as a motion exceeds them. Otherwise the final
    motion may exceed them.

    Args:
        programs: Problem of the first programs: the full problem, or the one without torque limits.
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
            return _minimize_levels((on_rows or found).at_time_scale(over), problem, levels[-1:], problem)
        return _between_rows(quickest, problem) if on_rows is None and problem.ends is None else on_rows
    between = None if problem.ends is not None else _between_rows(quickest, problem)
    if between is not None and quickest is not None and between.duration <= _AS_QUICK * quickest.duration:
        return between
    on_rows = _on_rows(found, problem, levels[-1])
    made = [motion for motion in (on_rows, between) if motion is not None]
    return made[ties.argmin([motion.duration for motion in made])] if made else None


def _torque_scale(spline: TimedSpline, problem: TimeProblem) -> float:
    """Time-scaling factor required by the torque limits.

    1 if they hold or if a boundary velocity is nonzero.
    """
    return 1.0 if problem.ends is not None else problem.torque_scale(spline, ALLOWED)


def _between_rows(spline: TimedSpline | None, problem: TimeProblem) -> TimedSpline | None:
    """Motion with a whole number of samples whose pieces meet anywhere.

    None if limits are exceeded. Between two samples this motion is not a single cubic: the certificate is computed for
    the slightly different motion that the samples define.
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
    """Time-scaling factor required by the cubics between a spline's samples."""
    step_s, (speed, push, jerk) = 1.0 / problem.rate_hz, problem.arrays.rates
    clock = np.linspace(0.0, spline.duration, round(spline.duration * problem.rate_hz) + 1)
    velocity = spline.path.evaluate(clock, 1)
    bent = accelerations(*hermite_pieces(clock, spline.positions(clock), velocity))
    moved = problem.options.movable
    uses = (np.abs(velocity) / speed, np.abs(bent) / push, np.abs(np.diff(bent, axis=1)) / step_s / jerk)
    largest = (float(use[..., moved].max()) for use in uses)
    return max(math.pow(use, 1.0 / order) for order, use in enumerate(largest, 1))


def _of_level(start: TimedMotion, problem: TimeProblem, level: Level) -> TimedSpline | None:
    """Optimize a motion on one level; None if no step is collision-free."""
    if not start.duration < LONGEST_MOTION_S:
        return None
    pieces = level.pieces_of(start.duration, problem.rate_hz)
    if pieces < 2 * RESTING:
        return None
    spline = _initial_spline(start, problem, even_breaks(start.duration, pieces))
    enough_s = _sufficient_duration(spline, problem, level)
    best, stalled, before = None, 0, math.inf
    if isinstance(start, TimedSpline) and not _is_blended(start, problem):
        before = start.duration * _torque_scale(start, problem)  # as slow as its torques require
    trust, over = level.trust, 1.0 if spline.ends is None else problem.time_scale(spline)
    if _is_blended(start, problem) and over > _FAR_FROM_LIMITS:
        trust = max(trust, _FAR_TRUST)
    for _ in range(level.steps):
        step = _step(spline, problem, trust, (_NEAR * level.gain, _OF_STEP))
        if step is None:
            break  # with a smaller trust region there is no solution either
        trust = trust * _SHRINK if step.part < 1.0 else min(trust / _SHRINK, level.trust)
        stalled += step.part <= _STALLED
        if step.part > 0.0:
            if level.is_brief and step.part == 1.0 and abs(step.time_scale - 1.0) < level.gain and over <= _REPAIRED:
                return step.spline  # the limits are restored as pieces meet at samples
            time_scale = over = problem.time_scale(step.spline)
            if spline.ends is not None and time_scale > _REPAIRED:
                spline = step.spline
                continue
            # Running faster than the program assumed would increase the tracking error and could cause a collision.
            moved = step.spline.at_time_scale(time_scale if problem.sway is None else max(time_scale, 1.0))
            # The next program corrects torques beyond their limits, which costs less time than slowing down.
            over = _torque_scale(moved, problem)
            kept = moved if over == 1.0 else moved.at_time_scale(over)
            if best is None or kept.duration < best.duration:
                best, spline = kept, moved
            if kept.duration > (1.0 - level.gain * step.part) * before or kept.duration <= enough_s:
                break
            before = best.duration
        if stalled == _STALLS:
            break
    return best


def _is_blended(start: TimedMotion, problem: TimeProblem) -> bool:
    """True if a motion from rest to rest must be blended into states in motion."""
    return problem.ends is not None and not (isinstance(start, TimedSpline) and start.ends is not None)


def _sufficient_duration(spline: TimedSpline, problem: TimeProblem, level: Level) -> float:
    """Duration that ends a level [s]; 0 without a lower bound."""
    if level.enough == 0.0 or spline.ends is not None:
        return 0.0
    turn = spline.control[-1] - spline.control[0]
    return (1.0 + level.enough) * problem.least_duration(turn, len(spline.control) - 3)


def _initial_spline(start: TimedMotion, problem: TimeProblem, breaks: FloatArray) -> TimedSpline:
    """Initial spline of a level.

    With a velocity-dependent tracking error, it is slowed down until it is collision-free. Between states in motion, it
    leaves the start's path over the longest blending time that is collision-free.
    """
    # If tracking errors cause contact, the motion is slowed down by this factor, at most this many times.
    slower, slowed = 1.5, 9
    ends = problem.ends
    if ends is None or not _is_blended(start, problem):
        spline = TimedSpline.approximate(start.positions, breaks, problem.ends)
        for _ in range(slowed if problem.sway is not None else 0):
            if problem.is_clear(spline):
                break
            spline = spline.at_time_scale(slower)
        return spline
    stops_s = np.abs([state.velocity for state in ends]) / problem.limits.acceleration
    for times, least_s in _BLENDED:
        within_s = np.maximum(times * stops_s, least_s)
        between = MotionBetween(start.positions, start.duration, ends, within_s)
        spline = TimedSpline.approximate(between.positions, breaks, ends)
        if problem.is_clear(spline):
            break
    return spline


def _on_rows(spline: TimedSpline, problem: TimeProblem, level: Level) -> TimedSpline | None:
    """Optimize a motion whose pieces meet at samples; None if not found."""
    pieces = len(spline.control) - 3 if level.is_brief else level.pieces_of(spline.duration, problem.rate_hz)
    if pieces < 2 * RESTING:
        return None
    rows, trust = math.ceil(spline.duration * problem.rate_hz - 1e-6), _SMALL_TRUST
    found: TimedSpline | None = None
    most, failed = math.inf, 0
    enough_rows = math.ceil(_sufficient_duration(spline, problem, level) * problem.rate_hz)
    for _ in range(_TRIES):
        breaks = breaks_at_rows(rows, pieces, problem.rate_hz)
        slower = spline.at_time_scale(breaks[-1] / spline.duration)
        near = TimedSpline.approximate(slower.positions, breaks, problem.ends)
        accuracy = 0.5 * KEPT if level.is_brief else _EXACT
        step = _step(near, problem, trust, (accuracy, 0.0), on_rows=True)
        if step is None or step.part == 0.0:
            if problem.sway is None or found is not None:
                break
            rows = math.ceil(rows * _REPAIRED)
            continue
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
        # The next step includes the torques, so half of the required slow-down suffices.
        rows = math.ceil(rows * (math.sqrt(over) if over > 1.0 else time_scale) - 1e-6)
        if rows > (1.0 - _WORTH_ROWS) * most or rows <= failed or most <= enough_rows:
            break
    return found


class _Step(NamedTuple):
    """Motion after a step.

    Attributes:
        spline: The motion.
        part: Fraction of the step that was taken; 0 if no tried fraction is collision-free.
        time_scale: Time scale of the program's solution.
    """

    spline: TimedSpline
    part: float
    time_scale: float


def _step(
    spline: TimedSpline, problem: TimeProblem, trust: float, gap: tuple[float, float], *, on_rows: bool = False
) -> _Step | None:
    """Optimal step, or the largest collision-free fraction of it.

    None if the program has no solution.

    A step may lead into contact between the sample points of the program, or because clearances are not linear. Then
    rows that cut off this step are added, once (compare Hettich and Kortanek 1993, "Semi-infinite programming").

    The time scale is left unchanged, unless a boundary velocity is nonzero, so that the pieces there change with the
    time scale, or tracking errors depend on speed.
    """
    free = spline.ends is None and problem.sway is None
    # Minimum time scale of a step if a boundary velocity is nonzero or tracking errors depend on speed: neither is
    # linear in the time scale.
    least = None if free else 1.0 if on_rows else 0.75
    rows = problem.program(spline, trust, least=least)
    found = problem.solve(rows, spline, gap)
    if found is None:
        return None
    change = np.zeros_like(spline.control)
    inner = slice(RESTING, -RESTING), problem.options.movable
    if free:
        change[inner] = found[0]
        moved = _apply_step(spline, change, 1.0)
        cuts = problem.cuts(moved, found[0])
        if cuts is None:
            return _Step(moved, 1.0, found[1])
        if len(cuts.upper) <= len(rows.upper) - len(rows.lower):  # with more there is hardly ever a solution
            found = problem.solve(with_rows(rows, cuts), spline, gap) or found
    change[inner], time_scale = found
    # A step is halved at most this many times until it is collision-free.
    parts = (0.5**halving for halving in range(5 + 1))
    tried = (
        _Step(
            _apply_step(spline, part * change, 1.0 if on_rows or free else 1.0 + part * (time_scale - 1.0)),
            part,
            time_scale,
        )
        for part in parts
    )
    return next((step for step in tried if problem.is_clear(step.spline)), _Step(spline, 0.0, time_scale))


def _apply_step(spline: TimedSpline, change: FloatArray, time_scale: float) -> TimedSpline:
    """Motion after changing its control points and its time scale."""
    moved = TimedSpline(frozen(spline.control + change), spline.knots, spline.ends)
    return moved if time_scale == 1.0 else moved.at_time_scale(time_scale)
