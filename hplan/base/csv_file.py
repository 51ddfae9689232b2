"""CSV files of numbers, with errors that name the line."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from hplan.base.arguments import decimal, file_path
from hplan.base.files import ByteBudget
from hplan.errors import InputError


@dataclass(frozen=True)
class CsvFile:
    """A CSV file whose rows are read one after the other.

    Attributes:
        path: The file.
        what: Kind of the file in messages, for example "motion".
        row_word: Kind of one row in messages, for example "row".
        first: Line number of the header.
        header: The first row; empty if the file is empty.
        rows: Iterator over the other rows, each with the number of its last line; it can be read once.
    """

    path: Path
    what: str
    row_word: str
    first: int
    header: list[str]
    rows: Iterator[tuple[int, list[str]]]

    @classmethod
    def read(cls, path: Path | str, what: str, row_word: str, *, blank: bool = False) -> CsvFile:
        """Read a file, with or without a byte order mark.

        Further arguments are the attributes of that name.

        Args:
            path: The file.
            blank: True to skip rows of blanks only.

        Raises:
            InputError: The file is missing, unreadable, too large, not UTF-8 or malformed.
        """
        path = file_path("path", path)
        # About fifteen minutes of seven joints at 250 Hz.
        text = ByteBudget(128_000_000).text(
            path, lambda reason: InputError(f"{what} file {path}: {reason}", path=str(path))
        )
        rows = _iterate_rows(path, what, text)
        if blank:
            rows = ((line, row) for line, row in rows if any(map(str.strip, row)))
        first, header = next(rows, (1, []))
        return cls(path, what, row_word, first, header, rows)

    def fault(self, line: int, reason: str) -> InputError:
        """Return the error that names the file, a line and the fault."""
        return _fault(self.path, self.what, line, reason)

    def number_rows(self, columns: Sequence[int]) -> Iterator[tuple[int, list[str], list[float]]]:
        """Iterate over the rows, checking each before yielding it.

        Args:
            columns: Indices of the required number columns.

        Yields:
            Line number, text of all columns, numbers of the required columns.

        Raises:
            InputError: The file has no rows, a row differs in length from the header, or a cell is not a finite number.
        """
        names = [self.header[column].strip() for column in columns]
        line = None
        for line, row in self.rows:
            if len(row) != len(self.header):
                raise self.fault(line, f"{len(row)} values, expected {len(self.header)}")
            yield line, row, [self._number(line, name, row[i]) for name, i in zip(names, columns, strict=True)]
        if line is None:
            raise self.fault(self.first, f"no {self.row_word}s follow the header")

    def timed_rows(self, columns: Sequence[int]) -> Iterator[tuple[int, list[str], list[float]]]:
        """Iterate over the rows; the first required column is increasing time.

        Raises:
            InputError: As `number_rows`, or time does not increase from one row to the next.
        """
        before = -math.inf
        for line, row, numbers in self.number_rows(columns):
            if not numbers[0] > before:
                name, text = self.header[columns[0]].strip(), row[columns[0]]
                raise self.fault(line, f"{name} is {text}, not later than in the {self.row_word} before")
            before = numbers[0]
            yield line, row, numbers

    def _number(self, line: int, name: str, text: str) -> float:
        value = decimal(text)
        if value is None:
            raise self.fault(line, f"{name} is {text!r}, expected a finite number")
        return value


def _iterate_rows(path: Path, what: str, text: str) -> Iterator[tuple[int, list[str]]]:
    """Iterate over the rows of a text, with their last line numbers."""
    length = 0

    # Maximum number of characters of a row.
    most_row = 1_000_000

    def lines() -> Iterator[str]:
        nonlocal length
        for line in io.StringIO(text, newline=""):
            length += len(line)
            if length > most_row:
                raise csv.Error(f"the row has more than {most_row:,} characters")
            yield line

    reader = csv.reader(lines(), strict=True)
    try:
        for row in reader:
            length = 0
            yield reader.line_num, row
    except csv.Error as error:
        raise _fault(path, what, max(reader.line_num, 1), str(error)) from error


def _fault(path: Path, what: str, line: int, reason: str) -> InputError:
    return InputError(f"{what} file {path}, line {line}: {reason}", path=str(path), line=line, reason=reason)
