r"""Distance between the convex hulls of two point sets: the GJK algorithm.

One of the hulls is rotated and translated. GJK searches for the point nearest to the origin in :math:`A - B`, the
differences of the points of the two hulls (Gilbert, Johnson and Keerthi 1988). It keeps a simplex of at most four
differences of corners; signed volumes give the simplex's point `v` nearest to the origin (Montanari, Petrinic and
Barbieri 2017, "Improving the GJK algorithm for faster and more reliable distance queries between convex objects"), and
the next corner `w` is the one farthest against `v`. No point of :math:`A - B` is nearer than :math:`v \cdot w / |v|`,
and `v` itself is no nearer than the nearest point. The result is the maximum of these lower bounds, so rounding errors
never make a distance too large by more than their own size.

Points, segments and flat polygons are hulls like any other. The distance is 0 if the hulls share a point;
`hplan.geometry.penetration` computes the depth.

**Support points.** A vertex at least as far in a direction as all its neighbours is the support point. So a walk from
vertex to vertex, always to the farthest neighbour, ends there. A hull with many vertices has a table of neighbours
(`corner_table`), which also holds a start vertex for each of the eight octants of directions.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import any_int, inline, kernel
from hplan.geometry.hull import CUBE_CORNERS
from hplan.geometry.planes import NO_PLANE, Plane
from hplan.geometry.sweep import STILL, Sweep, used_up
from hplan.geometry.vectors import Pose, Vector, cross, dot, placed_point, sub, turned_back

#: Range of a point set in an array of numbers: index of the first coordinate, index past the last one, and index of the
#: table (`corner_table`), `NO_TABLE` without one.
Span: TypeAlias = tuple[int, int, int]
NO_TABLE = any_int(0)

#: Layout of `work`: the simplex (four points of A - B), the matching points of A, the indices of both their corners,
#: weights; then the outputs: number of corners, the nearest points of A - B and of A, and the direction, of any length,
#: along which the two hulls are separated by the returned distance.
_CORNERS, _OF_FIRST, _NUMBERS, _WEIGHTS = any_int(0), any_int(12), any_int(24), any_int(32)
SIZE, NEAREST, ON_FIRST = any_int(36), any_int(37), any_int(40)
SEPARATING = any_int(43)
WORK = 46

#: Maximum number of corners visited, and the fraction of the simplex's size below which a distance counts as zero.
_MOST, _NONE = any_int(128), 1e-13

#: Up to this number of vertices, all of them are compared.
FEW: Final = 16

#: Number of start vertices.
OCTANTS: Final = 8

#: Initial number of corners.
_NONE_YET = any_int(0)


class Wanted(NamedTuple):
    """Requirements of a distance query.

    Attributes:
        enough: A lower bound of at least this is returned as soon as it is found [m].
        too_little: Once the distance is known to be less than this, the query may stop with any lower bound [m].
        fraction: Relative tolerance: the result may be too small by this fraction of the distance minus `radii`.
        radii: Sum of the radii that the caller subtracts from the distance [m].
        sweep: Infinity is returned as soon as this motion uses up at most the clearance along some direction.
    """

    enough: float
    too_little: float
    fraction: float
    radii: float
    sweep: Sweep = STILL


def corner_table(corners: FloatArray, first: int, table: int, faces: IntArray | None = None) -> FloatArray:
    """Return the adjacency table of a hull's vertices.

    Args:
        corners: (n, 3) vertices.
        first: Index of the first vertex coordinate in the kernel's number array, x, y, z of each vertex in turn.
        table: Index of the table in that array.
        faces: (m, 3) triangles of the hull; None if unknown.

    Returns:
        Numbers: for each octant (index 1 for x > 0, 2 for y > 0, 4 for z > 0, added) the index of a vertex; for each
            vertex, and one past the last, the index of its first neighbour in the table; the indices of the neighbours.
            Empty for at most `FEW` vertices, or vertices in one plane: then all are compared.
    """
    if len(corners) <= FEW:
        return np.zeros(0)
    # A vertex without a triangle would have no neighbours.
    if faces is None or not (np.bincount(faces.ravel(), minlength=len(corners)) > 0).all():
        from scipy.spatial import ConvexHull, QhullError

        try:
            faces = ConvexHull(corners).simplices
        except QhullError:
            return np.zeros(0)
    are_neighbours = np.zeros((len(corners), len(corners)), dtype=np.bool_)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        are_neighbours[faces[:, a], faces[:, b]] = are_neighbours[faces[:, b], faces[:, a]] = True
    here, there = np.nonzero(are_neighbours)
    begin = np.searchsorted(here, np.arange(len(corners) + 1))
    signs = CUBE_CORNERS[np.lexsort(CUBE_CORNERS.T)]  # x changes fastest
    octants = ties.on_raster(corners @ signs.T).argmax(axis=0)
    lists = table + OCTANTS + len(begin)
    return np.concatenate([first + 3 * octants, lists + begin, first + 3 * there]).astype(np.float64)


@kernel
def farthest_corner(points: FloatArray, span: Span, direction: Vector) -> int:
    """Index of the point that lies farthest in a direction."""
    (x, y, z), (first, last, table) = direction, span
    if table == NO_TABLE:
        best = first
        most = points[first] * x + points[first + 1] * y + points[first + 2] * z
        for p in range(first + 3, last, 3):
            height = points[p] * x + points[p + 1] * y + points[p + 2] * z
            if height > most:
                most, best = height, p
        return best
    octant = (1 if x > 0.0 else 0) + (2 if y > 0.0 else 0) + (4 if z > 0.0 else 0)
    best = int(points[table + octant])
    most = points[best] * x + points[best + 1] * y + points[best + 2] * z
    lists = table + OCTANTS
    while True:
        here = lists + (best - first) // 3
        before = best
        for n in range(int(points[here]), int(points[here + 1])):
            p = int(points[n])
            height = points[p] * x + points[p + 1] * y + points[p + 2] * z
            if height > most:
                most, best = height, p
        if best == before:
            return best


@kernel
def core_distance(
    shape: FloatArray,
    span: Span,
    pose: Pose,
    other: FloatArray,
    other_span: Span,
    wanted: Wanted,
    work: FloatArray,
) -> float:
    """Distance between two hulls; 0 if they share a point.

    Args:
        shape: Coordinates of points, one after the other.
        span: Range of the first hull's points.
        pose: Pose of the first hull in the frame of the other.
        other: Coordinates of points, one after the other.
        other_span: Range of the other hull's points.
        wanted: Accuracy and early exits of the query.
        work: (WORK,) buffer. On entry a direction from the other hull to the first at `NEAREST`, or zeros. On return it
            holds the nearest points, unless `enough` or `sweep` ended the query or the hulls overlap.
    """
    direction = (work[NEAREST], work[NEAREST + 1], work[NEAREST + 2])
    if direction[0] == 0.0 and direction[1] == 0.0 and direction[2] == 0.0:
        o = other_span[0]
        direction = sub(placed_point(pose, shape, span[0]), (other[o], other[o + 1], other[o + 2]))
    size, square, lower, scale = 0, math.inf, 0.0, 0.0
    work[SEPARATING], work[SEPARATING + 1], work[SEPARATING + 2] = 0.0, 0.0, 0.0
    for _ in range(_MOST):
        x, y, z = direction
        p = farthest_corner(shape, span, turned_back(pose, (-x, -y, -z)))
        o = farthest_corner(other, other_span, direction)
        a = placed_point(pose, shape, p)
        w = sub(a, (other[o], other[o + 1], other[o + 2]))
        length = math.sqrt(dot(direction, direction))
        along = dot(direction, w)
        if along > lower * length:
            lower = along / length
            work[SEPARATING], work[SEPARATING + 1], work[SEPARATING + 2] = direction
            if lower >= wanted.enough:
                return lower
            if lower - wanted.radii >= used_up(wanted.sweep, direction, length):
                return math.inf
        if size > 0:
            # The distance lies between `lower` and `length`.
            if length - lower <= wanted.fraction * abs(length - wanted.radii) or length < wanted.too_little:
                break
            if _is_known(work, size, p, o):
                break
        at, number = _CORNERS + 3 * size, _NUMBERS + 2 * size
        work[at], work[at + 1], work[at + 2] = w
        work[at + 12], work[at + 13], work[at + 14] = a
        work[number], work[number + 1] = float(p), float(o)
        size = _reduce_simplex(work, size + 1)
        scale = max(scale, dot(w, w))
        direction = (work[NEAREST], work[NEAREST + 1], work[NEAREST + 2])
        before, square = square, dot(direction, direction)
        if size == 4 or square <= _NONE * _NONE * scale:
            work[SIZE] = float(size)
            return 0.0
        if square >= before:
            break  # Only rounding errors are left.
    work[SIZE] = float(size)
    _find_point_of_first(work, size)
    return lower


@kernel
def plane_of_separation(shape: FloatArray, span: Span, pose: Pose, work: FloatArray) -> Plane:
    """Plane that touches the first hull of a query from behind.

    Its normal is the direction of the largest separation that `core_distance` found; `NO_PLANE` if it found none.
    """
    x, y, z = work[SEPARATING], work[SEPARATING + 1], work[SEPARATING + 2]
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return NO_PLANE
    normal = x / length, y / length, z / length
    corner = farthest_corner(shape, span, turned_back(pose, (-normal[0], -normal[1], -normal[2])))
    return normal, dot(normal, placed_point(pose, shape, corner))


@inline
def _is_known(work: FloatArray, size: int, p: int, o: int) -> bool:
    """True if a corner of A - B is in the simplex."""
    known = False
    for k in range(size):
        if work[_NUMBERS + 2 * k] == p and work[_NUMBERS + 2 * k + 1] == o:
            known = True
    return known


@kernel
def _find_point_of_first(work: FloatArray, size: int) -> None:
    """Write the nearest point of the first hull."""
    for c in range(3):
        value = 0.0
        for k in range(size):
            value += work[_WEIGHTS + k] * work[_OF_FIRST + 3 * k + c]
        work[ON_FIRST + c] = value


@inline
def _corner(work: FloatArray, k: int) -> Vector:
    return work[_CORNERS + 3 * k], work[_CORNERS + 3 * k + 1], work[_CORNERS + 3 * k + 2]


@kernel
def _reduce_simplex(work: FloatArray, size: int) -> int:
    """Reduce the simplex to the corners that span its nearest point.

    Writes the weights and the nearest point and returns the number of corners; four remain if the origin is inside.
    """
    a = _corner(work, 0)
    weights = (1.0, 0.0, 0.0, 0.0)
    if size == 2:
        first, second = _on_line(a, _corner(work, 1))
        weights = (first, second, 0.0, 0.0)
    elif size == 3:
        first, second, third = on_triangle(a, _corner(work, 1), _corner(work, 2))
        weights = (first, second, third, 0.0)
    elif size == 4:
        weights = _in_tetrahedron(a, _corner(work, 1), _corner(work, 2), _corner(work, 3))
    left = _NONE_YET
    for k in range(size):
        weight = weights[k]
        if weight > 0.0:
            if left < k:
                for c in range(3):
                    work[_CORNERS + 3 * left + c] = work[_CORNERS + 3 * k + c]
                    work[_OF_FIRST + 3 * left + c] = work[_OF_FIRST + 3 * k + c]
                for c in range(2):
                    work[_NUMBERS + 2 * left + c] = work[_NUMBERS + 2 * k + c]
            work[_WEIGHTS + left] = weight
            left += 1
    work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = _nearest_point(work, left)
    return left


@kernel
def _nearest_point(work: FloatArray, size: int) -> Vector:
    """The point of a simplex nearest to the origin.

    Its length is as exact as the rounding errors of the corners allow, but its direction is far more exact than that of
    the weighted sum of corners, because it is made perpendicular to the edge or face.
    """
    a = _corner(work, 0)
    x, y, z = a
    if size == 2:
        along = sub(_corner(work, 1), a)
        weight = work[_WEIGHTS + 1]
        x, y, z = x + weight * along[0], y + weight * along[1], z + weight * along[2]
        part = (x * along[0] + y * along[1] + z * along[2]) / dot(along, along)
        x, y, z = x - part * along[0], y - part * along[1], z - part * along[2]
    elif size == 3:
        normal = cross(sub(_corner(work, 1), a), sub(_corner(work, 2), a))
        part = dot(a, normal) / dot(normal, normal)
        x, y, z = part * normal[0], part * normal[1], part * normal[2]
    elif size == 4:
        x, y, z = 0.0, 0.0, 0.0
    return x, y, z


@kernel
def _on_line(a: Vector, b: Vector) -> tuple[float, float]:
    """Weights of a segment's point nearest to the origin."""
    along = sub(b, a)
    square = dot(along, along)
    t = min(1.0, max(0.0, -dot(a, along) / square)) if square > 0.0 else 0.0
    return 1.0 - t, t


@kernel
def _square_at(a: Vector, b: Vector, t: float) -> float:
    """Squared distance from the origin of a point on segment ab."""
    x, y, z = a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])
    return x * x + y * y + z * z


@kernel
def on_triangle(a: Vector, b: Vector, c: Vector) -> tuple[float, float, float]:
    """Weights of a triangle's point nearest to the origin.

    Areas are compared in the coordinate plane in which the triangle's projection is largest. If the projection of the
    origin lies beyond an edge, the nearest point is on one of the edges that it lies beyond.
    """
    normal = cross(sub(b, a), sub(c, a))
    square = dot(normal, normal)
    at_a, at_b, at_c, area = -1.0, -1.0, -1.0, 1.0
    if square > 0.0:
        up = dot(a, normal) / square
        foot = (up * normal[0], up * normal[1], up * normal[2])
        fa, fb, fc = sub(a, foot), sub(b, foot), sub(c, foot)
        nx, ny, nz = abs(normal[0]), abs(normal[1]), abs(normal[2])
        if nx >= ny and nx >= nz:
            area = normal[0]
            at_a, at_b, at_c = (
                fb[1] * fc[2] - fb[2] * fc[1],
                fc[1] * fa[2] - fc[2] * fa[1],
                fa[1] * fb[2] - fa[2] * fb[1],
            )
        elif ny >= nz:
            area = normal[1]
            at_a, at_b, at_c = (
                fb[2] * fc[0] - fb[0] * fc[2],
                fc[2] * fa[0] - fc[0] * fa[2],
                fa[2] * fb[0] - fa[0] * fb[2],
            )
        else:
            area = normal[2]
            at_a, at_b, at_c = (
                fb[0] * fc[1] - fb[1] * fc[0],
                fc[0] * fa[1] - fc[1] * fa[0],
                fa[0] * fb[1] - fa[1] * fb[0],
            )
        if area < 0.0:
            area, at_a, at_b, at_c = -area, -at_a, -at_b, -at_c
        if at_a > 0.0 and at_b > 0.0 and at_c > 0.0:
            whole = at_a + at_b + at_c
            return at_a / whole, at_b / whole, at_c / whole
    least, weights = math.inf, (1.0, 0.0, 0.0)
    if at_c <= 0.0:
        _, t = _on_line(a, b)
        least, weights = _square_at(a, b, t), (1.0 - t, t, 0.0)
    if at_b <= 0.0:
        _, t = _on_line(a, c)
        here = _square_at(a, c, t)
        if here < least:
            least, weights = here, (1.0 - t, 0.0, t)
    if at_a <= 0.0:
        _, t = _on_line(b, c)
        if _square_at(b, c, t) < least:
            weights = (0.0, 1.0 - t, t)
    return weights


@kernel
def _square_of(a: Vector, b: Vector, c: Vector, weights: Vector) -> float:
    """Squared distance from the origin of a point of a triangle."""
    x = weights[0] * a[0] + weights[1] * b[0] + weights[2] * c[0]
    y = weights[0] * a[1] + weights[1] * b[1] + weights[2] * c[1]
    z = weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2]
    return x * x + y * y + z * z


@kernel
def _in_tetrahedron(a: Vector, b: Vector, c: Vector, d: Vector) -> tuple[float, float, float, float]:
    """Weights of a tetrahedron's point nearest to the origin.

    They are all positive if the origin is inside. In that case each of the four volumes between the origin and a face
    has the sign of the whole volume; otherwise the nearest point lies on one of the faces that the origin lies beyond.
    """
    da, db, dc = sub(a, d), sub(b, d), sub(c, d)
    back = (-d[0], -d[1], -d[2])
    across = cross(db, dc)
    whole = dot(da, across)
    at_a = dot(back, across)
    at_b = dot(da, cross(back, dc))
    at_c = dot(da, cross(db, back))
    at_d = dot(a, cross(b, c))
    sign = 1.0 if whole > 0.0 else -1.0 if whole < 0.0 else 0.0
    at_a, at_b, at_c, at_d = sign * at_a, sign * at_b, sign * at_c, sign * at_d
    if at_a > 0.0 and at_b > 0.0 and at_c > 0.0 and at_d > 0.0:
        whole = at_a + at_b + at_c + at_d
        return at_a / whole, at_b / whole, at_c / whole, at_d / whole
    least, weights = math.inf, (1.0, 0.0, 0.0, 0.0)
    if at_d <= 0.0:
        u, v, w = on_triangle(a, b, c)
        least, weights = _square_of(a, b, c, (u, v, w)), (u, v, w, 0.0)
    if at_c <= 0.0:
        u, v, w = on_triangle(a, b, d)
        here = _square_of(a, b, d, (u, v, w))
        if here < least:
            least, weights = here, (u, v, 0.0, w)
    if at_b <= 0.0:
        u, v, w = on_triangle(a, c, d)
        here = _square_of(a, c, d, (u, v, w))
        if here < least:
            least, weights = here, (u, 0.0, v, w)
    if at_a <= 0.0:
        u, v, w = on_triangle(b, c, d)
        if _square_of(b, c, d, (u, v, w)) < least:
            weights = (0.0, u, v, w)
    return weights
