r"""Closed-form inverse kinematics of planar chains with up to three joints.

Locked joints merge the links between free joints into rigid links, so a chain with m free joints has m links. Write
points of the plane as complex numbers, :math:`l_k` for the lengths and :math:`\alpha_k` for the absolute angles of
those links: the tool is at :math:`\sum_k l_k e^{i \alpha_k}`. Two links reach a point at distance r with the angle
:math:`e` or :math:`-e` between them,

.. math::
    \cos e = \frac{r^2 - l_1^2 - l_2^2}{2 l_1 l_2}, \qquad
    \alpha_1 = \arg p \mp \arg(l_1 + l_2 e^{i e}), \qquad \alpha_2 = \alpha_1 \pm e.

With three links, :math:`\alpha_3` is free. As it varies, on either side of the elbow, a joint comes to one of its
limits only if the two links left by this limit (one joint locked, its neighbours merged into one rigid link) reach the
point, and the two sides meet if the elbow is straight or folded. These *corners*, at most 16, are closed-form solutions
themselves. Between neighbouring corners the same limits are satisfied throughout, so a check of the midpoint decides
whether the whole interval is feasible: no interval is missed, however narrow.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from hplan.base import ties
from hplan.base.arrays import BoolArray, ComplexArray, FloatArray, IntArray, Record
from hplan.base.elementary import arccos, arctan2, argument, modulus
from hplan.kinematics.approach_angles import WINDOW_TOLERANCE, Window, angle_above
from hplan.planar.planar_family import PlanarArm

#: A joint this far beyond its limit is clamped to the limit [rad].
ANGLE_TOLERANCE = 1e-10

#: Position tolerance for arms without a free joint [m].
MATCH_TOLERANCE = 1e-6

_BOTH_SIDES = np.array([1.0, -1.0])

#: Number of last-link directions tried with the limits ignored, and number of refinements of the best.
_TRIED, _CLOSER = 720, 3


@dataclass(frozen=True, eq=False)
class Reached(Record):
    """Configurations that reach points.

    Attributes:
        point: (k,) index of the point reached.
        joints: (k, m) angles of the free joints.
        direction: (k,) absolute angle of the last link.
    """

    point: IntArray
    joints: FloatArray
    direction: FloatArray


@dataclass(frozen=True, eq=False)
class FreeChain(Record):
    """The last links of a planar arm, from the first free joint.

    Attributes:
        free: Indices of the m free planar joints.
        lengths: (m,) lengths of the rigid links [m].
        signs: (m,) +1 or -1, sense of each joint.
        offsets: (m,) relative angles of the links at q = 0.
        lower: (m,) lower joint limits.
        upper: (m,) upper joint limits.
        tail: Angle from the last rigid link's chord to the arm's last link.
    """

    free: tuple[int, ...]
    lengths: FloatArray
    signs: FloatArray
    offsets: FloatArray
    lower: FloatArray
    upper: FloatArray
    tail: float

    @classmethod
    def build(cls, arm: PlanarArm, free: tuple[int, ...], held: FloatArray) -> FreeChain:
        """Return the chain from the first free joint on.

        Args:
            free: Indices of the free joints, increasing, at most three.
            held: (n,) joint values; values of free joints are ignored.
        """
        relative = arm.signs * held + arm.offsets
        ends = [*free[1:], arm.link_count][: len(free)]
        lengths, offsets, tail = [], [], 0.0
        for joint, end in zip(free, ends, strict=True):
            bend, chord = 0.0, complex(arm.lengths[joint])
            for link in range(joint + 1, end):
                bend += relative[link]
                chord += arm.lengths[link] * cmath.exp(1j * bend)
            bearing = cmath.phase(chord)
            lengths.append(abs(chord))
            offsets.append(arm.offsets[joint] + tail + bearing)
            tail = bend - bearing
        index = list(free)
        return cls(
            free, np.array(lengths), arm.signs[index], np.array(offsets), arm.lower[index], arm.upper[index], tail
        )

    def joints(self, absolute: FloatArray) -> FloatArray:
        """Joint angles (..., m) for absolute link angles (..., m).

        Each is the smallest equivalent angle not below its lower limit.
        """
        relative = absolute.copy()
        relative[..., 1:] -= absolute[..., :-1]
        q = self.signs * (relative - self.offsets) - self.lower
        q += self.lower - math.tau * np.floor((q + ANGLE_TOLERANCE) / math.tau)
        return q

    def keeps_limits(self, q: FloatArray) -> BoolArray:
        """Limit check of (..., m) joint angles, as returned by `joints`."""
        kept: BoolArray = np.all(q <= self.upper + ANGLE_TOLERANCE, axis=-1)
        return kept

    def reach(self, points: ComplexArray, turns: FloatArray, window: Window | None, count: int) -> Reached:
        """Return all configurations that reach points; continua are sampled.

        Args:
            points: (b,) points relative to the first free joint, along and across the link before it [m].
            turns: (b,) absolute angle of that link.
            window: Window of allowed absolute angles of the last link; None for all.
            count: Total number of samples between the ends of the continua.
        """
        if len(self.free) == 3 and (window is None or window.width > 0.0):
            low = None if window is None else window.low - turns - self.tail
            index, absolute = self._sample_intervals(points, low, 0.0 if window is None else window.width, count)
        elif window is not None and len(self.free) == 3:
            # At a straight elbow or a joint limit, the corners are the more exact solutions.
            corners, solved = self._corners(points)
            index, absolute = self._solve_last_angles(points, (window.low - turns - self.tail)[:, None])
            index = np.concatenate([index, np.nonzero(solved)[0]])
            absolute = np.concatenate([absolute, corners[solved]])
        else:
            index, absolute = self._solve_few_joints(points)
        q = self.joints(absolute)
        direction = turns[index] + self.tail + (absolute[:, -1] if self.free else 0.0)
        kept = self.keeps_limits(q)
        if window is not None:
            kept = kept & window.holds(direction)
        q = np.minimum(np.maximum(q[kept], self.lower), self.upper)
        return Reached(index[kept], q, direction[kept])

    def feasible_directions(self, points: ComplexArray, turns: FloatArray) -> list[tuple[float, float]]:
        """Intervals (low, high) of the last link's angle that reach points.

        The intervals of all points are merged.
        """
        found = self.reach(points, turns, None, 1)
        spans = [(float(angle), 0.0) for angle in found.direction]
        if len(self.free) == 3:
            start, width, feasible = self._intervals(points, self._corners(points)[0], None, 0.0)
            open_ = feasible.any(axis=1)
            low = start + (turns + self.tail)[:, None]
            spans += list(zip(low[open_].tolist(), width[open_].tolist(), strict=True))
        return _merge_intervals(spans)

    def violations(self, points: ComplexArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return solutions that ignore the limits, and their limit violations.

        For three free joints these are the corners, and directions of the last link at small intervals, refined around
        the minimum total violation.

        Returns:
            (k,) index of the point, (k, m) joint angles, (k, m) distances of each joint from its range, 0 inside.
        """
        if len(self.free) < 3:
            index, absolute = self._solve_few_joints(points)
            return index, *self._excess(self.joints(absolute))
        step = math.tau / _TRIED
        tried = np.tile(np.arange(_TRIED) * step, (len(points), 1))
        for closer in range(_CLOSER + 1):
            index, absolute = self._solve_last_angles(points, tried)
            q, excess = self._excess(self.joints(absolute))
            if closer == _CLOSER or not len(index):
                break
            best = absolute[ties.argmin(excess.sum(axis=1)), -1]
            tried = np.tile(best + step * np.linspace(-1.0, 1.0, 101), (len(points), 1))
            step *= 0.02
        corners, solved = self._corners(points)
        at_corner, beyond = self._excess(self.joints(corners[solved]))
        index = np.concatenate([index, np.nonzero(solved)[0]])
        return index, np.concatenate([q, at_corner]), np.concatenate([excess, beyond])

    def _excess(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Joint angles at the turns nearest to their ranges, and their violations."""
        below = q > 0.5 * (self.lower + self.upper) + np.pi
        q = np.where(below & ~(q <= self.upper), q - math.tau, q)
        return q, np.maximum(np.maximum(self.lower - q, q - self.upper), 0.0)

    def _solve_few_joints(self, points: ComplexArray) -> tuple[IntArray, FloatArray]:
        """Point indices and absolute angles for fewer than three free joints."""
        count = len(self.free)
        if count == 2:
            first, second, ok = _both_elbows(self.lengths[0], self.lengths[1], points)
            return np.nonzero(ok)[0], np.stack([first, second], axis=-1)[ok]
        ok = np.abs(modulus(points) - self.lengths.sum()) <= MATCH_TOLERANCE
        return np.flatnonzero(ok), argument(points)[ok, None][:, :count]

    def _with_last(self, points: ComplexArray, last: FloatArray) -> tuple[FloatArray, BoolArray]:
        """(..., 2, 3) absolute link angles for given last ones, with mask.

        The mask is True for solutions.
        """
        l1, l2, l3 = self.lengths
        first, second, ok = _both_elbows(l1, l2, points - l3 * np.exp(1j * last))
        return np.stack([first, second, np.broadcast_to(last[..., None], first.shape)], axis=-1), ok

    def _solve_last_angles(self, points: ComplexArray, last: FloatArray) -> tuple[IntArray, FloatArray]:
        """Point indices and absolute angles for (b, j) given last angles."""
        absolute, ok = self._with_last(points[:, None], last)
        return np.nonzero(ok)[0], absolute[ok]

    def _sample_intervals(
        self, points: ComplexArray, low: FloatArray | None, width: float, count: int
    ) -> tuple[IntArray, FloatArray]:
        """Point indices and absolute angles of corners and interval samples."""
        corners, solved = self._corners(points)
        start, widths, feasible = self._intervals(points, corners, low, width)
        index, found = [np.nonzero(solved)[0]], [corners[solved]]
        point, side, cell = np.nonzero(feasible)
        if len(point):
            sum_ = np.cumsum(widths[point, cell])
            station = sum_[-1] * (np.arange(count) + 0.5) / count
            which = np.minimum(np.searchsorted(sum_, station * (1.0 - 1e-12)), len(sum_) - 1)
            last = start[point[which], cell[which]] + (widths[point[which], cell[which]] - (sum_[which] - station))
            absolute, _ = self._with_last(points[point[which]], last)
            index.append(point[which])
            found.append(absolute[np.arange(count), side[which]])
        if low is not None:
            ends, at_ends = self._solve_last_angles(points, low[:, None] + [0.0, width])
            index.append(ends)
            found.append(at_ends)
        return np.concatenate(index), np.concatenate(found)

    def _corners(self, points: ComplexArray) -> tuple[FloatArray, BoolArray]:
        """Return both solutions of each corner's two-link problem.

        Returns:
            (b, 16, 3) absolute angles of the three links at the corners: the first joint at its limits, the second at
            its limits, straight or folded, the third at its limits; and (b, 16) mask of existing solutions.
        """
        l1, l2, l3 = self.lengths
        ends = self.signs * np.stack([self.lower, self.upper]) + self.offsets
        shoulder, elbow, wrist = ends[:, 0], np.array([*ends[:, 1], 0.0, np.pi]), ends[:, 2]
        upper_arm, forearm = l1 + l2 * np.exp(1j * elbow), l2 + l3 * np.exp(1j * wrist)
        near = np.concatenate([[l2, l2], modulus(upper_arm), [l1, l1]])
        far = np.concatenate([np.full(6, l3), modulus(forearm)])
        start = np.concatenate([l1 * np.exp(1j * shoulder), np.zeros(6)])
        first, second, ok = _both_elbows(near, far, points[:, None] - start)
        absolute = np.empty((*first.shape, 3))
        absolute[:, :2, :, 0] = shoulder[:, None]
        absolute[:, :2, :, 1] = first[:, :2]
        absolute[:, 2:6, :, 0] = first[:, 2:6] - argument(upper_arm)[:, None]
        absolute[:, 2:6, :, 1] = absolute[:, 2:6, :, 0] + elbow[:, None]
        absolute[:, :6, :, 2] = second[:, :6]
        absolute[:, 6:, :, 0] = first[:, 6:]
        absolute[:, 6:, :, 1] = second[:, 6:] - argument(forearm)[:, None]
        absolute[:, 6:, :, 2] = absolute[:, 6:, :, 1] + wrist[:, None]
        return absolute.reshape(len(points), -1, 3), ok.reshape(len(points), -1)

    def _intervals(
        self, points: ComplexArray, corners: FloatArray, low: FloatArray | None, width: float
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Last-link angle intervals between corners, and their feasible elbow sides.

        (b, j) starts and widths, and (b, 2, j) mask of the feasible sides.
        """
        cuts = corners[..., 2] % math.tau
        if low is not None:
            cuts = np.concatenate([cuts, (low[:, None] + [0.0, width]) % math.tau], axis=1)
        cuts.sort(axis=1)
        widths = np.diff(cuts, axis=1, append=cuts[:, :1] + math.tau)
        middle = cuts + 0.5 * widths
        absolute, ok = self._with_last(points[:, None], middle)
        feasible = (self.keeps_limits(self.joints(absolute)) & ok[..., :1]).transpose(0, 2, 1)
        if low is not None:
            feasible &= (angle_above(middle, low[:, None]) <= width)[:, None]
        return cuts, widths, feasible


def _both_elbows(
    l1: FloatArray | float, l2: FloatArray | float, points: ComplexArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(..., 2) absolute angles of two links, and a solution mask.

    The two solutions have the elbow on either side; a straight or folded elbow is a single configuration.
    """
    distance = modulus(points)
    product = np.maximum(2.0 * l1 * l2, 1e-300)
    squares, square = l1 * l1 + l2 * l2, distance * distance
    cos = (square - squares) / product
    # Rounding in the last digit would bend a straight elbow by 1e-8; a closer one counts as straight, or folded.
    cos = np.where(np.abs(cos) >= 1.0 - 1e-15 * (square + squares) / product, np.copysign(1.0, cos), cos)
    bend = arccos(cos)
    half = arctan2(l2 * np.sin(bend), l1 + l2 * cos)
    # A straight or folded arm reaches a point this far out of range [m].
    reach_tolerance = 1e-10
    ok = (distance <= l1 + l2 + reach_tolerance) & (distance >= np.abs(l1 - l2) - reach_tolerance)
    first = argument(points)[..., None] - _BOTH_SIDES * half[..., None]
    return first, first + _BOTH_SIDES * bend[..., None], np.stack([ok, ok & (bend > 0.0) & (bend < np.pi)], axis=-1)


def _merge_intervals(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Merge angle intervals (low, width) into disjoint intervals (low, high).

    Each low is in (-pi, pi].
    """
    merged: list[list[float]] = []
    for low, width in sorted(((np.pi - (np.pi - low) % math.tau, width) for low, width in spans)):
        if merged and low <= merged[-1][1] + WINDOW_TOLERANCE:
            merged[-1][1] = max(merged[-1][1], low + width)
        else:
            merged.append([low, low + width])
    # The last interval may wrap around into the first.
    while len(merged) > 1 and merged[-1][1] >= merged[0][0] + math.tau - WINDOW_TOLERANCE:
        first = merged.pop(0)
        merged[-1][1] = max(merged[-1][1], first[1] + math.tau)
    return [(float(low), float(min(high, low + math.tau))) for low, high in merged]
