"""Tables of lower bounds: how near they are to certified motions, by kind of problem."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.table import Table, number


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.fastest.bound` measured.
    """
    rows = []
    for group, n in results["groups"].items():
        gaps = [number(100.0 * n[which][key]) for which in ("gap", "joints_gap") for key in ("median", "p95", "max")]
        times = [number(n["ms"][key]) for key in ("median", "p95", "max")]
        rows.append((group, str(n["motions"]), *gaps, *times))
    one, broken = results["reference"], results["violations"]
    note = (
        f"Of {results['scenes']} certified motions {len(broken)} are shorter than their bound; for "
        f"{results['best_checked']} that of the best effort was compared too, and the bound sought on. "
        "Gaps: by how many per cent the motion is at most "
        "longer than the shortest one, by the bound and by the slowest joint alone. Bounds by reachability are called "
        f"planar. The reference scene: {one['seconds']:.3f} s, {100.0 * one['gap']:.1f} % below the motion of "
        f"{one['duration_s']:.3f} s, in {number(one['ms'])} ms and {number(one['memory_mb'])} MB."
    )
    columns = [f"{what}: {key}" for what in ("gap [%]", "one joint [%]", "ms") for key in ("median", "95 %", "max")]
    return [Table("Lower bounds of durations", ("", "motions", *columns), tuple(rows), note)]
