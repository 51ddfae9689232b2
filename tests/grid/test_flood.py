"""Floods across the words of 64 slices: two neighbours alone, however they lie to each other."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from reference import component, make_occupancy

from hplan.grid.flood import flood_slices, reachable
from hplan.grid.lattice import Lattice

#: Slices on either side of where one word ends and the next begins, and the ends of the axis.
EDGES = (0, 62, 63, 64, 65, 127, 128, 129)


@pytest.mark.parametrize("shape", [(4, 130), (3, 4, 130), (3, 3, 3, 130), (3, 4, 64)])
def test_two_neighbours_are_joined(shape: tuple[int, ...]) -> None:
    middle = [count // 2 for count in shape[:-1]]
    for bit in (bit for bit in EDGES if bit < shape[-1]):
        first = np.array([*middle, bit])
        for move in itertools.product((-1, 0, 1), repeat=len(shape)):
            second = first + move
            if not any(move) or not (0 <= second[-1] < shape[-1]):
                continue
            free = np.zeros(shape, dtype=bool)
            free[tuple(first)] = free[tuple(second)] = True
            reached = reachable(make_occupancy(free, np.ones(len(shape))), first)
            np.testing.assert_array_equal(reached, free, err_msg=f"{first} and {second}")


@pytest.mark.parametrize("bit", EDGES)
@pytest.mark.parametrize("apart", [(2, 0, 0), (0, 2, 0), (0, 0, 2), (2, 2, 2), (1, 1, 2), (1, 2, -1)])
def test_nodes_two_apart_are_not(bit: int, apart: tuple[int, int, int]) -> None:
    shape = (4, 4, 132)
    first = np.array([1, 1, bit])
    second = first + apart
    if second[-1] < 0:
        return
    free = np.zeros(shape, dtype=bool)
    free[tuple(first)] = free[tuple(second)] = True
    reached = reachable(make_occupancy(free, np.ones(3)), first)
    assert reached.sum() == 1
    assert reached[tuple(first)]


def test_slices_are_flooded_each_on_its_own() -> None:
    rng = np.random.default_rng(0)
    free = rng.random((6, 7, 130)) < 0.6
    start = np.array([2, 3, 0])
    free[2, 3] = True
    space = make_occupancy(free, np.ones(3))
    lattice = Lattice.of(space.grid.shape, space.grid.step)
    words = lattice.bordered(space.free_words)
    reached, count = flood_slices(lattice, words, lattice.row_of(start), lattice.mask(range(130)))
    bits = np.unpackbits(lattice.unbordered(reached).view(np.uint8), axis=1, bitorder="little")
    ours = bits[:, :130].reshape(free.shape).astype(bool)
    for number in range(130):
        np.testing.assert_array_equal(ours[..., number], component(free[..., number], start[:2]))
    assert count == ours.sum()
