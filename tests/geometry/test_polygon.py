"""Distances of segments from convex polygons, against dense samples."""

from __future__ import annotations

import numpy as np

from hplan.geometry.polygon import polygon_distances


def test_distances_from_polygons():
    rng = np.random.default_rng(3)
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    starts, ends = rng.uniform(-1.5, 2.5, (2, 500, 2))
    t = np.linspace(0.0, 1.0, 2001)[:, None, None]
    points = starts + t * (ends - starts)
    for polygon in (square, square[:2], square[:1]):
        size = polygon.max(axis=0)
        expected = np.linalg.norm(points - np.clip(points, 0.0, size), axis=-1).min(axis=0)
        found = polygon_distances(starts, ends, polygon)
        assert (found <= expected + 1e-12).all()
        np.testing.assert_allclose(found, expected, atol=2e-3)
    assert polygon_distances(np.array([[0.4, 0.4]]), np.array([[0.6, 0.5]]), square) == [0.0]
