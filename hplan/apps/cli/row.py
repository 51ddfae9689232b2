"""Choose stops along a tree row and plan a tour at each.

The stops together pick all reachable fruit, or the fraction --share of it. Writes stop-NN.csv for the controller and
stop-NN.html for each stop, scene.html with all of them, row.json and, if matplotlib is installed, row.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from html import escape as html_escape
from typing import TYPE_CHECKING

from hplan.apps.cli.job_folder import PAGE, ROW_REPORT, JobFolder, write_figure, write_result
from hplan.apps.cli.options import add_shared, command_parser, plan_options, robot_of, scene_with_wood
from hplan.apps.cli.terminal import (
    describe_certificate,
    escape,
    facts_table,
    number_table,
    percent,
    progress_line,
    show,
    unpicked_facts,
)
from hplan.base.units import at_least_mm

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.scene.model import Scene
    from hplan.tour.row import RowResult

_EPILOG = """\
The scene shows the row as seen from the base at y = 0 on the first side. The
row runs along y, at --distance from the base. Positions of stops are along y.

exit status:
  0  done
  2  bad input
  3  no fruit can be picked from any stop
  5, 6  as for hplan tour
"""

#: File name of the figure.
FIGURE = "row.png"

#: Options of the command that are fields of `RowOptions` under the same name.
_OPTIONS = ("step", "heights", "objective", "share", "lift_speed", "settling", "detaching", "carried")


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    add = parser.add_argument
    add("scene", help="scene file or name of a shipped scene")
    add_shared(parser, "out", "force", "robot", "parts", "wood")
    add(
        "--distance",
        type=float,
        metavar="M",
        help="distance from the base's axis to the row in metres (default: that of the scene's trunks, else 1.4)",
    )
    add("--one-side", action="store_true", help="stop on the first side only (default: on both)")
    add("--step", type=float, default=0.1, metavar="M", help="spacing of candidate stops in metres (default: 0.1)")
    add(
        "--heights",
        type=float,
        nargs="+",
        default=[0.0],
        metavar="M",
        help="heights of a lift or mast above the scene's, in metres (default: 0)",
    )
    add("--objective", choices=("stops", "time"), default="stops", help="cost to minimize (default: stops)")
    add("--share", type=float, default=1.0, metavar="F", help="fraction of the reachable fruits to pick (default: 1)")
    add("--drive-speed", type=float, default=0.5, metavar="M/S", help="driving speed in m/s (default: 0.5)")
    add(
        "--drive-acceleration",
        type=float,
        default=0.5,
        metavar="M/S2",
        help="driving acceleration in m/s2 (default: 0.5)",
    )
    add("--lift-speed", type=float, default=0.1, metavar="M/S", help="speed of the lift in m/s (default: 0.1)")
    add(
        "--settling",
        type=float,
        default=0.5,
        metavar="S",
        help="time from standstill until the arm moves, in seconds (default: 0.5)",
    )
    add("--detaching", type=float, default=1.0, metavar="S", help="time to detach a fruit in seconds (default: 1)")
    add("--carried", nargs="+", default=[], metavar="NAME", help="obstacles that the vehicle carries")
    add("--workers", type=int, default=1, metavar="N", help="number of processes that evaluate candidates (default: 1)")
    add_shared(parser, "detour", "effort", "seed", "pace", "tracking", "quiet")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Plan, write the files and print a summary; return the exit status."""
    folder = JobFolder(arguments, ("stop-[0-9]*.csv", "stop-[0-9]*.html", PAGE, FIGURE), ROW_REPORT)
    with progress_line(errors, quiet=arguments.quiet) as progress:
        result, files = _plan_row_and_write(arguments, folder, errors, progress)
    if not arguments.quiet:
        _show_row(console, result, f"{folder.path}: {files[0]}, ..., {', '.join(files[-3:])}")
    return 0


def _plan_row_and_write(
    arguments: argparse.Namespace, folder: JobFolder, errors: Console, progress: Callable[[str], None]
) -> tuple[RowResult, list[str]]:
    """Load, plan and write; return the result and its file names."""
    progress("reading robot and scene")

    from hplan.apps.view.figures import draw_row
    from hplan.base.files import HTML_COMMENT, write_marked
    from hplan.planning.report import write_report
    from hplan.scene.file import load_scene
    from hplan.tour.row import RowOptions, plan_row
    from hplan.tour.tour import TourOptions

    scene = scene_with_wood(arguments, load_scene(arguments.scene))
    row = RowOptions(
        distance=_trunk_distance(scene) if arguments.distance is None else arguments.distance,
        both=not arguments.one_side,
        speed=arguments.drive_speed,
        acceleration=arguments.drive_acceleration,
        **{option: getattr(arguments, option) for option in _OPTIONS},
    )
    options, tour = plan_options(arguments, "effort"), TourOptions(max_detour_s=arguments.max_detour_s)
    robot = robot_of(arguments, scene)
    with folder.job(scene.name, robot.name):
        result = plan_row(robot, scene, options, row=row, tour=tour, workers=arguments.workers, progress=progress)
        progress("writing files")
        digits = max(2, len(str(len(result.stops))))
        names = [f"stop-{number:0{digits}}" for number in range(1, len(result.stops) + 1)]
        with folder.stage_files() as staging:
            for name, stop in zip(names, result.stops, strict=True):
                write_result(stop.tour, {f"{name}.csv": stop.tour.trajectory}, staging, page=f"{name}.html")
            write_marked(staging / PAGE, _index(result, names), HTML_COMMENT)
            figure = write_figure(lambda: draw_row(result), staging / FIGURE, errors)
            write_report({**result.report, "files": [f"{name}.csv" for name in names]}, staging / ROW_REPORT)
    return result, [*(f"{name}.csv" for name in names), ROW_REPORT, PAGE, *figure]


def _trunk_distance(scene: Scene) -> float:
    """Mean distance of the trunks' feet along x [m]; the default of `RowOptions` without trunks."""
    from hplan.scene.obstacles import Capsule
    from hplan.tour.row import RowOptions

    trunks = [one for one in scene.obstacles if isinstance(one, Capsule) and one.name.endswith("trunk 1")]
    return sum(one.start[0] for one in trunks) / len(trunks) if trunks else RowOptions.distance


def _index(result: RowResult, names: list[str]) -> str:
    """HTML page with links to the pages of the stops."""
    links = "".join(
        f'<a href="{name}.html" target="stop">{number}<small> side {stop.place.side}, {stop.place.along:.1f} m, '
        f"{len(stop.tour.order)} fruits</small></a> "
        for number, (name, stop) in enumerate(zip(names, result.stops, strict=True), start=1)
    )
    title = html_escape(f"{result.scene.name}, {len(result.stops)} stops")
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>'
        "body{margin:0;display:flex;flex-direction:column;height:100vh;font:14px sans-serif;color:#22303C}"
        "nav{padding:.5em 1em;overflow-x:auto;white-space:nowrap}nav a{margin-right:1.2em;color:#0072B2}"
        "small{color:#7A8793}iframe{flex:1;border:0}</style>"
        f'<nav><b>{title}</b> &nbsp; {links}</nav><iframe name="stop" src="{names[0]}.html"></iframe></html>\n'
    )


def _show_row(console: Console, result: RowResult, files: str) -> None:
    """Print the stops and the totals in at most 80 columns."""
    report = result.report
    rows = []
    for number, stop in enumerate(report["stops"], start=1):
        count, clearance = len(stop["picked"]), stop["min_clearance_m"]
        rows.append(
            (
                str(number),
                str(stop["side"]),
                f"{stop['along']:.2f} m",
                f"{stop['height']:.2f} m",
                str(count),
                f"{stop['arrival_s']:.1f} s",
                f"{stop['motion_s']:.1f} s",
                f"{stop['motion_s'] / count:.2f} s",
                f"{at_least_mm(clearance, 1)} mm",
            )
        )
    headings = "", "side", "along", "height", "fruits", "arrival", "motion", "per fruit", "clearance"
    of = f"{report['picked']} of {report['fruits']}; {report['reachable']} can be picked from some stop"
    facts = [("picked", f"[bold]{percent(report['share_picked'])} %[/]: {of}")]
    facts += unpicked_facts(report["not_picked"], report["obstacles"])
    if len(report["trees"]) > 1:
        told = ", ".join(f"{name} {one['picked']} of {one['fruits']}" for name, one in report["trees"].items())
        facts.append(("trees", escape(told)))
    parts = ", ".join(f"{name[:-2]} {report[name]:.1f} s" for name in ("motion_s", "driving_s", "detaching_s"))
    with_drive = f"{report['total_s_per_fruit']:.2f} s with driving and detaching"
    facts += [
        ("time", f"{report['total_s']:.1f} s: {parts}"),
        ("per fruit", f"{report['motion_s_per_fruit']:.2f} s of motion, [bold]{with_drive}[/]"),
        ("per hour", f"{report['fruit_per_hour']:.0f} fruits"),
    ]
    if "max_force_n" in report:
        loads = f"at most {report['max_force_n']:.2g} N and {report['max_stress_mpa']:.2g} MPa"
        facts.append(("limbs", f"{loads} on limbs and stalks that are pushed"))
    facts += [
        ("certificate", describe_certificate(all(stop["verified"] for stop in report["stops"]))),
        ("files", escape(files)),
    ]
    show(console, report["scene"], report["robot"], number_table(headings, rows), facts_table(facts, 0))
