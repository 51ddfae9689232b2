"""Writing files whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from hplan.base.arguments import file_path, instance
from hplan.errors import OutputError


def write_text(path: Path | str, text: str) -> Path:
    """Write a file by a temporary one next to it, so that nothing half-written is ever seen.

    A link is followed; what exists and is no ordinary file (a folder, a device) is left alone.

    Raises:
        OutputError: The file cannot be written.
    """
    path = Path(path) if isinstance(path, str | os.PathLike) else file_path("path", path)
    instance("text", text, str)
    temporary: Path | None = None
    try:
        target = path.resolve()
        check_replaceable(target, path)
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=".hplan-")
        temporary = Path(name)
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as stream:
            stream.write(text)
        temporary.chmod(0o644)
        temporary.replace(target)
        temporary = None
    except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle, before Python 3.13
        raise OutputError(path, getattr(error, "strerror", None) or str(error)) from error
    except ValueError as error:
        raise OutputError(path, f"its text or its name cannot be written: {error}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
    return path


def check_replaceable(target: Path, path: Path) -> None:
    """Refuse to put a file where something else than a file is.

    Raises:
        OutputError: There is; names it as `path`.
    """
    if target.exists() and not target.is_file():
        raise OutputError(path, "it is a folder" if target.is_dir() else "it is no ordinary file")
