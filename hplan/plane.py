"""Points, segments and convex polygons of a plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hplan.arrays import BoolArray, FloatArray


def convex_hull(points: FloatArray) -> FloatArray:
    """Counter-clockwise convex hull (Andrew's monotone chain); 1 or 2 points where they are all in line."""
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
    """Distances of segments from a convex polygon, 0 where they meet.

    Args:
        starts: (n, 2) one end of each segment.
        ends: (n, 2) the other.
        polygon: (k, 2) corners, counter-clockwise where there are three or more; two are a segment, one is a point.

    Returns:
        (n,) distances.
    """
    least = np.full(len(starts), np.inf)
    inside = np.full(len(starts), len(polygon) >= 3)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        least = np.minimum(least, _segment_distances(starts, ends, a, b))
        inside &= _cross(b - a, starts - a) >= 0.0
    return np.where(inside, 0.0, least)


def _segment_distances(starts: FloatArray, ends: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,) distances of segments from one segment."""
    least = np.minimum(_point_distances(starts, a, b - a), _point_distances(ends, a, b - a))
    for end in (a, b):
        least = np.minimum(least, _point_distances(end, starts, ends - starts))
    # Their ends are nearest to one another but where they cross.
    return np.where(_apart(starts, ends, a, b) | _apart(a, b, starts, ends), least, 0.0)


def _apart(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> BoolArray:
    """Whether c and d are not on different sides of the line through a and b."""
    apart: BoolArray = _cross(b - a, c - a) * _cross(b - a, d - a) >= 0.0
    return apart


def _point_distances(points: FloatArray, starts: FloatArray, along: FloatArray) -> FloatArray:
    """Distances of points from segments, either of them one or n."""
    square = (along**2).sum(axis=-1)
    offsets = points - starts
    t = np.clip((offsets * along).sum(axis=-1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    distances: FloatArray = np.linalg.norm(offsets - t[..., None] * along, axis=-1)
    return distances


def _cross(u: FloatArray, v: FloatArray) -> FloatArray:
    product: FloatArray = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    return product
