"""Parsers and options that commands share, and what they say in hplan's own terms."""

from __future__ import annotations

import argparse
import math
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import hplan
from hplan.errors import OptionError, OutputError

if TYPE_CHECKING:
    from hplan.problem.options import PlanOptions
    from hplan.robot.tracking import TrackingModel


class CommandParser(argparse.ArgumentParser):
    """A parser that lets a command know of arguments that cannot be understood, before it ends the program."""

    #: What is to be understood.
    words: Sequence[str] = ()
    #: Called with what is wrong, and with the words.
    on_usage_error: Callable[[str, Sequence[str]], None] | None = None

    def error(self, message: str) -> NoReturn:
        """Say what is wrong and end the program."""
        if self.on_usage_error is not None:
            self.on_usage_error(message, self.words)
        super().error(message)


def command_parser(
    description: str, epilog: str, *, prog: str | None = None, usage: str | None = None
) -> CommandParser:
    """A parser whose help gives the description in lines of 79 and the epilog as it stands."""
    parser = CommandParser(
        prog=prog,
        usage=usage,
        description=textwrap.fill(description, 79),
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if prog is not None and prog.startswith("hplan"):
        parser.add_argument("--version", action="version", version=f"hplan {hplan.__version__}")
    return parser


def named_output(words: Sequence[str], default: Path) -> Path | None:
    """What `--out` names in arguments that may not be understood otherwise; None where that cannot be told."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--out", "--ou", type=Path, default=default)
    try:
        found: Path = parser.parse_known_args(words)[0].out
    except argparse.ArgumentError:
        return None
    return found


def add_scene(parser: argparse.ArgumentParser, default: str = "the paper's reference scene, Table 1") -> None:
    """Add the argument `scene`: a text, for `hplan.scene.file.load_scene` tells files and shipped scenes apart."""
    parser.add_argument("scene", nargs="?", help=f"scene file, or name of a shipped scene (default: {default})")


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Add the options `--robot` and `--limits`."""
    add = parser.add_argument
    add("--robot", type=Path, metavar="URDF", help="robot (default: the harvester that ships with hplan)")
    add("--limits", type=Path, metavar="YAML", help="acceleration limits (default: NAME.limits.yaml beside the URDF)")


def add_pace(parser: argparse.ArgumentParser) -> None:
    """Add the options `--rate` and `--speed`."""
    add = parser.add_argument
    add(
        "--rate",
        dest="rate_hz",
        type=float,
        default=250.0,
        metavar="HZ",
        help="rows per second in the CSV (default: 250)",
    )
    add("--speed", type=float, default=1.0, metavar="FRACTION", help="fraction of full speed, in (0, 1] (default: 1)")


def add_tracking(parser: argparse.ArgumentParser) -> None:
    """Add the options `--tracking-error` and `--tracking-delay`."""
    add = parser.add_argument
    add("--tracking-error", type=float, default=0.0, metavar="DEG", help="deviation of each joint that is allowed for")
    add("--tracking-delay", type=float, default=0.0, metavar="MS", help="the same, for each unit of joint velocity")


def tracking_of(arguments: argparse.Namespace) -> TrackingModel:
    """What `--tracking-error` and `--tracking-delay` say.

    Raises:
        OptionError: One that is negative or not finite.
    """
    from hplan.robot.tracking import TrackingModel

    error_deg, delay_ms = arguments.tracking_error, arguments.tracking_delay
    for option, value, unit in (("--tracking-error", error_deg, "degrees"), ("--tracking-delay", delay_ms, "ms")):
        if not 0.0 <= value < math.inf:
            raise OptionError(option, value, f"a finite number of {unit} >= 0")
    return TrackingModel(math.radians(error_deg), 1e-3 * delay_ms)


def plan_options(arguments: argparse.Namespace, *options: str) -> PlanOptions:
    """How to plan: tracking, pace, and the other options of these names.

    Raises:
        OptionError: A value out of its range.
    """
    from hplan.problem.options import PlanOptions

    tracking = tracking_of(arguments)
    chosen = {option: getattr(arguments, option) for option in ("rate_hz", "speed", *options)}
    return PlanOptions(tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s, **chosen)


def check_output_file(out: Path, read: Sequence[Path | None]) -> None:
    """Refuse, before any work, a file to write that is one of those that are `read`, or has no folder.

    Raises:
        OptionError: It would replace something that is read.
        OutputError: There is no such folder.
    """
    if any(path is not None and path.resolve() == out.resolve() for path in read):
        raise OptionError("--out", str(out), "another file than those that are read")
    if not out.resolve().parent.is_dir():
        raise OutputError(out, "its folder does not exist")
