"""Distances of segments in plain NumPy, a reference that shares no code with the package."""

import numpy as np


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
