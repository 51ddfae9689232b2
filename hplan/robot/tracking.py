r"""Model of the tracking error: largest distance of a controlled arm from its trajectory.

Errors of tracking grow with speed: what is commanded comes late, and feed-forward is wrong by a fraction of it. So each
joint is taken to deviate from its commanded position :math:`q_j(t)` by no more than

.. math:: e_j(t) = \text{still} + \text{delay} \cdot |\dot q_j(t)|.

Configurations at rest need room for the first part alone. Of a joint that slides the same numbers count as metres, and
metres per second.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import number
from hplan.base.arrays import FloatArray
from hplan.base.units import joint_unit
from hplan.errors import HplanError

#: How exactly the largest tracking error is found that would do, as a fraction of the one asked for.
_FRACTION_ERROR = 1e-3


@dataclass(frozen=True)
class TrackingModel:
    """Largest deviation of each joint from the commanded motion.

    Attributes:
        still_rad: Deviation at rest [rad; of joints that slide, m].
        delay_s: What comes to it for each rad/s, or m/s, of the joint's commanded velocity [s].
    """

    still_rad: float = 0.0
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            OptionError: One that is negative or not finite.
        """
        for field, option, unit in (
            ("still_rad", "tracking_error", "radians"),
            ("delay_s", "tracking_delay_s", "seconds"),
        ):
            expected = f"a finite number of {unit} >= 0"
            value = number(option, getattr(self, field), expected, lambda given: given >= 0.0)
            object.__setattr__(self, field, value)

    @property
    def is_exact(self) -> bool:
        """True if there is no deviation at all."""
        return self.still_rad == 0.0 and self.delay_s == 0.0

    def deviations(self, velocity: ArrayLike) -> FloatArray:
        """Largest deviations at joint velocities [rad/s], of the same shape [rad]."""
        with np.errstate(over="ignore"):
            deviations: FloatArray = self.still_rad + self.delay_s * np.abs(np.asarray(velocity, dtype=np.float64))
        return deviations

    def scaled(self, fraction: float) -> TrackingModel:
        """The model with a fraction of both deviations."""
        return TrackingModel(fraction * self.still_rad, fraction * self.delay_s)

    def summary(self, slides: Sequence[bool]) -> str:
        """Summary of the model, for joints of which some slide: in degrees, in millimetres, or both."""
        kinds = [joint_unit(kind).error(self.still_rad) for kind in sorted(set(slides) or {False})]
        error = f"{kinds[0]}, {kinds[1]} where a joint slides" if len(kinds) > 1 else kinds[0]
        return f"{error} + {1e3 * self.delay_s:.4g} ms of velocity" if self.delay_s else error


def name_margin(
    error: HplanError, asked: TrackingModel, slides: Sequence[bool], fraction: float, enough: str = "what would do is"
) -> None:
    """Let an error say that what it refuses was refused for a tracking error, and the largest that would do.

    Args:
        slides: Of each joint whether it slides.
        fraction: Fraction of it that would do; where none would, the error has another reason and is left as it is.
    """
    if not fraction > 0.0:
        return
    largest = asked.scaled(fraction)
    error.add(
        f"this allows for a tracking error of {asked.summary(slides)}; {enough} up to {largest.summary(slides)}",
        tracking_error_deg=math.degrees(asked.still_rad),
        tracking_delay_ms=1e3 * asked.delay_s,
        largest_tracking_error_deg=math.degrees(largest.still_rad),
        largest_tracking_delay_ms=1e3 * largest.delay_s,
    )


def largest_fraction(would_do: Callable[[float], bool]) -> float:
    """The largest fraction of a tracking error that would do, of which smaller ones would then do too, by bisection.

    Args:
        would_do: True for a fraction that would do.

    Returns:
        A fraction that does, less than `_FRACTION_ERROR` below the largest; 0 where none does.
    """
    if not would_do(0.0):
        return 0.0
    low, high = 0.0, 1.0
    while high - low > _FRACTION_ERROR:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if would_do(middle) else (low, middle)
    return low
