"""How far hplan's motions are from the fastest known, with each effort, and how long they take to plan."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from studies.benchmark.fastest.peers import PEERS, Found
from studies.benchmark.fastest.problems import FastestProblem, problems_of
from studies.benchmark.fastest.records import BEST_KNOWN, Record, read_records, write_records
from studies.benchmark.measure import Progress, evenly_chosen, spread, stages_in_cpu_time, timed

from hplan.errors import HplanError
from hplan.planning.plan import plan
from hplan.problem.options import EFFORT_NAMES, EffortName, PlanOptions

#: Problems of each group that are planned before the clock runs, with each effort.
WARM = 3


def measure(
    *,
    trees: Path | None,
    most: int | None,
    improve: Sequence[str] | None,
    progress: Progress,
    path: Path = BEST_KNOWN,
) -> dict[str, Any]:
    """Measure the set.

    Args:
        trees: Folder of measured trees; None to go without the problems among them.
        most: Problems of each group at most, evenly chosen; None for all.
        improve: None to leave the set's file as it is. Else durations shorter than the best known are written to it:
            hplan's, and those of these peers (`studies.benchmark.fastest.peers`), each run on every problem.
        progress: Told how far it is.
        path: The set's file.
    """
    records = read_records(path)
    problems = problems_of(
        evenly_chosen(records, most), trees, lambda done, total: progress("fastest: drawing", done, total)
    )
    for number, problem in enumerate(problems):
        if number % max(1, len(problems) // (2 * WARM)) == 0:
            progress("fastest: loading", number, len(problems))
            for effort in EFFORT_NAMES:
                _planned(problem, effort)
    rows: list[dict[str, Any]] = []
    best = {record.name: record for record in records}
    for number, problem in enumerate(problems):
        progress("fastest", number, len(problems))
        record = problem.record
        efforts = {effort: _planned(problem, effort) for effort in EFFORT_NAMES}
        found = [Found(row["duration_s"], effort) for effort, row in efforts.items() if row["certified"]]
        for peer in improve or ():
            found += PEERS[peer](problem)
        rows.append({"name": record.name, "group": record.group, "efforts": efforts, **_best(record, found)})
        if improve is not None and rows[-1]["improved"]:
            best[record.name] = record.improved(rows[-1]["best_s"], rows[-1]["by"])
            write_records(best.values(), path)
    progress("fastest", len(problems), len(problems))
    groups = {name: [row for row in rows if row["group"] == name] for name in ("planar", "trees")}
    return {
        "without_trees": trees is None,
        "kept": improve is not None,
        "groups": {name: numbers(some) for name, some in {**groups, "all": rows}.items() if some},
        "improved": [row["name"] for row in rows if row["improved"]],
        "rows": rows,
    }


def _planned(problem: FastestProblem, effort: EffortName) -> dict[str, Any]:
    """What hplan finds with an effort."""

    def run() -> tuple[float, bool]:
        try:
            with stages_in_cpu_time():
                found = plan(problem.robot, problem.scene, PlanOptions(effort=effort))
        except HplanError:
            return float("nan"), False
        return found.trajectory.duration, found.certificate.verified

    (duration, certified), ms = timed(run)
    return {"duration_s": duration, "certified": certified, "ms": ms}


def _best(record: Record, found: Sequence[Found]) -> dict[str, Any]:
    """The best that is known, with what was found now."""
    best = record
    for one in found:
        best = best.improved(one.duration_s, one.by)
    return {"known_s": record.duration_s, "best_s": best.duration_s, "by": best.by, "improved": best is not record}


def numbers(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What is told of a group.

    Args:
        rows: Its problems, at least one, as in the result of `measure`.
    """
    efforts: dict[str, Any] = {}
    for effort in EFFORT_NAMES:
        of = [row["efforts"][effort] for row in rows]
        known = [(one["duration_s"], row["best_s"]) for one, row in zip(of, rows, strict=True) if one["certified"]]
        ratios = np.array([ours / best for ours, best in known])
        efforts[effort] = {
            "certified": len(known),
            "to_best": spread(ratios.tolist()),
            "slower": int((ratios > 1.02).sum()),
            "ms": spread([one["ms"] for one in of]),
        }
    return {"problems": len(rows), "efforts": efforts, "by": dict(Counter(row["by"] for row in rows).most_common())}
