"""From start to goal on a grid over the joints that may move: a polyline of configurations.

With the base locked the grid is that of the planar joints. Where the base may turn, yaw is a further axis
(`hplan.cspace.yaw_layers`). Nodes are not motions: the polyline's own motions are looked at by the caller, or, where
the base turns, repaired here: a motion that cannot be shown clear is made joint by joint, or its nodes are avoided.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass, replace

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, WordArray, frozen
from hplan.errors import CertificationError
from hplan.planning.grid_entry import GridEntry, grid_entry
from hplan.planning.refusals import EnclosedError, Region, open_ended
from hplan.planning.task import GridAttempt, PlanningTask
from hplan.search import SearchResult, dense_search, reachable, two_level_search
from hplan.search.flood import has_bit
from hplan.search.grid import Grid, Occupancy
from hplan.search.lattice import Lattice
from hplan.search.result import path_cost
from hplan.search.wavefront import meet
from hplan.smoothing.repair import repaired

#: Motions of a path that cannot be shown clear are avoided so many times; with thick layers it succeeds more often.
DETOURS, THICK_DETOURS = 12, 20

#: So much farther from obstacles than the nodes of such a motion must neighbouring nodes be to be used instead [m].
ASIDE = 2e-3


@dataclass(frozen=True, eq=False)
class Route(Record):
    """A path over the grid.

    Attributes:
        occupancy: The C-space that was searched.
        search: The search.
        path: (m, dof) configurations from start to goal.
        step_deg: Largest spacing of the grid [deg].
    """

    occupancy: Occupancy
    search: SearchResult
    path: FloatArray
    step_deg: float


def find_route(task: PlanningTask, attempt: GridAttempt, margin: float) -> Route:
    """A path over the grid.

    Args:
        task: Arm, obstacles and what is asked.
        attempt: Grid, growth and range of yaws.
        margin: Clearance asked of motions to the grid, and of all motions where the base turns, wherever they are
            evaluated [m].

    Raises:
        EnclosedError: There is none on the grid.
        CertificationError: Start or goal cannot be joined to the grid; no path on it can be shown clear.
        OptionError: A step that gives no grid.
    """
    space = task.occupancy(attempt)
    start, goal = grid_entry(task, space, "start", margin), grid_entry(task, space, "goal", margin)
    if task.problem.turns:
        search, path = _turning_path(task, attempt, margin, space, (start, goal))
    else:
        search, nodes = _planar_search(task, attempt, space, start, goal)
        path = _configurations(task, space.grid, nodes, start, goal)[0]
    return Route(space, search, path, task.step_deg(attempt))


def _search(task: PlanningTask, space: Occupancy, start: IntArray, goal: IntArray) -> SearchResult:
    """The search that the options ask for, its time noted."""
    task.progress("search")
    if task.options.method == "dense" or len(space.grid.shape) < 2:
        found = dense_search(space, start, goal)
    else:
        found = two_level_search(space, start, goal)
    for stage in ("layers", "sparse", "fallback"):
        task.clock.add(stage, getattr(found.times, stage))
    return found


def _configurations(
    task: PlanningTask, grid: Grid, nodes: IntArray, start: GridEntry, goal: GridEntry
) -> tuple[FloatArray, int]:
    """The path over nodes as (m, dof) configurations, with start and goal where they are off the grid.

    Returns:
        The configurations, and at which of them the nodes begin.
    """
    path = np.repeat(task.problem.start[None], len(nodes), axis=0)
    path[:, task.axes] = grid.coordinates(nodes)
    parts = [path]
    for node, end in ((0, start), (-1, goal)):
        waypoints = end.waypoints
        if np.abs(path[node] - waypoints[-1]).max() < 1e-9:
            path[node], waypoints = waypoints[-1], waypoints[:-1]
        parts.insert(0 if end is start else 2, waypoints if end is start else waypoints[::-1])
    return frozen(np.concatenate(parts)), len(parts[0])


def _planar_search(
    task: PlanningTask, attempt: GridAttempt, space: Occupancy, start: GridEntry, goal: GridEntry
) -> tuple[SearchResult, IntArray]:
    """Search between the grid nodes that start and goal are joined to.

    Off the grid there may be several, and the nearest may lie in a pocket: "no path" is said only when no pair of them
    is connected.
    """
    search = _search(task, space, start.first, goal.first)
    if search.path is not None:
        return search, search.path
    most: tuple[int, BoolArray] = (0, np.zeros(space.grid.shape, dtype=np.bool_))
    known = most[1].copy()  # nodes from which the goal cannot be reached
    for node in start.all():
        if known[tuple(node)]:
            continue
        reached = reachable(space, node)
        for other in goal.all():
            if reached[tuple(other)]:
                search = _search(task, space, node, other)
                if search.path is not None:
                    return search, search.path
        known |= reached
        if (count := int(reached.sum())) > most[0]:
            most = count, reached
    what = f"the start reaches {most[0]} of {space.grid.size} nodes, not the goal"
    raise EnclosedError(Region(what, task, attempt.growth_m, space.grid, most[1]), most[0], open_ended=False)


def _turning_path(
    task: PlanningTask, attempt: GridAttempt, margin: float, space: Occupancy, entries: tuple[GridEntry, GridEntry]
) -> tuple[SearchResult, FloatArray]:
    """Search over yaws, and replace nodes between which no motion can be shown clear."""
    problem, (start, goal) = task.problem, entries
    lattice = Lattice.of(space.grid.shape, space.grid.step)
    free = lattice.bordered(space.free_words)
    search = _search(task, space, start.first, goal.first)
    nodes = search.path
    if nodes is None:
        search, nodes = _by_fronts(task, attempt, space, lattice, free, entries, search)
    known: dict[bytes, FloatArray | None] = {}
    for _ in range(THICK_DETOURS if attempt.thick else DETOURS):
        waypoints, before = _configurations(task, space.grid, nodes, start, goal)
        path, contacts = repaired(waypoints, task.field, problem.lower, problem.upper, margin, known)
        if not contacts:
            return search, path
        here = contacts[0] - before  # the motion from this node to the next is in contact; below 0: from the start
        if here + 2 <= 0 or here >= len(nodes):
            break  # between a tight end and the grid: not the grid's to avoid
        _take_out(task, space.grid, lattice, free, nodes[max(0, here) : here + 2])
        ahead = start.free_of(lattice, free, nodes[: max(0, here)])
        behind = goal.free_of(lattice, free, nodes[here + 2 :])
        bypass = None
        if len(ahead) and len(behind):
            with task.clock.stage("fallback"):
                bypass = meet(lattice, free, ahead, behind).path
        if bypass is None:
            break
        before_it, _ = _parted(nodes[: max(0, here)], bypass[0])
        _, after_it = _parted(nodes[here + 2 :], bypass[-1])
        nodes = np.concatenate([before_it, bypass, after_it])
    raise CertificationError("no path on the grid can be shown clear as a motion")


def _take_out(task: PlanningTask, grid: Grid, lattice: Lattice, free: WordArray, nodes: IntArray) -> None:
    """Take nodes, and their neighbours that are no farther from obstacles, out of the free ones."""
    steps = np.array(list(itertools.product((-1, 0, 1), repeat=len(grid.shape))))
    q = task.problem.start.copy()

    def clearance(node: IntArray) -> float:
        q[task.axes] = grid.coordinates(node)
        return task.field.clearance(q)

    most = max(clearance(node) for node in nodes) + ASIDE
    neighbours = np.unique((nodes[:, None] + steps).reshape(-1, len(grid.shape)), axis=0)
    inside = ((neighbours >= 0) & (neighbours < grid.shape)).all(axis=1)
    for node in neighbours[inside]:
        row, bit = lattice.row_of(node), int(node[-1])
        if has_bit(free, row, bit) and clearance(node) <= most:
            free[row, bit >> 6] &= ~(np.uint64(1) << np.uint64(bit & 63))


def _parted(nodes: IntArray, node: IntArray) -> tuple[IntArray, IntArray]:
    """The nodes before one of them and those after it; none where it is not among them."""
    places = np.flatnonzero((nodes == node).all(axis=1))
    return (nodes[: places[0]], nodes[places[0] + 1 :]) if len(places) else (nodes[:0], nodes[:0])


def _by_fronts(
    task: PlanningTask, attempt: GridAttempt, space: Occupancy, lattice: Lattice, free: WordArray,
    entries: tuple[GridEntry, GridEntry], search: SearchResult,
) -> tuple[SearchResult, IntArray]:  # fmt: skip
    """A path between any of the nodes that start and goal are joined to, by flooding from both.

    Raises:
        EnclosedError: There is none; `open_ended` where more yaws might open one.
    """
    begin = time.perf_counter()
    fronts = meet(lattice, free, *(np.array(entry.all()) for entry in entries))
    seconds = time.perf_counter() - begin
    task.clock.add("fallback", seconds)
    if fronts.path is None:
        grid, reached = space.grid, lattice.unbordered(fronts.reached)
        count, which = int(np.bitwise_count(reached).sum()), fronts.enclosed
        other = "goal" if which == "start" else "start"
        what = f"the {which} is connected to {count} of {grid.size} nodes, and the {other} is not among them"
        region = Region(what, task, attempt.growth_m, grid, reached)
        raise EnclosedError(region, count, open_ended=open_ended(task.problem, grid, reached))
    found = replace(
        search,
        path=fronts.path,
        cost=path_cost(fronts.path, lattice.step),
        expansions=search.expansions.with_fallback(0, fronts.flooded),
        times=replace(search.times, fallback=search.times.fallback + seconds),
        fallback="wavefront",
    )
    return found, fronts.path
