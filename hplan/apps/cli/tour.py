"""Plan a picking tour through the fruits of a scene.

The tour begins at the scene's start. The order minimizes the total duration of the certified motions. Writes tour.csv,
tour.json and an animated scene.html.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.job_folder import MCAP, PAGE, TOUR, TOUR_REPORT, JobFolder, needs_rosbags, write_result
from hplan.apps.cli.options import add_shared, command_parser, names_robots, plan_options, robot_of, scene_among
from hplan.apps.cli.terminal import (
    describe_certificate,
    escape,
    facts_table,
    number_table,
    progress_line,
    show,
    uncovered_rows,
    unpicked_table,
)
from hplan.base.files import cut
from hplan.base.units import at_least_mm
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.tour.tour import Leg, TourOptions, TourResult

_EPILOG = """\
Without a drop-off a picked fruit does not change the arm's shape. On the way to
a drop-off it carries a ball of the thickest fruit's size at its tool.
Fruits that are blocked by other fruits are picked after those. Unreachable
fruits are listed with the reason. Times are those of the motions, without
gripping and releasing.

with --csv each: tour-01-NAME.csv, tour-02-NAME.csv, ..., each from time 0;
tour-NN-return.csv is the motion back to the start.

exit status:
  0  done
  2  bad input
  3  no fruit can be picked, or the drop-off cannot be reached
  4  the motion to the drop-off cannot be timed
  5  the motion to the drop-off is not certified
  6  no motion to the drop-off was found
"""

#: Approximate number of kernels that the command calls.
TOUR_KERNELS = 80


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    add_shared(parser, "scene", "out", "force", "robot", "parts", "contacts", "wood", "upright", scene="tour")
    add = parser.add_argument
    add("--fruits", nargs="+", metavar="NAME", help="fruits to pick (default: all)")
    add(
        "--drop-off", type=float, nargs=3, metavar=("X", "Y", "Z"), help="drop-off as a position of the tool, in metres"
    )
    add(
        "--drop-off-pose",
        type=float,
        nargs=7,
        metavar=("X", "Y", "Z", "QX", "QY", "QZ", "QW"),
        help="drop-off as a pose of the tool frame (metres, quaternion)",
    )
    add("--drop-off-joints", type=float, nargs="+", metavar="DEG", help="drop-off as joint positions, in degrees")
    add(
        "--every", type=int, metavar="K", help="maximum number of fruits carried to the drop-off at a time (default: 1)"
    )
    add("--back", action="store_true", help="return to the start at the end")
    add("--order", choices=("best", "nearest", "given"), default="best", help="order of the fruits (default: best)")
    add("--compare", action="store_true", help="also report the durations of the other orders")
    add(
        "--grasps",
        type=int,
        default=4,
        metavar="N",
        help="number of grasps per fruit considered at a time (default: 4)",
    )
    add(
        "--csv",
        choices=("one", "each"),
        default="one",
        help="one CSV for the tour, or one for each fruit, from rest to rest (default: one)",
    )
    add("--standoff", type=float, metavar="M", help="length of the straight approaches in metres (default: 0.1)")
    add_shared(parser, "detour", "capture", "pace", "tracking", "deadline", "seed", "mcap", "quiet")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Plan, write the files and print a summary; return the exit status."""
    if arguments.scene is not None and names_robots(arguments.scene):
        from hplan.apps.cli.cell import run as run_cell

        return run_cell(arguments, console, errors, tour=True)
    folder = JobFolder(arguments, (TOUR, "tour-[0-9]*-*.csv", PAGE, MCAP), TOUR_REPORT)
    with progress_line(errors, quiet=arguments.quiet, kernels=TOUR_KERNELS) as progress:
        result, files = _plan_tour_and_write(arguments, folder, errors, progress)
    if not arguments.quiet:
        _show(console, result, folder.path, files)
    return 0


def _plan_tour_and_write(
    arguments: argparse.Namespace, folder: JobFolder, errors: Console, progress: Callable[[str], None]
) -> tuple[TourResult, list[str]]:
    """Load, plan and write; return the tour and its file names."""
    progress("reading robot and scene")

    from hplan.base.data_files import shipped_scene
    from hplan.planning.report import curve_report, write_report
    from hplan.scene.file import load_scene
    from hplan.tour.tour import plan_tour

    options = plan_options(arguments, "standoff", "capture_m")
    tour = _tour_options(arguments)
    needs_rosbags(arguments)
    given = load_scene(shipped_scene("tour") if arguments.scene is None else arguments.scene)
    robot = robot_of(arguments, given)
    scene, left_out = scene_among(arguments, robot, given, errors)
    with folder.job(scene.name, robot.name):
        result = plan_tour(robot, scene, options, fruits=arguments.fruits, tour=tour, progress=progress)
        progress("writing files")
        motions = {TOUR: result.trajectory}
        if arguments.csv == "each":
            digits = max(2, len(str(len(result.legs))))
            motions = {
                f"tour-{number:0{digits}}-{_file_word(leg.name)}.csv": leg.trajectory
                for number, leg in enumerate(result.legs, start=1)
            }
        with folder.stage_files() as staging:
            files = write_result(result, motions, staging, mcap=arguments.mcap)
            curve = curve_report(result.certificate)
            write_report(result.report | curve | left_out | {"files": list(motions)}, staging / TOUR_REPORT)
    return result, [*motions, TOUR_REPORT, *files]


def _tour_options(arguments: argparse.Namespace) -> TourOptions:
    """Build the tour options from the arguments."""
    from hplan.scene.model import Goal
    from hplan.tour.tour import TourOptions

    given = [option for option in _DROP_OFFS if getattr(arguments, option) is not None]
    if len(given) > 1:
        first, second = (f"--{option.replace('_', '-')}" for option in given[:2])
        raise OptionError(second, getattr(arguments, given[1]), f"no value with {first}: a tour has one drop-off")
    drop = None
    for option in given:
        keys, values = _DROP_OFFS[option], getattr(arguments, option)
        parts = {keys[0]: values[:3], keys[1]: values[3:]} if len(keys) == 2 else {keys[0]: values}
        expected = "three finite numbers and a quaternion of length 1" if len(keys) == 2 else "finite numbers"
        try:
            drop = Goal.model_validate(parts, strict=False)
        except ValueError as error:
            raise OptionError(f"--{option.replace('_', '-')}", values, expected) from error
    chosen = {option: getattr(arguments, option) for option in _OPTIONS}
    return TourOptions(drop_off=drop, stops=arguments.csv == "each", **chosen)


#: Options of the command that are fields of `TourOptions` under the same name.
_OPTIONS = ("every", "back", "order", "compare", "grasps", "max_detour_s")

#: Options of a drop-off, and the fields of a `Goal` that each one sets.
_DROP_OFFS = {
    "drop_off": ("position",),
    "drop_off_pose": ("position", "quaternion_xyzw"),
    "drop_off_joints": ("joints_deg",),
}


def _file_word(name: str) -> str:
    """Convert a fruit's name to a part of a file name."""
    return cut(re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-")) or "fruit"


def _show(console: Console, result: TourResult, folder: Path, files: Sequence[str]) -> None:
    """Print legs, totals and unpicked fruits.

    The output fits 80 columns, unless names are long.
    """
    kinds = [
        kind
        for kind in ("transit", "approach", "retreat", "drop")
        if any(_phase_times(leg, kind) for leg in result.legs)
    ]
    rows = []
    for number, leg in enumerate(result.legs, start=1):
        times = {kind: _phase_times(leg, kind) for kind in kinds}
        if leg.fruit is None:
            times["transit"] = leg.trajectory.duration
        clearance = leg.certificate.min_clearance_m
        rows.append(
            (
                str(number),
                escape(leg.name) if leg.fruit is not None else "[dim]back to the start[/]",
                *(f"{seconds:.3f} s" if seconds else "" for seconds in times.values()),
                "" if leg.fruit is None else f"{result.picked[leg.fruit]:.2f} s",
                f"{at_least_mm(clearance)} mm" if clearance < float("inf") else "no obstacles",
            )
        )
    legs = number_table(("", "fruit", *kinds, "picked at", "clearance"), rows, texts=("fruit",))
    show(
        console,
        result.report["scene"],
        result.report["robot"],
        legs,
        *unpicked_table(result.unreached),
        facts_table(_tour_facts(result, folder, files), 0),
    )


def _phase_times(leg: Leg, kind: str) -> float:
    """Total duration of a leg's phases of one kind [s]."""
    return sum(phase.end_s - phase.start_s for phase in leg.phases if phase.name == kind)


def _tour_facts(result: TourResult, folder: Path, files: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Summary rows of the whole tour."""
    report = result.report
    fruits = len(result.order)
    yield "tour", f"[bold]{result.duration:.3f} s[/], {fruits} fruit{'s' if fruits != 1 else ''}"
    if "expected_fruit" in report:
        yield "caught", f"{report['expected_fruit']:.1f} fruits expected within the gripper's capture range"
    totals = {order: seconds for order, seconds in report["totals_s"].items() if order != "fruits"}
    if len(totals) > 1:
        compared = ", ".join(f"{order} {seconds:.2f} s" for order, seconds in totals.items())
        yield "orders", f"{compared} ({report['totals_s']['fruits']} fruits)"
    yield "certificate", describe_certificate(result.certificate.verified)
    yield from uncovered_rows(result.certificate.uncovered_links)
    planner = report["planner"]
    yield "time", f"{1e-3 * planner['time_ms']:.1f} s, {planner['motions_planned']} motions planned"
    shown = files if len(files) <= 4 else [files[0], "...", *files[-3:]]
    yield "files", f"{escape(folder)}: {escape(', '.join(shown))}"
