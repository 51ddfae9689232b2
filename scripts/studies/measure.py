"""Building blocks of rows: CPU time, plans as rows, and the machine.

Times are CPU times of the calling thread: the measured code runs on one thread, and other load on the machine does not
count.
"""

from __future__ import annotations

import contextlib
import os
import platform
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from studies.harness import Row

from hplan.errors import HplanError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.report import versions
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.model import Scene

_T = TypeVar("_T")


def timed(run: Callable[[], _T]) -> tuple[_T, float]:
    """The result of a function, and its CPU time [ms]."""
    begin = time.thread_time()
    value = run()
    return value, 1e3 * (time.thread_time() - begin)


def median_ms(run: Callable[[], object], repetitions: int) -> float:
    """Median CPU time of repeated calls without the first [ms].

    Slow functions are repeated less often.
    """
    once, budget_ms = timed(run)[1], 1500.0
    affordable = min(repetitions, int(budget_ms / max(once, 1e-3)))
    return float(np.median([timed(run)[1] for _ in range(affordable)])) if affordable > 1 else once


def or_error(run: Callable[[], _T]) -> _T | HplanError:
    """The result of a function, or the `HplanError` that it raises."""
    try:
        return run()
    except HplanError as error:
        return error


def outcome(found: PlanResult | HplanError, ms: float) -> Row:
    """Row of a plan: success, CPU time [ms], duration [s], path origin."""
    if isinstance(found, HplanError):
        return {"solved": False, "certified": False, "ms": ms, "origin": found.kind, "message": found.message}
    certified = found.certificate.verified
    return {
        "solved": True,
        "certified": certified,
        "ms": ms,
        "duration_s": found.trajectory.duration,
        "origin": found.motion.origin,
        "fault": not certified,
    }


def planned(robot: Robot, scene: Scene, options: PlanOptions | None = None) -> tuple[PlanResult | None, Row]:
    """The plan of a scene, or None, and its row."""
    found, ms = timed(lambda: or_error(lambda: plan(robot, scene, options)))
    return None if isinstance(found, HplanError) else found, outcome(found, ms)


def ratio(value: float | None, other: float | None) -> float | None:
    """One number to another, where both are there."""
    return None if value is None or not other else value / other


def environment() -> dict[str, Any]:
    """Processor, system and versions."""
    found = versions()
    for package in ("ompl", "scipy"):  # in addition to a report's packages
        found[package] = "not installed"
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    processor = platform.processor() or "unknown"
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), processor)
    return {
        "processor": processor,
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": found,
    }
