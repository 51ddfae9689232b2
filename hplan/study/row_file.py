"""CSV files of result rows that interrupted runs resume from."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from hplan.base.csv_file import CsvFile
from hplan.base.interrupts import defer_signals
from hplan.errors import OutputError

_Row = TypeVar("_Row")

#: Parsers of the field types of a row.
_PARSERS: dict[str, Callable[[str], Any]] = {
    "float": float,
    "int": int,
    "str": str,
    "bool": lambda text: {"True": True, "False": False}[text],
    "float | None": lambda text: float(text) if text else None,
    "dict[str, int]": json.loads,
}


@contextmanager
def open_rows(path: Path | None, kind: type[_Row], job: str) -> Iterator[tuple[list[_Row], Callable[[_Row], None]]]:
    """Yield a file's rows, and a function that appends one durably.

    The file is locked against other writers. An incomplete last row, left by an interrupted run, is cut off.

    Args:
        path: The file, created if it does not exist; None for no file.
        kind: Dataclass of the rows, whose fields are the columns.
        job: Name of the job in messages, for example "study".

    Raises:
        InputError: The file holds other rows.
        OutputError: The file cannot be written, or another process writes to it.
    """
    if path is None:
        yield [], lambda _: None
        return
    columns = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    is_new, kept = not path.exists(), 0
    with ExitStack() as stack:
        try:
            file = stack.enter_context(path.open("ab+"))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _check_header(path, file, columns, job)
            _cut_incomplete_row(file)
            if not file.tell():
                _append(file, columns)
        except BlockingIOError as error:
            raise OutputError(path, f"another {job} is writing to it") from error
        except OSError as error:
            raise OutputError(path, error.strerror or str(error)) from error

        def keep(row: _Row) -> None:
            nonlocal kept
            kept += 1
            try:
                _append(file, [_format_cell(getattr(row, name)) for name in columns])
            except OSError as error:
                raise OutputError(path, error.strerror or str(error)) from error

        try:
            yield _read_rows(path, kind, columns, job), keep
        except BaseException:
            if is_new and not kept:
                path.unlink(missing_ok=True)
            raise


def _check_header(path: Path, file: BinaryIO, columns: Sequence[str], job: str) -> None:
    """Refuse a file with another header, and leave it unchanged.

    An incomplete header, from an interrupted run, is accepted.
    """
    file.seek(0)
    header, line = f"{','.join(columns)}\n".encode(), file.readline()
    if not header.startswith(line):
        raise CsvFile.read(path, "row", "row").fault(
            1, f"it is not the table of a {job}; expected the columns {','.join(columns)}"
        )


def _cut_incomplete_row(file: BinaryIO) -> None:
    file.seek(0)
    whole = file.read().rfind(b"\n") + 1
    file.truncate(whole)
    file.seek(whole)


def _append(file: BinaryIO, cells: Sequence[str]) -> None:
    """Append a row in one write and sync it to disk."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(cells)
    with defer_signals():
        file.write(line.getvalue().encode())
        file.flush()
        os.fsync(file.fileno())


def _format_cell(value: Any) -> str:
    if isinstance(value, dict):
        return json.dumps(value)
    return "" if value is None else " ".join(value.split()) if isinstance(value, str) else repr(value)


def _read_rows(path: Path, kind: type[_Row], columns: Sequence[str], job: str) -> list[_Row]:
    file = CsvFile.read(path, "row", "row")
    if list(file.header) != list(columns):
        raise file.fault(1, f"it is not the table of a {job}; expected the columns {','.join(columns)}")
    parsers = [_PARSERS[str(field.type)] for field in fields(kind)]  # type: ignore[arg-type]
    rows = []
    for line, cells in file.rows:
        try:
            rows.append(kind(*(parse(cell) for parse, cell in zip(parsers, cells, strict=True))))
        except (KeyError, ValueError) as error:
            raise file.fault(line, f"it is not a row of a {job}: {error}") from error
    return rows
