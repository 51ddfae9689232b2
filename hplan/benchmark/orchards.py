"""Orchards, all joints free: what is solved, how fast, and how quick the motions are, beside OMPL.

RRTConnect has 10 s and stops at its first path. BIT* improves its path for 1 s; where hplan or RRTConnect finds nothing
it has 10 s too, so that nothing is missed that it would find. Both simplify, then their paths become motions as in
`hplan.benchmark.paths`. What counts as OMPL's best is the quickest certified motion along any of its paths.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hplan.benchmark.measure import Progress, median, spread, timed
from hplan.benchmark.motions import look_at, of_rows
from hplan.benchmark.orchard_scenes import Crop, OrchardProblem, crop_of, measured_orchards, shipped_orchards
from hplan.benchmark.paths import Task, Ways, ways_of
from hplan.benchmark.planners import Ompl, OmplResult
from hplan.errors import HplanError
from hplan.pipeline import PlanResult, plan
from hplan.robot import Robot

#: OMPL's planners.
PLANNERS = ("RRTConnect", "BITstar")

#: Time for a path [s], and for BIT* to improve one.
PATIENCE, IMPROVING = 10.0, 1.0

#: Ways to make a certified motion of a peer's path.
WAYS = ("rounded", "processed")

#: What is listed by name: problems that take longer than this [ms], and motions slower than OMPL's by this share.
SLOW_MS, SLOWER = 500.0, 1.02


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
    problems = chosen([problem for crop in crops for problem in crop.problems()], most)
    rows: list[dict[str, Any]] = []
    for number, problem in enumerate(problems):
        progress("orchards", number, len(problems))
        if number == 0:
            _solve(robot, problem, None)  # loads the kernels
        rows.append(_solve(robot, problem, ompl))
    progress("orchards", len(problems), len(problems))
    groups = list(dict.fromkeys(crop.orchard.group for crop in crops))
    return {
        "without_trees": absent,
        "patience_s": PATIENCE,
        "improving_s": IMPROVING,
        "ompl": ompl is not None,
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


def chosen(problems: Sequence[OrchardProblem], most: int | None) -> list[OrchardProblem]:
    """So many of each group at most, evenly spread over it, in the order given."""
    kept: list[OrchardProblem] = []
    for group in dict.fromkeys(problem.group for problem in problems):
        ours = [problem for problem in problems if problem.group == group]
        count = len(ours) if most is None else min(most, len(ours))
        kept += [ours[(2 * i + 1) * len(ours) // (2 * count)] for i in range(count)]
    return kept


def _solve(robot: Robot, problem: OrchardProblem, ompl: Ompl | None) -> dict[str, Any]:
    """One problem, by hplan and by OMPL."""

    def run() -> PlanResult | HplanError:
        try:
            return plan(robot, problem.scene)
        except HplanError as error:
            return error

    found, ms = timed(run)
    task = Task.of(robot, problem.scene)
    row: dict[str, Any] = {"name": problem.name, "group": problem.group, "ms": ms}
    if isinstance(found, HplanError):
        row |= {"solved": False, "error": found.kind, "message": found.message}
    else:
        row |= {"solved": True, **_motion(task, found)}
    row["peers"] = {} if ompl is None else _peers(task, ompl, isinstance(found, PlanResult))
    for way in WAYS:
        best = min((p[f"{way}_s"] for p in row["peers"].values() if p.get(f"{way}_s")), default=float("nan"))
        row[f"best_{way}_s"] = best
        row[f"to_{way}"] = row.get("duration_s", float("nan")) / best
    return row


def _motion(task: Task, planned: PlanResult) -> dict[str, Any]:
    """hplan's motion, looked at finely too."""
    planner = planned.report["planner"]
    seen = look_at(task.robot, task.judge, of_rows(planned.trajectory))
    return {
        "route": "straight" if planner["method"] == "direct" else planner["fallback"].replace("none", "two-level"),
        "step_deg": planner["step_deg"],
        "certified": planned.certificate.verified,
        "clearance_mm": 1e3 * planned.certificate.min_clearance_m,
        "collides": seen.collides,
        "duration_s": planned.trajectory.duration,
        "length_deg": planned.report["path"]["length_deg"],
        "stages_ms": planned.report["time_ms"],
    }


def _peers(task: Task, ompl: Ompl, solved: bool) -> dict[str, dict[str, Any]]:
    """What OMPL's planners find; BIT* has its full time where another found nothing."""
    peers: dict[str, dict[str, Any]] = {}
    for planner in PLANNERS:
        seconds = PATIENCE if planner == "RRTConnect" or not solved else IMPROVING
        run = ompl.plan(
            task.robot, task.field, task.problem.start, task.problem.goal,
            margin=task.smallest_margin, planner=planner, seconds=seconds, turns=task.problem.turns,
        )  # fmt: skip
        solved = solved and run.path is not None
        peers[planner] = _peer(run, None if run.path is None else ways_of(task, run.path), seconds)
    return peers


def _peer(run: OmplResult, ways: Ways | None, seconds: float) -> dict[str, Any]:
    found: dict[str, Any] = {"solved": ways is not None, "seconds": seconds, "ms": run.total_ms}
    if ways is None:
        return found
    return {
        **found,
        "compiled_ms": run.compiled_ms,
        "length_deg": ways.length_deg,
        "rounded_s": ways.rounded_s,
        "processed_s": ways.processed_s,
        "total_ms": {way: run.total_ms + getattr(ways, f"{way}_ms") for way in WAYS},
        "spline_s": None if ways.spline is None else ways.spline.duration_s,
        "spline_collides": None if ways.spline is None else ways.spline.collides,
    }


def _fruits(crops: Sequence[Crop]) -> dict[str, Any]:
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
        "peers": {name: _peer_numbers(rows, name) for name in PLANNERS},
        **{f"to_{way}": _ratios(rows, f"to_{way}") for way in WAYS},
    }


def _by_a_peer(row: dict[str, Any]) -> bool:
    return any(peer["solved"] for peer in row["peers"].values())


def _ratios(rows: Sequence[dict[str, Any]], key: str) -> dict[str, Any]:
    """hplan's duration to that of the quickest certified motion along OMPL's paths."""
    ratios = [row[key] for row in rows if np.isfinite(row[key])]
    slower = sorted((row for row in rows if row[key] > SLOWER), key=lambda row: -float(row[key]))
    return {**spread(ratios), "count": len(ratios), "slower": {row["name"]: row[key] for row in slower}}


def _peer_numbers(rows: Sequence[dict[str, Any]], name: str) -> dict[str, Any]:
    runs = [row["peers"][name] for row in rows if name in row["peers"]]
    found = [run for run in runs if run["solved"]]
    return {
        "asked": len(runs),
        "solved": len(found),
        "ms": spread([run["ms"] for run in found]),
        "compiled_ms": spread([run["compiled_ms"] for run in found]),
        "length_deg": median([run["length_deg"] for run in found]),
        "splines": sum(run["spline_s"] is not None for run in found),
        "splines_colliding": sum(bool(run["spline_collides"]) for run in found),
        **{
            way: {
                "certified": sum(run[f"{way}_s"] is not None for run in found),
                "duration_s": median([run[f"{way}_s"] for run in found if run[f"{way}_s"] is not None]),
                "total_ms": median([run["total_ms"][way] for run in found]),
            }
            for way in WAYS
        },
    }
