"""Certify a trajectory in a scene: clearance, limits, start and goal.

The certificate holds for all times of the motion, not only at samples.

Given a folder that hplan wrote, the command certifies its trajectory with the settings of its report, and compares
robot, scene and trajectory with the digests in the report.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.apps.cli.finished_job import FinishedJob
from hplan.apps.cli.job_folder import REPORT
from hplan.apps.cli.options import (
    WOOD,
    add_shared,
    check_output_file,
    command_parser,
    names_robots,
    robot_of,
    scene_among,
    tracking_of,
)
from hplan.apps.cli.terminal import (
    FAILED,
    describe_certificate,
    escape,
    facts_table,
    hand_out,
    held_rows,
    pause_garbage_collection,
    percent,
    risk_words,
    show,
    tilt_words,
    uncovered_rows,
)
from hplan.base.files import is_folder
from hplan.base.units import at_least_mm
from hplan.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

_CERTIFY_STATUS = """\
exit status:
  0  certified
  2  bad input
  5  not certified, or robot, scene or trajectory differ from the report's
"""


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _CERTIFY_STATUS, prog=prog)
    add = parser.add_argument
    add("trajectory", type=Path, help="trajectory CSV, or output folder of a plan")
    add_shared(parser, "scene", "robot", "parts", "contacts", "wood", "upright", "tracking", "sigmas", "risk")
    add("--goal-contact", choices=("approach", "motion"), help="when the last link may touch the goal "
        "fruit: on the straight approach or during the whole motion (default: approach)")  # fmt: skip
    add("--interpolation", choices=("cubic", "quintic", "linear"), help="curve of the controller between samples: "
        "from positions and velocities, with accelerations too, or straight lines (default: cubic)")  # fmt: skip
    add("--velocity-jumps", action="store_true", help="with --interpolation linear: let the velocity jump at "
        "samples; acceleration, torque and rest at the ends are not checked")  # fmt: skip
    add("--begin", type=float, default=0.0, metavar="S", help="start time of the motion in seconds, on the clock of "
        "the moving obstacles' tracks (default: 0)")  # fmt: skip
    add(
        "--any-ends",
        action="store_true",
        help="do not compare the motion with the scene's start, goal and locked joints",
    )
    add("--moving-ends", action="store_true", help="do not require rest at the start and the end of the motion")
    add("--report", type=Path, metavar="FILE", help="write the certificate as JSON to this file")
    add_shared(parser, "force")
    add("--json", action="store_true", help="print the certificate as JSON instead of a summary")
    add("--quiet", action="store_true", help="print no summary")
    # Settings that are omitted come from the report in the folder.
    parser.set_defaults(tracking_error=None, tracking_error_m=None, tracking_delay=None, sigmas=None)
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Certify, compare with the report and print; return the exit status."""
    if arguments.scene is not None and names_robots(arguments.scene):
        from hplan.apps.cli.cell import certify_cell_motion as certify_cell

        _fill_in(arguments, None)
        return certify_cell(arguments, console)
    with pause_garbage_collection():
        from hplan.certificate.certificate import certify
        from hplan.planning.options import PlanOptions
        from hplan.planning.report import certificate_report, far_report, versions
        from hplan.robot.tracking import TrackingModel
        from hplan.scene.file import load_scene
        from hplan.trajectory.trajectory import read_csv

    path: Path = arguments.trajectory
    if path.suffix in (".yaml", ".yml", ".json") and str(arguments.scene).endswith(".csv"):
        raise InputError(f"the trajectory comes before the scene: hplan certify {arguments.scene} {path}")
    job = FinishedJob(path) if is_folder(path) else None
    given = load_scene(job.scene if arguments.scene is None and job is not None else arguments.scene)
    robot = robot_of(arguments, given, job)
    _fill_in(arguments, job)
    tracking = tracking_of(arguments)
    options = PlanOptions(tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s, sigmas=arguments.sigmas)
    scene, _left_out = scene_among(arguments, robot, given, errors)
    trajectory = read_csv(path) if job is None else job.trajectory()
    if arguments.report is not None:
        check_output_file(arguments.report, "--report", force=arguments.force)
    certificate = certify(
        robot,
        scene,
        trajectory,
        tracking_error=tracking.still_rad,
        tracking_delay_s=tracking.delay_s,
        sigmas=arguments.sigmas,
        risk=arguments.risk,
        goal_contact=arguments.goal_contact,
        contacts=() if job is None else job.contacts(scene),
        check_ends=not arguments.any_ends,
        rest_to_rest=not arguments.moving_ends,
        begin_s=arguments.begin,
        interpolation=arguments.interpolation,
        velocity_jumps=arguments.velocity_jumps,
    )
    differs = [] if job is None else job.list_differences(certificate.digests)
    report = {
        "status": "ok" if certificate.verified and not differs else "failed",
        "scene": scene.name,
        "robot": robot.name,
        "interpolation": arguments.interpolation or trajectory.interpolation,
        "differs": differs,
        **far_report(robot, scene),
        "certificate": certificate_report(certificate, options, scene),
        "versions": versions(),
    }
    error = TrackingModel(tracking.still_rad).summary(robot.slides)
    hand_out(arguments, console, report, lambda: _show_certificate(console, report, error))
    return 0 if report["status"] == "ok" else FAILED


def _fill_in(arguments: argparse.Namespace, job: FinishedJob | None) -> None:
    """Set omitted options from the job's report, or else to their defaults."""
    settings: dict[str, Any] = {"tracking_error_rad": 0.0, "tracking_delay_s": 0.0, "sigmas": 3.0}
    if job is not None:
        settings = job.report["certificate"]
    defaults = {
        "tracking_error": math.degrees(settings["tracking_error_rad"]),
        "tracking_error_m": 0.0,
        "tracking_delay": 1e3 * settings["tracking_delay_s"],
        "sigmas": settings["sigmas"],
        "risk": settings.get("risk", {}).get("asked"),
        "goal_contact": "motion" if settings.get("goal_contact") == "motion" else "approach",
        "yield_links": settings.get("yield_links"),
        "upright": settings.get("upright", {}).get("max_tilt_deg"),
        "upright_axis": settings.get("upright", {}).get("axis"),
        **{name: settings.get("wood", {}).get(name) for name in WOOD},
        "limb_limits": settings.get("wood", {}).get("limits"),
    }
    for name, value in defaults.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, value)


def _show_certificate(console: Console, report: dict[str, Any], error: str) -> None:
    """Print the certificate in at most 80 columns, unless names are long."""
    proof, table = report["certificate"], facts_table()
    clearance = "inf" if proof["nearest"] is None else at_least_mm(proof["min_clearance_m"], 3)
    table.add_row("certificate", describe_certificate(proof["verified"]))
    for violation in proof["violations"]:
        table.add_row("", escape(violation))
    for row in [*uncovered_rows(proof.get("uncovered_links", ())), *held_rows(proof)]:
        table.add_row(*row)
    shown = " mm or more, proved for all times" if proof["verified"] else " mm, the minimum found"
    table.add_row("clearance", clearance + shown)
    if proof.get("upright"):
        table.add_row("tilt", tilt_words(proof["upright"]))
    table.add_row("limits used", ", ".join(f"{k} {percent(v)}" for k, v in proof["limit_use"].items()) + " %")
    if "nearest_s" in proof:
        table.add_row("nearest", f"{proof['nearest']['obstacle']!r} at {proof['nearest_s']:.3f} s")
    if "clear_until_s" in proof:
        until = proof["clear_until_s"]
        table.add_row("at rest", "clear for all later times" if until is None else f"clear until {until:.3f} s")
    covered = f"tracking error {error}, delay {1e3 * proof['tracking_delay_s']:g} ms; {proof['sigmas']:g} sigma"
    table.add_row("covered", covered)
    if "risk" in proof:
        table.add_row("risk", escape(risk_words(proof["risk"])))
    if "uncertain" in proof:
        left = proof["uncertain"]
        one, some = 100.0 * left["one_beyond"], 100.0 * left["any_beyond_at_most"]
        table.add_row(
            "not covered",
            f"{one:.2g} % of the positions of an uncertain obstacle; all {left['obstacles']} together: {some:.2g} %",
        )
    rule = "on the straight approach" if proof["goal_contact"] == "approach" else "during the whole motion"
    windows = [(f"fruit {escape(at['fruit'])!r}", at["begin_s"], at["end_s"]) for at in proof.get("contacts", ())]
    if not windows and proof["contact_s"] is not None:
        windows = [(f"fruit, {rule}", *proof["contact_s"])]
    for what, begin, end in windows:
        table.add_row("contact", f"last link and {what}: {begin:.3f} to {end:.3f} s")
    for push in proof.get("pushes") or ():
        span = f"{push['begin_s']:.3f} to {push['end_s']:.3f} s"
        what = f"{escape(push['link'])} {escape(push['obstacle'])!r}, {1e3 * push['depth_m']:.1f} mm at most"
        if push.get("force_n") is not None:
            what += f", {push['force_n']:.1f} N, {push['stress_mpa']:.1f} MPa"
        table.add_row("pushed", f"by {what}: {span}")
    for what in report["differs"]:
        table.add_row("differs", f"[bold red]the {what} is not that of {REPORT}[/]")
    for what, digest in proof["digests"].items():
        table.add_row(what, digest[:23])
    show(console, report["scene"], report["robot"], table)
