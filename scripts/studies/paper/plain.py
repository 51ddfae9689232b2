"""The paper's method to the letter, in a page of plain code.

The paper's text leaves two things open, and both are arguments here: which theta3 slices are searched, and which
waypoints connectivity restoration carries back. It says that the "first waypoint" is "propagated backward" and
truncated before contact. Read as the first slice path, waypoint by waypoint from its first one, it gives the paper's
cost; read as that one waypoint alone, it does not. The first reading is the default.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from hplan.base.arrays import BoolArray, IntArray
from hplan.errors import NoPathError
from hplan.planar.grid import SearchResult, dense_search
from hplan.planar.grid.grid import Grid, Occupancy

#: The waypoints that restoration carries back towards the start: the first slice path, or its first waypoint alone.
Restoration: TypeAlias = Literal["path", "first waypoint"]
RESTORATIONS: tuple[Restoration, ...] = get_args(Restoration)


@dataclass(frozen=True, eq=False)
class PlainTwoLevel:
    """The two levels to the letter of the paper.

    Attributes:
        paths: Slice -> (m, 3) path, for the slices that have one.
        heads: Slice -> (k, 3) part of the first path that restoration keeps there.
        expansions: Slice -> nodes expanded there.
        union: (N1, N2, N3) mask of the sparse graph's nodes.
        second: Search on the union.
    """

    paths: dict[int, IntArray]
    heads: dict[int, IntArray]
    expansions: dict[int, int]
    union: BoolArray
    second: SearchResult


def plain_two_level(
    occupancy: Occupancy,
    start: IntArray,
    goal: IntArray,
    *,
    last_slice: int | None = None,
    restoration: Restoration = "path",
) -> PlainTwoLevel:
    """A* in every slice, restoration at the start, A* on the union.

    Args:
        occupancy: The (N1, N2, N3) C-space.
        start: (3,) node index.
        goal: (3,) node index, in a slice not below the start's.
        last_slice: Last slice searched, not below the goal's; by default the goal's.
        restoration: The waypoints to carry back towards the start.
    """
    flat = _slice_grid(occupancy.grid)
    last = int(goal[2]) if last_slice is None else last_slice
    paths: dict[int, IntArray] = {}
    expansions: dict[int, int] = {}
    for number in range(int(start[2]), last + 1):
        layer = Occupancy.from_mask(flat, occupancy.occupied_mask[:, :, number])
        result = dense_search(layer, start[:2], goal[:2])
        expansions[number] = result.expansions.total
        if result.path is not None:
            paths[number] = at_height(result.path, number)
    heads = carried_back(occupancy, paths, int(start[2]), restoration)
    union, second = second_level(occupancy, [*paths.values(), *heads.values()], start, goal)
    return PlainTwoLevel(paths, heads, expansions, union, second)


def carried_back(
    occupancy: Occupancy, paths: dict[int, IntArray], start_slice: int, restoration: Restoration = "path"
) -> dict[int, IntArray]:
    """Carry the first slice path back to the start's slice, cutting it in each slice before the first contact.

    Args:
        occupancy: The (N1, N2, N3) C-space.
        paths: Slice -> (m, 3) path.
        restoration: Carry back the whole path, or its first waypoint alone.

    Returns:
        Slice -> (k, 3) part kept there.
    """
    heads: dict[int, IntArray] = {}
    if not paths:
        return heads
    first = min(paths)
    kept = paths[first][:, :2] if restoration == "path" else paths[first][:1, :2]
    for number in range(first - 1, start_slice - 1, -1):
        blocked = np.flatnonzero(occupancy.occupied_mask[kept[:, 0], kept[:, 1], number])
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


def path_found(result: SearchResult) -> IntArray:
    """The (m, 3) path of a search that must have one."""
    if result.path is None:
        raise NoPathError("the search found no path from start to goal", reached_cells=result.expansions.total)
    return result.path


def at_height(path: IntArray, number: int) -> IntArray:
    """A slice's (m, 2) path as (m, 3) nodes."""
    return np.column_stack([path, np.full(len(path), number)])


def _slice_grid(grid: Grid) -> Grid:
    return Grid(grid.lower[:-1], grid.step[:-1], grid.shape[:-1])
