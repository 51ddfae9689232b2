"""The command `hplan`: finds the subcommand that its first word names, and loads no other."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from hplan.cli.options import command_parser

#: What each subcommand does; its file in this folder has its name, and in it a function `main`.
COMMANDS = {
    "plan": "plan one motion; write trajectory.csv, report.json and scene.html",
    "tour": "plan a picking tour through the fruits of a scene",
    "time": "time a motion through waypoints, for any robot",
    "certify": "prove that a trajectory keeps clearance and limits",
    "execute": "run a trajectory on a simulated arm",
    "orchard": "make a scene: a row of fruit trees",
    "view": "show what a job left in its folder, or a trajectory",
    "completion": "print a script that completes these words: hplan completion bash",
}

_USAGE = "hplan COMMAND [options]\n       hplan [SCENE] [options]    short for hplan plan"
_DESCRIPTION = "Motion planning for fruit-harvesting arms."


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status. Without a subcommand a scene is planned."""
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] in (["-h"], ["--help"]):
        width = max(map(len, COMMANDS))
        lines = [f"  {name:{width}}  {line}" for name, line in COMMANDS.items()]
        epilog = "\n".join(["commands:", *lines, "", "hplan COMMAND --help says more of each."])
        command_parser(_DESCRIPTION, epilog, prog="hplan", usage=_USAGE).parse_args(words[:1])
    if words and words[0] in COMMANDS:
        status: int = import_module(f"hplan.cli.{words[0]}").main(words[1:], prog=f"hplan {words[0]}")
        return status
    from hplan.cli import plan

    return plan.main(words, prog="hplan")
