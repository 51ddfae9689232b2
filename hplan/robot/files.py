"""Finds, reads and checks the files of any robot.

A robot has a URDF and, in the same folder, a limits YAML for limits that URDF cannot express. Robots of the package
example-robot-data are found by name (extra `robots`), those of robot_descriptions as `robot_descriptions:NAME`.
"""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arguments import file_path, nearest_name
from hplan.base.data_files import shipped_limits, shipped_robots, urdf_dir
from hplan.base.files import is_file
from hplan.errors import InputError, RobotFileError
from hplan.robot.faults import Faults
from hplan.robot.urdf_check import check_models
from hplan.robot.urdf_file import Urdf, check_moving_joints, read_urdf
from hplan.robot.urdf_xml import URDF_TEXT, is_urdf_text, line_of, read_urdf_xml

#: Beginning of the names of robots of the package robot_descriptions.
DESCRIBED: Final = "robot_descriptions:"


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
        xacro_args: Values of the arguments of a xacro file, by name.
    """

    urdf: Path
    tool_frame: str = "tool0"
    srdf: Path | None = None
    limits: Path | None = None
    package_dirs: tuple[Path, ...] = ()
    xacro_args: Mapping[str, str] = field(default_factory=dict)


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


def described_robot(name: str) -> RobotFiles:
    """Locate the files of a robot of the package robot_descriptions.

    Args:
        name: Name of its module, with or without `_description`: `ur5e`, `panda_mj`.

    Raises:
        InputError: The package is not installed, has no such robot, or cannot fetch it.
    """
    module = name.removesuffix("_description") + "_description"
    try:
        found = import_module(f"robot_descriptions.{module}")
    except ImportError as error:
        if find_spec("robot_descriptions") is None:
            reason = "is in the package robot_descriptions, which is not installed: pip install robot_descriptions"
        else:
            reason = f"is not in the package robot_descriptions: it has no module {module!r}"
        raise InputError(f"robot {name!r} {reason}", robot=name) from error
    except Exception as error:  # of git, which clones the robot's repository
        raise InputError(f"robot {name!r} cannot be fetched by robot_descriptions: {error}", robot=name) from error
    paths = [getattr(found, f"{kind}_PATH", None) for kind in ("URDF", "XACRO", "MJCF")]
    file = next((path for path in paths if path is not None), None)
    if file is None:
        raise InputError(f"robot {name!r} of robot_descriptions has neither URDF nor xacro nor MJCF", robot=name)
    folders = tuple(Path(getattr(found, key)) for key in ("PACKAGE_PATH", "REPOSITORY_PATH") if hasattr(found, key))
    arguments = {key: str(value) for key, value in getattr(found, "XACRO_ARGS", {}).items()}
    return RobotFiles(Path(file), package_dirs=folders, xacro_args=arguments)


def robot_files(path: Path | str | None) -> RobotFiles:
    """Locate the files of a robot by URDF path, text or name.

    Args:
        path: Path, text or name; None for the harvester.

    Raises:
        InputError: The package of the named robot is not installed.
    """
    if path is not None and str(path).startswith(DESCRIBED):
        return described_robot(str(path).removeprefix(DESCRIBED))
    if isinstance(path, str) and is_urdf_text(path):
        return RobotFiles(URDF_TEXT)
    found = urdf_dir() / "harvester.urdf" if path is None else file_path("path", path)
    if not is_file(found):
        if str(path) in shipped_robots():
            return RobotFiles(urdf_dir() / f"{path}.urdf")
        if str(path) in NAMED_ROBOTS:
            return named_robot(str(path))
    return RobotFiles(found)


class RobotGroup(NamedTuple):
    """Joints of a group of an SRDF.

    Attributes:
        base: Link below the group's first joint; None if the joints are listed.
        tip: Link at its end; None if the joints are listed.
        joints: Names of the listed joints, fixed ones too; empty for a chain.
    """

    base: str | None
    tip: str | None
    joints: tuple[str, ...]


def read_group(path: Path, name: str) -> RobotGroup:
    """Read a group of an SRDF: a chain, or a list of joints.

    Raises:
        RobotFileError: The file is missing or malformed, has no such group, or the group is neither a single chain nor
            a list of joints.
    """
    root = read_urdf_xml(path)
    groups = {str(group.get("name")): group for group in root.findall("group")}

    def parts(group: str, above: tuple[str, ...] = ()) -> list[ET.Element]:
        if group not in groups:
            raise RobotFileError(path, f"group {group!r}: {nearest_name(group, groups)}")
        if group in above:
            raise RobotFileError(path, f"group {group!r} contains itself")
        found: list[ET.Element] = []
        for part in groups[group]:
            found += parts(str(part.get("name")), (*above, group)) if part.tag == "group" else [part]
        return found

    found = parts(name)
    chains = [part for part in found if part.tag == "chain"]
    joints = tuple(str(part.get("name")) for part in found if part.tag == "joint")
    if len(chains) == 1 and not joints:
        return RobotGroup(chains[0].get("base_link"), chains[0].get("tip_link"), ())
    if joints and not chains:
        return RobotGroup(None, None, joints)
    kinds = ", ".join(dict.fromkeys(part.tag for part in found)) or "nothing"
    raise RobotFileError(path, f"group {name!r} has {kinds}; expected one <chain>, or <joint>s")


def read_group_state(path: Path, name: str) -> dict[str, float]:
    """Read the joint values of a group state of an SRDF, of all groups that have one of this name [rad, m].

    Raises:
        RobotFileError: The file is missing or malformed, has no such state, or a value is not a number.
    """
    states = read_urdf_xml(path).findall("group_state")
    named = [state for state in states if state.get("name") == name]
    if not named:
        known = [str(state.get("name")) for state in states]
        raise RobotFileError(path, f"group state {name!r}: {nearest_name(name, known)}")
    values: dict[str, float] = {}
    for joint in (joint for state in named for joint in state.findall("joint")):
        try:
            values[str(joint.get("name"))] = float(joint.get("value", ""))
        except ValueError as error:
            reason = f"{line_of(joint)}value of joint {joint.get('name')!r} is {joint.get('value')!r}"
            raise RobotFileError(path, f"{reason}, expected one number") from error
    return values


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

    def check_named(element: ET.Element, key: str, known: Collection[str]) -> str:
        name = element.get(key)
        if name not in known:
            reason = f"{line_of(element)}{key} of <{element.tag}> is {name!r}, expected one of {', '.join(known)}"
            raise RobotFileError(path, reason)
        return str(name)

    members = {
        name: [check_named(member, "link", links) for member in group.findall("drake:member")]
        for name, group in groups.items()
    }
    found: dict[tuple[str, str], str] = {}
    for name, group in groups.items():
        for ignored in group.findall("drake:ignored_collision_filter_group"):
            for first, second in itertools.product(members[name], members[check_named(ignored, "name", groups)]):
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
    root, faults = read_urdf_xml(urdf_path), Faults(urdf_path)
    urdf = read_urdf(urdf_path, root, faults=faults)
    faults.check()
    return build_models(
        urdf_path, urdf, ET.tostring(root, encoding="unicode") if faults.mended or root.is_made else None
    )


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
    faults = Faults(urdf_path)
    check_moving_joints(faults, urdf)
    faults.check()
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
    for number, name in enumerate(models[0].names[1:]):
        models[0].armature[number] = urdf.joints[name].armature
    for model in models[1:]:
        _check_meshes(faults, model)
    faults.check()
    return models


def _check_meshes(faults: Faults, shapes: pin.GeometryModel) -> None:
    """Find meshes with vertices that are not finite or too far.

    Too far is farther than any arm is long.
    """
    # No arm is as long, not even in millimetres read as metres [m].
    farthest = 1000.0
    for shape in shapes.geometryObjects:
        if not isinstance(shape.geometry, coal.BVHModelBase):
            continue
        away = np.abs(np.asarray(shape.geometry.vertices())).max(axis=1)
        where = f"link {shape.name.rpartition('_')[0]!r}: mesh {shape.meshPath}"
        if not np.isfinite(away).all():
            faults.add(f"{where} has {int(np.sum(~np.isfinite(away)))} vertices that are not finite numbers")
        elif away.max() > farthest:
            advice = 'scale="0.001 0.001 0.001" in <mesh> reads millimetres'
            faults.add(f"{where} reaches to {away.max():.4g} m, expected at most {farthest:g} m; {advice}")
