"""The folder that a planning command writes into: free of an earlier job's files, and filled at once or not at all.

Files are made in a folder of their own inside it and then moved, the report before any trajectory. So wherever a job
ends, by a fault, a full disk or a signal, no trajectory stands there without the report that belongs to it.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hplan.base.files import check_replaceable
from hplan.cli.options import CommandParser, named_output
from hplan.errors import HplanError, InputError, OutputError

#: Where files go unless something else is said.
OUT = Path("out")

#: Files of a finished job: of one motion, of a tour, of both.
TRAJECTORY, REPORT = "trajectory.csv", "report.json"
TOUR, TOUR_REPORT = "tour.csv", "tour.json"
PAGE = "scene.html"

#: The scene of a path that was given, with its ends as start and goal: what is certified is about this one.
SCENE = "scene.yaml"

#: The motion as messages of ROS 2, where it is asked for.
MCAP = "motion.mcap"

#: Files of the joint space, where they are asked for.
CSPACE_PAGE, CSPACE_FIGURE = "cspace.html", "cspace.png"

#: Files that go with the report of one motion.
PLAN_FILES = (TRAJECTORY, PAGE, MCAP, CSPACE_PAGE, CSPACE_FIGURE)

#: Name of the folder in which a process makes its files.
_STAGING = ".hplan-job-"


class JobFolder:
    """A folder, and the files in it that are a job's.

    Attributes:
        path: The folder.
        robot: Name of the robot, once it is known; for the report of a failure.
        scene: Name of the scene, likewise.
    """

    def __init__(self, path: Path, files: Sequence[str], report: str) -> None:
        """Change nothing yet.

        Args:
            path: The folder.
            files: Names of a job's files, or patterns of them.
            report: Name of the report.
        """
        self.path = path
        self.robot: str | None = None
        self.scene: str | None = None
        self._files = (*files, report)
        self._report = report

    @contextmanager
    def job(self) -> Iterator[None]:
        """Make the folder ready; should the job inside fail, leave nothing of it but its report.

        Raises:
            OutputError: The folder cannot be made or written.
        """
        prepare_folder(self.path)
        self.clear()
        try:
            yield
        except BaseException as error:
            self.fail(error)
            raise

    @contextmanager
    def filling(self) -> Iterator[Path]:
        """A folder to write files into, which come to stand in this one when the block ends.

        Raises:
            OutputError: A file cannot be written, or moved to its place.
        """
        staging = self.path / f"{_STAGING}{os.getpid()}"
        try:
            try:
                staging.mkdir()
                yield staging
                for file in sorted(staging.iterdir(), key=lambda file: (file.suffix == ".csv", file.name)):
                    check_replaceable(self.path / file.name, self.path / file.name)
                    file.replace(self.path / file.name)
            except OutputError as error:
                raise OutputError(self.path / error.path.name, error.reason) from error
            except OSError as error:
                name = Path(error.filename or staging).name
                raise OutputError(self.path / name, error.strerror or str(error)) from error
        finally:
            shutil.rmtree(staging, ignore_errors=True)

    def holds(self, file: Path) -> bool:
        """True if a file is in the folder and has the name of one of a job's."""
        place = file.resolve()
        return place.parent == self.path.resolve() and any(place.match(pattern) for pattern in self._files)

    def clear(self) -> None:
        """Remove the files of a job; an earlier job's trajectory must not be taken for the result of this one.

        What cannot be removed (a folder of that name) cannot be written either, and is reported then. What processes
        that were killed have left goes too.
        """
        for pattern in self._files:
            for file in sorted(self.path.glob(pattern)):
                with contextlib.suppress(OSError):
                    file.unlink(missing_ok=True)
        for staging in self.path.glob(f"{_STAGING}*"):
            number = staging.name.removeprefix(_STAGING)
            if number.isdecimal() and not _runs(int(number)):
                shutil.rmtree(staging, ignore_errors=True)

    def fail(self, error: BaseException) -> None:
        """Leave the report of a failed job; after a signal or a fault of hplan's own, nothing at all."""
        from hplan.planning.report import failure_report, write_report

        self.clear()
        if isinstance(error, HplanError):
            with contextlib.suppress(OutputError):
                write_report(failure_report(error, scene=self.scene, robot=self.robot), self.path / self._report)


def needs_rosbags(arguments: argparse.Namespace) -> None:
    """Refuse `--mcap`, before any work, where its messages cannot be written.

    Raises:
        InputError: rosbags is not installed.
    """
    if arguments.mcap:
        from hplan.ros.bag_writer import import_rosbags

        import_rosbags()


def prepare_folder(folder: Path) -> None:
    """Make a folder and see that it can be written, before any work.

    Raises:
        OutputError: It cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".hplan-probe"
        probe.touch()
        probe.unlink()
    except FileExistsError as error:
        raise OutputError(folder, "it is a file, not a folder") from error
    except OSError as error:
        raise OutputError(folder, error.strerror or str(error)) from error


def fail_on_usage_errors(parser: CommandParser, out: Path, folder_at: Callable[[Path], JobFolder]) -> None:
    """Make arguments that cannot be understood a failed job as well, if the folder that they name is there.

    Args:
        parser: Of a command that writes into the folder `--out`.
        out: Where files go unless something else is said.
        folder_at: The job's folder at a path.
    """

    def refuse(message: str, words: Sequence[str]) -> None:
        path = named_output(words, out)
        if path is not None and path.is_dir():
            folder_at(path).fail(InputError(message))

    parser.on_usage_error = refuse


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # someone else's
        return True
    return True
