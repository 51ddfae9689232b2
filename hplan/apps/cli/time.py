"""Compute the fastest motion through waypoints, from rest to rest.

It respects velocity, acceleration and torque limits. Corners are rounded within a guaranteed deviation. With --scene
the path is verified collision-free, shortened (or kept), smoothed, timed and certified, or refused with the location
of the contact.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.job_folder import PLAN_FILES, REPORT, SCENE, TRAJECTORY, JobFolder, write_result
from hplan.apps.cli.options import OUT as FOLDER
from hplan.apps.cli.options import (
    add_shared,
    check_output_file,
    command_parser,
    held_joints,
    plan_options,
    refuse,
    robot_of,
)
from hplan.apps.cli.terminal import escape, facts_table, number_table, pause_garbage_collection, progress_line, show
from hplan.base.files import is_file
from hplan.errors import OptionError

if TYPE_CHECKING:
    import pinocchio as pin
    from rich.console import Console

    from hplan.base.arrays import FloatArray
    from hplan.planning.result import PlanResult
    from hplan.robot.limits import Limits
    from hplan.trajectory.trajectory import Trajectory

#: Default output file.
DEFAULT_CSV = Path("timed.csv")

#: Options that require `--scene`, and options that exclude it.
_WITH_SCENE = (
    *("keep_path", "effort", "seed", "sigmas", "tracking_error", "tracking_error_m", "tracking_delay", "deadline_ms"),
    *("poses", "free", "tilt", "tool_frame", "srdf", "allow_neighbours", "package_dir", "xacro"),
    *("collision_from_visual", "acceleration_scale", "tool_tube_m", "group", "group_state", "repair_inertia"),
)
_WITHOUT_SCENE = ("acceleration", "no_torque", "joints")

_EPILOG = """\
WAYPOINTS.csv: a header, then one line for each waypoint. The columns are named
NAME or NAME_pos_rad (radians), for prismatic joints NAME_pos_m, in any order.
Continuous joints keep counting past a whole turn. Other columns are ignored.

joints: revolute, prismatic and continuous joints move, by default all except
those coupled by <mimic>. The others are locked at 0, at the limit nearest to 0,
or at the position given by --hold.

--scene: the folder --out (default: out) gets trajectory.csv, report.json,
scene.html and scene.yaml, the scene with the path's ends as start and goal.
Start and goal of the given scene are ignored; its fruits are obstacles.

exit status:
  0  done
  2  bad input
  4  the motion cannot be timed
  5  with --scene: the path is in contact, or no motion along it is certified
  6  with --scene: no motion found in time
"""


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    add = parser.add_argument
    add("urdf", type=Path, metavar="ROBOT", help="URDF file or name of a robot, such as panda or ur5; meshes are "
        "required with --scene only")  # fmt: skip
    add("waypoints", type=Path, metavar="WAYPOINTS.csv", help="CSV of the waypoints")
    limits = parser.add_mutually_exclusive_group()
    limits.add_argument(
        "--limits",
        type=Path,
        metavar="YAML",
        help="limits file, or name of a robot whose limits ship with hplan "
        "(default: NAME.limits.yaml next to the URDF)",
    )
    limits.add_argument(
        "--acceleration", type=float, metavar="RAD_S2", help="acceleration limit of every joint in rad/s2"
    )
    add("--no-torque", action="store_true", help="ignore the torque limits")
    add("--joints", nargs="+", metavar="NAME", help="joints that move (default: all)")
    add(
        "--deviation",
        type=float,
        default=1.0,
        metavar="DEG",
        help="maximum distance from the polyline in degrees; a degree is 17.5 mm for prismatic joints (default: 1)",
    )
    add_shared(parser, "pace")
    add(
        "--out",
        type=Path,
        metavar="FILE.csv",
        help="output file (default: timed.csv); with --scene the output folder (default: out)",
    )
    add_shared(parser, "force")
    add("--quiet", action="store_true", help="print no summary")
    add("--scene", metavar="SCENE", help="scene file or name of a shipped scene, with the obstacles")
    add("--keep-path", action="store_true", help="keep the path's shape within --deviation (default: shorten the path)")
    add("--poses", action="store_true", help="with --scene: the waypoints are tool poses in base_link, in columns "
        "x,y,z [m] and qx,qy,qz,qw; the motion begins at the scene's start")  # fmt: skip
    add("--free", action="store_true", help="with --poses: do not require straight lines between poses")
    add(
        "--tilt",
        type=float,
        metavar="DEG",
        help="with --poses: maximum angle between the vertical and the tool axis that points up at the start, in "
        "degrees (default: no limit)",
    )
    add_shared(parser, "effort", "seed", "sigmas", "parts", "tracking", "deadline")
    return parser


def _check_options(arguments: argparse.Namespace) -> None:
    """Refuse options that have no effect with, or without, a scene."""
    if arguments.scene is None:
        refuse(arguments, _WITH_SCENE, "no value without --scene")
    else:
        refuse(arguments, _WITHOUT_SCENE, "no value with --scene: the limits are the robot's or those of --limits")
    if arguments.poses:
        refuse(arguments, ["keep_path"], "no value with --poses")
    else:
        refuse(arguments, ["free", "tilt"], "no value without --poses")


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Time the path, write and print the motion; return the exit status."""
    if arguments.scene is None:
        arguments.out = DEFAULT_CSV if arguments.out is None else arguments.out
        return _time_and_write(arguments, console)
    arguments.out = FOLDER if arguments.out is None else arguments.out
    folder = JobFolder(arguments, (*PLAN_FILES, SCENE), REPORT)
    result, files = _finish_and_write(arguments, folder, errors)
    if not arguments.quiet:
        from hplan.apps.cli.plan import show_summary

        show_summary(console, result, folder.path, files)
    return 0


def _finish_and_write(
    arguments: argparse.Namespace, folder: JobFolder, errors: Console
) -> tuple[PlanResult, list[str]]:
    """Retime and certify the path in the scene; write the result.

    Returns:
        The result and the names of its files.
    """
    _check_options(arguments)
    # Columns of a waypoint file of tool poses.
    pose = ("x", "y", "z", "qx", "qy", "qz", "qw")
    with progress_line(errors, quiet=arguments.quiet) as status:
        status("reading robot and scene")
        with pause_garbage_collection():
            from hplan.apps.cli.plan import STAGE_WORDS
            from hplan.planning.finish import finish
            from hplan.planning.pose_sequence import plan_poses, pose_matrices
            from hplan.planning.report import curve_report, write_report
            from hplan.scene.file import load_scene, stage_scene
            from hplan.trajectory import read_waypoints
        options = plan_options(arguments, "effort", "sigmas")
        scene = load_scene(arguments.scene)
        arguments.robot = arguments.urdf
        robot = robot_of(arguments, scene)
        names, slides = (pose, (False,) * 7) if arguments.poses else (robot.joint_names, robot.slides)
        waypoints = read_waypoints(arguments.waypoints, names, slides)
        within_rad = math.radians(arguments.deviation) if arguments.keep_path else None

        def progress(stage: str) -> None:
            status(STAGE_WORDS.get(stage, stage))

        with folder.job(scene.name, robot.name):
            if arguments.poses:
                tilt = None if arguments.tilt is None else math.radians(arguments.tilt)
                poses, straight = pose_matrices(waypoints), not arguments.free
                result = plan_poses(robot, scene, poses, options, straight=straight, tilt_rad=tilt, progress=progress)
            else:
                result = finish(robot, scene, waypoints, options, keep_within_rad=within_rad, progress=progress)
            status("writing files")
            with folder.stage_files() as staging:
                files = write_result(result, {TRAJECTORY: result.trajectory}, staging)
                stage_scene(result.scene, staging / SCENE, folder.path / SCENE)
                write_report(result.report | curve_report(result.certificate), staging / REPORT)
    return result, [TRAJECTORY, REPORT, *files, SCENE]


def _time_and_write(arguments: argparse.Namespace, console: Console) -> int:
    """Time the path without checking collisions; write the motion."""
    from hplan.robot.dynamics import joints_that_slide
    from hplan.trajectory import read_kinematics, read_waypoints, time_waypoints
    from hplan.trajectory.trajectory import write_csv

    _check_options(arguments)
    model, held = read_kinematics(arguments.urdf, arguments.joints, hold=held_joints(arguments))
    waypoints = read_waypoints(arguments.waypoints, tuple(model.names)[1:], joints_that_slide(model))
    limits = _limits(arguments, model, held)
    check_output_file(arguments.out, force=arguments.force)
    trajectory = time_waypoints(
        model,
        waypoints,
        limits,
        deviation_rad=math.radians(arguments.deviation),
        rate_hz=arguments.rate_hz,
        speed=arguments.speed,
    )
    write_csv(trajectory, arguments.out)
    if not arguments.quiet:
        _show_motion(console, arguments, model, held, waypoints, limits, trajectory)
    return 0


def _limits(arguments: argparse.Namespace, model: pin.Model, held: Collection[str]) -> Limits:
    """Limits of the URDF, with acceleration (and jerk) limits from options."""
    from hplan.base.data_files import LIMITS_SUFFIX
    from hplan.robot.dynamics import joints_that_slide
    from hplan.robot.files import robot_files
    from hplan.robot.limits_file import limits_file, read_limits
    from hplan.trajectory import limits_of

    torque = not arguments.no_torque
    if arguments.acceleration is not None:
        if not (math.isfinite(arguments.acceleration) and arguments.acceleration >= 0.0):
            raise OptionError("--acceleration", arguments.acceleration, "a finite number >= 0")
        return limits_of(model, arguments.acceleration, torque=torque)
    files = robot_files(arguments.urdf)
    own = files.urdf.with_suffix(LIMITS_SUFFIX) if files.limits is None else files.limits
    path = own if arguments.limits is None else limits_file(arguments.limits)
    if arguments.limits is None and not is_file(path):
        raise OptionError(
            "--acceleration",
            None,
            f"acceleration limits, which a URDF cannot contain: a number, or a file with --limits ({path} is missing)",
        )
    acceleration, jerk = read_limits(path, tuple(model.names)[1:], joints_that_slide(model), held)
    return limits_of(model, acceleration, jerk, torque=torque)


def _show_motion(
    console: Console,
    arguments: argparse.Namespace,
    model: pin.Model,
    held: Mapping[str, float | None],
    waypoints: FloatArray,
    limits: Limits,
    trajectory: Trajectory,
) -> None:
    """Print a summary in at most 80 columns, unless names are long."""
    import numpy as np

    from hplan.base.units import joint_length
    from hplan.robot.dynamics import joints_that_slide
    from hplan.trajectory import AT_LIMIT, largest_path_deviation, limit_shares

    full, paced = limit_shares(trajectory, limits), limit_shares(trajectory, limits.scale(arguments.speed))
    length = float(np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum())
    slides = joints_that_slide(model)
    samples = "1 sample: no motion" if trajectory.samples == 1 else f"{trajectory.samples:,} samples"
    deviation = joint_length(largest_path_deviation(trajectory.position, waypoints), slides, ".4f")
    allowed = joint_length(math.radians(arguments.deviation), slides, "g")
    facts = [
        ("waypoints", f"{len(waypoints):,}, {joint_length(length, slides)} along the polyline"),
        ("motion", f"[bold]{trajectory.duration:.3f} s[/], {samples} at {arguments.rate_hz:g} Hz"),
        ("deviation", f"at most {deviation} from the polyline, {allowed} allowed"),
        ("at a limit", f"{100.0 * paced.bound:.1f} % of the time"),
        *(
            ("held", f"{escape(name)} at {'its neutral position' if value is None else f'{value:g} rad'}")
            for name, value in held.items()
        ),
        ("file", escape(arguments.out)),
    ]
    columns = {"velocity": full.velocity, "acceleration": full.acceleration, "torque": full.torque, "jerk": full.jerk}
    shown = {name: values for name, values in columns.items() if values is not None}
    first = "limits used, %"
    rows = (
        (
            escape(name),
            *(f"{100.0 * values[joint]:.1f}" for values in shown.values()),
            f"{100.0 * paced.binding[joint]:.1f} % of the time",
        )
        for joint, name in enumerate(trajectory.joint_names)
    )
    show(console, arguments.waypoints.name, model.name, facts_table(facts))
    console.print(number_table((first, *shown, "at a limit"), rows, texts=(first,)))
    torque = "" if full.torque is not None else "; torque is not limited"
    console.print(f"\nat a limit: uses {100.0 * AT_LIMIT:g} % or more of it{torque}\n", style="dim")
