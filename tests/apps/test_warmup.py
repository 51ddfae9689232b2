"""The command `hplan warmup`, and progress messages of compilation, in 80 columns."""

from __future__ import annotations

import io
import math
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rich.console import Console

from hplan.apps.cli import plan, warmup
from hplan.apps.cli.main import main
from hplan.apps.cli.terminal import progress_line
from hplan.base.kernel_turns import LISTENERS
from hplan.base.kernels import kernel


@kernel
def _sine(angle: float) -> float:
    return math.sin(angle)


@kernel
def _cosine(angle: float) -> float:
    return math.cos(angle)


def angles() -> None:
    _sine(1.0)
    sys.stdout.write("unseen\n")


def the_same() -> None:
    _cosine(1.0)


def a_fault() -> None:
    raise ValueError("of the job")


def nothing() -> None:
    """Do it."""


JOBS = {name: f"test_warmup:{name.replace(' ', '_')}" for name in ("angles", "the same", "a fault")}
JOBS["no scene"] = "plan missing.yaml"


def test_jobs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(warmup, "JOBS", JOBS)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    for kernels in (2, 0):
        assert main(["warmup", "--processes", "2"]) == 5
        out, err = capfd.readouterr()
        assert out.startswith(f"{kernels} kernels compiled in ")
        lines = err.splitlines()
        assert {line.split(":")[0] for line in lines if ": done, " in line} == set(JOBS)
        assert f"the same: done, {kernels} kernels" in err or f"angles: done, {kernels} kernels" in err
        assert "a fault failed: ValueError: of the job" in lines
        assert "no scene failed: exit status 2" in lines
        assert max(map(len, lines)) <= 80
    assert len(list(tmp_path.rglob("*.nbc"))) == 2
    monkeypatch.setattr(warmup, "JOBS", {"nothing": "test_warmup:nothing"})
    assert main(["warmup", "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    assert main(["warmup", "--processes", "0"]) == 2


@pytest.mark.parametrize("terminal", [True, False])
def test_command_reports_compilation(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hplan.apps.cli.terminal._EVERY_S", 0.0 if terminal else -1.0)
    console = Console(file=io.StringIO(), force_terminal=terminal, width=80)
    with progress_line(console, quiet=False, kernels=90) as show:
        show("looking for a path " * 9)
        for told in LISTENERS:
            told("grid.astar._astar", 87)
        time.sleep(0.3)
    said = console.file.getvalue()  # type: ignore[attr-defined]
    assert not LISTENERS
    if terminal:
        assert "compiling: kernel 87 of about 90, 0 s; looking" in said
    else:
        assert said == "compiling (first run only): kernel 87 of about 90, 0 s\n"


def test_number_of_called_kernels_is_as_documented(tmp_path: Path) -> None:
    code = "from hplan.apps.cli.main import main; main(['plan', '--quiet']); from hplan.base import kernels as k; "
    command = [sys.executable, "-c", code + "print(len(k._ASKED))"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=900, check=True)
    assert int(done.stdout) == pytest.approx(plan.KERNELS, rel=0.1)
