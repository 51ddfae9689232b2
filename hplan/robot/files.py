"""The files of a robot, read and checked: URDF, and in the same folder a limits YAML for what URDF cannot say.

Any robot's; which of them hplan can plan for is decided in `hplan.robot.family_reader`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml
from pydantic import BaseModel, ConfigDict, PositiveFloat, ValidationError

from hplan.base.arrays import FloatArray
from hplan.base.yaml_text import read_yaml
from hplan.errors import RobotFileError
from hplan.robot.urdf_check import check_models
from hplan.robot.urdf_file import Urdf, read_urdf
from hplan.robot.urdf_xml import line_of, read_urdf_xml

#: Key `format` of a limits file.
LIMITS_FORMAT = "hplan-limits/1"

#: What stands in the limits file's name in place of `.urdf`.
LIMITS_SUFFIX = ".limits.yaml"


def read_models(urdf_path: Path) -> tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]:
    """Read a URDF of serial joints with Pinocchio: kinematic, collision and visual model.

    Pinocchio raises one ValueError for every fault and writes the reason to the terminal, and passes over much that it
    cannot read; so the file is read by itself first, strictly, and what Pinocchio has is compared with it.

    Raises:
        RobotFileError: Missing or unreadable file, malformed XML, content that `hplan.robot.urdf_file` or Pinocchio
            refuses, or that Pinocchio reads otherwise.
    """
    urdf = read_urdf(urdf_path, read_urdf_xml(urdf_path))
    _check_family(urdf_path, urdf)
    try:
        models: tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]
        models = pin.buildModelsFromUrdf(str(urdf_path), package_dirs=[str(urdf_path.parent)])
    except (ValueError, RuntimeError) as error:
        reason = f"Pinocchio refuses it: {error} (its reader's own words, if any, are on the terminal)"
        raise RobotFileError(urdf_path, reason) from error
    check_models(urdf_path, urdf, models[0], models[1])
    return models


def _check_family(path: Path, urdf: Urdf) -> None:
    """Refuse what a file may say but no arm of the family can have: joints that mimic, limits of zero.

    Raises:
        RobotFileError: There is one; names line and element.
    """
    for joint in urdf.joints.values():
        where = f"{line_of(joint.element)}joint {joint.name!r}"
        if joint.element.find("mimic") is not None:
            raise RobotFileError(path, f"{where} mimics another; every joint must move by itself")
        for key in ("velocity", "effort") if joint.kind == "revolute" else ():
            if not joint.limits[key] > 0.0:
                text = joint.element.find("limit").get(key)  # type: ignore[union-attr]
                reason = f"{where}: {key} of <limit> is {text!r}, expected a finite number that is positive"
                raise RobotFileError(path, reason)


class _LimitsFile(BaseModel):
    """The limits YAML: what URDF has no word for, by joint name."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)

    format: str
    acceleration_rad_s2: dict[str, PositiveFloat]
    jerk_rad_s3: dict[str, PositiveFloat] | None = None


def read_limits(path: Path, joint_names: tuple[str, ...]) -> tuple[FloatArray, FloatArray | None]:
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

    def ordered(key: str, table: dict[str, float]) -> FloatArray:
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
