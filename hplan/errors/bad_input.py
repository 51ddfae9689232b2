"""Errors about invalid input: files, scenes, options, configurations (exit status 2)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar

from hplan.errors.root import HplanError


class InputError(HplanError):
    """An argument, file or option cannot be used.

    Examples:
        >>> from hplan.errors import InputError
        >>> InputError("row.csv: no samples", path="row.csv").exit_status
        2
    """

    exit_status = 2


class RobotFileError(InputError):
    """A robot file (URDF or limits YAML) is missing, unreadable or malformed.

    Attributes:
        path: The file, or `URDF text` for a robot given as text.
        reason: The fault; several faults follow one another on lines of their own.
        faults: All faults of the file that were found, each with its line if there is one.

    Examples:
        >>> from hplan.errors import RobotFileError
        >>> error = RobotFileError("arm.urdf", "no such file")
        >>> error.path.name, error.reason
        ('arm.urdf', 'no such file')
    """

    path: Path
    reason: str
    faults: tuple[str, ...]

    def __init__(self, path: Path | str, *faults: str) -> None:
        place = path if str(path) == "URDF text" else f"robot file {path}"
        reason = faults[0] if len(faults) == 1 else "\n  ".join([f"it has {len(faults)} faults:", *faults])
        super().__init__(f"{place}: {reason}", path=str(path), reason=reason)
        if len(faults) > 1:
            self.data["faults"] = list(faults)
        self.path, self.faults = Path(path), faults


class RobotFamilyError(InputError):
    """A valid URDF outside the family: optional yaw, then parallel revolute joints.

    Attributes:
        robot: Name of the robot.
        element: Name of the offending joint, link or frame.
        reason: The fault.

    Examples:
        >>> from hplan.errors import RobotFamilyError
        >>> error = RobotFamilyError("panda", "joint 3", "its axis is not parallel to the axis of joint 2")
        >>> error.robot, error.element
        ('panda', 'joint 3')
    """

    robot: str
    element: str
    reason: str

    def __init__(self, robot: str, element: str, reason: str) -> None:
        message = f"robot {robot!r} is not a planar arm on an optional yaw: {element}: {reason}"
        super().__init__(message, robot=robot, element=element, reason=reason)


class SceneError(InputError, ValueError):
    """A scene or scene file is invalid.

    It is also a `ValueError`, as pydantic's own validation errors are.

    Attributes:
        path: The file; None for a scene built in Python.
        where: Key path of the fault, for example `obstacles[0].radius`; None for the scene as a whole.
        line: 1-based line in the file; None if unknown.
        value: The invalid value; None if it is absent or a mapping.
        reason: The fault, and the expected value.

    Examples:
        >>> from hplan.errors import SceneError
        >>> from hplan.scene import Sphere
        >>> try:
        ...     Sphere(name="apple", center=(1.0, 0.0, 1.5), radius=-0.04)
        ... except SceneError as error:
        ...     print(error.where, error.value)
        radius -0.04
    """

    path: Path | None
    where: str | None
    line: int | None
    value: Any
    reason: str
    what: ClassVar[str] = "scene"

    def __init__(
        self,
        reason: str,
        *,
        path: Path | str | None = None,
        where: str | None = None,
        line: int | None = None,
        value: Any = None,
    ) -> None:
        place = self.what if path is None else f"{self.what} file {path}"
        place += "" if line is None else f", line {line}"
        place += f", {where}" if where else ""
        file, shown = None if path is None else str(path), None if value is None else repr(value)
        super().__init__(f"{place}: {reason}", path=file, where=where, line=line, value=shown, reason=reason)
        self.path = None if path is None else Path(path)
        self.value = value


class StudyError(SceneError):
    """A study or study file is invalid; attributes as in `SceneError`.

    Examples:
        >>> from hplan.errors import StudyError
        >>> StudyError("no arm is given", path="reach.yaml", where="arms", line=3).line
        3
    """

    what = "study"


class MovingObstacleError(InputError):
    """The scene moves, but the call requires a static scene.

    Attributes:
        obstacle: First obstacle with a track; None if only the base has one.

    Examples:
        >>> from hplan.errors import MovingObstacleError
        >>> MovingObstacleError("cart").obstacle
        'cart'
    """

    obstacle: str | None

    def __init__(self, obstacle: str | None, reason: str = "") -> None:
        what = "the base has a track" if obstacle is None else f"obstacle {obstacle!r} has a track"
        reason = (
            reason
            or "only scenes without moving bodies are supported; `scene.snapshot(time_s)` is the scene at one time"
        )
        super().__init__(f"{what}: {reason}", obstacle=obstacle)


class JointLimitError(InputError):
    """A configuration is outside the joint limits.

    Attributes:
        which: `start`, `goal` or, for example, `waypoint 3`.
        joint: Name of the joint.
        value: Its value [rad or m].
        lower: Its lower limit [rad or m].
        upper: Its upper limit [rad or m].

    Examples:
        >>> from hplan.errors import JointLimitError
        >>> error = JointLimitError("goal", "elbow", 2.8, -2.6, 2.6)
        >>> error.joint, error.value, error.upper
        ('elbow', 2.8, 2.6)
    """

    which: str
    joint: str

    def __init__(self, which: str, joint: str, value: float, lower: float, upper: float, unit: str = "rad") -> None:
        """Name the configuration, the joint, its value, its limits and their unit."""
        # Enough digits to show the difference.
        digits = next((d for d in (6, 9, 12) if f"{value:.{d}g}" not in (f"{lower:.{d}g}", f"{upper:.{d}g}")), 17)
        shown, low, high = (f"{number:.{digits}g}" for number in (value, lower, upper))
        message = f"{which}: joint {joint!r} is at {shown} {unit}, outside its limits [{low}, {high}] {unit}"
        facts = {f"value_{unit}": value, f"lower_{unit}": lower, f"upper_{unit}": upper}
        super().__init__(message, which=which, joint=joint, **facts)
        self.value, self.lower, self.upper = value, lower, upper


class StartStateError(InputError):
    """The start velocity or acceleration is infeasible: limit or locked joint.

    Attributes:
        joint: Name of the joint.
        quantity: `velocity` or `acceleration`.
        value: Value of the quantity, in the unit of the message.
        limit: Its limit, in the same unit.
        locked: True if the joint is locked.

    Examples:
        >>> from hplan.errors import StartStateError
        >>> error = StartStateError("elbow", "velocity", 3.0, 2.0, "rad/s")
        >>> error.quantity, error.value, error.limit
        ('velocity', 3.0, 2.0)
    """

    joint: str
    quantity: str

    def __init__(
        self, joint: str, quantity: str, value: float, limit: float, unit: str, *, locked: bool = False
    ) -> None:
        why = "it is locked" if locked else f"its limit is {limit:.6g} {unit}"
        message = f"start: joint {joint!r} has the {quantity} {value:.6g} {unit}; {why}"
        super().__init__(message, joint=joint, quantity=quantity, limit=limit, locked=locked)
        self.data["value"] = self.value = value


class NotOnMotionError(InputError):
    """The arm deviates from the running motion beyond the covered tracking error.

    Attributes:
        joint: Name of the joint.
        off_by: Deviation of the joint from the running motion [rad or m].
        covered: Tracking error that the certificate covers [rad or m].
        at_s: Time on the controller's clock [s].

    Examples:
        >>> from hplan.errors import NotOnMotionError
        >>> error = NotOnMotionError("elbow", 0.05, 0.01, 12.4)
        >>> error.joint, error.off_by, error.covered
        ('elbow', 0.05, 0.01)
    """

    joint: str
    off_by: float
    covered: float
    at_s: float

    def __init__(self, joint: str, off_by: float, covered: float, at_s: float, unit: str = "rad") -> None:
        message = (
            f"measured: joint {joint!r} is {off_by:.4g} {unit} from the running motion at {at_s:.10g} s "
            f"on the controller's clock; the certificate covers a tracking error of {covered:.4g} {unit}"
        )
        super().__init__(message, joint=joint, off_by=off_by, covered=covered, at_s=at_s)


class FrameError(InputError):
    """A camera frame cannot replace the previous one, or is too old.

    The scene keeps the obstacles of the last valid frame.

    Attributes:
        name: Name of the camera or obstacle that the frame updates.
        reason: The fault, and the expected value.

    Examples:
        >>> from hplan.errors import FrameError
        >>> error = FrameError("camera", "it is 0.9 s old; expected at most 0.2 s", age_s=0.9)
        >>> error.name, error.age_s
        ('camera', 0.9)
    """

    name: str
    reason: str

    def __init__(self, name: str, reason: str, **facts: Any) -> None:
        super().__init__(f"frame of {name!r}: {reason}", name=name, reason=reason, **facts)


class TiltedError(InputError):
    """A configuration does not hold the tool upright.

    Attributes:
        which: `start`, `goal` or, for example, `waypoint 3`.
        tilt_rad: Tilt of the tool, tracking error included [rad].
        max_tilt_rad: Maximum tilt of the scene [rad].

    Examples:
        >>> from hplan.errors import TiltedError
        >>> TiltedError("goal", 0.2, 0.1).tilt_rad
        0.2
    """

    which: str
    tilt_rad: float
    max_tilt_rad: float

    def __init__(self, which: str, tilt_rad: float, max_tilt_rad: float) -> None:
        tilt, most = math.degrees(tilt_rad), math.degrees(max_tilt_rad)
        super().__init__(
            f"{which} does not hold the tool upright: it tilts by {tilt:.4g} deg, and at most {most:.4g} deg is "
            "allowed (upright)",
            which=which,
            tilt_rad=tilt_rad,
            max_tilt_rad=max_tilt_rad,
        )


class ConfigurationInCollisionError(InputError):
    """Start or goal is in collision, or closer than the required clearance.

    Attributes:
        which: `start`, `goal` or, for example, `waypoint 3`.
        link: Name of the link.
        obstacle: Name of the obstacle, or of the other link.
        depth_m: Penetration depth in the obstacle grown by the clearance: the clearance minus the distance [m].
        clearance_m: Required clearance [m].

    Examples:
        >>> from hplan.errors import ConfigurationInCollisionError
        >>> error = ConfigurationInCollisionError("goal", "hand", "post 1", 0.012)
        >>> error.link, error.obstacle, error.depth_m
        ('hand', 'post 1', 0.012)
    """

    which: str
    link: str
    obstacle: str
    depth_m: float
    clearance_m: float

    def __init__(
        self,
        which: str,
        link: str,
        obstacle: str,
        depth_m: float,
        clearance_m: float = 0.0,
        *,
        mover: str = "",
        other: str = "",
    ) -> None:
        """Name configuration, link, obstacle, depth and required clearance [m].

        `mover` and `other` name the pair in the message; the defaults are `link` and the obstacle.
        """
        mover, other = mover or f"link {link!r}", other or f"obstacle {obstacle!r}"
        if depth_m >= clearance_m:
            depth = depth_m - clearance_m
            message = f"{which} is in collision: {mover} is {1e3 * depth:.3g} mm deep in {other}"
        else:
            message = (
                f"{which} is too close: {mover} is {1e3 * (clearance_m - depth_m):.3g} mm from "
                f"{other}, {1e3 * depth_m:.3g} mm less than the required {1e3 * clearance_m:.3g} mm"
            )
        super().__init__(message, which=which, link=link, obstacle=obstacle, depth_m=depth_m, clearance_m=clearance_m)


class OptionError(InputError):
    """An option or argument has an invalid value or type.

    Attributes:
        option: Name of the option.
        value: The value given.
        expected: The expected value, in words.

    Examples:
        >>> from hplan.errors import OptionError
        >>> print(OptionError("speed", 2.0, "a number between 0 and 1"))
        speed = 2.0: expected a number between 0 and 1
    """

    option: str
    value: Any
    expected: str

    def __init__(self, option: str, value: Any, expected: str) -> None:
        shown = repr(value)
        shown = shown if len(shown) <= 200 else f"{shown[:197]}..."
        super().__init__(f"{option} = {shown}: expected {expected}", option=option, value=shown, expected=expected)
        self.value = value


class OutputError(InputError):
    """A result cannot be written to its file.

    Attributes:
        path: The file.
        reason: The fault.

    Examples:
        >>> from hplan.errors import OutputError
        >>> OutputError("plan.csv", "it is a folder").reason
        'it is a folder'
    """

    path: Path
    reason: str

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(f"cannot write {path}: {reason}", path=str(path), reason=reason)
        self.path = Path(path)
