"""Compile and cache all numerical kernels of hplan.

Later commands then need not wait for compilation. The cache is next to hplan's modules or, if that folder is not
writable, in the user's cache folder (NUMBA_CACHE_DIR selects another one).
"""

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
from importlib import import_module
from typing import TYPE_CHECKING

import hplan
from hplan.apps.cli.options import add_shared, command_parser
from hplan.apps.cli.terminal import FAILED, progress_line
from hplan.base.child_process import import_environment, python_module
from hplan.base.interrupts import INTERRUPTS
from hplan.base.kernel_turns import LISTENERS
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

_EPILOG = """\
exit status:
  0  done
  5  a job failed; its kernels are compiled when they are first called
"""


def warm_up_controller() -> None:
    """Compile the kernels that a controller program calls for the default arm."""
    hplan.warm_up(hplan.load_robot())


def warm_up_any_arm() -> None:
    """Compile the same kernels for general (non-planar) arms.

    The robot is the default arm with its wrist joint turned, which needs no files other than its URDF.
    """
    from hplan.base.data_files import urdf_dir

    first, _, last = (urdf_dir() / "harvester.urdf").read_text(encoding="utf-8").rpartition('xyz="0 -1 0"')
    hplan.warm_up(hplan.load_robot(f'{first}xyz="1 0 0"{last}', limits="harvester"))


#: Jobs, as commands or functions; each one runs in its own process and folder. The first `_FIRST_JOBS` compile most of
#: the kernels that the others share, and therefore run before them.
JOBS = {
    "certified motion": "hplan.apps.cli.compile_ahead:compile_from_postprocessing_on",
    "plan": "plan --out a; certify a",
    "fruit": "plan dense-canopy",
    "orchard": "plan orchard-row; plan orchard-arm-row",
    "tour": "tour tour",
    "bound": "plan --bound",
    "dense search": "plan --method dense --objective length",
    "controller": "hplan.apps.cli.warmup:warm_up_controller",
    "any arm": "hplan.apps.cli.warmup:warm_up_any_arm",
}

#: Approximate number of kernels, checked by `scripts/build_wheel.py`.
ALL_KERNELS = 248

#: Number of jobs that run before the others.
_FIRST_JOBS = 2

#: Prefix of the line that a job prints for each compiled kernel.
_COMPILED = "compiled "


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    parser.add_argument("--processes", type=int, metavar="N", help="number of processes (default: one per core)")
    add_shared(parser, "quiet")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Compile all kernels and print the progress; return the exit status.

    On a terminal the progress is a status line, elsewhere one line for each finished job.
    """
    processes = len(os.sched_getaffinity(0)) if arguments.processes is None else arguments.processes
    if processes < 1:
        raise OptionError("processes", processes, "a whole number >= 1")
    begin, count = time.perf_counter(), 0
    with progress_line(errors, quiet=arguments.quiet) as show:

        def told(job: str, kernel: str | None) -> None:
            nonlocal count
            count += kernel is not None
            seconds = time.perf_counter() - begin
            show(f"kernel {count} of about {ALL_KERNELS}, {seconds:.0f} s: {kernel or job}")
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
    """Run all jobs, each in its own process.

    Args:
        processes: Maximum number of jobs that run at the same time.
        told: Called, by one thread at a time, with a job and the kernel that it has compiled, or None when the job
            has finished.
        environment: Environment variables of the jobs in addition to this process's.

    Returns:
        The last line of the error output of each failed job, by its name.
    """
    failed, lock = dict[str, str](), threading.Lock()
    running, is_ended = set[subprocess.Popen[str]](), threading.Event()

    def do(job: str) -> None:
        command = python_module("hplan.apps.cli.warmup", JOBS[job])
        with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile("w+") as said:
            process = subprocess.Popen(
                command, cwd=folder, env={**import_environment(), **environment}, stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE, stderr=said, text=True,
            )  # fmt: skip
            running.add(process)
            if is_ended.is_set():
                process.terminate()
            with process:
                for line in process.stdout or ():
                    if line.startswith(_COMPILED):
                        with lock:
                            told(job, line.removeprefix(_COMPILED).strip())
            running.discard(process)
            said.seek(0)
            lines = said.read().split("\n")
        with lock:
            if process.returncode != 0:
                failed[job] = next((line for line in reversed(lines) if line.strip()), f"status {process.returncode}")
            told(job, None)

    with ThreadPoolExecutor(processes) as pool:
        try:
            for jobs in (list(JOBS)[:_FIRST_JOBS], list(JOBS)[_FIRST_JOBS:]):
                list(pool.map(do, jobs))
        except INTERRUPTS:
            is_ended.set()
            pool.shutdown(wait=False, cancel_futures=True)
            for process in list(running):
                process.terminate()
            raise
    return failed


def _do(job: str) -> None:
    """Run a job in this process and print each kernel it compiles."""
    from hplan.apps.cli.main import main

    LISTENERS.append(lambda kernel, _: print(f"{_COMPILED}{kernel}", file=sys.__stdout__, flush=True))
    with contextlib.redirect_stdout(io.StringIO()):
        for part in job.split("; "):
            module, _, function = part.partition(":")
            if function:
                getattr(import_module(module), function)()
            elif status := main(part.split()):
                raise SystemExit(f"exit status {status}")


if __name__ == "__main__":
    _do(sys.argv[1])
