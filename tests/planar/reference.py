"""The searches said plainly: Dijkstra's algorithm over a mask, breadth-first flooding, and the two levels as the paper
has them (one search a slice, plain restoration)."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.planar.grid.grid import Grid, Occupancy

Node = tuple[int, ...]


def make_occupancy(free: BoolArray, step: FloatArray) -> Occupancy:
    """Occupancy of a grid from 0 with the given free nodes."""
    grid = Grid(np.zeros(free.ndim), np.array(step, dtype=np.float64), free.shape)
    return Occupancy.from_mask(grid, ~free)


def neighbours(free: BoolArray, node: Node) -> Iterator[tuple[Node, Node]]:
    """Each free neighbour of a node and the move to it."""
    for move in itertools.product((-1, 0, 1), repeat=free.ndim):
        other = tuple(place + change for place, change in zip(node, move, strict=True))
        inside = all(0 <= place < count for place, count in zip(other, free.shape, strict=True))
        if any(move) and inside and free[other]:
            yield other, move


def shortest(free: BoolArray, start: IntArray, goal: IntArray, step: FloatArray) -> tuple[float, IntArray | None]:
    """Dijkstra's algorithm: cost and (m, d) path; inf and None without one."""
    source, target = tuple(map(int, start)), tuple(map(int, goal))
    if not (free[source] and free[target]):
        return math.inf, None
    cost: dict[Node, float] = {source: 0.0}
    parent: dict[Node, Node] = {}
    settled: set[Node] = set()
    heap = [(0.0, source)]
    while heap:
        base, node = heapq.heappop(heap)
        if node in settled:
            continue
        settled.add(node)
        if node == target:
            path = [node]
            while path[-1] != source:
                path.append(parent[path[-1]])
            return base, np.array(path[::-1])
        for other, move in neighbours(free, node):
            new = base + math.hypot(*(change * spacing for change, spacing in zip(move, step, strict=True)))
            if new < cost.get(other, math.inf):
                cost[other], parent[other] = new, node
                heapq.heappush(heap, (new, other))
    return math.inf, None


def component(free: BoolArray, start: IntArray) -> BoolArray:
    """Mask of the nodes connected to a node."""
    labels, _ = ndimage.label(free, structure=np.ones((3,) * free.ndim))
    return np.asarray(labels == labels[tuple(start)])


def slice_paths(free: BoolArray, start: IntArray, goal: IntArray, step: FloatArray) -> dict[int, IntArray]:
    """A shortest path in each slice between start and goal that has one."""
    paths = {}
    for number in range(min(start[-1], goal[-1]), max(start[-1], goal[-1]) + 1):
        _, path = shortest(free[..., number], start[:-1], goal[:-1], step[:-1])
        if path is not None:
            paths[int(number)] = np.column_stack([path, np.full(len(path), number)])
    return paths


def restore(
    free: BoolArray, paths: dict[int, IntArray], start_slice: int, goal_slice: int
) -> dict[int, list[IntArray]]:
    """Parts of neighbouring paths for the slices between start and goal that have none."""
    direction = 1 if goal_slice >= start_slice else -1
    order = list(range(start_slice, goal_slice + direction, direction))
    feasible = [place for place, number in enumerate(order) if number in paths]
    parts: dict[int, list[IntArray]] = {}
    if not feasible:
        return parts

    def carry(path: IntArray, slices: list[int], *, head: bool) -> None:
        kept = path if head else path[::-1]
        for number in slices:
            blocked = np.flatnonzero(~free[(*kept[:, :-1].T, number)])
            kept = kept[: blocked[0]] if len(blocked) else kept
            if len(kept) == 0:
                return
            part = kept.copy()
            part[:, -1] = number
            parts.setdefault(number, []).append(part)

    carry(paths[order[feasible[0]]], order[: feasible[0]][::-1], head=True)
    carry(paths[order[feasible[-1]]], order[feasible[-1] + 1 :], head=False)
    for left, right in itertools.pairwise(feasible):
        for head in (True, False):
            carry(paths[order[left]], order[left + 1 : right], head=head)
            carry(paths[order[right]], order[left + 1 : right][::-1], head=head)
    return parts


def union_mask(free: BoolArray, paths: dict[int, IntArray], start: IntArray, goal: IntArray) -> BoolArray:
    """Mask of the sparse graph."""
    parts = restore(free, paths, int(start[-1]), int(goal[-1]))
    union = np.zeros_like(free)
    for piece in [start[None], goal[None], *paths.values(), *(part for row in parts.values() for part in row)]:
        union[tuple(piece.T)] = True
    return union


def path_cost(path: IntArray, step: FloatArray) -> float:
    """Length of a path."""
    return float(np.linalg.norm(np.diff(path, axis=0) * step, axis=1).sum())


def assert_path(free: BoolArray, path: IntArray, start: IntArray, goal: IntArray) -> None:
    """Every node free, every edge one move, from start to goal."""
    assert path[0].tolist() == list(start)
    assert path[-1].tolist() == list(goal)
    assert free[tuple(path.T)].all()
    moves = np.abs(np.diff(path, axis=0))
    assert (moves.max(axis=1, initial=0) == 1).all()
