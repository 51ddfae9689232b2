"""Compile the numerical kernels for all that hplan does, and keep them, so that no later command waits for that.

They are kept beside hplan, or where that cannot be written to in the user's cache folder (NUMBA_CACHE_DIR names
another).
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
  5  part of it failed; its kernels are compiled when they are called
"""


def warm_up_controller() -> None:
    """Compile for the default arm what a controller's program calls."""
    hplan.warm_up(hplan.load_robot())


def warm_up_any_arm() -> None:
    """That for the default arm with its wrist turned: no planar arm, and nothing but its own file is needed."""
    from hplan.base.data_files import urdf_dir

    first, _, last = (urdf_dir() / "harvester.urdf").read_text(encoding="utf-8").rpartition('xyz="0 -1 0"')
    hplan.warm_up(hplan.load_robot(f'{first}xyz="1 0 0"{last}', limits="harvester"))


#: What is done, commands or functions, each by a process of its own in a folder of its own. The first two compile most
#: of what the others need, and go before them.
JOBS = {
    "certified motion": "hplan.planning.compile_ahead:compile_from_postprocessing_on",
    "plan": "plan --out a; certify a",
    "fruit": "plan dense-canopy",
    "orchard": "plan orchard-row; plan orchard-arm-row",
    "tour": "tour tour",
    "bound": "plan --bound",
    "dense search": "plan --method dense --objective length",
    "controller": "hplan.apps.cli.warmup:warm_up_controller",
    "any arm": "hplan.apps.cli.warmup:warm_up_any_arm",
}

#: So many kernels are compiled, about: `scripts/build_wheel.py` holds that.
KERNELS = 250

#: Jobs that go before the others.
_FIRST = 2

#: What a job says of a kernel that it has compiled.
_COMPILED = "compiled "


def parser(prog: str) -> argparse.ArgumentParser:
    """The parser of the command's arguments."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    parser.add_argument("--processes", type=int, metavar="N", help="how many at a time (default: one for each core)")
    add_shared(parser, "quiet")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Compile; on a terminal with a line that tells how far that is, elsewhere with a line for each job."""
    processes = len(os.sched_getaffinity(0)) if arguments.processes is None else arguments.processes
    if processes < 1:
        raise OptionError("processes", processes, "a whole number of at least 1")
    begin, count = time.perf_counter(), 0
    with progress_line(errors, quiet=arguments.quiet) as show:

        def told(job: str, kernel: str | None) -> None:
            nonlocal count
            count += kernel is not None
            seconds = time.perf_counter() - begin
            show(f"kernel {count} of about {KERNELS}, {seconds:.0f} s: {kernel or job}")
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
            for jobs in (list(JOBS)[:_FIRST], list(JOBS)[_FIRST:]):
                list(pool.map(do, jobs))
        except INTERRUPTS:
            is_ended.set()
            pool.shutdown(wait=False, cancel_futures=True)
            for process in list(running):
                process.terminate()
            raise
    return failed


def _do(job: str) -> None:
    """Do a job in this process, and say what was compiled."""
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
