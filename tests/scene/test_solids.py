"""Hulls and clouds against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import ball, distances, uncovered

from hplan.scene.solids import HULL_VERTICES, MERGE_ERROR, Cloud, hull_of


def test_hull_of_a_block():
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 2) for z in (0, 3)], dtype=float)
    inner = np.random.default_rng(0).uniform(0, 1, (50, 3))
    hull = hull_of(np.vstack([inner, corners]), "block")
    assert (hull.name, hull.rounding, hull.is_point_set, hull.sigma) == ("block", 0.0, False, 0.0)
    assert sorted(map(tuple, hull.core)) == sorted(map(tuple, corners))
    assert sorted(map(tuple, hull.planes)) == sorted(
        [(1, 0, 0, 1), (-1, 0, 0, 0), (0, 1, 0, 2), (0, -1, 0, 0), (0, 0, 1, 3), (0, 0, -1, 0)]
    )
    # Twelve edges; the diagonals of the sides are none.
    assert sorted(np.linalg.norm(hull.edges[:, 3:], axis=1)) == [1] * 4 + [2] * 4 + [3] * 4
    assert not hull.core.flags.writeable
    assert not hull.planes.flags.writeable


@pytest.mark.parametrize("most", [14, 40, HULL_VERTICES])
def test_many_vertices_are_simplified_from_outside(most):
    points, _ = ball(0.2)
    hull = hull_of(points, most=most)
    assert len(hull.core) <= most
    assert 0.0 < hull.rounding < 0.2 * 4.0 / most + 0.03
    assert uncovered((hull,), points) <= 1e-7
    # Nothing of the grown hull is farther outside than the rounding, and the rounding is needed.
    exact = hull_of(points, most=10_000)
    assert exact.rounding == 0.0
    assert distances(exact, hull.core).max() <= 1e-7
    assert distances(hull, points).max() > -0.1 * hull.rounding
    assert {tuple(point) for point in hull.core} <= {tuple(point) for point in points}


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.integers(4, 300), st.floats(0.01, 1.0))
def test_hulls_hold_their_points(seed, count, flatness):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * [1.0, flatness, flatness**2]
    hull = hull_of(points, most=20)
    assert uncovered((hull,), points) <= 1e-6
    turned = hull.moved("other", np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]), np.array([1.0, 2.0, 3.0]), 0.1)
    assert (turned.name, turned.sigma, turned.rounding) == ("other", 0.1, hull.rounding)
    np.testing.assert_allclose(turned.core[:, 0], 1.0 - hull.core[:, 1])
    assert (turned.core @ turned.planes[:, :3].T <= turned.planes[:, 3] + 1e-9).all()
    assert len(turned.edges) == len(turned.core) + len(turned.planes) - 2  # Euler


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 400), st.sampled_from([1e-3, 0.02, 1.0]))
def test_balls_after_merging_hold_those_before(seed, count, size):
    points = np.random.default_rng(seed).uniform(0.0, size, (count, 3))
    cloud = Cloud.of("cloud", points, 0.01, 0.5)
    growth = cloud.rounding - 0.01
    assert 0.0 <= growth <= MERGE_ERROR + 1e-12
    gaps = np.linalg.norm(points[:, None] - cloud.core, axis=2).min(axis=1)
    assert gaps.max() <= growth + 1e-12
    assert (cloud.name, cloud.is_point_set, cloud.sigma) == ("cloud", True, 0.5)
    if size == 1.0:
        assert growth == 0.0
        assert sorted(map(tuple, cloud.core)) == sorted(map(tuple, points))
