"""Parsers and options shared by subcommands, and their conversion to hplan's types."""

from __future__ import annotations

import argparse
import difflib
import math
import re
import sys
import textwrap
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hplan
from hplan.apps.cli.own_files import check_own
from hplan.base.files import inputs, is_file, is_folder
from hplan.errors import OptionError, OutputError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.apps.cli.finished_job import FinishedJob
    from hplan.planning.options import PlanOptions
    from hplan.robot.model import Robot
    from hplan.robot.tracking import TrackingModel
    from hplan.scene.model import Scene
    from hplan.scene.robot_source import RobotSource
    from hplan.scene.wood import LimbLimits


#: Default output folder.
OUT = Path("out")


class _Parser(argparse.ArgumentParser):
    """Parser whose error about an unknown option names the nearest.

    The option with the most similar spelling.
    """

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments, and refuse unknown ones."""
        words = list(sys.argv[1:] if args is None else args)
        if "" in words:  # as of an unset variable of a shell; as a path it would be the current folder
            before = f" after {words[words.index('') - 1]}" if words.index("") else ""
            self.error(f"an argument is empty{before}")
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            known = [name for action in self._actions for name in action.option_strings]
            wrong = [word.partition("=")[0] for word in unknown if word.startswith("-")]
            places = {f"--{action.dest}": action.dest for action in self._actions if not action.option_strings}
            hints = [f"{places[word]} is given without {word}" for word in wrong if word in places]
            near = {word: difflib.get_close_matches(word, known, 1) for word in wrong if word not in places}
            hints += [f"did you mean {names[0]} for {word}?" for word, names in near.items() if names]
            self.error("; ".join([f"unrecognized arguments: {' '.join(unknown)}", *hints]))
        return found


def command_parser(
    description: str | None, epilog: str, *, prog: str | None = None, usage: str | None = None
) -> argparse.ArgumentParser:
    """Create a parser with hplan's help format.

    Args:
        description: A docstring; the help wraps it at 79 columns.
        epilog: Printed verbatim at the end of the help.
        prog: Program name; None for the script's name. Programs whose name begins with `hplan` have `--version`.
        usage: Usage line; None for the generated one.
    """
    parser = _Parser(
        prog=prog,
        usage=usage,
        description=textwrap.fill(" ".join((description or "").split()), 79),
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if prog is not None and prog.startswith("hplan"):
        parser.add_argument("--version", action="version", version=f"hplan {hplan.__version__}")
    return parser


#: Options of `hplan plan` that are fields of `PlanOptions`, for one robot or several.
OF_PLANS = ("method", "step_deg", "objective", "effort", "link_model", "sigmas", "standoff", "capture_m")

#: Options shared by several commands: group, name, help text and other arguments of `add_argument`.
_SHARED: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
    ("scene", "scene", "scene file or name of a shipped scene (default: {scene})", {"nargs": "?"}),
    ("out", "--out", "output folder (default: out)", {"type": Path, "default": OUT, "metavar": "DIR"}),
    ("force", "--force", "also replace files that hplan did not write", {"action": "store_true"}),
    ("robot", "--robot", "URDF or MJCF file, or name of a robot, such as panda or ur5 (default: the scene's robot, "
        "else harvester)",
        {"type": Path, "metavar": "URDF"}),
    ("robot", "--limits", "limits file, or name of a robot whose limits ship with hplan (default: "
        "NAME.limits.yaml next to the URDF)", {"type": Path, "metavar": "YAML"}),
    ("parts", "--acceleration-scale", "acceleration limits as a multiple of the velocity limits, if no file gives them "
        "(default: 2 per second)", {"type": float, "metavar": "PER_S"}),
    ("parts", "--hold", "positions of locked joints, in radians or, for prismatic joints, metres",
        {"nargs": "+", "action": "extend", "default": [], "metavar": "NAME=RAD"}),
    ("parts", "--tool-frame", "frame at the end of the arm (default: tool0, or the named robot's)",
        {"metavar": "NAME"}),
    ("parts", "--tool-tube", "add a picking tube of this length in metres at the tool frame, whose mouth becomes the "
        "tool frame", {"dest": "tool_tube_m", "type": float, "metavar": "M"}),
    ("parts", "--srdf", "SRDF file with the pairs of links that may touch",
        {"type": Path, "metavar": "FILE"}),
    ("parts", "--group", "group of the SRDF with the moving joints (default: all up to the tool frame)",
        {"metavar": "NAME"}),
    ("parts", "--group-state", "group state of the SRDF that held joints have", {"metavar": "NAME"}),
    ("parts", "--repair-inertia", "go on with inertias that no body has, with the smaller principal moments raised",
        {"action": "store_true"}),
    ("parts", "--allow-neighbours", "let links touch that have one joint between them", {"action": "store_true"}),
    ("parts", "--package-dir", "folder that is searched first for packages and meshes; may be repeated",
        {"action": "append", "type": Path, "default": [], "metavar": "DIR"}),
    ("parts", "--xacro", "arguments of a xacro file as names and values",
        {"nargs": "+", "action": "extend", "default": [], "metavar": "NAME:=VALUE"}),
    ("parts", "--collision-from-visual", "build collision shapes from the visual meshes of these links (without "
        "names: of all drawn links whose shapes are missing or differ in size)", {"nargs": "*", "metavar": "LINK"}),
    ("contacts", "--drop-inside", "remove and list the obstacles and fruits inside the pedestal or turret; the "
        "certificate does not cover them", {"action": "store_true"}),
    ("contacts", "--yield-links", "links that may push compliant obstacles (default: the scene's, else the links of "
        "the last two joints)", {"nargs": "+", "metavar": "LINK"}),
    ("wood", "--contact-force", "maximum force of a link on a limb in newtons; with any of these three options limbs "
        "bend, and how deep they may be pushed follows from force and stress (default: the scene's, else 10)",
        {"type": float, "metavar": "N"}),
    ("wood", "--wood-stress", "maximum bending stress of limbs in MPa (default: the scene's, else 30)",
        {"dest": "wood_stress_mpa", "type": float, "metavar": "MPA"}),
    ("wood", "--fruit-force", "maximum force on the stalk of a fruit that is pushed aside in newtons (default: the "
        "scene's, else 8)", {"type": float, "metavar": "N"}),
    ("wood", "--limb-limits", "limits of the limbs and fruit with these names (* for any characters) in place of those "
        "of all: contact-force=N, wood-stress=MPA, fruit-force=N, youngs-modulus=GPA:GPA; may be repeated",
        {"nargs": "+", "action": "append", "metavar": ("NAMES", "LIMIT=VALUE")}),
    ("upright", "--upright", "keep the tool upright: maximum angle in degrees, at any time, between the vertical and "
        "the tool axis that is vertical at the start (default: the scene's, else none)",
        {"type": float, "metavar": "DEG"}),
    ("upright", "--upright-axis", "another axis for --upright, in the tool frame",
        {"nargs": 3, "type": float, "metavar": ("X", "Y", "Z")}),
    ("gentle", "--gentle", "push limbs with as little force as motions do that take at most 5 %% longer",
        {"action": "store_true"}),
    ("pace", "--rate", "samples per second in the CSV (default: 250)",
        {"dest": "rate_hz", "type": float, "default": 250.0, "metavar": "HZ"}),
    ("pace", "--speed", "fraction of full speed, in (0, 1] (default: 1)",
        {"type": float, "default": 1.0, "metavar": "FRACTION"}),
    ("search", "--method", "grid search (default: two-level)",
        {"choices": ("two-level", "dense"), "default": "two-level"}),
    ("search", "--objective", "cost to minimize (default: duration)",
        {"choices": ("duration", "length"), "default": "duration"}),
    ("grid", "--link-model", "shape of the links in the grid search (default: capsule)",
        {"choices": ("capsule", "paper", "rectangle"), "default": "capsule"}),
    ("grid", "--step", "spacing of the joint grid in degrees (default: 1)",
        {"dest": "step_deg", "type": float, "default": 1.0, "metavar": "DEG"}),
    ("standoff", "--standoff", "length of the straight approach in metres (default: 0.1 to a fruit or a point, none to "
        "a pose)", {"type": float, "metavar": "M"}),
    ("effort", "--effort", "computing effort for a faster motion; quick stays near the first path (default: default)",
        {"choices": ("quick", "default", "best"), "default": "default"}),
    ("seed", "--seed", "random seed of the sampling-based planner (default: 0)",
        {"type": int, "default": 0, "metavar": "N"}),
    ("sigmas", "--sigmas", "standard deviations by which uncertain obstacles grow (default: 3, which leaves 2.9 %% of "
        "the positions of one obstacle uncovered)",
        {"type": float, "default": 3.0, "metavar": "K"}),
    ("risk", "--risk", "maximum probability of any contact, in place of --sigmas; it is allocated among the "
        "obstacles", {"type": float, "metavar": "P"}),
    ("capture", "--capture", "capture range of the gripper in metres, across its approach and along it; grasps that "
        "catch the fruit with the highest probability come first",
        {"dest": "capture_m", "nargs": 2, "type": float, "metavar": ("M", "M")}),
    ("detour", "--max-detour", "leave out fruits that lengthen a tour by more seconds (default: pick all)",
        {"dest": "max_detour_s", "type": float, "metavar": "S"}),
    ("tracking", "--tracking-error", "tracking error of each joint in degrees (default: 0)",
        {"type": float, "default": 0.0, "metavar": "DEG"}),
    ("tracking", "--tracking-error-m", "tracking error of each prismatic joint in metres (default: 0); the certificate "
        "covers the larger of both numbers, in radians and metres, for all joints",
        {"type": float, "default": 0.0, "metavar": "M"}),
    ("tracking", "--tracking-delay", "tracking error per unit of joint velocity in milliseconds (default: 0)",
        {"type": float, "default": 0.0, "metavar": "MS"}),
    ("deadline", "--deadline", "time limit of planning in milliseconds, without the time for loading (default: none)",
        {"dest": "deadline_ms", "type": float, "metavar": "MS"}),
    ("mcap", "--mcap", "also write motion.mcap for Foxglove and RViz (needs the extra ros)", {"action": "store_true"}),
    ("quiet", "--quiet", "print no progress and no summary", {"action": "store_true"}),
)  # fmt: skip


def add_shared(
    parser: argparse.ArgumentParser, *groups: str, scene: str = "the paper's reference scene, Table 1"
) -> None:
    """Add groups of shared options.

    Args:
        groups: Groups of `_SHARED`.
        scene: Description of the default scene in the help text.
    """
    for group in groups:
        for name, words, settings in (row[1:] for row in _SHARED if row[0] == group):
            parser.add_argument(name, help=words.replace("{scene}", scene), **settings)


def refuse(arguments: argparse.Namespace, names: Collection[str], expected: str) -> None:
    """Refuse options that would have no effect.

    Args:
        names: Destinations of the options; names unknown to the command are skipped.
        expected: The expected value in the error message.

    Raises:
        OptionError: One of the options differs from its default.
    """
    for action in arguments.parser._actions:
        if action.dest in names and getattr(arguments, action.dest) != action.default:
            raise OptionError(action.option_strings[-1], getattr(arguments, action.dest), expected)


def names_robots(scene: str) -> bool:
    """True if a scene file has the key `robots`, a workcell.

    False if the file cannot be read: loading it reports the error.
    """
    try:
        with Path(scene).open(encoding="utf-8") as file:
            return any(re.match(r"\s*[\"']?robots[\"']?\s*:", line) for line in file)
    except (OSError, UnicodeDecodeError):
        return False


def scene_among(
    arguments: argparse.Namespace, robot: Robot, scene: Scene, errors: Console
) -> tuple[Scene, dict[str, list[str]]]:
    """Apply `--yield-links`, `--drop-inside`, `--upright` and the limits of limbs to a scene.

    Returns:
        The scene, and for the report `left_out`: the names of the obstacles and fruits that were removed because they
        are inside the pedestal or turret. The names are printed too. Empty if nothing was removed.
    """
    if arguments.yield_links is not None:
        scene = scene.with_values(yield_links=tuple(arguments.yield_links))
    scene = scene_kept_upright(arguments, scene_with_wood(arguments, scene))
    if not arguments.drop_inside:
        return scene, {}
    from hplan.planning.world import without_inside

    smaller, names = without_inside(robot, scene)
    if not names:
        return smaller, {}
    goal = "" if smaller.goal == scene.goal else f"; the goal is now {smaller.goal.fruit}"
    told = f"removed, inside the pedestal or turret: {', '.join(names)}{goal}"
    errors.print(told, markup=False, soft_wrap=True)
    return smaller, {"left_out": list(names)}


#: Destinations of the options of limbs.
WOOD = ("contact_force", "wood_stress_mpa", "fruit_force")

#: Fields of `LimbLimits` by the names in `--limb-limits`.
_LIMB_LIMITS = {
    "contact-force": "contact_force",
    "wood-stress": "wood_stress_mpa",
    "fruit-force": "fruit_force",
    "youngs-modulus": "youngs_modulus_gpa",
}


def scene_with_wood(arguments: argparse.Namespace, scene: Scene) -> Scene:
    """A scene with the limits of `--contact-force` and the other options of limbs, if one of them is given.

    Raises:
        OptionError: A value of `--limb-limits` is malformed.
        SceneError: A limit is not positive, the scene has no limbs, or `--limb-limits` names none.
    """
    given: dict[str, Any] = {key: getattr(arguments, key) for key in WOOD if getattr(arguments, key) is not None}
    limits = tuple(map(_limb_limits, arguments.limb_limits or ()))
    if not given and not limits:
        return scene
    from hplan.scene.model import with_limbs
    from hplan.scene.wood import Wood

    wood = scene.wood or Wood()
    new = (each for each in limits if each not in wood.limits)
    return with_limbs(scene, wood.with_values(**given, limits=(*wood.limits, *new)))


def _limb_limits(words: Sequence[str] | Mapping[str, Any]) -> LimbLimits:
    """Limits from the words of `--limb-limits`, or as in a report.

    Raises:
        OptionError: A word is not of the form LIMIT=VALUE with numbers.
        SceneError: A value is not permitted.
    """
    from hplan.scene.wood import LimbLimits

    if not isinstance(words, Sequence):
        return LimbLimits(**words)
    found: dict[str, Any] = {}
    for text in words[1:]:
        name, _, value = text.partition("=")
        try:
            numbers = tuple(map(float, value.split(":")))
            found[_LIMB_LIMITS[name]] = numbers if name == "youngs-modulus" else float(value)
        except (KeyError, ValueError):
            expected = f"NAMES, then LIMIT=VALUE with one of {', '.join(_LIMB_LIMITS)}"
            raise OptionError("--limb-limits", text, expected) from None
    return LimbLimits(names=(words[0],), **found)


def scene_kept_upright(arguments: argparse.Namespace, scene: Scene) -> Scene:
    """A scene with the tilt of `--upright` and `--upright-axis`, if one of them is given.

    Raises:
        SceneError: The angle is out of range, or the axis is zero.
        OptionError: An axis is given without an angle.
    """
    tilt, axis = getattr(arguments, "upright", None), getattr(arguments, "upright_axis", None)
    if tilt is None and axis is None:
        return scene
    known = scene.upright
    if tilt is None and known is None:
        raise OptionError("--upright-axis", axis, "no value without --upright")
    given = {"max_tilt_deg": tilt} | {"axis": None if axis is None else tuple(axis)}
    kept = {key: value for key, value in given.items() if value is not None}
    return scene.with_values(upright=({} if known is None else known.model_dump()) | kept)


def held_joints(arguments: argparse.Namespace) -> dict[str, float]:
    """Positions of the locked joints from `--hold` [rad, or m if prismatic].

    Raises:
        OptionError: A value is not of the form NAME=NUMBER with a finite number.
    """
    held = {}
    for text in arguments.hold:
        name, _, value = text.partition("=")
        try:
            held[name] = float(value)
        except ValueError:
            held[name] = math.nan
        if not (name and math.isfinite(held[name])):
            raise OptionError("--hold", text, "NAME=RAD, the name of a joint and its position")
    return held


def xacro_arguments(arguments: argparse.Namespace) -> dict[str, str]:
    """Arguments of a xacro file from `--xacro`.

    Raises:
        OptionError: An argument is not of the form NAME:=VALUE.
    """
    given = {}
    for text in arguments.xacro:
        name, sign, value = text.partition(":=")
        if not (name and sign):
            raise OptionError("--xacro", text, "NAME:=VALUE, an argument of the xacro file and its value")
        given[name] = value
    return given


def from_visual(arguments: argparse.Namespace) -> bool | tuple[str, ...]:
    """Links of `--collision-from-visual`; True without names, False without the option."""
    names = getattr(arguments, "collision_from_visual", None)
    return names is not None and (tuple(names) or True)


def robot_of(arguments: argparse.Namespace, scene: Scene | None = None, job: FinishedJob | None = None) -> Robot:
    """Load the robot of `--robot`, else the scene's, else the job's.

    Raises:
        OptionError: A tracking error that does not apply to the robot's joints (`check_tracking`).
        HplanError: The robot cannot be loaded.
    """
    from hplan.robot.model import load_robot

    options = robot_options(arguments)
    path = scene.robot if arguments.robot is None and scene is not None else arguments.robot
    if path is None and job is not None:
        path = job.robot
    robot = load_robot(path, **options)
    check_tracking(arguments, robot)
    return robot


def robot_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Arguments of `load_robot`, beside the path, from the options `parts` and `--limits`.

    Raises:
        OptionError: A value of `--hold` or `--xacro` is malformed.
    """
    return {
        "limits": arguments.limits,
        "tool_frame": arguments.tool_frame,
        "tool_tube_m": arguments.tool_tube_m,
        "hold": held_joints(arguments),
        "package_dirs": arguments.package_dir,
        "srdf": arguments.srdf,
        "allow_neighbours": arguments.allow_neighbours,
        "collision_from_visual": from_visual(arguments),
        "xacro_args": xacro_arguments(arguments),
        "acceleration_scale": arguments.acceleration_scale,
        "group": arguments.group,
        "group_state": arguments.group_state,
        "repair_inertia": arguments.repair_inertia,
    }


def source_of(arguments: argparse.Namespace) -> str | RobotSource | None:
    """Robot of the arguments, as a scene names it; None for the default one.

    Raises:
        SceneError: An option cannot be part of a scene.
    """
    from hplan.base.data_files import robot_names
    from hplan.scene.robot_source import RobotSource

    path = None if arguments.robot is None else str(arguments.robot)
    given = {name: value for name, value in robot_options(arguments).items() if value}
    if not given and (path is None or (path in robot_names() and not is_file(arguments.robot))):
        return path
    given |= {name: str(given[name]) for name in ("limits", "srdf") if name in given}
    if "package_dirs" in given:
        given["package_dirs"] = tuple(map(str, given["package_dirs"]))
    return RobotSource(urdf=path or "harvester", **given)


def tracking_of(arguments: argparse.Namespace) -> TrackingModel:
    """Tracking model of `--tracking-error`, `--tracking-error-m` and `--tracking-delay`.

    The model has a single number for radians and metres, the maximum of both (see `check_tracking`).

    Raises:
        OptionError: A value is negative or not finite.
    """
    from hplan.robot.tracking import TrackingModel

    error_deg, error_m, delay_ms = arguments.tracking_error, arguments.tracking_error_m, arguments.tracking_delay
    given = ("--tracking-error", error_deg, "degrees"), ("--tracking-error-m", error_m, "metres")
    for option, value, unit in (*given, ("--tracking-delay", delay_ms, "ms")):
        if not 0.0 <= value < math.inf:
            raise OptionError(option, value, f"a finite number of {unit} >= 0")
    return TrackingModel(max(math.radians(error_deg), error_m), 1e-3 * delay_ms)


def check_tracking(arguments: argparse.Namespace, robot: Robot) -> None:
    """Check that the units of the tracking errors match the robot's joints.

    Raises:
        OptionError: An error in metres for a robot without prismatic joints, or an error in one unit only for a robot
            that also has joints of the other unit.
    """
    degrees, metres = getattr(arguments, "tracking_error", None), getattr(arguments, "tracking_error_m", None)
    if metres and not any(robot.slides):
        raise OptionError("--tracking-error-m", metres, "0: the robot has no prismatic joint")
    for option, value, other, kind, words in (
        (
            "--tracking-error-m",
            metres,
            degrees,
            True,
            "a length in metres: joint {!r} is prismatic, and degrees are not a length",
        ),
        (
            "--tracking-error",
            degrees,
            metres,
            False,
            "an angle in degrees: joint {!r} is revolute, and metres are not an angle",
        ),
    ):
        if other and not value and kind in robot.slides:
            raise OptionError(option, value, words.format(robot.joint_names[robot.slides.index(kind)]))


def plan_options(arguments: argparse.Namespace, *options: str) -> PlanOptions:
    """Build the plan options from the arguments.

    Args:
        arguments: The arguments; tracking, rate, speed, seed and deadline are always taken over.
        options: Names of the other options to take over.
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


def check_output_file(out: Path, option: str = "--out", *, force: bool) -> None:
    """Check, before any work, that an output file may be written.

    Args:
        out: The file to write.
        option: Name of the option, for the error message.
        force: Allow replacing a file that hplan did not write.

    Raises:
        OptionError: The file is an input of the command.
        OutputError: Its folder does not exist, or hplan did not write the existing file.
    """
    if out.resolve() in inputs():
        raise OptionError(option, str(out), "a file other than the inputs")
    if not is_folder(out.resolve().parent):
        raise OutputError(out, "its folder does not exist")
    check_own(out, force=force)
