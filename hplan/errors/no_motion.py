"""Errors where no motion is: shown not to exist (exit status 3), or not found (6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hplan.errors.root import HplanError


class NoPathError(HplanError):
    """No path exists on the grid, as flooding all that the start reaches shows; or none at all: a joint is blocked.

    `blockers` lists what bounds the reached region, largest part first, each a mapping with `obstacle`, `link`, `cells`
    and `slices_deg` (first and last value at which it blocks, of the last planned joint or of the one that is blocked).
    `goals` is for how many goals, all that there were, it was shown; the other facts are of the first of them.
    `open_ended` is set where the region ends at the edge of the yaws that were searched, so that a wider range might
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
        place = ", ".join(f"{value:.6g}" for value in position_m)
        message = f"the tool cannot reach ({place}) m: {detail}"
        super().__init__(message, position_m=list(position_m), reason=reason, **data)
        self.position_m = tuple(position_m)


class ApproachError(HplanError):
    """No straight approach as long as asked for.

    `reason` is `joint_limit` (`joint`), `elbow` (it would come too near to straight or folded), `joints` (fewer than
    three that may move) or, of a general (non-planar) arm, `line` (the tool cannot be drawn back so far).
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
        names = ", ".join(f"{o['obstacle']!r} ({o['link']}: {o['configurations']})" for o in obstacles[:3])
        more = f", and so do {refined} at finer approach angles" if refined else ""
        if best_clearance_m is not None and best_clearance_m > 0.0:
            more += (
                f"; spare clearance {1e3 * best_clearance_m:.3g} mm at the best of them, too little to be verified: "
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
        first = "".join(f"; {name!r}: {error.message}" for name, error in reasons[:3])
        super().__init__(
            f"none of {len(reasons)} fruits can be picked{first}{'; ...' if len(reasons) > 3 else ''}",
            unreached=[{"fruit": name, "error": error.as_dict()} for name, error in reasons],
        )
        self.reasons = tuple(reasons)


class NotFoundError(HplanError):
    """No motion was found within the memory and effort given, and none was shown not to exist.

    `tried` says what was tried, sentence by sentence.
    """

    exit_status = 6

    tried: list[str]

    def __init__(self, tried: Sequence[str], **data: Any) -> None:
        message = f"no motion was found, and it was not shown that there is none; tried: {'; '.join(tried)}"
        super().__init__(message, tried=list(tried), **data)


class ObstacleInTimeError(NotFoundError):
    """No motion was found past something that moves: `obstacle` is in the way, at `at_s`, of the best that was found.

    Both are None where the base alone moves and nothing was found to be timed.
    """

    obstacle: str | None
    at_s: float | None

    def __init__(self, obstacle: str | None, at_s: float | None, tried: Sequence[str]) -> None:
        super().__init__(tried, obstacle=obstacle, at_s=at_s)
        if obstacle is not None and at_s is not None:
            self.add(f"obstacle {obstacle!r} is in the way at {at_s:.4g} s")


class NotInTimeError(NotFoundError):
    """No motion was certified before the deadline; `tried` says what was tried, and for how long."""

    deadline_s: float
    elapsed_s: float

    def __init__(self, deadline_s: float, elapsed_s: float, tried: Sequence[str]) -> None:
        listed = "; ".join(tried) or "nothing, as time was up at once"
        message = f"no motion was found in time: {1e3 * deadline_s:.6g} ms are over; tried: {listed}"
        HplanError.__init__(self, message, tried=list(tried), deadline_s=deadline_s, elapsed_s=elapsed_s)


class PlanCancelledError(HplanError):
    """A plan was cancelled, `elapsed_s` after it was begun."""

    exit_status = 6
    elapsed_s: float

    def __init__(self, elapsed_s: float) -> None:
        super().__init__(f"the plan was cancelled after {1e3 * elapsed_s:.3g} ms", elapsed_s=elapsed_s)


class WorkersLostError(HplanError):
    """Tasks that never came to an end: the processes that had them were lost, again and again.

    `tasks` are their numbers. Whatever else was asked for is done.
    """

    exit_status = 6
    tasks: list[int]

    def __init__(self, tasks: Sequence[int], of: int) -> None:
        message = (
            f"{len(tasks)} of {of} tasks did not end, as the processes that had them were lost (out of memory, killed, "
            "or a machine gone); the others are done"
        )
        super().__init__(message, tasks=list(tasks))
