"""Run a ROS 2 node: judge the motions of any planner, or plan.

`judge` reads motions and MoveIt's planning scene, publishes a verdict for each motion, and passes on only motions that
are verified. `plan` reads joint states, depth clouds and planning scenes, and sends certified motions to a controller.
Without a ROS installation, `pip install 'hplan[ros2]'` installs what is needed.
"""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import TYPE_CHECKING

from hplan.apps.cli.options import command_parser

if TYPE_CHECKING:
    from rich.console import Console

_EPILOG = """\
examples:
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
    parser.add_argument("node", choices=("judge", "plan"), help="the node to run")
    parser.add_argument("ros_arguments", nargs=argparse.REMAINDER, metavar="--ros-args ...", help="arguments for ROS: "
        "parameters (-p NAME:=VALUE), topics (-r FROM:=TO), a file (--params-file FILE)")  # fmt: skip
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Run the node; return the exit status."""
    del console, errors
    if arguments.ros_arguments and arguments.ros_arguments[0] != "--ros-args":
        arguments.parser.error(f"expected --ros-args, got {arguments.ros_arguments[0]!r}")
    node = import_module(f"hplan.apps.ros.{arguments.node}_node")
    status: int = node.main(arguments.ros_arguments)
    return status
