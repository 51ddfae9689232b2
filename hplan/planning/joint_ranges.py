"""Ranges of joints that turret and neighbouring links leave free: intervals about the start.

A contact of a turning shape of the turret with an obstacle, or with the pedestal, depends on the yaw alone; one of
neighbours that fold into each other, or of the first link and what carries it, on the joint between them. A motion is
continuous, so each of these coordinates stays in the free interval in which it begins. The planner knows that as
narrower joint limits. A goal in another interval cannot be reached by any motion: that is shown, not a matter of the
grid.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from hplan.base import ties
from hplan.base.arrays import BoolArray, FloatArray, IntArray, frozen
from hplan.collision.coal_scene import CoalScene, Contact
from hplan.errors import NoPathError

#: Clearance that intervals leave beyond the one to keep, at most [m]; less where start or goal have less.
MARGIN: Final = 1e-3

#: Where a goal is out of reach with the margin, it is so with this one [m]: less cannot be certified.
LEAST_MARGIN: Final = 3e-5

#: A configuration that is beyond a wall by less than this is at it [rad].
_ROUNDING: Final = 1e-9


@dataclass(frozen=True)
class Wall:
    """One end of the free interval of a joint, and what blocks the joint there.

    Attributes:
        joint: Number of the joint.
        angle: Where the free interval ends [rad].
        is_upper: True if that is its upper end.
        contact: The two bodies, and what they have there beyond the distance to keep [m].
    """

    joint: int
    angle: float
    is_upper: bool
    contact: Contact

    def is_before(self, q: FloatArray) -> bool:
        """True if a (dof,) configuration is beyond it."""
        value = float(q[self.joint])
        return value > self.angle + _ROUNDING if self.is_upper else value < self.angle - _ROUNDING


@dataclass(frozen=True, eq=False)
class JointRanges:
    """Free intervals of all joints about a configuration.

    Attributes:
        lower: (dof,) where they begin [rad].
        upper: (dof,) where they end [rad].
        walls: What bounds those that are narrower than the joint limits.
    """

    lower: FloatArray
    upper: FloatArray
    walls: tuple[Wall, ...]

    def hold(self, configurations: FloatArray) -> BoolArray:
        """(n,) True for those of (n, dof) configurations that are in the intervals."""
        held = np.ones(len(configurations), dtype=np.bool_)
        for wall in self.walls:
            beyond = configurations[:, wall.joint] - wall.angle
            held &= (beyond if wall.is_upper else -beyond) <= _ROUNDING
        return held

    def wall_before(self, q: FloatArray) -> Wall | None:
        """The wall that a motion to a (dof,) configuration meets first; None where that is in the intervals."""
        return next((wall for wall in reversed(self.walls) if wall.is_before(q)), None)


def joint_ranges(scene: CoalScene, q: FloatArray, margin: float = MARGIN) -> JointRanges:
    """The intervals in which joints can move from a configuration.

    Args:
        scene: The arm among obstacles, made for the tracking error and the clearance to keep.
        q: (dof,) a configuration with more clearance than `margin` beyond the one to keep.
        margin: Clearance to leave beyond the one to keep [m].
    """
    robot = scene.robot
    lower, upper = robot.lower.copy(), robot.upper.copy()
    walls: list[Wall] = []
    if robot.planar is None:
        return JointRanges(frozen(lower), frozen(upper), ())
    for turn in _turns_that_decide(scene):
        joint = turn.joint
        for end in (lower, upper):
            end[joint], contact = _known_free(scene, turn, q, float(end[joint]), margin)
            if contact is not None:
                walls.append(Wall(joint, float(end[joint]), end is upper, contact))
    return JointRanges(frozen(lower), frozen(upper), tuple(walls))


def narrowed(scene: CoalScene, start: FloatArray, goal: FloatArray, clearance: float) -> JointRanges:
    """The intervals about a start, its goal among them.

    Args:
        scene: The arm among obstacles, made for the tracking error and the clearance to keep.
        start: (dof,) configuration.
        goal: (dof,) configuration.
        clearance: Clearance of both beyond the one to keep [m].

    Raises:
        NoPathError: The goal is beyond what no motion passes; names it, and the angles that are blocked.
    """
    ranges = joint_ranges(scene, start, min(MARGIN, 0.5 * clearance))
    if ranges.wall_before(goal) is None:
        return ranges
    least = min(LEAST_MARGIN, 0.5 * clearance)
    ranges = joint_ranges(scene, start, least)
    wall = ranges.wall_before(goal)
    if wall is None:
        return ranges
    beyond = joint_ranges(scene, goal, least)
    other = beyond.lower if wall.is_upper else beyond.upper
    raise _no_path(scene, wall, float(other[wall.joint]))


def _no_path(scene: CoalScene, wall: Wall, other: float) -> NoPathError:
    """The error that names what blocks a joint from a wall to another angle."""
    low, high = sorted(np.degrees([wall.angle, other]).tolist())
    contact = wall.contact
    message = (
        f"no path exists: between start and goal, from {low:.4g} to {high:.4g} deg of joint "
        f"{scene.robot.joint_names[wall.joint]!r}, {contact.link!r} is in {contact.other}, or nearer than the "
        "clearance to keep, whatever the other joints do"
    )
    blocker = {"obstacle": contact.obstacle, "link": contact.link, "cells": 0, "slices_deg": (low, high)}
    return NoPathError(message, reached_cells=0, blockers=[blocker])


class _Turn(NamedTuple):
    """A joint, the (k,) numbers of the pairs that it alone decides, and by how much each comes nearer as it turns."""

    joint: int
    pairs: IntArray
    radii: FloatArray


def _turns_that_decide(scene: CoalScene) -> Iterator[_Turn]:
    """The joints that alone decide some pairs: of the turret with obstacles, and of parts of the arm."""
    _, counts = scene.parts.movers
    (_, reaches), alone = scene.parts.reaches(), len(scene.parts.shapes)
    decided = np.repeat(np.arange(len(counts)), np.repeat([scene.own_first, 1], [alone, len(counts) - alone]))
    one = counts.sum(axis=1) == 1.0
    one[: len(scene.link_shapes)] = False  # obstacles of the first link are the trees' matter
    for joint in np.flatnonzero(counts[one].any(axis=0)).tolist():
        pairs = np.flatnonzero((one & (counts[:, joint] > 0.0))[decided])
        if len(pairs):
            yield _Turn(joint, pairs, np.maximum(reaches[decided[pairs], joint], _ROUNDING))


#: Ends of free intervals that were found before, by joint, its value, end of the range and margin: every grasp of a
#: fruit asks.
_KNOWN: WeakKeyDictionary[CoalScene, dict[tuple[int, float, float, float], tuple[float, Contact | None]]] = (
    WeakKeyDictionary()
)


def _known_free(
    scene: CoalScene, turn: _Turn, q: FloatArray, end: float, margin: float
) -> tuple[float, Contact | None]:
    """As `_free`, which the joint alone decides."""
    known, key = _KNOWN.get(scene, {}), (turn.joint, float(q[turn.joint]), end, margin)
    if key not in known:
        # Tables are replaced and never changed: another thread may read the one before.
        known = _KNOWN[scene] = {**known, key: _free(scene, turn, q, end, margin)}
    return known[key]


def _free(scene: CoalScene, turn: _Turn, q: FloatArray, end: float, margin: float) -> tuple[float, Contact | None]:
    """The value up to which a joint can turn towards an end of its range, and what stops it before, if anything.

    Conservative advancement, each pair with steps of its own: none comes nearer by more than the turn times its radius,
    so the joint may turn by d / radius before a pair that is d apart, and more, is asked again.
    """
    pairs, joint = turn.pairs, turn.joint
    kept = np.broadcast_to(scene.kept(scene.clearance), len(scene.pairs))[pairs]
    kept = kept + scene.deviation * turn.radii + margin
    at, length, direction = q.copy(), abs(end - float(q[joint])), 1.0 if end >= q[joint] else -1.0
    turned, due = 0.0, np.zeros(len(pairs))
    # An interval ends where the clearance left is less than this fraction of its margin.
    enough = 0.1
    while True:
        asked = np.flatnonzero(due <= turned)
        at[joint] = q[joint] + direction * turned
        scene.place(at)
        left = scene.distances_of(pairs[asked]) - kept[asked]
        least = ties.argmin(left)
        if left[least] <= enough * margin:
            mover, obstacle = scene.pairs[int(pairs[asked[least]])]
            return float(at[joint]), scene.contact(mover, obstacle, float(left[least]))
        due[asked] = turned + left / turn.radii[asked]
        turned = float(due.min())
        if turned >= length:
            return end, None
