"""What an arm has to keep clear of, made ready for planning and for judging.

The clearance to keep differs from obstacle to obstacle: to the scene's own comes what the tracking error may take, and
for an obstacle whose place is uncertain a chosen number of its standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hplan import ties
from hplan.arrays import FloatArray, Record, frozen
from hplan.clearance import ClearanceField
from hplan.collision import CollisionScene, base_contacts, base_radius
from hplan.errors import InputError
from hplan.robot import Robot
from hplan.scene import Solid
from hplan.section import Bodies, bodies_of

#: An obstacle may be this deep in pedestal or turret [m]: they stand on something.
BASE_DEPTH = 1e-3


@dataclass(frozen=True, eq=False)
class Surroundings(Record):
    """An arm among solids.

    Attributes:
        robot: The arm.
        solids: What it keeps clear of.
        clearance: Clearance to keep from all of them [m]: the scene's, and what the tracking error may take.
        growth: (solids,) clearance to keep from each beyond that, for its uncertainty [m].
        field: Distances between arm and solids, less the clearance to keep.
        judge: The solids in coal, each grown by its own growth.
        touched: Name of the solids that the last link may touch; None for none.
    """

    robot: Robot
    solids: tuple[Solid, ...]
    clearance: float
    growth: FloatArray
    field: ClearanceField
    judge: CollisionScene
    touched: str | None = None

    @classmethod
    def of(
        cls,
        robot: Robot,
        solids: Sequence[Solid],
        *,
        clearance: float = 0.0,
        tracking_error: float = 0.0,
        sigmas: float = 0.0,
    ) -> Surroundings:
        """Make solids ready.

        Args:
            robot: The arm.
            solids: What it keeps clear of.
            clearance: Clearance to keep [m].
            tracking_error: Deviation of any joint that motions have to allow for [rad].
            sigmas: How many standard deviations of its place an obstacle grows by.
        """
        growth = frozen(np.array([sigmas * solid.sigma for solid in solids], dtype=np.float64))
        keep = clearance + float(robot.sway(tracking_error).max())
        return cls(
            robot=robot,
            solids=tuple(solids),
            clearance=keep,
            growth=growth,
            field=ClearanceField.of(robot, solids, clearance=keep + growth, own_clearance=keep),
            judge=CollisionScene(robot, solids, growth=growth),
        )

    def touching(self, name: str) -> Surroundings:
        """The same where the last link may touch the solids of a name; bodies for cutting do not know them at all."""
        touched = np.array([solid.name == name for solid in self.solids], dtype=np.bool_)
        return replace(self, field=self.field.sparing(touched), judge=self.judge.touching(name), touched=name)

    def bodies(self, more: float = 0.0) -> Bodies:
        """The solids made ready for cutting, grown by the clearance to keep and `more` [m]."""
        kept = [number for number, solid in enumerate(self.solids) if solid.name != self.touched]
        return bodies_of(
            [self.solids[i] for i in kept],
            clearance=self.clearance + self.growth[kept] + more,
            own_clearance=self.clearance + more,
        )

    def check_base(self, yaw: float) -> None:
        """Refuse obstacles in which pedestal or turret stand: no motion of the arm changes that.

        The ground may touch the pedestal.

        Args:
            yaw: Yaw of the turret.

        Raises:
            InputError: There is one; names it, the body and the depth.
        """
        rows = self.field.solids
        near = np.linalg.norm(rows[:, 2:5], axis=1) <= rows[:, 5] + base_radius(self.robot)
        touched = [self.solids[i] for i in np.unique(self.field.owner[near]).tolist() if i >= 0]
        contacts = base_contacts(self.robot, touched, yaw, margin=-BASE_DEPTH)
        if contacts:
            worst = contacts[ties.argmin([contact.distance_m for contact in contacts])]
            raise InputError(
                f"obstacle {worst.obstacle!r} is {-1e3 * worst.distance_m:.3g} mm deep in the robot's "
                f"{worst.link!r}, which does not move: move the obstacle, or the robot",
                obstacle=worst.obstacle,
                link=worst.link,
                depth_m=-worst.distance_m,
            )
