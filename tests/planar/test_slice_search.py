"""Slices searched with their neighbours' bounds: each path is as short as by a separate search."""

from __future__ import annotations

import numpy as np
import pytest
from reference import assert_path, make_occupancy, path_cost

from hplan.base.arrays import BoolArray
from hplan.planar.grid import dense_search
from hplan.planar.grid.lattice import Lattice
from hplan.planar.grid.slice_search import search_slices

SIDE = 24


def drifting_discs(seed: int) -> BoolArray:
    """Occupied nodes of discs that move and grow from slice to slice; two corners stay free."""
    rng = np.random.default_rng(seed)
    i, j, k = np.indices((SIDE, SIDE, int(rng.integers(6, 40))))
    occupied = np.zeros(i.shape, dtype=np.bool_)
    for _ in range(int(rng.integers(2, 6))):
        (x, y), (dx, dy) = rng.uniform(0, SIDE, 2), rng.uniform(-0.5, 0.5, 2)
        radius = rng.uniform(1, 6) + rng.uniform(-0.2, 0.2) * k
        occupied |= np.hypot(i - x - dx * k, j - y - dy * k) <= radius
    occupied[0, 0] = occupied[-1, -1] = False
    return occupied


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("forward", [True, False])
def test_slice_path_is_as_short_as_a_search_of_its_own(seed: int, forward: bool) -> None:
    for number in range(8):
        occupied = drifting_discs(100 * seed + number)
        slices = occupied.shape[-1]
        ends = np.array([[0, 0, 0], [SIDE - 1, SIDE - 1, slices - 1]])
        start, goal = ends if forward else ends[::-1]
        space = make_occupancy(~occupied, np.array([1.0, 0.7, 1.0]))
        lattice = Lattice.build(space.grid.shape, space.grid.step)
        found = search_slices(lattice, lattice.add_border(space.free_words), start, goal, range(slices)).paths()
        for k in range(slices):
            plane = make_occupancy(~occupied[..., k], space.grid.step[:2])
            alone = dense_search(plane, start[:2], goal[:2], octile=True)
            assert (alone.path is not None) == (k in found)
            if alone.path is not None:
                path = found[k][:, :2]
                assert_path(~occupied[..., k], path, start[:2], goal[:2])
                assert path_cost(path, space.grid.step[:2]) == pytest.approx(alone.cost, abs=1e-9)
