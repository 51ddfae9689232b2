r"""The straight approach: the tool moves to its goal along the last link's own direction, which does not turn.

The yaw stands still, and so does the direction u of the last link; the last free joint, the wrist, then moves on a
straight line with it. Two joints carry the wrist. With t the distance of the tool from its goal, their inverse
kinematics (`hplan.kinematics.planar_chain`) for the wrist at :math:`p(t) = p(0) - t u` gives the path. With :math:`l_1,
l_2` their lengths, :math:`\alpha_1, \alpha_2` their absolute angles, :math:`u_1, u_2` their directions and :math:`e =
\alpha_2 - \alpha_1`, differentiating :math:`l_1 u_1 + l_2 u_2 = p(t)` once and twice gives

.. math::
    \alpha_1' &= \frac{p' \cdot u_2}{l_1 \sin e}, &
    \alpha_1'' &= \frac{l_1 \alpha_1'^2 \cos e + l_2 \alpha_2'^2}{l_1 \sin e}, \\
    \alpha_2' &= -\frac{p' \cdot u_1}{l_2 \sin e}, &
    \alpha_2'' &= -\frac{l_1 \alpha_1'^2 + l_2 \alpha_2'^2 \cos e}{l_2 \sin e}.

They are exact and finite as long as the elbow keeps away from straight and folded, which is asked for. A joint comes
to one of its limits where the wrist crosses a circle, and so does the elbow to what it keeps away from; between
these at most 16 distances, each a root of a quadratic, everything is kept or not throughout. So the largest stand-off
is exact too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, ComplexArray, FloatArray, Record, frozen
from hplan.base.elementary import argument, modulus, product
from hplan.base.polyline import curve_length
from hplan.errors import ApproachError, InputError, OptionError
from hplan.kinematics.planar_chain import locked_mask, two_links
from hplan.kinematics.straight_line import StraightApproach
from hplan.robot.model import Robot

#: The elbow keeps this angle from straight and from folded [rad]; there, joint speeds pass all bounds.
STRAIGHT = np.radians(1.0)

#: A joint may be beyond its limit by rounding [rad].
ROUNDING = 1e-10


@dataclass(frozen=True, eq=False)
class Standoffs(Record):
    """Beginnings of straight approaches.

    Attributes:
        configurations: (k, dof) the configurations at the stand-off, or as far towards it as is possible.
        feasible: (k,) True if the whole stretch from there to the goal is possible.
        largest: (k,) largest stand-off possible, at most the one asked for [m].
    """

    configurations: FloatArray
    feasible: BoolArray
    largest: FloatArray


class ApproachPath(StraightApproach):
    """The straight path from the stand-off to the goal along the last link's direction.

    Of the free joints in the plane the first two and the last move.
    """

    @cached_property
    def length(self) -> float:
        """Joint-space length, by Gauss-Legendre quadrature."""
        # Denser towards both ends, where the elbow may be nearly straight.
        panels = 0.5 * self.standoff * (1.0 - np.cos(np.linspace(0.0, np.pi, 17)))

        def speed(t: FloatArray) -> FloatArray:
            rates = self._stretch.joints(t.reshape(1, -1), 1)[0]
            speeds: FloatArray = np.linalg.norm(rates, axis=-1).reshape(t.shape)
            return speeds

        return curve_length(speed, panels)

    @cached_property
    def breaks(self) -> FloatArray:
        """(2,) the ends of the parameter; the path is one piece."""
        return frozen(np.array([0.0, self.end]))

    def joints_at(self, distance: FloatArray, derivative: int) -> FloatArray:
        """(..., dof) configurations at (...) distances from the goal [m], or derivatives with respect to these."""
        moved = self._stretch.joints(distance.reshape(1, -1), derivative)[0].reshape(*distance.shape, -1)
        q = np.broadcast_to(self.goal if derivative == 0 else 0.0, (*distance.shape, self.robot.dof)).copy()
        q[..., list(self._stretch.index)] += moved
        return q

    @cached_property
    def _stretch(self) -> Stretches:
        return Stretches.back_from(self.robot, self.goal[None], self.locked)


def standoffs(robot: Robot, candidates: ArrayLike, distance: float, *, locked: Sequence[str] = ()) -> Standoffs:
    """The beginnings of straight approaches to many goal configurations, and which of them are possible.

    Args:
        candidates: (k, dof) goal configurations.
        distance: Stand-off [m].

    Raises:
        InputError: Candidates of another shape, a joint that does not exist.
        OptionError: A distance that is not positive.
        ApproachError: Fewer than three joints that may move.
    """
    q = np.asarray(candidates, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != robot.dof:
        raise InputError(f"candidates: expected {robot.dof} joint values in each row, got the shape {q.shape}")
    if not (np.isfinite(distance) and distance > 0.0):
        raise OptionError("standoff", distance, "a positive number of metres")
    stretch = Stretches.back_from(robot, q, locked, standoff=distance)
    largest = stretch.largest(distance)
    configurations = stretch.configurations(q, largest[:, None])[:, 0]
    return Standoffs(frozen(configurations), frozen(largest >= distance), frozen(largest))


@dataclass(frozen=True, eq=False)
class Stretches:
    """Straight stretches back from k goals; distances from the goals are (k, m) arrays.

    Attributes:
        index: Indices of the three joints that move.
        signs: (3,) their senses.
        goal: (k, 3) their values at the goals.
        lower: (3,) their lower limits.
        upper: (3,) their upper limits.
        l1: (k, 1) distance from the first of them to the second [m].
        l2: (k, 1) distance from the second to the third, the wrist [m].
        wrist: (k, 1) the wrist at the goal, from the first joint, as horizontal + i upward [m].
        back: (k, 1) direction in which the wrist leaves the goal.
        side: (k, 1) +1 or -1, side of the elbow.
    """

    robot: Robot
    index: tuple[int, int, int]
    signs: FloatArray
    goal: FloatArray
    lower: FloatArray
    upper: FloatArray
    l1: FloatArray
    l2: FloatArray
    wrist: ComplexArray
    back: ComplexArray
    side: FloatArray

    @classmethod
    def back_from(cls, robot: Robot, q: FloatArray, locked: Sequence[str], *, standoff: float = 0.0) -> Stretches:
        """Stretches from (k, dof) configurations; `standoff` is for the error.

        Raises:
            InputError: A joint that does not exist.
            ApproachError: Fewer than three joints that may move.
        """
        free = np.flatnonzero(~locked_mask(robot, locked)[robot.arm_slice]).tolist()
        if len(free) < 3:
            names = ", ".join(robot.arm.joint_names[k] for k in free) or "none"
            detail = f"it takes three joints in the arm plane, and those that may move are {names}"
            raise ApproachError(standoff, "joints", detail, largest_standoff_m=0.0)
        moving = [free[0], free[1], free[-1]]
        shift = robot.dof - robot.arm.link_count
        index = [shift + k for k in moving]
        points = robot.arm.joint_points(q[:, shift:])
        plane: ComplexArray = points[..., 0] + 1j * points[..., 1]
        first, second, third = (plane[:, k, None] for k in moving)
        last = plane[:, -2, None] - plane[:, -1, None]
        turned = product(third - second, np.conj(second - first))
        return cls(
            robot=robot,
            index=(index[0], index[1], index[2]),
            signs=robot.arm.signs[moving],
            goal=q[:, index],
            lower=robot.lower[index],
            upper=robot.upper[index],
            l1=modulus(second - first),
            l2=modulus(third - second),
            wrist=third - first,
            back=last / modulus(last),
            side=np.where(turned.imag < 0.0, -1.0, 1.0),
        )

    @cached_property
    def _at_goal(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(k, 1) bearing of the wrist at the goals, and the angles of `two_links` there."""
        return two_links(self.l1, self.l2, self.wrist)[:3]

    @cached_property
    def _angles_at_goal(self) -> tuple[FloatArray, FloatArray]:
        """(k, 1) absolute angles of the two links at the goals."""
        bearing, half, bend = self._at_goal
        first = bearing - self.side * half
        return first, first + self.side * bend

    def configurations(self, goals: FloatArray, distance: FloatArray) -> FloatArray:
        """(k, m, dof) configurations at (k, m) distances from the (k, dof) goals, where these are possible [m]."""
        q = np.repeat(goals[:, None], distance.shape[1], axis=1)
        q[..., list(self.index)] += self.joints(distance, 0)
        within: FloatArray = np.minimum(np.maximum(q, self.robot.lower), self.robot.upper)
        return within

    def joints(self, distance: FloatArray, derivative: int) -> FloatArray:
        """(k, m, 3) the three joints' change from the goal, or their derivatives by distance; see the module's text."""
        first, second, _ = self._turns(distance)
        if derivative > 0:
            l1, l2, back = self.l1, self.l2, argument(self.back)
            a1, a2 = self._angles_at_goal[0] + first, self._angles_at_goal[1] + second
            sin, cos = np.sin(a2 - a1), np.cos(a2 - a1)
            first, second = np.cos(back - a2) / (l1 * sin), -np.cos(back - a1) / (l2 * sin)
            if derivative > 1:
                first, second = (
                    (l1 * first**2 * cos + l2 * second**2) / (l1 * sin),
                    -(l1 * first**2 + l2 * second**2 * cos) / (l2 * sin),
                )
        return self._changes(first, second)

    def _changes(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """(k, m, 3) of the three joints, from those of the two links' absolute angles."""
        return np.stack([first, second - first, -second], axis=-1) * self.signs

    def _turns(self, distance: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """(k, m) by how much the two links have turned since the goal, and whether the elbow keeps its bounds.

        It does where the wrist is in reach and the elbow keeps away from straight and folded.
        """
        wrist, (_, half_at_goal, bend_at_goal) = self.wrist + distance * self.back, self._at_goal
        _, half, bend, in_reach = two_links(self.l1, self.l2, wrist)
        # Seen from a point that is not on it, a straight line turns by less than half a turn.
        first = argument(product(wrist, np.conj(self.wrist))) - self.side * (half - half_at_goal)
        kept: BoolArray = in_reach & (bend >= STRAIGHT) & (bend <= np.pi - STRAIGHT)
        return first, first + self.side * (bend - bend_at_goal), kept

    def largest(self, distance: float) -> FloatArray:
        """(k,) the largest stand-offs possible, at most the given one."""
        cuts = np.empty((len(self.goal), self._crossings.shape[1] + 2))
        cuts[:, 0], cuts[:, -1] = 0.0, distance
        cuts[:, 1:-1] = np.sort(np.minimum(np.maximum(self._crossings, 0.0), distance), axis=1)
        middle = 0.5 * (cuts[:, :-1] + cuts[:, 1:])
        first, second, kept = self._turns(middle)
        q = self.goal[:, None] + self._changes(first, second)
        kept &= ((q >= self.lower - ROUNDING) & (q <= self.upper + ROUNDING)).all(axis=-1)
        broken = ~kept & (np.diff(cuts, axis=1) > 0.0)
        reached: FloatArray = np.where(
            broken.any(axis=1), np.take_along_axis(cuts, broken.argmax(axis=1)[:, None], axis=1)[:, 0], distance
        )
        return reached

    @cached_property
    def _crossings(self) -> FloatArray:
        """(k, 16) distances at which some joint may come to a limit or the elbow to its bounds; 0 where never."""
        l1, l2, goal = self.l1, self.l2, self.goal[:, :, None]
        first, second = self._angles_at_goal
        # (k, 3, 2) turns of the joints, in the links' sense, that bring them to their limits.
        left = self.signs[:, None] * (np.stack([self.lower, self.upper], axis=1) - goal)
        bends = np.concatenate(
            [second - first + left[:, 1], np.broadcast_to([STRAIGHT, np.pi - STRAIGHT], (len(goal), 2))],
            axis=1,
        )
        center = np.concatenate(
            [l1 * np.exp(1j * (first + left[:, 0])), np.zeros_like(bends), l2 * np.exp(1j * (second - left[:, 2]))],
            axis=1,
        )
        shape = (len(goal), 2)
        squared = np.concatenate(
            [
                np.broadcast_to(l2**2, shape),
                l1**2 + l2**2 + 2.0 * l1 * l2 * np.cos(bends),
                np.broadcast_to(l1**2, shape),
            ],
            axis=1,
        )
        # |wrist + t back - center|^2 = squared
        apart = self.wrist - center
        half = product(apart, np.conj(self.back)).real
        under = half**2 - modulus(apart) ** 2 + squared
        root = np.sqrt(np.maximum(under, 0.0))
        return np.where(np.tile(under >= 0.0, 2), np.concatenate([-half - root, -half + root], axis=1), 0.0)
