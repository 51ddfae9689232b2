"""The output folder of a planning command, written completely or never.

A job begins after all inputs have been read; no file changes before that. Files are written to a staging folder inside
the output folder and then moved, the report before any trajectory. Therefore the folder never holds a trajectory
without its report, even if the job ends by an error, a full disk or a signal.

Files that hplan did not write are kept (`own_files`) unless the user passes `--force`. As soon as the command knows its
folder, an interruption leaves a report that says so.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hplan
from hplan.apps.cli.own_files import FORMAT_KEY, NOT_OURS, WRITTEN, check_own, digests_of, is_own
from hplan.apps.cli.own_files import REPORT as REPORT
from hplan.apps.cli.own_files import ROW_REPORT as ROW_REPORT
from hplan.apps.cli.own_files import TOUR_REPORT as TOUR_REPORT
from hplan.base.files import (
    REPORT_FORMAT,
    ByteBudget,
    check_replaceable,
    inputs,
    new_folder,
    note_input,
    write_text,
)
from hplan.base.interrupts import INTERRUPTS, defer_signals, signal_of
from hplan.errors import HplanError, InputError, OptionError, OutputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from hplan.apps.view.playback import Shown
    from hplan.trajectory.trajectory import Trajectory

#: Files of a finished job in addition to its report: the CSV of one motion, the CSV of a tour, the page.
TRAJECTORY = "trajectory.csv"
TOUR = "tour.csv"
PAGE = "scene.html"

#: Scene of a user-supplied path, with the ends of the path as start and goal. The certificate refers to this scene.
SCENE = "scene.yaml"

#: The motion as ROS 2 messages, written on request.
MCAP = "motion.mcap"

#: Page and figure of the joint space, written on request.
CSPACE_PAGE, CSPACE_FIGURE = "cspace.html", "cspace.png"

#: Files that accompany the report of one motion; the trajectory comes first.
PLAN_FILES = (TRAJECTORY, PAGE, MCAP, CSPACE_PAGE, CSPACE_FIGURE)

#: Name prefix of the staging folder of a process; its process number follows.
_STAGING = ".hplan-job-"


#: Files that a job writes only on request, or only if an optional dependency is installed.
_OPTIONAL = (MCAP, CSPACE_PAGE, CSPACE_FIGURE, "row.png")

#: Output folder of the running command.
_CURRENT_FOLDER: ContextVar[JobFolder | None] = ContextVar("job_folder", default=None)


class JobFolder:
    """An output folder and the names of the job's files in it."""

    def __init__(self, arguments: argparse.Namespace, files: Sequence[str], report: str) -> None:
        """Register the folder of the running command; no file changes yet.

        Args:
            arguments: Arguments of the command, with the folder `out` and the flag `force`. Files that they name are
                registered as inputs.
            files: Names or glob patterns of the job's files; the trajectory comes first.
            report: Name of the job's report.
        """
        self.path: Path = arguments.out
        self._files = (*files, report)
        self._report = report
        self._force: bool = arguments.force
        #: Names of files of others that the job might replace.
        self._others: frozenset[str] = frozenset()
        #: Whether the folder has a report of how this job ended.
        self._is_settled = False
        _note_inputs(arguments)
        _CURRENT_FOLDER.set(self)

    @contextmanager
    def job(self, scene: str, robot: str) -> Iterator[None]:
        """Create the folder; on failure leave only a report.

        A failed job also removes the files of an earlier one. An `OptionError` (an option that does not fit robot or
        scene) does not count as a failed job: the folder stays as it is.

        Args:
            scene: Name of the scene, for the report of a failure.
            robot: Name of the robot, for the report of a failure.

        Raises:
            OptionError: The job would overwrite one of its inputs.
            OutputError: The folder cannot be written, or the job would replace a file that hplan did not write.
        """
        for path in inputs():
            if path.parent == self.path.resolve() and any(path.match(pattern) for pattern in self._files):
                raise OptionError("--out", str(self.path), f"a folder other than that of {path}, which is an input")
        self._is_settled = False
        self._check_own()
        with new_folder(self.path):
            yield from self._run_job(scene, robot)

    def _run_job(self, scene: str, robot: str) -> Iterator[None]:
        for staging in self.path.glob(f"{_STAGING}*"):  # left behind by killed processes
            number = staging.name.removeprefix(_STAGING)
            if number.isdecimal() and not _runs(int(number)):
                shutil.rmtree(staging, ignore_errors=True)
        try:
            yield
        except OptionError:
            raise
        except BaseException as error:
            if not self._is_settled:
                self._fail(error, scene, robot)
            raise

    @contextmanager
    def stage_files(self) -> Iterator[Path]:
        """Yield a staging folder; move its files into place on exit.

        The report receives the SHA-256 of the other files, so that hplan can later recognize them as its own.

        Raises:
            OutputError: A file cannot be written, or would replace one that hplan did not write.
        """
        staging = self.path / f"{_STAGING}{os.getpid()}"
        moved: list[Path] = []
        try:
            try:
                with defer_signals():
                    self._clear()  # so that no trajectory is ever next to the report of another job
                staging.mkdir()
                yield staging
                made = sorted(staging.iterdir(), key=lambda file: (file.suffix == ".csv", file.name))
                for file in made:
                    check_replaceable(self.path / file.name, self.path / file.name)
                    self._check_replaced(file.name)
                report = staging / self._report
                digests = digests_of([file for file in made if file != report])
                if self._report in {file.name for file in made}:
                    content = {FORMAT_KEY: REPORT_FORMAT} | json.loads(report.read_bytes()) | {WRITTEN: digests}
                    report.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
                with defer_signals():
                    moved.extend(file.replace(self.path / file.name) for file in made)
                    self._is_settled = True
            except OutputError as error:
                raise OutputError(self.path / error.path.name, error.reason) from error
            except OSError as error:
                name = Path(error.filename or staging).name
                raise OutputError(self.path / name, error.strerror or str(error)) from error
        except BaseException:
            with defer_signals():
                for file in () if self._is_settled else moved:
                    file.unlink(missing_ok=True)
            raise
        finally:
            with defer_signals():
                shutil.rmtree(staging, ignore_errors=True)

    def report_interrupt(self, error: BaseException) -> None:
        """Write the report of a job interrupted before it began.

        The files of an earlier job are removed. Nothing changes if the job's files are inputs of the command or if
        hplan did not write them.
        """
        if self._is_settled:
            return
        with defer_signals():
            try:
                if any(map(self._is_input, self._files)):
                    return
                self._check_own()
                self.path.mkdir(parents=True, exist_ok=True)
            except (OSError, OutputError):
                return
            self._fail(error, None, None)

    def _is_input(self, pattern: str) -> bool:
        folder = self.path.resolve()
        return any(path.parent == folder and path.match(pattern) for path in inputs())

    def _check_own(self) -> None:
        """Check that the job replaces only files that hplan wrote.

        Raises:
            OutputError: The job would replace a file that hplan did not write; names the file.
        """
        for name in self._files:
            if name not in _OPTIONAL and "*" not in name:
                check_own(self.path / name, force=self._force)
        # Names that are known later only: by then the report, which tells whose they are, is removed.
        later = [name for name in self._files if name in _OPTIONAL or "*" in name]
        found = (file for name in later for file in self.path.glob(name) if file.is_file())
        self._others = frozenset(file.name for file in found if not is_own(file))

    def _check_replaced(self, name: str) -> None:
        """Refuse to replace a file that is, or was when the job began, not hplan's."""
        check_own(self.path / name, force=self._force)
        if name in self._others and not self._force:
            raise OutputError(self.path / name, NOT_OURS)

    def _clear(self) -> None:
        """Remove the trajectory, report and accompanying files of an earlier job.

        Files that hplan did not write are kept. Unless the newest report in the folder is from a finished job of this
        kind, only trajectory and report are removed, because the other files may belong to another kind of job. A name
        that cannot be removed (a folder) is skipped; writing that file fails later with an error.
        """
        finished = []
        for name in (REPORT, TOUR_REPORT, ROW_REPORT):
            with contextlib.suppress(InputError):
                if read_report(self.path / name, is_input=False).get("status") == "ok":
                    finished.append(name)
        is_ours = bool(finished) and max(finished, key=lambda name: written_s(self.path / name)) == self._report
        for pattern in self._files:  # the report comes last, because it identifies the other files
            if is_ours or pattern in (self._files[0], self._report):
                for file in sorted(self.path.glob(pattern)):
                    with contextlib.suppress(OSError):
                        if self._may_replace(file):
                            file.unlink(missing_ok=True)

    def _may_replace(self, file: Path) -> bool:
        """True for hplan's own files; with `--force` for all job file names."""
        return is_own(file) or (self._force and file.name in self._files)

    def _fail(self, error: BaseException, scene: str | None, robot: str | None) -> None:
        """Write the report of a failed or interrupted job.

        After an internal error (neither an `HplanError` nor a signal) no report is written.
        """
        with defer_signals():
            self._clear()
            path = self.path / self._report
            if isinstance(error, HplanError):
                from hplan.planning.report import failure_report, write_report

                with contextlib.suppress(OutputError):
                    write_report(failure_report(error, scene=scene, robot=robot), path)
            elif isinstance(error, INTERRUPTS):
                report = {"status": "interrupted", "scene": scene, "robot": robot, "signal": signal_of(error).name}
                content = {"format": REPORT_FORMAT, **report, "versions": {"hplan": hplan.__version__}}
                with contextlib.suppress(OutputError):
                    write_text(path, json.dumps(content, indent=2) + "\n")
            self._is_settled = True


@contextmanager
def reporting_interrupts() -> Iterator[None]:
    """Context in which a signal leaves a report in the command's folder."""
    token = _CURRENT_FOLDER.set(None)
    try:
        yield
    except INTERRUPTS as error:
        folder = _CURRENT_FOLDER.get()
        if folder is not None:
            folder.report_interrupt(error)
        raise
    finally:
        _CURRENT_FOLDER.reset(token)


def _note_inputs(arguments: argparse.Namespace) -> None:
    """Register files named by the arguments as inputs, before reading them."""
    for name, value in vars(arguments).items():
        if name not in ("out", "report"):
            for item in value if isinstance(value, list | tuple) else (value,):
                with contextlib.suppress(OSError, ValueError):
                    if isinstance(item, Path | str) and Path(item).is_file():
                        note_input(Path(item))


def read_report(path: Path, *, is_input: bool = True) -> dict[str, Any]:
    """Read a report file.

    Args:
        path: The report, a JSON file of at most 64 MB.
        is_input: False if the running command may replace the file.

    Raises:
        InputError: The file is missing or too large, or does not hold a JSON object.
    """

    def fault(reason: str) -> InputError:
        return InputError(f"report file {path}: {reason}", path=str(path))

    most_report_bytes = 64_000_000
    text = ByteBudget(most_report_bytes).text(path, fault, is_input=is_input)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise fault(f"it is not valid JSON: {error}") from error
    if not isinstance(content, dict):
        raise fault("it is not a mapping of keys")
    return content


def written_s(path: Path) -> float:
    """Modification time of a file [s]; minus infinity if missing."""
    try:
        return path.stat().st_mtime
    except OSError:
        return float("-inf")


def needs_rosbags(arguments: argparse.Namespace) -> None:
    """Check, before any work, that `--mcap` can write its messages.

    Raises:
        InputError: `--mcap` is given and rosbags is not installed.
    """
    if arguments.mcap:
        from hplan.apps.ros.mcap_file import import_rosbags

        import_rosbags()


def write_result(
    result: Shown, motions: Mapping[str, Trajectory], folder: Path, *, mcap: bool = False, page: str = PAGE
) -> list[str]:
    """Write a result's motions as CSV, its page and, optionally, its messages.

    Args:
        motions: Motions by the names of their CSV files.
        folder: Folder to write into.
        mcap: Also write the motion as ROS 2 messages.
        page: File name of the page.

    Returns:
        File names of the page and, if written, of the messages.
    """
    from hplan.apps.view.page import write_page
    from hplan.apps.view.playback import playable
    from hplan.trajectory.trajectory import write_csv

    for name, motion in motions.items():
        write_csv(motion, folder / name)
    write_page(*playable(result), folder / page)
    if not mcap:
        return [page]
    from hplan.apps.ros.mcap_file import write_mcap

    write_mcap(result, folder / MCAP)
    return [page, MCAP]


def write_figure(draw: Callable[[], Figure], path: Path, errors: Console) -> list[str]:
    """Write a figure, or print why it is missing.

    A figure is missing if, for example, matplotlib is not installed.

    Returns:
        The names of the files written: one or none.
    """
    from hplan.apps.view.figures import write_png

    try:
        return [write_png(draw(), path).name]
    except InputError as error:
        errors.print(f"no {path.name}: {error.message}", markup=False, soft_wrap=True)
        return []


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # a process of another user
        return True
    return True
