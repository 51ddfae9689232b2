r"""Penetration depth of two convex hulls: the minimum translation that separates them.

For every direction `n`, a translation by the support :math:`h(n)` of the differences of their points separates them;
the depth is the minimum of these numbers. The directions are the face normals of a polytope of corners of :math:`A - B`
that grows by the corner farthest beyond its face nearest to the origin (the expanding polytope algorithm, van den
Bergen 2001). It starts from any tetrahedron: the origin need not be inside. The result is the minimum :math:`h` of all
normals tried, so it is never less than the depth, and it equals the depth if the polytope was finished within `_MOST`
corners.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import any_int, kernel
from hplan.geometry.convex_distance import NEAREST, ON_FIRST, Span, farthest_corner, on_triangle
from hplan.geometry.vectors import Pose, Vector, cross, dot, placed_point, sub, turned_back

#: Two hulls: point coordinates, range and pose of the first; point coordinates and range of the other.
HullPair: TypeAlias = tuple[FloatArray, Span, Pose, FloatArray, Span]

#: Maximum number of corners of the polytope, and of faces ever created.
_MOST, _FACES, _NONE_YET = any_int(64), any_int(1024), any_int(0)

#: Points within this fraction of the polytope's size lie on a face; edges and volumes below the second fraction are
#: degenerate.
_ON_FACE, _FLAT = 1e-12, 1e-9

#: Columns of a face: its corners, and 1 while no corner is beyond it.
_STANDS = any_int(3)


@kernel
def penetration(hulls: HullPair, work: FloatArray) -> float:
    """Penetration depth of two overlapping hulls.

    0 if the differences of their points span no volume.

    Args:
        hulls: The two, as for `hplan.geometry.convex_distance.core_distance`.
        work: (WORK,) buffer. In the entries of the nearest points it receives the shortest translation of the other
            hull that separates the two, and the first hull's point that is deepest in the other.
    """
    corners, of_first, planes = np.empty((_MOST, 3)), np.empty((_MOST, 3)), np.empty((_FACES, 4))
    faces, edges = np.empty((_FACES, 4), dtype=np.int64), np.empty((_FACES, 2), dtype=np.int64)
    for c in range(3):
        work[NEAREST + c] = 0.0
    scale = _tetrahedron(hulls, corners, of_first)
    if scale == 0.0:
        return 0.0
    made, depth = _NONE_YET, math.inf
    for i in range(4):
        made = _add_face(corners, ((i + 1) % 4, (i + 2) % 4, (i + 3) % 4), planes, faces, made)
    for count in range(4, _MOST + 1):
        nearest = _nearest_face(planes, faces, made)
        if nearest < 0:
            break
        normal = (planes[nearest, 0], planes[nearest, 1], planes[nearest, 2])
        w, a = _difference(hulls, normal)
        height = dot(normal, w)
        if height < depth:
            depth = height
            for c in range(3):
                work[NEAREST + c] = height * normal[c]
        if height - planes[nearest, 3] <= _ON_FACE * scale or count == _MOST or made + 2 * count > _FACES:
            break
        corners[count, 0], corners[count, 1], corners[count, 2] = w
        of_first[count, 0], of_first[count, 1], of_first[count, 2] = a
        made = _grow_hull(corners, count, _ON_FACE * scale, planes, faces, edges, made)
    _find_deepest(corners, of_first, planes, faces[:made], depth + 1e-9 * scale, work)
    return max(0.0, depth) if depth < math.inf else 0.0


@kernel
def _find_deepest(
    corners: FloatArray, of_first: FloatArray, planes: FloatArray, faces: IntArray, depth: float, work: FloatArray
) -> None:
    """Write the first hull's point that is deepest in the other.

    It is the point of the nearest face that is nearest to the origin; several triangles may form that face.
    """
    least = math.inf
    for f in range(faces.shape[0]):
        if faces[f, _STANDS] == 0 or planes[f, 3] > depth:
            continue
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        u, v, w = on_triangle(_corner_of(corners, i), _corner_of(corners, j), _corner_of(corners, k))
        square = 0.0
        for c in range(3):
            square += (u * corners[i, c] + v * corners[j, c] + w * corners[k, c]) ** 2
        if square < least:
            least = square
            for c in range(3):
                work[ON_FIRST + c] = u * of_first[i, c] + v * of_first[j, c] + w * of_first[k, c]


@kernel
def _corner_of(corners: FloatArray, i: int) -> Vector:
    return corners[i, 0], corners[i, 1], corners[i, 2]


@kernel
def _difference(hulls: HullPair, direction: Vector) -> tuple[Vector, Vector]:
    """Support corner of A - B in a direction.

    Also returns the corner's point of A.
    """
    shape, span, pose, other, other_span = hulls
    p = farthest_corner(shape, span, turned_back(pose, direction))
    o = farthest_corner(other, other_span, (-direction[0], -direction[1], -direction[2]))
    a = placed_point(pose, shape, p)
    return sub(a, (other[o], other[o + 1], other[o + 2])), a


@kernel
def _tetrahedron(hulls: HullPair, corners: FloatArray, of_first: FloatArray) -> float:
    """Write four corners of A - B that span a volume.

    Also writes their points of A. Returns the size, 0 if all corners lie in a plane.
    """
    size = 0.0
    first, point = _difference(hulls, (1.0, 0.0, 0.0))
    corners[0, 0], corners[0, 1], corners[0, 2] = first
    of_first[0, 0], of_first[0, 1], of_first[0, 2] = point
    along, normal = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for count in range(1, 4):
        most, best, best_point = 0.0, first, point
        for attempt in range(6):
            axis, sign = attempt // 2, 1.0 - 2.0 * (attempt % 2)
            unit = (sign if axis == 0 else 0.0, sign if axis == 1 else 0.0, sign if axis == 2 else 0.0)
            direction = unit
            if count == 2:
                direction = cross(along, unit)
            elif count == 3:
                direction = (sign * normal[0], sign * normal[1], sign * normal[2])
            if dot(direction, direction) <= 1e-4:
                continue  # Perpendicular to a segment along this axis.
            w, a = _difference(hulls, direction)
            off = sub(w, first)
            if count == 1:
                away = math.sqrt(dot(off, off))
            elif count == 2:
                aside = cross(along, off)
                away = math.sqrt(dot(aside, aside))
            else:
                away = abs(dot(normal, off))
            if away > most:
                most, best, best_point = away, w, a
        size = max(size, most)
        if most <= _FLAT * size:
            return 0.0
        corners[count, 0], corners[count, 1], corners[count, 2] = best
        of_first[count, 0], of_first[count, 1], of_first[count, 2] = best_point
        off = sub(best, first)
        if count == 1:
            along = (off[0] / most, off[1] / most, off[2] / most)
        elif count == 2:
            across = cross(along, off)
            normal = (across[0] / most, across[1] / most, across[2] / most)
    return size


@kernel
def _add_face(
    corners: FloatArray, triangle: tuple[int, int, int], planes: FloatArray, faces: IntArray, made: int
) -> int:
    """Write a face and return the number of faces.

    The centre of the first tetrahedron lies behind its plane. A degenerate face is not written.
    """
    i, j, k = triangle
    a, b, c = _corner_of(corners, i), _corner_of(corners, j), _corner_of(corners, k)
    normal = cross(sub(b, a), sub(c, a))
    length = math.sqrt(dot(normal, normal))
    if length == 0.0:
        return made
    x, y, z = normal[0] / length, normal[1] / length, normal[2] / length
    offset, middle = x * a[0] + y * a[1] + z * a[2], 0.0
    for m in range(4):
        middle += 0.25 * (x * corners[m, 0] + y * corners[m, 1] + z * corners[m, 2])
    if middle > offset:
        x, y, z, offset, j, k = -x, -y, -z, -offset, k, j
    planes[made, 0], planes[made, 1], planes[made, 2], planes[made, 3] = x, y, z, offset
    faces[made, 0], faces[made, 1], faces[made, 2], faces[made, _STANDS] = i, j, k, 1
    return made + 1


@kernel
def _nearest_face(planes: FloatArray, faces: IntArray, made: int) -> int:
    """Index of the face with the minimum plane offset; else -1."""
    nearest, least = -1, math.inf
    for f in range(made):
        if faces[f, _STANDS] == 1 and planes[f, 3] < least:
            nearest, least = f, planes[f, 3]
    return nearest


@kernel
def _grow_hull(
    corners: FloatArray, count: int, rounding: float, planes: FloatArray, faces: IntArray, edges: IntArray, made: int
) -> int:
    """Replace the faces that a corner lies beyond by faces with it."""
    new, open_edges = _corner_of(corners, count), 0
    for f in range(made):
        if faces[f, _STANDS] == 0 or dot((planes[f, 0], planes[f, 1], planes[f, 2]), new) <= planes[f, 3] + rounding:
            continue
        faces[f, _STANDS] = 0
        for side in range(3):
            start, end = faces[f, side], faces[f, (side + 1) % 3]
            twin = -1
            for e in range(open_edges):
                if edges[e, 0] == end and edges[e, 1] == start:
                    twin = e
            if twin >= 0:
                open_edges -= 1
                edges[twin, 0], edges[twin, 1] = edges[open_edges, 0], edges[open_edges, 1]
            else:
                edges[open_edges, 0], edges[open_edges, 1] = start, end
                open_edges += 1
    for e in range(min(open_edges, len(faces) - made)):
        made = _add_face(corners, (edges[e, 0], edges[e, 1], count), planes, faces, made)
    return made
