r"""Permitted depths of parts of limbs, with the neighbours that they are pushed against.

A link pushes a part by :math:`\delta \le d (1 - l |u \cdot s|)` along u (`hplan.scene.limb_parts`) with the force f.
Neighbours stop the part, and all that it carries along, behind gaps :math:`g_i` with the forces :math:`N_i \ge 0` along
:math:`n_i`. Let :math:`\langle a, b \rangle` be the displacement along a by a unit force along b. The limb is displaced
by :math:`p = f u - \sum N_i n_i`, where :math:`\langle u, p \rangle = \delta`, and
:math:`\langle n_i, p \rangle = g_i + z_i` if the neighbour is displaced by :math:`z_i`. With
:math:`\eta_i = \langle u, n_i \rangle / \langle u, u \rangle`,

.. math:: f = \delta / \langle u, u \rangle + \sum \eta_i N_i, \qquad
    \sum N_i (g_i + z_i - \eta_i \delta) = - \langle q, q \rangle \le 0, \qquad q = \sum N_i (n_i - \eta_i u) .

With k and r of `hplan.scene.limb_sweeps`, the first term is at most k d, :math:`\eta_i \delta \le r_i d`, and
:math:`\eta_i^2 \delta \le r_i^2 d`. Let gaps and displacements of neighbours be divided by :math:`r_i`, forces
multiplied by it, and stiffness :math:`k_i` by its square. Neighbours with :math:`z_i \ge N_i / k_i` then add at most
:math:`\max \sum N_i` over all

.. math:: N_i \ge 0, \qquad \sum N_i (N_i / k_i - a_i) \le 0, \qquad a_i = d - g_i .

If :math:`\delta` is smaller by a factor of t, all :math:`N_i` with the former constraint, divided by
:math:`\sqrt t`, keep this one, and their sum is the former :math:`\sum \eta_i N_i`. By Lagrange, for any A > 0,

.. math:: \sum N_i \le \sum k_i \max(0, A + a_i)^2 / (4 A) .

So one neighbour adds k (d - g), and is displaced by at most d - g. Several add more than the sum of that, since one may
deflect the limb towards another. As :math:`\langle q, q \rangle \le S / 4` with
:math:`S = \sum k_i \max(0, a_i)^2`, a limb that is softer by a factor of e displaces nothing by more than
:math:`r_i \sqrt{d^2 + e S / (4 k)}`. Rigid neighbours are not touched; others are displaced no farther than
`hplan.scene.neighbour_rooms` allows.

Each contact counts as if it was with a neighbour of its own: contacts with one neighbour are on one side of it, where
none increases the force of another one. Limbs that touch at rest, except at the pushed part, have grown together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.scene.limb_parts import TINY, PermittedContacts, Pushables, depth_and_extension
from hplan.scene.limb_sweeps import carried_along
from hplan.scene.limbs import Limbs
from hplan.scene.neighbours import Neighbours, find_neighbours
from hplan.scene.obstacle_kind import Solid
from hplan.scene.wood import LEAST_DEPTH_M, STATIC_SHARE, Wood, limits_by_segment

#: Distance per displacement within which neighbours are sought: they deflect each other's limbs sideways.
FARTHEST: Final = 1.5

#: Allowed for rounding in sums.
_ROUNDING: Final = 1e-9

#: Number of halvings in the search for a depth.
_HALVINGS: Final = 24


class LimbNeighbours(NamedTuple):
    """Parts of limbs, the items that they carry along, and the neighbours of these.

    Attributes:
        depth: (k,) maximum depth of each part without neighbours [m].
        extension: (k,) extension of its axis per depth.
        stiffness: (k,) its force per depth without neighbours [N/m].
        near: (n,) neighbours of all parts, and of all fruit on limbs; `pushable` is the number of one of these.
        by_segment: (n,) limb segment of that part; -1 for fruit.
        by_fruit: (n,) number of that fruit; -1 for parts.
        part: (m,) part that is pushed, in ascending order.
        at: (m,) place among the neighbours of one that something carried along may be pressed against.
        ratio: (m,) displacement of that per deflection of the part.
    """

    depth: FloatArray
    extension: FloatArray
    stiffness: FloatArray
    near: Neighbours
    by_segment: IntArray
    by_fruit: IntArray
    part: IntArray
    at: IntArray
    ratio: FloatArray

    def as_met(self, near: Neighbours) -> Neighbours:
        """(m,) neighbours as the parts meet them, by `near` or the same ones with other rooms."""
        found, ratio = near.at(self.at), self.ratio
        return found._replace(
            pushable=self.part, gap=found.gap / ratio, stiffness=found.stiffness * ratio**2,
            depth=found.depth / ratio, most_force=found.most_force / ratio,
        )  # fmt: skip


def limb_neighbours(
    parts: Pushables, limbs: Limbs, hanging: Pushables, stiff: Sequence[Solid], wood: Wood
) -> LimbNeighbours:
    """Neighbours of parts of limbs, and of everything that these carry along.

    Args:
        parts: Parts of limbs.
        limbs: All limbs.
        hanging: All fruit that hang from them.
        stiff: Solids of all other obstacles.
        wood: Limits and properties.
    """
    whole, lengths = depth_and_extension(parts)
    depth = np.clip(whole, 0.0, parts.depth)
    stiffness, sets, found = parts.force / np.maximum(whole, TINY), list[Neighbours](), list[tuple[Any, ...]]()
    for items in (parts, hanging):
        carried = carried_along(parts, stiffness, items, limbs, wood)
        moved, reach = FARTHEST * carried.ratio * depth[carried.pushed], np.zeros(len(items.names))
        np.maximum.at(reach, carried.item, moved)
        near = find_neighbours(items, reach, limbs, hanging, stiff, wood)
        near = near.at(np.argsort(near.pushable, kind="stable"))
        first, last = (np.searchsorted(near.pushable, carried.item, side=side) for side in ("left", "right"))
        pair = np.repeat(np.arange(len(moved)), last - first)
        at = np.arange(len(pair)) - np.repeat(np.cumsum(last - first) - (last - first), last - first) + first[pair]
        is_fruit, number = items.mass[near.pushable] > 0.0, near.pushable
        have_grown_together = (near.gap <= 0.0) & ~is_fruit & (near.fruit < 0) & (near.segment >= 0)
        is_own = ~is_fruit[at] & (carried.pushed[pair] == carried.item[pair])
        kept = (near.gap[at] < moved[pair]) & (is_own | ~have_grown_together[at])
        pair, at = pair[kept], at[kept] + sum(len(each.gap) for each in sets)
        by = np.where(is_fruit, -1, items.segment[number]), np.where(is_fruit, number, -1)
        found.append((*by, carried.pushed[pair], at, carried.ratio[pair]))
        sets.append(near)
    by_segment, by_fruit, part, at, ratio = (np.concatenate(columns) for columns in zip(*found, strict=True))
    order = np.argsort(part, kind="stable")
    extension = np.divide(lengths, whole, out=np.zeros(len(whole)), where=whole > 0.0)
    return LimbNeighbours(
        depth, extension, stiffness, Neighbours.join(sets), by_segment, by_fruit,
        part[order], at[order], ratio[order],
    )  # fmt: skip


def permitted_limb_contacts(
    parts: Pushables, found: LimbNeighbours, near: Neighbours, behind: Mapping[int, Neighbours],
    limbs: Limbs, hanging: Pushables, wood: Wood,
) -> PermittedContacts:  # fmt: skip
    """Depths within the limits of force and stress, with the neighbours that are pushed as well.

    Args:
        parts: Parts of limbs.
        found: Result of `limb_neighbours`.
        near: Its neighbours with the rooms that `hplan.scene.neighbour_rooms` finds.
        behind: Obstacles that these may be pressed against, by their places.
        limbs: All limbs.
        hanging: All fruit that hang from them.
        wood: Limits and properties.
    """
    limits, count = limits_by_segment(limbs, wood), len(parts.names)
    alone = _LimbsAlone(
        found.depth, found.stiffness, STATIC_SHARE * limits.force[parts.segment],
        (limits.stiffest / limits.softest)[parts.segment],
    )  # fmt: skip
    met = found.as_met(near)
    depth = _deepest(alone, met)
    depth[depth < LEAST_DEPTH_M] = 0.0
    push, force = _push(alone, depth, met), alone.stiffness * depth
    roots, fruits = [frozenset[int]()] * count, [frozenset[str]()] * count
    reached = np.flatnonzero(push.displaced > 0.0)
    for row, places in met.at(reached).by_pushable():
        at = reached[places]
        moved = Neighbours.join([
            met.at(at), *(behind[place] for place in set(found.at[at].tolist()) & behind.keys())
        ])  # fmt: skip
        roots[row], fruits[row] = moved.limb_roots, moved.fruit_names(hanging)
    cores = parts.extended(found.extension * depth)
    return PermittedContacts(
        depth, cores, force + push.squeezed, push.squeezed, force * parts.stress, roots, fruits
    )  # fmt: skip


class _LimbsAlone(NamedTuple):
    """Parts of limbs as if they had no neighbours.

    Attributes:
        depth: (k,) maximum depth [m].
        stiffness: (k,) force per depth [N/m].
        limit: (k,) maximum force with neighbours [N].
        softening: (k,) ratio of the largest to the smallest Young's modulus.
    """

    depth: FloatArray
    stiffness: FloatArray
    limit: FloatArray
    softening: FloatArray


class _LimbPush(NamedTuple):
    """Parts of limbs that are pushed to some depths.

    Attributes:
        squeezed: (k,) upper bound of the force that neighbours add [N].
        displaced: (m,) upper bound of the displacement of each neighbour [m]; negative for those that are not touched.
        is_permitted: (k,) mask of the parts for which all limits hold.
    """

    squeezed: FloatArray
    displaced: FloatArray
    is_permitted: BoolArray


def _deepest(alone: _LimbsAlone, met: Neighbours) -> FloatArray:
    """(k,) largest depths within all limits [m]."""
    depth, largest = np.zeros(len(alone.depth)), alone.depth.copy()
    np.minimum.at(largest, met.pushable, met.gap + met.depth)
    tried = largest
    for _ in range(_HALVINGS):
        is_permitted = _push(alone, tried, met).is_permitted
        depth, largest = np.where(is_permitted, tried, depth), np.where(is_permitted, largest, tried)
        tried = 0.5 * (depth + largest)
    return depth


def _push(alone: _LimbsAlone, depth: FloatArray, met: Neighbours) -> _LimbPush:
    """Push all parts among their neighbours.

    Args:
        alone: The parts.
        depth: (k,) depths [m].
        met: The neighbours as the parts meet them.
    """
    of, count = met.pushable, len(depth)

    def in_all(values: FloatArray) -> FloatArray:
        return np.bincount(of, values, count).astype(np.float64)

    is_spring, ahead = np.isfinite(met.stiffness), depth[of] - met.gap
    spring = np.where(is_spring, met.stiffness, 0.0)
    square = spring * np.maximum(0.0, ahead) ** 2
    pressed = in_all(square)
    farthest = np.sqrt(depth**2 + 0.25 * alone.softening * pressed / np.maximum(alone.stiffness, TINY))
    displaced, is_only = farthest[of] - met.gap, is_spring & (pressed[of] - square <= _ROUNDING * pressed[of])
    displaced = np.where(is_only, np.minimum(displaced, np.maximum(0.0, ahead)), displaced)
    touched, squeezed = np.where(displaced > 0.0, spring, 0.0), np.full(count, np.inf)
    for chosen in (np.where(ahead < 0.0, 0.0, touched), touched):
        mean = np.sqrt(in_all(chosen * ahead**2) / np.maximum(in_all(chosen), TINY))
        force = in_all(touched * np.maximum(0.0, mean[of] + ahead) ** 2)
        squeezed = np.minimum(squeezed, force / np.maximum(4.0 * mean, TINY))
    is_permitted = (alone.stiffness * depth + squeezed <= alone.limit) & (farthest <= FARTHEST * alone.depth)
    is_permitted[of[displaced > met.depth]] = False
    return _LimbPush(squeezed, displaced, is_permitted)
