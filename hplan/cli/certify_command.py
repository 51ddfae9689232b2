"""The command `hplan certify`: judge a trajectory of anyone's, or what a plan left in its folder.

Heavy imports wait until the arguments are understood.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.cli.terminal import (
    FAILED,
    CommandParser,
    add_robot,
    add_scene,
    add_tracking,
    command_parser,
    loading,
    percent,
    run_command,
    tracking_of,
)
from hplan.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.verification.certificate import Certificate

#: Files of a job that are read here.
TRAJECTORY, REPORT = "trajectory.csv", "report.json"

_DESCRIPTION = """\
Judge a trajectory in a scene: clearance, limits, start and goal, for all times. Of a folder written by hplan its
trajectory is judged, as its report says it was, and robot, scene and trajectory are compared with those of the report.
"""

_EXIT_STATUS = """\
exit status:
  0  certified
  2  bad input
  5  not certified, or the folder's report is about something else
"""


def main(argv: Sequence[str] | None = None, *, prog: str = "hplan certify") -> int:
    """Run the command; returns the exit status."""
    arguments = _parser(prog).parse_args(argv)
    return run_command(lambda console, _: _certify(arguments, console))


def _parser(prog: str) -> CommandParser:
    parser = command_parser(_DESCRIPTION, _EXIT_STATUS, prog=prog)
    add = parser.add_argument
    add("trajectory", type=Path, help="CSV, or the folder of a job")
    add_scene(parser)
    add_robot(parser)
    add_tracking(parser)
    add("--sigmas", type=float, metavar="K", help="an uncertain obstacle grows by K sigma (default: 3)")
    add("--goal-contact", choices=("approach", "motion"), help="when the last link may touch the fruit that is "
        "the goal: on a straight approach, or during the whole motion (default: approach)")  # fmt: skip
    add("--any-ends", action="store_true", help="start, goal and locked joints of the scene are not compared")
    add("--moving-ends", action="store_true", help="the motion need not begin and end at rest")
    add("--report", type=Path, metavar="FILE", help="write what was shown as JSON")
    add("--json", action="store_true", help="print it as JSON instead of a summary")
    add("--quiet", action="store_true", help="no summary")
    # A folder's report gives what is not given here.
    parser.set_defaults(tracking_error=None, tracking_delay=None)
    return parser


def _certify(arguments: argparse.Namespace, console: Console) -> int:
    """Read, judge, compare, say; returns the exit status."""
    with loading():
        from hplan.planning.report import certificate_report, report_text, versions, write_report
        from hplan.problem.options import PlanOptions
        from hplan.robot.model import load_robot
        from hplan.scene.file import load_scene
        from hplan.timing.trajectory import read_csv
        from hplan.verification.certificate import certify

    path: Path = arguments.trajectory
    told = _read_report(path / REPORT) if path.is_dir() else None
    _fill_in(arguments, told)
    tracking = tracking_of(arguments)
    options = PlanOptions(tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s, sigmas=arguments.sigmas)
    robot = load_robot(arguments.robot, limits=arguments.limits)
    scene = load_scene(arguments.scene)
    certificate = certify(
        robot,
        scene,
        read_csv(path / TRAJECTORY if told is not None else path),
        tracking_error=tracking.still_rad,
        tracking_delay_s=tracking.delay_s,
        sigmas=arguments.sigmas,
        goal_contact=arguments.goal_contact,
        check_ends=not arguments.any_ends,
        rest_to_rest=not arguments.moving_ends,
    )
    differs = [] if told is None else _differing(certificate, told)
    report = {
        "status": "ok" if certificate.verified and not differs else "failed",
        "scene": scene.name,
        "robot": robot.name,
        "differs": differs,
        "certificate": certificate_report(certificate, options),
        "versions": versions(),
    }
    if arguments.report is not None:
        write_report(report, arguments.report)
    if arguments.json:
        console.file.write(report_text(report))
    elif not arguments.quiet:
        _show(console, report)
    return 0 if report["status"] == "ok" else FAILED


def _read_report(path: Path) -> dict[str, Any]:
    """The certificate of a job's report.

    Raises:
        InputError: There is none, or it is no report of a plan.
    """
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"report file {path}: {error.strerror}", path=str(path)) from error
    except ValueError as error:
        raise InputError(f"report file {path}: it is no JSON: {error}", path=str(path)) from error
    found = told.get("certificate") if isinstance(told, dict) else None
    numbers = ("tracking_error_rad", "tracking_delay_s", "sigmas")
    if (
        not isinstance(found, dict)
        or not isinstance(found.get("digests"), dict)
        or not all(type(found.get(key)) in (int, float) for key in numbers)
    ):
        reason = f"it is no report of a plan with digests; {path.parent / TRAJECTORY} can be judged by itself"
        raise InputError(f"report file {path}: {reason}", path=str(path))
    return found


def _fill_in(arguments: argparse.Namespace, told: dict[str, Any] | None) -> None:
    """Take what was not asked for from a report, else from the defaults."""
    told = told or {"tracking_error_rad": 0.0, "tracking_delay_s": 0.0, "sigmas": 3.0}
    defaults = {
        "tracking_error": math.degrees(told["tracking_error_rad"]),
        "tracking_delay": 1e3 * told["tracking_delay_s"],
        "sigmas": told["sigmas"],
        "goal_contact": "motion" if told.get("goal_contact") == "motion" else "approach",
    }
    for name, value in defaults.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, value)


def _differing(certificate: Certificate, told: dict[str, Any]) -> list[str]:
    """Which of robot, scene and trajectory are not those of a report."""
    return [what for what, digest in vars(certificate.digests).items() if told["digests"].get(what) != digest]


def _show(console: Console, report: dict[str, Any]) -> None:
    """Rows that fit 80 columns, unless names are long."""
    from rich.markup import escape
    from rich.table import Table

    proof = report["certificate"]
    table = Table.grid(padding=(0, 2, 0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    clearance = "inf" if proof["nearest"] is None else f"{1e3 * proof['min_clearance_m']:.3f}"
    if proof["verified"]:
        table.add_row("certificate", "[bold green]verified[/]")
        table.add_row("clearance", f"{clearance} mm or more, shown for all times")
    else:
        table.add_row("certificate", "[bold red]NOT VERIFIED[/]")
        for violation in proof["violations"]:
            table.add_row("", escape(violation))
        table.add_row("clearance", f"{clearance} mm, the smallest found")
    table.add_row("limits used", ", ".join(f"{k} {percent(v)}" for k, v in proof["limit_use"].items()) + " %")
    error, delay = math.degrees(proof["tracking_error_rad"]), 1e3 * proof["tracking_delay_s"]
    table.add_row("covered", f"tracking error {error:g} deg, delay {delay:g} ms; {proof['sigmas']:g} sigma")
    if proof["contact_s"] is not None:
        begin, end = proof["contact_s"]
        rule = "on a straight approach" if proof["goal_contact"] == "approach" else "during the whole motion"
        table.add_row("contact", f"last link and fruit, {rule}: {begin:.3f} to {end:.3f} s")
    for what in report["differs"]:
        table.add_row("differs", f"[bold red]the {what} is not the one of {REPORT}[/]")
    for what, digest in proof["digests"].items():
        table.add_row(what, digest[:23])
    console.print(f"\n[bold]{escape(report['scene'])}[/] with [bold]{escape(report['robot'])}[/]\n")
    console.print(table)
    console.print()
