"""Random planar scenes: how often, how fast, how short and how quick, beside the dense search and OMPL."""

from __future__ import annotations

from typing import Any

import numpy as np
from studies.benchmark.measure import Progress, median, spread, timed
from studies.benchmark.motions import quickest_polyline, stopping_duration, toppra_motion
from studies.benchmark.paths import PathMotions, PeerTask, motions_of, summary, without_jerk
from studies.benchmark.planners import Ompl, OmplResult
from studies.benchmark.scenes import PlanarScene, random_scene

from hplan.errors import HplanError, NoPathError
from hplan.planning.plan import PlanResult, plan
from hplan.robot.model import Robot
from hplan.search import dense_search, two_level_search

#: Repetitions of the two-level search on a scene, of which the median counts.
_REPETITIONS = 3

#: OMPL's planners and the time each has for a path [s].
PLANNERS = (("RRTConnect", 1.0), ("BITstar", 0.2))


def measure(robot: Robot, *, seed: int, scenes: int, ompl: Ompl | None, progress: Progress) -> dict[str, Any]:
    """Measure the clutter set.

    Args:
        robot: The arm.
        seed: Seed of the scenes.
        scenes: Number of scenes drawn.
        ompl: OMPL, where it is installed.
        progress: Told how far it is.
    """
    rows: list[dict[str, Any]] = []
    failed: list[dict[str, Any]] = []
    runs: dict[str, list[tuple[OmplResult, PathMotions | None, float]]] = {name: [] for name, _ in PLANNERS}
    blocked = disagreeing = 0
    for number in range(scenes):
        progress("clutter", number, scenes)
        drawn = random_scene(robot, seed, number)
        if number == 0:
            _warm_up(robot, drawn, ompl)
        search = _compare_searches(drawn)
        disagreeing += search["two_level_path"] != search["dense_path"]
        planned, ms, error = _plan(robot, drawn)
        if not search["dense_path"]:
            blocked += 1
            if not isinstance(error, NoPathError):
                failed.append(_failure(drawn, error))
            continue
        if planned is None:
            failed.append(_failure(drawn, error))
            continue
        task = PeerTask.of(robot, drawn.scene)
        rows.append({"number": number, "total_ms": ms, **search, **_motion(task, planned)})
        for planner, seconds in PLANNERS if ompl is not None else ():
            run = None
            if ompl is not None:
                run = ompl.plan(task, task.problem.start, task.problem.goal, planner=planner, seconds=seconds)
            if run is not None:
                motions = None if run.path is None else motions_of(task, run.path)
                runs[planner].append((run, motions, planned.trajectory.duration))
                rows[-1][planner] = {"ms": run.total_ms, **({} if motions is None else _durations(motions))}
    progress("clutter", scenes, scenes)
    return {
        "seed": seed,
        "scenes": scenes,
        "with_path": len(rows) + sum(item["with_path"] for item in failed),
        "blocked": blocked,
        "disagreeing": disagreeing,
        "failed": failed,
        **_hplan_numbers(rows),
        "rows": rows,
        "planners": None if ompl is None else {name: _planner_numbers(found) for name, found in runs.items()},
    }


def _warm_up(robot: Robot, drawn: PlanarScene, ompl: Ompl | None) -> None:
    """Load every kernel before the clock runs."""
    _plan(robot, drawn)
    _compare_searches(drawn)
    if ompl is not None:
        task = PeerTask.of(robot, drawn.scene)
        ompl.plan(task, task.problem.start, task.problem.goal)


def _plan(robot: Robot, drawn: PlanarScene) -> tuple[PlanResult | None, float, HplanError | None]:
    def run() -> tuple[PlanResult | None, HplanError | None]:
        try:
            return plan(robot, drawn.scene), None
        except HplanError as error:
            return None, error

    (planned, error), ms = timed(run)
    return planned, ms, error


def _compare_searches(drawn: PlanarScene) -> dict[str, Any]:
    """Two-level and dense search on the same C-space."""
    fast_ms = []
    for _ in range(_REPETITIONS):
        fast, ms = timed(lambda: two_level_search(drawn.space, drawn.start, drawn.goal))
        fast_ms.append(ms)
    dense, dense_ms = timed(lambda: dense_search(drawn.space, drawn.start, drawn.goal))
    both = fast.path is not None and dense.path is not None
    return {
        "two_level_path": fast.path is not None,
        "dense_path": dense.path is not None,
        "two_level_ms": median(fast_ms),
        "dense_ms": dense_ms,
        "search_ratio": dense_ms / median(fast_ms),
        "cost_ratio": fast.cost / dense.cost if both else float("nan"),
        "fallback": fast.fallback,
    }


def _motion(task: PeerTask, planned: PlanResult) -> dict[str, Any]:
    """The motion beside the two recipes that start from its own grid path."""
    robot = task.robot
    duration = planned.trajectory.duration
    grid_motion = toppra_motion(robot, planned.grid_path)
    taut = quickest_polyline(robot, planned.grid_path, task.field, task.smallest_margin)
    stops = stopping_duration(robot, taut)
    try:
        no_jerk = plan(without_jerk(robot), task.scene).trajectory.duration
    except HplanError:
        no_jerk = float("nan")
    grid_s = float("nan") if grid_motion is None else grid_motion.duration
    return {
        "direct": task.field.is_clear(np.stack([task.problem.start, task.problem.goal]), task.smallest_margin),
        "certified": planned.certificate.verified,
        "clearance_mm": 1e3 * planned.certificate.min_clearance_m,
        "length_deg": 0.0 if planned.path is None else float(np.degrees(planned.path.length)),
        "duration_s": duration,
        "no_jerk_s": no_jerk,
        "grid_spline_s": grid_s,
        "stops_s": stops,
        "to_grid_spline": duration / grid_s,
        "to_stops": duration / stops,
        "no_jerk_to_grid_spline": no_jerk / grid_s,
        "no_jerk_to_stops": no_jerk / stops,
    }


def _durations(motions: PathMotions) -> dict[str, Any]:
    return {
        "length_deg": motions.length_deg,
        "spline_s": None if motions.spline is None else motions.spline.duration_s,
        "rounded_s": motions.rounded_s,
        "processed_s": motions.processed_s,
    }


def _failure(drawn: PlanarScene, error: HplanError | None) -> dict[str, Any]:
    return {
        "number": drawn.number,
        "with_path": drawn.has_path,
        "kind": "none" if error is None else error.kind,
        "message": "a motion was found where the dense search finds none" if error is None else error.message,
        "spare_clearance_mm": 1e3 * drawn.spare_clearance_m,
    }


def _hplan_numbers(rows: list[dict[str, Any]]) -> dict[str, Any]:
    def column(name: str, chosen: list[dict[str, Any]] = rows) -> list[float]:
        return [float(row[name]) for row in chosen if np.isfinite(row[name])]

    world = [row for row in rows if not row["direct"]]
    ratios = ("to_grid_spline", "to_stops", "no_jerk_to_grid_spline", "no_jerk_to_stops")
    costs = column("cost_ratio")
    return {
        "planned": len(rows),
        "certified": sum(row["certified"] for row in rows),
        "total_ms": spread(column("total_ms")),
        "slowest": sorted(({k: row[k] for k in ("number", "total_ms", "fallback")} for row in rows), key=_by_time)[:5],
        "length_deg": median(column("length_deg")),
        "duration_s": median(column("duration_s")),
        "two_level_ms": spread(column("two_level_ms")),
        "dense_ms": spread(column("dense_ms")),
        "search_ratio": {**spread(column("search_ratio")), "min": min(column("search_ratio"), default=float("nan"))},
        "cost_ratio": {**spread(costs), "optimal": sum(ratio < 1.0 + 1e-9 for ratio in costs)},
        "fallbacks": {name: sum(row["fallback"] == name for row in rows) for name in ("none", "all_slices", "dense")},
        **{name: {**spread(column(name)), "slower": sum(ratio > 1.0 for ratio in column(name))} for name in ratios},
        "around": {
            "scenes": len(world),
            "total_ms": spread(column("total_ms", world)),
            **{name: spread(column(name, world)) for name in ("search_ratio", "cost_ratio", *ratios)},
        },
    }


def _by_time(row: dict[str, Any]) -> float:
    return -float(row["total_ms"])


def _planner_numbers(found: list[tuple[OmplResult, PathMotions | None, float]]) -> dict[str, Any]:
    solved = [(run, motions, ours) for run, motions, ours in found if motions is not None]
    path_ms = [run.total_ms for run, _, _ in solved]
    return {
        "path_spread_ms": spread(path_ms),
        "compiled_ms": median([run.compiled_ms for run, _, _ in solved]),
        **summary([motions for _, motions, _ in solved], path_ms, [ours for _, _, ours in solved], asked=len(found)),
    }
