r"""Time window of contact with the goal fruit: straight approach and retreat.

The goal fruit is an obstacle for every link at all times, with one exception: the last link, in one contiguous time
window around the instant when the tool is at the fruit's centre, or nearest to it and within the fruit's
`grasp_offset`. In this window

- the tool keeps within `OFFSET` of the half-line that starts at its position at that instant, :math:`p^*`, and runs
  backward along the last link, :math:`\{p^* - x u^* : x \ge 0\}`: it moves straight along the link, and no deeper;
- the last link keeps its direction within `TURN`.

The link then touches the fruit with its tip only, from first contact to the grasp and back. Outside the window, and for
every other link inside it, clearance from the fruit is certified as from any obstacle. A fruit with a track may be
touched only once it rests relative to the base.

The link's direction is the tool axis (`hplan.robot.model.Robot.tool_axis`), and the link may rotate about it. The last
link is the body carried by the joint of the tool frame.

The window consists of whole cubics of the motion, and the two conditions hold at all times within each. The tool's path
leaves the chord between two samples :math:`h` apart by at most :math:`h^2 / 8 \max |\ddot p|`, and the points within a
distance of a half-line are a convex set: if both samples are within `OFFSET` minus that value, the path between them is
within `OFFSET`. The direction :math:`u` leaves its chord by at most :math:`h^2 / 8 \max |\ddot u|`. With :math:`r_j`
the tool's maximum distance from the axis of joint j (`hplan.collision.motion_coefficients`; 1 for a prismatic joint),
and joints counted from the base,

.. math::
    |\ddot p| \le \sum_j r_j |\ddot q_j| + \sum_{j \text{ turns}} |\dot q_j| \Bigl(r_j |\dot q_j|
        + 2 \sum_{k > j} r_k |\dot q_k|\Bigr), \quad
    |\ddot u| \le \sum_{j \text{ turns}} |\ddot q_j| + \Bigl(\sum_{j \text{ turns}} |\dot q_j|\Bigr)^2.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray
from hplan.collision.motion_coefficients import carriers, joint_axis, points_reach
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.trajectory.trajectory import SAME_TIME

#: Within this distance of its target point the tool counts as arrived [m].
THERE = 1e-3

#: Maximum speed that counts as rest [rad/s; m/s for prismatic joints].
REST = 1e-6

#: Maximum distance of the tool from its approach line [m], and maximum change of the last link's direction [rad].
OFFSET, TURN = 5e-3, np.radians(2.0)


@dataclass(frozen=True)
class FruitContact:
    """A time window in which the last link may touch a fruit.

    Attributes:
        fruit: The fruit as it was when contact was allowed; a different fruit with the same name is an obstacle.
        begin_s: Start of the window [s].
        end_s: End of the window [s].
    """

    fruit: Fruit
    begin_s: float
    end_s: float

    @property
    def span_s(self) -> tuple[float, float]:
        """Start and end of the window [s]."""
        return self.begin_s, self.end_s

    def starting_at(self, time_s: float) -> FruitContact:
        """The window with times from `time_s` on, those of the fruit's track included [s]."""
        track = self.fruit.track
        fruit = self.fruit if track is None else self.fruit.copy_unchecked({"track": track.starting_at(time_s)})
        return FruitContact(fruit, max(self.begin_s - time_s, 0.0), self.end_s - time_s)

    def covers(self, other: FruitContact) -> bool:
        """True if this contact allows everything that another one allows."""
        same = self.is_with([other.fruit])
        begins, ends = self.begin_s <= other.begin_s + SAME_TIME, other.end_s <= self.end_s + SAME_TIME
        return same and begins and ends

    def is_with(self, fruits: Iterable[Fruit]) -> bool:
        """True if the fruit is one of some fruits, equal in every value; times of tracks may differ by rounding."""
        track = self.fruit.track
        for fruit in fruits:
            if track is None or fruit.track is None:
                if self.fruit == fruit:
                    return True
            elif len(track.times_s) == len(fruit.track.times_s):
                off_s = np.abs(np.subtract(track.times_s, fruit.track.times_s)).max()
                moved = fruit.track.copy_unchecked({"times_s": track.times_s})
                if off_s <= 1e3 * SAME_TIME and self.fruit == fruit.copy_unchecked({"track": moved}):
                    return True
        return False

    def pieces(self, clock: FloatArray) -> slice | None:
        """Range of a motion's segments within the window; None if empty.

        Args:
            clock: (n,) times of the motion's samples [s].
        """
        begins, ends = (clock, clock) if len(clock) == 1 else (clock[:-1], clock[1:])
        inside = np.flatnonzero((begins >= self.begin_s - SAME_TIME) & (ends <= self.end_s + SAME_TIME))
        return slice(int(inside[0]), int(inside[-1]) + 1) if len(inside) else None


def instant_at(robot: Robot, rows: FloatArray, point: ArrayLike) -> tuple[int, float]:
    """Sample with the tool nearest to a point, and the distance [m].

    Args:
        rows: (n, dof) configurations.
        point: (3,) in `base_link` [m].
    """
    away = np.linalg.norm(robot.tool_positions(rows) - np.asarray(point), axis=1)
    row = int(away.argmin())
    return row, float(away[row])


def arrival_distance(fruit: Fruit) -> float:
    """Maximum distance of the tool from a fruit's centre at the grasp [m]."""
    return THERE + fruit.grasp_offset


def contact_window(robot: Robot, bezier: FloatArray, point: ArrayLike, within: float = THERE) -> slice | None:
    """Segments in which the last link may touch the fruit.

    Args:
        bezier: (pieces, 4 or 6, dof) Bezier points of the motion's segments.
        point: (3,) the fruit's centre, in `base_link` [m].
        within: Maximum distance of the tool from the point [m].

    Returns:
        A range of segments; None if the tool never reaches the point, or not on a straight approach.
    """
    rows = np.vstack([bezier[:, 0], bezier[-1:, -1]])
    with np.errstate(over="ignore", invalid="ignore"):
        row, away = instant_at(robot, rows, point)
        if not away <= within:
            return None
        straight = _is_straight(robot, bezier, rows, row)
    bent_before, bent_after = np.flatnonzero(~straight[:row]), np.flatnonzero(~straight[row:])
    first = int(bent_before[-1]) + 1 if len(bent_before) else 0
    last = row + int(bent_after[0]) if len(bent_after) else len(straight)
    return slice(first, last) if first < last else None


def _is_straight(robot: Robot, bezier: FloatArray, rows: FloatArray, row: int) -> BoolArray:
    """(pieces,) mask of the segments that keep the approach line and direction.

    Line and direction are taken from the tool and the last link at sample `row`.
    """
    poses = robot.forward_kinematics(rows)
    tool, along = poses[:, :3, 3], poses[:, :3, :3] @ robot.tool_axis
    bent, turned = tool_bends(robot, *largest_rates(bezier))
    off, lean = _off_line(tool, row, along[row]), np.linalg.norm(along - along[row], axis=1)
    kept: BoolArray = np.maximum(off[:-1], off[1:]) + bent / 8.0 <= OFFSET
    kept &= np.maximum(lean[:-1], lean[1:]) + turned / 8.0 <= 2.0 * np.sin(0.5 * TURN)
    return kept


def _off_line(tool: FloatArray, row: int, direction: FloatArray) -> FloatArray:
    """(n,) distances of tool positions from the backward half-line [m].

    The half-line starts at the position of sample `row`; `tool` is (n, 3).
    """
    from_there = tool - tool[row]
    behind = np.maximum(-(from_there @ direction), 0.0)
    off: FloatArray = np.linalg.norm(from_there + behind[:, None] * direction, axis=1)
    return off


def tool_bends(robot: Robot, rates: FloatArray, pushes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(pieces,) bounds of the second derivatives of tool position and direction.

    The direction is any unit vector fixed in the tool. `rates` and `pushes` bound the first and second derivatives of
    the joint values.
    """
    place = robot.model.frames[robot.frame_number(robot.tool_frame)].placement.translation[None]
    reach = points_reach(robot, place, robot.tool_joint - 1)
    bent, turn, turn_push = (np.zeros(len(rates)) for _ in range(3))
    beyond = np.zeros(len(rates))  # Sum of r |q'| of the outer joints.
    for joint in carriers(robot, robot.tool_joint - 1):
        rate, push = rates[:, joint], pushes[:, joint]
        bent += reach[joint] * push
        if not joint_axis(robot, joint)[1]:
            bent += rate * (reach[joint] * rate + 2.0 * beyond)
            turn, turn_push = turn + rate, turn_push + push
        beyond = beyond + reach[joint] * rate
    return bent, turn_push + turn * turn


def largest_rates(bezier: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(pieces, n) maximum first and second derivatives of Bezier segments.

    The derivatives are with respect to the segment's own parameter; the Bezier points bound them.
    """
    degree = bezier.shape[1] - 1.0
    rates, pushes = (np.abs(np.diff(bezier, order, axis=1)).max(axis=1) for order in (1, 2))
    return degree * rates, degree * (degree - 1.0) * pushes
