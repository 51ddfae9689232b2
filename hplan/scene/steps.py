"""Steps of a task: motions between which the arm picks objects up and puts them down."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from hplan.base.checked import StrictModel, fault
from hplan.scene.attached import HEAVIEST_KG
from hplan.scene.limits import Vector
from hplan.scene.model import Goal
from hplan.scene.obstacle_kind import Name


class Step(StrictModel):
    """A motion to a goal, and what the hand does there.

    Attributes:
        goal: Goal of the motion.
        pick: Name of the obstacle or fruit that the arm holds from then on; None for none.
        put: Name of the held object that is an obstacle from then on, where it is; None for none.
        frame: Name of the frame that holds a picked object; None for the tool frame.
        mass: Mass of a picked object [kg].
        center_of_mass: Its centre of mass in the frame [m]; None for that of a homogeneous solid.
        inertia: Rows of its inertia about the centre of mass, along the axes of the frame [kg m^2]; None for that of a
            homogeneous solid.
        may_touch: Links and other held objects that it may touch, as for `Attached`.
        contact_depth: Maximum depth of contacts at the pick or the put [m]: of the hand and the object, and of the
            object and what it stands on. The motion to the place comes no nearer than there, nor does the one away from
            it (`Start.contact_depth`).

    Examples:
        >>> from hplan.scene import Goal, Step
        >>> Step(goal=Goal(joints_deg=(0.0, 45.0, 60.0, 70.0)), pick="crate", mass=1.5).change
        'crate'
    """

    goal: Goal
    pick: Name | None = None
    put: Name | None = None
    frame: Name | None = None
    mass: Annotated[float, Field(ge=0.0, le=HEAVIEST_KG)] = 0.0
    center_of_mass: Vector | None = None
    inertia: tuple[Vector, Vector, Vector] | None = None
    may_touch: tuple[Name, ...] | None = None
    contact_depth: Annotated[float, Field(ge=0.0, le=0.05)] = 0.002

    @model_validator(mode="after")
    def _picks_or_puts(self) -> Step:
        if self.pick is not None and self.put is not None:
            raise fault("a step picks or puts one object; add a step for the other", "put")
        for key in ("frame", "center_of_mass", "inertia", "may_touch", "mass"):
            if self.pick is None and getattr(self, key) not in (None, 0.0):
                raise fault(f"{key} belongs to a pick", key)
        return self

    @property
    def change(self) -> str | None:
        """Name of the object that changes hands at the end of the step; None for none."""
        return self.pick or self.put

    @property
    def held(self) -> dict[str, Any]:
        """Values of `Attached` for a picked object, besides its shape."""
        return {key: getattr(self, key) for key in ("frame", "mass", "center_of_mass", "inertia", "may_touch")}
