"""Plan MotionBenchMaker's problems for the Panda, and look at every motion from outside."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from studies.benchmark.study_command import add_panda, add_rows, tell

from hplan.cli.options import command_parser
from hplan.cli.terminal import run_command

if TYPE_CHECKING:
    from rich.console import Console

_DESCRIPTION = """\
Plan MotionBenchMaker's problems for the Panda (seven sets, one JSON list each), and let coal look at every motion each
millisecond.
"""

_EPILOG = """\
exit status:
  0  done
  2  bad input
  5  a certified motion was found in contact
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add = parser.add_argument
    add("problems", type=Path, metavar="DIR", help="folder of the sets, panda_NAME.json each")
    add_panda(parser, required=True)
    add("--cpu", action="store_true", help="CPU time instead of the wall's")
    add_rows(parser)
    arguments = parser.parse_args(argv)
    return run_command(lambda console, _: _run(arguments, console))


def _run(arguments: argparse.Namespace, console: Console) -> int:
    """Plan, tell, write."""
    from studies.benchmark.motionbenchmaker import panda, solved, table

    from hplan.problem.options import PlanOptions

    robot = panda(arguments.urdf, arguments.limits, tuple(arguments.package_dir))
    options = PlanOptions(effort=arguments.effort)
    rows = list(solved(robot, arguments.problems, options, every=arguments.every, cpu=arguments.cpu))
    tell(console, table(rows), [vars(row) for row in rows], arguments.out)
    return 5 if any(row.verified and any(row.contacts) for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
