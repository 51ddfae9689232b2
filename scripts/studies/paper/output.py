"""Writing a folder of files, all of them or none."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

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
    """Write all files or none: each first under a temporary name, then all renamed.

    Raises:
        OutputError: They cannot be written.
    """
    staged: list[tuple[Path, Path]] = []
    try:
        for name, content in contents.items():
            handle, temporary = tempfile.mkstemp(dir=directory, prefix=f".{name}.")
            staged.append((Path(temporary), directory / name))
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
            Path(temporary).chmod(0o644)
        for temporary_path, target in staged:
            temporary_path.replace(target)
    except OSError as error:
        raise OutputError(directory, error.strerror or str(error)) from error
    finally:
        for temporary_path, _ in staged:
            temporary_path.unlink(missing_ok=True)
