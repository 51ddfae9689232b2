"""Errors about a path or motion: timing (exit status 4), certification (5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hplan.errors.root import HplanError


class TimingError(HplanError):
    """The path cannot be timed under the limits.

    Attributes:
        joint: The joint that violates its limit; None if unknown.
        cause: Key word of the reason; None if unknown.

    Examples:
        >>> from hplan.errors import TimingError
        >>> error = TimingError("gravity exceeds the torque limit", joint="shoulder")
        >>> error.joint, error.exit_status
        ('shoulder', 4)
    """

    exit_status = 4
    joint: str | None
    cause: str | None

    def __init__(self, message: str, *, joint: str | None = None, cause: str | None = None) -> None:
        super().__init__(message, joint=joint, cause=cause)


class CertificationError(HplanError):
    """The safety of a motion is not proved.

    `data` holds the place and the missing clearance.

    Examples:
        >>> from hplan.errors import CertificationError
        >>> CertificationError("the motion is not certified", link="hand").data
        {'link': 'hand'}
    """

    exit_status = 5


class PathInContactError(HplanError):
    """A path of straight joint-space segments is in collision or too close.

    No timing can mend that. The attributes describe the first place along the path, at a waypoint or on a segment.

    Attributes:
        waypoint: Number of the waypoint, counted from 1; None if the place is on a segment.
        segment: Number of the segment, counted from 1; segment k leads from waypoint k to k + 1. None at a waypoint.
        fraction: Position along the segment, 0 to 1.
        link: Name of the link.
        obstacle: Name of the obstacle.
        depth_m: Penetration depth, as in `ConfigurationInCollisionError` [m].
        clearance_m: Required clearance [m].
        places: All places found, each a mapping with these facts.

    Examples:
        >>> from hplan.errors import PathInContactError
        >>> place = {"waypoint": None, "segment": 2, "fraction": 0.4, "link": "hand", "obstacle": "post 1"}
        >>> place |= {"depth_m": 0.01, "clearance_m": 0.0}
        >>> error = PathInContactError("segment 2 is in collision", [place])
        >>> error.segment, error.obstacle, len(error.places)
        (2, 'post 1', 1)
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
        listed = [dict(place) for place in places]
        super().__init__(message, **listed[0], places=listed)
        self.places = tuple(dict(place) for place in listed)


class UnavoidableContactError(HplanError):
    """No collision-free stop or continuation was found from a start in motion.

    Attributes:
        reasons: Obstructions of the best stop, one sentence each.
        tried: Number of stops tried.
        clearance_m: Clearance of the best stop [m]; None if unknown.
        stop: The stop with the maximum clearance, a trajectory; it is not certified.

    Examples:
        >>> from hplan.errors import UnavoidableContactError
        >>> error = UnavoidableContactError(["'hand' touches 'post 1'"], 12, -0.01, stop=None)
        >>> error.tried, error.clearance_m
        (12, -0.01)
    """

    exit_status = 5
    reasons: list[str]
    tried: int
    clearance_m: float | None
    stop: Any

    def __init__(self, reasons: Sequence[str], tried: int, clearance_m: float | None, stop: Any) -> None:
        super().__init__(
            f"no collision-free motion was found from the start in motion ({tried} stops tried); the best stop: "
            f"{'; '.join(reasons)}",
            reasons=list(reasons),
            tried=tried,
            clearance_m=clearance_m,
        )
        self.stop = stop


class RunningMotionBlockedError(HplanError):
    """The running motion is blocked before a new motion can replace it.

    Attributes:
        reasons: Obstructions, one sentence each.
        stop: The certified stop on the path of the running motion, a trajectory from now on; None if no stop is
            certified.
        certificate: Certificate of the stop; None without a stop.
        begins_s: Time of the first sample of the stop on the controller's clock [s].

    Examples:
        >>> from hplan.errors import RunningMotionBlockedError
        >>> error = RunningMotionBlockedError(["'hand' touches 'post 1'"], stop=None, certificate=None)
        >>> error.data["can_stop"]
        False
    """

    exit_status = 5
    reasons: list[str]
    stop: Any
    certificate: Any
    begins_s: float

    def __init__(self, reasons: Sequence[str], stop: Any, certificate: Any, begins_s: float = 0.0) -> None:
        how = "no stop on its path is certified" if stop is None else "the arm can stop on its path"
        super().__init__(f"the running motion cannot be taken over: {'; '.join(reasons)}; {how}", reasons=list(reasons))
        self.data["can_stop"] = stop is not None
        self.stop, self.certificate, self.begins_s = stop, certificate, begins_s


class BoundError(HplanError):
    """A duration is below a proved lower bound; one is wrong.

    Attributes:
        duration_s: Duration of the motion [s].
        joint: Joint whose lower bound is violated.

    Examples:
        >>> from hplan.errors import BoundError
        >>> error = BoundError("0.9 s is below the lower bound", duration_s=0.9, joint="shoulder")
        >>> error.duration_s, error.exit_status
        (0.9, 5)
    """

    duration_s: float
    joint: str
    exit_status = 5
