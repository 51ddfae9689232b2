"""The files of a robot, read and checked: URDF, and beside it a limits YAML for what URDF cannot say.

Any robot's; which of them hplan can plan for is decided in `hplan.family_reader`.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, PositiveFloat, ValidationError

from hplan.errors import RobotFileError
from hplan.yaml_text import read_yaml

#: Key `format` of a limits file.
LIMITS_FORMAT = "hplan-limits/1"

#: What stands in the limits file's name in place of `.urdf`.
LIMITS_SUFFIX = ".limits.yaml"


def read_models(urdf_path: Path) -> tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]:
    """Read a URDF of any robot with Pinocchio: kinematic, collision and visual model.

    Pinocchio raises one ValueError for every fault and writes the reason to the terminal, so the file and its XML
    are checked first.

    Raises:
        RobotFileError: Missing or unreadable file, malformed XML, or refused by Pinocchio.
    """
    root = read_urdf_xml(urdf_path)
    check_links_and_joints(urdf_path, root)
    _check_numbers(urdf_path, root)
    try:
        models: tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]
        models = pin.buildModelsFromUrdf(str(urdf_path), package_dirs=[str(urdf_path.parent)])
    except (ValueError, RuntimeError) as error:
        reason = f"Pinocchio refuses it: {error} (its reader's own words, if any, are on the terminal)"
        raise RobotFileError(urdf_path, reason) from error
    return models


def read_urdf_xml(path: Path) -> ET.Element:
    """Read a URDF's XML and nothing more: its root element.

    Raises:
        RobotFileError: Missing or unreadable file, malformed XML, or no robot.
    """
    try:
        root = ET.parse(path).getroot()
    except OSError as error:
        raise RobotFileError(path, error.strerror or str(error)) from error
    except (ET.ParseError, LookupError, ValueError) as error:  # the last two: an encoding that Python does not know
        raise RobotFileError(path, f"malformed XML: {error}") from error
    if root.tag != "robot":
        raise RobotFileError(path, f"the root element is <{root.tag}>, expected <robot>")
    return root


def check_links_and_joints(path: Path, root: ET.Element) -> None:
    """Refuse what Pinocchio would refuse without a reason, or take in silence: names and what joins what.

    Raises:
        RobotFileError: A name missing or given twice, a joint to a link that does not exist, a joint that mimics.
    """
    if not root.get("name"):
        raise RobotFileError(path, "the robot has no name")
    links = [link.get("name") for link in root.findall("link")]
    joints = [joint.get("name") for joint in root.findall("joint")]
    for kind, names in (("link", links), ("joint", joints)):
        if None in names:
            raise RobotFileError(path, f"a <{kind}> has no name")
        twice = sorted({str(name) for name in names if names.count(name) > 1})
        if twice:
            raise RobotFileError(path, f"{kind} {twice[0]!r} is defined twice")
    for joint in root.findall("joint"):
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if link not in links:
                raise RobotFileError(path, f"joint {joint.get('name')!r}: its {end} link {link!r} does not exist")
        if joint.find("mimic") is not None:
            raise RobotFileError(path, f"joint {joint.get('name')!r} mimics another; every joint must move by itself")


def _check_numbers(path: Path, root: ET.Element) -> None:
    """The same for the numbers that safety depends on: sizes of collision geometry, masses, joint limits."""
    for link in root.findall("link"):
        where = f"link {link.get('name')!r}"
        for mass in link.findall("inertial/mass"):
            _number(path, where, mass, "value", "not negative", lambda value: value >= 0.0)
        for collision in link.findall("collision"):
            shape = collision.find("geometry/*")
            if shape is None:
                raise RobotFileError(path, f"{where}: a <collision> has no geometry")
            for attribute in ("radius", "length", "size"):
                if attribute in shape.attrib:
                    _number(path, where, shape, attribute, "positive", lambda value: value > 0.0)
    for joint in root.findall("joint"):
        if joint.get("type") != "revolute":
            continue
        where = f"joint {joint.get('name')!r}"
        limit = joint.find("limit")
        if limit is None:
            raise RobotFileError(path, f"{where}: it has no <limit>")
        for attribute in sorted(limit.attrib.keys() & {"lower", "upper"}):
            _number(path, where, limit, attribute, "in radians", math.isfinite)
        for attribute in ("velocity", "effort"):
            _number(path, where, limit, attribute, "positive", lambda value: value > 0.0)


def _number(
    path: Path,
    where: str,
    element: ET.Element,
    attribute: str,
    expected: str,
    accepts: Callable[[float], bool],
) -> None:
    """Require an attribute that holds a finite number, or several with spaces between, that `accepts` lets pass."""
    text = element.get(attribute)
    if text is None:
        raise RobotFileError(path, f"{where}: <{element.tag}> has no {attribute}")
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if not values or not all(math.isfinite(value) and accepts(value) for value in values):
        reason = f"{where}: {attribute} of <{element.tag}> is {text!r}, expected a finite number that is {expected}"
        raise RobotFileError(path, reason)


class _LimitsFile(BaseModel):
    """The limits YAML: what URDF has no word for, by joint name."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)

    format: str
    acceleration_rad_s2: dict[str, PositiveFloat]
    jerk_rad_s3: dict[str, PositiveFloat] | None = None


def read_limits(path: Path, joint_names: tuple[str, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Read acceleration [rad/s^2] and, where given, jerk limits [rad/s^3] in the order of `joint_names`.

    Raises:
        RobotFileError: Missing or malformed file, a joint missing or unknown, a limit that is not positive.
    """
    try:
        content, _ = read_yaml(path.read_text(encoding="utf-8"))
        limits = _LimitsFile.model_validate(content)
    except OSError as error:
        raise RobotFileError(path, f"{error.strerror}; it gives the acceleration limits, which URDF cannot") from error
    except UnicodeDecodeError as error:
        raise RobotFileError(path, "it is not UTF-8 text") from error
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f"line {error.problem_mark.line + 1}: "
        raise RobotFileError(path, f"{line}malformed YAML: {error.problem}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = "".join(f"{part}: " for part in first["loc"])
        raise RobotFileError(path, f"{where}{first['msg']} (got {first['input']!r})") from error
    if limits.format != LIMITS_FORMAT:
        raise RobotFileError(path, f"format is {limits.format!r}, expected {LIMITS_FORMAT!r}")

    def ordered(key: str, table: dict[str, float]) -> NDArray[np.float64]:
        missing = [name for name in joint_names if name not in table]
        unknown = [name for name in table if name not in joint_names]
        if missing or unknown:
            raise RobotFileError(path, f"{key}: joints missing {missing}, unknown {unknown}")
        return np.array([table[name] for name in joint_names])

    jerk = limits.jerk_rad_s3
    return (
        ordered("acceleration_rad_s2", limits.acceleration_rad_s2),
        None if jerk is None else ordered("jerk_rad_s3", jerk),
    )
