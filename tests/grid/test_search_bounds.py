"""The bounds: admissible, consistent, and the octile one exact where no obstacle is."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from reference import make_occupancy, neighbours, shortest

from hplan.base.arrays import FloatArray
from hplan.grid.astar import _bound, row_bounds
from hplan.grid.lattice import Lattice, NodeSet

SPACES = [
    ((6, 7), [1.0, 1.0]),
    ((6, 7), [0.4, 1.7]),
    ((5, 4, 6), [1.0, 1.0, 1.0]),
    ((5, 4, 6), [2.0, 0.3, 1.1]),
    ((3, 4, 3, 4), [1.0, 0.5, 2.0, 0.8]),
]


def octile(lattice: Lattice, node: tuple[int, ...], goal: tuple[int, ...]) -> float:
    here, target = lattice.node(np.array(node)), lattice.node(np.array(goal))
    return float(_bound(lattice.row_coordinates, lattice.step, *here, target, True))


@pytest.mark.parametrize(("shape", "step"), SPACES)
def test_octile_bound_is_exact_on_an_empty_grid(shape: tuple[int, ...], step: list[float]) -> None:
    free = np.ones(shape, dtype=bool)
    lattice = Lattice.of(shape, np.array(step))
    goal = tuple(count // 3 for count in shape)
    for node in itertools.islice(np.ndindex(shape), 0, None, 3):
        cost, _ = shortest(free, np.array(node), np.array(goal), np.array(step))
        assert octile(lattice, node, goal) == pytest.approx(cost, abs=1e-12)


@pytest.mark.parametrize(("shape", "step"), SPACES)
def test_octile_bound_is_consistent(shape: tuple[int, ...], step: list[float]) -> None:
    free = np.ones(shape, dtype=bool)
    lattice = Lattice.of(shape, np.array(step))
    goal = tuple(count - 1 for count in shape)
    assert octile(lattice, goal, goal) == 0.0
    for node in np.ndindex(shape):
        for other, move in neighbours(free, node):
            cost = float(np.linalg.norm(np.array(move) * step))
            assert octile(lattice, node, goal) <= cost + octile(lattice, other, goal) + 1e-12


def _row_bound(values: FloatArray, weights: FloatArray, row: int, togo: int) -> float:
    return float((values[row] + weights * togo).max())


@pytest.mark.parametrize(("shape", "step"), SPACES)
@pytest.mark.parametrize("density", [0.0, 0.4, 0.7])
def test_row_bounds_are_consistent(shape: tuple[int, ...], step: list[float], density: float) -> None:
    free = np.random.default_rng(len(shape)).random(shape) >= density
    goal = tuple(count // 2 for count in shape)
    free[goal] = True
    lattice = Lattice.of(shape, np.array(step))
    words = lattice.bordered(make_occupancy(free, np.array(step)).free_words)
    bounds = row_bounds(lattice, NodeSet.of(words), lattice.row_of(np.array(goal)))

    def bound(node: tuple[int, ...]) -> float:
        row = lattice.row_of(np.array(node))
        return _row_bound(bounds.values, bounds.weights, row, abs(node[-1] - goal[-1]))

    assert bound(goal) == 0.0
    for node in map(tuple, np.argwhere(free).tolist()):
        for other, move in neighbours(free, node):
            cost = float(np.linalg.norm(np.array(move) * step))
            assert bound(node) <= cost + bound(other) + 1e-12
    # Zero at the goal and consistent, hence admissible; and it knows of walls.
    if density == 0.0:
        assert bounds.settled == 2 * np.prod(shape[:-1])
