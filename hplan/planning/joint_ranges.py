"""Joint ranges left free by turret and neighbouring links.

The ranges are intervals around the start. A contact between a turning turret shape and an obstacle, or the pedestal,
depends on the yaw alone. A contact between neighbouring links that fold into each other, or between the first link and
its support, depends on the joint between them alone. A motion is continuous, so each of these coordinates stays in the
free interval that holds its start value. The planner treats the intervals as narrower joint limits. A goal in another
interval is proved unreachable, independently of the grid.
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

#: Maximum clearance of the intervals beyond the required one [m]; less if start or goal have less.
MARGIN: Final = 1e-3

#: A goal out of reach with `MARGIN` is checked again with this margin [m]; less cannot be certified.
LEAST_MARGIN: Final = 3e-5

#: A configuration beyond a wall by less than this counts as on it [rad].
_ROUNDING: Final = 1e-9


@dataclass(frozen=True)
class Wall:
    """One end of a joint's free interval, and the blocking contact.

    Attributes:
        joint: Number of the joint.
        angle: End of the free interval [rad].
        is_upper: True for the upper end.
        contact: The two bodies, and their distance beyond the required clearance [m].
    """

    joint: int
    angle: float
    is_upper: bool
    contact: Contact

    def is_before(self, q: FloatArray) -> bool:
        """True if a (dof,) configuration is beyond this wall."""
        value = float(q[self.joint])
        return value > self.angle + _ROUNDING if self.is_upper else value < self.angle - _ROUNDING


@dataclass(frozen=True, eq=False)
class JointRanges:
    """Free intervals of all joints around a configuration.

    Attributes:
        lower: (dof,) lower ends [rad].
        upper: (dof,) upper ends [rad].
        walls: Ends of the intervals that are narrower than the joint limits.
    """

    lower: FloatArray
    upper: FloatArray
    walls: tuple[Wall, ...]

    def hold(self, configurations: FloatArray) -> BoolArray:
        """(n,) mask of the (n, dof) configurations inside the intervals."""
        held = np.ones(len(configurations), dtype=np.bool_)
        for wall in self.walls:
            beyond = configurations[:, wall.joint] - wall.angle
            held &= (beyond if wall.is_upper else -beyond) <= _ROUNDING
        return held

    def wall_before(self, q: FloatArray) -> Wall | None:
        """First wall on the way to a configuration; None without one."""
        return next((wall for wall in reversed(self.walls) if wall.is_before(q)), None)


def joint_ranges(scene: CoalScene, q: FloatArray, margin: float = MARGIN) -> JointRanges:
    """Return the intervals in which the joints can move from a configuration.

    Args:
        scene: The arm among obstacles, built with the tracking error and the required clearance.
        q: (dof,) configuration with more clearance than `margin` beyond the required one.
        margin: Clearance of the intervals beyond the required one [m].
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
    """Return the free intervals around a start, with its goal inside.

    Args:
        scene: The arm among obstacles, built with the tracking error and the required clearance.
        start: (dof,) configuration.
        goal: (dof,) configuration.
        clearance: Clearance of both beyond the required one [m].

    Raises:
        NoPathError: A blocked joint separates the goal from the start; names the obstacle and the blocked angles.
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
    """Return the error that names the contact blocking a joint.

    The blocked range is from a wall to another angle.
    """
    low, high = sorted(np.degrees([wall.angle, other]).tolist())
    contact = wall.contact
    message = (
        f"no path exists: between start and goal, from {low:.4g} to {high:.4g} deg of joint "
        f"{scene.robot.joint_names[wall.joint]!r}, {contact.link!r} is in {contact.other} or closer than the "
        "required clearance, for all positions of the other joints"
    )
    blocker = {"obstacle": contact.obstacle, "link": contact.link, "cells": 0, "slices_deg": (low, high)}
    return NoPathError(message, reached_cells=0, blockers=[blocker])


class _Turn(NamedTuple):
    """A joint, its (k,) pairs, and their motion-bound coefficients.

    The joint alone determines the distances of these pairs.
    """

    joint: int
    pairs: IntArray
    radii: FloatArray


def _turns_that_decide(scene: CoalScene) -> Iterator[_Turn]:
    """Yield the joints that alone determine some pairs.

    These are pairs of the turret with obstacles, and self-collision pairs.
    """
    _, counts = scene.parts.movers
    (_, reaches), alone = scene.parts.reaches(), len(scene.parts.shapes)
    decided = np.repeat(np.arange(len(counts)), np.repeat([scene.own_first, 1], [alone, len(counts) - alone]))
    one = counts.sum(axis=1) == 1.0
    one[: len(scene.link_shapes)] = False  # the search trees handle obstacles of the first link
    for joint in np.flatnonzero(counts[one].any(axis=0)).tolist():
        pairs = np.flatnonzero((one & (counts[:, joint] > 0.0))[decided])
        if len(pairs):
            yield _Turn(joint, pairs, np.maximum(reaches[decided[pairs], joint], _ROUNDING))


#: Cache of interval ends by joint, joint value, end of the range and margin; every grasp of a fruit needs them.
_KNOWN: WeakKeyDictionary[CoalScene, dict[tuple[int, float, float, float], tuple[float, Contact | None]]] = (
    WeakKeyDictionary()
)


def _known_free(
    scene: CoalScene, turn: _Turn, q: FloatArray, end: float, margin: float
) -> tuple[float, Contact | None]:
    """Cached `_free`; the result depends on this joint's value alone."""
    known, key = _KNOWN.get(scene, {}), (turn.joint, float(q[turn.joint]), end, margin)
    if key not in known:
        # Replace tables instead of changing them: another thread may be reading the old one.
        known = _KNOWN[scene] = {**known, key: _free(scene, turn, q, end, margin)}
    return known[key]


def _free(scene: CoalScene, turn: _Turn, q: FloatArray, end: float, margin: float) -> tuple[float, Contact | None]:
    """Joint value reachable towards a range end, and the blocking contact.

    Conservative advancement with separate steps for each pair: a turn by an angle brings no pair closer by more than
    angle * radius, so a pair with distance d to spare needs no new distance query before a turn by d / radius. If the
    joint reaches the end of its range, the contact is missing (None).
    """
    pairs, joint = turn.pairs, turn.joint
    kept = np.broadcast_to(scene.kept(scene.clearance), len(scene.pairs))[pairs]
    kept = kept + scene.deviation * turn.radii + margin
    at, length, direction = q.copy(), abs(end - float(q[joint])), 1.0 if end >= q[joint] else -1.0
    turned, due = 0.0, np.zeros(len(pairs))
    # The interval ends when the remaining clearance is below this fraction of its margin.
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
