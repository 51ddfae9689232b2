"""How kernels are compiled."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from hplan.kernels import any_int, inlined, kernel

_THREE = any_int(3)


@inlined
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


def test_a_constant_is_no_kind_of_its_own() -> None:
    assert _all_of_them(2.0, 5) == 32.0 + 8.0 + 4.0
    assert isinstance(_THREE, np.int64)
    assert len(_power.overloads) <= 1  # 0 where the kernel that calls it comes from disk


def test_the_main_job_compiles_each_kernel_once(tmp_path: Path) -> None:
    """What is compiled for two kinds of argument doubles its share of the first run, and of every start."""
    code = "import hplan; hplan.plan(hplan.load_robot(), hplan.load_scene())"
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, check=True)
    kept = [file.name for file in tmp_path.rglob("*.nbc")]
    assert len(kept) > 20
    assert [name for name in kept if not name.endswith(".1.nbc")] == []
