"""Tables of replanning: its time and the duration of its motions beside plans from nothing, steps that failed."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.table import Table, failures, number, percent, times

#: What became of the motion, in the order of the rows.
_OUTCOMES = {
    "kept": "motion kept",
    "mended": "mended",
    "direct": "anew, straight",
    "roadmap": "anew, on a roadmap",
    "search": "anew, on a grid",
    "no_path": "no path",
    "failed": "failed",
}

#: How the obstacle moved.
_MOVED = {"shifted": "obstacle shifted", "close": "obstacle put close to the motion"}


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.replanning` measured.
    """
    by_outcome = results["by_outcome"]
    groups = {
        "all with a motion": results["all"],
        **{_OUTCOMES.get(key, key): by_outcome[key] for key in {**_OUTCOMES, **by_outcome} if key in by_outcome},
        **{text: results["by_move"][key] for key, text in _MOVED.items()},
    }
    return [_time_table(results, groups), _duration_table(groups), *failures("Replanning", results["failed"])]


def _time_table(r: dict[str, Any], groups: dict[str, dict[str, Any]]) -> Table:
    rows = []
    for name, g in groups.items():
        ours = (number(g["ms"][key]) for key in ("median", "p95", "p99", "max"))
        theirs = (number(g["from_nothing_ms"][key]) for key in ("median", "p95", "p99", "max"))
        rows.append((name, times(g["ratio"]["median"]), str(g["steps"]), *ours, *theirs))
    low, high = (number(100.0 * shift) for shift in r["shift_m"])
    note = (
        f"{r['scenes']} scenes with a motion to begin with (of {r['drawn']} drawn), {r['obstacles']} obstacles each, "
        f"half of them branches and half fruit; all four joints free. In each of {r['steps']:,} steps one obstacle "
        f"moves, drawn at random: it is shifted by {low} to {high} cm, or, in {percent(r['close_share'], 1.0)} of the "
        "draws, put close to the motion of the moment, in its way or beside it; "
        f"{number(100.0 * r['room_m'])} cm stay free at start and goal. Where a step has no motion the obstacle goes "
        "back. Ratio: time to plan the same scene from nothing (plan) to that of replanning, the median of the steps. "
        "Times [ms] to the certified motion. "
        f"{number(r['per_second'])} replans per second in the median. All steps, those without a motion too, take "
        f"{number(r['in_all_s'])} s together, and {number(r['in_all_from_nothing_s'])} s from nothing. Replanned: "
        f"{r['replanned']:,}, certified: {r['certified']:,}; looked at every 1 ms, {r['colliding']} touch an obstacle. "
        f"Steps with a motion by replanning alone: {len(r['only_replanned'])}; from nothing alone: "
        f"{len(r['only_from_nothing'])}."
    )
    columns = ("", "ratio", "steps", "median", "95 %", "99 %", "max")
    nothing = tuple(f"plan: {name}" for name in columns[3:])
    return Table("Replanning: time", (*columns, *nothing), tuple(rows), note)


def _duration_table(groups: dict[str, dict[str, Any]]) -> Table:
    rows = []
    for name, g in groups.items():
        ratios = g["to_from_nothing"]
        if ratios["count"]:
            cells = (number(ratios[key], 4) for key in ("median", "p95", "p99", "max"))
            rows.append((name, *cells, str(ratios["count"]), str(ratios["longer"]), str(ratios["shorter"])))
    note = (
        "What keeping a motion costs: its duration to that of the motion planned from nothing at that step. Longer, "
        "and shorter: by more than 2 %."
    )
    columns = ("replanned : from nothing", "median", "95 %", "99 %", "max", "steps", "longer", "shorter")
    return Table("Replanning: duration of the motion", columns, tuple(rows), note)
