"""Reachable states: the compiled search against sets of tuples on small random grids."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from hplan.base.arrays import BoolArray
from hplan.planning.lower_bound.reachability import Samples, is_reachable


def plain(free: BoolArray, samples: Samples) -> bool:
    """By the definition: states are a cell and the move to the next one."""
    first, last, first_of, last_of, steps = samples
    most = first_of.shape[1] // 2

    def inside(k: int, cell: tuple[int, ...]) -> bool:
        within = all(max(first[k, a], 0) <= cell[a] <= min(last[k, a], free.shape[a] - 1) for a in range(3))
        return within and bool(free[cell])

    def keeps(k: int, cell: tuple[int, ...], move: int) -> bool:
        return bool(first_of[k, move + most] <= cell[0] <= last_of[k, move + most])

    moves = range(-most, most + 1)
    cells = list(product(*map(range, free.shape)))
    states = {(cell, move) for cell in cells for move in moves if inside(0, cell) and keeps(0, cell, move)}
    for k in range(1, len(first)):
        reached = set()
        for (i, x, y), move in states:
            for dx, dy in product(range(-steps[1], steps[1] + 1), range(-steps[2], steps[2] + 1)):
                cell = (i + move, x + dx, y + dy)
                if inside(k, cell):
                    reached |= {(cell, move)}
        if k == len(first) - 1:
            return bool(reached)
        states = {
            (cell, move + change)
            for cell, move in reached
            for change in range(-steps[0], steps[0] + 1)
            if abs(move + change) <= most and keeps(k, cell, move + change)
        }
    return False


def packed(free: BoolArray):
    """Rows of bits along the first axis."""
    wide = np.zeros((*free.shape[1:], 64 * (-(-free.shape[0] // 64))), dtype=np.uint8)
    wide[..., : free.shape[0]] = np.moveaxis(free, 0, -1)
    return np.packbits(wide, axis=-1, bitorder="little").view(np.uint64)


def drawn(random: np.random.Generator, count: int) -> tuple[BoolArray, Samples]:
    """A grid of few free cells, and bounds that shrink to one cell at both ends."""
    shape = np.array([count, random.integers(1, 6), random.integers(1, 6)])
    free = random.random(shape) < random.uniform(0.3, 0.9)
    samples, most = int(random.integers(3, 8)), int(random.integers(1, 5 if count < 64 else 40))
    low = random.integers(0, shape, size=(samples, 3))
    first = np.maximum(low - random.integers(0, shape, size=(samples, 3)), 0)
    last = np.minimum(low + random.integers(0, shape, size=(samples, 3)), shape - 1)
    first[[0, -1]] = last[[0, -1]] = low[[0, -1]]
    free[tuple(first[0])] = free[tuple(first[-1])] = True
    first_of = random.integers(0, count // 2, size=(samples, 2 * most + 1))
    last_of = np.minimum(first_of + random.integers(-1, count, size=first_of.shape), count - 1)
    first_of, last_of = np.maximum(first_of, first[:, :1]), np.minimum(last_of, last[:, :1])
    first_of[0], last_of[0] = first[0, 0], last[0, 0]
    return free, Samples(first, last, first_of, last_of, random.integers(0, 3, size=3))


@pytest.mark.parametrize("count", [7, 64, 140])
def test_as_by_sets_of_states(count: int) -> None:
    random, found = np.random.default_rng(count), []
    for _ in range(60 if count < 64 else 8):
        free, samples = drawn(random, count)
        found.append(is_reachable(packed(free), samples))
        assert found[-1] == plain(free, samples)
    assert 0.05 < np.mean(found) < 0.95


def test_a_wall_has_to_be_passed_by_its_gap_and_takes_the_time_for_it() -> None:
    free = np.ones((9, 9, 1), dtype=np.bool_)
    free[:, 4, :] = False
    free[0, 4, 0] = True

    def reaches(samples: int) -> bool:
        first, last = np.zeros((samples, 3), dtype=np.int64), np.tile([8, 8, 0], (samples, 1))
        first[0] = last[0] = (8, 0, 0)
        first[-1] = last[-1] = (8, 8, 0)
        of = np.repeat(first[:, :1], 3, axis=1), np.repeat(last[:, :1], 3, axis=1)
        return is_reachable(packed(free), Samples(first, last, *of, np.array([1, 1, 0])))

    # Eight steps to the gap, in it once, eight back; the move takes a step to be turned about.
    assert next(samples for samples in range(2, 24) if reaches(samples)) == 18
