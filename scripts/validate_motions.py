"""Hold certified motions of random arms against Pinocchio and coal on everything that their URDFs describe."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.cli.job_folder import prepare_folder
from hplan.cli.options import command_parser
from hplan.cli.terminal import FAILED, run_command
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console
    from studies.validation.member_motions import MotionCounts

RESULT = "validation-motions.json"

_DESCRIPTION = """\
Draw members of the family with bodies on pedestal, turret, links and tool, and motions of each among obstacles of all
kinds; look every millisecond of every certified motion whether any body touches an obstacle or another body. Then put
obstacles where a certified motion grazes them by 0.1 to 5 mm, which must not be verified, and where everything keeps 1
to 5 mm from them, which must be.
"""

_EPILOG = f"""\
--full: 1000 motions of 20 members, 300 grazing and 300 clear obstacles
  (default: 50 motions of 5 members, 20 and 20).

writes DIR/{RESULT} where --out names a folder.

exit status:
  0  nothing wrong
  2  bad input
  5  a contact, a grazing motion verified, or a clear one not
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    arguments = _parser().parse_args(argv)
    return run_command(lambda console, errors: _run(arguments, console, errors))


def _run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Draw, look and show; returns the exit status."""
    from studies.validation.motions import GRAZING, MEMBERS, MOTIONS, validate_motions

    if arguments.out is not None:
        prepare_folder(arguments.out)
    defaults = (MEMBERS, MOTIONS, GRAZING) if arguments.full else (5, 50, 20)
    given = (arguments.members, arguments.motions, arguments.grazing)
    members, motions, grazing = (
        default if value is None else value for value, default in zip(given, defaults, strict=True)
    )
    least = {"--members": (members, 1), "--motions": (motions, 0), "--grazing": (grazing, 0)}
    for name, (value, smallest) in {**least, "--jobs": (arguments.jobs, 1), "--seed": (arguments.seed, 0)}.items():
        if value < smallest:
            raise OptionError(name, value, f"a whole number >= {smallest}")
    tally = validate_motions(
        members=members, motions=motions, grazing=grazing, seed=arguments.seed, jobs=arguments.jobs,
        progress=lambda done, so_far: errors.print(
            f"{done} of {members} members: {so_far.certified} certified of {so_far.asked}", markup=False
        ),
    )  # fmt: skip
    _show(console, tally)
    if arguments.out is not None:
        from hplan.planning.report import write_report

        write_report(tally.as_dict(), arguments.out / RESULT)
        console.print(f"written to {arguments.out / RESULT}\n", markup=False, soft_wrap=True)
    return 0 if tally.ok else FAILED


def _show(console: Console, tally: MotionCounts) -> None:
    """The counts in words."""
    refused = ", ".join(f"{count} {kind}" for kind, count in tally.refused.most_common()) or "none"
    members = ", ".join(f"{count} of {kind}" for kind, count in tally.members.most_common())
    for line in (
        f"members: {members}",
        f"motions asked for: {tally.asked}; refused: {refused}",
        f"certified: {tally.certified}, looked at {tally.looks} configurations; with contact: {len(tally.contacts)}",
        f"grazing: {tally.grazing}; of these verified: {len(tally.verified)}",
        f"clear: {tally.clear}; of these not verified: {len(tally.unverified)}",
    ):
        console.print(line, markup=False, soft_wrap=True)
    for what in (tally.contacts, tally.verified, tally.unverified):
        for case in what[:5]:
            console.print(str({name: value for name, value in case.items() if name != "scene"}), markup=False)


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add = parser.add_argument
    add("--full", action="store_true", help="the full numbers")
    add("--members", type=int, metavar="N", help="members of the family")
    add("--motions", type=int, metavar="N", help="certified motions, of all members together")
    add("--grazing", type=int, metavar="N", help="grazing obstacles, and as many clear ones")
    add("--seed", type=int, default=0, metavar="N", help="seed of all draws (default: 0)")
    add("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")
    add("--out", type=Path, metavar="DIR", help="folder to write the numbers into (default: none)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
