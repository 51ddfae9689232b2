"""Hold the analytic C-space against coal, on random scenes of every kind of obstacle."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.job_folder import prepare_folder
from hplan.apps.cli.options import add_shared, command_parser, robot_of
from hplan.apps.cli.terminal import FAILED, run_command
from hplan.errors import OutputError

if TYPE_CHECKING:
    from rich.console import Console
    from studies.validation.kinds import KindsValidation

RESULT = "validation-kinds.json"

_DESCRIPTION = """\
Ask coal whether the arm touches an obstacle, its links as capsules, and compare the answers with the analytic C-space
that the planner uses: random scenes of obstacles of each kind, at random yaws. Of the reference scene,
`benchmark.py reference` asks at every node.
"""

_EPILOG = f"""\
kinds: sphere, capsule, box, mesh, points, fruits; all where none is named.
missed: a collision for coal, free for us. It must be 0.
differ: the signs of our exact distances against coal's answers.
free, lost: free by more than 2 mm for coal, and what of this is forbidden for
  us; 1 % at most.
widest: most to spare for coal where we forbid.

writes DIR/{RESULT} where --out names a folder.

exit status:
  0  nothing missed and no more lost than may be
  2  bad input
  5  a fault was found
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    arguments = _parser().parse_args(argv)
    return run_command(lambda console, errors: _run(arguments, console, errors))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add_shared(parser, "robot", "parts")
    add = parser.add_argument
    add("--kinds", nargs="*", metavar="KIND", help="kinds of obstacles (default: all)")
    add("--scenes", type=int, default=200, metavar="N", help="random scenes of each kind (default: 200)")
    add("--configurations", type=int, default=20_000, metavar="M", help="configurations of each (default: 20000)")
    add("--seed", type=int, default=0, metavar="N", help="seed of the random scenes (default: 0)")
    add("--out", type=Path, metavar="DIR", help="folder to write the numbers into (default: none)")
    return parser


def _run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Compare, write and show; returns the exit status."""
    if arguments.out is not None:
        _prepare(arguments.out / RESULT)
    from studies.validation.kinds import validate_kinds
    from studies.validation.scenes import KINDS

    result = validate_kinds(
        robot_of(arguments),
        arguments.kinds or KINDS,
        scenes=arguments.scenes,
        configurations=arguments.configurations,
        seed=arguments.seed,
        told=lambda row: errors.print(f"{row.kind}: {row.seconds:.0f} s", markup=False),
    )
    _show(console, result)
    if arguments.out is not None:
        from hplan.planning.report import write_report

        write_report(result.as_dict(), arguments.out / RESULT)
        _print(console, f"written to {arguments.out / RESULT}")
    return 0 if result.ok else FAILED


def _prepare(path: Path) -> None:
    """Make the folder of a result and remove an earlier one from it, before any work.

    Raises:
        OutputError: The folder cannot be made or written, or the result not removed.
    """
    prepare_folder(path.parent)
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error


def _show(console: Console, result: KindsValidation) -> None:
    """A table, some of what was missed, and the verdict."""
    each = f"{result.configurations:,} configurations each"
    _print(console, f"\n{result.scenes:,} random scenes of each kind with {result.robot}, {each}")
    headings = ("kind", "looked at", "colliding", "missed", "differ", "free", "lost", "widest")
    rows = [
        (
            row.kind, f"{row.configurations:,}", f"{row.colliding:,}", f"{row.missed:,}", f"{row.differing:,}",
            f"{row.spare:,}", f"{100.0 * row.lost_share:.3f} %", _mm(row.widest_gap_m),
        )
        for row in result.results
    ]  # fmt: skip
    widths = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    for line in (headings, *rows):
        _print(console, "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))
    for row in result.results:
        for example in row.examples:
            joints = ", ".join(f"{joint:.9g}" for joint in example.joints_rad)
            where = f"{row.kind} {example.scene}: {example.side}"
            _print(console, f"{where}, coal {_mm(example.distance_m)}, joints_rad [{joints}]")
    _print(console, f"{'nothing missed' if result.ok else 'FAULTS'}, {result.total_s:.0f} s in all")


def _print(console: Console, line: str) -> None:
    console.print(line, markup=False, soft_wrap=True)


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.3g} mm"


if __name__ == "__main__":
    sys.exit(main())
