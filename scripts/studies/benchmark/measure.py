"""Clocks, medians and memory.

Times are CPU times of the calling thread unless they are called `wall`: what is measured runs on one thread, and
other load on the machine then does not count.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError
from hplan.planning.report import versions

_T = TypeVar("_T")


class Grouped(Protocol):
    """A problem of a set."""

    @property
    def group(self) -> str:
        """What it is counted with."""


_Grouped = TypeVar("_Grouped", bound=Grouped)

#: Called with what is being measured, how much of it is done and how much there is.
Progress = Callable[[str, int, int], None]

#: Packages beside those of a report whose versions matter here.
_PEERS = ("ompl", "scipy")


def timed(run: Callable[[], _T]) -> tuple[_T, float]:
    """What a function returns, and its CPU time [ms]."""
    begin = time.thread_time()
    value = run()
    return value, 1e3 * (time.thread_time() - begin)


def or_error(run: Callable[[], _T]) -> _T | HplanError:
    """What a function returns, or hplan's error that it raises."""
    try:
        return run()
    except HplanError as error:
        return error


def times_ms(run: Callable[[], object], repetitions: int, *, warm: int = 2) -> list[float]:
    """CPU times of repeated calls, after some that do not count [ms]."""
    for _ in range(warm):
        run()
    return [timed(run)[1] for _ in range(repetitions)]


def evenly_chosen(problems: Sequence[_Grouped], most: int | None) -> list[_Grouped]:
    """So many problems of each group at most, evenly spread over it, in the order given."""
    kept: list[_Grouped] = []
    for group in dict.fromkeys(problem.group for problem in problems):
        ours = [problem for problem in problems if problem.group == group]
        count = len(ours) if most is None else min(most, len(ours))
        kept += [ours[(2 * i + 1) * len(ours) // (2 * count)] for i in range(count)]
    return kept


def median(values: Sequence[float]) -> float:
    """The median; NaN of nothing."""
    return float(np.median(values)) if len(values) else float("nan")


def times_until(end_s: float, step_s: float) -> FloatArray:
    """Times from 0 on, so far apart, and the end [s]."""
    return np.append(np.arange(0.0, end_s, step_s), end_s)


def spread(values: Sequence[float]) -> dict[str, float]:
    """Median, 95th and 99th percentile, and maximum; NaN of nothing."""
    if not len(values):
        return dict.fromkeys(("median", "p95", "p99", "max"), float("nan"))
    q = np.percentile(values, [50, 95, 99, 100])
    return dict(zip(("median", "p95", "p99", "max"), (float(value) for value in q), strict=True))


@contextlib.contextmanager
def stages_in_cpu_time() -> Iterator[None]:
    """Let `time.perf_counter`, which hplan's stages are timed by, tell CPU time of the thread."""
    original = time.perf_counter
    time.perf_counter = time.thread_time
    try:
        yield
    finally:
        time.perf_counter = original


def peak_memory_mb(run: Callable[[], _T]) -> tuple[_T, float]:
    """What a function returns, and how far resident memory rose above its value before the call [MB].

    This counts everything, arrays of compiled kernels too, which tracemalloc does not see. NaN where the system does
    not tell (it takes Linux).
    """
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        before = _status_kb("VmRSS")
    except (OSError, KeyError):
        return run(), float("nan")
    value = run()
    return value, (_status_kb("VmHWM") - before) / 1024.0


def _status_kb(key: str) -> int:
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    table = dict(line.split(":", 1) for line in lines if ":" in line)
    return int(table[key].split()[0])


def fitted_slope(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Slope of the line through logarithms of values over those of sizes; NaN with fewer than two finite points."""
    x, y = np.asarray(sizes, dtype=np.float64), np.asarray(values, dtype=np.float64)
    kept = np.isfinite(y) & (y > 0.0) & (x > 0.0)
    if len(set(x[kept].tolist())) < 2:
        return float("nan")
    return float(np.polyfit(np.log(x[kept]), np.log(y[kept]), 1)[0])


def environment() -> dict[str, Any]:
    """Processor, system and versions."""
    found = versions()
    for package in _PEERS:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": found,
        "clock": "CPU time of the calling thread",
    }


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown"
