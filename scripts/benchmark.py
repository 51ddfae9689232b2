"""Measure hplan beside its peers, in one run on one machine, and write the tables and figures of the README."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.cli.job_folder import prepare_folder
from hplan.cli.options import command_parser
from hplan.cli.terminal import FAILED as FAULT
from hplan.cli.terminal import run_command
from hplan.errors import InputError, OutputError

if TYPE_CHECKING:
    from rich.console import Console

SETS = (
    *("reference", "clutter", "orchards", "replanning", "in_motion", "moving", "camera"),
    *("narrow", "fastest", "bound", "growth", "recheck"),
)

#: Random scenes: planned, replanned, and rechecked; windows and traps.
CLUTTER_SCENES, REPLANNING_SCENES, RECHECK_SCENES, NARROW_PLACES, BOUND_SCENES = 200, 20, 1000, 200, 500
QUICK_CLUTTER_SCENES, QUICK_REPLANNING_SCENES, QUICK_RECHECK_SCENES, QUICK_NARROW_PLACES = 20, 2, 25, 12
QUICK_BOUND_SCENES = 10

#: Scenes in which an obstacle moves while the arm does.
MOVING_SCENES, QUICK_MOVING_SCENES = 500, 4

#: Who else may look for faster motions than the best known (`studies.benchmark.fastest.peers`).
PEERS = ("rrtconnect", "detours", "ipopt")

#: Problems of each kind of orchard, and of the fastest, in a quick run.
QUICK_PROBLEMS = 3

_DESCRIPTION = """\
Measure hplan beside its peers: dense A*, coal's sampling of the grid, toppra on its own, and OMPL's planners where
they are installed (pip install 'hplan[bench]').
"""

_EPILOG = """\
sets:
  reference   the reference scene: stages, searches, C-space, motions, planners
  clutter     random planar scenes: success, time, length, duration, planners
  orchards    all joints among trees: success, time, duration, planners
  replanning  an obstacle of 40 moves: time, duration, beside plans from nothing
  in_motion   the same while the arm moves: splices and stops, looked at by coal alone
  moving      an obstacle that moves as the arm does: duration, waiting, safe intervals
  camera      frames of a depth camera to certified motions: time, beside their size
  narrow      windows, traps and pinches for three kinds of arm: success, time, duration, RRTConnect
  fastest     blocked scenes and trees: duration with each effort to the best known, time
  bound       planar problems: lower bound of the duration beside the certified motion, time
  growth      time and memory against grid step, obstacles and links
  recheck     certified trajectories looked at again every 0.1 ms

writes into DIR: benchmark.json, benchmark.md, benchmark-*.png

exit status:
  0  done, and no certified trajectory was found at fault
  2  bad input
  5  a certified trajectory was found at fault
"""

#: Width of tables that go to a file or a pipe.
WIDTH = 120


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    arguments = _parser().parse_args(argv)

    def command(console: Console, errors: Console) -> int:
        if not console.is_terminal:
            console.width = WIDTH
        if arguments.scenes is not None and arguments.scenes < 1:
            raise InputError("--scenes: expected a number of at least 1", scenes=arguments.scenes)
        arguments.out = arguments.out or Path(tempfile.mkdtemp(prefix="hplan-"))
        prepare_folder(arguments.out)
        results = run(arguments, errors)
        from studies.benchmark.tables import show

        show(console, results)
        for path in write(results, arguments.out):
            console.print(f"written: {path}", markup=False, soft_wrap=True)
        faults = (
            *(("recheck", "violations"), ("bound", "violations")),
            *(("orchards", "at_fault"), ("replanning", "at_fault"), ("in_motion", "at_fault")),
            ("moving", "at_fault"),
        )
        return FAULT if any(results.get(name, {}).get(key) for name, key in faults) else 0

    return run_command(command)


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add = parser.add_argument
    add("--out", type=Path, metavar="DIR", help="folder to write into (default: a temporary one, named in the end)")
    add("--quick", action="store_true", help="few repetitions and scenes: a look, not a measurement")
    add("--sets", nargs="+", choices=SETS, default=list(SETS), help="what to measure (default: all)", metavar="SET")
    add("--seed", type=int, default=0, metavar="N", help="seed of scenes and planners (default: 0)")
    add(
        "--scenes",
        type=int,
        metavar="N",
        help=f"random scenes of each set (default: {CLUTTER_SCENES} in clutter, {REPLANNING_SCENES} in replanning and "
        f"in_motion, {RECHECK_SCENES} in recheck, {NARROW_PLACES} in narrow, {MOVING_SCENES} in moving, "
        f"{BOUND_SCENES} in bound); problems of each kind of orchard and in fastest; orchards of the camera (default: "
        "all)",
    )
    trees = "folder of measured trees, a CSV of capsules each, for orchards, camera and fastest"
    add("--trees", type=Path, metavar="DIR", help=trees)
    add(
        "--improve",
        nargs="*",
        choices=PEERS,
        metavar="PEER",
        help="fastest: write durations shorter than the best known to the set's file, hplan's and those of these peers "
        f"({', '.join(PEERS)})",
    )
    return parser


def run(arguments: argparse.Namespace, errors: Console) -> dict[str, Any]:
    """Measure what was asked for."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description:32}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bars:
        task = bars.add_task("loading", total=None)

        def progress(what: str, done: int, total: int) -> None:
            bars.update(task, description=what, completed=done, total=total)

        return _measure(arguments, progress)


def _measure(arguments: argparse.Namespace, progress: Callable[[str, int, int], None]) -> dict[str, Any]:
    from studies.benchmark import camera, clutter, growth, in_motion, orchards, recheck, reference, replanning
    from studies.benchmark.fastest import bound
    from studies.benchmark.fastest import measure as fastest
    from studies.benchmark.measure import environment
    from studies.benchmark.moving import measure as moving
    from studies.benchmark.narrow import measure as narrow
    from studies.benchmark.planners import Ompl

    from hplan.robot.model import load_robot
    from hplan.scene.file import load_scene

    robot, scene = load_robot(), load_scene()
    quick, seed = arguments.quick, arguments.seed
    # The first seed of OMPL must be positive.
    ompl = Ompl.if_installed(seed + 1)
    many = arguments.scenes or (QUICK_CLUTTER_SCENES if quick else CLUTTER_SCENES)
    each = arguments.scenes or (QUICK_PROBLEMS if quick else None)
    walks = arguments.scenes or (QUICK_REPLANNING_SCENES if quick else REPLANNING_SCENES)
    most = arguments.scenes or (QUICK_RECHECK_SCENES if quick else RECHECK_SCENES)
    places = arguments.scenes or (QUICK_NARROW_PLACES if quick else NARROW_PLACES)
    passing = arguments.scenes or (QUICK_MOVING_SCENES if quick else MOVING_SCENES)
    bounded = arguments.scenes or (QUICK_BOUND_SCENES if quick else BOUND_SCENES)
    sets: dict[str, Callable[[], dict[str, Any]]] = {
        "reference": lambda: reference.measure(robot, scene, seed=seed, quick=quick, ompl=ompl, progress=progress),
        "clutter": lambda: clutter.measure(robot, seed=seed, scenes=many, ompl=ompl, progress=progress),
        "orchards": lambda: orchards.measure(robot, trees=arguments.trees, most=each, ompl=ompl, progress=progress),
        "replanning": lambda: replanning.measure(robot, seed=seed, scenes=walks, quick=quick, progress=progress),
        "in_motion": lambda: in_motion.measure(robot, seed=seed, scenes=walks, quick=quick, progress=progress),
        "moving": lambda: moving.measure(robot, seed=seed, scenes=passing, progress=progress),
        "camera": lambda: camera.measure(
            robot, trees=arguments.trees, most=arguments.scenes, seed=seed, quick=quick, progress=progress
        ),
        "narrow": lambda: narrow.measure(seed=seed, problems=places, ompl=ompl, progress=progress),
        "fastest": lambda: fastest.measure(
            trees=arguments.trees, most=each, improve=arguments.improve, progress=progress
        ),
        "bound": lambda: bound.measure(robot, scene, seed=seed, scenes=bounded, progress=progress),
        "growth": lambda: growth.measure(robot, scene, seed=seed, quick=quick, progress=progress),
        "recheck": lambda: recheck.measure(robot, scene, seed=seed, scenes=most, progress=progress),
    }
    return {
        "format": "hplan-benchmark/1",
        "settings": {"sets": [name for name in SETS if name in arguments.sets], "quick": quick, "seed": seed},
        "environment": environment(),
        **{name: measure() for name, measure in sets.items() if name in arguments.sets},
    }


def write(results: dict[str, Any], folder: Path) -> list[Path]:
    """Write JSON, Markdown and figures; figures only where matplotlib is installed.

    Raises:
        OutputError: A file cannot be written.
    """
    from studies.benchmark.figures import figures
    from studies.benchmark.tables import to_markdown

    from hplan.base.files import write_text
    from hplan.planning.report import write_report
    from hplan.view.figure_style import png_bytes, require_matplotlib

    written = [
        write_report(results, folder / "benchmark.json"),
        write_text(folder / "benchmark.md", to_markdown(results)),
    ]
    try:
        require_matplotlib()
    except InputError:
        return written
    for name, figure in figures(results).items():
        path = folder / f"{name}.png"
        try:
            path.write_bytes(png_bytes(figure))
        except OSError as error:
            raise OutputError(path, error.strerror or str(error)) from error
        written.append(path)
    return written


if __name__ == "__main__":
    sys.exit(main())
