"""Distances of segments in plain NumPy, a reference that shares no code with the package."""

import numpy as np


def segment_distances(a, b, c, d):
    """(n,) distances of the segments from (n, 3) a to b from the one from (3,) c to d."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv = (u * u).sum(axis=1), u @ v, float(v @ v)
    uw, vw = (u * w).sum(axis=1), w @ v
    best = np.full(len(a), np.inf)

    def take(s, t):
        np.minimum(best, np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1), out=best)

    for s in (np.zeros(len(a)), np.ones(len(a))):
        take(s, np.clip((uv * s + vw) / vv, 0.0, 1.0) if vv > 0.0 else np.zeros(len(a)))
    for t in (0.0, 1.0):
        take(np.clip((uv * t - uw) / np.maximum(uu, 1e-300), 0.0, 1.0), np.full(len(a), t))
    across = uu * vv - uv * uv
    inside = across > 1e-12 * uu * max(vv, 1e-300)
    s = np.where(inside, (uv * vw - vv * uw) / np.where(inside, across, 1.0), 0.0)
    t = np.where(inside, (uu * vw - uv * uw) / np.where(inside, across, 1.0), 0.0)
    inside &= (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    take(np.where(inside, s, 0.0), np.where(inside, t, 0.0) if vv > 0.0 else np.zeros(len(a)))
    return best
