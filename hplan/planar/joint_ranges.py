"""Joint ranges left free by turret and neighbouring links.

The ranges are intervals around the start. A contact between a turning turret shape and an obstacle, or the pedestal,
depends on the yaw alone. A contact between neighbouring links that fold into each other, or between the first link and
its support, depends on the joint between them alone. A motion is continuous, so each of these coordinates stays in the
free interval that holds its start value. The planner treats the intervals as narrower joint limits. A goal in another
interval is proved unreachable, independently of the grid.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.collision.coal_scene import CoalScene, Contact
from hplan.planar.family_reader import family_of
from hplan.planning.joint_ranges import ROUNDING, JointRanges, Wall


def joint_ranges(scene: CoalScene, q: FloatArray, margin: float) -> JointRanges:
    """Return the intervals in which the joints can move from a configuration.

    Args:
        scene: The arm among obstacles, built with the tracking error and the required clearance.
        q: (dof,) configuration with more clearance than `margin` beyond the required one.
        margin: Clearance of the intervals beyond the required one [m].
    """
    robot = scene.robot
    lower, upper = robot.lower.copy(), robot.upper.copy()
    walls: list[Wall] = []
    for turn in _turns_that_decide(scene):
        joint = turn.joint
        for end in (lower, upper):
            end[joint], contact = _known_free(scene, turn, q, float(end[joint]), margin)
            if contact is not None:
                walls.append(Wall(joint, float(end[joint]), end is upper, contact))
    return JointRanges(frozen(lower), frozen(upper), tuple(walls))


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
    # The search trees handle the obstacles of the first link.
    one[: len(scene.link_shapes)] &= [
        family_of(scene.robot).has_yaw and shape.parentJoint == 1 for shape in scene.link_shapes
    ]
    for joint in np.flatnonzero(counts[one].any(axis=0)).tolist():
        pairs = np.flatnonzero((one & (counts[:, joint] > 0.0))[decided])
        if len(pairs):
            yield _Turn(joint, pairs, np.maximum(reaches[decided[pairs], joint], ROUNDING))


#: Cache of interval ends by joint, joint value, end of the range and margin; every grasp of a fruit needs them.
_CACHED_ENDS: WeakKeyDictionary[CoalScene, dict[tuple[int, float, float, float], tuple[float, Contact | None]]] = (
    WeakKeyDictionary()
)


def _known_free(
    scene: CoalScene, turn: _Turn, q: FloatArray, end: float, margin: float
) -> tuple[float, Contact | None]:
    """Cached `_free`; the result depends on this joint's value alone."""
    known, key = _CACHED_ENDS.get(scene, {}), (turn.joint, float(q[turn.joint]), end, margin)
    if key not in known:
        # Replace tables instead of changing them: another thread may be reading the old one.
        known = _CACHED_ENDS[scene] = {**known, key: _free(scene, turn, q, end, margin)}
    return known[key]


def _free(scene: CoalScene, turn: _Turn, q: FloatArray, end: float, margin: float) -> tuple[float, Contact | None]:
    """Joint value reachable towards a range end, and the blocking contact.

    Conservative advancement with separate steps for each pair: a turn by an angle brings no pair closer by more than
    angle * radius, so a pair with distance d to spare needs no new distance query before a turn by d / radius. If the
    joint reaches the end of its range, the contact is missing (None).
    """
    pairs, joint = turn.pairs, turn.joint
    kept = np.broadcast_to(scene.required_distance(scene.clearance), len(scene.pairs))[pairs]
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
