"""Safe-interval path planning on the joint grid, as a baseline: the planar joints, the base locked.

Nodes are a configuration and an interval of time in which it is free; A* looks for the earliest arrival (Phillips and
Likhachev, SIPP, ICRA 2011). Start and goal are nodes, neighbours differ by a step or none in each joint. As usual with
this method, a move takes as long as its slowest joint does at its velocity limit, from speed to speed at once, and only
nodes are looked at: its durations are shorter than any arm's that has to accelerate, and its motions need not be clear
between nodes.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, Record
from hplan.collision.clearance_field import ClearanceField
from hplan.moving.path_in_time import MovingField
from hplan.robot.model import Robot
from hplan.scene.model import Scene

#: Spacing of the grid [deg], how far it reaches beyond start and goal [deg], and spacing of times [s].
STEP_DEG, BEYOND_DEG, STEP_S = 5.0, 40.0, 0.05

#: Most nodes that are looked at.
MOST_NODES = 60_000


@dataclass(frozen=True, eq=False)
class GridMotion(Record):
    """A motion from node to node.

    Attributes:
        time: (n,) times [s].
        position: (n, dof) configurations; at constant speeds between them.
        looked_at: Nodes that were looked at.
    """

    time: FloatArray
    position: FloatArray
    looked_at: int

    @property
    def duration(self) -> float:
        """When it arrives [s]."""
        return float(self.time[-1])


def safe_interval_motion(robot: Robot, scene: Scene, still: ClearanceField) -> GridMotion | None:
    """The motion by safe intervals; None where none was found.

    Args:
        robot: The arm.
        scene: The scene, its base locked.
        still: Distances from what stands still.
    """
    start, goal = scene.start.configuration, scene.goal.configuration
    planar = robot.arm_slice
    apart = (goal - start)[planar]
    counts = np.maximum(1, np.ceil(np.abs(apart) / math.radians(STEP_DEG) - 1e-9)).astype(int)
    steps = np.where(np.abs(apart) > 1e-9, np.abs(apart) / counts, math.radians(STEP_DEG))
    signs = np.where(apart < 0.0, -1.0, 1.0)
    target = tuple(np.where(np.abs(apart) > 1e-9, counts, 0).tolist())
    more = np.ceil(math.radians(BEYOND_DEG) / steps).astype(int)
    velocity, free = robot.velocity_limit[planar], _FreeTimes(robot, scene, still)

    def configuration(node: tuple[int, ...]) -> FloatArray:
        q = start.copy()
        q[planar] = start[planar] + signs * steps * np.array(node)
        return q

    def intervals(node: tuple[int, ...]) -> list[tuple[float, float]]:
        inside = all(-m <= k <= t + m for k, t, m in zip(node, target, more.tolist(), strict=True))
        q = configuration(node)
        within = bool((q >= robot.lower - 1e-9).all() and (q <= robot.upper + 1e-9).all())
        return free.intervals(q) if inside and within else []

    takes = {
        move: float((np.abs(move) * steps / velocity).max())
        for move in itertools.product((-1, 0, 1), repeat=len(target))
        if any(move)
    }
    left = steps / velocity

    def least(node: tuple[int, ...]) -> float:
        return float((np.abs(np.array(node) - np.array(target)) * left).max())

    found = _search(target, takes, intervals, least)
    if found is None:
        return None
    times, nodes, looked_at = found
    return GridMotion(np.array(times), np.array([configuration(node) for node in nodes]), looked_at)


def _search(
    target: tuple[int, ...],
    takes: dict[tuple[int, ...], float],
    intervals_of: Callable[[tuple[int, ...]], list[tuple[float, float]]],
    least: Callable[[tuple[int, ...]], float],
) -> tuple[list[float], list[tuple[int, ...]], int] | None:
    """A* over nodes and their safe intervals: times and nodes, waits included, and how many nodes were looked at."""
    known: dict[tuple[int, ...], list[tuple[float, float]]] = {}

    def intervals(node: tuple[int, ...]) -> list[tuple[float, float]]:
        if node not in known:
            known[node] = intervals_of(node)
        return known[node]

    begin = (0,) * len(target)
    if not intervals(begin) or intervals(begin)[0][0] > 0.0:
        return None
    first = (begin, 0)
    arrival, before = {first: 0.0}, {first: first}
    queue = [(least(begin), 0.0, first)]
    done: set[tuple[tuple[int, ...], int]] = set()
    while queue:
        _, now, state = heapq.heappop(queue)
        if state in done:
            continue
        done.add(state)
        node, interval = state
        if node == target:
            return _traced(state, before, arrival, takes, len(known))
        if len(known) > MOST_NODES:
            return None
        until = intervals(node)[interval][1]
        for move, lasts in takes.items():
            to = tuple(a + b for a, b in zip(node, move, strict=True))
            for number, (opens, closes) in enumerate(intervals(to)):
                then = max(now + lasts, opens)
                if then > closes or then - lasts > until:
                    continue
                following = (to, number)
                if then < arrival.get(following, math.inf):
                    arrival[following], before[following] = then, state
                    heapq.heappush(queue, (then + least(to), then, following))
    return None


def _traced(
    state: tuple[tuple[int, ...], int],
    before: dict[tuple[tuple[int, ...], int], tuple[tuple[int, ...], int]],
    arrival: dict[tuple[tuple[int, ...], int], float],
    takes: dict[tuple[int, ...], float],
    looked_at: int,
) -> tuple[list[float], list[tuple[int, ...]], int]:
    """Times and nodes of the way to a state; where it waits the node stands twice."""
    states = [state]
    while before[states[-1]] != states[-1]:
        states.append(before[states[-1]])
    states.reverse()
    times, nodes = [0.0], [states[0][0]]
    for one, other in itertools.pairwise(states):
        move = tuple(b - a for a, b in zip(one[0], other[0], strict=True))
        leaves = arrival[other] - takes[move]
        if leaves > times[-1] + 1e-9:
            times.append(leaves)
            nodes.append(one[0])
        times.append(arrival[other])
        nodes.append(other[0])
    return times, nodes, looked_at


class _FreeTimes:
    """When a configuration is free of everything, at times a step apart."""

    def __init__(self, robot: Robot, scene: Scene, still: ClearanceField) -> None:
        self._moving = MovingField(robot, scene, sigmas=3.0, tracking_error=0.0)
        self._still = still
        self._rows = math.ceil(max(0.0, self._moving.at_rest_s) / STEP_S) + 1
        self._fields = [self._moving.at(row * STEP_S) for row in range(self._rows + 1)]
        self._fastest = max(self._moving.travel(row * STEP_S, (row + 1) * STEP_S) for row in range(self._rows))

    def intervals(self, q: FloatArray) -> list[tuple[float, float]]:
        """Intervals of time in which a configuration is free; the last one may have no end."""
        if self._still.clearance(q) <= 0.0:
            return []
        free = np.ones(self._rows + 1, dtype=np.bool_)
        row = 0
        while row <= self._rows:
            clearance = self._fields[row].clearance(q)
            free[row] = clearance > 0.0
            # What moves cannot come nearer before so many rows.
            row += max(1, int(max(0.0, clearance) / max(self._fastest, 1e-12)))
        found: list[tuple[float, float]] = []
        edges = np.flatnonzero(np.diff(np.concatenate([[False], free, [False]]).astype(int)))
        for opens, closes in edges.reshape(-1, 2).tolist():
            end = math.inf if closes > self._rows else (closes - 1) * STEP_S
            found.append((opens * STEP_S, end))
        return found
