"""How kernels are compiled."""

from __future__ import annotations

import numpy as np

from hplan.base.kernels import any_int, inlined, kernel

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
