"""Ownership of files: hplan replaces only files that it has written itself.

A report names the files that were written with it, and their SHA-256. Pages and scenes carry the SHA-256 of their own
text. A CSV without a report belongs to hplan if hplan would write its trajectory with identical bytes.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Final

from hplan.base.files import REPORT_FORMAT, ByteBudget, is_marked, protecting_inputs
from hplan.errors import HplanError, OutputError

#: Reports of a finished job: one motion, a tour, a tree row, a study.
REPORT: Final = "report.json"
TOUR_REPORT: Final = "tour.json"
ROW_REPORT: Final = "row.json"
STUDY_REPORT: Final = "study.json"

#: Report key of the format.
FORMAT_KEY: Final = "format"

#: Report key of the SHA-256 of each file that was written with the report.
WRITTEN: Final = "written"

#: Maximum size of a file that is read to determine its owner [bytes].
_MOST_FILE_BYTES: Final = 256_000_000

#: Reason in the error about a file that is not replaced.
NOT_OURS: Final = "hplan did not write it, or it was changed since; choose another file, or replace it with --force"


def check_own(path: Path, *, force: bool) -> None:
    """Check that a file may be replaced.

    Args:
        path: The file; it may be missing.
        force: Allow replacing any file.

    Raises:
        OutputError: hplan has not written the file, or the file was changed since.
    """
    if not force and path.is_file() and not is_own(path):
        raise OutputError(path, NOT_OURS)


def is_own(path: Path) -> bool:
    """True if hplan wrote the file and its content is unchanged."""
    try:
        content = ByteBudget(_MOST_FILE_BYTES).read(path, is_input=False)
    except (OSError, ValueError):
        return False
    if not content:
        return False
    digest, recorded = hashlib.sha256(content).hexdigest(), recorded_digests(path.parent).get(path.name)
    if digest == recorded:
        return True
    if path.suffix == ".json":
        return _is_report(_parse_json_object(content))
    if path.suffix == ".csv" and recorded is None:
        return _is_trajectory(path, content)
    return is_marked(content)


def recorded_digests(folder: Path) -> dict[str, str]:
    """SHA-256 of a folder's files by name, according to its reports."""
    found: dict[str, str] = {}
    for name in (REPORT, TOUR_REPORT, ROW_REPORT, STUDY_REPORT):
        try:
            report = _parse_json_object(ByteBudget(_MOST_FILE_BYTES).read(folder / name, is_input=False))
        except (OSError, ValueError):
            continue
        written = report.get(WRITTEN)
        if _is_report(report) and isinstance(written, dict):
            found |= {str(file): str(digest) for file, digest in written.items()}
    return found


def digests_of(files: list[Path]) -> dict[str, str]:
    """SHA-256 of files by name."""
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def _parse_json_object(content: bytes) -> dict[str, Any]:
    """Parse a JSON object; empty if the content is anything else."""
    try:
        found = json.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _is_report(report: dict[str, Any]) -> bool:
    """True for a report of hplan; early versions wrote no format key."""
    if FORMAT_KEY in report:
        return bool(report[FORMAT_KEY] == REPORT_FORMAT)
    versions = report.get("versions")
    return "status" in report and isinstance(versions, dict) and "hplan" in versions


def _is_trajectory(path: Path, content: bytes) -> bool:
    """True if hplan would write this CSV's trajectory with identical bytes."""
    from hplan.trajectory.trajectory import csv_text, read_csv

    try:
        with protecting_inputs():  # so that the file does not count as an input of the command
            return csv_text(read_csv(path)).encode() == content
    except (HplanError, ValueError):
        return False
