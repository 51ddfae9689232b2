"""The paper's numbers measured again: three searches, link models, open choices."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from studies.harness import Row, plain, table
from studies.measure import environment, median_ms
from studies.paper.plain import RESTORATIONS, PlainTwoLevel, Restoration, path_found, plain_two_level
from studies.planar_cspace import arm_sections, joint_grid

from hplan.base.arrays import FloatArray, IntArray
from hplan.planar.family_reader import family_of
from hplan.planar.grid import SearchResult, dense_search, slices_with_path, two_level_search
from hplan.planar.grid import occupancy as cspace
from hplan.planar.grid.grid import Grid, Occupancy
from hplan.planar.grid.sections import LINK_MODELS, ArmSections
from hplan.planning.options import LinkModel
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene

_T = TypeVar("_T")

#: The paper's workspace demonstration, all in its unit: a ball in the middle of 21 layers.
DEMO_LOWER, DEMO_UPPER, DEMO_CENTRE, DEMO_DIAMETER = (0.0, 0.0, 5.0), (60.0, 60.0, 25.0), (30.0, 30.0, 15.0), 15.0
DEMO_START, DEMO_GOAL = (5.0, 10.0, 5.0), (55.0, 50.0, 25.0)

#: Number of progress reports of `measure`.
STEPS = 8


class Run(NamedTuple):
    """One search: cost [deg, or the workspace's unit], points, expansions, floods, time [ms].

    `layers` are the entries taken from the open lists of the slices, `second` the entries of the search that finds the
    path: nodes, and rows settled beforehand for its bound. `flooded` counts nodes.
    """

    cost: float
    points: int
    layers: int
    second: int
    flooded: int
    ms: float

    @property
    def total(self) -> int:
        """All entries taken from open lists."""
        return self.layers + self.second


#: The paper's reported values (Fig. 16 and text); its two-level search counts the second level alone.
PAPER_DENSE, PAPER_TWO_LEVEL = Run(145.214952, 107, 0, 154_647, 0, 23_500.0), Run(145.800739, 108, 0, 6_605, 0, 2_560.0)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Sources of the numbers; the figures are drawn from them.

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


@dataclass(frozen=True)
class Reproduction:
    """All numbers.

    Attributes:
        nodes: Nodes of the joint grid.
        runs: Searches of the example: `dense`, `plain`, `straight` (plain A* and the paper's bound), `hplan`.
        models: A row for each link model.
        variants: A row for each choice that the text leaves open.
        demo: Searches of the demonstration: `dense` and `two-level`.
        without: Slices without a path that the plain method searches, and the nodes that it expands there.
    """

    nodes: int
    runs: dict[str, Run]
    models: list[Row]
    variants: list[Row]
    demo: dict[str, Run]
    without: tuple[int, int]

    def as_dict(self) -> Row:
        """The numbers ready for JSON."""
        runs = {name: {key: run._asdict() for key, run in getattr(self, name).items()} for name in ("runs", "demo")}
        return plain({"format": "hplan-reproduction/2", "environment": environment(), **vars(self), **runs})  # type: ignore[no-any-return]


def measure(repetitions: int = 5, report: Callable[[str], None] = lambda _: None) -> tuple[Reproduction, Evidence]:
    """Measure everything; each time is the median of several runs.

    `report` is called with the current step.
    """
    robot, scene = load_robot(), load_scene()
    grid = joint_grid(family_of(robot).arm, math.radians(1.0))
    start, goal = (
        grid.nearest_node(end.configuration[family_of(robot).arm_slice]) for end in (scene.start, scene.goal)
    )
    spaces: dict[LinkModel, Occupancy] = {}
    models = []
    for model in LINK_MODELS:
        report(f"link model {model}")
        sections = arm_sections(robot, scene.solids, link_model=model)
        spaces[model], ms = _timed(lambda sections=sections: cspace.occupancy(family_of(robot).arm, sections, grid), 20)  # type: ignore[misc]
        models.append(_model_row(model, spaces[model], start, goal) | {"cspace_ms": ms})
    space = spaces["capsule"]
    report("searches")
    dense, dense_ms = _timed(lambda: dense_search(space, start, goal), repetitions)
    letter, letter_ms = _timed(lambda: plain_two_level(space, start, goal), repetitions)
    straight = _timed(lambda: two_level_search(space, start, goal, octile=False), repetitions)
    default = _timed(lambda: two_level_search(space, start, goal), repetitions)
    report("what the text leaves open")
    variants = [
        _variant_row(model, spaces[model], start, goal, last, restoration)
        for restoration in RESTORATIONS
        for model in ("capsule", "paper")
        for last in (int(goal[2]), grid.shape[2] - 1)
    ]
    report("demonstration")
    demo = demonstration()
    demo_dense = _timed(lambda: dense_search(*demo), repetitions)
    demo_two = _timed(lambda: two_level_search(*demo, octile=False), repetitions)
    second, expanded = letter.second, sum(letter.expansions.values())
    without = [number for number in letter.expansions if number not in letter.paths]
    scale = 180.0 / math.pi
    numbers = Reproduction(
        nodes=grid.size,
        runs={
            "dense": _run(dense, dense_ms, scale),
            "plain": Run(second.cost * scale, len(path_found(second)), expanded, second.expansions.total, 0, letter_ms),
            "straight": _run(*straight, scale),
            "hplan": _run(*default, scale),
        },
        models=models,
        variants=variants,
        demo={"dense": _run(*demo_dense), "two-level": _run(*demo_two)},
        without=(len(without), sum(letter.expansions[number] for number in without)),
    )
    origin, axes = family_of(robot).plane_at(0.0)
    disc, sections = scene.solids[0], arm_sections(robot, scene.solids)
    centre = ((disc.core - origin) @ axes.T)[0, :2]
    found = Evidence(robot, centre, disc.rounding, sections, space, start, goal, dense, letter, demo[0], demo_two[0])
    return numbers, found


def demonstration() -> tuple[Occupancy, IntArray, IntArray]:
    """The paper's workspace demonstration: grid, start and goal node."""
    grid = Grid.from_limits(DEMO_LOWER, DEMO_UPPER, 1.0)
    mesh = np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)
    inside = np.linalg.norm(mesh - np.array(DEMO_CENTRE), axis=-1) <= 0.5 * DEMO_DIAMETER
    return Occupancy.from_mask(grid, inside), grid.nearest_node(DEMO_START), grid.nearest_node(DEMO_GOAL)


def _timed(work: Callable[[], _T], repetitions: int) -> tuple[_T, float]:
    """The result and the median CPU time of some runs [ms]."""
    return work(), median_ms(work, repetitions)


def _run(result: SearchResult, ms: float, scale: float = 1.0) -> Run:
    expansions = result.expansions
    second = expansions.sparse + expansions.fallback
    return Run(result.cost * scale, len(path_found(result)), expansions.layers, second, expansions.flooded, ms)


def _model_row(model: LinkModel, space: Occupancy, start: IntArray, goal: IntArray) -> Row:
    dense = dense_search(space, start, goal)
    degrees = np.degrees(space.grid.axis(2)[slices_with_path(space, start, goal)])
    return {
        "model": model,
        "occupied": space.occupied_count,
        "first_deg": round(float(degrees[0])),
        "last_deg": round(float(degrees[-1])),
        "cost_deg": math.degrees(dense.cost),
        "points": len(path_found(dense)),
        "expansions": dense.expansions.total,
    }


def _variant_row(
    model: LinkModel, space: Occupancy, start: IntArray, goal: IntArray, last: int, restoration: Restoration
) -> Row:
    run = plain_two_level(space, start, goal, last_slice=last, restoration=restoration)
    return {
        "slices": f"0..{round(math.degrees(space.grid.axis(2)[last]))}",
        "carried": restoration,
        "model": model,
        "cost_deg": math.degrees(run.second.cost),
        "points": len(path_found(run.second)),
        "layers": sum(run.expansions.values()),
        "second": run.second.expansions.total,
        "sparse_nodes": int(run.union.sum()),
    }


def markdown(r: Reproduction) -> str:
    """The report as Markdown: the paper's numbers next to the measured ones."""
    runs = {"paper": PAPER_TWO_LEVEL} | {name: r.runs[name] for name in ("plain", "straight", "hplan")}
    dense, own = PAPER_DENSE, r.runs["dense"]
    empty = [""] * 3

    def each(name: str, text: Callable[[Run], str], paper: str | None = None) -> list[str]:
        cells = [text(run) for run in runs.values()]
        return [name, *(cells if paper is None else [paper, *cells[1:]])]

    comparison = [
        ["dense A*: cost [deg]", f"{dense.cost:.6f}", f"{own.cost:.6f}", *empty[1:]],
        ["dense A*: points", f"{dense.points}", f"{own.points}", *empty[1:]],
        ["dense A*: expansions", f"{dense.second:,}", f"{own.second:,}", *empty[1:]],
        ["dense A*: time [ms]", f"{dense.ms:,.0f}", f"{own.ms:.1f}", *empty[1:]],
        each("two-level: cost [deg]", lambda run: f"{run.cost:.6f}"),
        each("two-level: points", lambda run: f"{run.points}"),
        each("second level: expansions", lambda run: f"{run.second:,}"),
        each("layers: nodes", lambda run: f"{run.layers:,}", "not given"),
        each("nodes flooded", lambda run: f"{run.flooded:,}", "-"),
        each("two-level: time [ms]", lambda run: f"{run.ms:,.1f}"),
        each("time, dense / two-level", lambda run: f"{own.ms / run.ms:.1f}", f"{dense.ms / PAPER_TWO_LEVEL.ms:.1f}"),
    ]
    demo = [[name, f"{run.cost:.4f}", f"{run.points}", f"{run.total:,}"] for name, run in r.demo.items()]
    blocks = [
        table(("", *runs), comparison),
        "plain: the paper's method to the letter. straight: hplan's two-level search with plain A*, the paper's bound. "
        "hplan: as it is by default, with the octile bound and, in the layers, what slices before have shown. Flooded "
        "nodes are not counted: 64 are reached at once.",
        f"The paper does not count the layers. Plain A* in them expands {runs['plain'].layers:,} nodes, "
        f"{r.without[1]:,} of them in the {r.without[0]} slices that have no path: with the second level "
        f"{runs['plain'].total / own.total:.2f} of the dense A*.",
        f"Link models: occupied of {r.nodes:,} nodes, slices with a path, dense A*, C-space [ms].",
        _table_of(r.models),
        "What the text leaves open: the range of slices, and whether the whole first slice path or its first waypoint "
        "alone is carried back; the second level's cost, nodes of the layers, of the second level and of the union.",
        _table_of(r.variants),
        "The workspace demonstration, straight-line bound: cost in its own unit, points, expansions.",
        table(("", "cost", "points", "expansions"), demo),
    ]
    return "\n\n".join(block if isinstance(block, str) else "\n".join(block) for block in blocks) + "\n"


def _table_of(rows: list[Row]) -> list[str]:
    """Rows as a table, with a column for each key."""
    cells = [
        [f"{v:.6f}" if isinstance(v, float) else f"{v:,}" if isinstance(v, int) else v for v in row.values()]
        for row in rows
    ]
    return table([key.replace("_", " ") for key in rows[0]], cells)
