"""Errors of what is handed in: files, scenes, options, configurations; exit status 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

from hplan.errors.root import HplanError


class InputError(HplanError):
    """Something handed in cannot be used: a file, a value, an option."""

    exit_status = 2


class RobotFileError(InputError):
    """A robot file (URDF or limits YAML) is missing, unreadable or malformed."""

    path: Path
    reason: str

    def __init__(self, path: Path | str, reason: str) -> None:
        place = path if str(path) == "URDF text" else f"robot file {path}"
        super().__init__(f"{place}: {reason}", path=str(path), reason=reason)
        self.path = Path(path)


class RobotFamilyError(InputError):
    """A well-formed URDF that is not of the family: optional yaw, then parallel revolute joints.

    `element` names the joint, link or frame at fault.
    """

    robot: str
    element: str
    reason: str

    def __init__(self, robot: str, element: str, reason: str) -> None:
        message = f"robot {robot!r} is not a planar arm on an optional yaw: {element}: {reason}"
        super().__init__(message, robot=robot, element=element, reason=reason)


class SceneError(InputError, ValueError):
    """A scene, or a scene file, that does not say what it should.

    It is a `ValueError` too, as what pydantic raises of its own is.

    `where` is the key path (`obstacles[0].radius`), `line` its 1-based line in the file where that is known.
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
    """A study, or a study file, that does not say what it should; with the facts of a `SceneError`."""

    what = "study"


class MovingObstacleError(InputError):
    """Something in a scene moves, and what was asked for takes scenes that stand still.

    `obstacle` is the first obstacle that has a track; None where the base alone has one.
    """

    obstacle: str | None

    def __init__(self, obstacle: str | None, reason: str = "") -> None:
        what = "the base has a track" if obstacle is None else f"obstacle {obstacle!r} has a track"
        reason = reason or "this takes scenes in which nothing moves; `scene.at(time_s)` is one as it stands at a time"
        super().__init__(f"{what}: {reason}", obstacle=obstacle)


class JointLimitError(InputError):
    """A configuration outside the joint limits."""

    which: str
    joint: str

    def __init__(self, which: str, joint: str, value: float, lower: float, upper: float, unit: str = "rad") -> None:
        """Name the configuration (`start`, `goal`, `waypoint 3`), the joint, its value, its limits and their unit."""
        message = (
            f"{which}: joint {joint!r} is at {value:.6g} {unit}, outside its limits [{lower:.6g}, {upper:.6g}] {unit}"
        )
        facts = {f"value_{unit}": value, f"lower_{unit}": lower, f"upper_{unit}": upper}
        super().__init__(message, which=which, joint=joint, **facts)
        self.value, self.lower, self.upper = value, lower, upper


class StartStateError(InputError):
    """A start that moves as the arm cannot: beyond a joint's limit, or a joint that is locked."""

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
    """An arm that is not where the running motion has it, by more than the tracking error that is covered."""

    joint: str
    off_by: float
    covered: float
    at_s: float

    def __init__(self, joint: str, off_by: float, covered: float, at_s: float, unit: str = "rad") -> None:
        message = (
            f"measured: joint {joint!r} is {off_by:.4g} {unit} from where the running motion has it at {at_s:.10g} s "
            f"on the controller's clock; a tracking error of {covered:.4g} {unit} is covered"
        )
        super().__init__(message, joint=joint, off_by=off_by, covered=covered, at_s=at_s)


class ConfigurationInCollisionError(InputError):
    """Start or goal touches an obstacle or the arm itself, or comes closer than the clearance to keep."""

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
        """Name the configuration, link, obstacle, by how much too deep it is and the clearance to keep [m].

        `mover` and `other` name the two in the message; without them they are `link` and the obstacle.
        """
        mover, other = mover or f"link {link!r}", other or f"obstacle {obstacle!r}"
        if depth_m >= clearance_m:
            depth = depth_m - clearance_m
            message = f"{which} is in collision: {mover} is {1e3 * depth:.3g} mm deep in {other}"
        else:
            message = (
                f"{which} is too close: {mover} is {1e3 * (clearance_m - depth_m):.3g} mm from "
                f"{other}, {1e3 * depth_m:.3g} mm less than the {1e3 * clearance_m:.3g} mm to keep"
            )
        super().__init__(message, which=which, link=link, obstacle=obstacle, depth_m=depth_m, clearance_m=clearance_m)


class OptionError(InputError):
    """An option or argument outside its range."""

    option: str
    value: Any
    expected: str

    def __init__(self, option: str, value: Any, expected: str) -> None:
        shown = repr(value)
        shown = shown if len(shown) <= 200 else f"{shown[:197]}..."
        super().__init__(f"{option} = {shown}: expected {expected}", option=option, value=shown, expected=expected)
        self.value = value


class OutputError(InputError):
    """A result cannot be written where it was asked for."""

    path: Path
    reason: str

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(f"cannot write {path}: {reason}", path=str(path), reason=reason)
        self.path = Path(path)
