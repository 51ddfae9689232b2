"""Reading files up to a size, and writing them whole or not at all, never over what the same command has read."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from hplan.base.arguments import file_path, instance
from hplan.base.interrupts import uninterrupted
from hplan.errors import OutputError

#: Files that were read since `protecting_inputs` began; None where none are noted.
_INPUTS: ContextVar[set[Path] | None] = ContextVar("inputs", default=None)


class ByteBudget:
    """Bytes that files may still have, one after the other."""

    def __init__(self, most: int) -> None:
        self.most = self._left = most

    def read(self, path: Path, *, is_input: bool = True) -> bytes:
        """Read a file; of one that is too large, or a device without end, not more than is left.

        Args:
            is_input: False for what the command that runs may replace all the same.

        Raises:
            OSError: It cannot be read.
            ValueError: It is too large, or its name cannot be that of a file; says the size and the limit.
        """
        with path.open("rb") as file:
            content = file.read(self._left + 1)
        if len(content) > self._left:
            size = max(path.stat().st_size, len(content))
            before = self.most - self._left
            others = f", and the files before it {before:,}" if before else ""
            raise ValueError(f"{path} has {size:,} bytes or more{others}; at most {self.most:,} are read")
        self._left -= len(content)
        if is_input:
            note_input(path)
        return content

    def text(self, path: Path, fault: Callable[[str], Exception], *, is_input: bool = True) -> str:
        """Read a file of UTF-8 text, with or without a byte order mark.

        Args:
            fault: The error to raise, for a reason.
            is_input: As for `read`.
        """
        try:
            return self.read(path, is_input=is_input).decode("utf-8-sig")
        except OSError as error:
            raise fault(error.strerror or str(error)) from error
        except UnicodeDecodeError as error:
            raise fault("it is not UTF-8 text") from error
        except ValueError as error:
            raise fault(str(error)) from error


@contextmanager
def protecting_inputs() -> Iterator[None]:
    """Inside, no file is written over that was read inside: a command replaces none of its inputs."""
    token = _INPUTS.set(set())
    try:
        yield
    finally:
        _INPUTS.reset(token)


def note_input(path: Path) -> None:
    """Take a file for an input of the command that runs."""
    noted = _INPUTS.get()
    if noted is not None:
        noted.add(path.resolve())


def inputs() -> frozenset[Path]:
    """The files that the command has read, links followed."""
    return frozenset(_INPUTS.get() or ())


def is_file(path: Path) -> bool:
    """True if a file stands there; False for what cannot be the name of one (too long, a null character)."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """True if a folder stands there; False for what cannot be the name of one."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def cut(name: str) -> str:
    """A name, cut where it is too long to be part of a file's."""
    # Most bytes that a part of a file's name has which follows from a name of the user's; file systems take 255 in all.
    return name.encode("utf-8", "replace")[:96].decode("utf-8", "ignore")


def write_text(path: Path | str, text: str) -> Path:
    """Write a text as UTF-8, as `write_bytes`.

    Raises:
        OutputError: The file cannot be written.
    """
    path = Path(path) if isinstance(path, str | os.PathLike) else file_path("path", path)
    instance("text", text, str)
    try:
        content = text.encode("utf-8")
    except ValueError as error:
        raise OutputError(path, f"its text cannot be written: {error}") from error
    return write_bytes(path, content)


#: How comments begin and end, in pages and in YAML.
HTML_COMMENT, YAML_COMMENT = ("<!-- ", " -->"), ("# ", "")

#: The format of reports, their first key.
REPORT_FORMAT = "hplan-report/1"

#: The last line of a text that knows its own digest.
_MARK = "written by hplan; SHA-256 of all before this line: "


def write_marked(path: Path | str, text: str, comment: tuple[str, str]) -> Path:
    """Write a text, as `write_text`, and last a comment with its SHA-256, by which hplan knows it again (`is_marked`).

    Args:
        comment: How a comment begins and ends.

    Raises:
        OutputError: The file cannot be written.
    """
    instance("text", text, str)
    whole = text if text.endswith("\n") else f"{text}\n"
    digest = hashlib.sha256(whole.encode("utf-8", "surrogatepass")).hexdigest()
    return write_text(path, f"{whole}{comment[0]}{_MARK}{digest}{comment[1]}\n")


def is_marked(content: bytes) -> bool:
    """True if a file was written by `write_marked`, and not changed since."""
    text, _, last = content.rstrip(b"\n").rpartition(b"\n")
    _, mark, rest = last.partition(_MARK.encode())
    return bool(mark) and rest[:64].decode("ascii", "replace") == hashlib.sha256(text + b"\n").hexdigest()


def write_bytes(path: Path, content: bytes) -> Path:
    """Write a file by a temporary one next to it, so that nothing half-written is ever seen.

    A link is followed; what exists and is no ordinary file (a folder, a device) is left alone, and so is an input of
    the command that runs. Who may read it follows the umask.

    Raises:
        OutputError: The file cannot be written.
    """
    with replacing(path) as temporary, temporary.open("wb") as stream:
        stream.write(content)
    return path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new file beside `path` that takes its place when the block ends, and is gone where that fails.

    Raises:
        OutputError: The file cannot be written.
    """
    temporary: Path | None = None
    try:
        target = path.resolve()
        check_replaceable(target, path)
        new = target.with_name(f".hplan-{secrets.token_hex(8)}")
        with uninterrupted():
            os.close(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
            temporary = new
        yield new
        with uninterrupted():
            new.replace(target)
            temporary = None
    except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle, before Python 3.13
        raise OutputError(path, getattr(error, "strerror", None) or str(error)) from error
    except ValueError as error:
        raise OutputError(path, f"its name cannot be written: {error}") from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def check_replaceable(target: Path, path: Path) -> None:
    """Refuse to put a file where something else than a file is, or an input of the command.

    Raises:
        OutputError: There is; names it as `path`.
    """
    if target.exists() and not target.is_file():
        raise OutputError(path, "it is a folder" if target.is_dir() else "it is no ordinary file")
    if target.resolve() in inputs():
        raise OutputError(path, "it is read, and would be replaced; name another file")
