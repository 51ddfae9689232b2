"""Points, segments and convex polygons in the plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hplan.base.arrays import FloatArray


def convex_hull(points: FloatArray) -> FloatArray:
    """Counter-clockwise convex hull (Andrew's monotone chain).

    1 or 2 points if all points are collinear.
    """
    ordered = sorted({(float(x), float(y)) for x, y in points})
    if len(ordered) <= 2:
        return np.array(ordered)

    def half(sequence: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for point in sequence:
            while len(chain) >= 2 and _turn(chain[-2], chain[-1], point) <= 0.0:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return np.array(half(ordered) + half(ordered[::-1]))


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def polygon_distances(starts: FloatArray, ends: FloatArray, polygon: FloatArray) -> FloatArray:
    """Distances of segments from a convex polygon, 0 if they intersect.

    Args:
        starts: (n, 2) start points of the segments.
        ends: (n, 2) end points of the segments.
        polygon: (k, 2) vertices, counter-clockwise for k >= 3; k = 2 is a segment, k = 1 a point.

    Returns:
        (n,) distances.
    """
    a, b = polygon, np.roll(polygon, -1, axis=0)
    starts, ends = starts[:, None], ends[:, None]
    sides, links = b - a, ends - starts
    from_a, from_b = starts - a, starts - b
    turns = _cross(sides, from_a)
    least = np.minimum(_point_distances(from_a, sides), _point_distances(ends - a, sides))
    least = np.minimum(least, np.minimum(_point_distances(-from_a, links), _point_distances(-from_b, links)))
    # A segment and a side cross if the ends of each are on different sides of the other.
    crossing = (turns * _cross(sides, ends - a) < 0.0) & (_cross(links, from_a) * _cross(links, from_b) < 0.0)
    distances: FloatArray = np.where(crossing, 0.0, least).min(axis=1)
    inside = (turns >= 0.0).all(axis=1) if len(polygon) >= 3 else np.zeros(len(distances), dtype=np.bool_)
    return np.where(inside, 0.0, distances)


def _point_distances(offsets: FloatArray, along: FloatArray) -> FloatArray:
    """Distances of points from segments; offsets are from the segments' start points."""
    square = _dot(along, along)
    t = np.clip(_dot(offsets, along) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    rest = offsets - t[..., None] * along
    distances: FloatArray = np.sqrt(_dot(rest, rest))
    return distances


def _dot(u: FloatArray, v: FloatArray) -> FloatArray:
    # Several times faster than NumPy's sum over a last axis of length two.
    product: FloatArray = u[..., 0] * v[..., 0] + u[..., 1] * v[..., 1]
    return product


def _cross(u: FloatArray, v: FloatArray) -> FloatArray:
    product: FloatArray = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    return product
