"""Slices without a path, where each kind of restoration is needed: built on purpose, in both directions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference import assert_path, component, make_occupancy, shortest

from hplan.base.arrays import BoolArray
from hplan.grid import Fallback, SearchResult, reachable, two_level_search

SHAPE = (7, 6, 10)
STEP = np.array([1.0, 0.7, 1.3])


def walled(*walls: tuple[int, range]) -> BoolArray:
    """Free mask with a wall across axis 0 at the given places in the given slices."""
    free = np.ones(SHAPE, dtype=bool)
    for place, slices in walls:
        free[place, :, list(slices)] = False
    return free


def search(free: BoolArray, start: list[int], goal: list[int], *, octile: bool) -> SearchResult:
    result = two_level_search(make_occupancy(free, STEP), start, goal, octile=octile)
    best, _ = shortest(free, np.array(start), np.array(goal), STEP)
    if result.path is None:
        assert best == math.inf
    else:
        assert_path(free, result.path, np.array(start), np.array(goal))
        assert result.cost >= best - 1e-9
        if result.fallback == "dense":
            assert result.cost == pytest.approx(best, abs=1e-9)
    return result


@pytest.mark.parametrize("octile", [True, False])
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize(
    ("free", "restored", "fallback"),
    [
        (walled((3, range(3))), (0, 1, 2), "none"),
        (walled((3, range(7, 10))), (7, 8, 9), "none"),
        (walled((3, range(3)), (4, range(8, 10))), (0, 1, 2, 8, 9), "none"),
        (walled((3, range(3, 7))), (3, 4, 5, 6), "none"),
        (walled((3, range(2, 4)), (2, range(6, 7))), (2, 3, 6), "none"),
        (walled((2, range(5)), (4, range(5, 10))), (), "dense"),
    ],
    ids=["start", "goal", "both", "middle", "two gaps", "no feasible slice"],
)
def test_gap(free: BoolArray, restored: tuple[int, ...], fallback: Fallback, swap: bool, octile: bool) -> None:
    ends = [[0, 0, 0], [6, 5, 9]]
    start, goal = ends[::-1] if swap else ends
    result = search(free, start, goal, octile=octile)
    assert result.path is not None
    assert result.fallback == fallback
    assert result.restored_slices == restored
    assert set(result.slice_paths) == set(range(10)) - set(restored) - (
        set(range(10)) if fallback == "dense" else set()
    )


@pytest.mark.parametrize("octile", [True, False])
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("open_slices", [range(7, 10), range(1)])
def test_path_beyond_start_and_goal(open_slices: range, swap: bool, octile: bool) -> None:
    free = walled((3, range(10)))
    free[3, :, list(open_slices)] = True
    ends = [[0, 0, 2], [6, 5, 4]]
    start, goal = ends[::-1] if swap else ends
    result = search(free, start, goal, octile=octile)
    assert result.path is not None
    assert result.fallback == "all_slices"
    assert sorted(result.slice_paths) == list(open_slices)
    assert result.expansions.layers == 0
    assert result.expansions.fallback > 0
    assert result.times.fallback > 0.0


@pytest.mark.parametrize("octile", [True, False])
def test_no_path_at_all(octile: bool) -> None:
    free = walled((3, range(10)))
    result = search(free, [0, 0, 0], [6, 5, 9], octile=octile)
    assert result.path is None
    assert result.cost == math.inf
    assert result.feasible_slices is not None
    assert not result.feasible_slices.any()
    assert result.slice_paths == {}
    assert result.fallback == "dense"
    reached = reachable(make_occupancy(free, STEP), [0, 0, 0])
    assert np.array_equal(reached, component(free, np.array([0, 0, 0])))
    assert reached.sum() == 3 * 6 * 10


def test_paths_exist_in_some_slices_but_do_not_join() -> None:
    # Slice 5 is shut off from the slices of start and goal but for one hole far from any slice path.
    free = np.ones(SHAPE, dtype=bool)
    free[3, :, :4] = False
    free[:, :, 4] = False
    free[2, 5, 4] = True
    free[3, :, 6:] = False
    free[:, :, 7] = False
    free[4, 0, 7] = True
    result = search(free, [0, 0, 0], [6, 1, 9], octile=True)
    assert result.path is not None
    assert result.slice_paths.keys() == {5}
    assert result.fallback == "dense"
