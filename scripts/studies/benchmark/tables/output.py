"""All tables of a run, as Markdown and on a terminal."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable
from studies.benchmark.tables import (
    bound,
    camera,
    clutter,
    fastest,
    growth,
    in_motion,
    moving,
    narrow,
    orchards,
    recheck,
    reference,
    replanning,
)
from studies.benchmark.tables.table import Table

#: Makers of the tables of each set, in the order in which they are shown.
_MAKERS = {
    "reference": reference.tables,
    "clutter": clutter.tables,
    "orchards": orchards.tables,
    "replanning": replanning.tables,
    "in_motion": in_motion.tables,
    "moving": moving.tables,
    "camera": camera.tables,
    "narrow": narrow.tables,
    "fastest": fastest.tables,
    "bound": bound.tables,
    "recheck": recheck.tables,
    "growth": growth.tables,
}


def to_markdown(results: dict[str, Any]) -> str:
    """The whole run as Markdown.

    Args:
        results: Results of the run, as in `benchmark.json`.
    """
    lines = [f"{_preamble(results)}\n"]
    for table in _tables(results):
        lines.append(f"**{table.title}**\n")
        lines.append(_row(table.columns))
        lines.append("|---|" + "---:|" * (len(table.columns) - 1))
        lines.extend(_row(row) for row in table.rows)
        lines.append(f"\n{table.note}\n" if table.note else "")
    return "\n".join(lines).rstrip() + "\n"


def show(console: Console, results: dict[str, Any]) -> None:
    """The whole run on a terminal.

    Args:
        console: Where to print.
        results: Results of the run, as in `benchmark.json`.
    """
    console.print(f"\n{_preamble(results)}", markup=False)
    for table in _tables(results):
        drawn = RichTable(box=box.SIMPLE_HEAD, padding=(0, 1))
        for number, column in enumerate(table.columns):
            drawn.add_column(escape(column), justify="right" if number else "left", no_wrap=number == 0)
        for row in table.rows:
            drawn.add_row(*(escape(cell) for cell in row))
        console.print(f"\n[bold]{escape(table.title)}[/]")
        console.print(drawn)
        if table.note:
            console.print(table.note, markup=False, style="dim")
    console.print()


def _tables(results: dict[str, Any]) -> list[Table]:
    """All tables of a run; sets that were not measured have none."""
    return [table for name, make in _MAKERS.items() if name in results for table in make(results[name])]


def _preamble(results: dict[str, Any]) -> str:
    """What was run, and on what."""
    where, how = results["environment"], results["settings"]
    packages = ", ".join(f"{name} {version}" for name, version in where["versions"].items())
    quick = " Quick run: few repetitions." if how["quick"] else ""
    return (
        f"{where['processor']}, {where['cores']} cores, {where['system']}, Python {where['python']}; {packages}. "
        f"Seed {how['seed']}. Times are medians of CPU time on one thread, after a first call that does not count; "
        f"`x` is how many times hplan's it is.{quick}"
    )


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
