"""Hold motions of random arms against Pinocchio and coal on everything that their URDFs describe."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.job_folder import prepare_folder
from hplan.apps.cli.options import command_parser
from hplan.apps.cli.terminal import FAILED, run_command
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console
    from studies.validation.episodes import Tally

RESULT = "validation-{}.json"

_DESCRIPTION = """\
motions   Draw arms of any kind, half of the scenes moving, half of them with a cloud from a pose. Plan, stop, scale and
          splice, and look every half millisecond of what is handed out as verified whether any body touches an
          obstacle, as it truly is, or another body.
grazing   Put obstacles where a motion grazes them by 0.1 to 5 mm, which must not be verified, or where everything keeps
          1 to 5 mm from them, which must be.
yielding  Plan to the fruit of measured trees that give way (--trees), and look whether anything is pushed deeper than
          it yields, or by a link that may not, or untold; with a bound 10 um too small nothing must be verified.
soak      One planner, and four threads that call its methods at a camera's rate.
"""

_EPILOG = """\
A case follows from --seed and its number alone: `--first 17 --cases 1` runs number 17 again.

writes DIR/validation-WHAT.json where --out names a folder.

exit status:
  0  nothing wrong
  2  bad input
  5  a contact, a jump, a grazing motion verified, a clear one not, or a foreign exception
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    arguments = _parser().parse_args(argv)
    return run_command(lambda console, errors: _run(arguments, console, errors))


def _run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Draw, look and show; returns the exit status."""
    for name, least in (("cases", 1), ("first", 0), ("seed", 0)):
        if getattr(arguments, name) < least:
            raise OptionError(f"--{name}", getattr(arguments, name), f"a whole number >= {least}")
    if not arguments.minutes > 0.0:
        raise OptionError("--minutes", arguments.minutes, "a number of minutes > 0")
    if arguments.out is not None:
        prepare_folder(arguments.out)

    def told(tally: Tally, *, whole: bool = False) -> None:
        if arguments.out is not None:
            from hplan.planning.report import write_report

            write_report(tally.as_dict(), arguments.out / RESULT.format(arguments.what))
        if whole:
            _show(console, tally)

    tally = _count(arguments, lambda line: errors.print(line, markup=False, soft_wrap=True), told)
    told(tally, whole=True)
    return FAILED if tally.faults else 0


def _count(arguments: argparse.Namespace, say: Callable[[str], None], told: Callable[[Tally], None]) -> Tally:
    """What was counted, told now and then."""
    from studies.validation.episodes import Tally, run_case
    from studies.validation.grazing import graze

    until = time.monotonic() + 60.0 * arguments.minutes
    if arguments.what == "soak":
        from studies.validation.soak import soak

        return soak(arguments.seed, 60.0 * arguments.minutes, say, told)
    total, run = Tally(), {"motions": run_case, "grazing": graze}.get(arguments.what)
    if run is None:
        from studies.validation.yielding import among_yielding

        run = partial(among_yielding, trees=sorted(arguments.trees.glob("*.csv")))
    for number in range(arguments.first, arguments.first + arguments.cases):
        found = run(arguments.seed, number)
        total.add(found)
        for fault in found.faults:
            say(str(fault))
        if number % 10 == 9:
            say(f"up to case {number}: {total.motions} motions, {len(total.faults)} at fault")
            told(total)
        if time.monotonic() > until:
            break
    return total


def _show(console: Console, tally: Tally) -> None:
    """The counts in words."""
    for name in ("arms", "looked", "looked_in", "unverified", "refused"):
        counts: Counter[str] = getattr(tally, name)
        listed = ", ".join(f"{count} {kind}" for kind, count in counts.most_common()) or "none"
        console.print(f"{name.replace('_', ' ')}: {listed}", markup=False, soft_wrap=True)
    for name, value in tally.measured.items():
        console.print(f"{name}: {value}", markup=False, soft_wrap=True)
    looks = f"{tally.motions} motions, {tally.ticks} configurations; at fault: {len(tally.faults)}"
    console.print(looks, markup=False, soft_wrap=True)
    for fault in tally.faults[:5]:
        console.print(str(fault), markup=False, soft_wrap=True)


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add = parser.add_argument
    add("what", nargs="?", choices=("motions", "grazing", "yielding", "soak"), default="motions", help="what to do")
    add("--cases", type=int, default=20, metavar="N", help="arms, some 50 motions each (default: 20)")
    add("--first", type=int, default=0, metavar="N", help="number of the first case (default: 0)")
    add("--minutes", type=float, default=60.0, metavar="M", help="stop after so long (default: 60)")
    add("--seed", type=int, default=0, metavar="N", help="seed of all draws (default: 0)")
    trees = Path(__file__).parent / "examples" / "trees"
    add("--trees", type=Path, default=trees, metavar="DIR", help="measured trees (default: the shipped one)")
    add("--out", type=Path, metavar="DIR", help="folder to write the numbers into (default: none)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
