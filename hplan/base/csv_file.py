"""CSV files of numbers: rows of text in memory, numbers out of them, and faults that name the line."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from hplan.base.arguments import decimal, file_path, is_float
from hplan.errors import InputError


@dataclass(frozen=True)
class CsvFile:
    """A CSV, read whole.

    Attributes:
        path: The file.
        what: What it is, for messages: "motion".
        row_word: What one of its rows is, for messages: "row".
        header: Its first row; empty where there is none.
        rows: The others, each with the number of its (last) line.
    """

    path: Path
    what: str
    row_word: str
    header: list[str]
    rows: list[tuple[int, list[str]]]

    @classmethod
    def read(cls, path: Path | str, what: str, row_word: str) -> CsvFile:
        """Read a file, with or without a byte order mark.

        Raises:
            InputError: Missing or unreadable file, not UTF-8, or malformed.
        """
        path = file_path("path", path)
        try:
            with path.open(encoding="utf-8-sig", newline="") as stream:
                reader = csv.reader(stream, strict=True)
                rows = [(reader.line_num, row) for row in reader]
        except OSError as error:
            raise InputError(f"{what} file {path}: {error.strerror}", path=str(path)) from error
        except UnicodeDecodeError as error:
            raise InputError(f"{what} file {path}: it is not UTF-8 text", path=str(path)) from error
        except csv.Error as error:
            raise _fault(path, what, reader.line_num, str(error)) from error
        return cls(path, what, row_word, rows[0][1] if rows else [], rows[1:])

    def fault(self, line: int, reason: str) -> InputError:
        """The error that names the file, a line and what is wrong there."""
        return _fault(self.path, self.what, line, reason)

    def number_rows(self, columns: Sequence[int]) -> Iterator[tuple[int, list[str], list[float]]]:
        """The rows one after the other, each checked before it is handed out.

        Args:
            columns: Which columns hold the numbers wanted.

        Yields:
            The row's line, the texts in all its columns and the numbers in those wanted.

        Raises:
            InputError: No row, a row of another length than the header, a cell that is no finite number.
        """
        if not self.rows:
            raise self.fault(1, f"no {self.row_word}s follow the header")
        names = [self.header[column].strip() for column in columns]
        for line, row in self.rows:
            if len(row) != len(self.header):
                raise self.fault(line, f"{len(row)} values, expected {len(self.header)}")
            yield line, row, [self._number(line, name, row[i]) for name, i in zip(names, columns, strict=True)]

    def timed_rows(self, columns: Sequence[int]) -> Iterator[tuple[int, list[str], list[float]]]:
        """The rows one after the other, each checked before it is handed out.

        Args:
            columns: Which columns hold the numbers wanted; the first of them is time.

        Yields:
            The row's line, the texts in its columns and their numbers.

        Raises:
            InputError: No row, a row of another length than the header, a cell that is no finite number, time no
                later than in the row before.
        """
        before = -math.inf
        for line, row, numbers in self.number_rows(columns):
            texts = [row[column] for column in columns]
            if not numbers[0] > before:
                name = self.header[columns[0]].strip()
                raise self.fault(line, f"{name} is {texts[0]}, no later than in the {self.row_word} before")
            before = numbers[0]
            yield line, texts, numbers

    def _number(self, line: int, name: str, text: str) -> float:
        value = decimal(text)
        if value is None:
            raise self.fault(line, f"{name} is {text!r}, expected a {'finite ' if is_float(text) else ''}number")
        return value


def _fault(path: Path, what: str, line: int, reason: str) -> InputError:
    return InputError(f"{what} file {path}, line {line}: {reason}", path=str(path), line=line, reason=reason)
