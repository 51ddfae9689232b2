"""Fruit of a scene."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from hplan.scene.limits import Size, Vector
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
