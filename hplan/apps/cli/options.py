"""Parsers and options that commands share, and what they say in hplan's own terms."""

from __future__ import annotations

import argparse
import math
import re
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import hplan
from hplan.base.files import inputs, is_folder
from hplan.errors import OptionError, OutputError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.apps.cli.finished_job import FinishedJob
    from hplan.planning.options import PlanOptions
    from hplan.robot.model import Robot
    from hplan.robot.tracking import TrackingModel
    from hplan.scene.model import Scene


def command_parser(
    description: str, epilog: str, *, prog: str | None = None, usage: str | None = None
) -> argparse.ArgumentParser:
    """A parser whose help gives the description in lines of 79 and the epilog as it stands."""
    parser = argparse.ArgumentParser(
        prog=prog,
        usage=usage,
        description=textwrap.fill(description, 79),
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if prog is not None and prog.startswith("hplan"):
        parser.add_argument("--version", action="version", version=f"hplan {hplan.__version__}")
    return parser


def add_scene(parser: argparse.ArgumentParser, default: str = "the paper's reference scene, Table 1") -> None:
    """Add the argument `scene`: a text, for `hplan.scene.file.load_scene` tells files and shipped scenes apart."""
    parser.add_argument("scene", nargs="?", help=f"scene file, or name of a shipped scene (default: {default})")


def names_robots(scene: str) -> bool:
    """True if a scene file has several robots (`robots`); False where it cannot be read, which loading it says."""
    try:
        with Path(scene).open(encoding="utf-8") as file:
            return any(re.match(r"\s*[\"']?robots[\"']?\s*:", line) for line in file)
    except (OSError, UnicodeDecodeError):
        return False


def add_drop_inside(parser: argparse.ArgumentParser) -> None:
    """Add the options `--drop-inside` and `--yield-links`."""
    parser.add_argument("--drop-inside", action="store_true", help="leave out obstacles and fruits that stand in "
        "pedestal or turret, and say which; they are in no proof")  # fmt: skip
    parser.add_argument("--yield-links", nargs="+", metavar="LINK", help="links that may push what gives way (default: "
        "the scene's, else those of the last two joints)")  # fmt: skip


def add_deadline(parser: argparse.ArgumentParser) -> None:
    """Add the option `--deadline`; loading does not count."""
    parser.add_argument(
        "--deadline",
        dest="deadline_ms",
        type=float,
        metavar="MS",
        help="time that planning may take, without what is loaded before",
    )


def scene_among(arguments: argparse.Namespace, robot: Robot, scene: Scene, errors: Console) -> tuple[Scene, list[str]]:
    """The scene as `--yield-links` and `--drop-inside` want it, and what is left out, which the console prints."""
    if arguments.yield_links is not None:
        scene = scene.model_copy(update={"yield_links": tuple(arguments.yield_links)})
    if not arguments.drop_inside:
        return scene, []
    from hplan.planning.world import without_inside

    smaller, names = without_inside(robot, scene)
    if names:
        goal = "" if smaller.goal == scene.goal else f"; the goal is {smaller.goal.fruit} instead"
        left_out = f"left out, standing in pedestal or turret: {', '.join(names)}{goal}"
        errors.print(left_out, markup=False, soft_wrap=True)
    return smaller, list(names)


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Add the options `--robot`, `--limits`, `--hold`, and those of `add_robot_parts`."""
    add = parser.add_argument
    add("--robot", type=Path, metavar="URDF", help="robot, or name of one: a shipped one, panda, ur5 ... (default: "
        "the scene's, else harvester)")  # fmt: skip
    add("--limits", type=Path, metavar="YAML", help="acceleration limits, or name of a robot whose ship, as ur5 "
        "(default: NAME.limits.yaml in the URDF's folder)")  # fmt: skip
    add_hold(parser)
    add_robot_parts(parser)


def add_robot_parts(parser: argparse.ArgumentParser) -> None:
    """Add the options `--tool-frame`, `--srdf`, `--allow-neighbours` and `--package-dir`."""
    add = parser.add_argument
    add("--tool-frame", metavar="NAME", help="frame at the end of the arm (default: tool0, or the named robot's)")
    add("--srdf", type=Path, metavar="FILE", help="which links may touch, for robots beyond the planar family")
    add("--allow-neighbours", action="store_true", help="links with one joint between them may touch")
    add("--package-dir", action="append", type=Path, default=[], metavar="DIR", help="where package:// meshes are "
        "looked for first")  # fmt: skip


def add_hold(parser: argparse.ArgumentParser) -> None:
    """Add the option `--hold`."""
    parser.add_argument(
        "--hold",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=RAD",
        help="where joints that do not move stand",
    )


def held_joints(arguments: argparse.Namespace) -> dict[str, float]:
    """Joints and their positions, as `--hold` gives them.

    Raises:
        OptionError: A text that is not NAME=RAD.
    """
    held = {}
    for text in arguments.hold:
        name, _, value = text.partition("=")
        try:
            held[name] = float(value)
        except ValueError:
            held[name] = math.nan
        if not (name and math.isfinite(held[name])):
            raise OptionError("--hold", text, "NAME=RAD, a joint and its position")
    return held


def robot_of(arguments: argparse.Namespace, scene: Scene | None = None, job: FinishedJob | None = None) -> Robot:
    """The robot that the options of `add_robot` name, else the one that the scene is meant for, else the job's.

    Raises:
        HplanError: As `hplan.robot.model.load_robot` and `FinishedJob.robot`.
        OptionError: A tracking error in degrees alone where a joint slides, or one that is of no joint.
    """
    from hplan.robot.model import load_robot

    hold = held_joints(arguments)
    path = scene.robot if arguments.robot is None and scene is not None else arguments.robot
    if path is None and job is not None:
        path = job.robot
    robot = load_robot(
        path,
        limits=arguments.limits,
        tool_frame=arguments.tool_frame,
        hold=hold,
        package_dirs=arguments.package_dir,
        srdf=arguments.srdf,
        allow_neighbours=arguments.allow_neighbours,
    )
    _check_tracking(arguments, robot)
    return robot


def add_pace(parser: argparse.ArgumentParser) -> None:
    """Add the options `--rate` and `--speed`."""
    add = parser.add_argument
    add(
        "--rate",
        dest="rate_hz",
        type=float,
        default=250.0,
        metavar="HZ",
        help="rows per second in the CSV (default: 250)",
    )
    add("--speed", type=float, default=1.0, metavar="FRACTION", help="fraction of full speed, in (0, 1] (default: 1)")


def add_effort(parser: argparse.ArgumentParser) -> None:
    """Add the options `--effort` and `--seed`."""
    parser.add_argument("--effort", choices=("quick", "default", "best"), default="default", help="what to spend on a "
        "faster motion; quick: the first that is certified (default: default)")  # fmt: skip
    add_seed(parser)


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add the option `--seed`."""
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the samples by which trees grow; another "
        "may lead to another motion (default: 0)")  # fmt: skip


def add_sigmas(parser: argparse.ArgumentParser) -> None:
    """Add the option `--sigmas`."""
    parser.add_argument(
        "--sigmas",
        type=float,
        default=3.0,
        metavar="K",
        help="an uncertain obstacle grows by K sigma (default: 3, which leaves 2.9 %% of its places)",
    )


def add_tracking(parser: argparse.ArgumentParser) -> None:
    """Add the options `--tracking-error`, `--tracking-error-m` and `--tracking-delay`."""
    add = parser.add_argument
    add("--tracking-error", type=float, default=0.0, metavar="DEG", help="deviation of each joint that is allowed for")
    add("--tracking-error-m", type=float, default=0.0, metavar="M", help="that of each that slides; one number is "
        "covered, the larger of both in radians and metres")  # fmt: skip
    add("--tracking-delay", type=float, default=0.0, metavar="MS", help="the same, for each unit of joint velocity")


def tracking_of(arguments: argparse.Namespace) -> TrackingModel:
    """The tracking model of `--tracking-error`, `--tracking-error-m` and `--tracking-delay`.

    The model has one number for radians and metres: the larger of both. `robot_of` refuses what fits no joint.

    Raises:
        OptionError: One that is negative or not finite.
    """
    from hplan.robot.tracking import TrackingModel

    error_deg, error_m, delay_ms = arguments.tracking_error, arguments.tracking_error_m, arguments.tracking_delay
    given = ("--tracking-error", error_deg, "degrees"), ("--tracking-error-m", error_m, "metres")
    for option, value, unit in (*given, ("--tracking-delay", delay_ms, "ms")):
        if not 0.0 <= value < math.inf:
            raise OptionError(option, value, f"a finite number of {unit} >= 0")
    return TrackingModel(max(math.radians(error_deg), error_m), 1e-3 * delay_ms)


def _check_tracking(arguments: argparse.Namespace, robot: Robot) -> None:
    degrees, metres = getattr(arguments, "tracking_error", None), getattr(arguments, "tracking_error_m", None)
    if metres and not any(robot.slides):
        raise OptionError("--tracking-error-m", metres, "0: no joint of the robot slides")
    for option, value, other, kind, words in (
        ("--tracking-error-m", metres, degrees, True, "a length in metres: joint {!r} slides, and degrees are none"),
        ("--tracking-error", degrees, metres, False, "an angle in degrees: joint {!r} turns, and metres are none"),
    ):
        if other and not value and kind in robot.slides:
            raise OptionError(option, value, words.format(robot.joint_names[robot.slides.index(kind)]))


def plan_options(arguments: argparse.Namespace, *options: str) -> PlanOptions:
    """Options of a plan: tracking, speed, deadline, and the others of these names.

    Raises:
        OptionError: A value out of its range.
    """
    from hplan.planning.options import PlanOptions

    tracking = tracking_of(arguments)
    chosen = {option: getattr(arguments, option) for option in ("rate_hz", "speed", *options)}
    deadline_ms = getattr(arguments, "deadline_ms", None)
    return PlanOptions(
        tracking_error=tracking.still_rad,
        tracking_delay_s=tracking.delay_s,
        seed=getattr(arguments, "seed", 0),
        deadline_s=None if deadline_ms is None else 1e-3 * deadline_ms,
        **chosen,
    )


def check_output_file(out: Path, option: str = "--out") -> None:
    """Refuse, before any work, a file to write that the command has read, or that has no folder.

    Raises:
        OptionError: It would replace something that is read.
        OutputError: There is no such folder.
    """
    if out.resolve() in inputs():
        raise OptionError(option, str(out), "another file than those that are read")
    if not is_folder(out.resolve().parent):
        raise OutputError(out, "its folder does not exist")
