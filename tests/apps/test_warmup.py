"""The command `hplan warmup`: what it compiles is kept, what fails is told, in lines of 80 columns."""

from __future__ import annotations

from pathlib import Path

import pytest

from hplan.apps.cli import warmup
from hplan.apps.cli.main import main

IMPORTS = "import numpy as np; from hplan.base.elementary import arccos, arctan2; "
JOBS = {
    "angles": IMPORTS + "arccos(np.ones(1)); print('unseen')",
    "the same": IMPORTS + "arctan2(np.ones(1), np.ones(1))",
    "no scene": "main(['plan', 'missing.yaml'])",
    "a fault": "raise ValueError('of the job')",
}


def test_jobs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(warmup, "JOBS", JOBS)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
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
    monkeypatch.setattr(warmup, "JOBS", {"nothing": ""})
    assert main(["warmup", "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")
    assert main(["warmup", "--processes", "0"]) == 2
