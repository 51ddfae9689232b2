"""Distances of segments from segments and boxes, against references in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from segments import segment_to_box, segment_to_segment, vector

from hplan.geometry.segment_distance import off_box, off_segment


@settings(max_examples=300)
@given(vector, vector, vector, vector)
@example((0, 0, 0), (0, 0, 0), (1, 0, 0), (0, 0, 0))
@example((0, 0, 0), (0, 0, 0), (1, 1, 0), (0, -2, 0))
@example((0, 0, 0), (1, 0, 0), (2, 1, 0), (0, 0, 0))
@example((0, 0, 0), (1, 0, 0), (3, 0, 0), (-1, 0, 0))
@example((0, 0, 0), (1, 0, 0), (-2, 1, 0), (1.5, 0, 0))
@example((0, 0, 0), (1, 0, 0), (0.5, 1, 0), (2, 0, 0))
@example((0, 0, 0), (1, 0, 0), (0.5, -1, 0), (0, 2, 0))
def test_segment_to_segment(a, u, b, v):
    expected = segment_to_segment(*(np.array(x, dtype=float) for x in (a, u, b, v)))
    *off, _ = off_segment(*(tuple(map(float, x)) for x in (a, u, b, v)))
    assert np.linalg.norm(off) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-3])
def test_nearly_parallel_segments(angle):
    """Each crosses the other's plane somewhere; the error stays far below the links' tolerances."""
    rng = np.random.default_rng(6)
    for _ in range(50):
        u = rng.normal(size=3)
        turn = np.cross(u, rng.normal(size=3))
        v = rng.uniform(-2, 2) * (u + angle * turn)
        a, b = np.zeros(3), rng.uniform(-1, 2) * u + rng.choice([0.0, 0.3]) * np.cross(u, turn) / (turn @ turn) ** 0.5
        expected = segment_to_segment(a, u, b, v)
        *off, _ = off_segment(*(tuple(x.tolist()) for x in (a, u, b, v)))
        assert np.linalg.norm(off) == pytest.approx(expected, abs=2e-5 if angle else 1e-9)


@settings(max_examples=300)
@given(vector, vector, st.tuples(*[st.floats(0.01, 2.0)] * 3))
@example((-2, 0.5, 0), (4, 0, 0), (1, 0.5, 1))
@example((-2, 1.5, 0), (4, 0, 0), (1, 1, 1))
@example((-2, 2, 0), (4, -1, 0), (1, 1, 1))
@example((0, 0, 0), (0.1, 0, 0), (1, 1, 1))
@example((2, 2, 2), (0, 0, 0), (1, 1, 1))
def test_segment_to_box(a, u, half):
    expected = segment_to_box(*(np.array(x, dtype=float) for x in (a, u, half)))
    *off, _ = off_box(*(tuple(map(float, x)) for x in (a, u, half)))
    assert np.linalg.norm(off) == pytest.approx(expected, abs=1e-7)
