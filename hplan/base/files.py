"""Size-limited reading, atomic writing, protection of a command's own inputs."""

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
from hplan.base.interrupts import defer_signals
from hplan.errors import OutputError

#: Files read since `protecting_inputs` began; None outside of it.
_INPUTS: ContextVar[set[Path] | None] = ContextVar("inputs", default=None)


class ByteBudget:
    """Number of bytes that successive files may still contain."""

    def __init__(self, most: int) -> None:
        self.most = self._left = most

    def read(self, path: Path, *, is_input: bool = True) -> bytes:
        """Read a file, at most the remaining bytes even of a device.

        Args:
            path: The file.
            is_input: False for a file that the running command may replace.

        Raises:
            OSError: The file cannot be read.
            ValueError: The file is too large (the message has size and limit), or its name is invalid.
        """
        with path.open("rb") as file:
            content = file.read(self._left + 1)
        if len(content) > self._left:
            size = max(path.stat().st_size, len(content))
            before = self.most - self._left
            others = f", and the files before it {before:,}" if before else ""
            raise ValueError(f"{path} has at least {size:,} bytes{others}; at most {self.most:,} are read")
        self._left -= len(content)
        if is_input:
            note_input(path)
        return content

    def text(self, path: Path, fault: Callable[[str], Exception], *, is_input: bool = True) -> str:
        """Read a UTF-8 text file, with or without a byte order mark.

        Args:
            path: The file.
            fault: Makes the exception to raise from a reason.
            is_input: False for a file that the running command may replace.
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
    """Protect the files read inside the block from being overwritten.

    A command cannot replace its own inputs.
    """
    token = _INPUTS.set(set())
    try:
        yield
    finally:
        _INPUTS.reset(token)


def note_input(path: Path) -> None:
    """Register a file as an input of the running command."""
    noted = _INPUTS.get()
    if noted is not None:
        noted.add(path.resolve())


def inputs() -> frozenset[Path]:
    """Files that the command has read, symbolic links resolved."""
    return frozenset(_INPUTS.get() or ())


def is_file(path: Path) -> bool:
    """True if a file exists; False for an invalid name.

    Too long names and null characters are invalid.
    """
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """True if a folder exists; False for an invalid name."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def cut(name: str) -> str:
    """Shorten a name to a length that fits into a file name."""
    # Maximum number of bytes from a user's name in a file name; file systems allow 255 for the whole file name.
    return name.encode("utf-8", "replace")[:96].decode("utf-8", "ignore")


def write_text(path: Path | str, text: str) -> Path:
    """Write a text as UTF-8 with `write_bytes`.

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


#: Start and end of a comment, in HTML and in YAML.
HTML_COMMENT, YAML_COMMENT = ("<!-- ", " -->"), ("# ", "")

#: Format of reports, the value of their first key.
REPORT_FORMAT = "hplan-report/1"

#: Text of the last line of a file with its own digest.
_MARK = "written by hplan; SHA-256 of all before this line: "


def write_marked(path: Path | str, text: str, comment: tuple[str, str]) -> Path:
    """Write a text, followed by a comment with its SHA-256 (`is_marked`).

    Args:
        path: The file.
        text: The text.
        comment: Start and end of a comment.

    Raises:
        OutputError: The file cannot be written.
    """
    instance("text", text, str)
    whole = text if text.endswith("\n") else f"{text}\n"
    digest = hashlib.sha256(whole.encode("utf-8", "surrogatepass")).hexdigest()
    return write_text(path, f"{whole}{comment[0]}{_MARK}{digest}{comment[1]}\n")


def is_marked(content: bytes) -> bool:
    """True if `write_marked` wrote the content and it is unchanged."""
    text, _, last = content.rstrip(b"\n").rpartition(b"\n")
    _, mark, rest = last.partition(_MARK.encode())
    return bool(mark) and rest[:64].decode("ascii", "replace") == hashlib.sha256(text + b"\n").hexdigest()


def write_bytes(path: Path, content: bytes) -> Path:
    """Write a file atomically, via a temporary file in the same folder.

    Symbolic links are followed. An existing target that is not a regular file (a folder, a device) and an input of the
    running command are left alone. The permissions follow the umask.

    Raises:
        OutputError: The file cannot be written.
    """
    with replace_file(path) as temporary, temporary.open("wb") as stream:
        stream.write(content)
    return path


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Yield a temporary file that replaces `path` after the block.

    It is in the same folder, and deleted if the block fails.

    Raises:
        OutputError: The file cannot be written.
    """
    temporary: Path | None = None
    try:
        target = path.resolve()
        check_replaceable(target, path)
        new = target.with_name(f".hplan-{secrets.token_hex(8)}")
        with defer_signals():
            os.close(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
            temporary = new
        yield new
        with defer_signals():
            new.replace(target)
            temporary = None
    except (OSError, RuntimeError) as error:  # RuntimeError: circular links, before Python 3.13
        raise OutputError(path, getattr(error, "strerror", None) or str(error)) from error
    except ValueError as error:
        raise OutputError(path, f"its name cannot be written: {error}") from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def check_replaceable(target: Path, path: Path) -> None:
    """Refuse to replace an input of the command or a non-regular file.

    Raises:
        OutputError: `target` is a folder, a device or an input; the message names `path`.
    """
    if target.exists() and not target.is_file():
        raise OutputError(path, "it is a folder" if target.is_dir() else "it is not a regular file")
    if target.resolve() in inputs():
        raise OutputError(path, "it is an input and would be replaced; choose another file")


def prepare_folder(folder: Path) -> None:
    """Create a folder and check, before any work, that it is writable.

    Raises:
        OutputError: The path is a file, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".hplan-{secrets.token_hex(8)}"
        with defer_signals():
            probe.touch()
            probe.unlink()
    except FileExistsError as error:
        raise OutputError(folder, "it is a file, not a folder") from error
    except OSError as error:
        raise OutputError(folder, error.strerror or str(error)) from error


@contextmanager
def new_folder(path: Path) -> Iterator[None]:
    """Create a folder (`prepare_folder`); remove it after an error if it is new and empty."""
    is_new = not path.exists()
    prepare_folder(path)
    try:
        yield
    except BaseException:
        if is_new:
            with contextlib.suppress(OSError):  # it is not empty
                path.rmdir()
        raise
