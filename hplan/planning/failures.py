"""Combine the planning failures of several goals into one error."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter

from hplan.errors import (
    BlockedError,
    CertificationError,
    ConfigurationInCollisionError,
    HplanError,
    NoPathError,
    NotFoundError,
    TimingError,
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
        reasons = [{"reason": reason, "goals": number} for reason, number in tally]
        if all(isinstance(error, NoPathError | NotFoundError) for error in self.errors):
            missed = next(error for error in self.errors if isinstance(error, NotFoundError))
            return NotFoundError(missed.tried, goals=count, reasons=reasons)
        text = "; ".join(f"{number} x {reason}" for reason, number in tally[:_MOST_REASONS])
        message = (
            f"no certified motion to any of {count} {goals}: {text}{'; ...' if len(tally) > _MOST_REASONS else ''}"
        )
        failed = next(error for error in self.errors if not isinstance(error, NoPathError))
        if isinstance(failed, TimingError) and not any(isinstance(error, CertificationError) for error in self.errors):
            return TimingError(message, joint=failed.joint, cause=failed.cause)
        return CertificationError(message, goals=count, reasons=reasons)


def _explain_reason(error: HplanError) -> str:
    return "no path exists on the grid" if isinstance(error, NoPathError) else error.message
