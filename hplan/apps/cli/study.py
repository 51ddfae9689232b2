"""Evaluate every arm of a study with every tree and base placement.

A placement is a distance, height and turn. Writes study.csv, one row for each design as soon as it is evaluated,
study.json and, if matplotlib is installed, study.png. An interrupted study resumes when the command is run again.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.job_folder import write_figure
from hplan.apps.cli.options import OUT, add_shared, command_parser
from hplan.apps.cli.own_files import STUDY_REPORT, WRITTEN, check_own, digests_of
from hplan.apps.cli.terminal import escape, facts_table, number_table, percent, progress_line, unpicked_facts
from hplan.base.arguments import instance
from hplan.base.files import new_folder
from hplan.base.interrupts import INTERRUPTS, defer_signals, signal_of
from hplan.base.lazy_import import extra
from hplan.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.base.tasks import Pool
    from hplan.study.run import Choice, StudyResult

_EPILOG = """\
format: hplan-study/1
name: longer forearms
measure: reach                     # or tour, row
arms:
  - ur5
  - {name: long, vary: {link_lengths: [[1, 0.8, 0.4], [1, 1, 0.4]]}}
trees: ["trees/*.csv"]
distances: [1.2, 1.4]
turns_deg: [0, 180]                # both sides
yields: [{wood: 0.02, below: 0.008, fruit: 0.02}]

exit status:
  0  done
  2  bad input
  6  some designs lost their worker processes repeatedly; the others are done
"""

#: Files of a study in addition to its report: the table of designs and the figure.
ROWS, FIGURE = "study.csv", "study.png"


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    add = parser.add_argument
    add("study", type=Path, metavar="STUDY.yaml", help="study file: arms, trees and what to measure")
    add(
        "--out",
        type=Path,
        default=OUT,
        metavar="DIR",
        help="output folder; a study in it is resumed (default: out)",
    )
    add_shared(parser, "force")
    add(
        "--workers",
        type=int,
        metavar="N",
        help="number of designs evaluated at the same time (default: one per processor)",
    )
    add(
        "--scheduler",
        metavar="ADDRESS",
        help="address of a Dask scheduler, such as tcp://host:8786 (needs the extra cluster)",
    )
    add_shared(parser, "quiet")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Evaluate, write the files and print a summary; return the exit status."""
    with progress_line(errors, quiet=arguments.quiet) as progress:
        progress("reading the study")

        from hplan.apps.view.figures import draw_study
        from hplan.planning.report import versions, write_report
        from hplan.study.definition import load_study
        from hplan.study.run import run_study

        study = load_study(arguments.study)
        out: Path = arguments.out
        for name in (STUDY_REPORT, FIGURE):
            check_own(out / name, force=arguments.force)
        with new_folder(out):
            try:
                result = run_study(
                    study,
                    out / ROWS,
                    executor=_executor(arguments.scheduler),
                    workers=arguments.workers,
                    progress=lambda done, of: progress(f"design {done} of {of}"),
                )
            except INTERRUPTS as error:
                # Keep the rows written until now: the next run resumes with them.
                with defer_signals():
                    (out / FIGURE).unlink(missing_ok=True)
                    ended = {"status": "interrupted", "study": study.name, "signal": signal_of(error).name}
                    write_report({**ended, "versions": versions()}, out / STUDY_REPORT)
                raise
        report = {"status": "ok", "study": study.name, "measured": result.measured, "seconds": result.seconds}
        with defer_signals():
            figure = write_figure(lambda: draw_study(result), out / FIGURE, errors)
            written = digests_of([out / name for name in figure])
            rest = {"choices": list(map(asdict, result.choices)), "versions": versions(), WRITTEN: written}
            write_report({**report, **rest}, out / STUDY_REPORT)
        files = [ROWS, STUDY_REPORT, *figure]
    if not arguments.quiet:
        _show_study(console, result, f"{arguments.out}: {', '.join(files)}")
    return 0


def _executor(address: str | None) -> Pool | None:
    """Connect to Dask's executor; None without a scheduler address."""
    if address is None:
        return None
    with extra("cluster", "--scheduler needs Dask"):
        from distributed import Client
    from concurrent.futures import Executor

    try:
        return instance("executor", Client(address).get_executor(), Executor)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {address}: {error}", scheduler=address) from error


def _show_study(console: Console, result: StudyResult, files: str) -> None:
    """Print one line for each choice; a star marks the Pareto front."""
    from hplan.planning.failures import REASON_WORDS

    console.print(f"\n[bold]{escape(result.name)}[/], {len(result.rows)} designs\n")
    cells: dict[str, Callable[[Choice], str]] = {
        "arm": lambda one: f"{'[bold green]*[/]' if one.is_best else ' '} {escape(one.arm)}",
        "distance": lambda one: f"{one.distance_m:g} m",
        "height": lambda one: f"{one.height_m:g} m",
        "yields": lambda one: f"{1e3 * one.wood_yields_m:g}/{1e3 * one.fruit_yields_m:g} mm",
        "reach": lambda one: f"{one.reach_m:.2f} m",
        "picked": lambda one: f"{percent(one.share)} %",
        **{
            words: lambda one, reason=reason: f"{percent(one.not_picked[reason])} %"  # type: ignore[misc]
            for reason, words in REASON_WORDS.items()
        },
        "most often by": lambda one: escape(next(iter(one.obstacles), "")),
        "per fruit": lambda one: "" if one.seconds_per_fruit is None else f"{one.seconds_per_fruit:.2f} s",
        "CPU": lambda one: f"{one.cpu_s:.2f} s",
    }
    ranked = sorted(result.choices, key=lambda choice: (-choice.share, choice.cost))
    lines = {heading: [cell(one) for one in ranked] for heading, cell in cells.items()}
    shown = [heading for heading in lines if heading in ("arm", "picked", "CPU") or len(set(lines[heading])) > 1]
    console.print(number_table(shown, zip(*map(lines.__getitem__, shown), strict=True), texts=("arm",)))
    if any(result.not_picked.values()):
        console.print()
        console.print(facts_table(unpicked_facts(result.not_picked, result.obstacles), 0))
    failed = [row for row in result.rows if row.error]
    for row in failed[:5]:
        where = f"{row.arm}, {row.tree} at {row.distance_m:g} m"
        console.print(f"[yellow]nothing picked[/] {escape(where)}: {escape(row.error)}", soft_wrap=True)
    if len(failed) > 5:
        console.print(f"[yellow]nothing picked[/] in {len(failed) - 5} more rows: see the column error")
    console.print(
        f"\n[dim]* no other arm picks as much at as low a cost; CPU time per design\nfiles[/]  {escape(files)}\n"
    )
