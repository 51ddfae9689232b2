"""Tables of narrow places: what is solved by kind, gap and arm, and what is not."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.table import NONE, NOT_INSTALLED, Table, number

#: Problems that are listed by name, at most.
_LISTED = 40


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.narrow` measured.
    """
    return [_solved(results), *_refused(results)]


def _solved(o: dict[str, Any]) -> Table:
    rows = []
    for group, n in o["groups"].items():
        peer = NONE if n["peer"] is None else str(n["peer"])
        other = n["problems"] - n["solved"] - n["no_path"] - n["not_found"]
        counts = (n["solved"], n["certified"], n["no_path"], n["not_found"], other)
        ms = [number(n["ms"][key]) for key in ("median", "p99", "max")]
        ratio = [number(n["to_processed"][key], 4) for key in ("median", "p99", "max")]
        rows.append((group, str(n["problems"]), peer, str(n["missed"]), *map(str, counts), *ms, *ratio))
    patience = NOT_INSTALLED if o["patience_s"] is None else f"has {o['patience_s']:g} s"
    note = (
        "Openings that much wider than the link, drawn whether there is a motion or not; pinches leave that room, and "
        f"there is a motion. OMPL's RRTConnect {patience}; missed: by hplan where it finds a path. No path: shown on a "
        "grid; not found: neither found nor shown that there is none; other: not certified, not timed. Times [ms] of "
        "hplan, refusals among them. Ratios: duration of the motion to that of the certified one along OMPL's path "
        "after all of hplan's post-processing."
    )
    columns = ("problems", "RRTConnect", "missed", "hplan", "certified", "no path", "not found", "other")
    times = ("median", "99 %", "max")
    return Table("Narrow places", ("", *columns, *times, *(f"ratio: {name}" for name in times)), tuple(rows), note)


def _refused(o: dict[str, Any]) -> list[Table]:
    if not o["refused"]:
        return []
    missed = set(o["missed"])
    told = sorted(o["refused"], key=lambda row: row["name"] not in missed)
    rows = tuple((row["name"], "missed" if row["name"] in missed else "", row["error"]) for row in told[:_LISTED])
    return [Table(f"Narrow places: not solved ({len(told)})", ("problem", "", "error"), rows)]
