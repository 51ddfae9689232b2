"""Files that are written: whole or not at all."""

from __future__ import annotations

import os
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from hplan.base.files import write_text
from hplan.errors import OutputError


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_replaces_a_file(tmp_path):
    (tmp_path / "a.txt").write_text("before, and longer")
    write_text(str(tmp_path / "a.txt"), "after")
    assert (tmp_path / "a.txt").read_text() == "after"
    assert names(tmp_path) == ["a.txt"]


def test_follows_a_link(tmp_path):
    (tmp_path / "target").write_text("before")
    (tmp_path / "link").symlink_to("target")
    write_text(tmp_path / "link", "after")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "after"


@pytest.mark.parametrize(("make", "reason"), [(Path.mkdir, "it is a folder"), (os.mkfifo, "not a regular file")])
def test_folder_or_pipe_is_left_alone(make, reason, tmp_path):
    make(tmp_path / "a.txt")
    with pytest.raises(OutputError, match=reason):
        write_text(tmp_path / "a.txt", "text")
    assert names(tmp_path) == ["a.txt"]
    assert not (tmp_path / "a.txt").is_file()


def test_text_that_cannot_be_encoded_leaves_the_old_file(tmp_path):
    write_text(tmp_path / "a.txt", "before")
    with pytest.raises(OutputError, match="cannot be written"):
        write_text(tmp_path / "a.txt", "half a character: \ud800")
    assert (tmp_path / "a.txt").read_text() == "before"
    assert names(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_failure_while_writing_leaves_the_old_file(tmp_path, monkeypatch, fault):
    write_text(tmp_path / "a.txt", "before")

    def fail(*_):
        raise fault

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises((OutputError, KeyboardInterrupt)) as caught:
        write_text(tmp_path / "a.txt", "after")
    assert isinstance(caught.value, KeyboardInterrupt) or "No space left on device" in str(caught.value)
    assert (tmp_path / "a.txt").read_text() == "before"
    assert names(tmp_path) == ["a.txt"]


@contextmanager
def without_privileges():
    """Drop root's privileges inside the block: root may write anywhere."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_read_only_folder():
    with tempfile.TemporaryDirectory() as name:  # others may not enter pytest's own folders
        folder = Path(name)
        folder.chmod(0o555)
        with without_privileges(), pytest.raises(OutputError, match="Permission denied"):
            write_text(folder / "a.txt", "text")
        assert names(folder) == []
        folder.chmod(0o755)
