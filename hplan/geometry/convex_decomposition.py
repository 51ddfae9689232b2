r"""Convex decomposition of a closed surface; the union contains the solid.

The solid :math:`S` is cut by planes: each part is the closure :math:`S_C` of the intersection of its interior with the
interior of a box :math:`C` of a partition of space. Each part is replaced by its convex hull, so the union contains
the solid for any choice of cuts. The hull is exact: :math:`S_C` lies in the hull of its extreme points, and an extreme
point is either on the surface, and then a vertex of a triangle clipped by :math:`C`, or inside the solid, and then a
corner of :math:`C`. Hence

.. math:: \mathrm{conv}(S_C) = \mathrm{conv}(\text{vertices of the clipped triangles} \cup
    \{\text{corners of } C \text{ in } S_C\}).

Triangles in the plane of a cut belong to the side of the solid. The winding number decides if a corner is inside, at a
point `_NUDGE` inwards of the box. (Hulls with many vertices are simplified from outside, see `hplan.geometry.hull`.
Parts within `_IN_PLANE` of a cut are assigned to its other side. So "contains" means up to less than a micrometre.)

A surface may bound sheets as well as solids: leaves and panels, two faces back to back or nearly so. A part thinner
than `hplan.geometry.hull.THIN` is thickened by that length to either side, so that hulls of sheets have a volume too.

The excess of the parts over the solid is measured on a voxel grid (`_SolidVoxels`). The part with the maximum
excess is cut next, at the place that minimizes the total hull volume of the halves, until no excess is above the
tolerance or there are `PIECES` parts.
"""

from __future__ import annotations

import heapq
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hplan.base import ties
from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.base.disk_cache import cached_arrays
from hplan.geometry import hull
from hplan.geometry.hull import CUBE_CORNERS, THIN, Hull, hull_of, shared_edges, thickening_shifts, triangle_normals

#: Maximum number of convex parts of a mesh.
PIECES: Final = 64

#: Surfaces with fewer triangles are decomposed anew in each process, which takes some hundredths of a second.
_FEW_FACES: Final = 100

#: Vertices within this distance of a plane count as in it: the single-precision resolution at one metre [m].
_IN_PLANE: Final = 1e-7

#: Inward offset of a box corner for the inside test [m].
_NUDGE: Final = 2e-7

#: Number of cuts tried along an axis, in addition to quarter, half and three quarters.
_PLACES: Final = 6


@dataclass(frozen=True, eq=False)
class Pieces:
    """Convex parts of a solid.

    Attributes:
        hulls: The parts; their union contains the solid.
        excess: Maximum distance of a point of the parts from the solid [m]; 0 for a convex solid. (Enclosed cavities
            count as solid.)
    """

    hulls: tuple[Hull, ...]
    excess: float


def convex_pieces(vertices: FloatArray, faces: IntArray, *, most: int = PIECES) -> Pieces:
    """Decompose the solid inside a closed surface into convex parts; parts of detailed surfaces are kept on disk.

    See `hplan.base.disk_cache`.

    Args:
        vertices: (n, 3) vertices [m].
        faces: (m, 3) triangles, counter-clockwise as seen from outside; closed.
        most: Maximum number of parts.

    Raises:
        ValueError: The vertices lie in one plane.
    """
    if len(faces) < _FEW_FACES:
        return _cut(vertices, faces, most)
    parts = str(most).encode(), np.ascontiguousarray(vertices).tobytes(), np.ascontiguousarray(faces).tobytes()
    found = cached_arrays(parts, (sys.modules[__name__], hull), lambda: _to_arrays(_cut(vertices, faces, most)))
    return _from_arrays(found)


def _to_arrays(pieces: Pieces) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays that hold the parts, one after the other."""
    hulls = pieces.hulls
    return {
        "core": np.concatenate([part.core for part in hulls]),
        "faces": np.concatenate([part.faces for part in hulls]),
        "counts": np.array([(len(part.core), len(part.faces)) for part in hulls]),
        "rounding": np.array([part.rounding for part in hulls]),
        "excess": np.array(pieces.excess),
        "names": np.array([part.name for part in hulls]),
    }


def _from_arrays(found: Mapping[str, np.ndarray[Any, Any]]) -> Pieces:
    ends = np.cumsum(found["counts"], axis=0)[:-1]
    rows = zip(
        found["names"].tolist(),
        np.split(found["core"], ends[:, 0]),
        np.split(found["faces"], ends[:, 1]),
        found["rounding"].tolist(),
        strict=True,
    )
    return Pieces(tuple(Hull(*row) for row in rows), float(found["excess"]))


def _cut(vertices: FloatArray, faces: IntArray, most: int) -> Pieces:
    """Decompose without the cache."""
    whole = hull_of(vertices)
    if _is_convex(vertices, faces):
        return Pieces((whole,), whole.rounding)
    triangles = vertices[faces]
    voxels = _SolidVoxels.voxelize(triangles)
    places = _reflex_places(vertices, faces)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    ready: list[tuple[float, _ClippedPart]] = []
    first = _part(low, high, triangles, triangles)
    waiting = [] if first is None else [(-voxels.excess(first.hull), 0, first)]
    number = 0
    while waiting and max(len(waiting) + len(ready), number // 8) < most and -waiting[0][0] > voxels.tolerance:
        excess, _, part = heapq.heappop(waiting)
        halves = _halves(part, places, triangles)
        if halves is None:
            ready.append((-excess, part))
            continue
        for half in halves:
            number += 1
            heapq.heappush(waiting, (-voxels.excess(half.hull), number, half))
    ready += [(-excess, part) for excess, _, part in sorted(waiting, key=lambda item: item[1])]
    hulls = tuple(part.hull for _, part in ready)
    # The hulls do not overlap, so equal volumes prove that they are the solid itself; not so for sheets.
    solid = [part.hull for _, part in ready if not part.is_thin]
    volume, of_hulls = _volume(triangles), sum(_volume(hull.core[hull.faces]) for hull in solid)
    exact = abs(of_hulls - volume) <= 1e-6 * volume and all(hull.rounding == 0.0 for hull in solid)
    inexact = [excess for excess, part in ready if part.is_thin or not exact]
    return Pieces(hulls, max(inexact) + voxels.blur + THIN if inexact else 0.0)


def _volume(triangles: FloatArray) -> float:
    """Volume inside a closed surface [m^3]."""
    a, b, c = (triangles[:, i] - triangles[0, 0] for i in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


def _is_convex(vertices: FloatArray, faces: IntArray) -> bool:
    """True if no vertex is above the plane of any triangle."""
    size = float(np.ptp(vertices, axis=0).max())
    corners = vertices[faces]
    normals = triangle_normals(corners)
    sizes = np.linalg.norm(normals, axis=1)
    flat = sizes <= 1e-12 * size * size
    normals = normals[~flat] / sizes[~flat, None]
    offsets = (normals * corners[~flat, 0]).sum(axis=1)
    chunk = max(1, 4_000_000 // len(vertices))
    return all(
        float((normals[k : k + chunk] @ vertices.T - offsets[k : k + chunk, None]).max()) <= 1e-7 * size
        for k in range(0, len(normals), chunk)
    )


@dataclass(frozen=True, eq=False)
class _ClippedPart:
    """The part of the solid in a box.

    Attributes:
        low: (3,) lower corner of the box [m].
        high: (3,) upper corner of the box [m].
        triangles: (n, 3, 3) surface clipped by the box [m].
        thickening: (k, 3) shifts that give a sheet a volume; one row of zeros for a solid [m].
        hull: Convex hull of the part.
    """

    low: FloatArray
    high: FloatArray
    triangles: FloatArray
    thickening: FloatArray
    hull: Hull

    @property
    def is_thin(self) -> bool:
        """True for a sheet, or a part of one."""
        return len(self.thickening) > 1

    @property
    def extent(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner of the region to cut, (3,) [m]."""
        points = self.triangles.reshape(-1, 3) if self.is_thin else self.hull.core
        return points.min(axis=0), points.max(axis=0)

    def rough_volume(self, triangles: FloatArray) -> float:
        """Approximate hull volume of some triangles, thickened as the part [m^3]."""
        return _rough_volume((triangles.reshape(-1, 1, 3) + self.thickening).reshape(-1, 3))


def _part(low: FloatArray, high: FloatArray, triangles: FloatArray, surface: FloatArray) -> _ClippedPart | None:
    """Return the part of the solid in a box, or None."""
    corners = np.where(CUBE_CORNERS < 0.0, low, high)
    nudge = _NUDGE * np.sign(0.5 * (low + high) - corners)
    inside = corners[np.abs(winding_numbers(corners + nudge, surface)) > 0.25]
    points = np.unique(np.concatenate([triangles.reshape(-1, 3), inside]), axis=0)
    if len(points) == 0:
        return None
    thicker = thickening_shifts(points)
    points = (points[:, None] + thicker).reshape(-1, 3)
    try:
        hull = hull_of(points)
    except ValueError:  # too thin for Qhull
        hull = hull_of(_block(points))
    return _ClippedPart(low, high, triangles, thicker, hull)


def _block(points: FloatArray) -> FloatArray:
    """(8, 3) corners of a box along the principal axes of points.

    It is larger by `THIN` on every side.
    """
    middle = points.mean(axis=0)
    axes = np.linalg.eigh((points - middle).T @ (points - middle))[1].T
    local = (points - middle) @ axes.T
    low, high = local.min(axis=0) - THIN, local.max(axis=0) + THIN
    block: FloatArray = np.where(CUBE_CORNERS < 0.0, low, high) @ axes + middle
    return block


def _halves(part: _ClippedPart, places: list[FloatArray], surface: FloatArray) -> tuple[_ClippedPart, ...] | None:
    """Cut a part in two; None if no cut remains."""
    low, high = part.extent
    extent = high - low
    folds = [_places_between(found, low[axis], high[axis], 2.0 * _NUDGE) for axis, found in enumerate(places)]
    # Few folds indicate a solid made of blocks: with cuts at the folds only, the parts are the blocks.
    angular = sum(map(len, folds)) > 0 and max(map(len, folds)) <= _PLACES
    whole = max(part.rough_volume(part.triangles), 1e-300)
    best: tuple[float, int, float] | None = None
    # Cost of an uneven cut, as a fraction of the volume difference: no single cut of a ring reduces the hull volume,
    # but after an even cut the next one does.
    evenness = 0.03
    # Cost of a cut across a short side, relative to one across the longest.
    short_side = 0.1
    for axis in range(3):
        here = folds[axis]
        if not angular:
            some = here[np.linspace(0, len(here) - 1, min(len(here), _PLACES)).round().astype(int)]
            here = np.concatenate([some, low[axis] + extent[axis] * np.array([0.25, 0.5, 0.75])])
            here = _places_between(np.unique(here), low[axis], high[axis], max(2.0 * _NUDGE, 1e-3 * extent[axis]))
        for at in here.tolist():
            below, above = (_clip(part.triangles, axis, at, side) for side in (-1.0, 1.0))
            volumes = part.rough_volume(below), part.rough_volume(above)
            cost = (sum(volumes) + evenness * abs(volumes[0] - volumes[1])) / whole
            cost += short_side * (1.0 - extent[axis] / extent.max())
            if best is None or cost < best[0] - 1e-9:
                best = (cost, axis, at)
    if best is None:
        return None
    _, axis, at = best
    halves = []
    for side in (-1.0, 1.0):
        lower, upper = part.low.copy(), part.high.copy()
        (upper if side < 0.0 else lower)[axis] = at
        halves.append(_part(lower, upper, _clip(part.triangles, axis, at, side), surface))
    return tuple(half for half in halves if half is not None)


def _places_between(places: FloatArray, low: float, high: float, gap: float) -> FloatArray:
    """Places between two bounds, at least `gap` away from either."""
    return places[(places > low + gap) & (places < high - gap)]


def _fixed_directions() -> FloatArray:
    grid = np.array([(x, y, z) for x in range(-2, 3) for y in range(-2, 3) for z in range(-2, 3)], dtype=np.float64)
    shell = grid[np.abs(grid).max(axis=1) == 2]
    directions: FloatArray = shell / np.linalg.norm(shell, axis=1, keepdims=True)
    return directions


_SUPPORT_DIRECTIONS: Final = _fixed_directions()


def _rough_volume(points: FloatArray) -> float:
    """Hull volume of extreme points in fixed directions, 0 if flat [m^3]."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 4:
        return 0.0
    # Maximum number of points that represent a part in the comparison of cuts.
    samples = 3000
    x, y, z = points[:: 1 + len(points) // samples].T
    # For arrays this small, BLAS takes longer to wake its threads than to multiply.
    heights = _SUPPORT_DIRECTIONS[:, :1] * x + _SUPPORT_DIRECTIONS[:, 1:2] * y + _SUPPORT_DIRECTIONS[:, 2:] * z
    farthest = np.unique(ties.on_raster(heights).argmax(axis=1))
    try:
        return float(ConvexHull(np.column_stack([x, y, z])[farthest]).volume)
    except QhullError:
        return 0.0


def _clip(triangles: FloatArray, axis: int, at: float, side: float) -> FloatArray:
    """Clip triangles to one side of a plane.

    The side is `side * (coordinate - at) > 0`.

    Triangles in the plane are kept if they bound a solid on this side.
    """
    height = side * (triangles[:, :, axis] - at)
    height[np.abs(height) <= _IN_PLANE] = 0.0
    above = height > 0.0
    count = above.sum(axis=1)
    whole = (height >= 0.0).all(axis=1)
    level = whole & (count == 0)
    corners = triangles[level]
    parts = [triangles[whole & ~level], corners[side * triangle_normals(corners)[:, axis] < 0.0]]
    for number in (1, 2):
        rows = np.flatnonzero((count == number) & ~whole)
        # Rotate the vertex order so that the lone vertex comes first.
        lone = (above[rows] if number == 1 else ~above[rows]).argmax(axis=1)
        turn = (lone[:, None] + np.arange(3)) % 3
        corners = np.take_along_axis(triangles[rows], turn[:, :, None], axis=1)
        heights = np.take_along_axis(height[rows], turn, axis=1)
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ha, hb, hc = heights[:, :1], heights[:, 1:2], heights[:, 2:]
        ab, ac = a + ha / (ha - hb) * (b - a), a + ha / (ha - hc) * (c - a)
        ab[:, axis] = ac[:, axis] = at
        if number == 1:
            parts.append(np.stack([a, ab, ac], axis=1))
        else:
            parts += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(parts)


def winding_numbers(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """Winding numbers of a closed surface about (n, 3) points.

    1 inside, 0 outside, between on the surface.
    """
    total = np.zeros(len(points))
    for k, point in enumerate(points):
        a, b, c = (triangles[:, i] - point for i in range(3))
        la, lb, lc = (np.sqrt((side * side).sum(axis=1)) for side in (a, b, c))
        ab, bc, ca = (a * b).sum(axis=1), (b * c).sum(axis=1), (c * a).sum(axis=1)
        numerator = (a * np.cross(b, c)).sum(axis=1)
        total[k] = np.arctan2(numerator, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2.0 * np.pi)
    return total


def _reflex_places(vertices: FloatArray, faces: IntArray) -> list[FloatArray]:
    """Coordinates of reflex vertices, axis by axis: candidates for cuts."""
    normals = triangle_normals(vertices[faces])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    size = float(np.ptp(vertices, axis=0).max())
    folded: set[int] = set()
    for _, other, (start, end, apex) in shared_edges(faces):
        if (vertices[apex] - vertices[start]) @ normals[other] > 1e-6 * size:
            folded |= {start, end}
    rows = vertices[sorted(folded)].reshape(-1, 3)
    found = []
    for axis in range(3):
        places = np.unique(rows[:, axis])
        found.append(places[np.diff(places, prepend=-np.inf) > _IN_PLANE])
    return found


@dataclass(frozen=True, eq=False)
class _SolidVoxels:
    """Distance field of a solid, for the excess of its convex parts.

    Attributes:
        origin: (3,) centre of the first voxel [m].
        edge: Edge length of a voxel [m].
        distance: Distance of each voxel centre from the nearest centre of a solid voxel [m].
        tolerance: Maximum accepted excess of a part [m].
    """

    origin: FloatArray
    edge: float
    distance: FloatArray
    tolerance: float

    @classmethod
    def voxelize(cls, triangles: FloatArray) -> _SolidVoxels:
        """Voxelize a closed surface; the edge length is half the tolerance."""
        from scipy import ndimage

        low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
        # Accepted excess: 5 mm, or a fraction of the mesh's longest side if that is more.
        tolerance = max(5e-3, 0.02 * float((high - low).max()))
        edge = 0.5 * tolerance
        origin = low - 0.5 * edge
        shape = tuple((np.ceil((high - low) / edge) + 2).astype(int).tolist())
        solid: BoolArray = np.zeros(shape, dtype=np.bool_)
        for points in _covering_points(triangles, 0.7 * edge):
            solid[tuple(np.rint((points - origin) / edge).astype(int).T)] = True
        distance = edge * ndimage.distance_transform_edt(~ndimage.binary_fill_holes(solid))
        return cls(origin, edge, distance, tolerance)

    @property
    def blur(self) -> float:
        """Maximum error of a distance between centres: one voxel diagonal [m].

        It is half a diagonal at either end.
        """
        return float(np.sqrt(3.0) * self.edge)

    def excess(self, hull: Hull) -> float:
        """Excess of a hull over the solid [m].

        It is the maximum distance over voxels within half a diagonal of the hull.
        """
        margin = 0.5 * self.blur + hull.rounding
        low = np.floor((hull.core.min(axis=0) - margin - self.origin) / self.edge).astype(int)
        high = np.ceil((hull.core.max(axis=0) + margin - self.origin) / self.edge).astype(int) + 1
        low, high = np.maximum(low, 0), np.minimum(high, self.distance.shape)
        near = self.distance[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        index = np.argwhere(near > 0.5 * self.tolerance)
        # Farthest first, so that the first voxel in the hull is the answer.
        far = near[tuple(index.T)]
        order = np.argsort(-far, kind="stable")
        for k in range(0, len(order), 20_000):
            some = order[k : k + 20_000]
            centers = self.origin + self.edge * (index[some] + low)
            within = (centers @ hull.planes[:, :3].T <= hull.planes[:, 3] + margin).all(axis=1)
            if within.any():
                return float(far[some[int(within.argmax())]])
        return 0.5 * self.tolerance


def _covering_points(triangles: FloatArray, spacing: float) -> list[FloatArray]:
    """Points on all triangles, at most `spacing` apart [m].

    Triangles are bisected along the longest side until they are small enough.
    """
    found = [triangles.reshape(-1, 3)]
    while len(triangles):
        sides = np.linalg.norm(triangles - triangles[:, [1, 2, 0]], axis=2)
        triangles = triangles[sides.max(axis=1) > spacing]
        sides = sides[sides.max(axis=1) > spacing]
        turn = (sides.argmax(axis=1)[:, None] + np.arange(3)) % 3
        corners = np.take_along_axis(triangles, turn[:, :, None], axis=1)
        middle = 0.5 * (corners[:, 0] + corners[:, 1])
        found.append(middle)
        first = np.stack([corners[:, 0], middle, corners[:, 2]], axis=1)
        second = np.stack([middle, corners[:, 1], corners[:, 2]], axis=1)
        triangles = np.concatenate([first, second])
    return found
