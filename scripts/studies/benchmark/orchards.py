"""Orchards, all joints free: what is solved, how fast, and how quick the motions are, beside OMPL.

RRTConnect has 10 s and stops at its first path. BIT* improves its path for 1 s; where hplan or RRTConnect finds nothing
it has 10 s too, so that nothing is missed that it would find. Both simplify, then their paths become motions as in
`studies.benchmark.paths`. What counts as OMPL's best is the quickest certified motion along any of its paths.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from studies.benchmark.measure import Progress, evenly_chosen, median, or_error, spread, stages_in_cpu_time, timed
from studies.benchmark.motions import look_at, of_rows
from studies.benchmark.orchard_scenes import CropProblems, OrchardProblem, crop_of, measured_orchards, shipped_orchards
from studies.benchmark.paths import PathMotions, PeerTask, motions_of, summary
from studies.benchmark.planners import Ompl, OmplResult

from hplan.errors import HplanError
from hplan.planning.plan import PlanResult, plan
from hplan.robot.model import Robot

#: OMPL's planners.
PLANNERS = ("RRTConnect", "BITstar")

#: Time for a path [s], and for BIT* to improve one.
PATIENCE, IMPROVING = 10.0, 1.0

#: Problems of each group that are planned before the clock runs: what loads the kernels of every stage.
WARM = 2

#: Recipes for a certified motion of a peer's path.
RECIPES = ("rounded", "processed")

#: What is listed by name: problems that take longer than this [ms], and motions slower than OMPL's by this share.
SLOW_MS, SLOWER = 500.0, 1.02


@dataclass(frozen=True, eq=False)
class PlannerRun:
    """What a planner of OMPL's found.

    Attributes:
        result: Its path.
        motions: The motions along it; None where there is no path.
        seconds: Time that it had.
        ours_s: Duration of hplan's motion; None where hplan has none.
    """

    result: OmplResult
    motions: PathMotions | None
    seconds: float
    ours_s: float | None = None

    def numbers(self) -> dict[str, Any]:
        """The run as numbers."""
        motions = self.motions
        return {
            "solved": motions is not None,
            "seconds": self.seconds,
            "ms": self.result.total_ms,
            "compiled_ms": self.result.compiled_ms,
            "length_deg": None if motions is None else motions.length_deg,
            "rounded_s": None if motions is None else motions.rounded_s,
            "processed_s": None if motions is None else motions.processed_s,
            "spline_collides": None if motions is None or motions.spline is None else motions.spline.collides,
        }


def measure(
    robot: Robot, *, trees: Path | None, most: int | None, ompl: Ompl | None, progress: Progress
) -> dict[str, Any]:
    """Measure the orchards.

    Args:
        robot: The arm.
        trees: Folder of measured trees; None to go without them.
        most: Problems of each group at most, evenly chosen; None for all.
        ompl: OMPL, where it is installed.
        progress: Told how far it is.
    """
    absent = _absent(trees)
    orchards = shipped_orchards()
    if trees is not None and absent is None:
        orchards = [*measured_orchards(robot, trees), *orchards]
    crops = []
    for number, orchard in enumerate(orchards):
        progress("orchards: grasps", number, len(orchards))
        crops.append(crop_of(robot, orchard))
    problems = evenly_chosen([problem for crop in crops for problem in crop.problems()], most)
    for number, problem in enumerate(warm := evenly_chosen(problems, WARM)):
        progress("orchards: loading", number, len(warm))
        _planned(robot, problem)
    rows: list[dict[str, Any]] = []
    runs: dict[str, list[PlannerRun]] = {name: [] for name in PLANNERS}
    for number, problem in enumerate(problems):
        progress("orchards", number, len(problems))
        rows.append(_solve(robot, problem, ompl, runs))
    progress("orchards", len(problems), len(problems))
    groups = list(dict.fromkeys(crop.orchard.group for crop in crops))
    return {
        "without_trees": absent,
        "patience_s": PATIENCE,
        "improving_s": IMPROVING,
        "planners": None if ompl is None else {name: _planner_numbers(found) for name, found in runs.items()},
        "fruits": {group: _fruits([crop for crop in crops if crop.orchard.group == group]) for group in groups},
        "groups": {group: _numbers([row for row in rows if row["group"] == group]) for group in groups},
        "all": _numbers(rows),
        "at_fault": [row["name"] for row in rows if row.get("collides")],
        "rows": rows,
    }


def _absent(trees: Path | None) -> str | None:
    """Why there are no measured trees, or None."""
    if trees is None:
        return "no folder of measured trees was given"
    if not trees.is_dir():
        return f"there is no folder {trees}"
    return None if any(trees.glob("*.csv")) else f"there is no CSV in {trees}"


def _planned(robot: Robot, problem: OrchardProblem) -> PlanResult | HplanError:
    with stages_in_cpu_time():
        return or_error(lambda: plan(robot, problem.scene))


def _solve(
    robot: Robot, problem: OrchardProblem, ompl: Ompl | None, runs: dict[str, list[PlannerRun]]
) -> dict[str, Any]:
    """One problem, by hplan and by OMPL, whose runs are added to those there are."""
    found, ms = timed(lambda: _planned(robot, problem))
    task = PeerTask.of(robot, problem.scene)
    row: dict[str, Any] = {"name": problem.name, "group": problem.group, "ms": ms}
    if isinstance(found, HplanError):
        row |= {"solved": False, "error": found.kind, "message": found.message}
    else:
        row |= {"solved": True, **_motion(task, found)}
    solved = row["solved"]
    for planner in PLANNERS:
        if ompl is None:
            break
        run = _peer(task, ompl, planner, PATIENCE if planner == "RRTConnect" or not solved else IMPROVING)
        solved = solved and run.motions is not None
        runs[planner].append(replace(run, ours_s=row.get("duration_s")))
        row[planner] = run.numbers()
    for recipe in RECIPES:
        theirs = [row[planner][f"{recipe}_s"] for planner in PLANNERS if planner in row]
        row[f"best_{recipe}_s"] = min((s for s in theirs if s is not None), default=float("nan"))
        row[f"to_{recipe}"] = row.get("duration_s", float("nan")) / row[f"best_{recipe}_s"]
    return row


def _motion(task: PeerTask, planned: PlanResult) -> dict[str, Any]:
    """The motion of hplan's, looked at finely too."""
    planner = planned.report["planner"]
    seen = look_at(task.robot, task.checker, of_rows(planned.trajectory))
    return {
        "route": {"direct": "straight", "roadmap": "roadmap"}.get(
            planner["method"], planner["fallback"].replace("none", "two-level")
        ),
        "step_deg": planner["step_deg"],
        "certified": planned.certificate.verified,
        "clearance_mm": 1e3 * planned.certificate.min_clearance_m,
        "collides": seen.collides,
        "duration_s": planned.trajectory.duration,
        "length_deg": planned.report["path"]["length_deg"],
        "stages_ms": planned.report["time_ms"],
    }


def _peer(task: PeerTask, ompl: Ompl, planner: str, seconds: float) -> PlannerRun:
    """What one of OMPL's planners finds."""
    problem = task.problem
    result = ompl.plan(task, problem.start, problem.goal, planner=planner, seconds=seconds, turns=problem.turns)
    return PlannerRun(result, None if result.path is None else motions_of(task, result.path), seconds)


def _fruits(crops: Sequence[CropProblems]) -> dict[str, Any]:
    """How many fruits there are, how many can be taken, and what is against the others."""
    return {
        "orchards": len(crops),
        "fruits": sum(len(crop.orchard.scene.fruits) for crop in crops),
        "goals": sum(len(crop.goals) for crop in crops),
        "without": dict(sum((crop.without for crop in crops), Counter())),
        "home_not_clear": [crop.orchard.name for crop in crops if not crop.home_is_clear],
    }


def _numbers(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What is told of a group, and its problems to look at by name."""
    solved = [row for row in rows if row["solved"]]
    return {
        "problems": len(rows),
        "solved": len(solved),
        "certified": sum(row["certified"] for row in solved),
        "colliding": sum(row["collides"] for row in solved),
        "ms": spread([row["ms"] for row in solved]),
        "duration_s": median([row["duration_s"] for row in solved]),
        "length_deg": median([row["length_deg"] for row in solved]),
        "routes": dict(Counter(row["route"] for row in solved)),
        "failed": [{key: row[key] for key in ("name", "error", "message", "ms")} for row in rows if not row["solved"]],
        "missed": [row["name"] for row in rows if not row["solved"] and _by_a_peer(row)],
        "slow": [row["name"] for row in rows if row["ms"] > SLOW_MS],
        "planners": {name: sum(row[name]["solved"] for row in rows) for name in PLANNERS if rows and name in rows[0]},
        **{f"to_{recipe}": _ratios(rows, f"to_{recipe}") for recipe in RECIPES},
    }


def _by_a_peer(row: dict[str, Any]) -> bool:
    return any(row[name]["solved"] for name in PLANNERS if name in row)


def _ratios(rows: Sequence[dict[str, Any]], key: str) -> dict[str, Any]:
    """Durations to those of the quickest certified motions along OMPL's paths."""
    ratios = [row[key] for row in rows if np.isfinite(row[key])]
    slower = sorted((row for row in rows if row[key] > SLOWER), key=lambda row: -float(row[key]))
    return {**spread(ratios), "count": len(ratios), "slower": {row["name"]: row[key] for row in slower}}


def _planner_numbers(runs: Sequence[PlannerRun]) -> dict[str, Any]:
    """A planner's paths and what becomes of them, over the problems that hplan solves too."""
    shared = [(run, run.ours_s) for run in runs if run.ours_s is not None]
    found = [(run.result, run.motions, ours) for run, ours in shared if run.motions is not None]
    path_ms = [result.total_ms for result, _, _ in found]
    return {
        "path_spread_ms": spread(path_ms),
        "compiled_ms": median([result.compiled_ms for result, _, _ in found]),
        **summary([motions for _, motions, _ in found], path_ms, [ours for *_, ours in found], asked=len(shared)),
    }
