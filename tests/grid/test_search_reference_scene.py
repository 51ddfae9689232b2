"""Values of the reference scene and of the paper's demonstration, and what every result must keep."""

from __future__ import annotations

import numpy as np
import pytest
from reference import assert_path, make_occupancy
from studies.paper.random_scenes import disc_occupancy

from hplan.grid import dense_search, slices_with_path, two_level_search
from hplan.grid.grid import Grid, Occupancy
from hplan.grid.sections import LinkModel

START, GOAL = [0, 0, 0], [45, 60, 70]
DISC = np.array([[1.0, 1.3, 0.15]])


@pytest.fixture(scope="module")
def table_1() -> Occupancy:
    return disc_occupancy(DISC)


@pytest.fixture(scope="module")
def demonstration() -> Occupancy:
    """The paper's workspace: a ball in the middle of 21 layers."""
    grid = Grid.over([0, 0, 5], [60, 60, 25], 1.0)
    mesh = np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)
    return Occupancy.from_mask(grid, np.linalg.norm(mesh - [30, 30, 15], axis=-1) <= 7.5)


@pytest.mark.parametrize(
    ("model", "cost", "first"),
    [("capsule", 145.2149523784, 45), ("paper", 145.2149523784, 45), ("rectangle", 143.558098, 40)],
)
def test_reference_scene(model: LinkModel, cost: float, first: int) -> None:
    scene = disc_occupancy(DISC, model)
    free = ~scene.occupied
    for octile in (True, False):
        result = two_level_search(scene, START, GOAL, octile=octile)
        assert result.path is not None
        assert result.feasible_slices is not None
        assert np.degrees(result.cost) == pytest.approx(cost, abs=1e-6)
        assert len(result.path) == 107
        assert_path(free, result.path, START, GOAL)
        assert np.flatnonzero(result.feasible_slices).tolist() == list(range(first, 71))
        assert np.flatnonzero(slices_with_path(scene, START, GOAL)).tolist() == list(range(first, 91))
        assert sorted(result.slice_paths) == list(range(first, 71))
        assert result.restored_slices == tuple(range(first))
        assert result.fallback == "none"


def test_dense_costs_what_two_level_does(table_1: Occupancy) -> None:
    for octile in (True, False):
        result = dense_search(table_1, START, GOAL, octile=octile)
        assert np.degrees(result.cost) == pytest.approx(145.2149523784, abs=1e-9)
        assert result.path is not None
        assert_path(~table_1.occupied, result.path, START, GOAL)
        assert 140_000 < result.expansions.total < 154_700


def test_paper_settings_keep_their_counts(table_1: Occupancy) -> None:
    expansions = two_level_search(table_1, START, GOAL, octile=False).expansions
    assert expansions.layers == pytest.approx(52_948, rel=0.01)
    assert expansions.sparse == pytest.approx(5_412, rel=0.02)
    assert expansions.fallback == 0


def test_fewer_expansions_by_default(table_1: Occupancy) -> None:
    result = two_level_search(table_1, START, GOAL)
    assert 26 <= result.expansions.layers < 1_000
    assert 1_000 < result.expansions.sparse < 5_000
    assert result.expansions.total == result.expansions.layers + result.expansions.sparse
    assert result.sparse_nodes < 7_000


def test_workspace_demonstration(demonstration: Occupancy) -> None:
    start, goal = demonstration.grid.nearest([5, 10, 5]), demonstration.grid.nearest([55, 50, 25])
    dense = dense_search(demonstration, start, goal)
    for octile in (True, False):
        result = two_level_search(demonstration, start, goal, octile=octile)
        assert result.path is not None
        assert_path(~demonstration.occupied, result.path, start, goal)
        assert len(result.slice_paths) == 21
        assert result.fallback == "none"
        assert dense.cost - 1e-9 <= result.cost <= 1.05 * dense.cost


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 6), (3, 4, 3, 5)])
@pytest.mark.parametrize("octile", [True, False])
def test_start_is_the_goal(shape: tuple[int, ...], octile: bool) -> None:
    space = make_occupancy(np.ones(shape, dtype=bool), np.ones(len(shape)))
    node = [1] * len(shape)
    for search in (two_level_search, dense_search):
        result = search(space, node, node, octile=octile)
        assert result.path is not None
        assert result.path.tolist() == [node]
        assert result.cost == 0.0
