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
millisecond; with --peer, the same for OMPL's RRTConnect (extra bench), its paths simplified and timed by toppra.
"""

_EPILOG = """\
exit status:
  0  done
  2  bad input, or OMPL is missing
  5  a certified motion was found in contact
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add = parser.add_argument
    add("problems", type=Path, metavar="DIR", help="folder of the sets, panda_NAME.json each")
    add_panda(parser, required=True)
    add("--cpu", action="store_true", help="CPU time instead of the wall's")
    add("--no-jerk", action="store_true", help="plan without the limits of jerk, which toppra does not have")
    add("--peer", action="store_true", help="solve them by RRTConnect and toppra too")
    add("--seed", type=int, default=1, metavar="N", help="seed of OMPL, positive (default: 1)")
    add_rows(parser)
    arguments = parser.parse_args(argv)
    return run_command(lambda console, _: _run(arguments, console))


def _run(arguments: argparse.Namespace, console: Console) -> int:
    """Plan, tell, write."""
    from studies.benchmark.motionbenchmaker import panda, peer_table, solved, table
    from studies.benchmark.ompl_paths import seed_ompl
    from studies.benchmark.paths import without_jerk

    from hplan.problem.options import PlanOptions

    robot = panda(arguments.urdf, arguments.limits, tuple(arguments.package_dir))
    if arguments.no_jerk:
        robot = without_jerk(robot)
    options = PlanOptions(effort=arguments.effort)
    if arguments.peer:
        seed_ompl(arguments.seed)
    every, cpu, peer = arguments.every, arguments.cpu, arguments.peer
    rows = list(solved(robot, arguments.problems, options, every=every, cpu=cpu, peer=peer))
    told = [*table(rows), *(peer_table(rows) if peer else ())]
    tell(console, told, [row.row for row in rows], arguments.out)
    return 5 if any(row.verified and any(row.contacts) for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
