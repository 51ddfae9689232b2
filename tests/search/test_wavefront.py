"""The two wavefronts against a plain breadth-first search."""

from __future__ import annotations

from collections import deque
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import assert_path, component, make_occupancy

from hplan.base.arrays import BoolArray, IntArray
from hplan.search.lattice import Lattice
from hplan.search.wavefront import Wavefronts, meet


def fronts_of(free: BoolArray, start: IntArray, goal: IntArray) -> tuple[Wavefronts, Lattice]:
    step = np.linspace(1.0, 2.0, free.ndim)
    space = make_occupancy(free, step)
    lattice = Lattice.of(space.grid.shape, space.grid.step)
    return meet(lattice, lattice.bordered(space.free_words), start, goal), lattice


def fewest_moves(free: BoolArray, start: IntArray, goal: IntArray) -> int | None:
    """Moves of a shortest path, by a queue of single nodes."""
    level = {tuple(start): 0}
    queue = deque([tuple(start)])
    while queue:
        node = queue.popleft()
        if node == tuple(goal):
            return level[node]
        for move in product((-1, 0, 1), repeat=free.ndim):
            other = tuple(a + b for a, b in zip(node, move, strict=True))
            inside = all(0 <= a < n for a, n in zip(other, free.shape, strict=True))
            if inside and free[other] and other not in level:
                level[other] = level[node] + 1
                queue.append(other)
    return None


def check(free: BoolArray, start: IntArray, goal: IntArray) -> None:
    fronts, lattice = fronts_of(free, start, goal)
    moves = fewest_moves(free, start, goal)
    if moves is not None:
        assert fronts.path is not None
        assert_path(free, fronts.path, start, goal)
        assert len(fronts.path) == moves + 1
        assert fronts.enclosed == ""
        return
    assert fronts.path is None
    end = {"start": start, "goal": goal}[fronts.enclosed]
    bits = np.unpackbits(lattice.unbordered(fronts.reached).view(np.uint8), axis=1, bitorder="little")
    reached = bits[:, : free.shape[-1]].reshape(free.shape).astype(bool)
    np.testing.assert_array_equal(reached, component(free, end))


@settings(max_examples=150)
@given(
    shape=st.one_of(
        st.tuples(st.integers(1, 20), st.integers(1, 20)),
        st.tuples(*[st.integers(1, 7)] * 3),
        st.tuples(*[st.integers(1, 4)] * 4),
    ),
    density=st.sampled_from([0.0, 0.3, 0.5, 0.7, 0.9]),
    seed=st.integers(0, 2**32 - 1),
)
def test_small_masks(shape: tuple[int, ...], density: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    free = rng.random(shape) >= density
    start, goal = (np.array([rng.integers(count) for count in shape]) for _ in range(2))
    free[tuple(start)] = free[tuple(goal)] = True
    check(free, start, goal)


@pytest.mark.parametrize("length", [63, 64, 65, 128, 129])
def test_word_boundaries(length: int) -> None:
    rng = np.random.default_rng(length)
    free = rng.random((3, 3, 3, length)) >= 0.5
    start, goal = np.array([1, 1, 1, 0]), np.array([2, 0, 1, length - 1])
    free[tuple(start)] = free[tuple(goal)] = True
    check(free, start, goal)


@pytest.mark.parametrize("length", [64, 128])
def test_the_last_node_of_a_row_is_no_neighbour_of_the_first_of_the_next(length: int) -> None:
    """Neither upwards nor downwards, though their words stand side by side."""
    for rows in ((1, 2), (2, 1)):
        free = np.zeros((3, 4, length), dtype=bool)
        last, first = np.array([1, rows[0], length - 1]), np.array([1, rows[1], 0])
        free[tuple(last)] = free[tuple(first)] = True
        check(free, last, first)
        check(free, first, last)


def test_a_node_to_itself() -> None:
    fronts, _ = fronts_of(np.ones((3, 3, 3, 3), dtype=bool), np.ones(4, dtype=int), np.ones(4, dtype=int))
    np.testing.assert_array_equal(fronts.path, [[1, 1, 1, 1]])


def test_any_of_several_ends() -> None:
    """The nearest pair is joined; ends that are enclosed do no harm while another pair is connected."""
    free = np.ones((12, 12, 12), dtype=bool)
    free[5] = False
    free[5, 3, 3] = True
    starts, goals = np.array([[0, 0, 0], [3, 3, 3]]), np.array([[11, 11, 11], [6, 3, 4], [6, 9, 9]])
    fronts, _ = fronts_of(free, starts, goals)
    np.testing.assert_array_equal(fronts.path[[0, -1]], [[3, 3, 3], [6, 3, 4]])
    assert len(fronts.path) == 4
    free[5, 3, 3] = False
    fronts, _ = fronts_of(free, starts, goals)
    assert fronts.path is None


@pytest.mark.parametrize("density", [0.2, 0.35, 0.5, 0.65])
def test_asked_by_a_flood_first(monkeypatch: pytest.MonkeyPatch, density: float) -> None:
    """Where wavefronts have gone on for long, a flood says whether they can meet; the answers stay the same."""
    step = np.ones(4)
    for seed in range(12):
        rng = np.random.default_rng([seed, int(100 * density)])
        free = rng.random((6, 7, 8, 70)) >= density
        start, goal = (np.array([rng.integers(count) for count in free.shape]) for _ in range(2))
        free[tuple(start)] = free[tuple(goal)] = True
        lattice = Lattice.of(free.shape, step)
        words = lattice.bordered(make_occupancy(free, step).free_words)
        patient = meet(lattice, words, start, goal)
        monkeypatch.setattr("hplan.search.wavefront.PATIENT", 3)
        asked = meet(lattice, words, start, goal)
        monkeypatch.undo()
        assert (patient.path is None) == (asked.path is None)
        if patient.path is not None and asked.path is not None:
            np.testing.assert_array_equal(patient.path, asked.path)
            continue
        end = start if asked.enclosed == "start" else goal
        bits = np.unpackbits(lattice.unbordered(asked.reached).view(np.uint8), axis=1, bitorder="little")
        np.testing.assert_array_equal(bits[:, :70].reshape(free.shape).astype(bool), component(free, end))
        other = goal if asked.enclosed == "start" else start
        assert component(free, end).sum() <= component(free, other).sum()
