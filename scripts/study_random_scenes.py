"""Plan random scenes of any arm beside RRTConnect, graze its motions, and look at everything from outside."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from studies.benchmark.study_command import add_rows, tell

from hplan.cli.options import add_robot, command_parser, robot_of
from hplan.cli.terminal import run_command

if TYPE_CHECKING:
    from rich.console import Console

_DESCRIPTION = """\
Plan random scenes (boxes, balls, capsules, clouds) for an arm of any kind, let OMPL's RRTConnect (extra bench) solve
them too, and let coal look at every motion each millisecond. With --grazing, put obstacles where certified motions
graze them by 0.1 to 5 mm, which must not be verified, and where everything keeps 0.3 mm clear, which should be.
"""

_EPILOG = """\
exit status:
  0  done
  2  bad input, or OMPL is missing
  5  a certified motion was found in contact, a grazing one verified, or a scene missed that RRTConnect solves
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add = parser.add_argument
    add_robot(parser)
    add("--scenes", type=int, default=200, metavar="N", help="how many (default: 200)")
    add("--first", type=int, default=0, metavar="N", help="number of the first one (default: 0)")
    add("--grazing", type=int, default=0, metavar="N", help="grazing obstacles, and as many clear ones (default: 0)")
    add("--seed", type=int, default=1, metavar="N", help="of scenes and OMPL, positive (default: 1)")
    add("--effort", choices=("quick", "default", "best"), default="default", help="default: default")
    add_rows(parser)
    arguments = parser.parse_args(argv)
    return run_command(lambda console, _: _run(arguments, console))


def _run(arguments: argparse.Namespace, console: Console) -> int:
    """Plan, graze, tell, write."""
    from dataclasses import asdict

    from studies.benchmark import arm_grazing, arm_motions
    from studies.benchmark.ompl_paths import seed_ompl

    from hplan.problem.options import PlanOptions

    robot, options, seed = robot_of(arguments), PlanOptions(effort=arguments.effort), arguments.seed
    lines, kept, failed = [], [], False
    if arguments.scenes > 0:
        seed_ompl(seed)
        numbers = range(arguments.first, arguments.first + arguments.scenes)
        rows = list(arm_motions.attempts(robot, numbers, options, seed))
        lines += arm_motions.table(rows)
        kept += [asdict(row) for row in rows]
        failed |= any(any(row.contacts) or (row.peer_solved and not row.verified) for row in rows)
    if arguments.grazing > 0:
        grazed = list(arm_grazing.grazed(robot, arguments.grazing, seed))
        lines += arm_grazing.table(grazed)
        kept += [asdict(row) for row in grazed]
        failed |= any(row.verified for row in grazed if row.spare_m < 0.0)
    tell(console, lines, kept, arguments.out)
    return 5 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
