#!/usr/bin/env python3
"""Reproduce the paper: its numbers beside the measured ones, and its figures.

The paper plans for a three-link arm among one disc: analytic C-space (equations 1-3), a 2-D A* in every theta3 slice,
connectivity restoration, and a second A* on the sparse union. Three searches are run here:

- *dense*: A* on all 753,571 nodes, `hplan.search.dense_search`;
- *plain*: the two levels to the letter of the paper, written out below in a page of plain code: A* in every slice,
  with or without a path; the first path carried back towards the start; A* on the union;
- *hplan*: `hplan.search.two_level_search`, which floods before it searches, restores on both sides, is complete on the
  grid, and takes the paper's straight-line bound or the octile one.

Run without arguments it prints the report and writes the figures (PNG), `reproduction.json` and `reproduction.md`
into `paper/`. Figure numbers follow the paper's order of presentation as far as it is known here; subjects and layout
are our own. Exit status: 0 done, 2 bad input.
"""

from __future__ import annotations

import argparse
import heapq
import json
import math
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if __name__ == "__main__":  # runs from a checkout too
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from hplan import cspace
from hplan.arrays import BoolArray, FloatArray, IntArray
from hplan.errors import HplanError, OutputError
from hplan.grid import Grid, Occupancy
from hplan.robot import Robot, load_robot
from hplan.scene_file import load_scene
from hplan.search import SearchResult, dense_search, two_level_search
from hplan.section import LINK_MODELS, ArmSections, LinkModel, arm_sections

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

_T = TypeVar("_T")


@dataclass(frozen=True)
class Paper:
    """What the paper reports (Fig. 16 and text).

    Attributes:
        dense_cost_deg: Cost of the dense A* [deg].
        dense_points: Points of its path.
        dense_expansions: Nodes it expands.
        two_level_cost_deg: Cost of the two-level method [deg].
        two_level_points: Points of its path.
        two_level_expansions: Nodes that its second level expands.
        two_level_time_s: Its time [s].
        first_feasible_deg: First theta3 slice with a path [deg].
    """

    dense_cost_deg: float = 145.214952
    dense_points: int = 107
    dense_expansions: int = 154_647
    two_level_cost_deg: float = 145.800739
    two_level_points: int = 108
    two_level_expansions: int = 6_605
    two_level_time_s: float = 2.56
    first_feasible_deg: int = 45


PAPER = Paper()

#: The workspace demonstration, in the paper's unit.
DEMO_SIZE = (60.0, 60.0)
DEMO_LAYERS = (5.0, 25.0)
DEMO_CENTRE = (30.0, 30.0, 15.0)
DEMO_DIAMETER = 15.0
DEMO_START = (5.0, 10.0, 5.0)
DEMO_GOAL = (55.0, 50.0, 25.0)


@dataclass(frozen=True)
class Run:
    """One search, measured.

    Attributes:
        cost: Cost of its path ([deg], or the workspace's unit).
        points: Points of its path.
        layer_expansions: Nodes expanded in the slices; 0 for the dense search.
        path_expansions: Nodes expanded by the search that finds the path: dense, or on the sparse union.
        flooded: Nodes reached by bit-parallel flooding; no expansions.
        layer_ms: Time of the slices [ms].
        total_ms: Time of all of it [ms], median of several runs, warm.
    """

    cost: float
    points: int
    layer_expansions: int
    path_expansions: int
    flooded: int
    layer_ms: float
    total_ms: float

    @property
    def total_expansions(self) -> int:
        """All nodes expanded."""
        return self.layer_expansions + self.path_expansions


@dataclass(frozen=True)
class ModelRow:
    """One link model.

    Attributes:
        link_model: Its name.
        occupied: Occupied nodes of the grid.
        first_feasible_deg: First theta3 slice with a path [deg].
        last_feasible_deg: Last one [deg].
        dense_cost_deg: Cost of the dense A* [deg].
        dense_points: Points of its path.
        dense_expansions: Nodes it expands.
        cspace_ms: Time of the occupancy [ms], median, warm.
    """

    link_model: str
    occupied: int
    first_feasible_deg: int
    last_feasible_deg: int
    dense_cost_deg: float
    dense_points: int
    dense_expansions: int
    cspace_ms: float


@dataclass(frozen=True)
class Gap:
    """The feasibility gap: the last slice without a path and the first with one.

    Attributes:
        last_without_deg: Last theta3 before the first path [deg].
        first_with_deg: First theta3 with a path [deg].
        reached_without: Nodes the start reaches in the slice without a path.
        reached_with: The same in the slice with one.
        layers_searched: Slices searched, theta3 of the start to theta3 of the goal.
        layers_without: Those of them without a path.
        expansions_without: Nodes that a plain A* expands in those.
    """

    last_without_deg: int
    first_with_deg: int
    reached_without: int
    reached_with: int
    layers_searched: int
    layers_without: int
    expansions_without: int


@dataclass(frozen=True)
class Ties:
    """What the choice among equally short slice paths does to the second level.

    Attributes:
        choices: Sets of slice paths tried: two fixed orders of the moves, the rest drawn from a fixed seed.
        lowest_cost_deg: Lowest cost of the second level [deg].
        highest_cost_deg: Highest cost [deg].
        fewest_points: Fewest points of the path.
        most_points: Most points.
        fewest_expansions: Fewest nodes expanded by the second level.
        most_expansions: Most.
    """

    choices: int
    lowest_cost_deg: float
    highest_cost_deg: float
    fewest_points: int
    most_points: int
    fewest_expansions: int
    most_expansions: int


@dataclass(frozen=True)
class Slip:
    """The example with the bearing read as the paper prints it, arctan(x / y).

    Attributes:
        occupied: Occupied nodes.
        goal_is_free: Whether the goal's node is free.
        feasible_slices: theta3 slices with a path.
        cost_deg: Cost of the dense A* [deg]; None where no path exists.
    """

    occupied: int
    goal_is_free: bool
    feasible_slices: int
    cost_deg: float | None


@dataclass(frozen=True)
class Reproduction:
    """All numbers of the report.

    Attributes:
        paper: The paper's.
        nodes: Nodes of the joint grid.
        dense: Dense A*.
        plain: The two levels to the letter.
        straight: `two_level_search` with the paper's straight-line bound.
        octile: `two_level_search` with the octile bound.
        models: The three link models.
        gap: The feasibility gap (capsule model).
        ties: What ties do.
        sparse_nodes: Nodes of the sparse union (plain).
        demo_dense: Workspace demonstration, dense A*, in the paper's unit.
        demo_two_level: The same, two-level.
        demo_layers: Layers of the demonstration.
        slip_link_frame: Bearing read as printed, arctan(x / y), with x and y in the frame of the link before.
        slip_arm_plane: The same with x and y in the arm plane.
        versions: Versions of Python, numpy and numba.
    """

    paper: Paper
    nodes: int
    dense: Run
    plain: Run
    straight: Run
    octile: Run
    models: tuple[ModelRow, ...]
    gap: Gap
    ties: Ties
    sparse_nodes: int
    demo_dense: Run
    demo_two_level: Run
    demo_layers: int
    slip_link_frame: Slip
    slip_arm_plane: Slip
    versions: dict[str, str]

    def as_dict(self) -> dict[str, Any]:
        """The numbers ready for JSON."""
        return {"format": "hplan-reproduction/1", **asdict(self)}


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the numbers were taken from; the figures are drawn from it.

    Attributes:
        robot: The arm.
        centre: (2,) centre of the disc in the arm plane [m].
        radius: Its radius [m].
        sections: The obstacle cut by the arm plane (capsule model).
        occupancy: The C-space.
        start: (3,) node index.
        goal: (3,) node index.
        dense: Dense A*.
        plain: The two levels to the letter.
        demo: Workspace of the demonstration.
        demo_result: Its two-level search.
    """

    robot: Robot
    centre: FloatArray
    radius: float
    sections: ArmSections
    occupancy: Occupancy
    start: IntArray
    goal: IntArray
    dense: SearchResult
    plain: PlainTwoLevel
    demo: Occupancy
    demo_result: SearchResult


# ------------------------------------------------------------------------------------- the method to the letter


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
            paths[number] = _at_height(result.path, number)
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
        heads[number] = _at_height(kept, number)
    return heads


def second_level(
    occupancy: Occupancy, pieces: list[IntArray], start: IntArray, goal: IntArray
) -> tuple[BoolArray, SearchResult]:
    """A* on the union of slice paths and restored parts."""
    union = np.zeros(occupancy.grid.shape, dtype=np.bool_)
    for piece in [*pieces, start[None], goal[None]]:
        union[tuple(piece.T)] = True
    return union, dense_search(Occupancy.from_mask(occupancy.grid, ~union), start, goal)


def _at_height(path: IntArray, number: int) -> IntArray:
    return np.column_stack([path, np.full(len(path), number)])


def _slice_grid(grid: Grid) -> Grid:
    return Grid(grid.lower[:-1], grid.step[:-1], grid.shape[:-1])


# ------------------------------------------------------------------------------------------------------- measuring


def reproduce(
    repetitions: int = 5, tie_choices: int = 22, report: Callable[[str], None] = lambda _: None
) -> Reproduction:
    """Measure everything.

    Args:
        repetitions: Runs of which each time is the median; one more comes first, to warm up.
        tie_choices: Sets of slice paths tried for the ties, at least 2.
        report: Told what is being done.
    """
    return measure(repetitions, tie_choices, report)[0]


def measure(
    repetitions: int = 5, tie_choices: int = 22, report: Callable[[str], None] = lambda _: None
) -> tuple[Reproduction, Evidence]:
    """As `reproduce`, with the evidence for the figures."""
    robot, scene = load_robot(), load_scene()
    grid = cspace.joint_grid(robot.arm, math.radians(1.0))
    start_joints, goal_joints = scene.start.joints(), scene.goal.joints()
    assert start_joints is not None
    assert goal_joints is not None
    start, goal = grid.nearest(start_joints[robot.arm_slice]), grid.nearest(goal_joints[robot.arm_slice])

    models = []
    for link_model in LINK_MODELS:
        report(f"link model {link_model}")
        models.append(_model_row(robot, grid, start, goal, link_model, repetitions))

    report("dense A*")
    sections = arm_sections(robot, scene.solids)
    occupancy = cspace.occupancy(robot.arm, sections, grid)
    dense, dense_ms = _timed(lambda: dense_search(occupancy, start, goal), repetitions)
    report("two levels, to the letter")
    plain, plain_ms = _timed(lambda: plain_two_level(occupancy, start, goal), repetitions)
    report("two levels, hplan")
    straight, straight_ms = _timed(lambda: two_level_search(occupancy, start, goal, octile=False), repetitions)
    octile, octile_ms = _timed(lambda: two_level_search(occupancy, start, goal, octile=True), repetitions)
    report("ties")
    ties = _try_ties(occupancy, plain, start, goal, tie_choices)
    report("arctan(x / y)")
    slips = [_slip(_printed_arctan(robot, grid, sections, in_link_frame=flag), start, goal) for flag in (True, False)]
    report("workspace demonstration")
    demo, demo_start, demo_goal = demonstration()
    demo_dense, demo_dense_ms = _timed(lambda: dense_search(demo, demo_start, demo_goal), repetitions)
    demo_result, demo_ms = _timed(lambda: two_level_search(demo, demo_start, demo_goal, octile=False), repetitions)

    scale = 180.0 / math.pi
    assert plain.second.path is not None
    numbers = Reproduction(
        paper=PAPER,
        nodes=grid.size,
        dense=_run(dense, dense_ms, scale),
        plain=Run(
            cost=plain.second.cost * scale,
            points=len(plain.second.path),
            layer_expansions=sum(plain.expansions.values()),
            path_expansions=plain.second.expansions.total,
            flooded=0,
            layer_ms=1e3 * plain.layer_s,
            total_ms=plain_ms,
        ),
        straight=_run(straight, straight_ms, scale),
        octile=_run(octile, octile_ms, scale),
        models=tuple(models),
        gap=_gap(occupancy, plain, start),
        ties=ties,
        sparse_nodes=int(plain.union.sum()),
        demo_dense=_run(demo_dense, demo_dense_ms, 1.0),
        demo_two_level=_run(demo_result, demo_ms, 1.0),
        demo_layers=demo.grid.shape[2],
        slip_link_frame=slips[0],
        slip_arm_plane=slips[1],
        versions=_versions(),
    )
    origin, axes = robot.plane_at(0.0)
    disc = scene.solids[0]
    centre = ((disc.core - origin) @ axes.T)[0, :2]
    evidence = Evidence(robot, centre, disc.rounding, sections, occupancy, start, goal, dense, plain, demo, demo_result)
    return numbers, evidence


def demonstration() -> tuple[Occupancy, IntArray, IntArray]:
    """The paper's workspace demonstration: grid, start and goal node."""
    lower = (0.0, 0.0, DEMO_LAYERS[0])
    upper = (*DEMO_SIZE, DEMO_LAYERS[1])
    grid = Grid.over(lower, upper, 1.0)
    mesh = np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)
    inside = np.linalg.norm(mesh - np.array(DEMO_CENTRE), axis=-1) <= 0.5 * DEMO_DIAMETER
    return Occupancy.from_mask(grid, inside), grid.nearest(DEMO_START), grid.nearest(DEMO_GOAL)


def _timed(work: Callable[[], _T], repetitions: int) -> tuple[_T, float]:
    """The run of median time: its result and its time [ms]. One run before all warms up."""
    work()
    runs = []
    for _ in range(repetitions):
        begin = time.perf_counter()
        result = work()
        runs.append((1e3 * (time.perf_counter() - begin), result))
    median, result = sorted(runs, key=lambda run: run[0])[len(runs) // 2]
    return result, median


def _run(result: SearchResult, total_ms: float, scale: float) -> Run:
    assert result.path is not None
    expansions = result.expansions
    return Run(
        cost=result.cost * scale,
        points=len(result.path),
        layer_expansions=expansions.layers,
        path_expansions=expansions.sparse + expansions.fallback,
        flooded=expansions.flooded,
        layer_ms=1e3 * result.times.layers,
        total_ms=total_ms,
    )


def _model_row(
    robot: Robot, grid: Grid, start: IntArray, goal: IntArray, link_model: LinkModel, repetitions: int
) -> ModelRow:
    sections = arm_sections(robot, load_scene().solids, link_model=link_model)
    occupancy, cspace_ms = _timed(lambda: cspace.occupancy(robot.arm, sections, grid), max(20, repetitions))
    dense = dense_search(occupancy, start, goal)
    feasible = two_level_search(occupancy, start, goal).feasible_slices
    assert feasible is not None
    degrees = np.degrees(grid.axis(2)[np.flatnonzero(feasible)])
    assert dense.path is not None
    return ModelRow(
        link_model=link_model,
        occupied=occupancy.occupied_count,
        first_feasible_deg=round(float(degrees[0])),
        last_feasible_deg=round(float(degrees[-1])),
        dense_cost_deg=math.degrees(dense.cost),
        dense_points=len(dense.path),
        dense_expansions=dense.expansions.total,
        cspace_ms=cspace_ms,
    )


def _gap(occupancy: Occupancy, plain: PlainTwoLevel, start: IntArray) -> Gap:
    first = min(plain.paths)
    free = ~occupancy.occupied
    degrees = np.degrees(occupancy.grid.axis(2))
    without = [number for number in plain.expansions if number not in plain.paths]
    return Gap(
        last_without_deg=round(float(degrees[first - 1])),
        first_with_deg=round(float(degrees[first])),
        reached_without=len(_distances(free[:, :, first - 1], (int(start[0]), int(start[1])))),
        reached_with=len(_distances(free[:, :, first], (int(start[0]), int(start[1])))),
        layers_searched=len(plain.expansions),
        layers_without=len(without),
        expansions_without=sum(plain.expansions[number] for number in without),
    )


_MOVES = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]


def _distances(free: BoolArray, source: tuple[int, int]) -> dict[tuple[int, int], float]:
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


def _try_ties(occupancy: Occupancy, plain: PlainTwoLevel, start: IntArray, goal: IntArray, choices: int) -> Ties:
    """Second level for several choices among equally short slice paths."""
    flat_start, flat_goal = (int(start[0]), int(start[1])), (int(goal[0]), int(goal[1]))
    ahead = {number: _distances(~occupancy.occupied[:, :, number], flat_goal) for number in plain.paths}
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
    results = []
    for rule in rules:
        paths = {number: _at_height(descend(distances, rule), number) for number, distances in ahead.items()}
        heads = carried_back(occupancy, paths, int(start[2]))
        results.append(second_level(occupancy, [*paths.values(), *heads.values()], start, goal)[1])
    costs = [math.degrees(result.cost) for result in results]
    points = [len(result.path) for result in results if result.path is not None]
    expansions = [result.expansions.total for result in results]
    return Ties(choices, min(costs), max(costs), min(points), max(points), min(expansions), max(expansions))


def _slip(occupancy: Occupancy, start: IntArray, goal: IntArray) -> Slip:
    if not occupancy.is_free(goal):
        return Slip(occupancy.occupied_count, goal_is_free=False, feasible_slices=0, cost_deg=None)
    feasible = two_level_search(occupancy, start, goal).feasible_slices
    assert feasible is not None
    dense = dense_search(occupancy, start, goal)
    cost = None if dense.path is None else math.degrees(dense.cost)
    return Slip(occupancy.occupied_count, goal_is_free=True, feasible_slices=int(feasible.sum()), cost_deg=cost)


def _printed_arctan(robot: Robot, grid: Grid, sections: ArmSections, *, in_link_frame: bool) -> Occupancy:
    """C-space with the bearing read as the paper prints it, arctan(x / y).

    Args:
        robot: The arm.
        grid: The joint grid.
        sections: One disc for each link.
        in_link_frame: Take x and y along and across the link before; else in the arm plane.
    """
    arm = robot.arm
    mesh = np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij", sparse=True)
    occupied = np.zeros(grid.shape, dtype=np.bool_)
    x, y, heading = np.zeros((1, 1, 1)), np.zeros((1, 1, 1)), np.zeros((1, 1, 1))
    for k in range(3):
        cx, cy = sections.vertices[sections.vertex_start[sections.link_start[k]]]
        radius, length = sections.radii[sections.link_start[k]], arm.lengths[k]
        frame = heading if in_link_frame else np.zeros_like(heading)
        dx = np.cos(frame) * (cx - x) + np.sin(frame) * (cy - y)
        dy = np.cos(frame) * (cy - y) - np.sin(frame) * (cx - x)
        rho = np.hypot(dx, dy)
        with np.errstate(divide="ignore", invalid="ignore"):
            bearing = frame + np.arctan(dx / dy)
            tip = np.arccos(np.clip((length**2 + rho**2 - radius**2) / (2.0 * length * rho), -1.0, 1.0))
            half = np.where(rho**2 <= length**2 + radius**2, np.arcsin(np.clip(radius / rho, -1.0, 1.0)), tip)
        half = np.where(rho > length + radius, -1.0, np.where(rho <= radius, math.pi, half))
        heading = heading + arm.signs[k] * mesh[k] + arm.offsets[k]
        apart = np.abs((heading - bearing + math.pi) % (2.0 * math.pi) - math.pi)
        occupied |= apart <= half
        x, y = x + length * np.cos(heading), y + length * np.sin(heading)
    return Occupancy.from_mask(grid, occupied)


def _versions() -> dict[str, str]:
    import numba

    import hplan

    return {
        "hplan": hplan.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
    }


# ------------------------------------------------------------------------------------------------------- reporting

Rows = list[tuple[str, ...]]


def comparison_rows(r: Reproduction) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of the table beside the paper's Fig. 16."""
    paper = r.paper
    header = ("", "paper", "plain", "straight line", "octile")
    rows: Rows = [
        ("dense A*: cost [deg]", f"{paper.dense_cost_deg:.6f}", f"{r.dense.cost:.6f}", "", ""),
        ("dense A*: points", f"{paper.dense_points}", f"{r.dense.points}", "", ""),
        ("dense A*: expansions", f"{paper.dense_expansions:,}", f"{r.dense.path_expansions:,}", "", ""),
        ("dense A*: time [ms]", "-", f"{r.dense.total_ms:.1f}", "", ""),
    ]
    runs = (r.plain, r.straight, r.octile)
    rows += [
        ("two-level: cost [deg]", f"{paper.two_level_cost_deg:.6f}", *(f"{run.cost:.6f}" for run in runs)),
        ("two-level: points", f"{paper.two_level_points}", *(f"{run.points}" for run in runs)),
        ("  second level expands", f"{paper.two_level_expansions:,}", *(f"{run.path_expansions:,}" for run in runs)),
        ("  layers expand", "not given", *(f"{run.layer_expansions:,}" for run in runs)),
        ("  in all", "not given", *(f"{run.total_expansions:,}" for run in runs)),
        ("  flooded", "-", *(f"{run.flooded:,}" for run in runs)),
        ("two-level: time [ms]", f"{1e3 * paper.two_level_time_s:,.0f}", *(f"{run.total_ms:.1f}" for run in runs)),
    ]
    return header, rows


def model_rows(r: Reproduction) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of the table of the link models: nodes, slices with a path, dense A*."""
    header = (
        "link model",
        "occupied",
        "slices [deg]",
        "cost [deg]",
        "points",
        "expanded",
        "[ms]",
    )
    rows: Rows = [
        (
            row.link_model,
            f"{row.occupied:,}",
            f"{row.first_feasible_deg}..{row.last_feasible_deg}",
            f"{row.dense_cost_deg:.6f}",
            str(row.dense_points),
            f"{row.dense_expansions:,}",
            f"{row.cspace_ms:.2f}",
        )
        for row in r.models
    ]
    rows.append(
        ("published", "-", f"from {r.paper.first_feasible_deg}", f"{r.paper.dense_cost_deg:.6f}",
         str(r.paper.dense_points), f"{r.paper.dense_expansions:,}", "-")
    )  # fmt: skip
    return header, rows


def demo_rows(r: Reproduction) -> tuple[tuple[str, ...], Rows]:
    """Header and rows of the table of the workspace demonstration."""
    header = ("workspace", "cost", "points", "layers", "second", "in all", "time [ms]")
    rows: Rows = [
        (
            name,
            f"{run.cost:.4f}",
            str(run.points),
            f"{run.layer_expansions:,}",
            f"{run.path_expansions:,}",
            f"{run.total_expansions:,}",
            f"{run.total_ms:.1f}",
        )
        for name, run in (
            ("dense A*", r.demo_dense),
            (f"two-level, {r.demo_layers} layers", r.demo_two_level),
        )
    ]
    return header, rows


def left_out(r: Reproduction) -> list[str]:
    """What the paper does not count."""
    total = r.plain.total_expansions
    return [
        f"The layer searches. The paper's {r.paper.two_level_expansions:,} expansions are of the order of the second "
        f"level alone ({r.plain.path_expansions:,} here). Before it, a plain A* in {r.gap.layers_searched} slices "
        f"expands {r.plain.layer_expansions:,} nodes, {r.gap.expansions_without:,} of them in the "
        f"{r.gap.layers_without} slices that have no path. In all {total:,}, against {r.dense.total_expansions:,} "
        f"for the dense A*: {total / r.dense.total_expansions:.2f} of it, not "
        f"{r.paper.two_level_expansions / r.paper.dense_expansions:.3f}.",
        f"The total time. Its {r.paper.two_level_time_s:g} s stand beside the expansions of the second level. Here the "
        f"plain run takes {r.plain.total_ms:.0f} ms, {r.plain.layer_ms:.0f} ms of it in the layers; the dense A* "
        f"{r.dense.total_ms:.0f} ms, hplan's two levels {r.octile.total_ms:.0f} ms.",
        "What happens where restoration does not reach: a gap on the goal's side or in the middle, or no slice with a "
        "path. The method as printed is not complete.",
    ]


def differences(r: Reproduction) -> list[str]:
    """Where hplan differs from the paper."""
    link, plane, ties = r.slip_link_frame, r.slip_arm_plane, r.ties
    own = next(row for row in r.models if row.link_model == "paper")
    goal = "the goal is free" if link.goal_is_free else "the goal itself is forbidden"
    return [
        f"Bearing. The paper prints arctan(x/y). With x and y in the frame of the link before, {goal}: "
        f"{link.feasible_slices or 'no'} slice has a path, and {'one' if link.cost_deg else 'none'} exists in 3-D. "
        f"With x and y in the arm plane {plane.feasible_slices} slices have one and the dense cost is "
        f"{plane.cost_deg or math.inf:.6f} deg. Read as arctan2(y, x), slices, cost and points are the paper's.",
        f"Ties. Many slice paths are equally short, and which one a search returns decides what the second level can "
        f"use. Over {ties.choices} choices its cost goes from {ties.lowest_cost_deg:.6f} to "
        f"{ties.highest_cost_deg:.6f} deg with {ties.fewest_points} to {ties.most_points} points; the paper's "
        f"{r.paper.two_level_cost_deg:.6f} deg with {r.paper.two_level_points} lies between. The dense A* has ties "
        f"too: with the paper's own link model it expands {own.dense_expansions:,} nodes here, "
        f"{r.paper.dense_expansions:,} in the paper.",
        f"Flooding. hplan settles which slices have a path by bit-parallel flooding ({r.straight.flooded:,} nodes, 64 "
        f"at once) and searches only those: {r.straight.layer_expansions:,} layer expansions instead of "
        f"{r.plain.layer_expansions:,}; {r.octile.layer_expansions:,} with the octile bound.",
        "Restoration. The paper carries the first path back towards the start; hplan also carries the last one on "
        "towards the goal and closes gaps in the middle from both sides. Where that does not join start and goal, the "
        "grid is flooded: a dense search follows, or the proof that there is no path.",
    ]


def columns_text() -> str:
    """What the columns of the comparison are."""
    return (
        "plain: the paper's method to the letter. straight line, octile: hplan's two-level search with the paper's "
        "bound and with its own."
    )


def gap_text(r: Reproduction) -> str:
    """The feasibility gap in a sentence."""
    gap = r.gap
    return (
        f"theta3 = {gap.last_without_deg} deg has no path (the start reaches {gap.reached_without:,} nodes of the "
        f"slice), {gap.first_with_deg} deg has one ({gap.reached_with:,} nodes). The paper: from "
        f"{r.paper.first_feasible_deg} deg."
    )


def markdown(r: Reproduction) -> str:
    """The report as Markdown, as the README includes it."""

    def table(header: tuple[str, ...], rows: Rows) -> str:
        lines = ["| " + " | ".join(header) + " |", "|---" + "|---:" * (len(header) - 1) + "|"]
        return "\n".join([*lines, *("| " + " | ".join(cell.strip() for cell in row) + " |" for row in rows)])

    blocks = [
        table(*comparison_rows(r)),
        columns_text(),
        f"The feasibility gap: {gap_text(r)}",
        f"The link models: occupied nodes of {r.nodes:,}, slices with a path, dense A*, time of the C-space [ms].",
        table(*model_rows(r)),
        "The workspace demonstration: cost in its own unit, expansions of the layers, of the second level and in all.",
        table(*demo_rows(r)),
        "What the paper leaves out:\n\n" + "\n".join(f"- {text}" for text in left_out(r)),
        "Where hplan differs:\n\n" + "\n".join(f"- {text}" for text in differences(r)),
    ]
    return "\n\n".join(blocks) + "\n"


def show(r: Reproduction, console: Console) -> None:
    """Print the report."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    def table(title: str, header: tuple[str, ...], rows: Rows) -> None:
        result = Table(
            title=Text(title, style="bold"),
            title_justify="left",
            header_style="bold",
            box=box.SIMPLE_HEAD,
            pad_edge=False,
        )
        for place, name in enumerate(header):
            style = "yellow" if name == "paper" else ""
            result.add_column(Text(name), justify="right" if place else "left", style=style)
        for row in rows:
            result.add_row(*(Text(cell, no_wrap=True) for cell in row))
        console.print()
        console.print(result)

    table("Fig. 16: dense A* and the two-level method", *comparison_rows(r))
    console.print(Text(columns_text(), style="dim"))
    console.print("\n[bold]The feasibility gap[/bold]")
    console.print(gap_text(r), markup=False)
    table(f"Link models: occupied of {r.nodes:,}, slices with a path, dense A*, C-space [ms]", *model_rows(r))
    table("The workspace demonstration: cost in its own unit, expansions", *demo_rows(r))
    for title, texts in (("What the paper leaves out", left_out(r)), ("Where hplan differs", differences(r))):
        console.print(f"\n[bold]{title}[/bold]")
        items = Table.grid(padding=(0, 1))
        for text in texts:
            items.add_row("-", Text(text))
        console.print(items)


# --------------------------------------------------------------------------------------------------------- figures


def figures(evidence: Evidence) -> dict[str, Callable[[], Figure]]:
    """File name -> how to draw it."""
    from hplan.view import figures as flat
    from hplan.view import figures_3d as solid

    e = evidence
    arm, grid = e.robot.arm, e.occupancy.grid
    start_q, goal_q = grid.coordinates(e.start), grid.coordinates(e.goal)
    first = min(e.plain.paths)
    assert e.dense.path is not None
    assert e.plain.second.path is not None
    assert e.demo_result.path is not None
    dense_path, sparse_path, demo_path = e.dense.path, e.plain.second.path, e.demo_result.path
    field = flat.clearance_field(arm, e.sections, grid)

    def at(*degrees: float) -> list[int]:
        return [int(np.argmin(np.abs(np.degrees(grid.axis(2)) - value))) for value in degrees]

    return {
        "figure_06_link_cases.png": flat.link_cases,
        "figure_07_arm_and_obstacle.png": lambda: flat.arm_and_obstacle(arm, e.centre, e.radius, start_q, goal_q),
        "figure_08_cspace_links_1_2.png": lambda: flat.two_link_cspace(arm, e.sections, grid),
        "figure_09_slices.png": lambda: flat.slices(
            arm, e.sections, e.occupancy, e.start, e.goal, at(0, 30, 44, 45, 70, 90)
        ),
        "figure_10_layer_paths.png": lambda: flat.layer_paths(
            e.occupancy, e.start, e.goal, e.plain.paths, e.plain.expansions, [first - 1, first, *at(57, 70)]
        ),
        "figure_11_restoration.png": lambda: flat.restoration(
            e.occupancy, e.start, e.goal, e.plain.paths[first], e.plain.heads, [first - 1, *at(30, 15, 0)]
        ),
        "figure_12_workspace.png": lambda: solid.workspace(
            e.demo, DEMO_CENTRE, 0.5 * DEMO_DIAMETER, e.demo_result.slice_paths, demo_path
        ),
        "figure_14_cspace_and_path.png": lambda: solid.cspace_and_path(
            grid, field, e.plain.paths, e.plain.heads, sparse_path
        ),
        "figure_15_motion.png": lambda: flat.motions(
            arm,
            e.centre,
            e.radius,
            {"Dense A*": grid.coordinates(dense_path), "Two-level": grid.coordinates(sparse_path)},
        ),
        "overview.png": lambda: solid.overview(arm, e.centre, e.radius, grid, field, sparse_path),
    }


# ---------------------------------------------------------------------------------------------------- command line


def check_writable(directory: Path) -> None:
    """Make sure that files can be written into `directory`, which is created where it is missing.

    Raises:
        OutputError: They cannot.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        raise OutputError(directory, error.strerror or str(error)) from error


def write_all(directory: Path, contents: dict[str, bytes]) -> None:
    """Write all files or none: each first under a temporary name, then all renamed.

    Raises:
        OutputError: They cannot be written.
    """
    staged: list[tuple[Path, Path]] = []
    try:
        for name, content in contents.items():
            handle, temporary = tempfile.mkstemp(dir=directory, prefix=f".{name}.")
            staged.append((Path(temporary), directory / name))
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
            Path(temporary).chmod(0o644)
        for temporary_path, target in staged:
            temporary_path.replace(target)
    except OSError as error:
        raise OutputError(directory, error.strerror or str(error)) from error
    finally:
        for temporary_path, _ in staged:
            temporary_path.unlink(missing_ok=True)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        description="Print the paper's numbers beside the measured ones and draw its figures.",
        epilog="Exit status: 0 done, 2 bad input.",
    )
    result.add_argument(
        "--out", type=Path, default=Path("paper"), metavar="DIR",
        help="folder for figures (PNG), reproduction.json and reproduction.md (default: %(default)s)",
    )  # fmt: skip
    result.add_argument("--no-figures", action="store_true", help="numbers only")
    result.add_argument("--markdown", action="store_true", help="print the report as Markdown instead of tables")
    return result


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = parser().parse_args(arguments)
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from hplan.view.figures import png_bytes, require_matplotlib

    console, errors = Console(), Console(stderr=True)
    try:
        if not options.no_figures:
            require_matplotlib()
        check_writable(options.out)
        with Progress(
            SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            console=errors, transient=True,
        ) as progress:  # fmt: skip
            steps = progress.add_task("measuring", total=9)
            numbers, evidence = measure(
                report=lambda text: progress.update(steps, advance=1, description=f"measuring: {text}")
            )
            contents: dict[str, bytes] = {}
            if not options.no_figures:
                drawings = figures(evidence)
                drawn = progress.add_task("drawing", total=len(drawings))
                for name, draw in drawings.items():
                    progress.update(drawn, description=f"drawing: {name}")
                    contents[name] = png_bytes(draw())
                    progress.advance(drawn)
        contents["reproduction.md"] = markdown(numbers).encode()
        contents["reproduction.json"] = (json.dumps(numbers.as_dict(), indent=2) + "\n").encode()
        write_all(options.out, contents)
    except HplanError as error:
        errors.print("error:", style="bold red", end=" ")
        errors.print(error.message, markup=False, highlight=False, soft_wrap=True)
        return error.exit_status
    if options.markdown:
        sys.stdout.write(markdown(numbers))
        return 0
    show(numbers, console)
    console.print(f"\nWritten to {options.out}: {len(contents)} files.", highlight=False, soft_wrap=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
