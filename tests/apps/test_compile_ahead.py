"""The first run: which process compiles which kernels, and no process remains."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hplan.apps.cli import compile_ahead

#: Modules whose kernels a plan calls only after the path on the grid is found.
LATER = ("push_clear", "coarse_profile", "shortcut", "spline", "topp", "dynamics", "clearance_proof")

#: Says which kernels of hplan's are loaded, and for how many kinds of argument.
TELL = """
import gc
from numba.core.dispatcher import Dispatcher
for each in gc.get_objects():
    if isinstance(each, Dispatcher) and each.overloads and each.py_func.__module__.startswith("hplan."):
        print(each.py_func.__module__.rpartition(".")[2], each.py_func.__name__, len(each.overloads))
"""


def called_by(code: str) -> dict[str, int]:
    """The kernels that a program calls, as module.function, each with the kinds of argument that it calls it with."""
    done = subprocess.run([sys.executable, "-c", code + TELL], capture_output=True, text=True, check=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    return {f"{module}.{name}": int(kinds) for module, name, kinds in lines}


def test_each_process_compiles_its_half_once() -> None:
    """A kernel called with two argument types doubles its share of every start."""
    later = called_by("from hplan.apps.cli.compile_ahead import compile_from_postprocessing_on as work\nwork()\n")
    everything = called_by("import hplan\nhplan.plan(hplan.load_robot(), hplan.load_scene())\n")
    assert {name.split(".")[0] for name in later} >= set(LATER)
    assert len(set(everything) - set(later)) > 5
    assert [name for name in set(everything) - set(later) if name.split(".")[0] in LATER] == []
    assert {name for name, kinds in (later | everything).items() if kinds > 1} == set()


def test_first_run_is_one_without_kernels_on_disk(tmp_path: Path) -> None:
    """The cache's own tests cover the detection."""
    compile_ahead.compile_from_postprocessing_on()
    assert not compile_ahead.is_first_run()
    code = "from hplan.apps.cli.compile_ahead import is_first_run; raise SystemExit(not is_first_run())"
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, check=True)
    assert list(tmp_path.rglob("*.nbc")) == []


def begun(code: str) -> subprocess.Popen[bytes]:
    """A process in place of the compiling one."""
    return subprocess.Popen([sys.executable, "-c", code])


def test_other_process_does_not_outlive_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    other = begun("import time; time.sleep(600)")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(compile_ahead, "_start", lambda: other)

    def interrupted() -> None:
        with compile_ahead.compiling_ahead(True) as compile_last:
            compile_last()
            assert other.returncode is None
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert other.returncode is not None


def test_other_process_runs_nothing_of_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    marker = tmp_path / "was-run"
    for name in ("yaml", "numpy", "hplan"):
        (tmp_path / f"{name}.py").write_text(f"open({str(marker)!r}, 'w').close()\nraise SystemExit('run')")
    monkeypatch.chdir(tmp_path)
    other = compile_ahead._start()
    assert other is not None
    assert other.wait(300) == 0
    assert not marker.exists()


def test_where_no_process_can_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with compile_ahead.compiling_ahead(True) as compile_last:
        compile_last()
