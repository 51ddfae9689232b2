"""What the commands share: options, a folder to write into, errors shown, exit statuses.

Nothing heavy is imported before it is needed.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import math
import os
import signal
import sys
import textwrap
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hplan.errors import HplanError, OptionError, OutputError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.robot.tracking import TrackingModel

#: Exit status where what was looked at is not in order.
FAILED = 5

#: Exit status after an interrupt, as shells give it.
INTERRUPTED = 130


#: Signals that end a command, as an interrupt does, so that nothing half-written is left.
ENDING = (signal.SIGTERM, signal.SIGHUP)


class _Ended(BaseException):
    """A signal has ended the command."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class _Terminal:
    """An output of which no fault ends the command: what cannot be shown is escaped, what cannot be written is dropped.

    Results are in files and in the exit status. Whatever else is asked of it, the stream itself answers.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        #: The first fault.
        self.fault: OSError | ValueError | None = None

    def __getattr__(self, name: str) -> Any:
        """What the stream has."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write what can be written."""
        encoding = self._stream.encoding or "utf-8"
        try:
            text.encode(encoding)
        except UnicodeEncodeError:
            text = text.encode(encoding, "backslashreplace").decode(encoding)
        self._try(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Write what is held back."""
        self._try(self._stream.flush)

    def _try(self, action: Callable[[], Any]) -> None:
        if self.fault is not None:
            return
        try:
            action()
        except (OSError, ValueError) as error:  # ValueError: it is closed
            self.fault = error
            with contextlib.suppress(OSError, ValueError):
                # What it holds back would be a fault again when Python ends.
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())


def run_command(command: Callable[[Console, Console], int]) -> int:
    """Run a command and show the error that ends it.

    Args:
        command: Takes the consoles for results and for errors; returns the exit status.

    Returns:
        The exit status: the command's, the error's, `INTERRUPTED`, or 128 and the number of the signal that ended it.
        A terminal that cannot be written to changes nothing of it.
    """
    _open_what_is_closed()
    from rich.console import Console

    out, err = _Terminal(sys.stdout), _Terminal(sys.stderr)
    console, errors = Console(file=out, highlight=False), Console(file=err, highlight=False)  # type: ignore[arg-type]
    try:
        with _ending_by_signal(), _warning_on(errors):
            return command(console, errors)
    except HplanError as error:
        show_error(errors, error)
        return error.exit_status
    except KeyboardInterrupt:
        errors.print("interrupted")
        return INTERRUPTED
    except _Ended as ended:
        errors.print(f"ended by {signal.Signals(ended.number).name}")
        return 128 + ended.number
    finally:
        out.flush()
        if out.fault is not None and not isinstance(out.fault, BrokenPipeError):
            errors.print(f"cannot write to standard output: {getattr(out.fault, 'strerror', None) or out.fault}")


def _open_what_is_closed() -> None:
    """Give closed standard streams a place to go; else the next file that is opened takes their place."""
    for number, name in ((0, "stdin"), (1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            with contextlib.suppress(OSError):
                os.fstat(number)
                continue
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
            setattr(sys, name, open(number, "r" if number == 0 else "w", encoding="utf-8"))  # noqa: SIM115, PTH123


@contextmanager
def _ending_by_signal() -> Iterator[None]:
    """Inside, the signals of `ENDING` end the block by an exception, unless someone has other plans for them."""

    def end(number: int, _: object) -> None:
        raise _Ended(number)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    mine = [number for number in ENDING if signal.getsignal(number) is signal.SIG_DFL]
    for number in mine:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in mine:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def _warning_on(console: Console) -> Iterator[None]:
    """Inside, hplan's own warnings are shown as a line, without the place in the code."""

    def show(message: Any, category: type[Warning], *place: Any, **more: Any) -> None:
        if category.__module__.startswith("hplan."):
            console.print(f"warning: {message}", markup=False, soft_wrap=True)
        else:
            otherwise(message, category, *place, **more)

    with warnings.catch_warnings():
        otherwise, warnings.showwarning = warnings.showwarning, show
        yield


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


class CommandParser(argparse.ArgumentParser):
    """A parser that lets a command know of arguments that cannot be understood, before it ends the program."""

    #: Called with what is wrong.
    on_usage_error: Callable[[str], None] | None = None

    def error(self, message: str) -> NoReturn:
        """Say what is wrong and end the program."""
        if self.on_usage_error is not None:
            self.on_usage_error(message)
        super().error(message)


def command_parser(description: str, epilog: str, *, prog: str | None = None) -> CommandParser:
    """A parser whose help gives the description in lines of 79 and the epilog as it stands."""
    return CommandParser(
        prog=prog,
        description=textwrap.fill(description, 79),
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def named_output(arguments: Sequence[str] | None, default: Path) -> Path | None:
    """What `--out` names in arguments that may not be understood otherwise; None where that cannot be told."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--out", "--ou", type=Path, default=default)
    try:
        found: Path = parser.parse_known_args(arguments)[0].out
    except argparse.ArgumentError:
        return None
    return found


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
    from hplan.robot.tracking import TrackingModel

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


def percent(share: float) -> str:
    """A share in percent, without the sign; in powers of ten where it is beyond all use."""
    return f"{100.0 * share:{'.1f' if share < 1e4 else '.3g'}}"
