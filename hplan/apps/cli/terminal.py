"""Terminal output of a command: progress, tables, errors, signals, exit status.

Closed and full outputs do not end a command.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import math
import os
import signal
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from hplan.apps.cli.job_folder import reporting_interrupts
from hplan.base.files import protecting_inputs
from hplan.base.interrupts import INTERRUPTS, handling_signals, signal_of
from hplan.base.kernel_turns import LISTENERS
from hplan.base.lazy_import import without_garbage_collection
from hplan.base.units import at_most_deg
from hplan.errors import HplanError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from hplan.tour.tour import Unreached

#: Exit status of a failed check.
FAILED = 5

#: Interval of the progress lines without a terminal [s], and maximum length of the status line on one [characters].
_EVERY_S, _WIDTH = 10.0, 76


class _Terminal:
    """An output stream whose faults do not end the command.

    Characters that the encoding cannot represent are escaped; after the first write error all output is dropped. This
    loses nothing, since results are in files and in the exit status. All other attributes are the stream's own.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        #: The first error; None if all writes succeeded.
        self.fault: OSError | ValueError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text, escaping characters that the encoding lacks."""
        encoding = self._stream.encoding or "utf-8"
        try:
            text.encode(encoding)
        except UnicodeEncodeError:
            text = text.encode(encoding, "backslashreplace").decode(encoding)
        self._try(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush the stream."""
        self._try(self._stream.flush)

    def _try(self, action: Callable[[], Any]) -> None:
        if self.fault is not None:
            return
        try:
            action()
        except (OSError, ValueError) as error:  # ValueError: the stream is closed
            self.fault = error
            with contextlib.suppress(OSError, ValueError):
                # Python flushes the stream's buffer at exit, which would fail again.
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())


def run_command(command: Callable[[Console, Console], int]) -> int:
    """Run a command and print the error that ends it.

    Args:
        command: Takes the consoles for results and for errors; returns the exit status.

    Returns:
        The exit status: the command's, the error's, or 128 plus the number of the signal that ended it (130 after
        Ctrl-C). It does not depend on whether the terminal can be written.
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
    """Message about a command ended by a signal."""
    number = signal_of(error)
    return "interrupted" if number == signal.SIGINT else f"ended by {number.name}"


def _open_what_is_closed() -> None:
    """Open closed standard streams on the null device.

    Otherwise the next file that is opened would get their file descriptor, and output would go into that file.
    """
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
    """Context that prints hplan's own warnings without their code location."""

    def show(message: Any, category: type[Warning], *place: Any, **more: Any) -> None:
        if category.__module__.startswith("hplan."):
            console.print(f"warning: {message}", markup=False, soft_wrap=True)
        else:
            otherwise(message, category, *place, **more)

    with warnings.catch_warnings():
        otherwise, warnings.showwarning = warnings.showwarning, show
        yield


@contextmanager
def pause_garbage_collection() -> Iterator[None]:
    """Context for imports that keeps imported objects out of garbage collection.

    Collection is off inside the block; afterwards the objects are frozen (`gc.freeze`), so later collections skip them.
    """
    with without_garbage_collection():
        yield
        gc.freeze()


def show_error(console: Console, error: HplanError) -> None:
    """Print an error and, if no path exists, the first five blockers."""
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
    """Context with a status line; yields the function that sets its text.

    While kernels are being compiled, the line counts them. Without a terminal, this count is printed as a line every
    `_EVERY_S` seconds.

    Args:
        console: Console of the status line.
        quiet: Print nothing.
        kernels: Approximate number of kernels that the command calls; None if unknown.
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

    def show_compiling(_: str, number: int) -> None:
        nonlocal told_s
        seconds = time.monotonic() - begin
        words = f"kernel {number}{of}, {seconds:.0f} s"
        if status is not None:
            status.update(f"compiling: {words}; {stage}"[:_WIDTH])
        elif time.monotonic() - told_s > _EVERY_S:
            told_s = time.monotonic()
            console.print(f"compiling (first run only): {words}")

    LISTENERS.append(show_compiling)
    try:
        with contextlib.nullcontext() if status is None else status:
            yield show
    finally:
        LISTENERS.remove(show_compiling)


def escape(text: object) -> str:
    """Escape a text so that rich prints it verbatim."""
    from rich.markup import escape as escaped

    return escaped(str(text))


def facts_table(facts: Iterable[tuple[str, str]] = (), indent: int = 2) -> Table:
    """Create a table of (name, value) rows."""
    from rich.table import Table

    table = Table.grid(padding=(0, 2, 0, indent))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for fact in facts:
        table.add_row(*fact)
    return table


def number_table(headings: Iterable[str], rows: Iterable[Iterable[str]], *, texts: Collection[str] = ()) -> Table:
    """Create a table of numbers with a line below its headings.

    Args:
        headings: Headings of the columns.
        rows: Cells of each row, as text.
        texts: Headings of text columns, which are left-aligned and may wrap.
    """
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for heading in headings:
        is_text = heading in texts
        table.add_column(heading, justify="left" if is_text else "right", no_wrap=not is_text)
    for row in rows:
        table.add_row(*row)
    return table


def unpicked_table(unreached: Sequence[Unreached]) -> list[Table]:
    """Table of the fruits that are not picked; none without such fruits.

    Without an obstacle, the first fruit of each reason has the message of its error.
    """
    from hplan.planning.failures import REASON_WORDS

    lines, told = list[tuple[str, str, str]](), set[str | None]()
    for item in unreached:
        detail = item.obstacle or ("" if item.reason in told else item.error.message)
        told |= set() if item.obstacle else {item.reason}
        words = "left out" if item.reason is None else REASON_WORDS[item.reason]
        lines.append((escape(item.fruit), f"[yellow]{words}[/]", escape(detail)))
    headings = "not picked", "reason", "obstacle or detail"
    return [number_table(headings, lines, texts=headings)] if lines else []


def unpicked_facts(reasons: Mapping[str, int], obstacles: Mapping[str, int]) -> list[tuple[str, str]]:
    """Summary rows: numbers of fruits by reason, and the most frequent obstacles.

    Obstacles that differ only in their number, such as branches, are counted together.
    """
    from hplan.planning.failures import REASON_WORDS

    told = ", ".join(f"{count} {REASON_WORDS.get(reason, 'left out')}" for reason, count in reasons.items() if count)
    kinds = Counter[str]()
    for name, count in obstacles.items():
        kinds[name.rstrip(" 0123456789") or name] += count
    most = ", ".join(f"{escape(kind)} ({count})" for kind, count in kinds.most_common(3))
    most += "".join(f"; {escape(name)} alone {count}" for name, count in [*obstacles.items()][:1] if name not in kinds)
    return [(name, text) for name, text in (("[yellow]not picked[/]", told), ("most often by", most)) if text]


def show(console: Console, what: str, robot: str, *tables: Table) -> None:
    """Print a summary: title line and tables.

    Args:
        console: Console for results.
        what: Name of the scene or file.
        robot: Name of the robot.
        tables: The tables, printed in this order.
    """
    console.print(f"\n[bold]{escape(what)}[/] with [bold]{escape(robot)}[/]\n")
    for table in tables:
        console.print(table)
        console.print()


def hand_out(arguments: argparse.Namespace, console: Console, report: dict[str, Any], show: Callable[[], None]) -> None:
    """Write the report to `--report`; print it as JSON or a summary."""
    from hplan.planning.report import report_text, write_report

    if arguments.report is not None:
        write_report(report, arguments.report)
    if arguments.json:
        console.file.write(report_text(report))
    elif not arguments.quiet:
        show()


def risk_words(risk: dict[str, Any]) -> str:
    """Words for the collision risk of a motion.

    They give the upper bound on the probability of contact, the obstacle with the largest share of it, and the
    Monte Carlo estimate.
    """
    estimate, most = risk["estimate"], risk["shares"][:1]
    whose = "".join(f"; the largest share is that of {share['obstacle']!r}" for share in most)
    seen = f"{estimate['touching']} of {estimate['draws']:,} draws touch"
    return f"at most {risk['bound']:.2g}, allowed {risk['asked']:g}{whose}\n{seen}"


def describe_certificate(verified: bool) -> str:
    """The verdict of a certificate, with markup."""
    return "[bold green]verified[/]" if verified else "[bold red]NOT VERIFIED[/]"


def uncovered_rows(names: Collection[str]) -> list[tuple[str, str]]:
    """Summary row of drawn links that the certificate does not cover.

    The list is empty if all links are covered. The words have markup.
    """
    if not names:
        return []
    return [
        ("not covered", f"[bold yellow]drawn, but without a matching collision shape: {escape(', '.join(names))}[/]")
    ]


def held_rows(proof: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Summary row of the objects that the arm holds, by a certificate of a report; empty without any."""
    if "attached" not in proof:
        return []
    held = ", ".join(f"{escape(item['name'])} {item['mass_kg']:g} kg" for item in proof["attached"])
    return [("holds", held)]


def tilt_words(proof: dict[str, Any]) -> str:
    """Tilt of a tool that has to stay upright, from the certificate in a report."""
    bound, allowed = proof["bound_deg"], f"allowed: {proof['max_tilt_deg']:g} deg"
    if bound is None:
        return f"not bounded; {allowed}"
    return f"{at_most_deg(math.radians(bound))} deg or less from upright, proved for all times; {allowed}"


def percent(fraction: float) -> str:
    """Format a fraction in percent, without the sign.

    It has one decimal; from 1e4 on it has three significant digits.
    """
    return f"{100.0 * fraction:{'.1f' if fraction < 1e4 else '.3g'}}"
