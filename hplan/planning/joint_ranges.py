"""Intervals in which joints can move, and the contacts that end them.

The planner treats the intervals as narrower joint limits. `hplan.planning.specialist` returns them for a robot; without
a specialist they are the joint limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray
from hplan.collision.coal_scene import Contact
from hplan.errors import NoPathError
from hplan.robot.model import Robot

#: Maximum clearance of the intervals beyond the required one [m]; less if start or goal have less.
RANGE_MARGIN: Final = 1e-3

#: A goal out of reach with `MARGIN` is checked again with this margin [m]; less cannot be certified.
LEAST_MARGIN: Final = 3e-5

#: A configuration beyond a wall by less than this counts as on it [rad].
ROUNDING: Final = 1e-9


@dataclass(frozen=True)
class Wall:
    """One end of a joint's free interval, and the blocking contact.

    Attributes:
        joint: Number of the joint.
        angle: End of the free interval [rad].
        is_upper: True for the upper end.
        contact: The two bodies, and their distance beyond the required clearance [m].
    """

    joint: int
    angle: float
    is_upper: bool
    contact: Contact

    def is_before(self, q: FloatArray) -> bool:
        """True if a (dof,) configuration is beyond this wall."""
        value = float(q[self.joint])
        return value > self.angle + ROUNDING if self.is_upper else value < self.angle - ROUNDING

    def no_path(self, robot: Robot, other: float) -> NoPathError:
        """Return the error that names the contact blocking the joint.

        The blocked range is from the wall to another angle [rad].
        """
        low, high = sorted(np.degrees([self.angle, other]).tolist())
        contact = self.contact
        message = (
            f"no path exists: between start and goal, from {low:.4g} to {high:.4g} deg of joint "
            f"{robot.joint_names[self.joint]!r}, {contact.link!r} is in {contact.other_name} or closer than the "
            "required clearance, for all positions of the other joints"
        )
        blocker = {"obstacle": contact.obstacle, "link": contact.link, "cells": 0, "slices_deg": (low, high)}
        return NoPathError(message, reached_cells=0, blockers=[blocker])


@dataclass(frozen=True, eq=False)
class JointRanges:
    """Free intervals of all joints around a configuration.

    Attributes:
        lower: (dof,) lower ends [rad].
        upper: (dof,) upper ends [rad].
        walls: Ends of the intervals that are narrower than the joint limits.
    """

    lower: FloatArray
    upper: FloatArray
    walls: tuple[Wall, ...] = ()

    def hold(self, configurations: FloatArray) -> BoolArray:
        """(n,) mask of the (n, dof) configurations inside the intervals."""
        held = np.ones(len(configurations), dtype=np.bool_)
        for wall in self.walls:
            beyond = configurations[:, wall.joint] - wall.angle
            held &= (beyond if wall.is_upper else -beyond) <= ROUNDING
        return held

    def wall_before(self, q: FloatArray) -> Wall | None:
        """First wall on the way to a configuration; None without one."""
        return next((wall for wall in reversed(self.walls) if wall.is_before(q)), None)
