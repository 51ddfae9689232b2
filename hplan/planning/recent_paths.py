"""Paths along recent motions.

An arm that is given goal after goal often passes the same obstacles again. The points of its recent motions, the start
and the goals are the nodes of a roadmap. Its edges connect consecutive points of a motion, and each node with the
nearest point of each other motion if that is near. The edges of the quickest path are verified in turn, and the first
that is blocked is removed, until a whole path is clear (Bohlin and Kavraki 2000, "Path planning using lazy PRM"). That
takes a few dozen distance queries where trees take thousands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from hplan.base import ties
from hplan.base.arrays import BoolArray, FloatArray, IntArray, frozen
from hplan.base.kernels import kernel
from hplan.planning.problem import Problem
from hplan.robot.limits import clock_at_limits
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Trajectory

#: Number of motions that are remembered, and of points of each besides corners.
_MOTIONS, _POINTS = 8, 24

#: A motion adds something to others if a point of it is this far from all of theirs, and edges between motions are at
#: most so long [s]. Longer edges are mostly blocked: trees have been needed there.
_ADDS_S, _LONGEST_S = 0.1, 0.25

#: Number of blocked edges after which the search ends.
_BLOCKED = 8

#: Index of no node.
_NONE = -1


def with_motion(recent: Sequence[FloatArray], trajectory: Trajectory, robot: Robot) -> tuple[FloatArray, ...]:
    """Points of recent motions, and of another motion if it leads to other places; the oldest are dropped.

    Args:
        recent: (n, dof) configurations along each motion, oldest first.
        trajectory: The other motion.
        robot: The arm.
    """
    clock = clock_at_limits(trajectory.position, robot.velocity_limit)
    rows = np.unique(np.searchsorted(clock, np.linspace(0.0, clock[-1], _POINTS)))
    return _with_points(recent, trajectory.position[rows], robot)


def with_path(recent: Sequence[FloatArray], waypoints: FloatArray, robot: Robot) -> tuple[FloatArray, ...]:
    """The same for a polyline, all of whose corners are remembered.

    The segments between its points are collision-free, unlike those between points of a curved motion.

    Args:
        recent: (n, dof) configurations along each motion, oldest first.
        waypoints: (m, dof) the polyline, m >= 1.
        robot: The arm.
    """
    clock = clock_at_limits(waypoints, robot.velocity_limit)
    times = np.union1d(clock, np.linspace(0.0, clock[-1], _POINTS))
    return _with_points(recent, np.stack([np.interp(times, clock, joint) for joint in waypoints.T], axis=1), robot)


def _with_points(recent: Sequence[FloatArray], points: FloatArray, robot: Robot) -> tuple[FloatArray, ...]:
    known = np.concatenate([np.empty((0, robot.dof)), *recent])
    apart = ties.on_raster(_times(points, known, robot.velocity_limit).min(axis=1, initial=math.inf))
    return (*recent, frozen(points))[-_MOTIONS:] if apart.max() > _ADDS_S else tuple(recent)


@kernel
def _times(first: FloatArray, second: FloatArray, velocity: FloatArray) -> FloatArray:
    """(n, m) times between configurations at the velocity limits [s]."""
    times = np.empty((len(first), len(second)))
    for a in range(len(first)):
        for b in range(len(second)):
            longest = 0.0
            for j in range(len(velocity)):
                longest = max(longest, abs(first[a, j] - second[b, j]) / velocity[j])
            times[a, b] = longest
    return times


def recent_path(problem: Problem, margin: float) -> FloatArray | None:
    """(m, dof) waypoints of a collision-free path along recent motions to any of a problem's goals.

    None if there is none, or too many edges are blocked.

    Args:
        problem: The problem, whose `memory` has recent motions.
        margin: Clearance required beyond the scene's own at each evaluated configuration [m].
    """
    if not problem.memory.motions:
        return None
    nodes = np.concatenate([problem.start[None], problem.goals, *problem.memory.motions])
    sizes = [1, *(1 for _ in problem.goals), *map(len, problem.memory.motions)]
    times = ties.on_raster(_times(nodes, nodes, problem.robot.velocity_limit))
    ends = 1 + len(problem.goals)
    is_edge = _connect(times, np.repeat(np.arange(len(sizes)), sizes), ends)
    # A locked joint keeps its value, also where it had another one.
    is_edge &= (np.delete(nodes, problem.movable, axis=1) == np.delete(problem.start, problem.movable)).all(axis=1)
    is_clear = np.zeros_like(is_edge)
    for _ in range(_BLOCKED):
        path = _quickest(times, is_edge, ends)
        if not len(path):
            return None
        for a, b in pairwise(path.tolist()):
            if not is_clear[a, b] and not problem.field.is_clear(nodes[[a, b]], margin):
                is_edge[a, b] = is_edge[b, a] = False
                break
            is_clear[a, b] = is_clear[b, a] = True
        else:
            return frozen(nodes[path])
    return None


@kernel
def _connect(times: FloatArray, group: IntArray, ends: int) -> BoolArray:
    """(n, n) edges: between consecutive nodes of a motion, and from each node to a near one of each motion.

    Args:
        times: (n, n) time between two nodes [s].
        group: (n,) number of the motion, start or goal of each node, ascending.
        ends: Number of nodes that are start or goals, which come first.
    """
    count = len(times)
    is_edge = np.zeros((count, count), dtype=np.bool_)
    for a in range(count):
        nearest = _NONE
        for b in range(ends, count):
            if group[b] != group[b - 1]:
                nearest = _NONE
            if group[b] != group[a] and (nearest == _NONE or times[a, b] < times[a, nearest]):
                nearest = b
            is_last = b + 1 == count or group[b + 1] != group[b]
            if is_last and nearest != _NONE and times[a, nearest] <= _LONGEST_S:
                is_edge[a, nearest] = is_edge[nearest, a] = True
        if a >= ends and a + 1 < count and group[a] == group[a + 1]:
            is_edge[a, a + 1] = is_edge[a + 1, a] = True
    return is_edge


@kernel
def _quickest(times: FloatArray, is_edge: BoolArray, ends: int) -> IntArray:
    """Nodes of the quickest path from node 0 to one of the goals, 1 to `ends` - 1; empty if there is none."""
    count = len(times)
    reached, before = np.full(count, math.inf), np.full(count, _NONE)
    is_done = np.zeros(count, dtype=np.bool_)
    reached[0] = 0.0
    while True:
        node = _NONE
        for k in range(count):
            if not is_done[k] and reached[k] < math.inf and (node == _NONE or reached[k] < reached[node]):
                node = k
        if node == _NONE:
            return np.zeros(0, dtype=np.int64)
        if 0 < node < ends:
            break
        is_done[node] = True
        for k in range(count):
            if is_edge[node, k] and reached[node] + times[node, k] < reached[k]:
                reached[k], before[k] = reached[node] + times[node, k], node
    length, k = 1, node
    while before[k] != _NONE:
        length, k = length + 1, before[k]
    path = np.empty(length, dtype=np.int64)
    for n in range(length - 1, -1, -1):
        path[n] = node
        node = before[node]
    return path
