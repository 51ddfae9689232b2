r"""Tracking error model: maximum deviation of a controlled arm from its trajectory.

Tracking errors grow with speed: commands take effect with a delay, and feed-forward has a relative error. The deviation
of each joint from its commanded position :math:`q_j(t)` is therefore bounded by

.. math:: e_j(t) = \text{still} + \text{delay} \cdot |\dot q_j(t)|.

At rest only the first term applies. For prismatic joints the same numbers are in metres and metres per second.
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

#: Accuracy of the maximum permitted tracking error, as a fraction of the requested one.
_FRACTION_ERROR = 1e-3


@dataclass(frozen=True)
class TrackingModel:
    """Maximum deviation of each joint from the commanded motion.

    Attributes:
        still_rad: Deviation at rest [rad; m for prismatic joints].
        delay_s: Additional deviation per unit of the joint's commanded velocity, rad/s or m/s [s].

    Examples:
        >>> TrackingModel(still_rad=0.01, delay_s=0.02).deviations([0.0, 1.0]).tolist()
        [0.01, 0.03]
    """

    still_rad: float = 0.0
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            OptionError: A value is negative or not finite.
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
        """True if the deviation is always zero."""
        return self.still_rad == 0.0 and self.delay_s == 0.0

    def deviations(self, velocity: ArrayLike) -> FloatArray:
        """Maximum deviations [rad] at joint velocities [rad/s], of the same shape."""
        with np.errstate(over="ignore"):
            deviations: FloatArray = self.still_rad + self.delay_s * np.abs(np.asarray(velocity, dtype=np.float64))
        return deviations

    def scale(self, fraction: float) -> TrackingModel:
        """Scale both deviations by a fraction."""
        return TrackingModel(fraction * self.still_rad, fraction * self.delay_s)

    def summary(self, slides: Sequence[bool]) -> str:
        """Describe the model in words.

        Args:
            slides: Whether each joint is prismatic; the text uses degrees, millimetres, or both.
        """
        kinds = [joint_unit(kind).error(self.still_rad) for kind in sorted(set(slides) or {False})]
        error = f"{kinds[0]}, {kinds[1]} for prismatic joints" if len(kinds) > 1 else kinds[0]
        return f"{error} + {1e3 * self.delay_s:.4g} ms of velocity" if self.delay_s else error


def name_margin(
    error: HplanError,
    asked: TrackingModel,
    slides: Sequence[bool],
    fraction: float,
    enough: str = "planning would succeed with",
) -> None:
    """Add the tracking error, and the maximum possible one, to an error.

    Args:
        error: The error; changed.
        asked: The requested tracking error.
        slides: Whether each joint is prismatic.
        fraction: Fraction of the requested tracking error that would succeed. If 0, the error has another cause and is
            left unchanged.
        enough: Phrase before the maximum in the message.
    """
    if not fraction > 0.0:
        return
    largest = asked.scale(fraction)
    error.add(
        f"the required tracking error is {asked.summary(slides)}; {enough} up to {largest.summary(slides)}",
        tracking_error_deg=math.degrees(asked.still_rad),
        tracking_delay_ms=1e3 * asked.delay_s,
        largest_tracking_error_deg=math.degrees(largest.still_rad),
        largest_tracking_delay_ms=1e3 * largest.delay_s,
    )


def largest_fraction(would_do: Callable[[float], bool]) -> float:
    """Maximum fraction of a tracking error that succeeds, by bisection.

    Smaller fractions are assumed to succeed, too.

    Args:
        would_do: True for a fraction that succeeds.

    Returns:
        A fraction that succeeds, less than `_FRACTION_ERROR` below the maximum; 0 if no fraction succeeds.

    Examples:
        >>> round(largest_fraction(lambda fraction: fraction <= 0.5), 2)
        0.5
    """
    if not would_do(0.0):
        return 0.0
    low, high = 0.0, 1.0
    while high - low > _FRACTION_ERROR:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if would_do(middle) else (low, middle)
    return low
