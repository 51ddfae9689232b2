"""The reference scene: time by stage, the searches, the C-space, and the motion beside those of other recipes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from studies.benchmark.growth import beside_the_way
from studies.benchmark.measure import Progress, median, spread, stages_in_cpu_time, timed, times_ms
from studies.benchmark.motions import (
    Findings,
    TimedMotion,
    look_at,
    of_rows,
    quickest_polyline,
    stopping_duration,
    toppra_motion,
)
from studies.benchmark.paths import PeerTask, motions_of, summary, without_jerk
from studies.benchmark.planners import Ompl
from studies.benchmark.scenes import STEP_DEG
from studies.planar_cspace import arm_sections, joint_grid
from studies.validation.cspace import sampled_occupancy

from hplan.base.arrays import FloatArray
from hplan.base.polyline import path_length
from hplan.collision.coal_scene import CoalScene
from hplan.cspace.occupancy import occupancy
from hplan.errors import InputError
from hplan.planning.plan import PlanResult, plan
from hplan.planning.report import STAGES
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.search import SearchResult, dense_search, two_level_search
from hplan.search.grid import Occupancy

#: Discs of the crowded C-space: the scene's own, and small ones that leave its motion free.
MANY_DISCS = 100


def measure(
    robot: Robot, scene: Scene, *, seed: int, quick: bool, ompl: Ompl | None, progress: Progress
) -> dict[str, Any]:
    """Measure the reference set.

    Args:
        robot: The arm.
        scene: The reference scene.
        seed: Seed of the crowded C-spaces.
        quick: A few repetitions only.
        ompl: OMPL, where it is installed.
        progress: Told how far it is.
    """
    repetitions = 5 if quick else 31
    progress("reference: stages", 0, 4)
    result, stages = _stages(robot, scene, repetitions)
    progress("reference: searches", 1, 4)
    if result.occupancy is None or result.search is None or result.search.path is None:
        raise InputError(f"scene {scene.name!r}: its motion is empty")
    ends = result.search.path[0], result.search.path[-1]
    searches = _searches(result.occupancy, *ends, repetitions)
    progress("reference: C-space", 2, 4)
    space = _spaces(robot, scene, seed, repetitions, 1 if quick else 5)
    progress("reference: motions", 3, 4)
    task = PeerTask.of(robot, scene)
    motions = _motions(task, result)
    progress("reference: motions", 4, 4)
    few = (("RRTConnect", 1.0, 5), ("BITstar", 0.2, 2), ("BITstar", 1.0, 1))
    many = (("RRTConnect", 1.0, 50), ("BITstar", 0.2, 10), ("BITstar", 1.0, 10))
    planners = None if ompl is None else _planners(task, ompl, few if quick else many, result, progress)
    return {
        "scene": scene.name,
        "repetitions": repetitions,
        "stages_ms": stages,
        "searches": searches,
        "cspace": space,
        "motions": motions,
        "planners": planners,
    }


def _stages(robot: Robot, scene: Scene, repetitions: int) -> tuple[PlanResult, dict[str, Any]]:
    """Median time of each stage, in CPU time, and the whole in both clocks [ms]."""
    result = plan(robot, scene)
    with stages_in_cpu_time():
        reports = [plan(robot, scene).report["time_ms"] for _ in range(repetitions + 2)][2:]
    wall = [plan(robot, scene).report["time_ms"]["total"] for _ in range(repetitions)]
    table = {name: median([report[name] for report in reports]) for name in (*STAGES, "total")}
    return result, {
        **table,
        "total_spread": spread([report["total"] for report in reports]),
        "total_wall": median(wall),
    }


def _searches(space: Occupancy, start: Any, goal: Any, repetitions: int) -> dict[str, Any]:
    """The two-level search and the dense one on the same C-space."""
    runs: dict[str, tuple[Callable[[], SearchResult], int]] = {
        "two_level": (lambda: two_level_search(space, start, goal), repetitions),
        "two_level_paper": (lambda: two_level_search(space, start, goal, octile=False), max(3, repetitions // 4)),
        "dense": (lambda: dense_search(space, start, goal), max(3, repetitions // 2)),
        "dense_octile": (lambda: dense_search(space, start, goal, octile=True), max(3, repetitions // 2)),
    }
    table: dict[str, Any] = {}
    for name, (run, count) in runs.items():
        found = run()
        table[name] = {
            "ms": median(times_ms(run, count, warm=1)),
            "cost_deg": float(np.degrees(found.cost)),
            "points": 0 if found.path is None else len(found.path),
            "expansions": found.expansions.total,
            "flooded": found.expansions.flooded,
        }
    fast = table["two_level"]["ms"]
    table["ratio_dense"] = table["dense"]["ms"] / fast
    table["ratio_dense_octile"] = table["dense_octile"]["ms"] / fast
    return table


def _spaces(robot: Robot, scene: Scene, seed: int, repetitions: int, coal_repetitions: int) -> dict[str, Any]:
    """The analytic C-space beside coal's sampling of the same grid, and the C-space of many discs."""
    grid = joint_grid(robot.arm, np.radians(STEP_DEG))
    checker = CoalScene(robot, scene.solids)
    sections = arm_sections(robot, scene.solids)
    ours = occupancy(robot.arm, sections, grid)
    whole = median(times_ms(lambda: occupancy(robot.arm, arm_sections(robot, scene.solids), grid), 3 * repetitions))
    alone = median(times_ms(lambda: occupancy(robot.arm, sections, grid), 3 * repetitions))
    sampled: list[float] = []
    differing = 0
    for _ in range(coal_repetitions):
        theirs, ms = timed(lambda: sampled_occupancy(checker, grid))
        sampled.append(ms)
        differing = int((theirs != ours.occupied).sum())
    crowded, crowded_alone, shares = [], [], []
    for number in range(3 if coal_repetitions == 1 else 20):
        discs = beside_the_way(robot, scene, MANY_DISCS, seed + number)
        cut = arm_sections(robot, discs)
        shares.append(occupancy(robot.arm, cut, grid).occupied_count / grid.size)
        crowded.append(median(times_ms(lambda d=discs: occupancy(robot.arm, arm_sections(robot, d), grid), 5)))  # type: ignore[misc]
        crowded_alone.append(median(times_ms(lambda c=cut: occupancy(robot.arm, c, grid), 5)))  # type: ignore[misc]
    return {
        "nodes": grid.size,
        "occupied": ours.occupied_count,
        "analytic_ms": whole,
        "analytic_grid_ms": alone,
        "coal_ms": median(sampled),
        "differing_nodes": differing,
        "ratio_coal": median(sampled) / whole,
        "many_discs": MANY_DISCS,
        "many_occupied_share": median(shares),
        "many_ms": median(crowded),
        "many_grid_ms": median(crowded_alone),
    }


def _motions(task: PeerTask, result: PlanResult) -> dict[str, Any]:
    """Length, duration and what fine samples show, of hplan's motions and of what else becomes of the grid path."""
    robot, scene = task.robot, task.scene
    free_of_jerk = without_jerk(robot)
    ours = {
        "hplan": result,
        "hplan_length": plan(robot, scene, PlanOptions(objective="length")),
        "hplan_no_jerk": plan(free_of_jerk, scene),
    }
    table: dict[str, Any] = {}
    for name, planned in ours.items():
        path = planned.path
        table[name] = {
            "length_deg": 0.0 if path is None else float(np.degrees(path.length)),
            "certified": planned.certificate.verified,
            **_numbers(look_at(robot, task.checker, of_rows(planned.trajectory))),
        }
    taut = quickest_polyline(robot, result.grid_path, task.field, task.smallest_margin)
    table["grid_spline"] = _recipe(task, result.grid_path, toppra_motion(robot, result.grid_path))
    table["grid_defaults"] = _recipe(task, result.grid_path, toppra_motion(robot, result.grid_path, defaults=True))
    table["taut_spline"] = _recipe(task, taut, toppra_motion(robot, taut))
    table["taut_defaults"] = _recipe(task, taut, toppra_motion(robot, taut, defaults=True))
    table["taut_stops"] = {
        "length_deg": float(np.degrees(path_length(taut))),
        "corners": len(taut) - 2,
        "duration_s": stopping_duration(robot, taut),
        "certified": task.field.is_clear(taut, task.smallest_margin),
    }
    for row in table.values():
        row["ratio"] = row["duration_s"] / table["hplan"]["duration_s"]
    no_jerk = table["hplan_no_jerk"]["duration_s"]
    return {
        "rows": table,
        "hplan_to_grid_spline": table["hplan"]["duration_s"] / table["grid_spline"]["duration_s"],
        "hplan_to_stops": table["hplan"]["duration_s"] / table["taut_stops"]["duration_s"],
        "no_jerk_to_grid_spline": no_jerk / table["grid_spline"]["duration_s"],
        "no_jerk_to_stops": no_jerk / table["taut_stops"]["duration_s"],
    }


def _recipe(task: PeerTask, path: FloatArray, motion: TimedMotion | None) -> dict[str, Any]:
    length = {"length_deg": float(np.degrees(path_length(path))), "certified": False}
    if motion is None:
        return {**length, "duration_s": float("nan")}
    return {**length, **_numbers(look_at(task.robot, task.checker, motion))}


def _numbers(findings: Findings) -> dict[str, Any]:
    flags = ("collides", "leaves_range", "breaks_limits")
    return {**vars(findings), **{flag: getattr(findings, flag) for flag in flags}}


def _planners(
    task: PeerTask, ompl: Ompl, runs: tuple[tuple[str, float, int], ...], result: PlanResult, progress: Progress
) -> dict[str, Any]:
    """OMPL's planners, each several times, and what becomes of their paths."""
    start, goal = task.problem.start, task.problem.goal
    ompl.plan(task, start, goal)  # loads the kernels
    table: dict[str, Any] = {}
    for planner, seconds, count in runs:
        found, motions = [], []
        for number in range(count):
            progress(f"reference: {planner}, {seconds:g} s", number, count)
            run = ompl.plan(task, start, goal, planner=planner, seconds=seconds)
            if run.path is not None:
                found.append(run)
                motions.append(motions_of(task, run.path))
        progress(f"reference: {planner}, {seconds:g} s", count, count)
        numbers = summary(
            motions, [run.total_ms for run in found], [result.trajectory.duration] * len(motions), asked=count
        )
        table[f"{planner} {seconds:g} s" if planner == "BITstar" else planner] = {
            "planner": planner,
            "seconds": seconds,
            "plan_ms": median([run.plan_ms for run in found]),
            "simplify_ms": median([run.simplify_ms for run in found]),
            "compiled_ms": median([run.compiled_ms for run in found]),
            "length_before_deg": float(np.degrees(median([run.length_before for run in found]))),
            **numbers,
        }
    return table
