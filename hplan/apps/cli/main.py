"""Motion planning for fruit-harvesting arms."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

from hplan.base.interrupts import INTERRUPTS, handling_signals, leave, signal_of

#: Summary of each subcommand. The module of the same name in this package defines `parser(prog)` and
#: `run(arguments, console, errors)`, which returns the exit status.
COMMANDS = {
    "plan": "plan one motion; write trajectory.csv, report.json and scene.html",
    "tour": "plan a picking tour through the fruits of a scene",
    "row": "choose stops along a row of trees and plan a tour at each",
    "batch": "plan one motion for each of many scene files",
    "study": "evaluate many arms at many trees, on all processors",
    "time": "time a motion through waypoints, for any robot",
    "certify": "prove that a trajectory keeps clearance and limits",
    "execute": "run a trajectory on a simulated arm",
    "ros": "run a ROS 2 node: judge motions of any planner, or plan",
    "init": "write a folder to start from: a scene with your arm, a script",
    "orchard": "generate a scene with a row of fruit trees",
    "inspect": "list the faults of a robot file, its joints and touching links",
    "gui": "move arm, goal and obstacles in a browser; plan and save",
    "view": "show the motion of an output folder, or a trajectory",
    "warmup": "compile all numerical kernels now",
    "completion": "print a shell completion script: hplan completion bash",
}

_USAGE = "hplan COMMAND [options]\n       hplan [SCENE] [options]    short for hplan plan"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status.

    Without a subcommand the arguments go to `hplan plan`.

    Args:
        argv: The arguments; None for `sys.argv[1:]`, in which case a signal ends the process.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    return _ended_cleanly(lambda: _run_words(words), is_program=argv is None)


def _ended_cleanly(work: Callable[[], int], *, is_program: bool) -> int:
    """Run a command line and end without a traceback on a signal.

    This covers the time before the command installs its own signal handling.

    Args:
        work: Runs the command line and returns the exit status.
        is_program: Whether the process ends with the work. If so, an interrupted process exits immediately.

    Returns:
        The exit status of `work`, or 128 plus the number of the signal.
    """
    with handling_signals():
        try:
            status = work()
        except INTERRUPTS as error:
            number = signal_of(error)
            if sys.stderr is not None:
                sys.stderr.write("interrupted\n" if number.name == "SIGINT" else f"ended by {number.name}\n")
            status = 128 + number
        # The signal may have interrupted native code in an inconsistent state, so skip the normal teardown.
        if is_program and status > 128:
            leave(status)
    return status


def _run_words(words: list[str]) -> int:
    from hplan.apps.cli.options import command_parser

    if words[:1] in (["-h"], ["--help"]):
        width = max(map(len, COMMANDS))
        lines = [f"  {name:{width}}  {line}" for name, line in COMMANDS.items()]
        epilog = "\n".join(["commands:", *lines, "", "hplan COMMAND --help describes the options of a command."])
        command_parser(__doc__, epilog, prog="hplan", usage=_USAGE).parse_args(words[:1])
    if words and words[0] in COMMANDS:
        return _run_named(words[0], f"hplan {words[0]}", words[1:])
    if words and (near := _near_command(words[0])):
        command_parser(__doc__, "", prog="hplan", usage=_USAGE).error(
            f"{words[0]!r} is neither a command nor a scene; did you mean {near!r}?"
        )
    return _run_named("plan", "hplan", words)


def _near_command(word: str) -> str | None:
    """Subcommand with the most similar spelling; None for options and scenes."""
    import difflib
    import os

    from hplan.base.data_files import shipped_scenes

    if word.startswith("-") or word in shipped_scenes() or os.path.lexists(word):
        return None
    return next(iter(difflib.get_close_matches(word, COMMANDS, 1)), None)


def run_subcommand(name: str, prog: str, argv: Sequence[str] | None = None) -> int:
    """Run one subcommand; return the exit status.

    Args:
        name: One of `COMMANDS`.
        prog: Program name in help and messages.
        argv: The arguments; None for `sys.argv[1:]`, in which case a signal ends the process.
    """
    return _ended_cleanly(lambda: _run_named(name, prog, argv), is_program=argv is None)


def _run_named(name: str, prog: str, argv: Sequence[str] | None) -> int:
    import argparse
    from importlib import import_module

    from hplan.apps.cli.terminal import run_command

    command = import_module(f"hplan.apps.cli.{name}")
    parser = command.parser(prog)
    arguments = parser.parse_args(argv, argparse.Namespace(parser=parser))
    return run_command(lambda console, errors: command.run(arguments, console, errors))
