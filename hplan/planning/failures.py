"""Combine the planning failures of several goals into one error."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Iterable
from typing import Any, Final, Literal, cast, get_args

from hplan.errors import (
    BlockedError,
    CertificationError,
    ConfigurationInCollisionError,
    HplanError,
    NoPathError,
    NotFoundError,
    TimingError,
    UnreachableError,
)

#: Errors that report a missing motion; any other one is a fault of the input.
NO_MOTION = (
    BlockedError,
    NoPathError,
    NotFoundError,
    CertificationError,
    TimingError,
    ConfigurationInCollisionError,
)

#: Reasons why a fruit is not picked, by the first condition that fails: no configuration reaches it, or none was found;
#: obstacles block all that do; no approach to a collision-free one is certified; no motion to an approach was found.
Reason = Literal["out_of_reach", "blocked", "no_approach", "no_motion"]
REASONS: Final[tuple[Reason, ...]] = get_args(Reason)

#: The reasons in words, for tables and figures.
REASON_WORDS: Final[dict[str, str]] = {
    "out_of_reach": "out of reach",
    "blocked": "blocked",
    "no_approach": "no approach",
    "no_motion": "no motion found",
}

#: Key of `HplanError.data` that marks errors about the straight approach, and its value.
_PHASE, _APPROACH = "phase", "approach"


def mark_approach(error: HplanError) -> HplanError:
    """The error, marked as a failure of the straight approach."""
    error.data[_PHASE] = _APPROACH
    return error


def reason_of(error: HplanError) -> Reason:
    """Why a fruit is not picked, by the error of its motion."""
    if error.data.get("reason") in REASONS:
        return cast(Reason, error.data["reason"])
    if isinstance(error, UnreachableError):
        return "out_of_reach"
    if isinstance(error, BlockedError):
        return "blocked"
    return "no_approach" if error.data.get(_PHASE) == _APPROACH else "no_motion"


def obstacle_of(error: HplanError) -> str | None:
    """Name of the obstacle that an error reports most often; None if unknown."""
    for one in (*error.data.get("obstacles", ()), *error.data.get("blockers", ()), error.data):
        if one.get("obstacle") is not None:
            return str(one["obstacle"])
    return None


def tally_reasons(unpicked: Iterable[tuple[Reason, str | None]]) -> tuple[dict[str, int], dict[str, int]]:
    """Numbers of fruits by reason, and by obstacle in descending order.

    Args:
        unpicked: Reason and obstacle of each fruit that is not picked.
    """
    listed = list(unpicked)
    reasons = Counter(reason for reason, _ in listed)
    obstacles = Counter(obstacle for _, obstacle in listed if obstacle is not None)
    return {reason: reasons[reason] for reason in REASONS}, dict(obstacles.most_common())


#: Maximum number of reasons in the message; `data` has all of them.
_MOST_REASONS = 3


class UnexplainedNoPathError(NoPathError):
    """A proof of infeasibility with an explanation computed on request.

    Finding the explanation takes longer than the proof itself.
    """

    @abstractmethod
    def explain(self) -> NoPathError:
        """Return the error with the blocking obstacles."""


class FailuresError(Exception):
    """Planning failed for every one of several goals; internal, users see `as_one`.

    Attributes:
        errors: One error for each goal, in the order of the goals; at least one.
    """

    def __init__(self, errors: tuple[HplanError, ...]) -> None:
        super().__init__(errors)
        self.errors = errors

    @property
    def is_proof(self) -> bool:
        """True if the absence of a path was proved for each goal."""
        return all(isinstance(error, NoPathError) for error in self.errors)

    def as_one(self, goals: str = "goals") -> HplanError:
        """Return the one error to raise.

        `NoPathError` if the absence of a path is proved for every goal; `NotFoundError` if it is proved for some and
        the search for the others was inconclusive.

        Args:
            goals: Plural noun for the goals in the message.
        """
        first, count = self.errors[0], len(self.errors)
        if isinstance(first, NoPathError) and self.is_proof:
            shown = first.explain() if isinstance(first, UnexplainedNoPathError) else first
            detail = shown.message.removeprefix("no path exists on the grid: ")
            message = f"no path exists on the grid to any of {count} {goals}; to the first of them: {detail}"
            return (
                shown
                if count == 1
                else NoPathError(message, reached_cells=shown.reached_cells, blockers=shown.blockers, goals=count)
            )
        if count == 1:
            return first
        tally = Counter(
            _explain_reason(error) for error in self.errors
        ).most_common()  # in order of appearance if equal
        facts: dict[str, Any] = {"reasons": [{"reason": reason, "goals": number} for reason, number in tally]}
        named = Counter(filter(None, map(obstacle_of, self.errors))).most_common(1)
        facts |= {"obstacle": named[0][0]} if named else {}
        if all(error.data.get(_PHASE) == _APPROACH for error in self.errors):
            facts[_PHASE] = _APPROACH
        if all(isinstance(error, NoPathError | NotFoundError) for error in self.errors):
            missed = next(error for error in self.errors if isinstance(error, NotFoundError))
            return NotFoundError(missed.tried, goals=count, **facts)
        text = "; ".join(f"{number} x {reason}" for reason, number in tally[:_MOST_REASONS])
        message = (
            f"no certified motion to any of {count} {goals}: {text}{'; ...' if len(tally) > _MOST_REASONS else ''}"
        )
        failed = next(error for error in self.errors if not isinstance(error, NoPathError))
        if isinstance(failed, TimingError) and not any(isinstance(error, CertificationError) for error in self.errors):
            timing = TimingError(message, joint=failed.joint, cause=failed.cause)
            timing.data |= facts
            return timing
        return CertificationError(message, goals=count, **facts)


def _explain_reason(error: HplanError) -> str:
    return "no path exists on the grid" if isinstance(error, NoPathError) else error.message
