"""Fruit of a scene."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BeforeValidator, Field, model_validator

from hplan.base.checked import fault
from hplan.scene.limits import FARTHEST_M, Size, Vector
from hplan.scene.obstacle_kind import Item, Name, Sigma, to_tuple


class Fruit(Item):
    """A spherical fruit; an obstacle unless it is the goal.

    `track`, `sway`, `yields` and `covariance` are described in `hplan.scene.obstacle_kind.Item`.

    Attributes:
        name: Name of the fruit.
        center: Centre [m].
        radius: Radius [m].
        sigma: Standard deviation of each coordinate of its position [m].
        hangs_from: Names of the obstacles that the fruit is attached to. They are compliant for a task that may touch
            this fruit: up to their own `yields`, or `hplan.collision.compliant_solids.HANGING_M` if that is 0.
        grasp_offset: Maximum distance of the tool from the centre at the grasp [m], at most the radius. Grasps off the
            centre are tried if obstacles block those at the centre.

    Examples:
        >>> from hplan.scene import Fruit
        >>> apple = Fruit(name="apple", center=(1.2, 0.0, 1.6), radius=0.04, hangs_from="branch 1")
        >>> apple.hangs_from
        ('branch 1',)
    """

    name: Name
    center: Vector
    radius: Size
    sigma: Sigma = 0.0
    hangs_from: Annotated[tuple[Name, ...], BeforeValidator(to_tuple), Field(exclude=True)] = ()
    grasp_offset: Annotated[float, Field(ge=0.0, le=FARTHEST_M, exclude=True)] = 0.0

    @model_validator(mode="after")
    def _is_grasped_inside(self) -> Self:
        if self.grasp_offset > self.radius:
            raise fault(f"expected at most the radius, {self.radius:g} m", "grasp_offset")
        return self
