"""Tasks in which the tool stays upright."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, Field

from hplan.base.checked import StrictModel
from hplan.scene.limits import Vector


def _direction(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    """Refuse a vector without a direction."""
    if not math.hypot(*axis) > 1e-9:
        raise ValueError("expected a direction, not (0, 0, 0)")
    return axis


class Upright(StrictModel):
    """Maximum tilt of the tool during the whole motion.

    The tilt is the angle between the vertical (against gravity, in `base_link`) and an axis fixed in the tool; rotation
    about the vertical does not count. A base with a track does not tilt.

    Attributes:
        max_tilt_deg: Maximum tilt [deg].
        axis: The axis that stays upright, in the tool frame, of any length. None for the one that is vertical at the
            scene's start.

    Examples:
        >>> from hplan.scene import Upright
        >>> Upright(max_tilt_deg=10.0).axis is None
        True
    """

    max_tilt_deg: Annotated[float, Field(gt=0.0, le=120.0)]
    axis: Annotated[Vector, AfterValidator(_direction)] | None = None
