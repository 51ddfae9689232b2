"""The folder that a planning command writes into: filled at once or not at all.

A job begins when all that it reads has been read: before that no file is changed. Files are made in a folder of their
own inside it and then moved, the report before any trajectory. So wherever a job ends, by a fault, a full disk or a
signal, no trajectory stands there without the report that belongs to it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.base.files import ByteBudget, check_replaceable, inputs
from hplan.errors import HplanError, InputError, OptionError, OutputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from hplan.apps.view.playback import Shown
    from hplan.trajectory.trajectory import Trajectory

#: Files of a finished job: of one motion, of a tour, of a row, of all.
TRAJECTORY, REPORT = "trajectory.csv", "report.json"
TOUR, TOUR_REPORT = "tour.csv", "tour.json"
ROW_REPORT = "row.json"
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


class JobFolder:
    """A folder, and the files in it that are a job's."""

    def __init__(self, path: Path, files: Sequence[str], report: str) -> None:
        """Change nothing yet.

        Args:
            files: Names of a job's files, or patterns of them; first its trajectory.
        """
        self.path = path
        self._files = (*files, report)
        self._report = report

    @contextmanager
    def job(self, scene: str, robot: str) -> Iterator[None]:
        """Make the folder ready; should the job inside fail, leave nothing of it, or an earlier one, but its report.

        An option that does not fit robot or scene is no failed job: what stands there stays.

        Args:
            scene: Name of the scene, for the report of a failure.
        """
        for path in inputs():
            if path.parent == self.path.resolve() and any(path.match(pattern) for pattern in self._files):
                raise OptionError("--out", str(self.path), f"another folder than that of {path}, which is read")
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
            self._fail(error, scene, robot)
            raise

    @contextmanager
    def filling(self) -> Iterator[Path]:
        """A folder to write files into, which come to stand in this one when the block ends."""
        staging = self.path / f"{_STAGING}{os.getpid()}"
        moved: list[Path] = []
        try:
            try:
                self._clear()  # so that no trajectory is seen beside another's report
                staging.mkdir()
                yield staging
                made = sorted(staging.iterdir(), key=lambda file: (file.suffix == ".csv", file.name))
                for file in made:
                    check_replaceable(self.path / file.name, self.path / file.name)
                moved.extend(file.replace(self.path / file.name) for file in made)
            except OutputError as error:
                raise OutputError(self.path / error.path.name, error.reason) from error
            except OSError as error:
                name = Path(error.filename or staging).name
                raise OutputError(self.path / name, error.strerror or str(error)) from error
        except BaseException:
            for file in moved:
                file.unlink(missing_ok=True)
            raise
        finally:
            shutil.rmtree(staging, ignore_errors=True)

    def _clear(self) -> None:
        """Remove an earlier job's trajectory, report, and the files that came with it.

        Files that may be another kind of job's, or the user's own, stay: where the last report here is not of a
        finished job of this kind, all but trajectory and report. What cannot be removed (a folder of that name) cannot
        be written either, and is reported then.
        """
        finished = []
        for name in (REPORT, TOUR_REPORT, ROW_REPORT):
            with contextlib.suppress(InputError):
                if read_report(self.path / name, is_input=False).get("status") == "ok":
                    finished.append(name)
        is_ours = bool(finished) and max(finished, key=lambda name: written_s(self.path / name)) == self._report
        for pattern in self._files:
            if is_ours or pattern in (self._files[0], self._report):
                for file in sorted(self.path.glob(pattern)):
                    with contextlib.suppress(OSError):
                        file.unlink(missing_ok=True)

    def _fail(self, error: BaseException, scene: str, robot: str) -> None:
        """Leave the report of a failed job; after a signal or a fault of hplan's own, nothing at all."""
        from hplan.planning.report import failure_report, write_report

        self._clear()
        if isinstance(error, HplanError):
            with contextlib.suppress(OutputError):
                write_report(failure_report(error, scene=scene, robot=robot), self.path / self._report)


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
        probe = folder / ".hplan-probe"
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
