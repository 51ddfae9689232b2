"""Tables of the fastest known motions: how far hplan is from them with each effort, and who holds them."""

from __future__ import annotations

from typing import Any

from studies.benchmark.tables.table import Table, number

#: Problems that are listed by name, at most.
_LISTED = 20


def tables(results: dict[str, Any]) -> list[Table]:
    """The tables of the set.

    Args:
        results: What `studies.benchmark.fastest` measured.
    """
    return [_ratios(results), _holders(results), *_slowest(results)]


def _ratios(f: dict[str, Any]) -> Table:
    rows = []
    for group, n in f["groups"].items():
        for effort, e in n["efforts"].items():
            ratio = [number(e["to_best"][key], 4) for key in ("median", "p95", "max")]
            ms = [number(e["ms"][key]) for key in ("median", "p95")]
            certified = f"{e['certified']}/{n['problems']}"
            rows.append((f"{group}, {effort}", certified, *ratio, str(e["slower"]), *ms))
    note = (
        "Duration of hplan's motions to the best known of the same problem, whoever found it: a motion that hplan has "
        "certified. Planar: base locked, the straight motion in contact; trees: all joints, among measured trees, the "
        "straight motion in contact. Slower: by more than 2 %. Times to plan [ms]."
    )
    if f["without_trees"]:
        note += " No measured trees: no folder of them was given."
    columns = ("", "certified", "ratio: median", "95 %", "max", "slower", "ms: median", "95 %")
    return Table("To the fastest known motion", columns, tuple(rows), note)


def _holders(f: dict[str, Any]) -> Table:
    names = list(dict.fromkeys(by for n in f["groups"].values() for by in n["by"]))
    rows = tuple(
        (group, str(n["problems"]), *(str(n["by"].get(by, 0)) for by in names)) for group, n in f["groups"].items()
    )
    found = len(f["improved"])
    kept = "now kept" if f["kept"] else "not kept (--improve)"
    note = f"{found} of them were found in this run, {kept}." if found else ""
    return Table("Who found the fastest known motion", ("", "problems", *names), rows, note)


def _slowest(f: dict[str, Any]) -> list[Table]:
    def gap(row: dict[str, Any]) -> float:
        best = row["efforts"]["best"]
        return float(best["duration_s"] / row["best_s"]) if best["certified"] else float("inf")

    slow = sorted((row for row in f["rows"] if gap(row) > 1.02), key=lambda row: (-gap(row), row["name"]))
    rows = tuple(
        (
            row["name"],
            number(gap(row), 4),
            *(number(row["efforts"][effort]["duration_s"], 4) for effort in ("default", "best")),
            number(row["best_s"], 4),
            row["by"],
        )
        for row in slow[:_LISTED]
    )
    columns = ("", "best to known", "default [s]", "best [s]", "known [s]", "by")
    return [Table(f"Slower than the fastest known by more than 2 % with the best effort ({len(slow)})", columns, rows)]
