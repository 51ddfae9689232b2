"""The command `hplan warmup`: what it compiles is kept, what fails is told, in lines of 80 columns."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from hplan.apps.cli import warmup
from hplan.apps.cli.main import main
from hplan.base.elementary import arccos, arctan2


def angles() -> None:
    arccos(np.ones(1))
    sys.stdout.write("unseen\n")


def the_same() -> None:
    arctan2(np.ones(1), np.ones(1))


def no_scene() -> None:
    warmup._command("plan", "missing.yaml")


def a_fault() -> None:
    raise ValueError("of the job")


def nothing() -> None:
    """Do it."""


JOBS = {"angles": angles, "the same": the_same, "no scene": no_scene, "a fault": a_fault}


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
    monkeypatch.setattr(warmup, "JOBS", {"nothing": nothing})
    assert main(["warmup", "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    assert main(["warmup", "--processes", "0"]) == 2
