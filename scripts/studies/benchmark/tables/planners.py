"""Sampling planners beside hplan: the tables that the reference scene, clutter and orchards share."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.table import NONE, NOT_INSTALLED, Table, number, times

#: How to read the first of the tables, whatever the set.
PLANNER_NOTE = (
    "Duration of the motion to that of hplan's, time to the motion, time to the path, its length; only hplan's times "
    "contain setting up and checking the scene. OMPL asks "
    "hplan's compiled kernel about whole motions by way of Python; `compiled` is an estimate of the time to the path "
    "with the Python part of those calls taken out. RRTConnect stops at its first path, BIT* when its time is up (or "
    "the straight line is found clear), after 1 s at most; both simplify. A path becomes a motion by a spline (cubic, "
    "through the waypoints, toppra as advised, no limit on jerk), by rounding (hplan's corner rounding and timing), "
    "or by hplan's post (all of its post-processing). Fit: certified; for splines no fault seen in samples every 1 ms."
)

_COLUMNS = ("planner, motion", "to hplan's", "in all [ms]", "path [ms]", "compiled [ms]", "path [deg]", "fit")

#: Ways to make a motion of a planner's path, as in `studies.benchmark.paths`.
_WAYS = {"spline": "spline", "rounded": "rounding", "processed": "hplan's post"}


def row_of_hplan(
    total_ms: float, length_deg: float, fit: str, *, path_ms: str = NONE, digits: int = 3
) -> tuple[str, ...]:
    """The row of hplan: median time to the motion and median length, and how many motions could be run.

    Args:
        total_ms: Time to the motion [ms].
        length_deg: Length of the path [deg].
        fit: How many motions of how many could be run.
        path_ms: Time to the path, where it is known apart.
        digits: Significant digits of the length.
    """
    return "hplan", "1 x", number(total_ms), path_ms, path_ms, number(length_deg, digits), fit


def planner_tables(where: str, first: tuple[str, ...], planners: dict[str, Any] | None, note: str) -> list[Table]:
    """Times and durations, then the faults of splines; just the word where OMPL is not installed.

    Args:
        where: Name of the set, for the titles.
        first: The row of hplan.
        planners: Numbers of each planner, or None where OMPL is not installed.
        note: How to read the first table.

    Returns:
        The tables; the first one alone where no planner ran.
    """
    rows = (first, *_rows(planners, len(first)))
    found = [Table(f"{where}: sampling planners", _COLUMNS, rows, note)]
    if planners:
        found.append(_faults(where, planners))
    return found


def _rows(planners: dict[str, Any] | None, columns: int) -> list[tuple[str, ...]]:
    if planners is None:
        return [(f"OMPL {name}", NOT_INSTALLED, *[""] * (columns - 2)) for name in ("RRTConnect", "BIT*")]
    rows: list[tuple[str, ...]] = []
    for name, p in planners.items():
        for way, text in _WAYS.items():
            w = p[way]
            count = w["usable"] if way == "spline" else w["certified"]
            ms = number(w["total_ms"]), number(p["path_ms"]), number(p["compiled_ms"])
            length = number(p["length_deg"], 4)
            rows.append((f"{_label(name)}, {text}", times(w["ratio"]), *ms, length, f"{count} of {p['problems']}"))
    return rows


def _faults(where: str, planners: dict[str, Any]) -> Table:
    rows = []
    for name, p in planners.items():
        w = p["spline"]
        rows.append(
            (
                _label(name),
                f"{w['colliding']} of {w['timed']}",
                number(w["worst_depth_mm"]),
                str(w["outside_range"]),
                number(w["worst_outside_deg"]),
                str(w["over_limits"]),
                f"{p['rounded']['faster_than_hplan']}",
                f"{p['processed']['faster_than_hplan']}",
            )
        )
    columns = (
        "planner",
        "collide",
        "deepest [mm]",
        "out of range",
        "farthest [deg]",
        "over limits",
        "quicker by rounding",
        "quicker by hplan's post",
    )
    note = (
        "How many splines collide, leave the joint range or break a velocity, acceleration or torque limit by more "
        "than 0.1 %; then how many certified motions along the planner's path are quicker than hplan's own."
    )
    return Table(f"{where}: faults of splines, and where planners win", columns, tuple(rows), note)


def _label(name: str) -> str:
    return name.replace("BITstar", "BIT*")
