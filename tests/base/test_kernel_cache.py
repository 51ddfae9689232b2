"""Kernels and their cache on disk: with any defect programs run and warn once."""

from __future__ import annotations

import enum
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba as nb
import numpy as np
import pytest

from hplan.base import kernels
from hplan.base.arrays import FloatArray
from hplan.base.kernels import KernelCacheWarning, any_int, inline, kernel

ROOT = Path(__file__).parents[2]

KERNELS = """
from hplan.base.kernels import inline, kernel

@inline
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
    """Standard output and error of a program, which must succeed."""
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


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder after its first run, with old file times."""
    folder = tmp_path_factory.mktemp("compiled")
    (folder / "kernels.py").write_text(KERNELS)
    os.utime(folder / "kernels.py", (1e9, 1e9))
    assert run(folder) == ("False True 4.0 6.0", "")
    for file in folder.rglob("*.nb?"):
        os.utime(file, (1e9 + 100.0, 1e9 + 100.0))
    return folder


@pytest.fixture
def kept(compiled: Path, tmp_path: Path) -> Path:
    """A copy with the same times; the sources' change times are later."""
    return Path(shutil.copytree(compiled, tmp_path / "there"))


def test_kernels_are_cached_from_first_run(kept: Path) -> None:
    assert run(kept) == ("True True 4.0 6.0", "")


def test_compiler_modules_are_not_loaded_again(folder: Path) -> None:
    """Not numba's own functions, with all of scipy.linalg: neither for a call nor for an error."""
    (folder / "total.py").write_text(
        "import numpy as np\nfrom hplan.base.kernels import kernel\n\n@kernel\ndef total(n):\n"
        "    if n < 0: raise ValueError('n')\n    return np.ones(n), np.ones(n).sum(), np.any(np.ones(n) > 2)\n"
    )
    use = "import sys, total; a, b, c = total.total(3); print(a.tolist(), b, c, 'scipy.linalg' in sys.modules)\n"
    use += "try: total.total(-1)\nexcept ValueError as error: print(error)"
    assert run(folder, use) == ("[1.0, 1.0, 1.0] 3.0 False True\nn", "")
    assert run(folder, use) == ("[1.0, 1.0, 1.0] 3.0 False False\nn", "")


def test_source_that_was_changed_is_compiled_anew(kept: Path) -> None:
    (kept / "kernels.py").write_text(KERNELS.replace("4.0", "6.0"))
    assert run(kept)[0] == "False True 6.0 6.0"


def test_another_processor_compiles_anew(kept: Path) -> None:
    assert run(kept, NUMBA_CPU_NAME="generic")[0] == "False True 4.0 6.0"


LONG = """
from hplan.base.kernels import kernel

@kernel
def long(x):
    return {}

@kernel
def twice(x):
    return 2.0 * long(x)
""".format(" + ".join(f"(x / {n}.0 if x < {n}.0 else x * x - {n}.0)" for n in range(1, 25)))


def test_kernel_that_is_not_tiny_is_compiled_once(folder: Path) -> None:
    """Its callers refer to it by a name that is the same in every process.

    If its own file is lost, it is compiled again.
    """
    (folder / "long.py").write_text(LONG)
    whole, values = "import long; print(long.twice(2.0) == 2.0 * long.long(2.0))", "import long; print(long.twice(2.0))"
    assert run(folder, whole) == ("True", "")
    caller, called = (next(folder.rglob(f"long.{name}-*.nbc")) for name in ("twice", "long"))
    assert caller.stat().st_size < 0.7 * called.stat().st_size
    kept, answer = caller.stat().st_ino, run(folder, values)
    called.unlink()
    before = "from hplan.base.kernels import kernel; kernel(lambda x: x)(1)\n"  # as a count goes on
    assert run(folder, before + values) == answer
    assert called.exists()
    assert caller.stat().st_ino == kept
    called.write_bytes(b"")
    said, warned = run(folder, values)
    assert (said, warned.count("KernelCacheWarning")) == (answer[0], 1)
    assert caller.stat().st_ino == kept


RECORDS = """
import numpy as np
from hplan.base.kernels import kernel

@kernel
def value(row):
    return {}

@kernel
def first(rows):
    return value(rows[0]) + 1.0

@kernel
def last(rows):
    return value(rows[-1]) + 2.0

points = np.array([(2.0, 3.0), (4.0, 5.0)], dtype=[("x", "f8"), ("y", "f8")])
counts = np.array([(6, 2.0), (7, 8.0)], dtype=[("n", "i8"), ("x", "f8")])
""".format(" + ".join(f"(row.x / {n}.0 if row.x < {n}.0 else row.x * row.x - {n}.0)" for n in range(1, 25)))


def test_processes_that_met_records_in_another_order_share_kernels(folder: Path) -> None:
    """numba numbers record types as it meets them; a symbol with that number would name another kernel elsewhere."""
    (folder / "records.py").write_text(RECORDS)
    meet, call = "from records import *\n", "print(first(points), last(counts), first(counts), last(points))\n"
    right = run(folder, meet + call, NUMBA_CACHE_DIR=str(folder / "alone"))
    for compiled in ("first(points)", "last(counts)", "first(counts)", "last(points)"):
        assert run(folder, meet + compiled) == ("", "")
    for order in ("", "last(counts); first(points)\n", "last(points); first(counts)\n"):
        assert run(folder, COUNTED + meet + order + call + "print(len(compiled.buffer))") == (f"{right[0]}\n0", "")


def test_processes_do_not_compile_the_same(folder: Path) -> None:
    (folder / "long.py").write_text(LONG)
    code = "from hplan.base.kernel_turns import LISTENERS; LISTENERS.append(lambda *told: print(*told)); import long; "
    with ThreadPoolExecutor(2) as pool:
        said = list(pool.map(lambda _: run(folder, code + "long.twice(2.0)")[0].split("\n"), range(2)))
    assert sorted(line for lines in said for line in lines if line) == ["long.long 2", "long.twice 1"]


def test_turn_ends_when_another_process_has_compiled_the_kernel(compiled: Path, folder: Path) -> None:
    """A process that loads the kernel after waiting does not keep others waiting for it."""
    code = f"""
import shutil, subprocess, sys
import kernels
from hplan.base import kernels as cache
asked, wait = [], cache.wait_for_turn
def wait_for_other(folder, name):
    shutil.copytree({str(compiled / "__pycache__")!r}, folder, dirs_exist_ok=True)
    asked.append((str(folder), name))
    return wait(folder, name) or True
cache.wait_for_turn = wait_for_other
print(kernels.triple(2.0), kernels.double(2.0), len(asked))
ask = "from pathlib import Path; from hplan.base import kernel_turns as turns; turns._PATIENCE_S = 0.2; "
for folder, name in asked:
    subprocess.run([sys.executable, "-c", ask + f"print(turns.wait_for_turn(Path({{folder!r}}), {{name!r}}))"])
"""
    said, _ = run(folder, code, PYTHONUNBUFFERED="1")
    first, *waited = said.split("\n")
    assert first.startswith("6.0 4.0 ")
    assert len(waited) == int(first.split()[-1]) > 0
    assert set(waited) == {"False"}


def test_nowhere_to_keep_them(folder: Path) -> None:
    (folder / "__pycache__").touch()  # a file instead of the folder stops root as well
    said, warned = run(folder, **NOWHERE)
    assert said == "False False 4.0 6.0"
    assert warned.count("KernelCacheWarning") == 1
    assert "compiled kernels cannot be cached: neither the package's folder nor the user's cache folder" in warned
    assert sorted(path.name for path in folder.iterdir()) == ["__pycache__", "kernels.py"]


def test_damaged_files(kept: Path) -> None:
    half, other = kept.rglob("*.nbc")
    half.write_bytes(half.read_bytes()[:1000])
    other.write_bytes(b"x" * 1000)
    said, warned = run(kept)
    assert said.endswith("True 4.0 6.0")
    assert warned.count("KernelCacheWarning") == 1
    assert f"{kept / '__pycache__'} cannot be read" in warned
    assert run(kept) == ("True True 4.0 6.0", "")  # and are whole again


@kernel
def _slope(values: FloatArray) -> float:
    return float(values[-1] - values[0])


def test_no_damage_goes_unnoticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Changed bits, missing ends and pieces of a file, and other kernels' files."""
    monkeypatch.setattr(nb.config, "CACHE_DIR", str(tmp_path))
    compiled: Any = _slope
    ones, whole = np.ones(3), np.ones(3, dtype=np.int64)
    _slope(ones), _slope(whole)
    cache, context = compiled._cache, compiled.targetctx
    types = [(nb.typeof(ones),), (nb.typeof(whole),)]
    file, other = (cache.folders()[0] / cache._key(each).file_name for each in types)
    data = file.read_bytes()
    assert cache.load_overload(types[0], context) is not None

    random = np.random.default_rng(23)
    damaged = [other.read_bytes(), b"", data[:31], data[:32], data + b"x"]
    for _ in range(50):
        at, until = sorted(random.integers(len(data), size=2))
        flipped = bytearray(data)
        flipped[at] ^= 1 << int(random.integers(8))
        damaged += [bytes(flipped), data[:until], data[:at] + bytes(until + 1 - at) + data[until + 1 :] + b"."]
    for each in damaged:
        file.write_bytes(each)
        monkeypatch.setattr(kernels, "_GIVEN", set())
        with pytest.warns(KernelCacheWarning, match="damaged"):
            assert cache.load_overload(types[0], context) is None
    file.write_bytes(data)
    assert cache.load_overload(types[0], context) is not None


SHIPPED = """
import pathlib
from hplan.base import kernels as of_hplan
of_hplan._SHIPPED = pathlib.Path("{}")
"""

#: Records the compilations.
COUNTED = """
from numba.core import event
compiled = event.RecordingListener()
event.register("numba:compile", compiled)
"""


def test_kernels_that_came_with_the_package(folder: Path, tmp_path: Path) -> None:
    """Compiled for many processors, read from read-only folders; other versions are ignored."""
    brought = tmp_path / "kernels"
    brought.mkdir()
    run(folder, USE, **kernels.portable_processor(), NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    for file in (tmp_path / "cache").rglob("*.nbc"):
        shutil.copy2(file, brought)
    made_for = brought / "made_for.txt"
    made_for.write_text(kernels.made_for())
    (folder / "__pycache__").touch()
    count = COUNTED + USE + "print(len(compiled.buffer))"
    assert run(folder, SHIPPED.format(brought) + count, **NOWHERE) == ("True False 4.0 6.0\n0", "")

    older = (
        "import llvmlite.binding as ll\n"
        "one = type(ll.get_host_cpu_features())(sse2=True)\n"
        "ll.get_host_cpu_features = lambda: one\n"
    )
    for before, named in ((older, "this processor lacks avx2, bmi"), ("", "this is CPython")):
        said, warned = run(folder, before + SHIPPED.format(brought) + count, **NOWHERE)
        assert said.startswith("False False 4.0 6.0\n")
        assert not said.endswith("\n0")
        assert named in warned
        assert "the kernels shipped with hplan are for CPython" in warned
        made_for.write_text(kernels.made_for().replace("numba ", "numba 0."))


READ = """
from typing import NamedTuple

import numpy as np

from hplan.base.kernels import inline, kernel

STEP = 1.0
FAR = 2.0
TABLE = np.array([1.0, 2.0])

class Pair(NamedTuple):
    first: float
    second: float

@inline
def half(x):
    return 0.5 * x

@kernel
def deep(x):
    return x + 1.0

@kernel
def called(x):
    return deep(x)

@kernel
def same(x):
    return x - 1.0
"""

READS = """
import read
from hplan.base.kernels import is_kept, kernel
from read import STEP, TABLE, Pair, called, deep, half, same

def kernels():
    def constant(): return STEP
    def array(): return TABLE[1]
    def inlines(): return half(2.0)
    def calls(): return deep(0.0)
    def calls_what_calls(): return called(0.0)
    def of_a_module(): return read.FAR
    def field(pair): return pair.first
    def made(): return Pair(3.0, 4.0).first
    def unchanged(): return same(0.0)
    return [constant, array, inlines, calls, calls_what_calls, of_a_module, field, made, unchanged]

for function in kernels():
    compiled = kernel(function)
    arguments = (Pair(first=1.0, second=2.0),) if function.__name__ == "field" else ()
    print(function.__name__, is_kept(compiled), compiled(*arguments))
"""


def test_change_of_dependency_recompiles_kernel(folder: Path) -> None:
    """The kernels' file is unchanged; each uses another part of the changed file."""

    def answers(text: str) -> dict[str, tuple[str, float]]:
        (folder / "read.py").write_text(text)
        lines = [line.split() for line in run(folder, "import reads")[0].splitlines()]
        return {name: (kept, float(value)) for name, kept, value in lines}

    (folder / "reads.py").write_text(READS)
    right = {
        "constant": (1.0, 7.0),
        "array": (2.0, 5.0),
        "inlines": (1.0, 0.5),
        "calls": (1.0, 100.0),
        "calls_what_calls": (1.0, 100.0),
        "of_a_module": (2.0, 9.0),
        "field": (1.0, 1.0),
        "made": (3.0, 4.0),
        "unchanged": (-1.0, -1.0),
    }
    assert answers(READ) == {name: ("False", values[0]) for name, values in right.items()}
    changes = {
        "STEP = 1.0": "STEP = 7.0",
        "FAR = 2.0": "FAR = 9.0",
        "1.0, 2.0]": "1.0, 5.0]",
        "0.5 * x": "0.25 * x",
        "x + 1.0": "x + 100.0",
        "    first: float\n    second: float": "    second: float\n    first: float",
    }
    text = "# A comment moves every line.\n" + READ
    for old, new in changes.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    after = answers(text)
    assert {name: value for name, (_, value) in after.items()} == {name: values[1] for name, values in right.items()}
    assert {name for name, (kept, _) in after.items() if kept == "True"} <= {"field", "unchanged"}
    assert after["unchanged"][0] == "True"


def test_constant_changed_while_the_program_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may or may not be in the code that numba compiles later, so that is not cached."""
    monkeypatch.setattr(nb.config, "CACHE_DIR", str(tmp_path))
    assert _shifted(1) == 2
    assert len(list(tmp_path.rglob("*.nbc"))) == 1
    monkeypatch.setitem(globals(), "SHIFT", 5)
    _shifted(1.0)
    assert len(list(tmp_path.rglob("*.nbc"))) == 1


SHIFT = 1


@kernel
def _shifted(x: float) -> float:
    return x + SHIFT


def test_unknown_dependency_is_not_cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nb.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(kernels, "_GIVEN", set())
    with pytest.warns(KernelCacheWarning, match=r"_coloured: the dependencies of <Colour.RED: 1> are unknown"):
        assert _coloured() == 1
    assert list(tmp_path.rglob("*.nbc")) == []


class Colour(enum.Enum):
    """A type that numba knows and digests do not."""

    RED = 1


RED = Colour.RED


@kernel
def _coloured() -> int:
    value: int = RED.value
    return value


def test_no_room_to_keep_them(folder: Path) -> None:
    full = (
        "import errno, os, pathlib\n"
        "def full(*_): raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))\n"
        "pathlib.Path.replace = full\n"
    )
    said, warned = run(folder, full + USE)
    assert said == "False True 4.0 6.0"
    assert warned.count("KernelCacheWarning") == 1
    assert "is writable ([Errno 28] No space left on device)" in warned
    assert list(folder.rglob("*.nbc*")) == []


def test_read_only_installation_uses_other_cache(tmp_path: Path) -> None:
    """The package without a writable home; the program uses few kernels."""
    site = tmp_path / "site"
    shutil.copytree(ROOT / "hplan", site / "hplan", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "urdf", site / "urdf")
    folders = [site / "hplan", *(path for path in (site / "hplan").rglob("*") if path.is_dir())]
    for each in folders:
        (each / "__pycache__").touch()
    code = (
        "import sys\n"
        "from hplan.apps.cli.compile_ahead import compiling_ahead, is_first_run\n"
        "from hplan.robot.model import load_robot\n"
        "assert 'site' in sys.modules['hplan'].__file__\n"
        "with compiling_ahead(is_first_run()):\n"
        "    print(is_first_run(), load_robot().dynamics.gravity([[0.0] * 4]).round(3).tolist())\n"
    )
    said, warned = run(site, code, PYTHONPATH=str(site), **NOWHERE)
    assert said.startswith("True [[")
    assert warned.count("KernelCacheWarning") == 1


# Without the disk

_THREE = any_int(3)


@inline
def _twice(x: float) -> float:
    return 2.0 * x


@kernel
def _power(x: float, times: int) -> float:
    result = 1.0
    for _ in range(times):
        result *= x
    return result


@kernel
def _all_of_them(x: float, times: int) -> float:
    return _power(x, times) + _power(x, _THREE) + _twice(x)


def test_constant_argument_adds_no_signature() -> None:
    assert _all_of_them(2.0, 5) == 32.0 + 8.0 + 4.0
    assert isinstance(_THREE, np.int64)
    assert len(_power.overloads) <= 1  # 0 if the calling kernel comes from disk
