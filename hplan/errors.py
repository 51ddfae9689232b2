"""Every error that hplan raises on purpose, under one root.

An error carries its facts as attributes, so that a program can act on *which joint*, *which obstacle*, *how deep*
without reading the sentence; `data` gathers them for the report. Each is stored once, by the root; a class annotates
its own, and sets only those that JSON knows under another name or as another type. `exit_status` is what the command
line returns for it.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar


class HplanError(Exception):
    """Root of all hplan errors.

    Errors can be pickled and copied, whatever their constructor takes: they are restored from what they hold, notes
    included. As for Python's own, traceback and cause stay behind; what cannot be pickled becomes its text.

    Attributes:
        data: The facts of the error, ready for JSON.
        exit_status: Exit status of the command line for this error.
    """

    exit_status: ClassVar[int] = 1

    def __init__(self, message: str, **data: Any) -> None:
        """Store the sentence and its facts, each as an attribute too."""
        super().__init__(message)
        vars(self).update(data)
        self.message = message
        self.data: dict[str, Any] = data

    @property
    def kind(self) -> str:
        """Name of the error, as the report gives it."""
        return type(self).__name__

    def as_dict(self) -> dict[str, Any]:
        """The error as the report's `error` object: `kind`, `message` and the facts."""
        return {"kind": self.kind, "message": self.message, **self.data}

    def add(self, sentence: str, **data: Any) -> None:
        """Add a sentence and its facts."""
        self.message = f"{self.message}; {sentence}"
        self.args = (self.message, *self.args[1:])
        self.data |= data

    def __reduce__(self) -> tuple[Any, ...]:
        """Restore without the constructor, whose arguments are not kept."""
        state = {name: value if _can_be_pickled(value) else repr(value) for name, value in vars(self).items()}
        return _without_constructor, (type(self), self.args), state


def _without_constructor(kind: type[HplanError], arguments: tuple[Any, ...]) -> HplanError:
    """An error with its `args` and nothing else."""
    return kind.__new__(kind, *arguments)


def _can_be_pickled(value: object) -> bool:
    try:
        pickle.dumps(value)
    except Exception:  # whatever a foreign class raises
        return False
    return True


class InputError(HplanError):
    """Something handed in cannot be used: a file, a value, an option."""

    exit_status = 2


class RobotFileError(InputError):
    """A robot file (URDF or limits YAML) is missing, unreadable or malformed."""

    path: Path
    reason: str

    def __init__(self, path: Path | str, reason: str) -> None:
        """Name the file and what is wrong with it."""
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
        """Name the robot, the element of it and what the family asks for."""
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

    def __init__(
        self,
        reason: str,
        *,
        path: Path | str | None = None,
        where: str | None = None,
        line: int | None = None,
        value: Any = None,
    ) -> None:
        """Name the file, the key, its line and the value."""
        place = "scene" if path is None else f"scene file {path}"
        place += "" if line is None else f", line {line}"
        place += f", {where}" if where else ""
        file, shown = None if path is None else str(path), None if value is None else repr(value)
        super().__init__(f"{place}: {reason}", path=file, where=where, line=line, value=shown, reason=reason)
        self.path = None if path is None else Path(path)
        self.value = value


class MovingObstacleError(InputError):
    """Something in a scene moves, and what was asked for takes scenes that stand still.

    `obstacle` is the first obstacle that has a track; None where the base alone has one.
    """

    obstacle: str | None

    def __init__(self, obstacle: str | None, reason: str = "") -> None:
        """Name the obstacle, and say why it must not move."""
        what = "the base has a track" if obstacle is None else f"obstacle {obstacle!r} has a track"
        reason = reason or "this takes scenes in which nothing moves; `scene.at(time_s)` is one as it stands at a time"
        super().__init__(f"{what}: {reason}", obstacle=obstacle)


class JointLimitError(InputError):
    """A configuration outside the joint limits."""

    which: str
    joint: str

    def __init__(self, which: str, joint: str, value: float, lower: float, upper: float) -> None:
        """Name the configuration (`start`, `goal`, `waypoint 3`), the joint, its value and its limits [rad]."""
        message = f"{which}: joint {joint!r} is at {value:.6g} rad, outside its limits [{lower:.6g}, {upper:.6g}] rad"
        super().__init__(message, which=which, joint=joint, value_rad=value, lower_rad=lower, upper_rad=upper)
        self.value, self.lower, self.upper = value, lower, upper


class StartStateError(InputError):
    """A start that moves as the arm cannot: beyond a joint's limit, or a joint that is locked."""

    joint: str
    quantity: str

    def __init__(self, joint: str, quantity: str, value: float, limit: float, *, locked: bool = False) -> None:
        """Name the joint, the quantity (`velocity` in rad/s, `acceleration` in rad/s^2), its value and its limit."""
        unit = {"velocity": "rad/s", "acceleration": "rad/s^2"}[quantity]
        why = "it is locked" if locked else f"its limit is {limit:.6g} {unit}"
        message = f"start: joint {joint!r} has the {quantity} {value:.6g} {unit}; {why}"
        super().__init__(message, joint=joint, quantity=quantity, limit=limit, locked=locked)
        self.data["value"] = self.value = value


class ConfigurationInCollisionError(InputError):
    """Start or goal touches an obstacle or the arm itself, or comes closer than the clearance to keep."""

    which: str
    link: str
    obstacle: str
    depth_m: float
    clearance_m: float

    def __init__(
        self, which: str, link: str, obstacle: str, depth_m: float, clearance_m: float = 0.0, *, other: str = ""
    ) -> None:
        """Name the configuration, link, obstacle, by how much too deep it is and the clearance to keep [m].

        `other` is the obstacle in words where it is none but a part of the arm.
        """
        other = other or f"obstacle {obstacle!r}"
        if depth_m >= clearance_m:
            depth = depth_m - clearance_m
            message = f"{which} is in collision: link {link!r} is {1e3 * depth:.3g} mm deep in {other}"
        else:
            message = (
                f"{which} is too close: link {link!r} is {1e3 * (clearance_m - depth_m):.3g} mm from "
                f"{other}, {1e3 * depth_m:.3g} mm less than the {1e3 * clearance_m:.3g} mm to keep"
            )
        super().__init__(message, which=which, link=link, obstacle=obstacle, depth_m=depth_m, clearance_m=clearance_m)


class OptionError(InputError):
    """An option or argument outside its range."""

    option: str
    value: Any
    expected: str

    def __init__(self, option: str, value: Any, expected: str) -> None:
        """Name the option, the value given and what would be right."""
        shown = repr(value)
        shown = shown if len(shown) <= 200 else f"{shown[:197]}..."
        super().__init__(f"{option} = {shown}: expected {expected}", option=option, value=shown, expected=expected)
        self.value = value


class OutputError(InputError):
    """A result cannot be written where it was asked for."""

    path: Path
    reason: str

    def __init__(self, path: Path | str, reason: str) -> None:
        """Name the path and the system's reason."""
        super().__init__(f"cannot write {path}: {reason}", path=str(path), reason=reason)
        self.path = Path(path)


class NoPathError(HplanError):
    """No path exists on the grid, as flooding all that the start reaches shows; or none at all: a joint is blocked.

    `blockers` lists what bounds the reached region, largest part first, each a mapping with `obstacle`, `link`, `cells`
    and `slices_deg` (first and last value at which it blocks, of the last planned joint or of the one that is blocked).
    `goals` is for how many goals, all that there were, it was shown; the other facts are of the first of them.
    `open_ended` is set where the region ends at the edge of the yaws that were looked at, so that a wider range might
    open it.
    """

    exit_status = 3
    open_ended = False
    reached_cells: int
    goals: int

    def __init__(
        self, message: str, *, reached_cells: int, blockers: Sequence[Mapping[str, Any]] = (), goals: int = 1
    ) -> None:
        """Store how many cells the start reaches, what bounds them, and for how many goals it was shown."""
        listed = [dict(blocker) for blocker in blockers]
        super().__init__(message, reached_cells=reached_cells, blockers=listed, goals=goals)
        self.blockers = tuple(dict(blocker) for blocker in blockers)


class UnreachableError(HplanError):
    """No configuration puts the tool at a position.

    `reason` is `too_far` or `too_near` (`excess_m`), `joint_limit` (`joint`, `limit_deg`, `excess_deg`, and so all
    of `passed`: limits that would have to be passed, by the least sum), `approach` (`approach_deg` asked for,
    `reachable_deg` intervals), `locked` (`locked_joints`, `beside_m`), `off_plane` (`beside_m`), or `not_found`
    (`joints` that were only tried at some values).
    """

    exit_status = 3
    reason: str

    def __init__(self, position_m: Sequence[float], reason: str, detail: str, **data: Any) -> None:
        """Name the position, the reason in a word and in a sentence, and its facts."""
        place = ", ".join(f"{value:.6g}" for value in position_m)
        message = f"the tool cannot reach ({place}) m: {detail}"
        super().__init__(message, position_m=list(position_m), reason=reason, **data)
        self.position_m = tuple(position_m)


class ApproachError(HplanError):
    """No straight approach as long as asked for.

    `reason` is `joint_limit` (`joint`), `elbow` (it would come too near to straight or folded), or `joints` (fewer
    than three that may move).
    """

    exit_status = 3
    standoff_m: float
    reason: str
    largest_standoff_m: float
    joint: str | None

    def __init__(
        self, standoff_m: float, reason: str, detail: str, *, largest_standoff_m: float, joint: str | None = None
    ) -> None:
        """Name the stand-off asked for, the reason in a word and in a sentence, and the largest one possible [m]."""
        super().__init__(
            f"no straight approach from {standoff_m:.6g} m: {detail}",
            standoff_m=standoff_m,
            reason=reason,
            largest_standoff_m=largest_standoff_m,
            joint=joint,
        )


class BlockedError(HplanError):
    """A fruit or a point that the arm could reach if nothing were in the way.

    `obstacles` lists what is, most often first, each a mapping with `obstacle`, `link` and the number of
    `configurations`, of those at evenly spaced approach angles. `refined` more were tried at angles in between, where
    these come nearest to being clear; the best of all has the clearance `best_clearance_m` beyond the one to keep, and
    `needed_clearance_m` would be needed.
    """

    exit_status = 3
    what: str
    refined: int
    best_clearance_m: float | None
    needed_clearance_m: float

    def __init__(
        self,
        what: str,
        tried: int,
        obstacles: Sequence[Mapping[str, Any]],
        *,
        refined: int = 0,
        best_clearance_m: float | None = None,
        needed_clearance_m: float = 0.0,
    ) -> None:
        """Name what cannot be reached, how many configurations were tried, what is in their way and by how much."""
        names = ", ".join(f"{o['obstacle']!r} ({o['link']}: {o['configurations']})" for o in obstacles[:3])
        more = f", and so do {refined} at finer approach angles" if refined else ""
        if best_clearance_m is not None and best_clearance_m > 0.0:
            more += (
                f"; spare clearance {1e3 * best_clearance_m:.3g} mm at the best of them, too little to be shown clear: "
                f"{1e3 * needed_clearance_m:.3g} mm are needed"
            )
        super().__init__(
            f"{what} is blocked: all {tried} configurations that reach it collide, with {names}{more}",
            what=what,
            tried=tried,
            obstacles=[dict(o) for o in obstacles],
            refined=refined,
            best_clearance_m=best_clearance_m,
            needed_clearance_m=needed_clearance_m,
        )
        self.obstacles = tuple(dict(o) for o in obstacles)


class TourError(HplanError):
    """None of the fruits of a tour can be picked; `reasons` has for each its name and the error that says why."""

    exit_status = 3

    def __init__(self, reasons: Sequence[tuple[str, HplanError]]) -> None:
        """Name the fruits and why each cannot be picked."""
        first = "".join(f"; {name!r}: {error.message}" for name, error in reasons[:3])
        super().__init__(
            f"none of {len(reasons)} fruits can be picked{first}{'; ...' if len(reasons) > 3 else ''}",
            unreached=[{"fruit": name, "error": error.as_dict()} for name, error in reasons],
        )
        self.reasons = tuple(reasons)


class TimingError(HplanError):
    """A path that cannot be timed under the limits; `joint` is the one at fault where it is known."""

    exit_status = 4
    joint: str | None
    cause: str | None

    def __init__(self, message: str, *, joint: str | None = None, cause: str | None = None) -> None:
        """Name the joint and the cause."""
        super().__init__(message, joint=joint, cause=cause)


class CertificationError(HplanError):
    """A motion whose safety could not be proved; `data` says where and by how much."""

    exit_status = 5


class PathInContactError(HplanError):
    """A path of straight motions that touches something, or comes closer than the clearance to keep, by its own shape.

    Of the first place along it: either `waypoint` or `segment` is its number, counted from 1, the other None (segment k
    leads from waypoint k to the next); `fraction` is how far along the segment it is. Depth and clearance to keep are
    those of `ConfigurationInCollisionError`. `places` lists all that were found, each a mapping with these facts.
    """

    exit_status = 5
    waypoint: int | None
    segment: int | None
    fraction: float
    link: str
    obstacle: str
    depth_m: float
    clearance_m: float

    def __init__(self, message: str, places: Sequence[Mapping[str, Any]]) -> None:
        """Store the sentence and the places, the first along the path first."""
        listed = [dict(place) for place in places]
        super().__init__(message, **listed[0], places=listed)
        self.places = tuple(dict(place) for place in listed)


class UnavoidableContactError(HplanError):
    """A start in motion that was not left without contact, neither by a stop nor by a motion on.

    `reasons` says what is in the way of the best stop, `stop` is that stop: the trajectory by which the arm comes to
    rest with the most clearance, not certified.
    """

    exit_status = 5
    reasons: list[str]
    tried: int
    clearance_m: float | None
    stop: Any

    def __init__(self, reasons: Sequence[str], tried: int, clearance_m: float | None, stop: Any) -> None:
        """Say what is in the way of the best of so many stops, and how near it comes [m]."""
        super().__init__(
            f"the start's state of motion cannot be left without contact, as far as {tried} stops show; of the best: "
            f"{'; '.join(reasons)}",
            reasons=list(reasons),
            tried=tried,
            clearance_m=clearance_m,
        )
        self.stop = stop


class RunningMotionBlockedError(HplanError):
    """A running motion is no longer clear before a new one could take over, or cannot be left without contact.

    `stop` is the certified stop on the path of the running motion, a trajectory from now on; None where there is none.
    """

    exit_status = 5
    reasons: list[str]
    stop: Any
    certificate: Any

    def __init__(self, reasons: Sequence[str], stop: Any, certificate: Any) -> None:
        """Say what is in the way, and how the arm can stop."""
        how = "no stop on its path is certified" if stop is None else "it can stop on its path"
        super().__init__(f"the running motion cannot be taken over: {'; '.join(reasons)}; {how}", reasons=list(reasons))
        self.data["can_stop"] = stop is not None
        self.stop, self.certificate = stop, certificate


class BoundError(HplanError):
    """A motion is shorter than a duration that was shown to be too short: one of the two is wrong."""

    duration_s: float
    joint: str
    exit_status = 5


class NotFoundError(HplanError):
    """No motion was found within the memory and effort given, and none was shown not to exist.

    `tried` says what was looked at, sentence by sentence.
    """

    exit_status = 6

    tried: list[str]

    def __init__(self, tried: Sequence[str], **data: Any) -> None:
        """Say what was tried."""
        message = f"no motion was found, and it was not shown that there is none; tried: {'; '.join(tried)}"
        super().__init__(message, tried=list(tried), **data)


class ObstacleInTimeError(NotFoundError):
    """No motion was found past something that moves: `obstacle` is in the way, at `at_s`, of the best that was found.

    Both are None where the base alone moves and nothing was found to be timed.
    """

    obstacle: str | None
    at_s: float | None

    def __init__(self, obstacle: str | None, at_s: float | None, tried: Sequence[str]) -> None:
        """Name the obstacle and the time, and say what was tried."""
        super().__init__(tried, obstacle=obstacle, at_s=at_s)
        if obstacle is not None and at_s is not None:
            self.add(f"obstacle {obstacle!r} is in the way at {at_s:.4g} s")


class NotInTimeError(NotFoundError):
    """No motion was certified before the deadline; `tried` says what was looked at, and for how long."""

    deadline_s: float
    elapsed_s: float

    def __init__(self, deadline_s: float, elapsed_s: float, tried: Sequence[str]) -> None:
        """Say what was tried within the time."""
        listed = "; ".join(tried) or "nothing, as time was up at once"
        message = f"no motion was found in time: {1e3 * deadline_s:.6g} ms are over; tried: {listed}"
        HplanError.__init__(self, message, tried=list(tried), deadline_s=deadline_s, elapsed_s=elapsed_s)


class PlanCancelledError(HplanError):
    """Whoever asked for a plan does not want it any more, `elapsed_s` after it was begun."""

    exit_status = 6
    elapsed_s: float

    def __init__(self, elapsed_s: float) -> None:
        """Say after which time."""
        super().__init__(f"the plan was cancelled after {1e3 * elapsed_s:.3g} ms", elapsed_s=elapsed_s)
