"""All searches against Dijkstra's algorithm and the plain two levels, on random masks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reference import assert_path, component, make_occupancy, path_cost, shortest, slice_paths, union_mask

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.grid import dense_search, reachable, slices_with_path, two_level_search

STEPS = [1.0, 1.0, 0.3, 2.5, 0.01]


def check(free: BoolArray, start: IntArray, goal: IntArray, step: FloatArray, *, octile: bool) -> None:
    """Everything that must hold of the searches on one mask."""
    space = make_occupancy(free, step)
    best, _ = shortest(free, start, goal, step)
    dense = dense_search(space, start, goal, octile=octile)
    two_level = two_level_search(space, start, goal, octile=octile)
    assert (dense.path is None) == (best == math.inf)
    assert (two_level.path is None) == (best == math.inf)
    if dense.path is not None and two_level.path is not None:
        assert dense.cost == pytest.approx(best, abs=1e-9)
        assert two_level.cost >= best - 1e-9
        for result in (dense, two_level):
            assert_path(free, result.path, start, goal)
            assert path_cost(result.path, step) == pytest.approx(result.cost, abs=1e-9)

    # Each slice: a path exactly where there is one, and a shortest.
    expected = slice_paths(free, start, goal, step)
    own = {number: path for number, path in two_level.slice_paths.items() if number in expected}
    assert own.keys() == expected.keys()
    for number, path in two_level.slice_paths.items():
        ends = [[*start[:-1], number], [*goal[:-1], number]]
        assert_path(free, path, *ends)
    for number, path in own.items():
        cost, least = path_cost(path, step), path_cost(expected[number], step)
        assert cost == pytest.approx(least, abs=1e-9)
    assert two_level.layers is not None
    searched = range(two_level.layers.first, two_level.layers.first + len(two_level.layers.begins) - 1)
    connected = slices_with_path(space, start, goal)
    for number in range(free.shape[-1]):
        here = free[(*start[:-1], number)] and component(free[..., number], start[:-1])[tuple(goal[:-1])]
        assert connected[number] == here
        assert two_level.layers.feasible[number] == (here and number in searched)

    # The sparse graph is the plain one, and its search is exact.
    union = union_mask(free, own, start, goal)
    on_union, _ = shortest(union, start, goal, step)
    assert (two_level.fallback == "none") == (on_union < math.inf)
    if two_level.fallback == "none":
        assert two_level.cost == pytest.approx(on_union, abs=1e-9)
        assert two_level.sparse_nodes == union.sum()


def random_case(
    rng: np.random.Generator, shape: tuple[int, ...], density: float
) -> tuple[BoolArray, IntArray, IntArray, FloatArray]:
    """Free mask, two free nodes, steps."""
    free = rng.random(shape) >= density
    start, goal = (np.array([rng.integers(count) for count in shape]) for _ in range(2))
    free[tuple(start)] = free[tuple(goal)] = True
    return free, start, goal, rng.choice(STEPS, len(shape))


@settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow])
@given(
    shape=st.one_of(
        st.tuples(st.integers(1, 14), st.integers(1, 14)),
        st.tuples(st.integers(1, 7), st.integers(1, 7), st.integers(1, 7)),
        st.tuples(*[st.integers(1, 4)] * 4),
    ),
    density=st.sampled_from([0.0, 0.1, 0.3, 0.5, 0.6]),
    octile=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_small_masks(shape: tuple[int, ...], density: float, octile: bool, seed: int) -> None:
    check(*random_case(np.random.default_rng(seed), shape, density), octile=octile)


@pytest.mark.parametrize("length", [62, 63, 64, 65, 130])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_word_boundaries(axis: int, length: int) -> None:
    rng = np.random.default_rng([axis, length])
    shape = [4, 4, 4]
    shape[axis] = length
    for density in (0.2, 0.45):
        free, start, goal, step = random_case(rng, tuple(shape), density)
        start[axis], goal[axis] = rng.permutation([int(rng.integers(3)), length - 1 - int(rng.integers(3))])
        free[tuple(start)] = free[tuple(goal)] = True
        check(free, start, goal, step, octile=True)


@pytest.mark.parametrize("shape", [(64, 65), (130, 3), (3, 130), (1, 70), (70, 1)])
def test_word_boundaries_in_the_plane(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(shape)
    for octile in (True, False):
        check(*random_case(rng, shape, 0.3), octile=octile)


@pytest.mark.parametrize("seed", range(6))
def test_rooms_and_discs(seed: int) -> None:
    """Larger planes with walls, holes and round obstacles, where scans are long and corners many."""
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(20, 70)), int(rng.integers(20, 70)), 3)
    free = np.ones(shape, dtype=bool)
    i, j = np.indices(shape[:2])
    for number in range(shape[2]):
        for _ in range(int(rng.integers(2, 12))):
            if rng.random() < 0.5:
                along = int(rng.integers(2))
                place = int(rng.integers(shape[along]))
                wall = (i, j)[along] == place
                wall &= np.abs((j, i)[along] - int(rng.integers(shape[1 - along]))) > int(rng.integers(3))
                free[wall, number] = False
            else:
                centre, radius = rng.uniform(0, shape[:2]), rng.uniform(1, 12)
                free[(i - centre[0]) ** 2 + (j - centre[1]) ** 2 < radius**2, number] = False
    nodes = np.argwhere(free)
    start, goal = nodes[rng.integers(len(nodes), size=2)]
    start[2], goal[2] = 0, 2
    free[tuple(start)] = free[tuple(goal)] = True
    check(free, start, goal, rng.choice(STEPS, 3), octile=True)


@pytest.mark.parametrize("shape", [(30, 40), (7, 9, 70), (9, 66, 5), (4, 3, 5, 6)])
@pytest.mark.parametrize("density", [0.0, 0.4, 0.7])
def test_reachable_is_the_component(shape: tuple[int, ...], density: float) -> None:
    free, start, _, step = random_case(np.random.default_rng(len(shape)), shape, density)
    assert np.array_equal(reachable(make_occupancy(free, step), start), component(free, start))
