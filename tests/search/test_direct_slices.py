"""Paths as short as on an empty plane, against Dijkstra's algorithm."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import make_occupancy, path_cost, shortest

from hplan.base.arrays import BoolArray, IntArray
from hplan.search.direct_slices import DirectPaths, PlaneEnds, direct_paths, with_others
from hplan.search.lattice import Lattice


def paths_of(free: BoolArray, start: list[int], goal: list[int], wanted: range) -> tuple[DirectPaths, list[IntArray]]:
    """The paths, and for each slice its (m, 2) places."""
    lattice = Lattice.of(free.shape, np.ones(3))
    words = lattice.bordered(make_occupancy(free, np.ones(3)).free_words)
    rows = [lattice.row_of(np.array([*place, 0])) for place in (start, goal)]
    found = direct_paths(words, PlaneEnds(lattice.padded[1], *rows), lattice.mask(wanted), wanted[0])
    path_rows, begins = with_others(found, np.empty(0, dtype=np.int64), np.zeros(len(wanted) + 1, dtype=np.int64))
    return found, [lattice.row_coordinates[path_rows[a:b]] for a, b in itertools.pairwise(begins)]


@settings(max_examples=60)
@given(
    shape=st.tuples(st.integers(1, 8), st.integers(1, 8), st.sampled_from([1, 3, 64, 65, 130])),
    density=st.sampled_from([0.0, 0.1, 0.3, 0.5]),
    step=st.tuples(st.sampled_from([1.0, 0.7]), st.sampled_from([1.0, 1.3])),
    seed=st.integers(0, 2**32 - 1),
)
def test_found_exactly_where_a_slice_has_one(
    shape: tuple[int, int, int], density: float, step: tuple[float, float], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    free = rng.random(shape) >= density
    start, goal = ([int(rng.integers(count)) for count in shape[:2]] for _ in range(2))
    wanted = range(shape[2] // 4, shape[2])
    found, paths = paths_of(free, start, goal, wanted)
    empty, _ = shortest(np.ones(shape[:2], dtype=bool), np.array(start), np.array(goal), np.array(step))
    assert len(paths) == len(wanted)
    for number, path in zip(wanted, paths, strict=True):
        cost, _ = shortest(free[..., number], np.array(start), np.array(goal), np.array(step))
        assert (len(path) > 0) == math.isclose(cost, empty, abs_tol=1e-9)
        other = (int(found.others[number // 64]) >> (number % 64)) & 1
        assert other == (len(path) == 0 and free[*start, number] and free[*goal, number])
        if len(path):
            assert path[0].tolist() == start
            assert path[-1].tolist() == goal
            assert free[path[:, 0], path[:, 1], number].all()
            assert path_cost(path, step) == pytest.approx(empty, abs=1e-9)
            assert np.abs(np.diff(path, axis=0)).max(initial=0) <= 1
    assert found.reached >= sum(len(path) for path in paths) - (len(paths) if start == goal else 0)


def test_diagonal_moves_come_first() -> None:
    _, (path,) = paths_of(np.ones((6, 9, 1), dtype=bool), [4, 1], [2, 7], range(1))
    assert path.tolist() == [[4, 1], [3, 2], [2, 3], [2, 4], [2, 5], [2, 6], [2, 7]]


def test_other_slices_keep_their_paths() -> None:
    free = np.ones((3, 3, 4), dtype=bool)
    free[1, 1, 1:3] = False
    lattice = Lattice.of(free.shape, np.ones(3))
    words = lattice.bordered(make_occupancy(free, np.ones(3)).free_words)
    start, goal = (lattice.row_of(np.array([place, place, 0])) for place in (0, 2))
    found = direct_paths(words, PlaneEnds(lattice.padded[1], start, goal), lattice.mask(range(4)), 0)
    rows, begins = with_others(found, np.array([7, 8, 9]), np.array([0, 0, 0, 3, 3]))
    assert begins.tolist() == [0, 3, 3, 6, 9]
    assert rows[3:6].tolist() == [7, 8, 9]
    assert rows[:3].tolist() == rows[6:].tolist()
