"""Tables of growth: time and memory against grid step, obstacles and links."""

from __future__ import annotations

from typing import Any

from studies.benchmark.growth import QUANTITIES
from studies.benchmark.tables.table import Table, number, times

#: What grows, with its title.
_AXES = {"step": "grid step [deg]", "obstacles": "obstacles", "links": "links"}

_NOTE = (
    "Times [ms] of the C-space, the two-level search, dense A*, and all from scene to certified motion. Memory: "
    "largest rise of resident memory during the call, of the two-level search with its C-space, of the dense search "
    "without."
)


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.growth` measured.
    """
    return [_growth(results[axis], axis, title) for axis, title in _AXES.items()]


def _growth(g: dict[str, Any], axis: str, title: str) -> Table:
    rows = [
        (
            f"{case['size']:g}" if case.get("certified") else f"{case['size']:g}, no motion",
            times(case["dense_ms"] / case["two_level_ms"]),
            f"{case['nodes']:,}",
            *(number(case[name]) for name in QUANTITIES),
        )
        for case in g["cases"]
    ]
    against = "obstacles" if axis == "obstacles" else "nodes"
    slopes = g["slopes"]
    rows.append(("exponent", "", "", *(number(slopes[name], 2) for name in QUANTITIES)))
    columns = ("", "dense : ours", "nodes", "C-space", "search", "dense", "motion", "search MB", "dense MB")
    return Table(f"Growth: {title}", columns, tuple(rows), f"{_NOTE} Exponents: against {against}.")
