"""The terminal that a command runs at: signals, closed or full outputs, progress, facts and errors shown, statuses."""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from hplan.apps.cli.job_folder import reporting_interrupts
from hplan.base.files import protecting_inputs
from hplan.base.interrupts import INTERRUPTS, handling_signals, signal_of
from hplan.base.kernel_turns import LISTENERS
from hplan.base.lazy_import import without_garbage_collection
from hplan.errors import HplanError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

#: Exit status where what was checked is not in order.
FAILED = 5

#: Without a terminal there is a line of progress every so often [s]; on one, it has so many characters at most.
_EVERY_S, _WIDTH = 10.0, 76


class _Terminal:
    """An output of which no fault ends the command: what cannot be shown is escaped, what cannot be written is dropped.

    Results are in files and in the exit status. Whatever else is asked of it, the stream itself answers.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        #: The first fault.
        self.fault: OSError | ValueError | None = None

    def __getattr__(self, name: str) -> Any:
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
        The exit status: the command's, the error's, or 128 and the number of the signal that ended it (130 after
        Ctrl-C). A terminal that cannot be written to changes nothing of it.
    """
    _open_what_is_closed()
    from rich.console import Console

    out, err = _Terminal(sys.stdout), _Terminal(sys.stderr)
    console, errors = Console(file=out, highlight=False), Console(file=err, highlight=False)  # type: ignore[arg-type]
    try:
        with handling_signals(), _warning_on(errors), protecting_inputs():
            try:
                with reporting_interrupts():
                    return command(console, errors)
            except INTERRUPTS as error:
                errors.print(interrupt_words(error))
                return 128 + signal_of(error)
    except HplanError as error:
        show_error(errors, error)
        return error.exit_status
    finally:
        out.flush()
        if out.fault is not None and not isinstance(out.fault, BrokenPipeError):
            errors.print(f"cannot write to standard output: {getattr(out.fault, 'strerror', None) or out.fault}")


def interrupt_words(error: BaseException) -> str:
    """What is said when a signal has ended a command."""
    number = signal_of(error)
    return "interrupted" if number == signal.SIGINT else f"ended by {number.name}"


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
    with without_garbage_collection():
        yield
        gc.freeze()


def show_error(console: Console, error: HplanError) -> None:
    """Say what went wrong and, where no path exists, the first of what is in the way."""
    console.print(f"[bold red]error[/] ({error.kind}): {escape(error.message)}", soft_wrap=True)
    for blocker in error.data.get("blockers", ())[:5]:
        low, high = blocker["slices_deg"]
        console.print(
            f"  {escape(blocker['obstacle'])} against {escape(blocker['link'])}: {blocker['cells']} border nodes, "
            f"last joint {low:g} to {high:g} deg",
            soft_wrap=True,
        )


@contextmanager
def progress_line(console: Console, *, quiet: bool, kernels: int | None = None) -> Iterator[Callable[[str], None]]:
    """A status line on the terminal, set by what this gives; none where none is wanted.

    While kernels are compiled it tells how many of about how many; where there is no terminal, by a line now and then.

    Args:
        kernels: How many are called, about; None where that is not known.
    """
    if quiet:
        yield lambda _: None
        return
    begin = told_s = time.monotonic()
    stage, of = "starting", "" if kernels is None else f" of about {kernels}"
    status = console.status(stage) if console.is_terminal else None

    def show(words: str) -> None:
        nonlocal stage
        stage = words
        if status is not None:
            status.update(words[:_WIDTH])

    def compiling(_: str, number: int) -> None:
        nonlocal told_s
        seconds = time.monotonic() - begin
        words = f"kernel {number}{of}, {seconds:.0f} s"
        if status is not None:
            status.update(f"compiling: {words}; {stage}"[:_WIDTH])
        elif time.monotonic() - told_s > _EVERY_S:
            told_s = time.monotonic()
            console.print(f"compiling, as on every first run: {words}")

    LISTENERS.append(compiling)
    try:
        with contextlib.nullcontext() if status is None else status:
            yield show
    finally:
        LISTENERS.remove(compiling)


def escape(text: object) -> str:
    """A text that stands for itself among markup."""
    from rich.markup import escape as escaped

    return escaped(str(text))


def facts_table(facts: Iterable[tuple[str, str]] = (), indent: int = 2) -> Table:
    """A table of facts, each a name and what is said of it."""
    from rich.table import Table

    table = Table.grid(padding=(0, 2, 0, indent))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for fact in facts:
        table.add_row(*fact)
    return table


def number_table(headings: Iterable[str], rows: Iterable[Iterable[str]], *, texts: Collection[str] = ()) -> Table:
    """A table of numbers with a line below its headings; columns of texts stand to the left, and may be wrapped."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for heading in headings:
        is_text = heading in texts
        table.add_column(heading, justify="left" if is_text else "right", no_wrap=not is_text)
    for row in rows:
        table.add_row(*row)
    return table


def show(console: Console, what: str, robot: str, *tables: Table) -> None:
    """Show a summary: what it is about, a scene or file, and the robot in it; then its tables."""
    console.print(f"\n[bold]{escape(what)}[/] with [bold]{escape(robot)}[/]\n")
    for table in tables:
        console.print(table)
        console.print()


def hand_out(arguments: argparse.Namespace, console: Console, report: dict[str, Any], show: Callable[[], None]) -> None:
    """Write a report where `--report` says, and print it as JSON or show a summary."""
    from hplan.planning.report import report_text, write_report

    if arguments.report is not None:
        write_report(report, arguments.report)
    if arguments.json:
        console.file.write(report_text(report))
    elif not arguments.quiet:
        show()


def risk_words(risk: dict[str, Any]) -> str:
    """How probable it is at most that a motion touches anything, who has most of it, and the estimate."""
    estimate, most = risk["estimate"], risk["shares"][:1]
    whose = "".join(f"; most of it {share['obstacle']!r}" for share in most)
    seen = f"{estimate['touching']} of {estimate['draws']:,} draws touch"
    return f"{risk['bound']:.2g} at most, asked for {risk['asked']:g}{whose}\n{seen}"


def certificate_words(verified: bool) -> str:
    """The verdict of a certificate, with markup."""
    return "[bold green]verified[/]" if verified else "[bold red]NOT VERIFIED[/]"


def uncovered_rows(names: Collection[str]) -> list[tuple[str, str]]:
    """The row about drawn links that a certificate does not cover, with markup; none if it covers all."""
    if not names:
        return []
    return [("not covered", f"[bold yellow]drawn, without a fitting collision shape: {escape(', '.join(names))}[/]")]


def percent(fraction: float) -> str:
    """A fraction in percent, without the sign; in powers of ten where it is beyond all use."""
    return f"{100.0 * fraction:{'.1f' if fraction < 1e4 else '.3g'}}"
