"""What the commands share: options, a folder to write into, errors shown, exit statuses.

Nothing heavy is imported before it is needed.
"""

from __future__ import annotations

import argparse
import gc
import math
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.errors import HplanError, OptionError, OutputError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.tracking import TrackingModel

#: Exit status where what was looked at is not in order.
FAILED = 5

#: Exit status after an interrupt, as shells give it.
INTERRUPTED = 130


def run_command(command: Callable[[Console, Console], int]) -> int:
    """Run a command and show the error that ends it.

    Args:
        command: Takes the consoles for results and for errors; returns the exit status.

    Returns:
        The exit status: the command's, the error's, or `INTERRUPTED`.
    """
    from rich.console import Console

    console, errors = Console(highlight=False), Console(stderr=True, highlight=False)
    try:
        return command(console, errors)
    except HplanError as error:
        show_error(errors, error)
        return error.exit_status
    except KeyboardInterrupt:
        errors.print("interrupted")
        return INTERRUPTED


@contextmanager
def loading() -> Iterator[None]:
    """Run imports inside: what they make stays, and is left out of all collections of garbage, these and later ones."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def show_error(console: Console, error: HplanError) -> None:
    """Say what went wrong and, where no path exists, the first of what is in the way."""
    from rich.markup import escape

    console.print(f"[bold red]error[/] ({error.kind}): {escape(error.message)}", soft_wrap=True)
    for blocker in error.data.get("blockers", ())[:5]:
        low, high = blocker["slices_deg"]
        console.print(
            f"  {escape(blocker['obstacle'])} against {escape(blocker['link'])}: {blocker['cells']} border nodes, "
            f"last joint {low:g} to {high:g} deg",
            soft_wrap=True,
        )


def command_parser(description: str, epilog: str, *, prog: str | None = None) -> argparse.ArgumentParser:
    """A parser whose help gives the description in lines of 79 and the epilog as it stands."""
    return argparse.ArgumentParser(
        prog=prog,
        description=textwrap.fill(description, 79),
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the argument `scene`."""
    parser.add_argument(
        "scene", nargs="?", type=Path, help="scene file (default: the paper's reference scene, Table 1)"
    )


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Add the options `--robot` and `--limits`."""
    add = parser.add_argument
    add("--robot", type=Path, metavar="URDF", help="robot (default: the harvester that ships with hplan)")
    add("--limits", type=Path, metavar="YAML", help="acceleration limits (default: NAME.limits.yaml beside the URDF)")


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
    from hplan.tracking import TrackingModel

    error_deg, delay_ms = arguments.tracking_error, arguments.tracking_delay
    for option, value, unit in (("--tracking-error", error_deg, "degrees"), ("--tracking-delay", delay_ms, "ms")):
        if not 0.0 <= value < math.inf:
            raise OptionError(option, value, f"a finite number of {unit} >= 0")
    return TrackingModel(math.radians(error_deg), 1e-3 * delay_ms)


def prepare_folder(folder: Path) -> None:
    """Make a folder and see that it can be written, before any work.

    Raises:
        OutputError: It cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".hplan-probe"
        probe.touch()
        probe.unlink()
    except FileExistsError as error:
        raise OutputError(folder, "it is a file, not a folder") from error
    except OSError as error:
        raise OutputError(folder, error.strerror or str(error)) from error
