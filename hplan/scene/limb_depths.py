r"""Permitted depths of parts of limbs, with the neighbours that they are pushed against.

A limb that is pushed against another one, or against anything else, bends that as well: behind a gap g,
a neighbour with the compliance :math:`c_2` adds :math:`(\delta - g) / c_2`, and a rigid one stops it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.scene.limb_parts import PermittedContacts, Pushables, depth_and_extension
from hplan.scene.limb_sweeps import carried_along, largest_stiffness
from hplan.scene.limbs import Limbs
from hplan.scene.neighbours import Neighbours, find_neighbours
from hplan.scene.obstacle_kind import Solid
from hplan.scene.wood import LEAST_DEPTH_M, STATIC_SHARE, Wood, limits_by_segment


def permitted_limb_contacts(
    pushables: Pushables, limbs: Limbs, hanging: Pushables, stiff: Sequence[Solid], wood: Wood
) -> PermittedContacts:
    """Depths within the limits of force and stress, with the neighbours that are pushed as well.

    Args:
        pushables: Parts of limbs.
        limbs: All limbs.
        hanging: All fruit that hang from them.
        stiff: Solids of all other obstacles.
        wood: Limits and properties.
    """
    count = len(pushables.names)
    whole, lengths = depth_and_extension(pushables)
    per_depth = pushables.force / np.maximum(whole, 1e-12)  # of the limb alone [N/m]
    most = np.clip(whole, 0.0, pushables.depth)
    found = find_neighbours(pushables, most, limbs, hanging, stiff, wood)
    stiffness = largest_stiffness(pushables, whole, lengths, limbs, wood)
    for items in (pushables, hanging):
        others = _pressed_farther_out(pushables, most, stiffness, items, limbs, hanging, stiff, wood)
        found = Neighbours(*(np.concatenate(pair) for pair in zip(found, others, strict=True)))
    depth, limit = most.copy(), STATIC_SHARE * limits_by_segment(limbs, wood).force[pushables.segment]
    for row, mine in found.by_pushable():
        depth[row] = _squeezed_depth(float(most[row]), float(per_depth[row]), float(limit[row]), mine)
    depth[depth < LEAST_DEPTH_M] = 0.0
    force = per_depth * depth
    pushed_on = np.maximum(0.0, depth[found.pushable] - found.gap)
    pressing = np.multiply(found.stiffness, pushed_on, where=pushed_on > 0.0, out=np.zeros(len(pushed_on)))
    squeezed = np.bincount(found.pushable, pressing, count).astype(np.float64)
    cores = pushables.extended(np.divide(lengths * depth, whole, out=np.zeros(count), where=whole > 0.0))
    roots, fruits = ([frozenset[Any]()] * count for _ in range(2))
    for row, mine in found.at(pushed_on > 0.0).by_pushable():
        roots[row], fruits[row] = mine.limb_roots, mine.fruit_names(hanging)
    return PermittedContacts(depth, cores, force + squeezed, squeezed, force * pushables.stress, roots, fruits)


def _squeezed_depth(most: float, per_depth: float, limit: float, neighbours: Neighbours) -> float:
    """Depth at which limb and neighbours together exert the limit of force [m]."""
    most = min(most, float((neighbours.gap + neighbours.depth).min()))
    slope, force, at = per_depth, 0.0, 0.0
    for row in np.argsort(neighbours.gap, kind="stable").tolist():
        gap = float(neighbours.gap[row])
        if gap >= most or force + slope * (gap - at) >= limit:
            break
        force, at, slope = force + slope * (gap - at), gap, slope + float(neighbours.stiffness[row])
    return min(most, at + (limit - force) / slope)


def _pressed_farther_out(
    pushables: Pushables, depth: FloatArray, stiffness: FloatArray, items: Pushables, limbs: Limbs,
    hanging: Pushables, stiff: Sequence[Solid], wood: Wood,
) -> Neighbours:  # fmt: skip
    """Obstacles that pushed limbs press other parts of theirs against, or fruit on them, as neighbours of their own."""
    carried = carried_along(pushables, stiffness, items, limbs, wood)
    moved = carried.ratio * depth[carried.pushed]
    reach = np.zeros(len(items.names))
    np.maximum.at(reach, carried.item, moved)
    near = find_neighbours(items, reach, limbs, hanging, stiff, wood)
    # Limbs that touch at rest have grown together.
    near = near.at((near.gap > 0.0) | (items.mass[near.pushable] > 0.0))
    near = near.at(np.argsort(near.pushable, kind="stable"))
    first, last = (np.searchsorted(near.pushable, carried.item, side=side) for side in ("left", "right"))
    pair = np.repeat(np.arange(len(moved)), last - first)
    row = np.arange(len(pair)) - np.repeat(np.cumsum(last - first) - (last - first), last - first)
    row += first[pair]
    touches = near.gap[row] < moved[pair]
    pair, row = pair[touches], row[touches]
    ratio = carried.ratio[pair]
    return Neighbours(
        carried.pushed[pair], near.gap[row] / ratio, near.stiffness[row] * ratio**2, near.depth[row] / ratio,
        near.most_force[row] / ratio, near.root[row], near.fruit[row], near.direction[row],
    )  # fmt: skip
