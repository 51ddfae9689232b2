"""Tables of motions past an obstacle that moves."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.table import Table, number


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.moving.measure` measured.
    """
    rows = []
    for kind, n in results["groups"].items():
        counts = (n["scenes"], n["certified"], n["contacts"], n["in_the_way"], n["could_wait"], *n["how"].values())
        spreads = [
            number(n[key][what]) for key in ("to_waiting", "to_unhindered", "to_grid") for what in ("median", "max")
        ]
        grid = (str(n["planar"]), str(n["grid"]), str(n["grid_contacts"]))
        rows.append((kind, *map(str, counts), *spreads, *grid, number(n["ms"]["median"]), number(n["ms"]["max"])))
    note = (
        "One obstacle crosses the arm's way, three stand still. Contacts: of certified motions, by coal alone every "
        "0.5 ms. In the way: the motion planned without what moves meets it; of those that are certified, how many "
        "could be run after waiting until it is clear for good, and what is done instead. Ratios of durations, of "
        "those that it is in the way of: to waiting, to the motion without what moves, to the safe-interval baseline "
        f"on a grid of {results['step_deg']:g} deg (base locked; without acceleration limits, which no arm can do). "
        "Grid: problems of the baseline, motions that it finds, and how many of them are in contact between its "
        "nodes. Times [ms], refusals among them."
    )
    columns = ("scenes", "certified", "contacts", "in the way", "could wait", "waits", "slows", "around", "at once")
    ratios = ("to waiting", "max", "to alone", "max", "to grid", "max")
    rest = ("grid: problems", "found", "contacts", "ms", "max")
    found = [Table("Obstacles that move", ("", *columns, *ratios, *rest), tuple(rows), note)]
    if results["refused"]:
        told = tuple((row["scene"], row["kind"], row["message"]) for row in results["refused"][:20])
        found.append(Table(f"Obstacles that move: refused ({len(results['refused'])})", ("scene", "", "error"), told))
    return found
