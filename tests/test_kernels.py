"""How kernels are compiled."""

from __future__ import annotations

import subprocess
import sys

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
    assert len(_power.overloads) == 1


def test_the_main_job_compiles_each_kernel_once() -> None:
    """What is compiled for two kinds of argument doubles its share of the first run, and of every start."""
    code = """
import gc, hplan
from numba.core.dispatcher import Dispatcher
hplan.plan(hplan.load_robot(), hplan.load_scene())
for item in gc.get_objects():
    if isinstance(item, Dispatcher) and item.py_func.__module__.startswith("hplan.") and len(item.overloads) > 1:
        print(item.py_func.__module__, item.py_func.__name__)
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == ""
