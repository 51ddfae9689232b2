"""Show a motion: write its animated page and serve it until interrupted.

Given a folder of `plan`, `tour` or `time --scene`, the command shows the latest job's motion in its own scene. A scene
that neither ships with hplan nor is in the folder must be given. The pages written by `row` are served unchanged.
"""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.finished_job import FinishedJob
from hplan.apps.cli.job_folder import PAGE, REPORT, ROW_REPORT, TOUR_REPORT, written_s
from hplan.apps.cli.options import add_shared, check_output_file, command_parser, robot_of
from hplan.apps.cli.terminal import FAILED
from hplan.base.files import ByteBudget, is_folder
from hplan.errors import InputError, OptionError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.apps.view.playback import Playback
    from hplan.apps.view.server import LiveView
    from hplan.robot.model import Robot
    from hplan.scene.model import Scene

_EPILOG = """\
Robot, scene and trajectory are compared with those of the folder's report. If
they differ, nothing is written; the CSV by itself can still be shown.

exit status:
  0  done
  1  the live view does not start
  2  bad input
  5  robot, scene or trajectory differ from the folder's report
"""


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    add = parser.add_argument
    add("motion", type=Path, metavar="FOLDER_OR_CSV", help="output folder of a plan, tour or row, or a trajectory CSV")
    add_shared(parser, "scene", "robot", "parts", scene="the job's, or the paper's reference scene")
    add("--out", type=Path, metavar="FILE", help="write the page to this file and do not serve it (default: scene.html "
        "in the folder; for a CSV NAME.html next to it)")  # fmt: skip
    add_shared(parser, "force")
    add("--no-serve", action="store_true", help="write the page without serving it")
    add("--quiet", action="store_true", help="do not print the name of the written file")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Compare with the report, write and serve; return the exit status."""
    from hplan.apps.view.page import write_page
    from hplan.apps.view.playback import Playback
    from hplan.certificate.digests import Digests
    from hplan.scene.file import load_scene
    from hplan.trajectory.trajectory import read_csv

    path: Path = arguments.motion
    if is_folder(path) and written_s(path / ROW_REPORT) > max(written_s(path / name) for name in (REPORT, TOUR_REPORT)):
        return _view_row(arguments, console)
    job = FinishedJob(path, tours=True) if is_folder(path) else None
    out = arguments.out or (path.with_suffix(".html") if job is None else path / PAGE)
    trajectory = read_csv(path) if job is None else job.trajectory()
    scene = load_scene(job.scene if arguments.scene is None and job is not None else arguments.scene)
    robot = robot_of(arguments, scene, job)
    check_output_file(out, force=arguments.force)
    playback = Playback(trajectory)
    if job is not None:
        differs = job.list_differences(Digests(robot, scene, trajectory))
        for what in differs:
            errors.print(f"the {what} is not that of {job.path}", markup=False, soft_wrap=True)
        if differs:
            return FAILED
        playback = job.playback(trajectory)
    write_page(robot, scene, playback, out)
    if not arguments.quiet:
        console.print(f"written: {out}", markup=False, soft_wrap=True)
    if not arguments.no_serve and arguments.out is None:
        serve_page(console, robot, scene, playback)
    return 0


def _view_row(arguments: argparse.Namespace, console: Console) -> int:
    """Serve the pages written by `hplan row`; return the exit status."""
    from hplan.apps.view.server import LiveView

    folder: Path = arguments.motion
    if arguments.out is not None:
        raise OptionError("--out", str(arguments.out), f"no value: the pages of a row are in its folder, {folder}")
    try:
        names = [PAGE, *sorted(path.name for path in folder.glob("stop-[0-9]*.html"))]
        most_page_bytes = 64_000_000
        pages = {name: ByteBudget(most_page_bytes).read(folder / name) for name in names}
    except (OSError, ValueError) as error:
        raise InputError(f"page of {folder}: {getattr(error, 'strerror', None) or error}", path=str(folder)) from error
    if not arguments.quiet:
        console.print(f"written by hplan row: {folder / PAGE}", markup=False, soft_wrap=True)
    if not arguments.no_serve:
        wait_for(console, LiveView(pages.pop(PAGE), pages))
    return 0


def serve_page(console: Console, robot: Robot, scene: Scene, playback: Playback) -> None:
    """Serve the animated scene until interrupted."""
    from hplan.apps.view.page import serve

    wait_for(console, serve(robot, scene, playback))


def wait_for(console: Console, view: LiveView) -> None:
    """Print the address of a view and wait until interrupted."""
    with view as server:
        console.print(f"serving the scene at {server.url} (interrupt to stop)")
        with contextlib.suppress(KeyboardInterrupt):
            server.wait()
