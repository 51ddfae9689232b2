"""Measure everything: the example of the paper by three searches, link models, ties, the demonstration."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from studies.paper.demonstration import demonstration
from studies.paper.plain import PlainTwoLevel, path_found, plain_two_level
from studies.paper.results import PAPER, Gap, ModelRow, Reproduction, Run
from studies.paper.slip import printed_arctan, slip_of
from studies.paper.ties import distances_from
from studies.paper.variants import try_variants
from studies.planar_cspace import arm_sections, joint_grid

from hplan.base.arrays import FloatArray, IntArray
from hplan.cspace import occupancy as cspace
from hplan.cspace.sections import LINK_MODELS, ArmSections, LinkModel
from hplan.errors import InputError
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.search import SearchResult, dense_search, slices_with_path, two_level_search
from hplan.search.astar import row_bounds
from hplan.search.grid import Grid, Occupancy
from hplan.search.lattice import Lattice
from hplan.search.restoration import union_of
from hplan.search.slice_search import search_slices

_T = TypeVar("_T")

#: How often `measure` reports what is being done.
STEPS = 12


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
    grid = joint_grid(robot.arm, math.radians(1.0))
    start, goal = (_node(grid, pose.joints(), robot) for pose in (scene.start, scene.goal))

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
    default, default_ms = _timed(lambda: two_level_search(occupancy, start, goal), repetitions)
    occupancies: dict[LinkModel, Occupancy] = {
        "capsule": occupancy,
        "paper": cspace.occupancy(robot.arm, arm_sections(robot, scene.solids, link_model="paper"), grid),
    }
    variants = try_variants(occupancies, start, goal, tie_choices, report)
    report("arctan(x / y)")
    slips = [slip_of(printed_arctan(robot, grid, sections, in_link_frame=flag), start, goal) for flag in (True, False)]
    report("workspace demonstration")
    demo, demo_start, demo_goal = demonstration()
    demo_dense, demo_dense_ms = _timed(lambda: dense_search(demo, demo_start, demo_goal), repetitions)
    demo_result, demo_ms = _timed(lambda: two_level_search(demo, demo_start, demo_goal, octile=False), repetitions)

    scale = 180.0 / math.pi
    numbers = Reproduction(
        paper=PAPER,
        nodes=grid.size,
        dense=_run(dense, dense_ms, scale),
        plain=Run(
            cost=plain.second.cost * scale,
            points=len(path_found(plain.second)),
            layer_expansions=sum(plain.expansions.values()),
            path_expansions=plain.second.expansions.total,
            settled=0,
            flooded=0,
            layer_ms=1e3 * plain.layer_s,
            total_ms=plain_ms,
        ),
        straight=_run(straight, straight_ms, scale),
        hplan=_run(default, default_ms, scale, settled=_settled_rows(occupancy, start, goal)),
        models=tuple(models),
        gap=_gap(occupancy, plain, start),
        variants=variants,
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


def _node(grid: Grid, joints: FloatArray | None, robot: Robot) -> IntArray:
    """Grid node of the scene's start or goal.

    Raises:
        InputError: It is not given by joint angles.
    """
    if joints is None:
        raise InputError("the example wants its start and goal as joint angles")
    return grid.nearest(joints[robot.arm_slice])


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


def _run(result: SearchResult, total_ms: float, scale: float, settled: int = 0) -> Run:
    expansions = result.expansions
    return Run(
        cost=result.cost * scale,
        points=len(path_found(result)),
        layer_expansions=expansions.layers,
        path_expansions=expansions.sparse + expansions.fallback,
        settled=settled,
        flooded=expansions.flooded,
        layer_ms=1e3 * result.times.layers,
        total_ms=total_ms,
    )


def _settled_rows(occupancy: Occupancy, start: IntArray, goal: IntArray) -> int:
    """Rows that `two_level_search` settles for the bound of its search on the union; its result has them in a sum."""
    lattice = Lattice.of(occupancy.grid.shape, occupancy.grid.step)
    free = lattice.bordered(occupancy.free_words)
    between = range(int(min(start[-1], goal[-1])), int(max(start[-1], goal[-1])) + 1)
    nodes, _ = union_of(lattice, free, search_slices(lattice, free, start, goal, between), start, goal)
    return row_bounds(lattice, nodes, lattice.row_of(goal)).settled


def _model_row(
    robot: Robot, grid: Grid, start: IntArray, goal: IntArray, link_model: LinkModel, repetitions: int
) -> ModelRow:
    sections = arm_sections(robot, load_scene().solids, link_model=link_model)
    occupancy, cspace_ms = _timed(lambda: cspace.occupancy(robot.arm, sections, grid), max(20, repetitions))
    dense = dense_search(occupancy, start, goal)
    degrees = np.degrees(grid.axis(2)[slices_with_path(occupancy, start, goal)])
    return ModelRow(
        link_model=link_model,
        occupied=occupancy.occupied_count,
        first_feasible_deg=round(float(degrees[0])),
        last_feasible_deg=round(float(degrees[-1])),
        dense_cost_deg=math.degrees(dense.cost),
        dense_points=len(path_found(dense)),
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
        reached_without=len(distances_from(free[:, :, first - 1], (int(start[0]), int(start[1])))),
        reached_with=len(distances_from(free[:, :, first], (int(start[0]), int(start[1])))),
        layers_searched=len(plain.expansions),
        layers_without=len(without),
        expansions_without=sum(plain.expansions[number] for number in without),
    )


def _versions() -> dict[str, str]:
    import numba

    import hplan

    return {
        "hplan": hplan.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
    }
