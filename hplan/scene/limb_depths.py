r"""Permitted depths of limbs and fruit, with the neighbours that they are pushed against.

A limb that is pushed against another one, or against anything else, bends that as well: behind a gap g,
a neighbour with the compliance :math:`c_2` adds :math:`(\delta - g) / c_2`, and a rigid one stops it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.geometry.cloud import Cloud
from hplan.scene.limb_parts import TINY, Pushables, depth_and_extension, parts_between, smallest_eigenvalue
from hplan.scene.limb_sweeps import carried_along, largest_stiffness
from hplan.scene.limbs import Limbs
from hplan.scene.obstacle_kind import Solid
from hplan.scene.wood import LEAST_DEPTH_M, STATIC_SHARE, Wood, limits_by_segment

#: Number of limb parts whose neighbours are found together.
_TOGETHER: Final = 256


class PermittedContacts(NamedTuple):
    """Permitted depth of each pushable, and what it does.

    Attributes:
        depth: (k,) permitted depth [m].
        extension: (k,) extension of both ends along the stiff axis [m].
        force: (k,) static force at that depth [N].
        pressed: (k,) the part of it by neighbours [N].
        stress: (k,) static stress of the limb at that depth [Pa].
        roots: The roots of neighbours' limbs, of each pushable.
        fruits: The names of neighbouring fruit, of each pushable.
    """

    depth: FloatArray
    extension: FloatArray
    force: FloatArray
    pressed: FloatArray
    stress: FloatArray
    roots: list[frozenset[int]]
    fruits: list[frozenset[str]]


def permitted_contacts(
    pushables: Pushables, limbs: Limbs, hanging: Pushables, stiff: Sequence[Solid], wood: Wood
) -> PermittedContacts:
    """Depths within the limits of force and stress, with the neighbours that are pushed as well.

    Args:
        pushables: Parts of limbs, or fruit.
        limbs: All limbs.
        hanging: All fruit that hang from them.
        stiff: Solids of all other obstacles.
        wood: Limits and properties.
    """
    count = len(pushables.names)
    whole, lengths = depth_and_extension(pushables)
    per_depth = pushables.force / np.maximum(whole, 1e-12)  # of the limb alone [N/m]
    most = np.clip(whole, 0.0, pushables.depth)
    found = _neighbours(pushables, most, limbs, hanging, stiff, wood)
    if not pushables.mass.any():
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
    extension = np.divide(lengths * depth, whole, out=np.zeros(count), where=whole > 0.0)
    roots, fruits = ([frozenset[Any]()] * count for _ in range(2))
    for row, mine in found.at(pushed_on > 0.0).by_pushable():
        roots[row] = frozenset(mine.root[mine.root >= 0].tolist())
        fruits[row] = frozenset(hanging.names[fruit] for fruit in mine.fruit[mine.fruit >= 0].tolist())
    return PermittedContacts(depth, extension, force + squeezed, squeezed, force * pushables.stress, roots, fruits)


class Neighbours(NamedTuple):
    """Obstacles that pushed limbs or fruit may be pressed against.

    Attributes:
        pushable: (m,) the pushed limb part or fruit.
        gap: (m,) gap between both [m].
        stiffness: (m,) stiffness of the neighbour [N/m]; inf if it is rigid.
        depth: (m,) maximum deflection of the neighbour [m].
        root: (m,) first bending segment of its limb from the clamp; for fruit, of the limb that carries it; -1 if none.
        fruit: (m,) number of a fruit; -1 for others.
    """

    pushable: IntArray
    gap: FloatArray
    stiffness: FloatArray
    depth: FloatArray
    root: IntArray
    fruit: IntArray

    def at(self, kept: BoolArray | IntArray) -> Neighbours:
        """Those of a mask or of some numbers."""
        return Neighbours(
            self.pushable[kept], self.gap[kept], self.stiffness[kept], self.depth[kept], self.root[kept],
            self.fruit[kept],
        )  # fmt: skip

    def by_pushable(self) -> Iterator[tuple[int, Neighbours]]:
        """Number of each pushable with neighbours, and these."""
        order = np.argsort(self.pushable, kind="stable")
        numbers, first = np.unique(self.pushable[order], return_index=True)
        for number, (begin, end) in zip(numbers.tolist(), pairwise([*first.tolist(), len(order)]), strict=True):
            yield number, self.at(order[begin:end])


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
    near = _neighbours(items, reach, limbs, hanging, stiff, wood)
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
        near.root[row], near.fruit[row],
    )  # fmt: skip


def _neighbours(
    pushables: Pushables, depth: FloatArray, limbs: Limbs, hanging: Pushables, stiff: Sequence[Solid], wood: Wood
) -> Neighbours:
    """Obstacles within the depth of pushed limbs or fruit, but for the limbs that they grow from and those on them."""
    related, roots = limbs.related()[pushables.segment], limbs.roots()
    moved = np.flatnonzero(depth >= LEAST_DEPTH_M)
    found = list[Neighbours]()
    start, end = pushables.start, pushables.end
    for first in range(0, len(moved), _TOGETHER):
        rows = moved[first : first + _TOGETHER]
        middles, halves = 0.5 * (start[rows] + end[rows]), 0.5 * np.linalg.norm(end[rows] - start[rows], axis=1)
        apart = np.linalg.norm(middles[:, None] - 0.5 * (limbs.start + limbs.end), axis=2) - halves[:, None]
        reach = (depth + pushables.radius)[rows, None] + limbs.radius + 0.5 * limbs.length
        row, other = np.nonzero((apart < reach) & ~related[rows])
        row = rows[row]
        distance, along = _axis_distance(start[row], end[row], limbs.start[other], limbs.end[other])
        gap = np.maximum(0.0, distance - pushables.radius[row] - limbs.radius[other])
        near = gap < depth[row]
        row, other, gap, along = row[near], other[near], gap[near], along[near]
        point = parts_between(limbs, other, along, along, wood)
        soft = smallest_eigenvalue(point.compliance, point.stiff_axis, np.ones(len(other)))
        soft[limbs.clamped[other]] = 0.0
        stiffness = np.divide(1.0, soft, out=np.full(len(soft), np.inf), where=soft > 1e-12)
        room = np.where(soft > 1e-12, np.minimum(point.force * soft, point.depth), 0.0)
        found.append(Neighbours(row, gap, stiffness, room, roots[other], np.full(len(row), -1)))
        found.append(_fruit_neighbours(pushables, rows, depth, hanging, related, roots))
        for solid in stiff:
            gap = _solid_distance(start[rows], end[rows], solid) - pushables.radius[rows]
            near = gap < depth[rows]
            rigid, none = np.full(int(near.sum()), np.inf), np.full(int(near.sum()), -1)
            found.append(Neighbours(rows[near], np.maximum(0.0, gap[near]), rigid, np.zeros(len(rigid)), none, none))
    if not found:
        none = np.zeros(0, dtype=np.int64)
        return Neighbours(none, np.zeros(0), np.zeros(0), np.zeros(0), none, none)
    return Neighbours(*(np.concatenate(columns) for columns in zip(*found, strict=True)))


def _fruit_neighbours(
    pushables: Pushables, rows: IntArray, depth: FloatArray, hanging: Pushables, related: BoolArray, roots: IntArray
) -> Neighbours:
    """Fruit within the depth of pushed limbs or other fruit, but for the fruit on the pushed limbs."""
    start, along = pushables.start[rows], (pushables.end - pushables.start)[rows]
    offset = hanging.start - start[:, None]
    fraction = np.einsum("kfj,kj->kf", offset, along) / np.maximum(np.einsum("kj,kj->k", along, along), TINY)[:, None]
    apart = offset - np.clip(fraction, 0.0, 1.0)[:, :, None] * along[:, None]
    distance = np.linalg.norm(apart, axis=2)
    gap = np.maximum(0.0, distance - pushables.radius[rows, None] - hanging.radius)
    own = related[rows][:, hanging.segment] & (pushables.swing[rows] == 0.0)[:, None]
    own |= np.array(pushables.names)[rows, None] == np.array(hanging.names) if len(hanging.names) else False
    row, other = np.nonzero((gap < depth[rows, None]) & ~own)
    direction = apart[row, other] / np.maximum(distance[row, other], TINY)[:, None]
    soft = 0.5 * np.einsum("mi,mij,mj->m", direction, hanging.compliance[0][other], direction)
    room = np.minimum(hanging.force[other] * soft, hanging.depth[other])
    return Neighbours(
        rows[row], gap[row, other], 1.0 / np.maximum(soft, TINY), room, roots[hanging.segment[other]], other
    )


def _solid_distance(start: FloatArray, end: FloatArray, solid: Solid) -> FloatArray:
    """(k,) lower bounds of the distances of axes between (k, 3) points from a solid [m]."""
    core = solid.core
    if isinstance(solid, Cloud):
        from scipy.spatial import cKDTree

        count = 9  # points of each axis; between two of them the distance is at most half a step smaller
        points = np.linspace(start, end, count)
        step = np.linalg.norm(end - start, axis=1) / (count - 1)
        distance = cKDTree(core).query(points)[0].min(axis=0) - 0.5 * step
    elif len(core) <= 2:
        distance = _axis_distance(start, end, *(np.broadcast_to(core[at], start.shape) for at in (0, -1)))[0]
    else:  # of the boxes about both
        low, high = np.minimum(start, end), np.maximum(start, end)
        apart = np.maximum(core.min(axis=0) - high, low - core.max(axis=0))
        distance = np.linalg.norm(np.maximum(apart, 0.0), axis=1)
    found: FloatArray = distance - solid.rounding
    return found


def _axis_distance(
    start: FloatArray, end: FloatArray, other_start: FloatArray, other_end: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(k,) distances of (k, 3) axes, and the nearest points' distances from the other axes' starts [m]."""
    u, v, w = end - start, other_end - other_start, start - other_start
    uu, uv, vv, uw, vw = (np.einsum("kj,kj->k", *pair) for pair in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    tiny = 1e-18
    determinant = uu * vv - uv * uv
    inner = np.divide(uv * vw - vv * uw, determinant, out=np.zeros_like(uu), where=determinant > 1e-12 * uu * vv + tiny)
    best, at = np.full(len(u), np.inf), np.zeros(len(u))
    for s in (np.clip(inner, 0.0, 1.0), np.zeros_like(uu), np.ones_like(uu)):
        t = np.clip((uv * s + vw) / np.maximum(vv, tiny), 0.0, 1.0)
        s = np.clip((uv * t - uw) / np.maximum(uu, tiny), 0.0, 1.0)
        distance = np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1)
        at = np.where(distance < best, t * np.sqrt(vv), at)
        best = np.minimum(best, distance)
    return best, at
