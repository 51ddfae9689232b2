"""Narrow places: what is solved, how fast, and how quick the motions are, beside OMPL's RRTConnect.

RRTConnect stops at its first path, which is simplified and becomes a motion as in `studies.benchmark.paths`. A problem
is missed where it finds a path and hplan gives no certified motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from studies.benchmark.measure import Progress, median, or_error, spread, stages_in_cpu_time, timed
from studies.benchmark.narrow.scenes import ARMS, GAPS, KINDS, ROOMS, NarrowProblem, narrow_problems
from studies.benchmark.paths import PeerTask, motions_of
from studies.benchmark.planners import Ompl

from hplan.errors import HplanError, NoPathError, NotFoundError
from hplan.planning.plan import PlanResult, plan

#: Time that RRTConnect has [s].
PATIENCE = 30.0

#: Problems that are planned before the clock runs: what loads the kernels of every stage.
WARM = 8


def measure(
    *, seed: int, problems: int, ompl: Ompl | None, progress: Progress, seconds: float = PATIENCE
) -> dict[str, Any]:
    """Measure narrow places.

    Args:
        seed: Of the problems.
        problems: How many windows and traps; pinches come with them.
        ompl: OMPL, where it is installed.
        progress: Told how far it is.
        seconds: Time that RRTConnect has [s].
    """
    progress("narrow: drawing", 0, problems)
    drawn = narrow_problems(seed, problems)
    for number in range(0, len(drawn), max(1, len(drawn) // WARM)):
        progress("narrow: loading", number, len(drawn))
        _planned(drawn[number])
    rows = []
    for number, problem in enumerate(drawn):
        progress("narrow", number, len(drawn))
        rows.append(_solve(problem, ompl, seconds))
    progress("narrow", len(drawn), len(drawn))
    groups = {
        **{kind: [row for row in rows if row["kind"] == kind] for kind in (*KINDS, "pinch")},
        **{
            f"{name}, {1e3 * gap:g} mm": [
                row for row in rows if (row["kind"] == "pinch") is pinch and row["gap_m"] == gap
            ]
            for name, gaps, pinch in (("opening", GAPS, False), ("pinch", ROOMS, True))
            for gap in gaps
        },
        **{arm: [row for row in rows if row["arm"] == arm] for arm in ARMS},
        "all": rows,
    }
    return {
        "patience_s": None if ompl is None else seconds,
        "groups": {name: _numbers(found) for name, found in groups.items() if found},
        "missed": [_name(row) for row in rows if _is_missed(row)],
        "refused": [
            {"name": _name(row), "error": row["error"], "message": row["message"]} for row in rows if row["error"]
        ],
        "rows": rows,
    }


def _planned(problem: NarrowProblem) -> PlanResult | HplanError:
    with stages_in_cpu_time():
        return or_error(lambda: plan(problem.robot, problem.scene))


def _solve(problem: NarrowProblem, ompl: Ompl | None, seconds: float) -> dict[str, Any]:
    """One problem, by hplan and by RRTConnect."""
    found, ms = timed(lambda: _planned(problem))
    row: dict[str, Any] = {
        "number": problem.number,
        "kind": problem.kind,
        "gap_m": problem.gap_m,
        "arm": problem.arm,
        "joints": problem.robot.dof,
        "ms": ms,
        "error": None,
        "peer": None,
    }
    if isinstance(found, HplanError):
        row |= {"error": found.kind, "message": found.message}
        row |= {"no_path": isinstance(found, NoPathError), "not_found": isinstance(found, NotFoundError)}
    else:
        row |= {"method": found.report["planner"]["method"], "certified": found.certificate.verified}
        row |= {"duration_s": found.trajectory.duration}
    if ompl is not None:
        task = PeerTask.of(problem.robot, problem.scene)
        ends = task.problem.start, task.problem.goal
        run = ompl.plan(task, *ends, seconds=seconds, turns=task.problem.turns)
        motions = None if run.path is None else motions_of(task, run.path)
        row["peer"] = {
            "solved": run.path is not None,
            "ms": run.total_ms,
            "processed_s": None if motions is None else motions.processed_s,
        }
    return row


def _is_missed(row: dict[str, Any]) -> bool:
    return row["error"] is not None and row["peer"] is not None and row["peer"]["solved"]


def _name(row: dict[str, Any]) -> str:
    return f"{row['number']}: {row['kind']}, {1e3 * row['gap_m']:g} mm, {row['arm']}"


def _numbers(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What is told of a group."""
    solved = [row for row in rows if row["error"] is None]
    peers = [row["peer"] for row in rows if row["peer"] is not None]
    both = [row for row in solved if row["peer"] is not None and row["peer"]["processed_s"] is not None]
    ratios = [row["duration_s"] / row["peer"]["processed_s"] for row in both]
    return {
        "problems": len(rows),
        "solved": len(solved),
        "certified": sum(row["certified"] for row in solved),
        "no_path": sum(row.get("no_path", False) for row in rows),
        "not_found": sum(row.get("not_found", False) for row in rows),
        "peer": sum(peer["solved"] for peer in peers) if peers else None,
        "missed": sum(_is_missed(row) for row in rows),
        "ms": spread([row["ms"] for row in rows]),
        "solved_ms": spread([row["ms"] for row in solved]),
        "peer_ms": median([peer["ms"] for peer in peers if peer["solved"]]),
        "to_processed": {**spread(ratios), "slower": int(np.sum(np.array(ratios) > 1.0)), "count": len(ratios)},
    }
