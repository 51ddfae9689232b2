"""Plan one motion for each of many scene files.

Writes a table with one row for each scene as soon as it is planned. An interrupted batch resumes when the command is
run again with the same table.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.options import OF_PLANS, add_shared, command_parser, plan_options, robot_of
from hplan.apps.cli.terminal import escape, number_table, progress_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from hplan.study.batch import BatchRow

_EPILOG = """\
exit status:
  0  every scene has a certified motion
  2  bad input of the command itself
  6  some scenes have no certified motion; the table says why

examples:
  hplan batch scenes/*.yaml --jobs 8
  hplan batch scenes/*.yaml --robot my_arm.urdf --trajectories motions
"""

#: Exit status if some scenes have no certified motion.
_SOME_FAILED = 6


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    add = parser.add_argument
    add("scenes", nargs="+", metavar="SCENE", help="scene files or names of shipped scenes")
    add("--out", type=Path, default=Path("batch.csv"), metavar="CSV", help="table to write, and to resume from "
        "(default: batch.csv)")  # fmt: skip
    add("--trajectories", type=Path, metavar="DIR", help="folder for the motions as CSV (default: none are written)")
    add("--jobs", type=int, metavar="N", help="number of concurrent plans (default: one per processor)")
    add_shared(parser, "robot", "parts", "search", "effort", "seed", "grid", "standoff")
    add_shared(parser, "pace", "tracking", "sigmas", "risk", "capture", "deadline", "quiet")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Plan, write the table and print a summary; return the exit status."""
    with progress_line(errors, quiet=arguments.quiet) as progress:
        progress("reading robot and scenes")
        from hplan.base.arguments import check_integer
        from hplan.study.batch import run_batch

        options = plan_options(arguments, *OF_PLANS, "risk")
        if arguments.jobs is not None:
            check_integer("--jobs", arguments.jobs, 1)
        rows = run_batch(
            arguments.scenes,
            options,
            robot=None if arguments.robot is None else robot_of(arguments),
            rows=arguments.out,
            trajectories=arguments.trajectories,
            workers=arguments.jobs,
            progress=lambda done, of: progress(f"scene {done} of {of}"),
        )
    if not arguments.quiet:
        _show_rows(console, rows, arguments.out)
    return 0 if all(row.verified for row in rows) else _SOME_FAILED


def _show_rows(console: Console, rows: Sequence[BatchRow], path: Path) -> None:
    """Print one line for each scene, and errors.

    Scenes without a motion have an error.
    """
    lines = [
        (
            escape(row.scene),
            escape(row.status),
            "" if row.duration_s is None else f"{row.duration_s:.3f} s",
            "" if row.min_clearance_m is None else f"{1e3 * row.min_clearance_m:.1f} mm",
            "" if row.planning_ms is None else f"{row.planning_ms:.0f} ms",
        )
        for row in rows
    ]
    headings = ("scene", "status", "motion", "clearance", "planning")
    console.print(number_table(headings, lines, texts=headings[:2]))
    for row in rows:
        if row.error:
            console.print(f"[yellow]{escape(row.scene)}[/]: {escape(row.error)}", soft_wrap=True)
    verified = sum(row.verified for row in rows)
    console.print(f"\n{verified} of {len(rows)} scenes have a certified motion\n[dim]table[/]  {escape(path)}\n")
