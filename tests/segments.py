"""Distances of segments in plain NumPy, a reference that shares no code with the package."""

import numpy as np
from hypothesis import strategies as st

#: Coordinates and points: many are multiples of a half, so that they coincide or line up.
lattice = st.integers(-4, 4).map(lambda i: 0.5 * i)
number = st.one_of(lattice, st.floats(-2.0, 2.0, width=32).map(lambda x: 0.0 if abs(x) < 1e-4 else x))
vector = st.tuples(number, number, number)


def segment_distances(a, b, c, d):
    """(...,) distances of segments a to b from segments c to d, of (..., 2) or (..., 3) points.

    All the c and d may be one point each, and the same.
    """

    def dot(x, y):
        return (x * y).sum(axis=-1)

    def share(part, whole):
        return np.clip(part / np.where(whole > 0.0, whole, 1.0), 0.0, 1.0)

    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    across = uu * vv - uv * uv
    crosses = across > 1e-12 * uu * vv
    safe = np.where(crosses, across, 1.0)
    s, t = (np.where(crosses, part / safe, 0.0) for part in (uv * vw - vv * uw, uu * vw - uv * uw))
    inside = crosses & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    zero, one = np.zeros_like(uw), np.ones_like(uw)
    places = [(zero, share(vw, vv)), (one, share(uv + vw, vv)), (share(-uw, uu), zero), (share(uv - uw, uu), one)]
    places.append((np.where(inside, s, 0.0), np.where(inside, t, places[0][1])))
    return np.min([np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1) for s, t in places], axis=0)


def point_to_segment(point, start, along):
    square = along @ along
    t = 0.0 if square == 0.0 else np.clip((point - start) @ along / square, 0.0, 1.0)
    return np.linalg.norm(point - start - t * along)


def segment_to_segment(a, u, b, v):
    """Minimum distance over the ends of both segments and over their interiors.

    The interiors count if the lines' nearest points are there.
    """
    ends = [
        point_to_segment(a, b, v),
        point_to_segment(a + u, b, v),
        point_to_segment(b, a, u),
        point_to_segment(b + v, a, u),
    ]
    (s, t), _, rank, _ = np.linalg.lstsq(np.stack([u, -v], axis=1), b - a, rcond=1e-12)
    if rank == 2 and 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
        ends.append(np.linalg.norm(a + s * u - b - t * v))
    return min(ends)


def segment_to_box(a, u, half):
    """Ternary search: the distance of a point from a convex body is convex along the segment."""

    def distance(t):
        return np.linalg.norm(np.maximum(np.abs(a + t * u) - half, 0.0))

    low, high = 0.0, 1.0
    for _ in range(150):
        third = (high - low) / 3.0
        if distance(low + third) <= distance(high - third):
            high -= third
        else:
            low += third
    return min(distance(t) for t in (0.0, low, high, 1.0))
