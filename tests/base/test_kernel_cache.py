"""Compiled kernels on disk: whatever is the matter with them, programs run, and say so once."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

KERNELS = """
from hplan.base.kernels import inlined, kernel

@inlined
def half(x):
    return 0.5 * x

@kernel
def double(x):
    return 4.0 * half(x)

@kernel
def triple(x):
    return 3.0 * x
"""

USE = """
import kernels
from hplan.base.kernels import can_be_kept, is_kept
print(is_kept(kernels.double), can_be_kept(kernels.double), kernels.double(2.0), kernels.triple(2.0))
"""

#: Nowhere to keep anything: neither a home nor a cache of the user's can be made inside a device.
NOWHERE = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null/cache"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a module of kernels."""
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "kernels.py").write_text(KERNELS)
    return tmp_path / "here"


def run(folder: Path, code: str = USE, **environment: str) -> tuple[str, str]:
    """What a program says on its two outputs; it must succeed."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA", "XDG"))}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        env={**inherited, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1", **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip(), done.stderr


def test_kept_from_the_first_run_on(folder: Path) -> None:
    assert run(folder) == ("False True 4.0 6.0", "")
    assert run(folder) == ("True True 4.0 6.0", "")


def test_a_copy_that_keeps_times_is_no_first_run(folder: Path, tmp_path: Path) -> None:
    """The sources' change times, of now, are later than all times in the copy."""
    for file in folder.rglob("*"):
        os.utime(file, (1e9, 1e9))
    run(folder)
    for file in folder.rglob("*.nb?"):
        os.utime(file, (1e9 + 100.0, 1e9 + 100.0))
    copy = shutil.copytree(folder, tmp_path / "there", copy_function=shutil.copy2)
    assert run(copy) == ("True True 4.0 6.0", "")


def test_a_source_that_was_changed_is_compiled_anew(folder: Path) -> None:
    run(folder)
    source = folder / "kernels.py"
    source.write_text(KERNELS.replace("4.0", "6.0"))
    assert run(folder)[0] == "False True 6.0 6.0"


def test_another_processor_compiles_anew(folder: Path) -> None:
    run(folder)
    assert run(folder, NUMBA_CPU_NAME="generic")[0] == "False True 4.0 6.0"


def test_nowhere_to_keep_them(folder: Path) -> None:
    (folder / "__pycache__").touch()  # a file where the folder should be stops root as well
    said, warned = run(folder, **NOWHERE)
    assert said == "False False 4.0 6.0"
    assert warned.count("KernelCacheWarning") == 1
    assert "compiled kernels cannot be kept: neither the package's folder nor the user's cache folder" in warned
    assert sorted(path.name for path in folder.iterdir()) == ["__pycache__", "kernels.py"]


@pytest.mark.parametrize(
    ("suffix", "damage"),
    [
        (".nbi", lambda data: data[: len(data) // 2]),
        (".nbi", lambda data: b""),
        (".nbc", lambda data: data[:-1]),
        (".nbc", lambda data: b"x" * len(data)),
    ],
    ids=["half an index", "an empty index", "code one byte short", "something else for code"],
)
def test_damaged_files(folder: Path, suffix: str, damage: Callable[[bytes], bytes]) -> None:
    run(folder)
    files = list(folder.rglob(f"*{suffix}"))
    assert len(files) == 2
    for file in files:
        file.write_bytes(damage(file.read_bytes()))
    said, warned = run(folder)
    assert said.endswith("True 4.0 6.0")
    assert warned.count("KernelCacheWarning") == 1
    assert f"{folder / '__pycache__'} cannot be read" in warned
    assert run(folder) == ("True True 4.0 6.0", "")  # and are whole again


def test_no_room_to_keep_them(folder: Path) -> None:
    full = (
        "import errno, os, numba.core.caching as caching\n"
        "def full(*_): raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))\n"
        "caching.IndexDataCacheFile._save_index = full\n"
    )
    said, warned = run(folder, full + USE)
    assert said == "False True 4.0 6.0"
    assert warned.count("KernelCacheWarning") == 1
    assert "cannot be written (OSError: [Errno 28] No space left on device)" in warned


def test_without_compiling_there_is_nothing_to_keep(folder: Path) -> None:
    assert run(folder, NUMBA_DISABLE_JIT="1") == ("False False 4.0 6.0", "")


def test_an_installation_that_nobody_may_write_to(tmp_path: Path) -> None:
    """The package as it is, on a machine without a home; what is asked of it takes few kernels."""
    site = tmp_path / "site"
    shutil.copytree(ROOT / "hplan", site / "hplan", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "urdf", site / "urdf")
    folders = [site / "hplan", *(path for path in (site / "hplan").rglob("*") if path.is_dir())]
    for each in folders:
        (each / "__pycache__").touch()
    code = (
        "import sys\n"
        "from hplan.planning.compile_ahead import compiling_ahead, is_first_run\n"
        "from hplan.robot.model import load_robot\n"
        "assert 'site' in sys.modules['hplan'].__file__\n"
        "with compiling_ahead(is_first_run()) as wait:\n"
        "    print(is_first_run(), load_robot().dynamics.gravity([[0.0] * 4]).round(3).tolist())\n"
    )
    said, warned = run(site, code, PYTHONPATH=str(site), **NOWHERE)
    assert said.startswith("True [[")
    assert warned.count("KernelCacheWarning") == 1
