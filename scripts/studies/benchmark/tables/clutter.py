"""Tables of clutter: ratios and times over random scenes, sampling planners, scenes that failed."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.planners import PLANNER_NOTE, planner_tables, row_of_hplan
from studies.benchmark.tables.table import Table, failures, number


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.clutter` measured.
    """
    return [_ratios(results), *_planners(results), *failures("Clutter", results["failed"])]


def _ratios(c: dict[str, Any]) -> Table:
    around = c["around"]

    def ratio(name: str, key: str, *, inverse: bool = False) -> tuple[str, ...]:
        values, part = c[key], around[key]
        cells = [values["median"], part["median"], values["p95"], values["max"]]
        return name, *(number(1.0 / v if inverse else v, 4) for v in cells)

    t, a = c["total_ms"], around["total_ms"]
    rows = (
        ratio("dense A* : two-level, time", "search_ratio"),
        ratio("two-level : dense A*, cost", "cost_ratio"),
        ratio("duration, hplan : (a) grid path through toppra", "to_grid_spline"),
        ratio("the same, jerk not limited", "no_jerk_to_grid_spline"),
        ratio("duration, hplan : (b) straight with stops", "to_stops"),
        ratio("the same, jerk not limited", "no_jerk_to_stops"),
        ("scene to certified trajectory [ms]", *(number(v) for v in (t["median"], a["median"], t["p95"], t["max"]))),
    )
    found = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in c["fallbacks"].items())
    note = (
        f"{c['scenes']} scenes, {c['with_path']} with a path on the grid: {c['planned']} planned, {c['certified']} "
        f"certified; of {c['blocked']} without one, hplan and the dense search agree on all but {c['disagreeing']}. "
        f"Around obstacles: the {around['scenes']} scenes where the straight motion is not clear. 99th percentile of "
        f"the time: {number(t['p99'])} ms. Median length {number(c['length_deg'])} deg, duration "
        f"{number(c['duration_s'])} s. Cost optimal in {c['cost_ratio']['optimal']} of {c['planned']}. "
        f"Fallbacks: {found}."
    )
    columns = ("", "median", "around obstacles", "95 %", "largest")
    return Table("Clutter: ratios and times", columns, rows, note)


def _planners(c: dict[str, Any]) -> list[Table]:
    first = row_of_hplan(c["total_ms"]["median"], c["length_deg"], f"{c['certified']} of {c['with_path']}")
    note = f"{PLANNER_NOTE} Medians over the scenes solved. hplan's length is that of its motions."
    return planner_tables("Clutter", first, c["planners"], note)
