"""Connectivity where slices have no path of their own.

The paper takes the path of the first slice that has one, carries it back slice by slice towards the start, and cuts
it in each slice before the first contact. The same is done here on the goal's side (the last path is carried on
towards the goal, its tail kept after the last contact) and, from both sides and at both ends, across gaps in the
middle.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hplan.arrays import IntArray
from hplan.grid import Occupancy


def restore(
    occupancy: Occupancy, paths: dict[int, IntArray], start_slice: int, goal_slice: int
) -> dict[int, list[IntArray]]:
    """Parts of neighbouring paths for the slices between start and goal that have none.

    Args:
        occupancy: The whole grid.
        paths: Slice number -> (m, d) path, for the slices that have one.
        start_slice: Slice of the start.
        goal_slice: Slice of the goal.

    Returns:
        Slice number -> parts, each an (m, d) array of free nodes.
    """
    direction = 1 if goal_slice >= start_slice else -1
    order = list(range(start_slice, goal_slice + direction, direction))
    feasible = [place for place, number in enumerate(order) if number in paths]
    parts: dict[int, list[IntArray]] = {}
    if not feasible:
        return parts
    first, last = feasible[0], feasible[-1]

    def add(carried: Iterator[tuple[int, IntArray]]) -> None:
        for number, part in carried:
            parts.setdefault(number, []).append(part)

    add(_carry(occupancy, paths[order[first]], order[:first][::-1], head=True))
    add(_carry(occupancy, paths[order[last]], order[last + 1 :], head=False))
    for left, right in zip(feasible, feasible[1:], strict=False):
        gap = order[left + 1 : right]
        for head in (True, False):
            add(_carry(occupancy, paths[order[left]], gap, head=head))
            add(_carry(occupancy, paths[order[right]], gap[::-1], head=head))
    return parts


def _carry(occupancy: Occupancy, path: IntArray, slices: list[int], *, head: bool) -> Iterator[tuple[int, IntArray]]:
    """Carry a path's head (or tail) from slice to slice, cut before the first contact in each."""
    kept = path if head else path[::-1]
    words, shape = occupancy.free_words, occupancy.grid.shape
    for number in slices:
        rows = np.ravel_multi_index(tuple(kept[:, :-1].T), shape[:-1])
        free = (words[rows, number >> 6] >> np.uint64(number & 63)) & np.uint64(1) != 0
        blocked = np.flatnonzero(~free)
        kept = kept[: blocked[0]] if len(blocked) else kept
        if len(kept) == 0:
            return
        part = kept.copy()
        part[:, -1] = number
        yield number, part
