r"""Inverse kinematics of a planar chain with up to three free joints: all its solutions, in closed form.

Joints that are held make rigid pieces of the links between free joints, so a chain with m free joints is one of m
links. Write points of the plane as complex numbers, :math:`l_k` for the lengths and :math:`\alpha_k` for the absolute
angles of those links: the tool is at :math:`\sum_k l_k e^{i \alpha_k}`. Two links reach a point at distance r with
the angle :math:`e` or :math:`-e` between them,

.. math::
    \cos e = \frac{r^2 - l_1^2 - l_2^2}{2 l_1 l_2}, \qquad
    \alpha_1 = \arg p \mp \arg(l_1 + l_2 e^{i e}), \qquad \alpha_2 = \alpha_1 \pm e.

With three, :math:`\alpha_3` is free. Along it, on either side of the elbow, a joint comes to one of its limits only
where the two links that this limit leaves (one joint held, its neighbours made one rigid piece) reach the point, and
the two sides meet where the elbow is straight or folded. These *corners*, at most 16, are closed-form solutions
themselves. Between neighbouring corners the same limits are kept throughout, so one look at the middle tells which
intervals are feasible: none is overlooked, however narrow.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from hplan.base import ties
from hplan.base.arrays import BoolArray, ComplexArray, FloatArray, IntArray, Record
from hplan.base.elementary import arccos, arctan2, argument, modulus
from hplan.kinematics.approach_angles import WINDOW_TOLERANCE, Window, above
from hplan.robot.planar_family import PlanarArm

#: A joint this far beyond its limit is put on it [rad].
ANGLE_TOLERANCE = 1e-10

#: Arms with no joint left to adjust reach a point from which they are this far away [m].
MATCH_TOLERANCE = 1e-6

_SIDES = np.array([1.0, -1.0])

#: Directions of the last link tried where limits are set aside, and how often the best is refined.
_TRIED, _CLOSER = 720, 3


@dataclass(frozen=True, eq=False)
class Reached(Record):
    """Configurations that reach points.

    Attributes:
        point: (k,) which point each reaches.
        joints: (k, m) angles of the free joints.
        direction: (k,) absolute angle of the last link.
    """

    point: IntArray
    joints: FloatArray
    direction: FloatArray


@dataclass(frozen=True, eq=False)
class FreeChain(Record):
    """The last links of a planar arm as a chain of those joints that are free; see the module's text.

    Attributes:
        free: Indices of the free planar joints, m of them.
        lengths: (m,) lengths of the rigid pieces [m].
        signs: (m,) +1 or -1, sense of each joint.
        offsets: (m,) relative angles of the pieces at q = 0.
        lower: (m,) lower joint limits.
        upper: (m,) upper joint limits.
        tail: Angle from the last piece's chord to the arm's last link.
    """

    free: tuple[int, ...]
    lengths: FloatArray
    signs: FloatArray
    offsets: FloatArray
    lower: FloatArray
    upper: FloatArray
    tail: float

    @classmethod
    def of(cls, arm: PlanarArm, free: tuple[int, ...], held: FloatArray) -> FreeChain:
        """The chain from the first free joint on.

        Args:
            free: Indices of the free joints, increasing, at most three.
            held: (n,) values of the joints; only those of joints that are held count.
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
        """Joint angles (..., m) for absolute angles (..., m) of the pieces, each the first one not below its limit."""
        relative = absolute.copy()
        relative[..., 1:] -= absolute[..., :-1]
        q = self.signs * (relative - self.offsets) - self.lower
        q += self.lower - math.tau * np.floor((q + ANGLE_TOLERANCE) / math.tau)
        return q

    def keeps_limits(self, q: FloatArray) -> BoolArray:
        """Mask of the (..., m) joint angles, as `joints` gives them, that are within the limits."""
        kept: BoolArray = np.all(q <= self.upper + ANGLE_TOLERANCE, axis=-1)
        return kept

    def reach(self, points: ComplexArray, turns: FloatArray, window: Window | None, count: int) -> Reached:
        """All configurations that reach points; of a continuum the ends and about `count` in between.

        Args:
            points: (b,) points, seen from the first free joint, along and across the piece before it [m].
            turns: (b,) absolute angle of that piece.
            window: Absolute angles of the last link to keep to; None for all.
            count: Configurations between the ends of continua, in all.
        """
        if len(self.free) == 3 and (window is None or window.width > 0.0):
            low = None if window is None else window.low - turns - self.tail
            index, absolute = self._sampled(points, low, 0.0 if window is None else window.width, count)
        elif window is not None and len(self.free) == 3:
            # Where the elbow is straight, or a joint at its limit, the corners are the more exact ones.
            corners, solved = self._corners(points)
            index, absolute = self._directed(points, (window.low - turns - self.tail)[:, None])
            index = np.concatenate([index, np.nonzero(solved)[0]])
            absolute = np.concatenate([absolute, corners[solved]])
        else:
            index, absolute = self._isolated(points)
        q = self.joints(absolute)
        direction = turns[index] + self.tail + (absolute[:, -1] if self.free else 0.0)
        kept = self.keeps_limits(q)
        if window is not None:
            kept = kept & window.holds(direction)
        q = np.minimum(np.maximum(q[kept], self.lower), self.upper)
        return Reached(index[kept], q, direction[kept])

    def feasible_directions(self, points: ComplexArray, turns: FloatArray) -> list[tuple[float, float]]:
        """Intervals (low, high) of the last link's absolute angle with which points are reached, of all points."""
        found = self.reach(points, turns, None, 1)
        spans = [(float(angle), 0.0) for angle in found.direction]
        if len(self.free) == 3:
            start, width, feasible = self._intervals(points, self._corners(points)[0], None, 0.0)
            open_ = feasible.any(axis=1)
            low = start + (turns + self.tail)[:, None]
            spans += list(zip(low[open_].tolist(), width[open_].tolist(), strict=True))
        return _merged(spans)

    def violations(self, points: ComplexArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Solutions with limits set aside, and how far each joint is then beyond its limits.

        Of three free joints, the corners, and directions of the last link at small intervals, smaller ones near the
        least sum.

        Returns:
            (k,) which point, (k, m) joint angles, (k, m) distances from the range of each joint, 0 in it.
        """
        if len(self.free) < 3:
            index, absolute = self._isolated(points)
            return index, *self._excess(self.joints(absolute))
        step = math.tau / _TRIED
        tried = np.tile(np.arange(_TRIED) * step, (len(points), 1))
        for closer in range(_CLOSER + 1):
            index, absolute = self._directed(points, tried)
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
        """Joint angles, whole turns taken off where that brings them nearer to their range, and their distance."""
        below = q > 0.5 * (self.lower + self.upper) + np.pi
        q = np.where(below & ~(q <= self.upper), q - math.tau, q)
        return q, np.maximum(np.maximum(self.lower - q, q - self.upper), 0.0)

    def _isolated(self, points: ComplexArray) -> tuple[IntArray, FloatArray]:
        """Number of the point, and absolute angles, for fewer than three free joints."""
        count = len(self.free)
        if count == 2:
            first, second, ok = _both_elbows(self.lengths[0], self.lengths[1], points)
            return np.nonzero(ok)[0], np.stack([first, second], axis=-1)[ok]
        ok = np.abs(modulus(points) - self.lengths.sum()) <= MATCH_TOLERANCE
        return np.flatnonzero(ok), argument(points)[ok, None][:, :count]

    def _with_last(self, points: ComplexArray, last: FloatArray) -> tuple[FloatArray, BoolArray]:
        """(..., 2, 3) absolute angles of three pieces, that of the last given, and whether they are solutions."""
        l1, l2, l3 = self.lengths
        first, second, ok = _both_elbows(l1, l2, points - l3 * np.exp(1j * last))
        return np.stack([first, second, np.broadcast_to(last[..., None], first.shape)], axis=-1), ok

    def _directed(self, points: ComplexArray, last: FloatArray) -> tuple[IntArray, FloatArray]:
        """Number of the point, and absolute angles, for (b, j) absolute angles of the last of three pieces."""
        absolute, ok = self._with_last(points[:, None], last)
        return np.nonzero(ok)[0], absolute[ok]

    def _sampled(
        self, points: ComplexArray, low: FloatArray | None, width: float, count: int
    ) -> tuple[IntArray, FloatArray]:
        """Number of the point, and absolute angles: the corners, and samples of what is feasible between them."""
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
            ends, at_ends = self._directed(points, low[:, None] + [0.0, width])
            index.append(ends)
            found.append(at_ends)
        return np.concatenate(index), np.concatenate(found)

    def _corners(self, points: ComplexArray) -> tuple[FloatArray, BoolArray]:
        """Solutions of the corners' two-link problems, both sides of each.

        Returns:
            (b, 16, 3) absolute angles of the three pieces at the corners: the first joint at its limits, the second at
            its limits, straight or folded, the third at its limits; and (b, 16) whether there is a solution.
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
        """Intervals of the last piece's angle between corners: (b, j) starts and widths, (b, 2, j) feasible elbows."""
        cuts = corners[..., 2] % math.tau
        if low is not None:
            cuts = np.concatenate([cuts, (low[:, None] + [0.0, width]) % math.tau], axis=1)
        cuts.sort(axis=1)
        widths = np.diff(cuts, axis=1, append=cuts[:, :1] + math.tau)
        middle = cuts + 0.5 * widths
        absolute, ok = self._with_last(points[:, None], middle)
        feasible = (self.keeps_limits(self.joints(absolute)) & ok[..., :1]).transpose(0, 2, 1)
        if low is not None:
            feasible &= (above(middle, low[:, None]) <= width)[:, None]
        return cuts, widths, feasible


def _both_elbows(
    l1: FloatArray | float, l2: FloatArray | float, points: ComplexArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(..., 2) absolute angles of two links that reach points, elbow to either side, and whether they are solutions.

    A straight or folded elbow is one configuration, not two.
    """
    distance = modulus(points)
    product = np.maximum(2.0 * l1 * l2, 1e-300)
    squares, square = l1 * l1 + l2 * l2, distance * distance
    cos = (square - squares) / product
    # Rounding of the last digit would bend a straight elbow by 1e-8; nearer than that it is straight, or folded.
    cos = np.where(np.abs(cos) >= 1.0 - 1e-15 * (square + squares) / product, np.copysign(1.0, cos), cos)
    bend = arccos(cos)
    half = arctan2(l2 * np.sin(bend), l1 + l2 * cos)
    # A point this far out of reach is reached by a straight or folded arm [m].
    reach_tolerance = 1e-10
    ok = (distance <= l1 + l2 + reach_tolerance) & (distance >= np.abs(l1 - l2) - reach_tolerance)
    first = argument(points)[..., None] - _SIDES * half[..., None]
    return first, first + _SIDES * bend[..., None], np.stack([ok, ok & (bend > 0.0) & (bend < np.pi)], axis=-1)


def _merged(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Intervals (low, width) of angles as few intervals (low, high), from low in (-pi, pi] on."""
    merged: list[list[float]] = []
    for low, width in sorted(((np.pi - (np.pi - low) % math.tau, width) for low, width in spans)):
        if merged and low <= merged[-1][1] + WINDOW_TOLERANCE:
            merged[-1][1] = max(merged[-1][1], low + width)
        else:
            merged.append([low, low + width])
    # The last may run on into the first.
    while len(merged) > 1 and merged[-1][1] >= merged[0][0] + math.tau - WINDOW_TOLERANCE:
        first = merged.pop(0)
        merged[-1][1] = max(merged[-1][1], first[1] + math.tau)
    return [(float(low), float(min(high, low + math.tau))) for low, high in merged]
