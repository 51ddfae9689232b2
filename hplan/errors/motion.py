"""Errors of a path or motion that is there: it cannot be timed (exit status 4), or is not certified (5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hplan.errors.root import HplanError


class TimingError(HplanError):
    """A path that cannot be timed under the limits; `joint` is the one at fault where it is known."""

    exit_status = 4
    joint: str | None
    cause: str | None

    def __init__(self, message: str, *, joint: str | None = None, cause: str | None = None) -> None:
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

    `stop` is the certified stop on the path of the running motion, a trajectory from now on, whose first row is at
    `begins_s` on the controller's clock [s]; None where there is none.
    """

    exit_status = 5
    reasons: list[str]
    stop: Any
    certificate: Any
    begins_s: float

    def __init__(self, reasons: Sequence[str], stop: Any, certificate: Any, begins_s: float = 0.0) -> None:
        how = "no stop on its path is certified" if stop is None else "it can stop on its path"
        super().__init__(f"the running motion cannot be taken over: {'; '.join(reasons)}; {how}", reasons=list(reasons))
        self.data["can_stop"] = stop is not None
        self.stop, self.certificate, self.begins_s = stop, certificate, begins_s


class BoundError(HplanError):
    """A motion is shorter than a duration that was shown to be too short: one of the two is wrong."""

    duration_s: float
    joint: str
    exit_status = 5
