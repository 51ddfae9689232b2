"""Plan the fruits of a scene without and with a tracking error, run them on machines that track badly, and count."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from hplan.cli.options import add_robot, add_tracking, command_parser, robot_of, tracking_of
from hplan.cli.terminal import FAILED, run_command

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.planning.plan import PlanResult
    from hplan.planning.task import PlanningCache
    from hplan.problem.options import PlanOptions
    from hplan.scene.model import Scene

_DESCRIPTION = """\
Which fruits that can be picked without a tracking error can be picked with one, and in how much more time; and, with
--execute, whether the motions touch anything when a simulated arm of other masses runs them late, and how many of them
stay within the tracking error.
"""

_EPILOG = """\
exit status:
  0  no motion touched anything whose joints stayed within the tracking error
  2  bad input
  5  one did
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    arguments = _parser().parse_args(argv)
    return run_command(lambda console, _: _run(arguments, console))


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add = parser.add_argument
    add("scenes", nargs="+", help="scene files, or names of scenes that ship with hplan")
    add_robot(parser)
    add_tracking(parser)
    parser.set_defaults(tracking_error=0.02, tracking_delay=3.0)
    add("--fruits", type=int, metavar="N", help="the first N fruits of each scene (default: all)")
    add("--execute", action="store_true", help="run the motions in MuJoCo")
    add("--mass-factors", type=float, nargs="+", default=(0.8, 1.2), metavar="F", help="default: 0.8 1.2")
    add("--command-delay", type=float, default=1.0, metavar="MS", help="by how much controllers are late (default: 1)")
    add("--bandwidth", type=float, default=200.0, metavar="RAD/S", help="of the position loop (default: 140)")
    return parser


def _run(arguments: argparse.Namespace, console: Console) -> int:
    """Plan, execute, show; returns the exit status."""
    import numpy as np

    from hplan.execution.plant import Plant
    from hplan.execution.simulation import execute
    from hplan.planning.task import PlanningCache
    from hplan.problem.options import PlanOptions
    from hplan.scene.file import load_scene

    tracking = tracking_of(arguments)
    plants = [
        Plant(factor, 1e-3 * arguments.command_delay, arguments.bandwidth, decoupled=True)
        for factor in arguments.mass_factors
    ]
    options = PlanOptions()
    allowing = replace(options, tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s)
    ratios, pickable, runs, within, touching, both = [], 0, 0, 0, 0, 0
    for name in arguments.scenes:
        scene = load_scene(name)
        robot = robot_of(arguments, scene)
        plain, careful = PlanningCache(robot), PlanningCache(robot)
        for fruit in scene.fruits[: arguments.fruits]:
            task = scene.model_copy(update={"goal": scene.goal.model_copy(update={"fruit": fruit.name})})
            before = _planned(plain, task, options)
            if before is None:
                continue
            pickable += 1
            found = _planned(careful, task, allowing)
            if found is None:
                console.print(f"{name} {fruit.name}: not with a tracking error of {tracking}")
                continue
            ratios.append(found.trajectory.duration / before.trajectory.duration)
            console.print(f"{name} {fruit.name}: {found.trajectory.duration:.3f} s, {ratios[-1]:.3f} of before")
            for plant in plants if arguments.execute else ():
                result = execute(robot, task, found.trajectory, plant)
                runs, kept, touched = runs + 1, result.is_within(tracking), bool(result.contacts)
                within, touching, both = within + kept, touching + touched, both + (kept and touched)
    console.print(f"{len(ratios)} of {pickable} fruits can be picked with a tracking error of {tracking}")
    if ratios:
        console.print(f"in {np.median(ratios):.3f} times the time (median), {max(ratios):.3f} at most")
    if arguments.execute:
        console.print(f"{runs} executed: {within} within it, {touching} touched something, {both} did both")
    return FAILED if both else 0


def _planned(workspace: PlanningCache, scene: Scene, options: PlanOptions) -> PlanResult | None:
    """The plan, or None where there is none."""
    from hplan.errors import HplanError
    from hplan.planning.plan import plan_with

    try:
        return plan_with(workspace, scene, options)
    except HplanError:
        return None


if __name__ == "__main__":
    sys.exit(main())
