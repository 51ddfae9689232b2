"""Objects that the arm holds: obstacles attached to a frame of the robot, with mass and permitted contacts."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from hplan.base.checked import StrictModel, fault
from hplan.scene.limits import Vector
from hplan.scene.obstacle_kind import Name
from hplan.scene.obstacles import Obstacle

#: Maximum mass of a held object [kg].
HEAVIEST_KG = 1e4


class Attached(StrictModel):
    """An object attached to a frame of the robot: a crate in the gripper, a cup, a tool.

    It moves with the frame and counts as a part of the link that carries it: in collision checks, in the certificate,
    on pages, and with mass and inertia in torques.

    Attributes:
        object: Its shape and name; the coordinates are those of the frame. It has no track, sway, deflection or
            position uncertainty of its own.
        frame: Name of the frame or link that holds it; None for the tool frame.
        mass: Mass [kg].
        center_of_mass: Centre of mass in the frame [m]; None for that of a homogeneous solid of this shape.
        inertia: Rows of the inertia about the centre of mass, along the axes of the frame [kg m^2]; None for that of a
            homogeneous solid of this shape.
        may_touch: Names of the links and other held objects that it may touch; None for the links of the hand, fingers
            included, if the hand holds it, and for none otherwise. It may always touch what does not move relative to
            it.

    Examples:
        >>> from hplan.scene import Attached, Box
        >>> crate = Box(name="crate", center=(0.1, 0.0, 0.0), size=(0.2, 0.3, 0.2))
        >>> Attached(object=crate, mass=1.5).name
        'crate'
    """

    object: Obstacle
    frame: Name | None = None
    mass: Annotated[float, Field(ge=0.0, le=HEAVIEST_KG)] = 0.0
    center_of_mass: Vector | None = None
    inertia: tuple[Vector, Vector, Vector] | None = None
    may_touch: tuple[Name, ...] | None = None

    @model_validator(mode="after")
    def _is_rigid(self) -> Attached:
        held = self.object
        for key in ("track", "sway", "covariance", "parent"):
            if getattr(held, key, None) is not None:
                raise fault(f"a held object has no {key}", "object", key)
        for key in ("yields", "sigma"):
            if getattr(held, key) != 0.0:
                raise fault(f"a held object has no {key}", "object", key)
        return self

    @model_validator(mode="after")
    def _has_mass(self) -> Attached:
        for key in ("center_of_mass", "inertia"):
            if self.mass == 0.0 and getattr(self, key) is not None:
                raise fault(f"{key} belongs to a mass: give mass [kg] too", key)
        if self.inertia is not None:
            rows = np.array(self.inertia)
            moments = np.linalg.eigvalsh(0.5 * (rows + rows.T))
            size = float(np.abs(rows).max())
            is_physical = moments[0] >= 0.0 and moments[2] <= (moments[0] + moments[1]) * (1.0 + 1e-6)
            if not (np.abs(rows - rows.T).max() <= 1e-9 * size and is_physical):
                reason = (
                    "expected a symmetric matrix whose principal moments are >= 0, none above the sum of the others"
                )
                raise fault(reason, "inertia")
        return self

    @property
    def name(self) -> str:
        """Name of the object."""
        return self.object.name
