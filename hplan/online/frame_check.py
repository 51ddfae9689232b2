"""Clouds replaced frame by frame, with checks of each frame.

Frames are accepted on arrival, and their age is checked for plans.

A refused frame changes nothing: the obstacles of the last good frame stay in the scene.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from hplan.base.arguments import list_of, text
from hplan.errors import FrameError, InputError, OptionError
from hplan.online.frame_kernels import FAR_M
from hplan.scene.model import Scene
from hplan.scene.obstacles import PointCloud, Solid

if TYPE_CHECKING:
    from hplan.online.frame import CloudOptions, FrameReport


def check_cloud_name(scene: Scene, name: str) -> None:
    """Refuse a cloud name that an obstacle or fruit already has.

    Raises:
        InputError: An obstacle that is not a cloud, or a fruit, has that name.
        OptionError: `name` is not a name.
    """
    text("name", name, "the name of the cloud")
    taken = [item for item in (*scene.obstacles, *scene.fruits) if item.name == name]
    if taken and not isinstance(taken[0], PointCloud):
        what = type(taken[0]).__name__.lower()
        raise InputError(f"{name!r} is a {what}; a cloud must have its own name", name=name)


def solids_named(scene: Scene, names: Sequence[str], cloud: str, time_s: float | None) -> tuple[Solid, ...]:
    """Solids of named fruits and obstacles in the base frame.

    Moving ones are placed at `time_s`.

    Args:
        cloud: Name of the cloud itself, which must not be among `names`.
        time_s: Time on the clock of the scene's tracks [s]; None if the named items are static.

    Raises:
        InputError: A name is unknown, or it is the cloud's name.
        OptionError: A value of `names` is not a name; or a named item moves and `time_s` is missing.
    """
    wanted = list_of("ignore", names, str, "names of fruits and obstacles")
    if not wanted:
        return ()
    known = {item.name for item in (*scene.obstacles, *scene.fruits)}
    for name in wanted:
        if name == cloud:
            raise InputError(f"ignore: {name!r} is the cloud itself", name=name)
        if name not in known:
            raise InputError(f"ignore: there is no fruit or obstacle {name!r}", name=name)
    named = scene.copy_unchecked(
        {key: tuple(item for item in getattr(scene, key) if item.name in wanted) for key in ("obstacles", "fruits")}
    )
    if named.moves:
        if time_s is None:
            expected = "the time of the frame on the clock of the scene's tracks: a body to ignore moves"
            raise OptionError("time_s", None, expected)
        named = named.snapshot(time_s)
    return named.listed_solids


def with_cloud(scene: Scene, name: str, cloud: PointCloud | None) -> Scene:
    """Return the scene with a cloud replaced or added; None removes it."""
    obstacles = list(scene.obstacles)
    place = next((number for number, obstacle in enumerate(obstacles) if obstacle.name == name), len(obstacles))
    obstacles[place : place + 1] = [] if cloud is None else [cloud]
    # Name and obstacle are checked: no need to check the scene again.
    return scene.copy_unchecked({"obstacles": tuple(obstacles)})


#: Decay of the reference share of returns per frame: slow enough that a fading camera is noticed.
_FADING: Final = 0.98


@dataclass(frozen=True)
class AcceptedFrame:
    """The last frame that was accepted for a cloud.

    Attributes:
        time_s: Time stamp on the controller's clock; None if the caller stated none [s].
        received_s: Time of the call on the monotonic clock of this machine [s].
        return_share: Reference share of rows with a return for the next frame.
        max_age_s: Age limit for plans that rely on the frame; None for no limit [s].
    """

    time_s: float | None
    received_s: float
    return_share: float
    max_age_s: float | None

    def age_s(self, now: float | None) -> float:
        """Age on the controller's clock [s].

        Since the call if one of the times is unknown.
        """
        return time.monotonic() - self.received_s if now is None or self.time_s is None else now - self.time_s

    def age_fault(self, name: str, now: float | None) -> FrameError | None:
        """The error for a frame too old or too new, if any.

        None means that plans may rely on the frame. A stamp may be as far in the future as `max_age_s`.
        """
        age_s = self.age_s(now)
        if self.max_age_s is None or abs(age_s) <= self.max_age_s:
            return None
        reason = f"it is {age_s:.4g} s old; the maximum age is {self.max_age_s:.4g} s (`max_age_s`)"
        if age_s < 0.0:
            reason = f"its stamp {self.time_s:.10g} s is {-age_s:.4g} s in the future; expected the controller's clock"
        return FrameError(name, f"{reason}: give a new frame", age_s=age_s, max_age_s=self.max_age_s)


def check_order(name: str, time_s: float | None, before: AcceptedFrame | None) -> None:
    """Refuse a frame older than the last accepted one of its cloud.

    Raises:
        FrameError: The frame is older, or only one of both frames has a time stamp.
    """
    if before is None:
        return
    if (time_s is None) != (before.time_s is None):
        given, other = ("no", "one") if time_s is None else ("a", "none")
        raise FrameError(
            name,
            f"it has {given} time stamp and the frame before has {other}; expected `time_s` with every frame or never",
        )
    if time_s is not None and before.time_s is not None and time_s < before.time_s:
        raise FrameError(
            name,
            f"its stamp {time_s:.10g} s is before the stamp of the last frame, {before.time_s:.10g} s; if the clock "
            f"was set back, remove({name!r}) first",
            time_s=time_s,
            last_time_s=before.time_s,
        )


def check_content(
    name: str, report: FrameReport, options: CloudOptions, time_s: float | None, before: AcceptedFrame | None
) -> AcceptedFrame:
    """Refuse a frame from a failing camera, or one without obstacles.

    Wrong units and wrong poses are detected too.

    Args:
        name: Name of the cloud.
        report: The counts of the frame.
        options: Which losses are acceptable.
        time_s: Time stamp of the frame; None if it has none [s].
        before: The last frame that was accepted; None for the first.

    Returns:
        The accepted frame, for the checks of the next one.

    Raises:
        FrameError: Most returns are farther than a depth camera can see; too few rows have a return; or no obstacle is
            left, no ignored point was seen, and `allow_empty` is not set.
    """
    counts = {
        "given": report.given,
        "not_finite": report.not_finite,
        "no_return": report.no_return,
        "out_of_reach": report.out_of_reach,
        "of_arm": report.of_arm,
        "isolated": report.isolated,
    }
    returns = report.given - report.not_finite - report.no_return
    share = returns / max(report.given, 1)
    reference = 0.0 if before is None else before.return_share
    reason = ""
    if 2 * report.far > returns:
        reason = (
            f"{report.far} of {returns} returns are more than {FAR_M:g} m from the camera: expected metres; points in "
            "millimetres must be divided by 1000"
        )
    elif share < (1.0 - options.max_lost) * reference:
        reason = (
            f"{100.0 * share:.3g} % of {report.given} rows have a return, in earlier frames {100.0 * reference:.3g} %: "
            f"the camera may be failing; `max_lost` = {options.max_lost:g} is the maximum loss"
        )
    elif not (report.kept or report.ignored or options.allow_empty):
        listed = ", ".join(f"{count} {key.replace('_', ' ')}" for key, count in counts.items())
        reason = (
            f"it leaves no obstacle ({listed}): check the unit (m), `pose` and `joints`. "
            f"`CloudOptions(allow_empty=True)` accepts a camera that sees nothing within reach; remove({name!r}) "
            "removes the cloud"
        )
    if reason:
        raise FrameError(name, f"{reason}. The obstacles of the last good frame stay in the scene", **counts)
    return AcceptedFrame(time_s, time.monotonic(), max(share, _FADING * reference), options.max_age_s)
