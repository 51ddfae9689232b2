"""Tables of orchards: fruits, problems solved, routes, durations, sampling planners, problems to look at."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.planners import PLANNER_NOTE, planner_tables, row_of_hplan
from studies.benchmark.tables.table import NONE, Table, number, times

#: Problems that are listed by name, at most, the worst first.
_LISTED = 30


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.orchards` measured.
    """
    return [
        _fruits(results),
        _solved(results),
        _routes(results),
        _durations(results),
        *_planners(results),
        *_to_look_at(results["all"]),
    ]


def _fruits(o: dict[str, Any]) -> Table:
    rows = []
    for group, f in o["fruits"].items():
        without = dict(f["without"])
        blocked, straight = without.pop("blocked", 0), without.pop("no_approach", 0)
        why = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in sorted(without.items()))
        rows.append((group, *map(str, (f["orchards"], f["fruits"], f["goals"], blocked, straight)), why or "0"))
    note = (
        "All four joints move. Goals: fruits with a grasp that is clear but for the last link at the fruit itself, and "
        "has a clear straight approach of 0.1 m; the others are a goal for no planner. Problems: from the tucked home "
        "pose to where the approach to each of them begins, and from each of these places to the next. All fruits are "
        "obstacles. Measured trees stand alone, their trunk that far in front of the base; fruit hangs at the tips of "
        "branches, those within reach first."
    )
    blocked_home = [name for f in o["fruits"].values() for name in f["home_not_clear"]]
    if blocked_home:
        note += f" Home is not clear, so nothing begins there: {', '.join(blocked_home)}."
    if o["without_trees"] is not None:
        note += f" No measured trees: {o['without_trees']}."
    columns = ("orchards", "number", "fruits", "goals", "blocked", "no approach", "out of reach")
    return Table("Orchards: fruits", columns, tuple(rows), note)


def _solved(o: dict[str, Any]) -> Table:
    rows = []
    for group, n in {**o["groups"], "all": o["all"]}.items():
        theirs = [str(n["planners"].get(name, NONE)) for name in ("RRTConnect", "BITstar")]
        ms = [number(n["ms"][key]) for key in ("median", "p95", "p99", "max")]
        counts = str(n["problems"]), str(n["solved"]), *theirs, str(len(n["missed"])), str(n["certified"])
        rows.append((group, *counts, *ms))
    note = (
        f"Solved by each planner; missed: by OMPL, and not by hplan. RRTConnect has {o['patience_s']:g} s, BIT* "
        f"{o['improving_s']:g} s, and {o['patience_s']:g} s where hplan or RRTConnect finds nothing. Times [ms] of "
        "hplan from the scene to the certified trajectory. Of its trajectories, looked at every 1 ms, "
        f"{o['all']['colliding']} touch an obstacle."
    )
    columns = ("", "problems", "hplan", "RRTConnect", "BIT*", "missed", "certified", "median", "95 %", "99 %", "max")
    return Table("Orchards: solved, and how fast", columns, tuple(rows), note)


def _routes(o: dict[str, Any]) -> Table:
    found = sorted(o["all"]["routes"], key=lambda route: -o["all"]["routes"][route])
    rows = [
        (group, *(str(n["routes"].get(route, 0)) for route in found))
        for group, n in {**o["groups"], "all": o["all"]}.items()
    ]
    note = (
        "The straight motion, a roadmap of few configurations, the two-level search over layers of yaw, or what it "
        "falls back on."
    )
    columns = ("hplan's motions by", *(route.replace("_", " ") for route in found))
    return Table("Orchards: what carried the motion", columns, tuple(rows), note)


def _durations(o: dict[str, Any]) -> Table:
    rows = []
    for group, n in {**o["groups"], "all": o["all"]}.items():
        cells: list[str] = []
        for ratios in (n["to_rounded"], n["to_processed"]):
            cells += [*(number(ratios[key], 4) for key in ("median", "p95", "max")), str(len(ratios["slower"]))]
        rows.append((group, str(n["to_rounded"]["count"]), number(n["duration_s"]), *cells))
    note = (
        "Duration of hplan's motion to that of the quickest certified one along any of OMPL's paths: these with "
        "rounded corners under the same timing, then (post) with all of hplan's post-processing. Slower: problems "
        "where hplan takes more than 1.02 of it."
    )
    ratio = ("median", "95 %", "max", "slower")
    columns = ("hplan : OMPL's best", "problems", "[s]", *ratio, *(f"post: {name}" for name in ratio))
    return Table("Orchards: duration of the motion", columns, tuple(rows), note)


def _planners(o: dict[str, Any]) -> list[Table]:
    ours = o["all"]
    first = row_of_hplan(ours["ms"]["median"], ours["length_deg"], f"{ours['certified']} of {ours['problems']}")
    note = (
        f"{PLANNER_NOTE} Here RRTConnect has {o['patience_s']:g} s, and BIT* {o['improving_s']:g} s; where hplan or "
        f"RRTConnect finds nothing, it has {o['patience_s']:g} s too. Medians over the problems that both solve. "
        "hplan's length is that of its motions."
    )
    return planner_tables("Orchards", first, o["planners"], note)


def _to_look_at(n: dict[str, Any]) -> list[Table]:
    """The problems that are missed, slow to solve, or solved by slow motions."""
    missed = dict.fromkeys(n["missed"], "missed")
    rows = [(row["name"], missed.get(row["name"], "not solved"), row["error"]) for row in n["failed"]]
    rows += [(name, "slower than OMPL", times(ratio)) for name, ratio in n["to_rounded"]["slower"].items()]
    rows += [(name, "slower than OMPL's by post", times(ratio)) for name, ratio in n["to_processed"]["slower"].items()]
    if not rows:
        return []
    note = "OMPL solves what is missed, and not what is only not solved." if n["failed"] else ""
    return [Table(f"Orchards: problems to look at ({len(rows)})", ("problem", "", ""), tuple(rows[:_LISTED]), note)]
