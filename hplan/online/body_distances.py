"""Compiled distances of points from solids: the arm's bodies and ignored objects."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.kernels import kernel
from hplan.collision import obstacle_rows as row
from hplan.geometry.segment_distance import point_hull, point_segment
from hplan.geometry.vectors import Vector


class Bodies(NamedTuple):
    """Solids grown by a padding, from `hplan.collision.obstacle_rows.solid_rows`."""

    rows: FloatArray
    data: FloatArray


@kernel
def distance_from_bodies(point: Vector, rows: FloatArray, data: FloatArray, enough: float) -> float:
    """Distance of a point from the nearest solid [m].

    Negative inside its rounding; infinite above `enough`.
    """
    least, still, following = math.inf, (0.0, 0.0, 0.0), 0
    limit = enough
    while following < rows.shape[0]:
        s = following
        following = s + 1
        dx, dy, dz = (
            rows[s, row.CENTRE] - point[0],
            rows[s, row.CENTRE + 1] - point[1],
            rows[s, row.CENTRE + 2] - point[2],
        )
        within = limit + rows[s, row.BOUND]
        kind = rows[s, row.KIND]
        if dx * dx + dy * dy + dz * dz > within * within or within < 0.0:
            following = int(rows[s, row.NEXT]) if kind >= row.NODE else s + 1
            continue
        ax, ay, az = rows[s, row.SHAPE], rows[s, row.SHAPE + 1], rows[s, row.SHAPE + 2]
        apart = math.inf
        if kind == row.POINT:
            apart = math.sqrt(dx * dx + dy * dy + dz * dz)
        elif kind == row.SEGMENT:
            bx, by, bz = rows[s, row.SECOND_END], rows[s, row.SECOND_END + 1], rows[s, row.SECOND_END + 2]
            apart = point_segment(point, (ax, ay, az), (bx - ax, by - ay, bz - az))
        elif kind == row.BOX:
            apart = _box_distance((-dx, -dy, -dz), rows[s])
        elif kind == row.HULL:
            most = limit + rows[s, row.RADIUS]
            apart = point_hull(point, data, int(ax), int(ay), int(az), most)
            if apart >= most and apart > 0.0:  # The distance may exceed this number.
                continue
        elif kind == row.LEAF:
            for p in range(int(rows[s, row.POINTS]), int(rows[s, row.POINTS_END]), 3):
                apart = min(apart, point_segment((data[p], data[p + 1], data[p + 2]), point, still))
        least = min(least, apart - rows[s, row.RADIUS])
        limit = min(limit, least)
    return least if least <= enough else math.inf


@kernel
def _box_distance(offset: Vector, solid: FloatArray) -> float:
    """Distance of a point from a box [m].

    `offset` is the point relative to the box's centre.
    """
    square, (x, y, z) = 0.0, offset
    for axis in range(3):
        a = row.AXES + 3 * axis
        along = x * solid[a] + y * solid[a + 1] + z * solid[a + 2]
        beyond = max(0.0, abs(along) - solid[row.SHAPE + axis])
        square += beyond * beyond
    return math.sqrt(square)


@kernel
def _distances_from_bodies(
    points: FloatArray, rows: FloatArray, data: FloatArray, enough: float, found: FloatArray
) -> None:
    for n in range(points.shape[0]):
        found[n] = distance_from_bodies((points[n, 0], points[n, 1], points[n, 2]), rows, data, enough)


def distances_from_bodies(
    points: FloatArray, rows: FloatArray, data: FloatArray, enough: float = math.inf
) -> FloatArray:
    """(n,) distances of (n, 3) points from the nearest solid [m].

    Negative inside its rounding. Infinite above `enough`, and without any solid.
    """
    found = np.empty(len(points))
    _distances_from_bodies(np.array(points, dtype=np.float64, order="C"), rows, data, enough, found)
    return found
