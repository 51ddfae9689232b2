"""Collects the faults of a robot file for one error."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hplan.errors import RobotFileError


class Faults:
    """Faults of one robot file, and its harmless faults, which were mended.

    Attributes:
        path: The file.
        repairs: Whether faults that have an obvious remedy are mended, too: decimal commas, misspelled names.
        found: Faults that prevent reading, each with its line.
        mended: Faults that no motion depends on, and what was done about each.
    """

    def __init__(self, path: Path, *, repairs: bool = False) -> None:
        self.path = path
        self.repairs = repairs
        self.found: list[str] = []
        self.mended: list[str] = []

    @contextmanager
    def collect(self) -> Iterator[None]:
        """Context in which a `RobotFileError` is kept instead of raised."""
        try:
            yield
        except RobotFileError as error:
            self.add(*error.faults)

    def add(self, *faults: str) -> None:
        """Add faults; one that is known already is not added again."""
        self.found += [fault for fault in faults if fault not in self.found]

    def mend(self, what: str) -> None:
        """Add a harmless fault, once."""
        if what not in self.mended:
            self.mended.append(what)

    def check(self) -> None:
        """Check that no fault was found.

        Raises:
            RobotFileError: There are faults; names them all, in the order of their lines.
        """
        if self.found:
            raise RobotFileError(self.path, *sorted(self.found, key=lambda fault: split_line(fault)[0]))


def split_line(fault: str) -> tuple[int, str]:
    """Line number of a fault, and the fault without it.

    The number is 0 without one.

    Examples:
        >>> split_line("line 12: joint 'elbow': it has no <limit>")
        (12, "joint 'elbow': it has no <limit>")
        >>> split_line("it has no moving joint")
        (0, 'it has no moving joint')
    """
    found = re.match(r"line (\d+): ", fault)
    return (0, fault) if found is None else (int(found[1]), fault[found.end() :])
