r"""Convex hulls grown by a radius.

A hull with more than `HULL_VERTICES` vertices keeps a subset :math:`V` of them. Its rounding is the maximum distance of
the other vertices from :math:`\mathrm{conv}\,V`. The grown hull is convex and contains every vertex, so it contains the
whole hull; its excess is at most its rounding.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Final, Literal

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, Record, frozen, readonly
from hplan.base.disk_cache import cached_arrays

#: Maximum number of vertices of a hull.
HULL_VERTICES: Final = 128

#: Points with a smaller extent than this in some direction are thickened by it to either side [m].
THIN: Final = 1e-5

#: Hulls of fewer points are computed faster than they are read from the disk.
_FEW_POINTS: Final = 2000

#: (8, 3) corners of the cube from -1 to 1.
CUBE_CORNERS: Final = readonly([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def triangle_normals(triangles: FloatArray) -> FloatArray:
    """(n, 3) normals of (n, 3, 3) triangles.

    Their lengths are twice the areas.
    """
    normals: FloatArray = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return normals


def shared_edges(faces: IntArray) -> Iterator[tuple[int, int, tuple[int, int, int]]]:
    """Iterate over edges shared by two of (m, 3) triangles.

    Yields:
        Index of the later triangle, index of the other, and (start, end, apex) vertices of the later one.
    """
    sides: dict[tuple[int, int], int] = {}
    for face, (a, b, c) in enumerate(faces.tolist()):
        for start, end, apex in ((a, b, c), (b, c, a), (c, a, b)):
            other = sides.pop((end, start), None)
            if other is None:
                sides[start, end] = face
            else:
                yield face, other, (start, end, apex)


@dataclass(frozen=True, eq=False)
class Hull(Record):
    """The convex hull of a few points, grown by a radius.

    Attributes:
        name: Name of the object that it belongs to.
        core: (k, 3) vertices of the hull [m].
        faces: (m, 3) triangles of vertices, counter-clockwise as seen from outside.
        rounding: Radius about the core [m].
        sigma: Standard deviation of its position [m].
        yields: Maximum deflection [m].
    """

    name: str
    core: FloatArray
    faces: IntArray
    rounding: float = 0.0
    sigma: float = 0.0
    yields: float = 0.0

    #: The solid is the hull of its core grown by its rounding; `excess` is its maximum distance from the obstacle [m].
    is_point_set: ClassVar[Literal[False]] = False
    excess: ClassVar[float] = 0.0
    #: It counts for all links, and is no part of a limb (`hplan.scene.obstacle_kind.Convex`).
    meets: ClassVar[Literal["all"]] = "all"
    contact_limit: ClassVar[None] = None
    is_limb: ClassVar[Literal[False]] = False

    @property
    def hull(self) -> Hull:
        """The hull itself."""
        return self

    @property
    def grown_corners(self) -> FloatArray:
        """(n, 3) points whose hull contains the grown hull [m].

        The excess is at most 0.74 of the rounding.
        """
        if self.rounding == 0.0:
            return self.core
        grown: FloatArray = (self.core[:, None] + self.rounding * CUBE_CORNERS).reshape(-1, 3)
        return grown

    @property
    def surface(self) -> tuple[FloatArray, IntArray]:
        """Hull of the grown corners: (n, 3) vertices [m], (m, 3) triangles."""
        grown = self if self.rounding == 0.0 else whole_hull(self.grown_corners)
        return grown.core, grown.faces

    @cached_property
    def planes(self) -> FloatArray:
        """(f, 4) facets: outward unit normal and offset [m].

        A point x is in the core if normal @ x <= offset for all facets.
        """
        return self._facets[0]

    @cached_property
    def edges(self) -> FloatArray:
        """(e, 6) edges between facets: one end, vector to the other [m]."""
        return self._facets[1]

    @cached_property
    def _facets(self) -> tuple[FloatArray, FloatArray]:
        corners = self.core[self.faces]
        normals = triangle_normals(corners)
        sizes = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.maximum(sizes, 1e-300)
        # The largest triangle of a facet defines its plane: its normal is the most accurate.
        facet_of = np.full(len(normals), -1)
        leaders: list[int] = []
        offsets = (normals * corners[:, 0]).sum(axis=1)
        # Facets whose unit normals have a dot product within this of 1 are merged.
        coplanar = 1e-9
        for face in np.argsort(-sizes[:, 0], kind="stable"):
            if facet_of[face] < 0:
                same = (facet_of < 0) & (normals @ normals[face] > 1.0 - coplanar)
                same &= np.abs(offsets - offsets[face]) < 1e-9
                same[face] = True
                facet_of[same] = len(leaders)
                leaders.append(int(face))
        # Every vertex is on or below: rounding errors shift the plane outwards, never into the hull.
        normals = normals[leaders]
        planes = np.column_stack([normals, (normals @ self.core.T).max(axis=1)])
        rows = [
            [*self.core[start], *(self.core[end] - self.core[start])]
            for face, other, (start, end, _) in shared_edges(self.faces)
            if facet_of[other] != facet_of[face]
        ]
        return frozen(planes), frozen(np.array(rows, dtype=np.float64).reshape(-1, 6))

    def transform(
        self, rotation: FloatArray, shift: FloatArray, scale: FloatArray | float = 1.0, **changes: Any
    ) -> Hull:
        """Return the scaled, rotated and shifted hull.

        Its facets and edges are transformed too, since they take long to compute.

        Args:
            rotation: (3, 3) rotation.
            shift: (3,) shift [m].
            scale: Factors along its own axes, applied first; must be 1 for a hull with rounding.
            changes: Other changed fields.
        """
        core = frozen(np.ascontiguousarray(self.core * scale @ rotation.T + shift))
        normals = self.planes[:, :3] / scale
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True) @ rotation.T
        ends, along = self.edges[:, :3] * scale @ rotation.T + shift, self.edges[:, 3:] * scale @ rotation.T
        placed = replace(self, core=core, **changes)
        # Every vertex is on or below: rounding errors shift a plane outward, never into the hull.
        planes = np.column_stack([normals, (normals @ core.T).max(axis=1)])
        vars(placed)["_facets"] = frozen(planes), frozen(np.column_stack([ends, along]))
        return placed


def hull_of(points: FloatArray, name: str = "", *, most: int = HULL_VERTICES) -> Hull:
    """Convex hull of points in general position, with at most `most` vertices; of many points it is kept on disk.

    See `hplan.base.disk_cache`.

    Args:
        points: (n, 3) points that do not lie in one plane [m].
        name: Name of the obstacle.
        most: Maximum number of vertices, at least 14.

    Returns:
        The hull; its rounding is 0 if all vertices are kept.

    Raises:
        ValueError: The points lie in one plane.
    """
    if len(points) < _FEW_POINTS:
        return _hull_of(points, name, most)
    parts = str(most).encode(), np.ascontiguousarray(points, dtype=np.float64).tobytes()
    found = cached_arrays(parts, [sys.modules[__name__]], lambda: _to_arrays(_hull_of(points, name, most)))
    return Hull(name, readonly(found["core"]), readonly(found["faces"], np.int64), float(found["rounding"]))


def _to_arrays(hull: Hull) -> dict[str, np.ndarray[Any, Any]]:
    return {"core": hull.core, "faces": hull.faces, "rounding": np.array(hull.rounding)}


def _hull_of(points: FloatArray, name: str, most: int) -> Hull:
    """Convex hull without the cache."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        whole = ConvexHull(points)
        corners = points[whole.vertices]
        if len(corners) <= most:
            return _small_hull(name, corners, 0.0)
        kept, hull = _some_vertices(corners, most)
    except QhullError as error:
        raise ValueError("the points lie in one plane") from error
    core = corners[kept]
    excess = (corners @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    outside = corners[excess > 0.0]
    rounding = float(_distance_to_triangles(outside, core[hull.simplices]).max(initial=0.0))
    return _small_hull(name, core, rounding)


def whole_hull(points: FloatArray, name: str = "", rounding: float = 0.0, sigma: float = 0.0) -> Hull:
    """Convex hull of (n, 3) points with all vertices; thickened if flat."""
    thicker = (points[:, None] + thickening_shifts(points)).reshape(-1, 3)
    return replace(hull_of(thicker, name, most=len(thicker) + 14), rounding=rounding, sigma=sigma)


def thickening_shifts(points: FloatArray) -> FloatArray:
    """Shifts whose copies give flat (n, 3) points a volume [m].

    Returns:
        (k, 3) shifts; one row of zeros if the hull has a volume.
    """
    local = points - points.mean(axis=0)
    axes = np.linalg.eigh(local.T @ local)[1].T
    shifts = np.zeros((1, 3))
    for axis in axes[np.ptp(local @ axes.T, axis=0) < THIN]:
        shifts = np.concatenate([shifts - THIN * axis, shifts + THIN * axis])
    return shifts


def _some_vertices(corners: FloatArray, most: int) -> tuple[IntArray, Any]:
    """Select vertices with the largest excess, a few at a time.

    Returns:
        Rows of the selected vertices, and their hull.
    """
    from scipy.spatial import ConvexHull

    axes = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=np.float64)
    axes = axes[np.abs(axes).sum(axis=1) % 2 == 1]  # along the axes and the space diagonals
    kept = np.unique(ties.on_raster(corners @ axes.T).argmax(axis=0))
    # Vertices with a smaller excess than this are not added [m].
    hull_error = 2e-4
    while True:
        hull = ConvexHull(corners[kept])
        excess = corners @ hull.equations[:, :3].T + hull.equations[:, 3]
        peaks = np.unique(ties.on_raster(excess).argmax(axis=0))
        height = excess[peaks].max(axis=1)
        new = peaks[ties.argsort(-height)][: min(8, most - len(kept))]
        new = new[excess[new].max(axis=1) > hull_error]
        if len(new) == 0:
            return kept, hull
        kept = np.union1d(kept, new)


def _small_hull(name: str, points: FloatArray, rounding: float) -> Hull:
    """Hull of a few points, faces outward, vertices in their order."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    index = np.full(len(points), -1)
    vertices = np.sort(hull.vertices)
    index[vertices] = np.arange(len(vertices))
    core = readonly(points[vertices])
    faces = index[hull.simplices]
    inward = (triangle_normals(core[faces]) * hull.equations[:, :3]).sum(axis=1) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return Hull(name, core, readonly(faces, np.int64), rounding)


def _distance_to_triangles(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """(n,) distances of points from the nearest triangle."""
    least = np.full(len(points), np.inf)
    edges = np.roll(triangles, -1, axis=1) - triangles
    squares = np.maximum((edges * edges).sum(axis=2), 1e-300)
    normals = triangle_normals(triangles)
    inwards = np.cross(normals[:, None], edges)
    sizes = np.linalg.norm(normals, axis=1)
    for corners, along, square, inward, normal, size in zip(
        triangles, edges, squares, inwards, normals, sizes, strict=True
    ):
        away = points[:, None] - corners
        t = np.clip((away * along).sum(axis=2) / square, 0.0, 1.0)
        offs = away - t[..., None] * along
        least = np.minimum(least, np.sqrt((offs * offs).sum(axis=2).min(axis=1)))
        if size > 0.0:
            inner = ((away * inward).sum(axis=2) >= 0.0).all(axis=1)
            least[inner] = np.minimum(least[inner], np.abs(away[inner, 0] @ normal) / size)
    return least
