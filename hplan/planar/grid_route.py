"""Grid path over the planar joints, with a locked base.

The result is a polyline of configurations. Free nodes do not imply free segments: the caller verifies the segments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, Record, frozen
from hplan.errors import CertificationError
from hplan.planar.grid import SearchResult, dense_search, reachable_nodes, two_level_search
from hplan.planar.grid.grid import Grid, Occupancy
from hplan.planar.grid_entry import GridEntry, grid_entry
from hplan.planar.grids import GridAttempt, grid_axes, grid_occupancy, step_deg
from hplan.planar.no_path_proof import EnclosedError, Region, enclosed_goals
from hplan.planar.own_contact import within_bodies
from hplan.planning.problem import Problem
from hplan.planning.stages import current_clock

#: A node and a configuration that differ by less than this are treated as equal [rad].
_EQUAL_TO_NODE = 1e-9


@dataclass(frozen=True, eq=False)
class Route(Record):
    """A path over the grid.

    Attributes:
        path: (m, dof) configurations from start to goal.
        step_deg: Maximum spacing of the grid [deg].
    """

    occupancy: Occupancy
    search: SearchResult
    path: FloatArray
    step_deg: float

    def report(self) -> dict[str, Any]:
        """Return the entries of the report's section `planner`."""
        spent = self.search.expansions
        found: dict[str, Any] = {
            "step_deg": self.step_deg,
            "cost_deg": math.degrees(self.search.cost),
            "fallback": self.search.fallback,
            "expansions": {
                "layers": spent.layers,
                "sparse": spent.sparse,
                "fallback": spent.fallback,
                "total": spent.total,
                "flooded_cells": spent.flooded,
            },
        }
        return found if self.search.path is None else {**found, "points": len(self.search.path)}


def find_route(problem: Problem, attempt: GridAttempt, margin: float) -> Route:
    """Find a path to the problem's first goal on the grid.

    Args:
        problem: The planning problem.
        margin: Clearance required of motions to the grid at every evaluated configuration [m].

    Raises:
        EnclosedError: The grid contains no path, nor with links that are within the bodies of the arm.
        CertificationError: Start or goal cannot be connected to the grid, or the grid contains no path, but its C-space
            is larger than the bodies of the arm.
        OptionError: The step gives no valid grid.
    """
    space = grid_occupancy(problem, attempt)
    start, goal = grid_entry(problem, space, "start", margin), grid_entry(problem, space, "goal", margin)
    search, nodes = _planar_search(problem, attempt, space, start, goal)
    return Route(space, search, _configurations(problem, space.grid, nodes, start, goal), step_deg(problem, attempt))


def _search(problem: Problem, space: Occupancy, start: IntArray, goal: IntArray) -> SearchResult:
    """Run the search selected by the options and record its time."""
    clock = current_clock()
    clock.progress("search")
    if problem.options.method == "dense" or len(space.grid.shape) < 2:
        found = dense_search(space, start, goal)
    else:
        found = two_level_search(space, start, goal)
    for stage in ("layers", "sparse", "fallback"):
        clock.add(stage, getattr(found.times, stage))
    return found


def _configurations(problem: Problem, grid: Grid, nodes: IntArray, start: GridEntry, goal: GridEntry) -> FloatArray:
    """Convert a node path to (m, dof) configurations.

    Adds an off-grid start or goal.
    """
    path = np.repeat(problem.start[None], len(nodes), axis=0)
    path[:, grid_axes(problem)] = grid.coordinates(nodes)
    before, after = start.waypoints, goal.waypoints
    if np.abs(path[0] - before[-1]).max() < _EQUAL_TO_NODE:
        path[0], before = before[-1], before[:-1]
    if np.abs(path[-1] - after[-1]).max() < _EQUAL_TO_NODE:
        path[-1], after = after[-1], after[:-1]
    return frozen(np.concatenate([before, path, after[::-1]]))


def _planar_search(
    problem: Problem, attempt: GridAttempt, space: Occupancy, start: GridEntry, goal: GridEntry
) -> tuple[SearchResult, IntArray]:
    """Search between the grid nodes connected to start and goal.

    An off-grid start or goal may connect to several nodes, and the nearest may lie in a pocket: "no path" is reported
    only if no pair of nodes is connected.
    """
    search = _search(problem, space, start.nodes[0], goal.nodes[0])
    if search.path is not None:
        return search, search.path
    largest = known = np.zeros(space.grid.shape, dtype=np.bool_)  # nodes that cannot reach the goal
    for node in start.nodes:
        if known[tuple(node)]:
            continue
        reached = reachable_nodes(space, node)
        for other in goal.nodes:
            if reached[tuple(other)]:
                search = _search(problem, space, node, other)
                if search.path is not None:
                    return search, search.path
        known = known | reached
        largest = max(largest, reached, key=np.count_nonzero)
    if within_bodies(problem.robot) is not problem.robot:
        (proof,) = enclosed_goals(problem, attempt, [0], explained=True)
        inconclusive = "the grid contains no path, but its links are larger than the bodies of the arm"
        raise proof or CertificationError(inconclusive)
    count = int(largest.sum())
    description = f"the start reaches {count} of {space.grid.size} nodes, not the goal"
    raise EnclosedError(problem, attempt, count, Region(description, space.grid, largest))
