"""Why no motion leads to any of several goals, put into one error."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from hplan.errors import CertificationError, HplanError, NoPathError, NotFoundError, TimingError
from hplan.planning.enclosure import EnclosedError

#: So many reasons stand in the sentence; `data` has all of them.
TOLD = 3


@dataclass(frozen=True, eq=False)
class Refusals:
    """Errors of several goals.

    Attributes:
        errors: One for each goal, in the goals' order; at least one.
    """

    errors: tuple[HplanError, ...]

    def error(self, goals: str = "goals") -> HplanError:
        """The one error to raise.

        `NoPathError` only where no path was shown for every goal; `NotFoundError` where it was shown for some and no
        motion was found to the others.

        Args:
            goals: What the goals are, in the plural.
        """
        first, count = self.errors[0], len(self.errors)
        if isinstance(first, NoPathError) and all(isinstance(error, NoPathError) for error in self.errors):
            told = first.explained() if isinstance(first, EnclosedError) else first
            detail = told.message.removeprefix("no path exists on the grid: ")
            message = f"no path exists on the grid to any of {count} {goals}; to the first of them: {detail}"
            return (
                told
                if count == 1
                else NoPathError(message, reached_cells=told.reached_cells, blockers=told.blockers, goals=count)
            )
        if count == 1:
            return first
        tally = Counter(_reason(error) for error in self.errors).most_common()  # in order of appearance where equal
        reasons = [{"reason": reason, "goals": number} for reason, number in tally]
        if all(isinstance(error, NoPathError | NotFoundError) for error in self.errors):
            missed = next(error for error in self.errors if isinstance(error, NotFoundError))
            return NotFoundError(missed.tried, goals=count, reasons=reasons)
        text = "; ".join(f"{number} x {reason}" for reason, number in tally[:TOLD])
        message = f"no certified motion to any of {count} {goals}: {text}{'; ...' if len(tally) > TOLD else ''}"
        failed = next(error for error in self.errors if not isinstance(error, NoPathError))
        if isinstance(failed, TimingError) and not any(isinstance(error, CertificationError) for error in self.errors):
            return TimingError(message, joint=failed.joint, cause=failed.cause)
        return CertificationError(message, goals=count, reasons=reasons)


def _reason(error: HplanError) -> str:
    return "no path exists on the grid" if isinstance(error, NoPathError) else error.message
