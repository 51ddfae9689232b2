"""The command `hplan warmup`: compile whatever hplan may call, at once, instead of bit by bit when it is called."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

from hplan.apps.cli.options import command_parser
from hplan.apps.cli.terminal import FAILED, progress_line
from hplan.base.child_process import import_environment, python_module
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

_DESCRIPTION = """\
Compile the numerical kernels for all that hplan does, and keep them, so that no later command waits for that. They are
kept beside hplan, or where that cannot be written to in the user's cache folder (NUMBA_CACHE_DIR names another).
"""

_EPILOG = """\
exit status:
  0  done
  5  part of it failed; its kernels are compiled when they are called
"""

#: What is done, each by a process of its own in a folder of its own: programs, in whose words `main` is the command
#: line. The first two compile most of what the others need, and go before them.
JOBS = {
    "certified motion": "from hplan.planning.compile_ahead import compile_from_postprocessing_on as work; work()",
    "plan": "main(['plan', '--out', 'a']); main(['certify', 'a'])",
    "fruit": "main(['plan', 'dense-canopy'])",
    "orchard": "main(['plan', 'orchard-row']); main(['plan', 'orchard-arm-row'])",
    "tour": "main(['tour', 'tour'])",
    "bound": "main(['plan', '--bound'])",
    "dense search": "main(['plan', '--method', 'dense', '--objective', 'length'])",
    "controller": """
import hplan, numpy as np
robot, scene = hplan.load_robot(), hplan.load_scene()
planner = hplan.Planner(robot, scene)
motion = planner.plan(begins_s=0.0)
points = np.random.default_rng(1).normal((0.9, 0.5, 1.4), 0.03, (5000, 3))
pose = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
seen = {"joints": scene.start.configuration, "pose": pose, "radius": 0.005, "keep_s": 1.0}
for time_s in (0.0, 0.05):
    planner.set_cloud("seen", points, time_s=time_s, **seen)
motion = planner.replan(at=0.3, now=0.1)
planner.stop_at(0.5, now=0.4)
""",
    "any arm": """
import hplan
from hplan.scene import Box, Goal, Scene, Start
boards = (Box(name="lower", center=(0.7, 0.0, 0.05), size=(0.3, 1.2, 0.02)),
          Box(name="upper", center=(0.75, 0.0, 0.62), size=(0.3, 1.2, 0.02)))
start, goal = (0.0, -0.3, 0.0, -1.9, 0.0, 1.6, 0.785), (0.5, 0.55, 0.0, -1.75, 0.0, 2.3, 0.785)
scene = Scene(name="shelf", start=Start(joints_rad=start), goal=Goal(joints_rad=goal), obstacles=boards)
try:
    robot = hplan.load_robot("panda", hold={"panda_finger_joint1": 0.04})
except hplan.errors.HplanError:
    pass  # the extra robots is not installed
else:
    hplan.plan(robot, scene)
""",
}

#: Jobs that go before the others.
_FIRST = 2

#: What a job says of a kernel that it has compiled.
_COMPILED = "compiled "


def parser(prog: str) -> argparse.ArgumentParser:
    """The parser of the command's arguments."""
    parser = command_parser(_DESCRIPTION, _EPILOG, prog=prog)
    parser.add_argument("--processes", type=int, metavar="N", help="how many at a time (default: one for each core)")
    parser.add_argument("--quiet", action="store_true", help="no progress, no summary")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Compile; on a terminal with a line that tells how far that is, elsewhere with a line for each job.

    Raises:
        OptionError: A number of processes below 1.
    """
    processes = len(os.sched_getaffinity(0)) if arguments.processes is None else arguments.processes
    if processes < 1:
        raise OptionError("processes", processes, "a whole number of at least 1")
    begin, count = time.perf_counter(), 0
    with progress_line(errors, quiet=arguments.quiet) as show:

        def told(job: str, kernel: str | None) -> None:
            nonlocal count
            count += kernel is not None
            seconds = time.perf_counter() - begin
            show(f"kernel {count}, {seconds:.0f} s: {kernel or job}"[:76])
            if kernel is None and not arguments.quiet and not errors.is_terminal:
                errors.print(f"{job}: done, {count} kernels, {seconds:.0f} s")

        failed = compile_all(processes, told, {})
    for job, message in failed.items():
        errors.print(f"{job} failed: {message}", markup=False)
    if not arguments.quiet:
        console.print(f"{count} kernels compiled in {time.perf_counter() - begin:.0f} s")
    return FAILED if failed else 0


def compile_all(
    processes: int, told: Callable[[str, str | None], None], environment: Mapping[str, str]
) -> dict[str, str]:
    """Do all jobs, each in a process.

    Args:
        told: Called, by one thread at a time, with a job and a kernel that it has compiled, or None when it is done.
        environment: Variables of theirs besides this process's.

    Returns:
        Of jobs that failed the last line that they wrote.
    """
    failed, lock = dict[str, str](), threading.Lock()

    def do(job: str) -> None:
        command = python_module("hplan.apps.cli.warmup")
        with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile("w+") as said:
            process = subprocess.Popen(
                command, cwd=folder, env={**import_environment(), **environment}, stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=said, text=True,
            )  # fmt: skip
            with process:
                assert process.stdin is not None
                assert process.stdout is not None
                process.stdin.write(JOBS[job])
                process.stdin.close()
                for line in process.stdout:
                    if line.startswith(_COMPILED):
                        with lock:
                            told(job, line.removeprefix(_COMPILED).strip())
            said.seek(0)
            lines = said.read().split("\n")
        with lock:
            if process.returncode != 0:
                failed[job] = next((line for line in reversed(lines) if line.strip()), f"status {process.returncode}")
            told(job, None)

    with ThreadPoolExecutor(processes) as pool:
        for jobs in (list(JOBS)[:_FIRST], list(JOBS)[_FIRST:]):
            list(pool.map(do, jobs))
    return failed


def _do(program: str) -> None:
    """Do a job in this process, and say what was compiled."""
    from numba.core import event

    from hplan.apps.cli.main import main

    class Compiled(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            """Nothing is to be said."""

        def on_end(self, event: Any) -> None:
            function = event.data["dispatcher"].py_func
            if function.__module__.startswith("hplan."):
                name = f"{function.__module__.removeprefix('hplan.')}.{function.__name__}"
                print(f"{_COMPILED}{name}", file=sys.__stdout__, flush=True)

    event.register("numba:compile", Compiled())
    statuses: list[int] = []
    with contextlib.redirect_stdout(io.StringIO()):
        exec(program, {"main": lambda words: statuses.append(main(words))})
    if any(statuses):
        raise SystemExit(f"exit status {max(statuses)}")


if __name__ == "__main__":
    _do(sys.stdin.read())
