"""Compiled distances of points from solids: the arm's bodies and ignored objects."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, TableArray
from hplan.base.kernels import kernel
from hplan.collision import compiled_obstacles as row
from hplan.geometry.segment_distance import point_hull, point_segment
from hplan.geometry.vectors import Vector, sub, vector_of


class Bodies(NamedTuple):
    """Solids grown by a padding, from `hplan.collision.compiled_obstacles.solid_rows`."""

    rows: TableArray
    data: FloatArray


@kernel
def distance_from_bodies(point: Vector, rows: TableArray, data: FloatArray, enough: float) -> float:
    """Distance of a point from the nearest solid [m].

    Negative inside its rounding; infinite above `enough`.
    """
    least, still, following = math.inf, (0.0, 0.0, 0.0), 0
    limit = enough
    while following < len(rows):
        solid = rows[following]
        dx, dy, dz = solid.centre[0] - point[0], solid.centre[1] - point[1], solid.centre[2] - point[2]
        within = limit + solid.bound
        kind = solid.kind
        if dx * dx + dy * dy + dz * dz > within * within or within < 0.0:
            following = solid.next if kind >= row.NODE else following + 1
            continue
        following += 1
        apart = math.inf
        if kind == row.POINT:
            apart = math.sqrt(dx * dx + dy * dy + dz * dz)
        elif kind == row.SEGMENT:
            start = vector_of(solid.start)
            apart = point_segment(point, start, sub(vector_of(solid.end), start))
        elif kind == row.BOX:
            apart = _box_distance((-dx, -dy, -dz), rows, following - 1)
        elif kind == row.HULL:
            most = limit + solid.radius
            apart = point_hull(point, data, solid.first, solid.edges, solid.last, most)
            if apart >= most and apart > 0.0:  # The distance may exceed this number.
                continue
        elif kind == row.LEAF:
            for p in range(solid.first, solid.last, 3):
                apart = min(apart, point_segment((data[p], data[p + 1], data[p + 2]), point, still))
        least = min(least, apart - solid.radius)
        limit = min(limit, least)
    return least if least <= enough else math.inf


@kernel
def _box_distance(offset: Vector, rows: TableArray, s: int) -> float:
    """Distance of a point from a box [m].

    `offset` is the point relative to the box's centre.
    """
    square, (x, y, z), half, axes = 0.0, offset, rows[s].half, rows[s].axes
    for axis in range(3):
        along = x * axes[3 * axis] + y * axes[3 * axis + 1] + z * axes[3 * axis + 2]
        beyond = max(0.0, abs(along) - half[axis])
        square += beyond * beyond
    return math.sqrt(square)


@kernel
def _distances_from_bodies(
    points: FloatArray, rows: TableArray, data: FloatArray, enough: float, found: FloatArray
) -> None:
    for n in range(points.shape[0]):
        found[n] = distance_from_bodies((points[n, 0], points[n, 1], points[n, 2]), rows, data, enough)


def distances_from_bodies(
    points: FloatArray, rows: TableArray, data: FloatArray, enough: float = math.inf
) -> FloatArray:
    """(n,) distances of (n, 3) points from the nearest solid [m].

    Negative inside its rounding. Infinite above `enough`, and without any solid.
    """
    found = np.empty(len(points))
    _distances_from_bodies(np.array(points, dtype=np.float64, order="C"), rows, data, enough, found)
    return found
