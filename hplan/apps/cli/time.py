"""The command `hplan time`: time a motion through waypoints for any robot that Pinocchio reads.

Without a scene it knows no obstacles. With one the path is verified, finished, and certified: a job like a plan.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.job_folder import OUT as FOLDER
from hplan.apps.cli.job_folder import PAGE, PLAN_FILES, REPORT, SCENE, TRAJECTORY, JobFolder
from hplan.apps.cli.options import (
    add_deadline,
    add_effort,
    add_hold,
    add_pace,
    add_robot_parts,
    add_sigmas,
    add_tracking,
    check_output_file,
    command_parser,
    held_joints,
    plan_options,
    robot_of,
)
from hplan.apps.cli.terminal import facts_table, loading, number_table, progress_line, show_title
from hplan.base.files import is_file
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.base.arrays import FloatArray
    from hplan.planning.result import PlanResult
    from hplan.robot.limits import Limits
    from hplan.trajectory import Machine
    from hplan.trajectory.trajectory import Trajectory

#: Where the motion goes unless something else is said.
OUT = Path("timed.csv")

#: Options, with their defaults, that take a scene, and such that do not.
_WITH_SCENE: dict[str, object] = {
    "keep_path": False,
    "effort": "default",
    "seed": 0,
    "sigmas": 3.0,
    "tracking_error": 0.0,
    "tracking_error_m": 0.0,
    "tracking_delay": 0.0,
    "deadline_ms": None,
    "tool_frame": None,
    "srdf": None,
    "allow_neighbours": False,
    "package_dir": [],
}
_WITHOUT_SCENE: dict[str, object] = {"acceleration": None, "no_torque": False, "joints": None}

_DESCRIPTION = """\
Time the fastest motion through waypoints, from rest to rest, under the URDF's velocity and torque limits and given
acceleration limits. Corners are rounded within a guaranteed deviation. With --scene the path is verified
collision-free, shortened (or kept), smoothed, timed and certified, or refused with the place where it is in contact.
"""

_EPILOG = """\
WAYPOINTS.csv: a header, then a line for each waypoint. Columns NAME or, in
radians, NAME_pos_rad, of prismatic joints NAME_pos_m, in any order; continuous
joints count on past a whole turn; other columns are ignored.

joints: revolute, prismatic and continuous ones move; by default all but those
that mimic another or are mimicked. The others are held: at 0, at the limit
nearest to it, or where --hold says.

--scene: written are trajectory.csv, report.json, scene.html and scene.yaml, the
scene with the path's ends as start and goal, into the folder --out (default:
out). Start and goal of the scene do not matter; a fruit is an obstacle.

exit status:
  0  done
  2  bad input
  4  the motion cannot be timed
  5  with --scene: the path is in contact, or no motion along it is certified
  6  with --scene: none was found in time
"""


def parser(prog: str) -> argparse.ArgumentParser:
    """The parser of the command's arguments."""
    parser = command_parser(_DESCRIPTION, _EPILOG, prog=prog)
    add = parser.add_argument
    add("urdf", type=Path, metavar="ROBOT", help="a URDF, or the name of a robot (panda, ur5 ...); meshes are "
        "needed with --scene only")  # fmt: skip
    add("waypoints", type=Path, metavar="WAYPOINTS.csv", help="the waypoints")
    limits = parser.add_mutually_exclusive_group()
    limits.add_argument(
        "--limits",
        type=Path,
        metavar="YAML",
        help="acceleration limits, or name of a robot whose ship (default: NAME.limits.yaml in the URDF's folder)",
    )
    limits.add_argument("--acceleration", type=float, metavar="RAD_S2", help="one acceleration limit for all joints")
    add("--no-torque", action="store_true", help="do not limit the torque")
    add("--joints", nargs="+", metavar="NAME", help="the joints that move")
    add_hold(parser)
    add(
        "--deviation",
        type=float,
        default=1.0,
        metavar="DEG",
        help="largest distance from the polyline; of joints that slide 17.5 mm for each degree (default: 1)",
    )
    add_pace(parser)
    add("--out", type=Path, metavar="FILE.csv", help="file to write (default: timed.csv); with --scene a folder")
    add("--quiet", action="store_true", help="no summary")
    _add_scene(parser)
    return parser


def _add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the options that take a scene."""
    parser.add_argument("--scene", metavar="SCENE", help="obstacles: a scene file, or name of a shipped scene")
    add = parser.add_argument
    add("--keep-path", action="store_true", help="keep the path's shape within --deviation; else it is shortened")
    add_effort(parser)
    add_sigmas(parser)
    add_robot_parts(parser)
    add_tracking(parser)
    add_deadline(parser)


def _check_options(arguments: argparse.Namespace) -> None:
    """Refuse options that do nothing with a scene, or without one.

    Raises:
        OptionError: There is one.
    """
    with_scene = arguments.scene is not None
    out_of_place = _WITHOUT_SCENE if with_scene else _WITH_SCENE
    how = "left out with --scene: limits are the robot's, or of --limits" if with_scene else "left out, or --scene"
    for name, default in out_of_place.items():
        value = getattr(arguments, name)
        if value != default:
            raise OptionError(f"--{name.replace('_', '-').removesuffix('-ms')}", value, how)


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Read, time, write, and say how it went; returns the exit status."""
    if arguments.scene is None:
        arguments.out = OUT if arguments.out is None else arguments.out
        return _timed(arguments, console)
    folder = JobFolder(FOLDER if arguments.out is None else arguments.out, (*PLAN_FILES, SCENE), REPORT)
    result = _finished(arguments, folder, errors)
    if not arguments.quiet:
        from hplan.apps.cli.plan import show_summary

        show_summary(console, result, folder.path, [SCENE])
    return 0


def _finished(arguments: argparse.Namespace, folder: JobFolder, errors: Console) -> PlanResult:
    """Finish the path among the obstacles of the scene, and write what came of it."""
    _check_options(arguments)
    with progress_line(errors, quiet=arguments.quiet) as show:
        show("reading robot and scene")
        with loading():
            from hplan.apps.cli.plan import STAGE_WORDS
            from hplan.apps.view.page import write_page
            from hplan.apps.view.playback import Playback
            from hplan.planning.finishing.finish import finish
            from hplan.planning.report import curve_report, write_report
            from hplan.scene.file import load_scene, save_scene
            from hplan.trajectory import read_waypoints
            from hplan.trajectory.trajectory import write_csv
        options = plan_options(arguments, "effort", "sigmas")
        scene = load_scene(arguments.scene)
        arguments.robot = arguments.urdf
        robot = robot_of(arguments, scene)
        waypoints = read_waypoints(arguments.waypoints, robot.joint_names, robot.slides)
        within_rad = math.radians(arguments.deviation) if arguments.keep_path else None
        with folder.job(scene.name, robot.name):
            result = finish(
                robot,
                scene,
                waypoints,
                options,
                keep_within_rad=within_rad,
                progress=lambda stage: show(STAGE_WORDS.get(stage, stage)),
            )
            show("writing files")
            with folder.filling() as staging:
                write_csv(result.trajectory, staging / TRAJECTORY)
                write_page(robot, result.scene, Playback.of(result), staging / PAGE)
                save_scene(result.scene, folder.path / SCENE)  # where it stands, for it may name files
                write_report(result.report | curve_report(result.certificate), staging / REPORT)
    return result


def _timed(arguments: argparse.Namespace, console: Console) -> int:
    """Time the path, whatever is in its way."""
    from hplan.robot.dynamics import joints_that_slide
    from hplan.trajectory import read_machine, read_waypoints, time_waypoints
    from hplan.trajectory.trajectory import write_csv

    _check_options(arguments)
    machine = read_machine(arguments.urdf, arguments.joints, hold=held_joints(arguments))
    waypoints = read_waypoints(arguments.waypoints, machine.joint_names, joints_that_slide(machine.model))
    limits = _limits(arguments, machine)
    check_output_file(arguments.out)
    trajectory = time_waypoints(
        machine.model,
        waypoints,
        limits,
        deviation_rad=math.radians(arguments.deviation),
        rate_hz=arguments.rate_hz,
        speed=arguments.speed,
    )
    write_csv(trajectory, arguments.out)
    if not arguments.quiet:
        _show(console, arguments, machine, waypoints, limits, trajectory)
    return 0


def _limits(arguments: argparse.Namespace, machine: Machine) -> Limits:
    """The URDF's limits, with acceleration (and jerk) from the YAML or the number given."""
    from hplan.base.data_files import LIMITS_SUFFIX
    from hplan.robot.dynamics import joints_that_slide
    from hplan.robot.files import limits_file, read_limits, robot_files
    from hplan.trajectory import limits_of

    torque = not arguments.no_torque
    if arguments.acceleration is not None:
        if not (math.isfinite(arguments.acceleration) and arguments.acceleration >= 0.0):
            raise OptionError("--acceleration", arguments.acceleration, "a finite number >= 0")
        return limits_of(machine.model, arguments.acceleration, torque=torque)
    files = robot_files(arguments.urdf)
    own = files.urdf.with_suffix(LIMITS_SUFFIX) if files.limits is None else files.limits
    path = own if arguments.limits is None else limits_file(arguments.limits)
    if arguments.limits is None and not is_file(path):
        raise OptionError(
            "--acceleration",
            None,
            f"acceleration limits, which a URDF cannot hold: a number here, or a file by --limits ({path} is missing)",
        )
    acceleration, jerk = read_limits(path, machine.joint_names, joints_that_slide(machine.model), machine.held)
    return limits_of(machine.model, acceleration, jerk, torque=torque)


def _show(
    console: Console,
    arguments: argparse.Namespace,
    machine: Machine,
    waypoints: FloatArray,
    limits: Limits,
    trajectory: Trajectory,
) -> None:
    """Facts, then a row for each joint; fits 80 columns, unless names are long."""
    import numpy as np
    from rich.markup import escape

    from hplan.base.units import joint_length
    from hplan.robot.dynamics import joints_that_slide
    from hplan.trajectory import AT_LIMIT, largest_deviation, limit_shares

    full, paced = limit_shares(trajectory, limits), limit_shares(trajectory, limits.scaled(arguments.speed))
    facts = facts_table()
    length = float(np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum())
    slides = joints_that_slide(machine.model)
    facts.add_row("waypoints", f"{len(waypoints):,}, {joint_length(length, slides)} along the lines between them")
    rows = "1 row: nothing to move" if trajectory.samples == 1 else f"{trajectory.samples:,} rows"
    facts.add_row("motion", f"[bold]{trajectory.duration:.3f} s[/], {rows} at {arguments.rate_hz:g} Hz")
    deviation = joint_length(largest_deviation(trajectory.position, waypoints), slides, ".4f")
    allowed = joint_length(math.radians(arguments.deviation), slides, "g")
    facts.add_row("deviation", f"{deviation} from the lines at most, {allowed} allowed")
    facts.add_row("at a limit", f"{100.0 * paced.bound:.1f} % of the time")
    for name, value in machine.held.items():
        facts.add_row("held", f"{escape(name)} at {'its neutral position' if value is None else f'{value:g} rad'}")
    facts.add_row("file", escape(str(arguments.out)))
    table = number_table()
    table.add_column("use of limits, %", no_wrap=True)
    columns = {"velocity": full.velocity, "acceleration": full.acceleration, "torque": full.torque, "jerk": full.jerk}
    shown = {name: values for name, values in columns.items() if values is not None}
    for heading in (*shown, "holds the motion back"):
        table.add_column(heading, justify="right", no_wrap=True)
    for joint, name in enumerate(machine.joint_names):
        shares = (f"{100.0 * values[joint]:.1f}" for values in shown.values())
        table.add_row(escape(name), *shares, f"{100.0 * paced.binding[joint]:.1f} % of the time")
    show_title(console, arguments.waypoints.name, machine.model.name)
    console.print(facts)
    console.print()
    console.print(table)
    torque = "" if full.torque is not None else "; torque is not limited"
    console.print(f"\nholds the motion back: uses {100.0 * AT_LIMIT:g} % or more of a limit{torque}\n", style="dim")
