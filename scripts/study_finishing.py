"""Finish OMPL's paths on MotionBenchMaker's problems and the reference scene, beside toppra on the same paths."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from studies.benchmark.study_command import add_panda, add_rows, tell

from hplan.cli.options import command_parser
from hplan.cli.terminal import run_command
from hplan.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

_DESCRIPTION = """\
Let OMPL's RRTConnect (extra bench) find and simplify paths for MotionBenchMaker's problems of the Panda and for the
reference scene, finish them, and compare the motions with splines through the same paths, timed by toppra.
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
    add("--problems", type=Path, metavar="DIR", help="folder of the sets, panda_NAME.json each (default: none)")
    add_panda(parser, required=False)
    add("--repeat", type=int, default=10, metavar="N", help="paths in the reference scene (default: 10)")
    add("--seed", type=int, default=1, metavar="N", help="seed of OMPL, positive (default: 1)")
    add("--resolution", type=float, default=0.01, metavar="FRACTION", help="distance between configurations that OMPL "
        "checks, as a fraction of the space's extent (default: 0.01, as OMPL has it)")  # fmt: skip
    add_rows(parser)
    arguments = parser.parse_args(argv)
    return run_command(lambda console, _: _run(arguments, console))


def _run(arguments: argparse.Namespace, console: Console) -> int:
    """Plan, finish, tell, write."""
    from studies.benchmark.finishing import finished, table
    from studies.benchmark.motionbenchmaker import SETS, panda, problems, scene_of
    from studies.benchmark.ompl_paths import seed_ompl

    from hplan.problem.options import PlanOptions
    from hplan.robot.model import load_robot
    from hplan.scene.file import load_scene

    seed_ompl(arguments.seed)
    options = PlanOptions(effort=arguments.effort)
    rows = list(finished(load_robot(), [("reference", load_scene())] * arguments.repeat, options, arguments.resolution))
    if arguments.problems is not None:
        if arguments.urdf is None or arguments.limits is None:
            raise InputError("--problems: --urdf and --limits are needed too")
        robot = panda(arguments.urdf, arguments.limits, tuple(arguments.package_dir))
        scenes = [
            (name, scene_of(robot, problem, name))
            for name in SETS
            for problem in problems(arguments.problems, name)[:: arguments.every]
        ]
        rows += finished(robot, scenes, options, arguments.resolution)
    tell(console, table(rows), [vars(row) for row in rows], arguments.out)
    return 5 if any(row.finished_touches for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
