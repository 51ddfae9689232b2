"""Run a ROS 2 node: judge the motions of any planner, or plan.

`judge` reads motions and MoveIt's planning scene, publishes a verdict for each motion, and passes on only motions that
are verified. `plan` reads joint states, depth clouds and planning scenes, and sends certified motions to a controller.
Without a ROS installation, `pip install 'hplan[ros2]'` installs what is needed.
"""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Iterable
from dataclasses import fields
from importlib import import_module
from typing import TYPE_CHECKING

from hplan.apps.cli.options import command_parser

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.base.checked import Options

_EPILOG = """\
examples:
  hplan ros judge --help    # its parameters
  hplan ros judge --ros-args -p robot:=panda \\
      -r '~/display_trajectory:=/display_planned_path' \\
      -r planning_scene:=/monitored_planning_scene
  hplan ros plan --ros-args -p robot:=ur5 -p scene:=cell.yaml

exit status:
  0  ended by SIGINT or SIGTERM
  2  bad input: a parameter, robot, scene, or no rclpy
"""


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    parser.add_argument(
        "node", choices=("judge", "plan"), help="the node to run; its parameters are listed by `hplan ros NODE --help`"
    )
    parser.add_argument("ros_arguments", nargs=argparse.REMAINDER, metavar="--ros-args ...", help="arguments for ROS: "
        "parameters (-p NAME:=VALUE), topics (-r FROM:=TO), a file (--params-file FILE)")  # fmt: skip
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Run the node; return the exit status."""
    del errors
    node = import_module(f"hplan.apps.ros.{arguments.node}_node")
    first = next(iter(arguments.ros_arguments), "--ros-args")
    if first in ("-h", "--help"):
        _print_parameters(node.PARAMETERS, console)
        return 0
    if first != "--ros-args":
        arguments.parser.error(f"expected --ros-args, got {first!r}")
    status: int = node.main(arguments.ros_arguments)
    return status


def _print_parameters(kinds: Iterable[type[Options]], console: Console) -> None:
    """Print the parameters of a node, with their defaults."""
    from hplan.apps.ros.node import describe_fields

    console.print("parameters, each as -p NAME:=VALUE after --ros-args:", highlight=False)
    for kind in kinds:
        described = describe_fields(kind)
        for field in fields(kind):  # type: ignore[arg-type]
            default = list(field.default) if isinstance(field.default, tuple) else field.default
            words = f"{described[field.name]} (default: {json.dumps(default)})"
            text = textwrap.fill(words, 100, initial_indent=" " * 6, subsequent_indent=" " * 6)
            console.print(f"  {field.name}\n{text}", markup=False, highlight=False, soft_wrap=True)
