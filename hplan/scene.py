"""The scene: obstacles, fruit, start and goal.

Positions are in `base_link`, z up, in metres. A scene never changes; `with_obstacles` gives a new one. The classes
are the scene file's schema too (`hplan.scene_file`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final, Literal, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, model_validator
from pydantic_core import PydanticCustomError

from hplan.arrays import FloatArray

FORMAT: Final = "hplan-scene/1"

Vector: TypeAlias = tuple[float, float, float]
Name: TypeAlias = Annotated[str, Field(min_length=1)]


class _Strict(BaseModel):
    """Immutable, no unknown keys, no NaN or infinity, no text where a number belongs."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True, strict=True)


class Sphere(_Strict):
    """A ball."""

    kind: Literal["sphere"] = "sphere"
    name: Name
    center: Vector
    radius: PositiveFloat

    @property
    def core(self) -> FloatArray:
        """(1, 3) points; the obstacle is their hull grown by `rounding`."""
        return np.array([self.center])

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""
        return self.radius


class Capsule(_Strict):
    """A segment with a radius: branch, wire, trunk."""

    kind: Literal["capsule"] = "capsule"
    name: Name
    start: Vector = Field(alias="from")
    end: Vector = Field(alias="to")
    radius: PositiveFloat

    @property
    def core(self) -> FloatArray:
        """(2, 3) points; the obstacle is their hull grown by `rounding`."""
        return np.array([self.start, self.end])

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""
        return self.radius


class Box(_Strict):
    """A block of the given full edge lengths, turned by roll, pitch and yaw (fixed axes x, y, z)."""

    kind: Literal["box"] = "box"
    name: Name
    center: Vector
    size: tuple[PositiveFloat, PositiveFloat, PositiveFloat]
    rpy_deg: Vector = (0.0, 0.0, 0.0)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation from the box's frame to `base_link`."""
        roll, pitch, yaw = (math.radians(angle) for angle in self.rpy_deg)
        cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
        return np.array(
            [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ]
        )

    @property
    def core(self) -> FloatArray:
        """(8, 3) corners; the obstacle is their hull."""
        signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        corners: FloatArray = np.array(self.center) + (0.5 * signs * np.array(self.size)) @ self.rotation.T
        return corners

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""
        return 0.0


Obstacle: TypeAlias = Annotated[Sphere | Capsule | Box, Field(discriminator="kind")]


class Fruit(_Strict):
    """A fruit: a ball, an obstacle unless it is the one being reached for."""

    name: Name
    center: Vector
    radius: PositiveFloat


class Start(_Strict):
    """Where the motion begins: one of `joints_deg`, `joints_rad`."""

    joints_deg: tuple[float, ...] | None = None
    joints_rad: tuple[float, ...] | None = None

    @model_validator(mode="after")
    def _one_of(self) -> Start:
        given = [key for key in type(self).model_fields if getattr(self, key) is not None]
        if len(given) != 1:
            keys = ", ".join(type(self).model_fields)
            raise ValueError(f"give exactly one of {keys}; got {', '.join(given) or 'none'}")
        return self

    def joints(self) -> FloatArray | None:
        """The configuration [rad], or None where the goal is given in another way."""
        if self.joints_deg is not None:
            return np.radians(self.joints_deg)
        return None if self.joints_rad is None else np.array(self.joints_rad, dtype=np.float64)


class Goal(Start):
    """Where the motion ends: joints, a `tool0` position, or the name of a fruit."""

    position: Vector | None = None
    fruit: str | None = None


def _fault(message: str, *below: int | str) -> PydanticCustomError:
    """A fault of the scene as a whole that shows at one place; `scene_file` finds its line by `below`."""
    return PydanticCustomError("scene", "{message}", {"message": message, "below": below})


class Scene(_Strict):
    """Everything around the arm, and what it is asked to do.

    Attributes:
        name: Name of the scene.
        start: Configuration at which the motion begins.
        goal: Configuration, tool position or fruit to reach.
        locked_joints: Joints that keep their start value.
        clearance: Distance kept from every obstacle [m].
        obstacles: What must not be touched.
        fruits: Fruit; obstacles too, except the one reached for.
    """

    format: Literal["hplan-scene/1"] = FORMAT
    name: Name
    start: Start
    goal: Goal
    locked_joints: tuple[str, ...] = ()
    clearance: Annotated[float, Field(ge=0.0)] = 0.0
    obstacles: tuple[Obstacle, ...] = ()
    fruits: tuple[Fruit, ...] = ()

    @model_validator(mode="after")
    def _names_are_unique(self) -> Scene:
        seen: set[str] = set()
        for key, items in (("obstacles", self.obstacles), ("fruits", self.fruits)):
            for index, item in enumerate(items):
                if item.name in seen:
                    raise _fault(f"two obstacles are called {item.name!r}; names must differ", key, index, "name")
                seen.add(item.name)
        if self.goal.fruit is not None and self.goal.fruit not in {fruit.name for fruit in self.fruits}:
            raise _fault(f"{self.goal.fruit!r} is not among the fruits", "goal", "fruit")
        return self

    @property
    def solids(self) -> tuple[Sphere | Capsule | Box, ...]:
        """All that the arm must keep clear of: the obstacles, and each fruit that is not the goal as a ball."""
        kept = [fruit for fruit in self.fruits if fruit.name != self.goal.fruit]
        balls = (Sphere(name=f.name, center=f.center, radius=f.radius) for f in kept)
        return (*self.obstacles, *balls)

    def with_obstacles(self, obstacles: Sequence[Sphere | Capsule | Box]) -> Scene:
        """The same task among other obstacles."""
        return Scene.model_validate(
            {
                **{key: getattr(self, key) for key in type(self).model_fields},
                "obstacles": tuple(obstacles),
            }
        )
