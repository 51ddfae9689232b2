"""Obstacles that pushed limbs or fruit may be pressed against."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.geometry.cloud import Cloud
from hplan.scene.limb_parts import TINY, Pushables, parts_between, smallest_eigenvalue
from hplan.scene.limbs import Limbs
from hplan.scene.obstacle_kind import Solid
from hplan.scene.wood import LEAST_DEPTH_M, Wood

#: Number of limb parts whose neighbours are found together.
_TOGETHER: Final = 256


class Neighbours(NamedTuple):
    """Obstacles that pushed limbs or fruit may be pressed against.

    Attributes:
        pushable: (m,) the pushed limb part or fruit.
        gap: (m,) gap between both [m].
        stiffness: (m,) stiffness of the neighbour [N/m]; inf if it is rigid.
        depth: (m,) maximum deflection of the neighbour [m].
        most_force: (m,) maximum force on the neighbour [N]; inf if it is rigid.
        root: (m,) first bending segment of its limb from the clamp; for fruit, of the limb that carries it; -1 if none.
        fruit: (m,) number of a fruit; -1 for others.
        direction: (m, 3) unit vector towards the neighbour: all of it lies behind a plane with this normal at the gap;
            zeros if there is no such plane, or none is known.
        segment: (m,) limb segment that it is, or that a fruit hangs from; -1 for others.
        along: (m,) distance of the point next to the pushed one from the start of a limb segment [m]; else 0.
    """

    pushable: IntArray
    gap: FloatArray
    stiffness: FloatArray
    depth: FloatArray
    most_force: FloatArray
    root: IntArray
    fruit: IntArray
    direction: FloatArray
    segment: IntArray
    along: FloatArray

    def at(self, kept: BoolArray | IntArray) -> Neighbours:
        """Those of a mask or of some numbers."""
        return Neighbours(
            self.pushable[kept], self.gap[kept], self.stiffness[kept], self.depth[kept], self.most_force[kept],
            self.root[kept], self.fruit[kept], self.direction[kept], self.segment[kept], self.along[kept],
        )  # fmt: skip

    @classmethod
    def join(cls, sets: Sequence[Neighbours]) -> Neighbours:
        """All of some sets, at least one."""
        return cls(*(np.concatenate(columns) for columns in zip(*sets, strict=True)))

    @property
    def limb_roots(self) -> frozenset[int]:
        """Roots of the neighbours' limbs."""
        return frozenset(self.root[self.root >= 0].tolist())

    def fruit_names(self, hanging: Pushables) -> frozenset[str]:
        """Names of the neighbours that are fruit."""
        return frozenset(hanging.names[number] for number in self.fruit[self.fruit >= 0].tolist())

    def by_pushable(self) -> Iterator[tuple[int, IntArray]]:
        """Number of each pushable with neighbours, and the places of these."""
        order = np.argsort(self.pushable, kind="stable")
        numbers, first = np.unique(self.pushable[order], return_index=True)
        for number, (begin, end) in zip(numbers.tolist(), pairwise([*first.tolist(), len(order)]), strict=True):
            yield number, order[begin:end]


def find_neighbours(
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
        apart, along = _between_axes(start[row], end[row], limbs.start[other], limbs.end[other])
        distance = np.linalg.norm(apart, axis=1)
        gap = np.maximum(0.0, distance - pushables.radius[row] - limbs.radius[other])
        near = gap < depth[row]
        row, other, gap, along, direction = row[near], other[near], gap[near], along[near], _unit(apart[near])
        point = parts_between(limbs, other, along, along, wood)
        soft = smallest_eigenvalue(point.compliance, point.stiff_axis, np.ones(len(other)))
        is_known = np.linalg.norm(direction, axis=1) > 0.5
        towards = np.einsum("mi,mij,mj->m", direction, point.compliance[0], direction)
        soft = np.where(is_known, np.minimum(soft, towards), soft)
        soft[limbs.clamped[other]] = 0.0
        stiffness = np.divide(1.0, soft, out=np.full(len(soft), np.inf), where=soft > 1e-12)
        room = np.where(soft > 1e-12, np.minimum(point.force * soft, point.depth), 0.0)
        force = np.where(soft > 1e-12, point.force, np.inf)
        none = np.full(len(row), -1)
        found.append(Neighbours(row, gap, stiffness, room, force, roots[other], none, direction, other, along))
        found.append(_fruit_neighbours(pushables, rows, depth, hanging, related, roots))
        for solid in stiff:
            distance, direction = _from_solid(start[rows], end[rows], solid)
            gap = np.maximum(0.0, distance - pushables.radius[rows])
            near = gap < depth[rows]
            rigid, none = np.full(int(near.sum()), np.inf), np.full(int(near.sum()), -1)
            zeros = np.zeros(len(rigid))
            columns = rigid, zeros, rigid, none, none, direction[near], none, zeros
            found.append(Neighbours(rows[near], gap[near], *columns))
    if not found:
        none, nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
        return Neighbours(none, *(nothing,) * 4, none, none, np.zeros((0, 3)), none, nothing)
    return Neighbours.join(found)


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
    direction = _unit(apart[row, other])
    soft = 0.5 * np.einsum("mi,mij,mj->m", direction, hanging.compliance[0][other], direction)
    room = np.minimum(hanging.force[other] * soft, hanging.depth[other])
    return Neighbours(
        rows[row], gap[row, other], 1.0 / np.maximum(soft, TINY), room, hanging.force[other],
        roots[hanging.segment[other]], other, direction, hanging.segment[other], np.zeros(len(row)),
    )  # fmt: skip


def _from_solid(start: FloatArray, end: FloatArray, solid: Solid) -> tuple[FloatArray, FloatArray]:
    """Lower bounds of the distances of axes from a solid, and the directions of the solid.

    Args:
        start: (k, 3) starts of the axes [m].
        end: (k, 3) ends of the axes [m].
        solid: The solid.

    Returns:
        (k,) [m] and (k, 3), as in `Neighbours`; directions from a hull hold for points.
    """
    core = solid.core
    if isinstance(solid, Cloud):
        from scipy.spatial import cKDTree

        count = 9  # points of each axis; between two of them the distance is at most half a step smaller
        points = np.linspace(start, end, count)
        step = np.linalg.norm(end - start, axis=1) / (count - 1)
        return cKDTree(core).query(points)[0].min(axis=0) - 0.5 * step - solid.rounding, np.zeros_like(start)
    if len(core) <= 2:
        apart = _between_axes(start, end, *(np.broadcast_to(core[at], start.shape) for at in (0, -1)))[0]
    else:  # of the boxes about both
        low, high = np.minimum(start, end), np.maximum(start, end)
        apart = np.maximum(0.0, core.min(axis=0) - high) - np.maximum(0.0, low - core.max(axis=0))
    return np.linalg.norm(apart, axis=1) - solid.rounding, _unit(apart)


def _unit(vectors: FloatArray) -> FloatArray:
    """(k, 3) unit vectors; zeros for vectors of no length."""
    length = np.linalg.norm(vectors, axis=1)[:, None]
    found: FloatArray = vectors / np.maximum(length, TINY)
    return found


def _between_axes(
    start: FloatArray, end: FloatArray, other_start: FloatArray, other_end: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(k, 3) shortest vectors from axes to others, and (k,) their ends' distances from the others' starts [m]."""
    u, v, w = end - start, other_end - other_start, start - other_start
    uu, uv, vv, uw, vw = (np.einsum("kj,kj->k", *pair) for pair in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    tiny = 1e-18
    determinant = uu * vv - uv * uv
    inner = np.divide(uv * vw - vv * uw, determinant, out=np.zeros_like(uu), where=determinant > 1e-12 * uu * vv + tiny)
    best, at, apart = np.full(len(u), np.inf), np.zeros(len(u)), np.zeros_like(u)
    for s in (np.clip(inner, 0.0, 1.0), np.zeros_like(uu), np.ones_like(uu)):
        t = np.clip((uv * s + vw) / np.maximum(vv, tiny), 0.0, 1.0)
        s = np.clip((uv * t - uw) / np.maximum(uu, tiny), 0.0, 1.0)
        between = t[:, None] * v - w - s[:, None] * u
        distance = np.linalg.norm(between, axis=1)
        is_nearer = distance < best
        at = np.where(is_nearer, t * np.sqrt(vv), at)
        apart = np.where(is_nearer[:, None], between, apart)
        best = np.minimum(best, distance)
    return apart, at
