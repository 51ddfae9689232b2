"""Kernels compiled ahead by a second process, on the first run after hplan was installed.

numba compiles a kernel when it is first called, one after the other, and keeps it on disk. So another process begins
with what a plan calls from the path on the grid on, on a path through the reference scene. The plan compiles what leads
to that path, then the certificate, and finds the rest compiled, or comes to what the other process is at. Without that
process, or where kernels cannot be kept on disk, a plan compiles all of them itself.
"""

from __future__ import annotations

import gc
import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from hplan.base.child_process import import_environment, python_module
from hplan.base.kernels import can_be_kept, is_kept
from hplan.optimization.interior_point import solve

if TYPE_CHECKING:
    from hplan.base.arrays import FloatArray
    from hplan.planning.problem import Problem


def is_first_run() -> bool:
    """True if a kernel that every plan needs is not on disk as its source stands."""
    return not is_kept(solve)


@contextmanager
def compiling_ahead(first_run: bool) -> Iterator[Callable[[], None]]:
    """Inside the block the kernels from post-processing on are compiled by another process, if this is the first run.

    Args:
        first_run: What `is_first_run` says.

    Yields:
        A function that compiles the last of them, if so, for when the path on the grid is found.
    """
    useful = first_run and can_be_kept(solve) and len(os.sched_getaffinity(0)) > 1
    other = _start() if useful else None
    try:
        yield compile_certificate if other is not None else lambda: None
    finally:
        if other is not None:
            other.kill()
            other.wait()


def _start() -> subprocess.Popen[bytes] | None:
    """The other process; None where none can be started."""
    command, nowhere = python_module("hplan.planning.compile_ahead"), subprocess.DEVNULL
    try:
        return subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere, env=import_environment())
    except OSError:
        return None


def compile_from_postprocessing_on() -> None:
    """Optimise and certify a motion through the reference scene, and time its path."""
    from hplan.planning.motion import quickest
    from hplan.planning.path_finder import Path
    from hplan.planning.problem import MARGIN

    problem, waypoints = _reference()
    quickest(problem, [Path(waypoints, "search")], MARGIN)
    compile_certificate()


def compile_certificate() -> None:
    """Time a path through the reference scene and certify its motion: what the optimiser does not call."""
    from hplan.planning.motion import certificate_of, timed
    from hplan.trajectory.spline import SplinePath

    problem, waypoints = _reference()
    certificate_of(problem, timed(problem, SplinePath.through(waypoints)))


def _reference() -> tuple[Problem, FloatArray]:
    """Arm and scene of a first run, and waypoints past the ball."""
    from hplan.planning.options import PlanOptions
    from hplan.planning.problem import Problem
    from hplan.robot.model import load_robot
    from hplan.scene.file import load_scene

    scene = load_scene()
    start, goal = scene.start.configuration, scene.goal.configuration
    waypoints = np.stack([start, start, goal, goal])
    # Elbow and wrist while the shoulder turns, on a path that avoids the ball of the reference scene [deg].
    waypoints[1:3, -2:] = np.radians((80.0, 80.0))
    return Problem.of(load_robot(), scene, PlanOptions()).between(start, goal), waypoints


if __name__ == "__main__":
    gc.disable()  # an eighth of the time, for some 300 MB until it ends
    compile_from_postprocessing_on()
