"""Stages of a plan, and how long each of them takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

#: Stages of a plan, in order.
STAGES = (
    "grasps", "trees", "cspace", "layers", "sparse", "fallback", "postprocess", "timing", "certificate", "bound",
    "export",
)  # fmt: skip


class StageClock:
    """Wall-clock time of each stage [s]; a stage entered again adds up."""

    def __init__(self) -> None:
        self._begin = time.perf_counter()
        self.seconds = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what runs inside as part of a stage."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.add(name, time.perf_counter() - begin)

    def add(self, name: str, seconds: float) -> None:
        """Add time that was measured elsewhere."""
        self.seconds[name] += seconds

    def told(self) -> list[str]:
        """The stages that there were and how long each took, in words."""
        return [f"{name} for {1e3 * seconds:.3g} ms" for name, seconds in self.seconds.items() if seconds > 0.0]

    def as_ms(self) -> dict[str, float]:
        """Times by stage and in all [ms]."""
        table = {name: round(1e3 * seconds, 4) for name, seconds in self.seconds.items()}
        return {**table, "total": round(1e3 * (time.perf_counter() - self._begin), 4)}
