"""Numbers of cells, merged points and the tree over them against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.scene.cloud_tree import box_centres, number_cells, tree_of
from hplan.scene.solids import LEAF


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(0, 500), st.sampled_from([1, 3, 10, 2**40]))
def test_cells_are_numbered_as_they_first_appear(seed, count, span):
    rows = np.random.default_rng(seed).integers(-span, span + 1, (count, 3))
    numbers, cells = number_cells(rows)
    seen: dict[tuple[int, ...], int] = {}
    expected = [seen.setdefault(tuple(row), len(seen)) for row in rows.tolist()]
    assert numbers.tolist() == expected
    assert cells == len(seen)


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 300), st.integers(1, 40))
def test_middles_of_boxes(seed, count, groups):
    rng = np.random.default_rng(seed)
    points, numbers = rng.uniform(-1, 1, (count, 3)), rng.integers(0, groups, count).astype(np.int32)
    _, numbers = np.unique(numbers, return_inverse=True)
    middles, farthest = box_centres(points, numbers.astype(np.int32), int(numbers.max()) + 1)
    for number, middle in enumerate(middles):
        inside = points[numbers == number]
        np.testing.assert_array_equal(middle, 0.5 * (inside.min(axis=0) + inside.max(axis=0)))
    assert farthest == pytest.approx(np.linalg.norm(points - middles[numbers], axis=1).max(), rel=1e-12)


@pytest.mark.parametrize("kind", ["random", "one place", "steps", "line", "sorted"])
@pytest.mark.parametrize("count", [1, LEAF + 1, 1000])
def test_a_tree_halves_its_points(kind, count):
    rng = np.random.default_rng(count)
    points = {
        "random": rng.uniform(0, 1, (count, 3)),
        "one place": np.ones((count, 3)),
        "steps": rng.integers(0, 3, (count, 3)).astype(float),
        "line": rng.uniform(0, 1, (count, 1)) * [1.0, 0.0, 0.0],
        "sorted": np.sort(rng.uniform(0, 1, (count, 3)), axis=0),
    }[kind]
    core = points.copy()
    nodes = tree_of(core, LEAF)
    assert sorted(map(tuple, core)) == sorted(map(tuple, points))
    for number, (first, last, after, *ball) in enumerate(nodes.tolist()):
        inside = core[int(first) : int(last)]
        low, high = inside.min(axis=0), inside.max(axis=0)
        np.testing.assert_array_equal(ball[:3], 0.5 * (low + high))
        assert ball[3] == pytest.approx(np.linalg.norm(inside - ball[:3], axis=1).max(), rel=1e-12)
        if after > number + 1:
            axis, middle = int(np.argmax(high - low)), (int(first) + int(last)) // 2
            assert nodes[number + 1, 1] == middle
            assert core[int(first) : middle, axis].max() <= core[middle : int(last), axis].min()
