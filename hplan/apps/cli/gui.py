"""Move arm, goal and obstacles in a browser; plan, play and save the scene.

The interface needs the extra `viser`. It is reached from this machine alone and runs until interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.options import add_shared, command_parser, robot_of

if TYPE_CHECKING:
    from rich.console import Console

_EPILOG = """\
Sliders move the joints. The handle at the goal and, for an obstacle or fruit
chosen in the list, a second handle are dragged; clearance or contact is shown
at once. The scene is saved with the arm's present configuration as its start.

exit status:
  0  interrupted or closed
  2  bad input
"""


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    add_shared(parser, "scene", "robot", "parts")
    parser.add_argument(
        "--port", type=int, default=8080, metavar="N", help="port (default: 8080, or the next free one)"
    )
    parser.add_argument("--out", type=Path, default=Path("scene.yaml"), metavar="FILE",
        help="suggested name of the saved scene (default: scene.yaml)")  # fmt: skip
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:  # noqa: ARG001
    """Serve the interface until interrupted; return the exit status."""
    from hplan.apps.view.gui import Gui
    from hplan.apps.view.session import Session
    from hplan.scene.file import load_scene

    scene = load_scene(arguments.scene)
    with Gui(Session(robot_of(arguments, scene), scene), port=arguments.port, out=arguments.out) as gui:
        console.print(f"serving the interface at {gui.url} (interrupt to stop)")
        with contextlib.suppress(KeyboardInterrupt):
            gui.wait()
    return 0
