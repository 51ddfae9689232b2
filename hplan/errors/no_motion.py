"""Errors if no motion exists (exit status 3) or was found (6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hplan.errors.root import HplanError


class NoPathError(HplanError):
    """No path exists: proved by a grid flood fill, or joint blocked.

    Attributes:
        reached_cells: Number of grid cells connected to the start.
        blockers: Boundary of that region, largest share first, each a mapping with `obstacle`, `link`, `cells` and
            `slices_deg` (first and last blocked value of the last planned joint or of the blocked joint).
        goals: Number of goals; the proof covers all of them, and the other attributes describe the first one.
        open_ended: True if the region ends at the edge of the searched yaw range, so that a wider range might open it.

    Examples:
        >>> from hplan.errors import NoPathError
        >>> blocker = {"obstacle": "post 1", "link": "hand", "cells": 40, "slices_deg": [10.0, 35.0]}
        >>> error = NoPathError("no path exists", reached_cells=1200, blockers=[blocker])
        >>> error.blockers[0]["obstacle"], error.exit_status
        ('post 1', 3)
    """

    exit_status = 3
    open_ended = False
    reached_cells: int
    goals: int

    def __init__(
        self, message: str, *, reached_cells: int, blockers: Sequence[Mapping[str, Any]] = (), goals: int = 1
    ) -> None:
        """Store the number of cells, the boundary and the number of goals."""
        listed = [dict(blocker) for blocker in blockers]
        super().__init__(message, reached_cells=reached_cells, blockers=listed, goals=goals)
        self.blockers = tuple(dict(blocker) for blocker in blockers)


class UnreachableError(HplanError):
    """No configuration puts the tool at the position.

    Attributes:
        position_m: The position [m].
        reason: Key word. `too_far` and `too_near` come with `excess_m`; `joint_limit` with `joint`, `limit_deg`,
            `excess_deg` and `passed`, the limits exceeded by the configuration with the minimum sum of excesses;
            `approach` with `approach_deg` (required) and the intervals `reachable_deg`; `locked` with `locked_joints`,
            and the distance `beside_m` from the arm plane [m]; `off_plane` with `beside_m`; `not_found` with `joints`
            that were sampled at some values only.

    Examples:
        >>> from hplan.errors import UnreachableError
        >>> error = UnreachableError((3.0, 0.0, 1.0), "too_far", "the arm is too short", excess_m=0.8)
        >>> error.reason, error.excess_m, error.position_m
        ('too_far', 0.8, (3.0, 0.0, 1.0))
    """

    exit_status = 3
    reason: str

    def __init__(self, position_m: Sequence[float], reason: str, detail: str, **data: Any) -> None:
        place = ", ".join(f"{value:.6g}" for value in position_m)
        message = f"the tool cannot reach ({place}) m: {detail}"
        super().__init__(message, position_m=list(position_m), reason=reason, **data)
        self.position_m = tuple(position_m)


class ApproachError(HplanError):
    """No straight approach of the required length.

    Attributes:
        standoff_m: Required length [m].
        largest_standoff_m: Maximum length found [m].
        reason: `joint_limit` (see `joint`), `elbow` (too close to straight or folded), `joints` (fewer than three free
            joints) or `line` (the tool cannot retract that far).
        joint: The joint at its limit; None for the other reasons.

    Examples:
        >>> from hplan.errors import ApproachError
        >>> error = ApproachError(0.2, "elbow", "the elbow straightens", largest_standoff_m=0.12)
        >>> error.reason, error.largest_standoff_m
        ('elbow', 0.12)
    """

    exit_status = 3
    standoff_m: float
    reason: str
    largest_standoff_m: float
    joint: str | None

    def __init__(
        self, standoff_m: float, reason: str, detail: str, *, largest_standoff_m: float, joint: str | None = None
    ) -> None:
        super().__init__(
            f"no straight approach from {standoff_m:.6g} m: {detail}",
            standoff_m=standoff_m,
            reason=reason,
            largest_standoff_m=largest_standoff_m,
            joint=joint,
        )


class BlockedError(HplanError):
    """Obstacles block every configuration that reaches a fruit or a point.

    Attributes:
        what: Name of the fruit or point in the message.
        tried: Number of configurations tried, at evenly spaced approach angles.
        refined: Number of further configurations, tried at angles near the best ones.
        obstacles: Blocking obstacles, most frequent first, each a mapping with `obstacle`, `link` and the number of
            `configurations`.
        best_clearance_m: Maximum clearance found, in excess of the required clearance [m]; None if unknown.
        needed_clearance_m: Excess clearance required for verification [m].

    Examples:
        >>> from hplan.errors import BlockedError
        >>> obstacle = {"obstacle": "post 1", "link": "hand", "configurations": 12}
        >>> error = BlockedError("fruit 'apple'", 12, [obstacle])
        >>> error.obstacles[0]["link"], error.exit_status
        ('hand', 3)
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
        names = ", ".join(f"{o['obstacle']!r} ({o['link']}: {o['configurations']})" for o in obstacles[:3])
        more = f", and so do {refined} at finer approach angles" if refined else ""
        if best_clearance_m is not None and best_clearance_m > 0.0:
            more += (
                f"; the best of them has a spare clearance of {1e3 * best_clearance_m:.3g} mm, too little for a proof: "
                f"{1e3 * needed_clearance_m:.3g} mm are required"
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
    """No fruit of a tour can be picked.

    Attributes:
        reasons: Pairs of fruit name and the error that explains its failure.

    Examples:
        >>> from hplan.errors import TourError, UnreachableError
        >>> cause = UnreachableError((3.0, 0.0, 1.0), "too_far", "the arm is too short")
        >>> [name for name, _ in TourError([("apple", cause)]).reasons]
        ['apple']
    """

    exit_status = 3

    def __init__(self, reasons: Sequence[tuple[str, HplanError]]) -> None:
        first = "".join(f"; {name!r}: {error.message}" for name, error in reasons[:3])
        super().__init__(
            f"none of {len(reasons)} fruits can be picked{first}{'; ...' if len(reasons) > 3 else ''}",
            unreached=[{"fruit": name, "error": error.as_dict()} for name, error in reasons],
        )
        self.reasons = tuple(reasons)


class DetourError(HplanError):
    """A fruit can be picked, but lengthens its tour by more than allowed.

    Attributes:
        adds_s: Time by which it would lengthen the tour; of fruits that are left out together, the mean [s].
        allowed_s: The allowed time [s].

    Examples:
        >>> from hplan.errors import DetourError
        >>> error = DetourError(7.25, 3.0)
        >>> error.adds_s, error.allowed_s, error.message
        (7.25, 3.0, 'it would lengthen the tour by 7.25 s; 3 s are allowed')
    """

    exit_status = 3
    adds_s: float
    allowed_s: float

    def __init__(self, adds_s: float, allowed_s: float) -> None:
        message = f"it would lengthen the tour by {adds_s:.3g} s; {allowed_s:.3g} s are allowed"
        super().__init__(message, adds_s=adds_s, allowed_s=allowed_s)


class NotFoundError(HplanError):
    """The search is inconclusive: no motion found, and none proved impossible.

    More memory, effort or time may find a motion.

    Attributes:
        tried: Methods tried, one sentence each.

    Examples:
        >>> from hplan.errors import NotFoundError
        >>> error = NotFoundError(["RRT-Connect, 20,000 nodes"])
        >>> error.tried, error.exit_status
        (['RRT-Connect, 20,000 nodes'], 6)
    """

    exit_status = 6

    tried: list[str]

    def __init__(self, tried: Sequence[str], **data: Any) -> None:
        message = f"no motion was found, and none was proved impossible; tried: {'; '.join(tried)}"
        super().__init__(message, tried=list(tried), **data)


class ObstacleInTimeError(NotFoundError):
    """No motion was found past a moving obstacle.

    Attributes:
        obstacle: Obstacle that blocks the best motion found.
        at_s: Time of that contact [s]. Both are None if no obstacle is the reason, for
            example if the torque exceeds its limit while the base tilts.

    Examples:
        >>> from hplan.errors import ObstacleInTimeError
        >>> error = ObstacleInTimeError("cart", 1.25, ["waiting at the start"])
        >>> error.obstacle, error.at_s
        ('cart', 1.25)
    """

    obstacle: str | None
    at_s: float | None

    def __init__(self, obstacle: str | None, at_s: float | None, tried: Sequence[str]) -> None:
        super().__init__(tried, obstacle=obstacle, at_s=at_s)
        if obstacle is not None and at_s is not None:
            self.add(f"obstacle {obstacle!r} blocks the motion at {at_s:.4g} s")


class NotInTimeError(NotFoundError):
    """No motion was certified before the deadline.

    Attributes:
        deadline_s: The deadline, from the start of the call [s].
        elapsed_s: Time elapsed [s].
        tried: Methods tried, with their durations, one sentence each.

    Examples:
        >>> from hplan.errors import NotInTimeError
        >>> error = NotInTimeError(0.1, 0.102, ["grid search for 80 ms"])
        >>> error.deadline_s, error.elapsed_s
        (0.1, 0.102)
    """

    deadline_s: float
    elapsed_s: float

    def __init__(self, deadline_s: float, elapsed_s: float, tried: Sequence[str]) -> None:
        listed = "; ".join(tried) or "nothing, because no time was left"
        message = f"no motion was found within {1e3 * deadline_s:.6g} ms; tried: {listed}"
        HplanError.__init__(self, message, tried=list(tried), deadline_s=deadline_s, elapsed_s=elapsed_s)


class PlanCancelledError(HplanError):
    """The caller cancelled the call.

    Attributes:
        elapsed_s: Time from the start of the call to the cancellation [s].

    Examples:
        >>> from hplan.errors import PlanCancelledError
        >>> PlanCancelledError(0.25).elapsed_s
        0.25
    """

    exit_status = 6
    elapsed_s: float

    def __init__(self, elapsed_s: float) -> None:
        super().__init__(f"the plan was cancelled after {1e3 * elapsed_s:.3g} ms", elapsed_s=elapsed_s)


class WorkersLostError(HplanError):
    """Some tasks repeatedly lost the process that ran them.

    All other tasks are done.

    Attributes:
        tasks: Numbers of the unfinished tasks.

    Examples:
        >>> from hplan.errors import WorkersLostError
        >>> WorkersLostError([3, 7], of=100).tasks
        [3, 7]
    """

    exit_status = 6
    tasks: list[int]

    def __init__(self, tasks: Sequence[int], of: int) -> None:
        message = (
            f"{len(tasks)} of {of} tasks are not done because their processes were lost (out of memory, killed, or on "
            "a failed machine); the others are done"
        )
        super().__init__(message, tasks=list(tasks))
