"""Distances of segments against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hplan.collision.body_kernels import off_body, off_row
from hplan.collision.distances import off_box, off_segment
from hplan.collision.obstacle_rows import AXES, BOUND, BOX, CENTRE, KIND, SHAPE
from hplan.collision.placed_bodies import ALONG, PLACED, START
from hplan.scene.solids import rpy_rotation

lattice = st.integers(-4, 4).map(lambda i: 0.5 * i)
number = st.one_of(lattice, st.floats(-2.0, 2.0, width=32).map(lambda x: 0.0 if abs(x) < 1e-4 else x))
vector = st.tuples(number, number, number)


def point_to_segment(point, start, along):
    square = along @ along
    t = 0.0 if square == 0.0 else np.clip((point - start) @ along / square, 0.0, 1.0)
    return np.linalg.norm(point - start - t * along)


def segment_to_segment(a, u, b, v):
    """Least over the ends of both, and over the inside of both where the lines' nearest points lie there."""
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


@settings(max_examples=300)
@given(vector, vector, vector, vector, st.sampled_from([1.0, 1e-3, 1e-6, 1e-7, 1e-9]))
def test_what_vectors_between_segments_show_is_no_more_than_their_distance(a, u, b, turn, angle):
    """Of segments that are nearly parallel the vector may end beside the nearest points."""
    a, u, b, v = (np.array(x, dtype=float) for x in (a, u, b, np.array(u) + angle * np.array(turn)))
    placed = np.zeros((2, PLACED))
    placed[:, START:ALONG], placed[:, ALONG:PLACED] = [a, b], [u, v]
    *off, t, shown = off_body(placed, 0, 1)
    nearest = min(
        np.linalg.norm(a + s * u - b - r * v)
        for s, r in [(t, np.clip((a + t * u - b) @ v / max(v @ v, 1e-300), 0.0, 1.0)), *settled(a, u, b, v)]
    )
    assert shown <= nearest + 1e-12
    assert np.linalg.norm(off) >= nearest - 1e-9
    if angle == 1.0:
        assert shown == pytest.approx(nearest, abs=1e-7)


def settled(a, u, b, v):
    """Places on two segments, each nearest to the other's, from several on."""
    for s in (0.0, 0.5, 1.0):
        for _ in range(100):
            r = np.clip((a + s * u - b) @ v / max(v @ v, 1e-300), 0.0, 1.0)
            s = np.clip((b + r * v - a) @ u / max(u @ u, 1e-300), 0.0, 1.0)
        yield s, r


@settings(max_examples=300)
@given(vector, vector, st.tuples(*[st.floats(0.01, 2.0)] * 3), st.integers(0, 2**32 - 1))
def test_what_vectors_from_boxes_show_is_their_distance(a, u, half, seed):
    a, u, half = (np.array(x, dtype=float) for x in (a, u, half))
    rng = np.random.default_rng(seed)
    turn = rpy_rotation(*rng.uniform(-3.0, 3.0, 3))
    solid, placed = np.zeros((1, 21)), np.zeros((1, PLACED))
    solid[0, KIND], solid[0, SHAPE : SHAPE + 3], solid[0, AXES : AXES + 9] = BOX, half, turn.ravel()
    solid[0, CENTRE:BOUND] = centre = rng.uniform(-1.0, 1.0, 3)
    placed[0, START:ALONG], placed[0, ALONG:PLACED] = centre + a @ turn, u @ turn  # rows of `turn`: axes of the box
    *off, _, shown = off_row(placed, 0, solid, 0)
    expected = segment_to_box(a, u, half)
    assert np.linalg.norm(off) == pytest.approx(expected, abs=1e-7)
    assert shown <= expected + 1e-12
    assert expected < 1e-6 or shown == pytest.approx(expected, abs=1e-7)
