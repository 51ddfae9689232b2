r"""Solids of meshes and point clouds: convex hulls and ball clouds.

Every solid has `name`, `core` (k, 3), `rounding`, `is_point_set` and `sigma`. A solid is the hull of its core grown by
its rounding; for a point set, each core point is a separate ball of that radius.

**Hull.** A hull with more than `HULL_VERTICES` vertices keeps a subset :math:`V` of them. Its rounding is the maximum
distance of the other vertices from :math:`\mathrm{conv}\,V`. The grown hull is convex and contains every vertex, so it
contains the whole hull; its excess is at most its rounding.

**Cloud.** Points in one voxel of a grid may be merged into one ball. Its radius grows by their maximum distance from
its centre, at most `MERGE_ERROR`, so the new balls contain the old ones. The points are stored in the order of a tree,
along a Morton curve that is split recursively.

**Swept solids.** Let a solid be the hull of a core :math:`C` grown by a rounding. Shifted by all of :math:`[-a, a]`, it
sweeps the hull of :math:`C - a` and :math:`C + a` grown by the same rounding: a ball becomes a capsule, any other solid
a hull. This is exact, except that a flat hull is thickened by `THIN`, and a hull with many vertices is simplified as
for a mesh. A cloud becomes a cloud of copies along the segment, dense enough that balls with a radius larger by
`SWEPT_ERROR` cover the swept balls; if that needs too many points, fewer copies of larger balls.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Final, Literal

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, Record, frozen, readonly

#: Maximum number of vertices of a hull.
HULL_VERTICES: Final = 128

#: Points with a smaller extent than this in some direction are thickened by it to either side [m].
THIN: Final = 1e-5

#: Maximum growth of a ball by merging [m].
MERGE_ERROR: Final = 1e-3

#: Maximum number of points in a leaf of a cloud's tree.
LEAF: Final = 16

#: (8, 3) corners of the cube from -1 to 1.
CUBE_CORNERS: Final = readonly([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def rpy_rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Rotation by roll, pitch and yaw about fixed axes, (3, 3) [rad]."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quaternion_rotation(quaternion_xyzw: Sequence[float]) -> FloatArray:
    """Rotation of a quaternion (x, y, z, w) after normalization, (3, 3)."""
    q = np.asarray(quaternion_xyzw, dtype=np.float64)
    x, y, z, w = q / np.linalg.norm(q)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: FloatArray = np.eye(3) + 2.0 * w * across + 2.0 * across @ across
    return rotation


def rpy_of(rotation: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a (3, 3) rotation [deg].

    It inverts `rpy_rotation`, which takes radians.
    """
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    if math.hypot(rotation[0, 0], rotation[1, 0]) > 1e-9:
        roll, yaw = math.atan2(rotation[2, 1], rotation[2, 2]), math.atan2(rotation[1, 0], rotation[0, 0])
    else:  # gimbal lock: roll and yaw rotate about the same axis
        roll, yaw = 0.0, math.atan2(-rotation[0, 1], rotation[1, 1])
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


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
        name: Name of the obstacle that it belongs to.
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

    def placed(self, rotation: FloatArray, shift: FloatArray, scale: FloatArray | float = 1.0, **changes: Any) -> Hull:
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
    """Convex hull of points in general position, with at most `most` vertices.

    Args:
        points: (n, 3) points that do not lie in one plane [m].
        name: Name of the obstacle.
        most: Maximum number of vertices, at least 14.

    Returns:
        The hull; its rounding is 0 if all vertices are kept.

    Raises:
        ValueError: The points lie in one plane.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        whole = ConvexHull(points)
        corners = points[whole.vertices]
        if len(corners) <= most:
            return _oriented(name, corners, 0.0)
        kept, hull = _some_vertices(corners, most)
    except QhullError as error:
        raise ValueError("the points lie in one plane") from error
    core = corners[kept]
    excess = (corners @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    outside = corners[excess > 0.0]
    rounding = float(_distance_to_triangles(outside, core[hull.simplices]).max(initial=0.0))
    return _oriented(name, core, rounding)


def whole_hull(points: FloatArray, name: str = "", rounding: float = 0.0, sigma: float = 0.0) -> Hull:
    """Convex hull of (n, 3) points with all vertices; thickened if flat."""
    thicker = (points[:, None] + thickening(points)).reshape(-1, 3)
    return replace(hull_of(thicker, name, most=len(thicker) + 14), rounding=rounding, sigma=sigma)


def thickening(points: FloatArray) -> FloatArray:
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


def _oriented(name: str, points: FloatArray, rounding: float) -> Hull:
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


@dataclass(frozen=True, eq=False)
class Cloud(Record):
    """Many balls of one radius.

    Attributes:
        name: Name of the obstacle.
        core: (n, 3) centres [m], in the order of the tree.
        rounding: Radius of every ball [m].
        tree: (nodes, 7) tree in preorder: first centre and one past the last; index of the next node that is not a
            descendant; centre and radius of a ball that bounds its centres [m].
        sigma: Standard deviation of its position [m].
        yields: Maximum deflection [m].
    """

    name: str
    core: FloatArray
    rounding: float
    tree: FloatArray
    sigma: float = 0.0
    yields: float = 0.0

    #: Each core point is a separate ball; `excess` is the maximum distance from the obstacle [m].
    is_point_set: ClassVar[Literal[True]] = True
    excess: ClassVar[float] = 0.0

    @classmethod
    def of(cls, name: str, points: FloatArray, radius: float, sigma: float = 0.0) -> Cloud:
        """Return balls about (n, 3) points, n > 0, possibly merged.

        Points are merged if that reduces their number considerably.
        """
        from hplan.scene.cloud_tree import merged  # compiled: numba is loaded only for clouds

        # The diagonal of a voxel with this edge is twice the maximum error.
        core, growth = merged(np.array(points, dtype=np.float64, order="C"), 2.0 * MERGE_ERROR / math.sqrt(3.0))
        return cls.unmerged(name, core, radius + growth, sigma)

    @classmethod
    def unmerged(cls, name: str, points: FloatArray, radius: float, sigma: float = 0.0) -> Cloud:
        """Return balls about all (n, 3) points, n > 0."""
        from hplan.scene.cloud_tree import tree_of

        core, tree = tree_of(np.ascontiguousarray(points, dtype=np.float64), LEAF)
        return cls(name, frozen(core), radius, frozen(tree), sigma)
