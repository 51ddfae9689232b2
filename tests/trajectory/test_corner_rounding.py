"""The path keeps to the polyline, in turn, within the deviation."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hplan.trajectory.corner_rounding import largest_deviation, rounded_path


def frechet_distance_is_within(curve: np.ndarray, points: np.ndarray, bound: float) -> bool:
    """Whether dense points of two curves can be gone through side by side within a bound (discrete Frechet)."""
    near = np.linalg.norm(curve[:, None] - points[None], axis=2) <= bound
    reach = np.zeros_like(near)
    for i, j in itertools.product(*map(range, near.shape)):
        before = (i == 0 and j == 0) or reach[max(i - 1, 0) : i + 1, max(j - 1, 0) : j + 1].any()
        reach[i, j] = near[i, j] and before
    return bool(reach[-1, -1])


coordinate = st.one_of(
    st.floats(-3.0, 3.0), st.sampled_from([0.0, 1.0, 1.0 + 1e-9, 1.0 - 1e-6, 1.01, -1.0]), st.floats(-1e-6, 1e-6)
)
polylines = npst.arrays(np.float64, st.tuples(st.integers(2, 9), st.integers(1, 4)), elements=coordinate)


@settings(max_examples=300)
@given(polylines, st.sampled_from([1e-4, 1e-2, 0.1, 1.0]))
@example(np.array([[0.0], [1.0], [0.0]]), 0.1)
@example(np.array([[0.0, 0], [1, 0], [0, 1e-9], [1, 1]]), 0.01)
@example(np.array([[0.0, 0], [1, 0], [1, 1e-4], [0, 1e-4]]), 0.01)
@example(np.array([[0.0, 0], [1e-7, 0], [1e-7, 1e-7], [1, 1]]), 1e-4)
def test_path_keeps_to_the_polyline(points, deviation):
    path = rounded_path(points, deviation)
    curve = path.evaluate(np.linspace(0.0, path.end, 4000))
    assert largest_deviation(curve, points) <= deviation + 1e-12
    np.testing.assert_allclose(path.evaluate([0.0, path.end]), points[[0, -1]], rtol=1e-15, atol=2e-9)
    # Joint limits that the waypoints keep.
    assert (path.pieces >= points.min(axis=0) - 1e-12).all()
    assert (path.pieces <= points.max(axis=0) + 1e-12).all()
    assert (np.diff(path.breaks) > 0.0).all()
    # Every waypoint is passed, in turn: none before the one it follows.
    distance = np.linalg.norm(curve[:, None] - points[None], axis=2) <= deviation + path.end / 4000
    at = 0
    for passed in distance.T:
        assert passed[at:].any()
        at += int(passed[at:].argmax())


@settings(max_examples=40)
@given(polylines, st.sampled_from([0.03, 0.3]))
def test_path_runs_along_the_polyline(points, deviation):
    path = rounded_path(points, deviation)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assume(length < 15.0)
    step = 0.05
    curve = path.evaluate(np.linspace(0.0, path.end, 2 + int(path.end / step)))
    pieces = [
        a + (b - a) * np.linspace(0, 1, 2 + int(np.linalg.norm(b - a) / step))[:, None]
        for a, b in itertools.pairwise(points)
    ]
    assert frechet_distance_is_within(curve, np.concatenate(pieces), deviation + step)


def test_deviation_is_used():
    """At a lone corner the path passes the corner at just what thinning leaves of the deviation."""
    path = rounded_path([[0, 0], [1, 0], [1, 1]], 0.02)
    s = np.linspace(0, path.end, 20_001)
    assert np.linalg.norm(path.evaluate(s) - [1, 0], axis=1).min() == pytest.approx(0.015, rel=1e-6)


def test_parameter_is_the_length_and_curvature_is_continuous():
    path = rounded_path([[0, 0], [1, 0], [1, 2]], 0.02)
    speed = np.linalg.norm(path.evaluate(np.linspace(0, path.end, 1000), 1), axis=1)
    assert speed.max() == pytest.approx(1.0)
    assert np.median(speed) == pytest.approx(1.0)
    for at in path.breaks[1:-1]:
        sides = path.evaluate([at - 1e-9, at + 1e-9], 2)
        np.testing.assert_allclose(sides[0], sides[1], atol=1e-5)
