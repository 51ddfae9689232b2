"""Finds, reads and checks the files of any robot.

A robot has a URDF and, in the same folder, a limits YAML for limits that URDF cannot express. Robots of the package
example-robot-data are found by name (extra `robots`).
"""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal

import numpy as np
import pinocchio as pin

from hplan.base.arguments import file_path
from hplan.base.arrays import FloatArray
from hplan.base.checked import Positive, StrictModel
from hplan.base.data_files import LIMITS_SUFFIX, robot_names, shipped_limits, shipped_robots, urdf_dir
from hplan.base.files import is_file
from hplan.errors import InputError, RobotFileError, SceneError
from hplan.robot.urdf_check import check_models
from hplan.robot.urdf_file import Urdf, read_urdf
from hplan.robot.urdf_xml import URDF_TEXT, is_urdf_text, line_of, read_urdf_xml
from hplan.scene.file import read_model

#: Value of the key `format` in a limits file.
LIMITS_FORMAT = "hplan-limits/1"


@dataclass(frozen=True)
class NamedRobot:
    """Robot of the package example-robot-data that hplan knows by name.

    Attributes:
        urdf: Path of its URDF in that package's folder of robots.
        tool_frame: Frame at the end of the arm.
        srdf: Path of its SRDF there, if it declares links that may touch, with reasons; else None.
    """

    urdf: str
    tool_frame: str
    srdf: str | None = None


#: Robots by name. Their limits files, NAME.limits.yaml, are in the folder of the shipped robots.
NAMED_ROBOTS: Final = {
    "panda": NamedRobot("panda_description/urdf/panda.urdf", "panda_hand_tcp", "panda_description/srdf/panda.srdf"),
    "ur3": NamedRobot("ur_description/urdf/ur3_robot.urdf", "tool0"),
    "ur5": NamedRobot("ur_description/urdf/ur5_robot.urdf", "tool0"),
    "ur10": NamedRobot("ur_description/urdf/ur10_robot.urdf", "tool0"),
}


@dataclass(frozen=True)
class RobotFiles:
    """Paths of a robot's files.

    Attributes:
        urdf: The URDF.
        tool_frame: Frame at the end of the arm.
        srdf: The SRDF; None if there is no SRDF.
        limits: The limits file; None for the default one in the URDF's folder.
        package_dirs: Folders of its meshes.
    """

    urdf: Path
    tool_frame: str = "tool0"
    srdf: Path | None = None
    limits: Path | None = None
    package_dirs: tuple[Path, ...] = ()


def named_robot(name: str) -> RobotFiles:
    """Locate the files of a robot in `NAMED_ROBOTS`.

    Raises:
        InputError: The package example-robot-data is not installed.
    """
    robot, cmeel = NAMED_ROBOTS[name], find_spec("cmeel")
    roots = [] if cmeel is None else [Path(place).parent for place in cmeel.submodule_search_locations or ()]
    for root in roots:
        share = root / "cmeel.prefix" / "share"
        folder = share / "example-robot-data" / "robots"
        if (folder / robot.urdf).is_file():
            srdf = None if robot.srdf is None else folder / robot.srdf
            return RobotFiles(folder / robot.urdf, robot.tool_frame, srdf, shipped_limits(name), (share, folder))
    raise InputError(
        f"robot {name!r} is in the package example-robot-data, which is not installed: pip install 'hplan[robots]'",
        robot=name,
        extra="robots",
    )


def robot_files(path: Path | str | None) -> RobotFiles:
    """Locate the files of a robot by URDF path, text or name.

    Args:
        path: Path, text or name; None for the harvester.

    Raises:
        InputError: The package of the named robot is not installed.
    """
    if isinstance(path, str) and is_urdf_text(path):
        return RobotFiles(URDF_TEXT)
    found = urdf_dir() / "harvester.urdf" if path is None else file_path("path", path)
    if not is_file(found):
        if str(path) in shipped_robots():
            return RobotFiles(urdf_dir() / f"{path}.urdf")
        if str(path) in NAMED_ROBOTS:
            return named_robot(str(path))
    return RobotFiles(found)


def read_srdf(path: Path, links: Collection[str] | None = None) -> tuple[tuple[str, str, str], ...]:
    """Read the pairs of links that may touch from an SRDF.

    Pairs that the SRDF disables because they were never seen to touch are left out: they are checked. A pair without a
    reason gets `by the SRDF`.

    Args:
        path: The SRDF.
        links: Names of the robot's links; None if the robot is unknown.

    Raises:
        RobotFileError: The file is missing or malformed, a pair lacks a name, or no pair is of the robot's links.
    """
    root = read_urdf_xml(path)
    if root.find("link") is not None:
        raise RobotFileError(path, "it is a URDF because it has a <link>; expected an SRDF with <disable_collisions>")
    found, named = [], []
    for element in root.iter("disable_collisions"):
        pair = [element.get(key) for key in ("link1", "link2")]
        if not all(pair):
            raise RobotFileError(path, f"{line_of(element)}<disable_collisions> does not name two links")
        named.append(pair)
        reason = (element.get("reason") or "by the SRDF").strip()
        # A pair that was never seen to touch may still touch, so it is checked.
        if reason.lower().replace(" ", "") not in ("never", "notinsampling"):
            found.append((str(pair[0]), str(pair[1]), reason))
    if links is not None and named and not any(set(pair) <= set(links) for pair in named):
        first, second = named[0]
        reason = (
            f"it is for another robot: none of its pairs, {first!r} and {second!r} first, is of links of this robot"
        )
        raise RobotFileError(path, f"{reason}: {', '.join(links)}")
    return tuple(found)


def filtered_links(path: Path, root: ET.Element, links: Collection[str]) -> tuple[tuple[str, str, str], ...]:
    """Pairs of links that may touch by Drake's collision filter groups.

    The result has the format of `read_srdf`.

    Args:
        path: The file, for messages.
        root: Root element of the URDF.
        links: Names of the robot's links.

    Raises:
        RobotFileError: A group has a member, or ignores a group, that does not exist.
    """
    groups = {
        str(group.get("name")): group
        for group in root.findall("drake:collision_filter_group")
        if (group.get("ignore") or "false").strip().lower() in ("false", "0")
    }

    def named(element: ET.Element, key: str, known: Collection[str]) -> str:
        name = element.get(key)
        if name not in known:
            reason = f"{line_of(element)}{key} of <{element.tag}> is {name!r}, expected one of {', '.join(known)}"
            raise RobotFileError(path, reason)
        return str(name)

    members = {
        name: [named(member, "link", links) for member in group.findall("drake:member")]
        for name, group in groups.items()
    }
    found: dict[tuple[str, str], str] = {}
    for name, group in groups.items():
        for ignored in group.findall("drake:ignored_collision_filter_group"):
            for first, second in itertools.product(members[name], members[named(ignored, "name", groups)]):
                if first != second:
                    found.setdefault((min(first, second), max(first, second)), f"Drake's filter group {name!r}")
    return tuple((*pair, reason) for pair, reason in found.items())


def neighbouring_links(model: pin.Model) -> tuple[tuple[str, str, str], ...]:
    """Pairs of links with one joint between them, as in `read_srdf`."""
    links = [(frame.name, frame.parentJoint) for frame in model.frames if frame.type == pin.FrameType.BODY]
    return tuple(
        (first, second, "neighbours")
        for (first, i), (second, j) in itertools.combinations(links, 2)
        if i != j and (model.parents[j] == i or model.parents[i] == j)
    )


def read_models(urdf_path: Path) -> tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]:
    """Read a URDF's kinematic, collision and visual model with Pinocchio.

    Joints must not mimic others. Pinocchio raises one ValueError for every fault, writes the reason to the terminal,
    and ignores much that it cannot read. Therefore the file is first read strictly, and Pinocchio's model is compared
    with it.

    Raises:
        RobotFileError: The file is missing, unreadable or malformed XML, `hplan.robot.urdf_file` or Pinocchio refuses
            its content, or Pinocchio reads it differently.
    """
    return build_models(urdf_path, read_urdf(urdf_path, read_urdf_xml(urdf_path)))


def build_models(
    urdf_path: Path, urdf: Urdf, text: str | None = None
) -> tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]:
    """Build the kinematic, collision and visual model of a strictly read URDF.

    Args:
        urdf_path: The file; its folder contains the meshes.
        urdf: Its content.
        text: The XML to build from; None for the file's.

    Raises:
        RobotFileError: Pinocchio refuses the content, or reads it differently.
    """
    _check_moving_joints(urdf_path, urdf)
    models: tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]
    folders = [str(urdf_path.parent)]
    try:
        if text is None:
            models = pin.buildModelsFromUrdf(str(urdf_path), package_dirs=folders)
        else:
            with TemporaryDirectory() as scratch:
                file = Path(scratch, "adapted.urdf")
                file.write_text(text, encoding="utf-8")
                models = pin.buildModelsFromUrdf(str(file), package_dirs=folders)
    except (ValueError, RuntimeError) as error:
        of_mesh = str(error).partition("message: ")[2].partition("\nHint:")[0].replace("\n", " ")
        cause = of_mesh or str(error)
        reason = f"Pinocchio refuses it: {cause} (its own messages, if any, are on the terminal)"
        raise RobotFileError(urdf_path, reason) from error
    check_models(urdf_path, urdf, models[0], models[1])
    return models


def _check_moving_joints(path: Path, urdf: Urdf) -> None:
    """Check that no joint mimics another and that all limits are positive.

    Raises:
        RobotFileError: A joint mimics another, or a moving joint has a limit that is not positive.
    """
    for joint in urdf.joints.values():
        where = f"{line_of(joint.element)}joint {joint.name!r}"
        if joint.kind != "fixed" and joint.element.find("mimic") is not None:
            raise RobotFileError(path, f"{where} mimics another joint; every joint must move by itself")
        for key in ("velocity", "effort", "acceleration", "jerk") if joint.kind in ("revolute", "prismatic") else ():
            if key in joint.limits and not joint.limits[key] > 0.0:
                reason = f"{where}: {key} of <limit> is '{joint.limits[key]:g}', expected a positive finite number"
                raise RobotFileError(path, reason)


class _LimitsFile(StrictModel):
    """Limits YAML: limits that URDF cannot express, by joint name."""

    format: Literal["hplan-limits/1"]
    acceleration_rad_s2: dict[str, Positive] | None = None
    acceleration_m_s2: dict[str, Positive] | None = None
    jerk_rad_s3: dict[str, Positive] | None = None
    jerk_m_s3: dict[str, Positive] | None = None


def find_limits(
    urdf_path: Path, urdf: Urdf, joint_names: tuple[str, ...], given: Path | None, held: Iterable[str]
) -> tuple[FloatArray, FloatArray | None]:
    """Find acceleration and jerk limits in a limits file or URDF 1.2.

    Args:
        urdf_path: The URDF; the default limits file is `NAME.limits.yaml` in its folder, also for `NAME.urdf.xacro`.
        urdf: Its content.
        joint_names: Names of the joints, in the order of the result.
        given: The limits file; None for the default one.
        held: Names of further joints that the file may contain.

    Returns:
        (dof,) acceleration [rad/s^2, m/s^2] and jerk limits [rad/s^3, m/s^3]; None for no jerk limits.

    Raises:
        RobotFileError: The limits file is invalid (`read_limits`); or there is no file and the URDF lacks the
            acceleration of a joint, or the jerk of some joints only.
    """
    name = urdf_path.name.removesuffix(".xacro").removesuffix(".urdf") if urdf_path.suffix == ".xacro" else None
    default = urdf_path.with_suffix(LIMITS_SUFFIX) if name is None else urdf_path.with_name(name + LIMITS_SUFFIX)
    limits = [urdf.joints[name].limits for name in joint_names]
    is_text = urdf_path == URDF_TEXT
    if given is not None or not any("acceleration" in limit for limit in limits) or (is_file(default) and not is_text):
        if given is None and is_text:
            raise RobotFileError(urdf_path, f"it has no acceleration limits: {_LIMITS_ADVICE}")
        slides = [urdf.joints[name].kind == "prismatic" for name in joint_names]
        return read_limits(default if given is None else given, joint_names, slides, held)

    def listed(key: str) -> FloatArray:
        for name, limit in zip(joint_names, limits, strict=True):
            if key not in limit:
                reason = f"joint {name!r}: <limit> has no {key}, unlike other joints: {_LIMITS_ADVICE}"
                raise RobotFileError(urdf_path, line_of(urdf.joints[name].element) + reason)
        return np.array([limit[key] for limit in limits])

    return listed("acceleration"), listed("jerk") if any("jerk" in limit for limit in limits) else None


#: Advice on how to specify limits.
_LIMITS_ADVICE = (
    "write acceleration (and jerk) into every <limit> (URDF 1.2), or give a limits file (limits, --limits), or the "
    f"name of a robot whose limits ship with hplan: {', '.join(robot_names())}"
)


def limits_file(given: Path) -> Path:
    """Path of a limits file, given by path or robot name.

    A name must be of a robot whose limits ship with hplan.
    """
    return shipped_limits(str(given)) if not is_file(given) and str(given) in robot_names() else given


def read_limits(
    path: Path, joint_names: Sequence[str], slides: Sequence[bool], others: Iterable[str] = ()
) -> tuple[FloatArray, FloatArray | None]:
    """Read acceleration and jerk limits from a limits file.

    Args:
        path: The limits file.
        joint_names: Names of the joints, in the order of the result.
        slides: Whether each joint is prismatic: its limits are in metres, and may be in `acceleration_m_s2` and
            `jerk_m_s3`.
        others: Names of further joints that either table may contain.

    Returns:
        (dof,) acceleration [rad/s^2, m/s^2] and jerk limits [rad/s^3, m/s^3]; None for no jerk limits.

    Raises:
        RobotFileError: The file is missing or malformed; a joint is missing, unknown or in both units, or is revolute
            but in metres; or a limit is not positive.
    """
    try:
        limits = read_model(_LimitsFile, path)
    except SceneError as error:
        places = (f"line {error.line}" if error.line else None), error.where
        hint = f"; expected format: {LIMITS_FORMAT}" if error.where == "format" else ""
        if not is_file(path):
            hint = f"; it gives the acceleration limits that the URDF lacks: {_LIMITS_ADVICE}"
        raise RobotFileError(path, ": ".join([*filter(None, places), error.reason + hint])) from error

    known, kinds = frozenset(others), dict(zip(joint_names, slides, strict=True))

    def ordered(*keys: str) -> FloatArray | None:
        turning, sliding = (getattr(limits, key) for key in keys)
        if turning is None and sliding is None:
            return None
        found = (turning or {}) | (sliding or {})
        for name in sliding or {}:
            if not kinds.get(name, True):
                raise RobotFileError(path, f"{keys[1]}: joint {name!r} is revolute; it belongs in {keys[0]}")
            if name in (turning or {}):
                raise RobotFileError(path, f"{keys[1]}: joint {name!r} is also in {keys[0]}")
        missing = [name for name in joint_names if name not in found]
        unknown = [name for name in found if name not in kinds and name not in known]
        if missing or unknown:
            raise RobotFileError(path, f"{keys[0]}: joints missing {missing}, unknown {unknown}")
        return np.array([found[name] for name in joint_names])

    acceleration = ordered("acceleration_rad_s2", "acceleration_m_s2")
    if acceleration is None:
        raise RobotFileError(path, "acceleration_rad_s2 is missing, or acceleration_m_s2 of prismatic joints")
    return acceleration, ordered("jerk_rad_s3", "jerk_m_s3")
