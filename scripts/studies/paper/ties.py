"""Many slice paths are equally short; what the choice among them does to the second level."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence

import numpy as np
from studies.paper.plain import PlainTwoLevel, Restoration, at_height, carried_back, second_level
from studies.paper.results import Ties

from hplan.base.arrays import BoolArray, IntArray
from hplan.search.grid import Occupancy

_MOVES = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]


def distances_from(free: BoolArray, source: tuple[int, int]) -> dict[tuple[int, int], float]:
    """Length of the shortest way from `source` to every node of a slice that it reaches, in steps."""
    nodes = {(int(i), int(j)) for i, j in np.argwhere(free)}
    distances = {source: 0.0}
    queue = [(0.0, source)]
    while queue:
        distance, (i, j) = heapq.heappop(queue)
        if distance > distances[i, j]:
            continue
        for a, b in _MOVES:
            other, length = (i + a, j + b), distance + math.hypot(a, b)
            if other in nodes and length < distances.get(other, math.inf) - 1e-9:
                distances[other] = length
                heapq.heappush(queue, (length, other))
    return distances


def equal_slice_paths(
    occupancy: Occupancy, plain: PlainTwoLevel, start: IntArray, goal: IntArray, choices: int
) -> list[dict[int, IntArray]]:
    """Choose several times among the equally short paths of each slice.

    Args:
        occupancy: The (N1, N2, N3) C-space.
        plain: The two levels, for the slices that have a path.
        start: (3,) node index.
        goal: (3,) node index.
        choices: Sets of slice paths, at least 2: two fixed orders of the moves, the rest drawn from a fixed seed.

    Returns:
        For each choice, slice -> (m, 3) path.
    """
    flat_start, flat_goal = (int(start[0]), int(start[1])), (int(goal[0]), int(goal[1]))
    ahead = {number: distances_from(~occupancy.occupied[:, :, number], flat_goal) for number in plain.paths}
    random = np.random.default_rng(20240)

    def descend(distances: dict[tuple[int, int], float], choose: Callable[[int], int]) -> IntArray:
        path = [flat_start]
        while path[-1] != flat_goal:
            i, j = path[-1]
            onward = [
                (i + a, j + b)
                for a, b in _MOVES
                if abs(distances.get((i + a, j + b), math.inf) + math.hypot(a, b) - distances[i, j]) < 1e-9
            ]
            path.append(onward[choose(len(onward))])
        return np.array(path)

    rules: list[Callable[[int], int]] = [lambda _: 0, lambda count: count - 1]
    rules += [lambda count: int(random.integers(count))] * (choices - 2)
    return [
        {number: at_height(descend(distances, rule), number) for number, distances in ahead.items()} for rule in rules
    ]


def try_ties(
    occupancy: Occupancy,
    choices: Sequence[dict[int, IntArray]],
    start: IntArray,
    goal: IntArray,
    restoration: Restoration = "path",
) -> Ties:
    """Second level for several choices among equally short slice paths, as `equal_slice_paths` returns them."""
    results = []
    for paths in choices:
        heads = carried_back(occupancy, paths, int(start[2]), restoration)
        results.append(second_level(occupancy, [*paths.values(), *heads.values()], start, goal)[1])
    costs = [math.degrees(result.cost) for result in results]
    points = [len(result.path) for result in results if result.path is not None]
    expansions = [result.expansions.total for result in results]
    return Ties(len(choices), min(costs), max(costs), min(points), max(points), min(expansions), max(expansions))
