"""The folder that a planning command writes into: filled at once or not at all.

A job begins when all that it reads has been read: before that no file is changed. Files are made in a folder of their
own inside it and then moved, the report before any trajectory. So wherever a job ends, by a fault, a full disk or a
signal, no trajectory stands there without the report that belongs to it.

What hplan has not written stays (`own_files`), unless the user wants it replaced. An interrupted job leaves a report
that says so, from the moment that the command knows its folder.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import secrets
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
from hplan.base.files import REPORT_FORMAT, ByteBudget, check_replaceable, inputs, note_input, write_text
from hplan.base.interrupts import INTERRUPTS, signal_of, uninterrupted
from hplan.errors import HplanError, InputError, OptionError, OutputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from hplan.apps.view.playback import Shown
    from hplan.trajectory.trajectory import Trajectory

#: Files of a finished job besides its report: of one motion, of a tour, of all.
TRAJECTORY = "trajectory.csv"
TOUR = "tour.csv"
PAGE = "scene.html"

#: The scene of a path that was given, with its ends as start and goal: what is certified is about this one.
SCENE = "scene.yaml"

#: The motion as messages of ROS 2, where it is asked for.
MCAP = "motion.mcap"

#: Files of the joint space, where they are asked for.
CSPACE_PAGE, CSPACE_FIGURE = "cspace.html", "cspace.png"

#: Files that go with the report of one motion, its trajectory first.
PLAN_FILES = (TRAJECTORY, PAGE, MCAP, CSPACE_PAGE, CSPACE_FIGURE)

#: Name of the folder in which a process makes its files.
_STAGING = ".hplan-job-"


#: Files that a job writes only if they are requested, or if it can.
_OPTIONAL = (MCAP, CSPACE_PAGE, CSPACE_FIGURE, "row.png")

#: The folder of the command that runs.
_CURRENT: ContextVar[JobFolder | None] = ContextVar("job_folder", default=None)


class JobFolder:
    """A folder, and the files in it that are a job's."""

    def __init__(self, arguments: argparse.Namespace, files: Sequence[str], report: str) -> None:
        """Change nothing yet.

        Args:
            arguments: The command's, with the folder `out` and `force`. Files that they name are inputs.
            files: Names of a job's files, or patterns of them; first its trajectory.
        """
        self.path: Path = arguments.out
        self._files = (*files, report)
        self._report = report
        self._force: bool = arguments.force
        #: Names of files of others that the job might replace.
        self._others: frozenset[str] = frozenset()
        #: Whether a report stands here that says how the job has ended.
        self._is_settled = False
        _note_inputs(arguments)
        _CURRENT.set(self)

    @contextmanager
    def job(self, scene: str, robot: str) -> Iterator[None]:
        """Make the folder ready; should the job inside fail, leave nothing of it, or an earlier one, but its report.

        An option that does not fit robot or scene is no failed job: the folder stays as it is.

        Args:
            scene: Name of the scene, for the report of a failure.

        Raises:
            OutputError: The folder cannot be written, or has a file that would be replaced and is not hplan's.
        """
        for path in inputs():
            if path.parent == self.path.resolve() and any(path.match(pattern) for pattern in self._files):
                raise OptionError("--out", str(self.path), f"another folder than that of {path}, which is read")
        self._is_settled = False
        self._check_own()
        prepare_folder(self.path)
        for staging in self.path.glob(f"{_STAGING}*"):  # of processes that were killed
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
    def filling(self) -> Iterator[Path]:
        """A folder to write files into, which are moved into this one when the block ends.

        The report takes the SHA-256 of the others, by which they are known again.
        """
        staging = self.path / f"{_STAGING}{os.getpid()}"
        moved: list[Path] = []
        try:
            try:
                with uninterrupted():
                    self._clear()  # so that no trajectory is seen beside another's report
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
                with uninterrupted():
                    moved.extend(file.replace(self.path / file.name) for file in made)
                    self._is_settled = True
            except OutputError as error:
                raise OutputError(self.path / error.path.name, error.reason) from error
            except OSError as error:
                name = Path(error.filename or staging).name
                raise OutputError(self.path / name, error.strerror or str(error)) from error
        except BaseException:
            with uninterrupted():
                for file in () if self._is_settled else moved:
                    file.unlink(missing_ok=True)
            raise
        finally:
            with uninterrupted():
                shutil.rmtree(staging, ignore_errors=True)

    def interrupted(self, error: BaseException) -> None:
        """Leave the report of a job that a signal has ended before it began; an earlier job's files go.

        If the folder has files of others in their place, or such that the command reads, nothing is changed.
        """
        if self._is_settled:
            return
        with uninterrupted():
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
        """Refuse a folder in which a file would be replaced that is not hplan's.

        Raises:
            OutputError: There is one; names it.
        """
        for name in self._files:
            if name not in _OPTIONAL and "*" not in name:
                check_own(self.path / name, force=self._force)
        # Names that are known later only: by then the report, which tells whose they are, is removed.
        later = [name for name in self._files if name in _OPTIONAL or "*" in name]
        found = (file for name in later for file in self.path.glob(name) if file.is_file())
        self._others = frozenset(file.name for file in found if not is_own(file))

    def _check_replaced(self, name: str) -> None:
        """Refuse to replace a file that is not hplan's now, or was not when the job began.

        Raises:
            OutputError: It is one.
        """
        check_own(self.path / name, force=self._force)
        if name in self._others and not self._force:
            raise OutputError(self.path / name, NOT_OURS)

    def _clear(self) -> None:
        """Remove an earlier job's trajectory, report, and the files that came with it.

        Files that may be another kind of job's, or the user's own, stay: where the last report here is not of a
        finished job of this kind, all but trajectory and report; and all that hplan did not write. What cannot be
        removed (a folder of that name) cannot be written either, and is reported then.
        """
        finished = []
        for name in (REPORT, TOUR_REPORT, ROW_REPORT):
            with contextlib.suppress(InputError):
                if read_report(self.path / name, is_input=False).get("status") == "ok":
                    finished.append(name)
        is_ours = bool(finished) and max(finished, key=lambda name: written_s(self.path / name)) == self._report
        for pattern in self._files:  # the report, by which the others are known, is the last
            if is_ours or pattern in (self._files[0], self._report):
                for file in sorted(self.path.glob(pattern)):
                    with contextlib.suppress(OSError):
                        if self._may_replace(file):
                            file.unlink(missing_ok=True)

    def _may_replace(self, file: Path) -> bool:
        """True for hplan's own files, and with `--force` for those that have the name of a job's file."""
        return is_own(file) or (self._force and file.name in self._files)

    def _fail(self, error: BaseException, scene: str | None, robot: str | None) -> None:
        """Leave the report of a failed or interrupted job; after a fault of hplan's own, nothing at all."""
        with uninterrupted():
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
    """Run a command inside: if a signal ends it, the report in its folder says so."""
    token = _CURRENT.set(None)
    try:
        yield
    except INTERRUPTS as error:
        folder = _CURRENT.get()
        if folder is not None:
            folder.interrupted(error)
        raise
    finally:
        _CURRENT.reset(token)


def _note_inputs(arguments: argparse.Namespace) -> None:
    """Take files that the arguments name for inputs, before they are read."""
    for name, value in vars(arguments).items():
        if name not in ("out", "report"):
            for item in value if isinstance(value, list | tuple) else (value,):
                with contextlib.suppress(OSError, ValueError):
                    if isinstance(item, Path | str) and Path(item).is_file():
                        note_input(Path(item))


def read_report(path: Path, *, is_input: bool = True) -> dict[str, Any]:
    """What a report holds."""

    def fault(reason: str) -> InputError:
        return InputError(f"report file {path}: {reason}", path=str(path))

    most_report_bytes = 64_000_000
    text = ByteBudget(most_report_bytes).text(path, fault, is_input=is_input)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise fault(f"it is no JSON: {error}") from error
    if not isinstance(content, dict):
        raise fault("it is no mapping of keys")
    return content


def written_s(path: Path) -> float:
    """When a file was written [s]; minus infinity if it is not there."""
    try:
        return path.stat().st_mtime
    except OSError:
        return float("-inf")


def needs_rosbags(arguments: argparse.Namespace) -> None:
    """Refuse `--mcap`, before any work, where its messages cannot be written."""
    if arguments.mcap:
        from hplan.apps.ros.bag_writer import import_rosbags

        import_rosbags()


def write_result(
    result: Shown, motions: Mapping[str, Trajectory], folder: Path, *, mcap: bool = False, page: str = PAGE
) -> list[str]:
    """Write motions as CSV, the page of a result and, where that is wanted, its messages.

    Returns:
        The names of the last two.
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
    """Write a figure, or say why there is none, as where matplotlib is missing; gives the names of what is written."""
    from hplan.apps.view.figure_style import write_png

    try:
        return [write_png(draw(), path).name]
    except InputError as error:
        errors.print(f"no {path.name}: {error.message}", markup=False, soft_wrap=True)
        return []


def prepare_folder(folder: Path) -> None:
    """Make a folder and see that it can be written, before any work."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".hplan-{secrets.token_hex(8)}"
        with uninterrupted():
            probe.touch()
            probe.unlink()
    except FileExistsError as error:
        raise OutputError(folder, "it is a file, not a folder") from error
    except OSError as error:
        raise OutputError(folder, error.strerror or str(error)) from error


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # someone else's
        return True
    return True
