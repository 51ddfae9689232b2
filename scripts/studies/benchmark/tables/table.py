"""A table of text, and what the tables of several sets share: numbers as text, and scenes that failed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

#: What stands where there is no number.
NONE = "-"

#: What stands in place of a planner that is missing.
NOT_INSTALLED = "not installed"

#: Failed scenes that are listed, at most.
_LISTED = 20


@dataclass(frozen=True)
class Table:
    """A table of text.

    Attributes:
        title: What it shows.
        columns: Headings; the first column holds names, the others numbers.
        rows: Cells.
        note: What one must know to read it.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def number(value: float | None, digits: int = 3) -> str:
    """A number as text.

    Args:
        value: The number, if there is one.
        digits: Significant digits; those before the decimal point are all kept.

    Returns:
        The number, or `NONE` where there is none or it is not finite.
    """
    if value is None or not math.isfinite(value):
        return NONE
    if value != 0.0 and abs(value) >= 10.0 ** (digits - 1):
        return f"{value:,.0f}"
    return f"{value:.{digits}g}"


def times(value: float) -> str:
    """A ratio as text, such as `3.2 x`; `NONE` where it is not finite."""
    return f"{number(value)} x" if math.isfinite(value) else NONE


def percent(part: float, whole: float) -> str:
    """A part of a whole as text, in whole per cent."""
    return f"{100.0 * part / whole:.0f} %"


def failures(where: str, failed: Sequence[dict[str, Any]]) -> list[Table]:
    """The table of the scenes that failed.

    Args:
        where: Name of the set, for the title.
        failed: What is known of each scene that failed.

    Returns:
        One table with the first scenes of them, or none where no scene failed.
    """
    if not failed:
        return []
    rows = tuple(
        (str(f["number"]), f["kind"], number(f.get("spare_clearance_mm")), f["message"][:120]) for f in failed[:_LISTED]
    )
    columns = ("scene", "error", "clearance at start or goal [mm]", "message")
    return [Table(f"{where}: scenes that failed ({len(failed)})", columns, rows)]
