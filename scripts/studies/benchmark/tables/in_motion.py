"""Tables of splices and stops: what became of running motions, their times, and what coal and differences say."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.table import Table, failures, number


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.in_motion` measured.
    """
    return [_splices(results), _stops(results["stops"]), *failures("In motion", results["failed"])]


def _splices(r: dict[str, Any]) -> Table:
    rows = [
        (name, str(count), *(number(r["ms"][name][key]) for key in ("median", "p95", "p99", "max")))
        for name, count in r["outcomes"].items()
    ]
    position, velocity, acceleration = (f"{jump:.1g}" for jump in r["largest_jumps"])
    note = (
        f"{r['scenes']} scenes (of {r['drawn']} drawn) in which obstacles move while the arm does. {r['splices']:,} "
        f"spliced motions, {r['certified']:,} certified as a whole; looked at every {1e3 * r['every_s']:g} ms by coal "
        f"alone, {r['colliding']} touch anything, the nearest comes to {number(r['least_clearance_mm'])} mm. Largest "
        f"jumps at the seam: {position} rad, {velocity} rad/s, {acceleration} rad/s^2. Times [ms]."
    )
    return Table("In motion: what comes next", ("", "steps", "median", "95 %", "99 %", "max"), tuple(rows), note)


def _stops(r: dict[str, Any]) -> Table:
    row = (*(number(r["ms"][key]) for key in ("median", "p95", "p99", "max")),)
    note = (
        f"{r['count']:,} stops at random instants, {r['certified']:,} certified, by the path's clearance and anew. Off "
        f"the path: {number(r['largest_off_path_mm'])} mm at most, by the bound {number(r['largest_bound_mm'])} mm. "
        "They take longer than the slowest joint alone would, or than the rest of the motion, by "
        f"{number(1e3 * r['later_s']['median'])} ms in the median and {number(1e3 * r['later_s']['p99'])} ms in 99 %. "
        "Times to the certified stop [ms]."
    )
    return Table("In motion: stops", ("", "median", "95 %", "99 %", "max"), (("stop", *row),), note)
