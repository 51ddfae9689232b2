"""The first run: what is compiled, by which process, and that neither is left behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hplan import first_run

#: Modules whose kernels a plan calls only after the path on the grid is found.
LATER = ("clear", "fast", "shorten", "spline", "topp", "dynamics", "clearance_proof")


def compiled_by(command: list[str], cache: Path) -> set[str]:
    """What is on disk after a command: kernels as module.function, each with its number."""
    subprocess.run([sys.executable, *command], env={**os.environ, "NUMBA_CACHE_DIR": str(cache)}, check=True)
    return {file.name for file in cache.rglob("*.nbc")}


def test_each_process_compiles_its_half_once(tmp_path: Path) -> None:
    """What is compiled for two kinds of argument doubles its share of the first run, and of every start."""
    later = compiled_by(["-m", "hplan.first_run"], tmp_path)
    everything = compiled_by(["-c", "import hplan; hplan.plan(hplan.load_robot(), hplan.load_scene())"], tmp_path)
    assert {name.split(".")[0] for name in later} >= set(LATER)
    assert len(everything - later) > 15
    assert [name for name in everything - later if name.split(".")[0] in LATER] == []
    assert [name for name in everything if not name.endswith(".1.nbc")] == []


def test_first_run_until_the_kernels_are_kept_and_newer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first_run.compile_from_postprocessing_on()
    assert not first_run.is_first_run()
    source = Path(first_run.__file__).with_name("topp.py")

    class Kernel:
        py_func = first_run.greedy.py_func  # type: ignore[attr-defined]

        class stats:  # noqa: N801 - numba's name
            cache_path = str(tmp_path)

    monkeypatch.setattr(first_run, "greedy", Kernel)
    assert first_run.is_first_run()
    index = tmp_path / f"topp.greedy-1.py{sys.version_info.major}{sys.version_info.minor}.nbi"
    index.touch()
    assert not first_run.is_first_run()
    old = source.stat().st_mtime - 10.0
    os.utime(index, (old, old))
    assert first_run.is_first_run()


def begun(code: str) -> subprocess.Popen[bytes]:
    """A process that stands for the other one."""
    return subprocess.Popen([sys.executable, "-c", code])


@pytest.mark.parametrize("code", ["pass", "raise SystemExit(1)"], ids=["done", "failed"])
def test_the_plan_waits_for_the_other_process(code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    other = begun(code)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(first_run, "_start", lambda: other)
    with first_run.compiling_beside(True) as compiled:
        compiled()
        assert other.returncode is not None


def test_the_other_process_does_not_outlive_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    other = begun("import time; time.sleep(600)")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(first_run, "_start", lambda: other)
    monkeypatch.setattr(first_run, "PATIENCE_S", 0.01)

    def interrupted() -> None:
        with first_run.compiling_beside(True) as compiled:
            compiled()
            assert other.returncode is None
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert other.returncode is not None


@pytest.mark.parametrize(("first", "processors"), [(False, 2), (True, 1)], ids=["later run", "one processor"])
def test_no_other_process_where_it_would_not_help(
    first: bool, processors: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def start() -> Any:
        raise AssertionError

    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(processors)))
    monkeypatch.setattr(first_run, "_start", start)
    with first_run.compiling_beside(first) as compiled:
        compiled()


def test_where_no_process_can_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with first_run.compiling_beside(True) as compiled:
        compiled()
