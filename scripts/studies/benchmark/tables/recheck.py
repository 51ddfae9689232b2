"""Tables of the recheck: violations of certified trajectories, time at a limit, scenes that failed."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.table import NONE, Table, failures, number


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.recheck` measured.
    """
    return [_violations(results), _shares(results), *failures("Recheck", results["failed"])]


def _violations(r: dict[str, Any]) -> Table:
    rows = []
    for name, count in r["violation_counts"].items():
        use = r["worst_use"].get(name)
        cells = [NONE, NONE] if use is None else [f"{use['use']:.5f}", str(use["number"])]
        rows.append((name, str(count), *cells))
    note = (
        f"{r['with_path']:,} scenes with a path (of {r['drawn']:,} drawn), {r['around']:,} of them with obstacles in "
        f"the straight way: {r['planned']:,} planned, {r['certified']:,} certified. {r['instants']:,} instants in "
        f"{r['motion_s']:,.0f} s of motion, from the CSV as the csv module reads it. Smallest clearance seen: "
        f"{number(r['least_clearance_mm'])} mm; never less than certified, by "
        f"{number(r['least_clearance_beyond_certificate_mm'])} mm at least (at one instant in fifty)."
    )
    columns = ("checked every 0.1 ms", "violations", "largest use", "in scene")
    return Table("Recheck: certified trajectories looked at again", columns, tuple(rows), note)


def _shares(r: dict[str, Any]) -> Table:
    rows = []
    for key, name in (("hplan", "hplan"), ("hplan_no_jerk", "hplan, jerk not limited")):
        s = r["reference"][key]
        parts = [s.get(k) for k in ("any", "any_at_95_percent", "velocity", "acceleration", "torque", "jerk")]
        rows.append((name, *(NONE if part is None else f"{100.0 * part:.1f} %" for part in parts)))
    return Table(
        "Recheck: share of the time at a limit, reference scene",
        ("", ">= 0.999", ">= 0.95", "velocity", "acceleration", "torque", "jerk"),
        tuple(rows),
        "At >= 0.999 and >= 0.95 of some limit; then at >= 0.999 of each.",
    )
