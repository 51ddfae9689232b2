"""Compilation of kernels by a second process, on the first run.

numba compiles each kernel at its first call, one after the other, and keeps it on disk. A second process therefore
compiles the kernels that a plan calls after the grid search, with a path through the reference scene. Meanwhile the
plan compiles the kernels of the grid search and the certificate, and finds the rest compiled or in progress.
Without the second process, or if kernels cannot be kept on disk, the plan compiles all of them itself.
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
from hplan.optimization.interior_point import solve_program

if TYPE_CHECKING:
    from hplan.base.arrays import FloatArray
    from hplan.planning.problem import Problem


def is_first_run() -> bool:
    """True if a basic kernel has no current version on disk."""
    return not is_kept(solve_program)


@contextmanager
def compiling_ahead(first_run: bool) -> Iterator[Callable[[], None]]:
    """Compile the post-processing and certificate kernels in another process during the block.

    It does so on the first run only, if kernels can be kept on disk and a second processor is available.

    Args:
        first_run: The result of `is_first_run`.

    Yields:
        A function to call after the grid search: it compiles the certificate's kernels, or does nothing without the
        second process.
    """
    useful = first_run and can_be_kept(solve_program) and len(os.sched_getaffinity(0)) > 1
    other = _start() if useful else None
    try:
        yield compile_certificate if other is not None else lambda: None
    finally:
        if other is not None:
            other.kill()
            other.wait()


def _start() -> subprocess.Popen[bytes] | None:
    """Start the second process; None if it cannot be started."""
    command, nowhere = python_module("hplan.apps.cli.compile_ahead"), subprocess.DEVNULL
    try:
        return subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere, env=import_environment())
    except OSError:
        return None


def compile_from_postprocessing_on() -> None:
    """Plan through the reference scene, from post-processing to the certificate."""
    from hplan.planning.motion import quickest
    from hplan.planning.path_finder import Path
    from hplan.planning.problem import MARGIN

    problem, waypoints = _reference()
    quickest(problem, [Path(waypoints, "search")], MARGIN)
    compile_certificate()


def compile_certificate() -> None:
    """Time a path through the reference scene and certify its motion.

    This compiles the kernels that the optimizer does not call.
    """
    from hplan.planning.motion import certificate_of, time_along
    from hplan.trajectory.spline import SplinePath

    problem, waypoints = _reference()
    certificate_of(problem, time_along(problem, SplinePath.from_control_points(waypoints)))


def _reference() -> tuple[Problem, FloatArray]:
    """The problem of the reference scene, and waypoints around its ball."""
    from hplan.planning.options import PlanOptions
    from hplan.planning.problem import Problem
    from hplan.robot.model import load_robot
    from hplan.scene.file import load_scene

    scene = load_scene()
    start, goal = scene.start.configuration, scene.goal.configuration
    waypoints = np.stack([start, start, goal, goal])
    # Elbow and wrist fold while the shoulder turns, so that the path avoids the ball of the reference scene [deg].
    waypoints[1:3, -2:] = np.radians((80.0, 80.0))
    return Problem.from_scene(load_robot(), scene, PlanOptions()).from_configurations(start, goal), waypoints


if __name__ == "__main__":
    gc.disable()  # saves an eighth of the time, for some 300 MB until the process ends
    compile_from_postprocessing_on()
