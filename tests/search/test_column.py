"""Fold, turn, unfold: the nearest column by brute force, and the path through it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import assert_path, component, make_occupancy

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.search import two_level_search
from hplan.search.astar import astar
from hplan.search.column import by_column
from hplan.search.lattice import Lattice, NodeSet


def plain(lattice: Lattice, free, start: IntArray, goal: IntArray):
    """A slice search for `by_column`."""
    path, _, expansions = astar(lattice, NodeSet.of(free), start, goal, octile=True)
    return path, expansions, 0


def column_of(free: BoolArray, step: FloatArray, start: IntArray, goal: IntArray) -> IntArray | None:
    space = make_occupancy(free, step)
    lattice = Lattice.of(space.grid.shape, space.grid.step)
    path, _, flooded = by_column(lattice, lattice.bordered(space.free_words), start, goal, plain)
    ends = [component(free[..., node[-1]], node[:-1]) for node in (start, goal)]
    assert flooded == sum(int(end.sum()) for end in ends)
    return path


def check(free: BoolArray, step: FloatArray, start: IntArray, goal: IntArray) -> None:
    path = column_of(free, step, start, goal)
    low, high = sorted((int(start[-1]), int(goal[-1])))
    common = free[..., low : high + 1].all(axis=-1)
    for node in (start, goal):
        common &= component(free[..., node[-1]], node[:-1])
    assert (path is None) == (not common.any())
    if path is None:
        return
    assert_path(free, path, start, goal)
    # It turns in one place, and no other place is nearer to both ends together.
    turning = path[np.flatnonzero(np.diff(path[:, -1]))]
    assert (turning[:, :-1] == turning[:1, :-1]).all()
    if low < high:
        assert (np.abs(np.diff(path[:, -1])) * np.any(np.diff(path[:, :-1], axis=0), axis=1) == 0).all()
        places = np.argwhere(common)
        least = min(
            float(np.linalg.norm((p - start[:-1]) * step[:-1]) + np.linalg.norm((p - goal[:-1]) * step[:-1]))
            for p in places
        )
        place = turning[0, :-1]
        length = np.linalg.norm((place - start[:-1]) * step[:-1]) + np.linalg.norm((place - goal[:-1]) * step[:-1])
        assert length == pytest.approx(least, abs=1e-9)


@settings(max_examples=200)
@given(
    shape=st.one_of(st.tuples(*[st.integers(1, 7)] * 3), st.tuples(*[st.integers(1, 4)] * 4)),
    density=st.sampled_from([0.0, 0.1, 0.3, 0.5]),
    seed=st.integers(0, 2**32 - 1),
)
def test_small_masks(shape: tuple[int, ...], density: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    free = rng.random(shape) >= density
    start, goal = (np.array([rng.integers(count) for count in shape]) for _ in range(2))
    free[tuple(start)] = free[tuple(goal)] = True
    check(free, rng.uniform(0.5, 2.0, len(shape)), start, goal)


@pytest.mark.parametrize("length", [64, 65, 130])
@pytest.mark.parametrize("first", [0, 1, 62, 63])
def test_word_boundaries(length: int, first: int) -> None:
    """Between two ends that are free alone, a single obstacle closes a column from end to end, and no farther."""
    for last in {min(66, length - 1), length - 1} - {first, first + 1}:
        for barred in range(length):
            start, goal = np.array([0, 1, first]), np.array([0, 1, last])
            free = np.zeros((1, 2, length), dtype=bool)
            free[0, 0] = True
            free[0, 0, barred] = False
            free[tuple(start)] = free[tuple(goal)] = True
            path = column_of(free, np.ones(3), start, goal)
            assert (path is None) == (first <= barred <= last)


def test_the_two_level_search_folds_where_slices_do_not_join() -> None:
    """Between the ends every slice has a wall of its own, which only the folded place is clear of."""
    free = np.ones((9, 9, 9, 12), dtype=bool)
    for k in range(1, 11):
        free[..., k] = False
        free[0, 0, 0, k] = True
    start, goal = np.array([8, 8, 8, 0]), np.array([8, 8, 0, 11])
    result = two_level_search(make_occupancy(free, np.ones(4)), start, goal)
    assert result.fallback == "column"
    assert_path(free, result.path, start, goal)
    np.testing.assert_array_equal(result.path[np.flatnonzero(np.diff(result.path[:, -1]))][:, :-1], np.zeros((11, 3)))
