"""Limits files: acceleration, jerk and other limits of joints.

Velocities and efforts replace those of the URDF.

Read are hplan's own format and MoveIt's `joint_limits.yaml`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from pydantic import ConfigDict

from hplan.base.arguments import nearest_name
from hplan.base.arrays import FloatArray
from hplan.base.checked import Positive, StrictModel
from hplan.base.data_files import LIMITS_SUFFIX, robot_names, shipped_limits
from hplan.base.files import ByteBudget, is_file
from hplan.errors import OptionError, RobotFileError, SceneError
from hplan.robot.urdf_file import Urdf
from hplan.robot.urdf_xml import URDF_TEXT, line_of
from hplan.scene.file import parse_model, read_model
from hplan.scene.limits import MOST_SCENE_BYTES

#: Value of the key `format` in a limits file.
LIMITS_FORMAT = "hplan-limits/1"

#: Ratio of accelerations to velocity limits if nothing gives acceleration limits: full speed in half a second [1/s].
ACCELERATION_SCALE: Final = 2.0

#: Keys of a limits file by quantity: of joints that turn, and of joints that slide.
LIMIT_KEYS: Final = {
    "velocity": ("velocity_rad_s", "velocity_m_s"),
    "acceleration": ("acceleration_rad_s2", "acceleration_m_s2"),
    "jerk": ("jerk_rad_s3", "jerk_m_s3"),
    "effort": ("effort_nm", "effort_n"),
}


class _LimitsFile(StrictModel):
    """Limits YAML: limits that URDF cannot express or lacks, by joint name."""

    format: Literal["hplan-limits/1"]
    velocity_rad_s: dict[str, Positive] | None = None
    velocity_m_s: dict[str, Positive] | None = None
    acceleration_rad_s2: dict[str, Positive] | None = None
    acceleration_m_s2: dict[str, Positive] | None = None
    jerk_rad_s3: dict[str, Positive] | None = None
    jerk_m_s3: dict[str, Positive] | None = None
    effort_nm: dict[str, Positive] | None = None
    effort_n: dict[str, Positive] | None = None


class _MoveItJoint(StrictModel):
    """Limits of one joint in MoveIt's file.

    A limit counts if its `has_` key is true.
    """

    model_config = ConfigDict(extra="ignore")

    has_position_limits: bool = False
    min_position: float | None = None
    max_position: float | None = None
    has_velocity_limits: bool = False
    max_velocity: float | None = None
    has_acceleration_limits: bool = False
    max_acceleration: float | None = None
    has_jerk_limits: bool = False
    max_jerk: float | None = None
    has_effort_limits: bool = False
    max_effort: float | None = None

    def limits(self) -> dict[str, float]:
        """Limits that count, by quantity; `lower` and `upper` for the positions."""
        found = {
            quantity: getattr(self, f"max_{quantity}")
            for quantity in LIMIT_KEYS
            if getattr(self, f"has_{quantity}_limits")
        }
        if self.has_position_limits:
            found |= {"lower": self.min_position, "upper": self.max_position}
        return {quantity: float(value) for quantity, value in found.items() if value is not None}


class _MoveItFile(StrictModel):
    """MoveIt's `joint_limits.yaml`."""

    model_config = ConfigDict(extra="ignore")

    joint_limits: dict[str, _MoveItJoint]


@dataclass(frozen=True)
class _Tables:
    """Content of a limits file: quantity, joint, value.

    Attributes:
        turning: Limits of joints that turn, or of any.
        sliding: Limits of joints that slide.
        is_moveit: Whether it is MoveIt's file: it may have joints of other robots.
    """

    turning: Mapping[str, Mapping[str, float]]
    sliding: Mapping[str, Mapping[str, float]]
    is_moveit: bool = False


def _read_tables(path: Path) -> _Tables:
    """Read a limits file of either format.

    Raises:
        RobotFileError: The file is missing or malformed.
    """
    try:
        text = ByteBudget(MOST_SCENE_BYTES).text(path, lambda reason: SceneError(reason, path=path))
        if re.search(r"(?m)^joint_limits\s*:", text):
            found: dict[str, dict[str, float]] = {}
            for joint, limits in parse_model(_MoveItFile, text, path).joint_limits.items():
                for quantity, value in limits.limits().items():
                    found.setdefault(quantity, {})[joint] = value
            return _Tables(found, {}, is_moveit=True)
        own = read_model(_LimitsFile, path)
    except SceneError as error:
        places = (f"line {error.line}" if error.line else None), error.where
        hint = f"; expected format: {LIMITS_FORMAT}" if error.where == "format" else ""
        if not is_file(path):
            hint = f"; it gives the acceleration limits that the URDF lacks: {LIMITS_ADVICE}"
        raise RobotFileError(path, ": ".join([*filter(None, places), error.reason + hint])) from error
    turning, sliding = (
        {quantity: getattr(own, keys[side]) for quantity, keys in LIMIT_KEYS.items() if getattr(own, keys[side])}
        for side in (0, 1)
    )
    return _Tables(turning, sliding)


def limits_in_place(path: Path, joints: Collection[str]) -> dict[str, dict[str, float]]:
    """Limits of a limits file that take the place of the URDF's.

    Args:
        path: The limits file.
        joints: Names of the URDF's joints.

    Returns:
        `lower`, `upper`, `velocity` and `effort`, as far as the file has them, by joint name [rad, m, s, N m, N].

    Raises:
        RobotFileError: The file is missing or malformed, one of these limits is not positive, or of no joint of the
            URDF (MoveIt's files may have further joints).
    """
    tables, found = _read_tables(path), dict[str, dict[str, float]]()
    for quantity in ("lower", "upper", "velocity", "effort"):
        for table in (tables.turning, tables.sliding):
            for joint, value in table.get(quantity, {}).items():
                if joint not in joints:
                    if tables.is_moveit:
                        continue
                    raise RobotFileError(path, f"{quantity} of joint {joint!r}: {nearest_name(joint, joints)}")
                if quantity in LIMIT_KEYS and not value > 0.0:
                    reason = f"max_{quantity} of joint {joint!r} is {value:g}, expected a positive number"
                    raise RobotFileError(path, reason)
                found.setdefault(joint, {})[quantity] = value
    return found


def default_limits(urdf_path: Path) -> Path:
    """Default limits file: `NAME.limits.yaml` in the URDF's folder, also for `NAME.urdf.xacro`."""
    if urdf_path.suffix != ".xacro":
        return urdf_path.with_suffix(LIMITS_SUFFIX) if urdf_path.name else urdf_path / LIMITS_SUFFIX
    return urdf_path.with_name(urdf_path.name.removesuffix(".xacro").removesuffix(".urdf") + LIMITS_SUFFIX)


def find_limits(
    urdf_path: Path,
    urdf: Urdf,
    joint_names: tuple[str, ...],
    given: Path | None,
    held: Iterable[str],
    scale: float | None = None,
) -> tuple[FloatArray, FloatArray | None, str | None]:
    """Find acceleration and jerk limits in a limits file or URDF 1.2, or assume them.

    Args:
        urdf_path: The URDF; the default limits file is `NAME.limits.yaml` in its folder, also for `NAME.urdf.xacro`.
        urdf: Its content.
        joint_names: Names of the joints, in the order of the result.
        given: The limits file; None for the default one.
        held: Names of further joints that the file may contain.
        scale: Ratio of assumed accelerations to the velocity limits [1/s]; None for `ACCELERATION_SCALE`.

    Returns:
        (dof,) acceleration [rad/s^2, m/s^2] and jerk limits [rad/s^3, m/s^3]; None for no jerk limits. The assumption,
        if nothing gives accelerations; None if the file or the URDF does.

    Raises:
        RobotFileError: The limits file is invalid (`read_limits`); or there is no file and the URDF lacks the
            acceleration or jerk of some joints only.
        OptionError: `scale` is given although the accelerations are.
    """
    default = default_limits(urdf_path)
    limits = [urdf.joints[name].limits for name in joint_names]
    is_text = urdf_path == URDF_TEXT
    from_file = given is not None or (is_file(default) and not is_text)
    if not from_file and not any("acceleration" in limit for limit in limits):
        factor = ACCELERATION_SCALE if scale is None else scale
        assumed = f"it has no acceleration limits; {factor:g} /s times the velocity limits are assumed: {LIMITS_ADVICE}"
        return factor * np.array([limit["velocity"] for limit in limits]), None, assumed
    if scale is not None:
        source = (default if given is None else given) if from_file else "the URDF"
        raise OptionError("acceleration_scale", scale, f"None: {source} gives the acceleration limits")
    if from_file:
        slides = [urdf.joints[name].kind == "prismatic" for name in joint_names]
        return *read_limits(default if given is None else given, joint_names, slides, held), None

    def read_list(key: str) -> FloatArray:
        for name, limit in zip(joint_names, limits, strict=True):
            if key not in limit:
                reason = f"joint {name!r}: <limit> has no {key}, unlike other joints: {LIMITS_ADVICE}"
                raise RobotFileError(urdf_path, line_of(urdf.joints[name].element) + reason)
        return np.array([limit[key] for limit in limits])

    jerk = read_list("jerk") if any("jerk" in limit for limit in limits) else None
    return read_list("acceleration"), jerk, None


#: Advice on how to specify limits.
LIMITS_ADVICE: Final = (
    "write acceleration (and jerk) into every <limit> (URDF 1.2), or give a limits file (limits, --limits; "
    "hplan inspect --write-limits writes one), or the name of a robot whose limits ship with hplan: "
    f"{', '.join(robot_names())}"
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
    tables = _read_tables(path)
    known, kinds = frozenset(others), dict(zip(joint_names, slides, strict=True))

    def read_ordered(quantity: str) -> FloatArray | None:
        keys = LIMIT_KEYS[quantity]
        turning, sliding = (table.get(quantity, {}) for table in (tables.turning, tables.sliding))
        if not turning and not sliding:
            return None
        found = {**turning, **sliding}
        for name in sliding:
            if not kinds.get(name, True):
                raise RobotFileError(path, f"{keys[1]}: joint {name!r} is revolute; it belongs in {keys[0]}")
            if name in turning:
                raise RobotFileError(path, f"{keys[1]}: joint {name!r} is also in {keys[0]}")
        missing = [name for name in joint_names if not found.get(name, 0.0) > 0.0]
        unknown = [name for name in found if name not in kinds and name not in known and not tables.is_moveit]
        if missing and tables.is_moveit:
            lacking = f"has_{quantity}_limits: true and a positive max_{quantity}"
            raise RobotFileError(path, f"joint_limits: joints {missing} need {lacking}")
        if missing or unknown:
            raise RobotFileError(path, f"{keys[0]}: joints missing {missing}, unknown {unknown}")
        return np.array([found[name] for name in joint_names])

    acceleration = read_ordered("acceleration")
    if acceleration is None:
        lacking = "acceleration_rad_s2 is missing, or acceleration_m_s2 of prismatic joints"
        if tables.is_moveit:
            lacking = "joint_limits: no joint has has_acceleration_limits: true and a positive max_acceleration"
        raise RobotFileError(path, lacking)
    return acceleration, read_ordered("jerk")
