"""The paper's method to the letter, in a page of plain code."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from hplan.arrays import BoolArray, IntArray
from hplan.grid import Grid, Occupancy
from hplan.search import SearchResult, dense_search


@dataclass(frozen=True, eq=False)
class PlainTwoLevel:
    """The two levels to the letter of the paper.

    Attributes:
        paths: Slice -> (m, 3) path, for the slices that have one.
        heads: Slice -> (k, 3) part of the first path that restoration keeps there.
        expansions: Slice -> nodes expanded there.
        union: (N1, N2, N3) mask of the sparse graph's nodes.
        second: Search on the union.
        layer_s: Time of the slices [s].
        total_s: Time of all of it [s].
    """

    paths: dict[int, IntArray]
    heads: dict[int, IntArray]
    expansions: dict[int, int]
    union: BoolArray
    second: SearchResult
    layer_s: float
    total_s: float


def plain_two_level(occupancy: Occupancy, start: IntArray, goal: IntArray) -> PlainTwoLevel:
    """A* in every slice from the start's to the goal's, restoration on the start's side, A* on the union."""
    begin = time.perf_counter()
    flat = _slice_grid(occupancy.grid)
    paths: dict[int, IntArray] = {}
    expansions: dict[int, int] = {}
    for number in range(int(start[2]), int(goal[2]) + 1):
        layer = Occupancy.from_mask(flat, occupancy.occupied[:, :, number])
        result = dense_search(layer, start[:2], goal[:2])
        expansions[number] = result.expansions.total
        if result.path is not None:
            paths[number] = at_height(result.path, number)
    layers_done = time.perf_counter()
    heads = carried_back(occupancy, paths, int(start[2]))
    union, second = second_level(occupancy, [*paths.values(), *heads.values()], start, goal)
    done = time.perf_counter()
    return PlainTwoLevel(paths, heads, expansions, union, second, layers_done - begin, done - begin)


def carried_back(occupancy: Occupancy, paths: dict[int, IntArray], start_slice: int) -> dict[int, IntArray]:
    """Carry the first slice path back to the start's slice, cutting it in each slice before the first contact."""
    heads: dict[int, IntArray] = {}
    if not paths:
        return heads
    first = min(paths)
    kept = paths[first][:, :2]
    for number in range(first - 1, start_slice - 1, -1):
        blocked = np.flatnonzero(occupancy.occupied[kept[:, 0], kept[:, 1], number])
        kept = kept[: blocked[0]] if len(blocked) else kept
        heads[number] = at_height(kept, number)
    return heads


def second_level(
    occupancy: Occupancy, pieces: list[IntArray], start: IntArray, goal: IntArray
) -> tuple[BoolArray, SearchResult]:
    """A* on the union of slice paths and restored parts."""
    union = np.zeros(occupancy.grid.shape, dtype=np.bool_)
    for piece in [*pieces, start[None], goal[None]]:
        union[tuple(piece.T)] = True
    return union, dense_search(Occupancy.from_mask(occupancy.grid, ~union), start, goal)


def at_height(path: IntArray, number: int) -> IntArray:
    """A slice's (m, 2) path as (m, 3) nodes."""
    return np.column_stack([path, np.full(len(path), number)])


def _slice_grid(grid: Grid) -> Grid:
    return Grid(grid.lower[:-1], grid.step[:-1], grid.shape[:-1])
