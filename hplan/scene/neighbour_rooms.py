r"""How far neighbours of pushed limbs and fruit may be displaced, with the obstacles behind them.

**Limbs.** A neighbour with the stiffness s at its contact that is displaced by z, and touches nothing else, takes the
force s z, and displaces a point of its limb by at most :math:`r z \sqrt{s / k}`, with r and k of
`hplan.scene.limb_sweeps` for the part at the contact. So it touches nothing else up to

.. math:: z = \sqrt{k / s} \; \min_i \; g_i / r_i

over everything next to its limb and what this carries along, except for what pushes it. Of the gap to another obstacle
that may yield only half counts: that may be displaced as well.

**Fruit.** A neighbour that is a fruit has the permitted depth of `hplan.scene.fruit_depths` in the direction of the
push, with everything next to it, except for what pushes it, rigid and at half of the gap if it may yield. Up to there
the force is at most in proportion to the displacement.

Only the straight segment or the fruit that pushes a neighbour does not stop it; other segments of the same limb do.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.scene.fruit_depths import FruitPush, FruitsAlone, deepest_push
from hplan.scene.limb_depths import FARTHEST, LimbNeighbours
from hplan.scene.limb_parts import Pushables
from hplan.scene.limbs import Limbs
from hplan.scene.neighbours import Neighbours
from hplan.scene.wood import LEAST_DEPTH_M

#: Share of the gap between two obstacles that both may yield.
_HALF: Final = 0.5

#: Places along a segment are numbers below 1 that are added to the number of the segment.
_WITHIN: Final = 0.999


class NeighbourRooms:
    """Finds the rooms of neighbours.

    Args:
        parts: Parts of limbs, sorted by segments and along these.
        limbs: All limbs.
        of_limbs: The neighbours of the parts.
        fruit: Hanging fruit as if they had no neighbours.
        of_fruit: Their neighbours.
    """

    def __init__(
        self, parts: Pushables, limbs: Limbs, of_limbs: LimbNeighbours, fruit: FruitsAlone, of_fruit: Neighbours
    ) -> None:
        self._length, self._of_limbs = limbs.length, of_limbs
        self._part = parts.segment + _WITHIN * parts.along[:, 0] / limbs.length[parts.segment]
        met = of_limbs.as_met(of_limbs.near)
        gap = _gap_if_rigid(met)
        order = np.lexsort([gap, met.pushable])
        self._next_to, self._gap = met.at(order), np.append(gap[order], np.inf)
        self._first = np.searchsorted(self._next_to.pushable, np.arange(len(parts.names) + 1))
        self._pendulums, self._pushes = fruit.pendulums, dict[tuple[int, bytes], FruitPush]()
        rigid = of_fruit._replace(gap=_gap_if_rigid(of_fruit), stiffness=np.full(len(of_fruit.gap), np.inf))
        self._next_to_fruit = {row: rigid.at(places) for row, places in rigid.by_pushable()}
        self._nothing = of_fruit.at(np.zeros(0, dtype=np.int64))

    def find(
        self, near: Neighbours, by_segment: IntArray, by_fruit: IntArray
    ) -> tuple[Neighbours, dict[int, Neighbours]]:
        """Neighbours as they yield with the obstacles behind them.

        Args:
            near: (n,) neighbours.
            by_segment: (n,) limb segment that pushes each; -1 for none.
            by_fruit: (n,) number of the fruit that pushes it; -1 for none.

        Returns:
            The neighbours, and the obstacles that fruit among them may be pressed against, by the places of these.
        """
        stiffness, room, behind = near.stiffness.copy(), near.depth.copy(), dict[int, Neighbours]()
        rows = np.flatnonzero((near.fruit < 0) & np.isfinite(near.stiffness))
        room[rows] = np.minimum(room[rows], self._rooms_of_limbs(near.at(rows), by_segment[rows], by_fruit[rows]))
        rows = np.flatnonzero(near.fruit >= 0)
        contacts, of_each = np.unique(
            np.stack([near.fruit[rows], by_segment[rows], by_fruit[rows]]), axis=1, return_inverse=True
        )
        order, ends = np.argsort(of_each.ravel(), kind="stable"), np.cumsum(np.bincount(of_each.ravel()))
        for contact, places in zip(contacts.T.tolist(), np.split(rows[order], ends[:-1]), strict=bool(len(rows))):
            push, pressed = self._push_of_fruit(*contact)
            directions, force = near.direction[places], self._pendulums[contact[0]].stiffness * push.depth
            depths = push.depth - np.max(push.corners @ directions.T, axis=0, initial=0.0)
            depths[(depths < LEAST_DEPTH_M) | ~directions.any(axis=1)] = 0.0
            room[places] = depths
            stiffness[places] = np.divide(force, depths, out=np.full(len(depths), np.inf), where=depths > 0.0)
            if len(pressed.gap):
                behind |= dict.fromkeys(places.tolist(), pressed)
        return near._replace(stiffness=stiffness, depth=room), behind

    def _rooms_of_limbs(self, near: Neighbours, by_segment: IntArray, by_fruit: IntArray) -> FloatArray:
        """(n,) deflections of limbs up to which they touch nothing else [m]."""
        place = near.segment + _WITHIN * near.along / self._length[near.segment]
        part = np.searchsorted(self._part, place, side="right") - 1
        at, last = self._first[part], self._first[part + 1]
        while True:
            left = np.flatnonzero(at < last)
            other = self._next_to.at(at[left])
            is_pusher = np.where(other.fruit >= 0, other.fruit == by_fruit[left], other.segment == by_segment[left])
            is_pusher &= np.isfinite(other.stiffness)
            if not is_pusher.any():
                break
            at[left[is_pusher]] += 1
        gap = np.where(at < last, self._gap[at], np.inf)
        known = _HALF * FARTHEST * self._of_limbs.depth[part]
        found: FloatArray = np.minimum(gap, known) * np.sqrt(self._of_limbs.stiffness[part] / near.stiffness)
        return found

    def _push_of_fruit(self, fruit: int, by_segment: int, by_fruit: int) -> tuple[FruitPush, Neighbours]:
        """Push of a fruit by a segment or another fruit, and the obstacles that it may be pressed against."""
        near = self._next_to_fruit.get(fruit, self._nothing)
        is_pusher = np.where(near.fruit >= 0, near.fruit == by_fruit, (near.segment == by_segment) & (by_segment >= 0))
        others, key = near.at(~is_pusher), (fruit, is_pusher.tobytes())
        if key not in self._pushes:
            self._pushes[key] = deepest_push(self._pendulums[fruit], others)
        push = self._pushes[key]
        return push, others.at(push.reached)


def _gap_if_rigid(near: Neighbours) -> FloatArray:
    """(n,) gaps with which neighbours count as rigid [m]."""
    return np.where(np.isfinite(near.stiffness), _HALF, 1.0) * near.gap
