"""Configurations of a planar arm with its tool at a point.

Approach angles are those of all arms.

`hplan.planar.inverse_kinematics` measures the angle of the last link in the arm plane, from its horizontal axis. The
approach angle of all arms (`hplan.kinematics.tool_at_point`) is measured from the outward direction. In a vertical
plane the two are equal if the point is ahead of the base, and add up to 180 degrees if it is behind.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, frozen
from hplan.errors import UnreachableError
from hplan.kinematics.approach_angles import Window
from hplan.kinematics.tool_at_point import approach_angles, tool_at_point
from hplan.planar.family_reader import family_of
from hplan.planar.inverse_kinematics import reach
from hplan.robot.model import Robot

#: A plane with a normal this close to horizontal is vertical.
_VERTICAL = 1e-9


def configurations_at_point(
    robot: Robot,
    position: ArrayLike,
    *,
    approach_deg: float | tuple[float, float] | None = None,
    count: int,
    start: ArrayLike | None = None,
    locked: Sequence[str] = (),
) -> FloatArray:
    """Return all (k, dof) configurations with the tool at a position, or at one of several; continua are sampled.

    Args:
        robot: The planar arm.
        position: (3,), or (p, 3) for several, in `base_link` [m].
        approach_deg: Approach angle, or an interval (low, high) [deg]; None for all.
        count: Total number of samples of the continua, for each position.
        start: (dof,) start configuration.
        locked: Names of joints that keep their start values.

    Raises:
        UnreachableError: No configuration reaches a position; `reason` and `data` say why.
        InputError: A position, start or joint is invalid.
        OptionError: An option is invalid.
    """
    window = Window.from_degrees(approach_deg)
    if window is None:
        return reach(robot, position, count=count, start=start, locked=locked).configurations
    if abs(np.cross(*family_of(robot).plane_axes)[2]) > _VERTICAL:
        # In a tilted plane an interval of approach angles is none of angles in the plane.
        return tool_at_point(robot, position, approach_deg=approach_deg, count=count, start=start, locked=locked)
    low = math.degrees(window.low)
    high = low + math.degrees(window.width)
    rows: list[FloatArray] = []
    failures: list[UnreachableError] = []
    for ends in ((low, high), (180.0 - high, 180.0 - low)):
        try:
            every = reach(robot, position, approach_deg=ends, count=count, start=start, locked=locked).configurations
        except UnreachableError as error:
            failures.append(error.with_traceback(None))
        else:
            rows.append(every[window.holds(approach_angles(robot, every))])
    found = np.concatenate(rows) if rows else np.empty((0, robot.dof))
    if not len(found):
        raise failures[0] if failures else _beyond_window(position, low, high)
    found = found[np.lexsort(np.round(found, 7).T[::-1])]
    other = np.ones(len(found), dtype=np.bool_)
    other[1:] = (np.abs(np.diff(found, axis=0)) > 1e-7).any(axis=1)
    return frozen(found[other])


def _beyond_window(positions: ArrayLike, low: float, high: float) -> UnreachableError:
    """Return the error for the first of some positions outside the approach window.

    They are reached only with the point on the other side of the base.
    """
    detail = f"not with an approach angle of {low:.4g} to {high:.4g} deg against the outward direction"
    place = np.atleast_2d(np.asarray(positions, dtype=np.float64))[0]
    return UnreachableError(place.tolist(), "approach", detail, approach_deg=[low, high])
