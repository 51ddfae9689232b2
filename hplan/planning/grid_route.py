"""From start to goal on a grid over the joints that may move: a polyline of configurations.

With the base locked the grid is that of the planar joints. Where the base may turn, yaw is a further axis
(`hplan.cspace.yaw_layers`). Nodes are not motions: the polyline's own motions are looked at by the caller, or, where
the base turns, mended here: a motion that cannot be shown clear is made joint by joint, or its nodes are avoided.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, WordArray, frozen
from hplan.collision.clearance_field import ClearanceField
from hplan.cspace.occupancy import occupancy
from hplan.cspace.sections import ArmSections, sections_at
from hplan.cspace.yaw_layers import LayerCache, turning_occupancy, yaw_axis
from hplan.errors import CertificationError, OptionError
from hplan.planning.enclosure import EnclosedError, PlanarRegion, TurningRegion, open_ended
from hplan.planning.grid_entry import joined_nodes
from hplan.planning.report import StageClock
from hplan.problem.definition import Problem
from hplan.problem.options import PlanOptions
from hplan.problem.world import World
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.search import SearchResult, dense_search, reachable, two_level_search
from hplan.search.flood import has_bit
from hplan.search.grid import Grid, Occupancy
from hplan.search.lattice import Lattice
from hplan.search.result import path_cost
from hplan.search.wavefront import Wavefronts, meet
from hplan.smoothing.repair import leave_contact, repaired

#: How many motions of a way that cannot be shown clear are led around; with thick layers it succeeds more often.
DETOURS, THICK_DETOURS = 12, 20

#: So much farther from obstacles than the nodes of such a motion must nodes beside them be to be used instead [m].
ASIDE = 2e-3


#: Called with the name of each stage as it begins.
Progress = Callable[[str], None]


def no_progress(_: str) -> None:
    """Where nobody wants to know the stages."""


@dataclass(frozen=True)
class GridAttempt:
    """One try: how fine the grid is, and how much obstacles are grown in it.

    Attributes:
        step_deg: Largest spacing of the grid [deg].
        growth: Growth of obstacles in the C-space [m].
        beyond: How far the base may turn beyond start and goal; used where it turns.
        thick: Whether each layer of yaws holds the obstacles at all yaws nearer to it than to others, not at its own
            yaw alone: motions between layers are then seldom in contact, but narrow ways are closed.
    """

    step_deg: float
    growth: float = 0.0
    beyond: float = 0.0
    thick: bool = False


@dataclass(frozen=True, eq=False)
class Route(Record):
    """A way over the grid.

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


@dataclass(frozen=True, eq=False)
class PlanningTask(Record):
    """What every try at one motion shares.

    Attributes:
        world: The arm and what it must keep clear of.
        scene: Where that comes from.
        problem: Start, goal, joints that may move.
        options: How to plan.
        clock: Where time is noted.
        layers: Planar layers that are already there.
        progress: Called with the name of each stage as it begins.
    """

    world: World
    scene: Scene
    problem: Problem
    options: PlanOptions
    clock: StageClock
    layers: LayerCache
    progress: Progress

    @property
    def robot(self) -> Robot:
        """The arm."""
        return self.world.robot

    @property
    def field(self) -> ClearanceField:
        """Distances between the arm and what it must keep clear of."""
        return self.world.field

    def __getstate__(self) -> dict[str, tuple[Any, bool]]:
        """The fields; who listens to the progress of a plan does not travel with it."""
        return {**super().__getstate__(), "progress": (no_progress, False)}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Announce a stage, and note the time of what runs inside."""
        self.progress(name)
        with self.clock.stage(name):
            yield

    @property
    def axes(self) -> IntArray:
        """The joint behind each axis of the grid: the planar joints, then the yaw where it may turn."""
        planar = np.arange(self.robot.dof)[self.robot.arm_slice]
        return np.append(planar, 0) if self.problem.turns else planar

    def ends(self, space: Occupancy, margin: float) -> tuple[_Ends, _Ends]:
        """Start and goal joined to the grid by motions that keep `margin` [m] wherever they are evaluated.

        Raises:
            CertificationError: One of them is joined to no node.
        """
        return self.end(space, "start", margin), self.end(space, "goal", margin)

    def end(self, space: Occupancy, which: Literal["start", "goal"], margin: float) -> _Ends:
        """The nodes that start or goal is joined to nearby; in a tight place those that a way out of it leads to.

        Raises:
            CertificationError: There is none.
        """
        problem = self.problem
        q = problem.start if which == "start" else problem.goal
        ways = leave_contact(q, self.field, problem.lower, problem.upper, margin)
        for way in itertools.chain([q[None]], ways):
            nodes = joined_nodes(space, way[-1], self.axes, self.field, margin)
            first = next(nodes, None)
            if first is not None:
                return _Ends(way, first, nodes)
        raise CertificationError(
            f"no motion from the {which} to a free node of the grid can be shown clear; a smaller step may help",
            which=which,
        )

    def planar_grid(self, step_deg: float) -> Grid:
        """The grid over the planar joints.

        Raises:
            OptionError: A step that gives none.
        """
        planar = self.robot.arm_slice
        try:
            return Grid.over(self.problem.lower[planar], self.problem.upper[planar], np.radians(step_deg))
        except OptionError as error:
            raise OptionError("step_deg", self.options.step_deg, error.expected) from error

    def search(self, space: Occupancy, start: IntArray, goal: IntArray) -> SearchResult:
        """The search that the options ask for, its time noted."""
        self.progress("search")
        if self.options.method == "dense" or len(space.grid.shape) < 2:
            found = dense_search(space, start, goal)
        else:
            found = two_level_search(space, start, goal)
        for stage in ("layers", "sparse", "fallback"):
            self.clock.add(stage, getattr(found.times, stage))
        return found

    def configurations(self, grid: Grid, nodes: IntArray, start: _Ends, goal: _Ends) -> tuple[FloatArray, int]:
        """The way over nodes as (m, dof) configurations, with start and goal where they stand beside the grid.

        Returns:
            The configurations, and at which of them the nodes begin.
        """
        path = np.repeat(self.problem.start[None], len(nodes), axis=0)
        path[:, self.axes] = grid.coordinates(nodes)
        parts = [path]
        for node, end in ((0, start), (-1, goal)):
            way = end.way
            if np.abs(path[node] - way[-1]).max() < 1e-9:
                path[node], way = way[-1], way[:-1]
            parts.insert(0 if end is start else 2, way if end is start else way[::-1])
        return frozen(np.concatenate(parts)), len(parts[0])


def find_route(task: PlanningTask, grid_attempt: GridAttempt, margin: float) -> Route:
    """A way over the grid.

    Args:
        task: Arm, obstacles and what is asked.
        grid_attempt: Grid, growth and range of yaws.
        margin: Clearance asked of motions to the grid, and of all motions where the base turns, wherever they are
            evaluated [m].

    Raises:
        EnclosedError: There is none on the grid.
        CertificationError: Start or goal cannot be joined to the grid; no way on it can be shown clear.
        OptionError: A step that gives no grid.
    """
    return (
        _turning_route(task, grid_attempt, margin) if task.problem.turns else _planar_route(task, grid_attempt, margin)
    )


def planar_space(task: PlanningTask, grid_attempt: GridAttempt) -> tuple[Occupancy, ArmSections]:
    """The C-space with the base locked, and the sections it is made of."""
    with task.stage("cspace"):
        sections = sections_at(
            task.robot,
            task.world.bodies(grid_attempt.growth),
            task.robot.yaw_of(task.problem.start),
            link_model=task.options.link_model,
            within_reach=False,
        )
        return occupancy(task.robot.arm, sections, task.planar_grid(grid_attempt.step_deg)), sections


def _planar_route(task: PlanningTask, grid_attempt: GridAttempt, margin: float) -> Route:
    space, sections = planar_space(task, grid_attempt)
    start, goal = task.ends(space, margin)
    search, nodes = _planar_search(task, space, sections, start, goal)
    return Route(space, search, task.configurations(space.grid, nodes, start, goal)[0], grid_attempt.step_deg)


def _planar_search(
    task: PlanningTask, space: Occupancy, sections: ArmSections, start: _Ends, goal: _Ends
) -> tuple[SearchResult, IntArray]:
    """Search between the grid nodes that start and goal are joined to.

    Beside the grid there may be several, and the nearest may lie in a pocket: "no path" is said only when no pair
    of them is connected.
    """
    search = task.search(space, start.first, goal.first)
    if search.path is not None:
        return search, search.path
    most: tuple[int, BoolArray] = (0, np.zeros(space.grid.shape, dtype=np.bool_))
    for node in start.all():
        reached = reachable(space, node)
        for other in goal.all():
            if reached[tuple(other)]:
                search = task.search(space, node, other)
                if search.path is not None:
                    return search, search.path
        if int(reached.sum()) > most[0]:
            most = (int(reached.sum()), reached)
    what = f"the start reaches {most[0]} of {space.grid.size} nodes, not the goal"
    raise EnclosedError(PlanarRegion(what, space.grid, task.robot, sections, most[1]), most[0], open_ended=False)


def turning_space(task: PlanningTask, grid_attempt: GridAttempt) -> Occupancy:
    """The C-space over planar joints and yaw."""
    problem = task.problem
    with task.stage("cspace"):
        planar = task.planar_grid(grid_attempt.step_deg)
        yaws = yaw_axis(
            problem.start[0], problem.goal[0], math.radians(grid_attempt.step_deg), problem.lower[0], problem.upper[0],
            grid_attempt.beyond,
        )  # fmt: skip
        return turning_occupancy(
            task.robot,
            task.world.bodies(grid_attempt.growth),
            planar,
            *yaws,
            thick=grid_attempt.thick,
            layers=task.layers,
        )


def _turning_route(task: PlanningTask, grid_attempt: GridAttempt, margin: float) -> Route:
    problem, space = task.problem, turning_space(task, grid_attempt)
    start, goal = task.ends(space, margin)
    lattice = Lattice.of(space.grid.shape, space.grid.step)
    free = lattice.bordered(space.free_words)
    search = task.search(space, start.first, goal.first)
    nodes = search.path
    if nodes is None:
        search, fronts = _by_fronts(task, lattice, free, start, goal, search)
        nodes = fronts.path
        if nodes is None:
            raise _enclosed(task, grid_attempt, space, lattice, fronts)
    known: dict[bytes, FloatArray | None] = {}
    for _ in range(THICK_DETOURS if grid_attempt.thick else DETOURS):
        way, before = task.configurations(space.grid, nodes, start, goal)
        path, contacts = repaired(way, task.field, problem.lower, problem.upper, margin, known)
        if not contacts:
            return Route(space, search, path, grid_attempt.step_deg)
        here = contacts[0] - before  # the motion from this node to the next is in contact; below 0: from the start
        if here + 2 <= 0 or here >= len(nodes):
            break  # a way from a tight end to the grid, which is not the grid's to lead around
        _take_out(task, space.grid, lattice, free, nodes[max(0, here) : here + 2])
        ahead, behind = start.among(lattice, free, nodes[: max(0, here)]), goal.among(lattice, free, nodes[here + 2 :])
        bypass = None
        if len(ahead) and len(behind):
            with task.clock.stage("fallback"):
                bypass = meet(lattice, free, ahead, behind).path
        if bypass is None:
            break
        nodes = np.concatenate(
            [_until(nodes[: max(0, here)], bypass[0]), bypass, _after(nodes[here + 2 :], bypass[-1])]
        )
    raise CertificationError("no way on the grid can be shown clear as a motion")


def _take_out(task: PlanningTask, grid: Grid, lattice: Lattice, free: WordArray, nodes: IntArray) -> None:
    """Take nodes, and those beside them that are no farther from obstacles, out of the free ones."""
    steps = np.array(list(itertools.product((-1, 0, 1), repeat=len(grid.shape))))
    q = task.problem.start.copy()

    def clearance(node: IntArray) -> float:
        q[task.axes] = grid.coordinates(node)
        return task.field.clearance(q)

    most = max(clearance(node) for node in nodes) + ASIDE
    beside = np.unique((nodes[:, None] + steps).reshape(-1, len(grid.shape)), axis=0)
    inside = ((beside >= 0) & (beside < grid.shape)).all(axis=1)
    for node in beside[inside]:
        row, bit = lattice.row_of(node), int(node[-1])
        if has_bit(free, row, bit) and clearance(node) <= most:
            free[row, bit >> 6] &= ~(np.uint64(1) << np.uint64(bit & 63))


def _until(nodes: IntArray, last: IntArray) -> IntArray:
    """The nodes before one of them; none where it is not among them."""
    return nodes[: int((nodes == last).all(axis=1).argmax())] if len(nodes) else nodes


def _after(nodes: IntArray, first: IntArray) -> IntArray:
    """The nodes after one of them; none where it is not among them."""
    if not len(nodes):
        return nodes
    matches = (nodes == first).all(axis=1)
    return nodes[int(matches.argmax()) + 1 :] if matches.any() else nodes[:0]


def _by_fronts(
    task: PlanningTask, lattice: Lattice, free: WordArray, start: _Ends, goal: _Ends, search: SearchResult
) -> tuple[SearchResult, Wavefronts]:
    """A way between any of the nodes that start and goal are joined to."""
    begin = time.perf_counter()
    fronts = meet(lattice, free, np.array(start.all()), np.array(goal.all()))
    seconds = time.perf_counter() - begin
    task.clock.add("fallback", seconds)
    found = replace(
        search,
        path=fronts.path,
        cost=math.inf if fronts.path is None else path_cost(fronts.path, lattice.step),
        expansions=search.expansions.with_fallback(0, fronts.flooded),
        times=replace(search.times, fallback=search.times.fallback + seconds),
        fallback="wavefront",
    )
    return found, fronts


class _Ends:
    """The nodes that one end is joined to; the first is found at once, the others when asked for.

    Attributes:
        way: (k, dof) configurations from the end to where the nodes are joined, mostly the end alone.
        first: The nearest node.
    """

    def __init__(self, way: FloatArray, first: IntArray, others: Iterator[IntArray]) -> None:
        self.way = way
        self.first = first
        self._rest = others
        self._known = [first]

    def all(self) -> list[IntArray]:
        """All of them, the nearest first."""
        self._known.extend(self._rest)
        return self._known

    def among(self, lattice: Lattice, free: WordArray, nodes: IntArray) -> IntArray:
        """Those of a way's nodes that are still free; of the nodes that this end is joined to where there are none."""
        for choice in (nodes, self.all()):
            left = [node for node in choice if has_bit(free, lattice.row_of(node), int(node[-1]))]
            if left:
                return np.array(left)
        return np.empty((0, len(lattice.shape)), dtype=np.int64)


def _enclosed(
    task: PlanningTask, grid_attempt: GridAttempt, space: Occupancy, lattice: Lattice, fronts: Wavefronts
) -> EnclosedError:
    """The error for an end that is enclosed; `open_ended` where more yaws might open it."""
    grid, reached = space.grid, lattice.unbordered(fronts.reached)
    count, which = int(np.bitwise_count(reached).sum()), fronts.enclosed
    other = "goal" if which == "start" else "start"
    what = f"the {which} is connected to {count} of {grid.size} nodes, and the {other} is not among them"
    region = TurningRegion(what, grid, task.world, grid_attempt.growth, reached)
    return EnclosedError(region, count, open_ended=open_ended(task.problem, grid, reached))
