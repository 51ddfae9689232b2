"""Writing a folder of files, all of them or none."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from pathlib import Path

from hplan.base.files import replacing
from hplan.errors import OutputError


def check_writable(directory: Path) -> None:
    """Make sure that files can be written into `directory`, which is created where it is missing.

    Raises:
        OutputError: They cannot.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        raise OutputError(directory, error.strerror or str(error)) from error


def write_all(directory: Path, contents: dict[str, bytes]) -> None:
    """Write all files or none: each first under a temporary name, then all moved.

    Raises:
        OutputError: They cannot be written.
    """
    with ExitStack() as files:
        for name, content in contents.items():
            files.enter_context(replacing(directory / name)).write_bytes(content)
