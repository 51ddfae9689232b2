"""The scene: obstacles, fruit, start and goal.

A scene never changes; `with_obstacles` gives a new one. The classes are the scene file's schema too
(`hplan.scene.file`). What keeps the arm away are an obstacle's `solids`: itself, or what a mesh or a point cloud
becomes (`hplan.scene.solids`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar, Final, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from hplan.base.arrays import FloatArray
from hplan.base.data_files import shipped_robots
from hplan.errors import SceneError
from hplan.scene.fault import StrictModel, fault
from hplan.scene.limits import FARTHEST_M, MOST_OBSTACLES
from hplan.scene.obstacles import (
    Box,
    Capsule,
    Cylinder,
    Mesh,
    Name,
    Obstacle,
    PointCloud,
    Sigma,
    Size,
    Solid,
    Sphere,
    Vector,
)

FORMAT: Final = "hplan-scene/1"


class Fruit(StrictModel):
    """A fruit: a ball, an obstacle unless it is the one being reached for."""

    name: Name
    center: Vector
    radius: Size
    sigma: Sigma = 0.0


class Start(StrictModel):
    """The start of the motion: one of `joints_deg`, `joints_rad`."""

    joints_deg: tuple[float, ...] | None = None
    joints_rad: tuple[float, ...] | None = None

    #: The keys of which one is to be given.
    _choices: ClassVar[tuple[str, ...]] = ("joints_deg", "joints_rad")

    @model_validator(mode="after")
    def _one_of(self) -> Start:
        given = [key for key in self._choices if getattr(self, key) is not None]
        if len(given) != 1:
            keys = ", ".join(self._choices)
            raise ValueError(f"give exactly one of {keys}; got {', '.join(given) or 'none'}")
        return self

    def joints(self) -> FloatArray | None:
        """The configuration [rad], or None for a goal given otherwise."""
        if self.joints_deg is not None:
            return np.radians(self.joints_deg)
        return None if self.joints_rad is None else np.array(self.joints_rad, dtype=np.float64)

    @property
    def configuration(self) -> FloatArray:
        """The configuration [rad].

        Raises:
            SceneError: It is a goal given otherwise.
        """
        joints = self.joints()
        if joints is None:
            raise SceneError("expected a goal given by joints", where="goal")
        return joints


class Goal(Start):
    """The goal of the motion: joints, a `tool0` position, or the name of a fruit.

    To a position or a fruit, `approach_deg` fixes or bounds the angle of the last link in the arm plane (0: outward,
    90: up).
    """

    position: Vector | None = None
    fruit: str | None = None
    approach_deg: float | tuple[float, float] | None = None

    _choices: ClassVar[tuple[str, ...]] = ("joints_deg", "joints_rad", "position", "fruit")

    @model_validator(mode="after")
    def _approach_is_free(self) -> Goal:
        if self.approach_deg is not None and self.joints() is not None:
            raise ValueError("approach_deg belongs to a position or a fruit; joints leave nothing to choose")
        return self


class Scene(StrictModel):
    """Everything around the arm, and what it is asked to do.

    Attributes:
        name: Name of the scene.
        robot: Name of the shipped robot that it is meant for; None for the default one. Commands take it unless they
            are told another, as `load_robot(scene.robot)` does; it is no part of what is planned or certified.
        start: Configuration at which the motion begins.
        goal: Configuration, tool position or fruit to reach.
        locked_joints: Joints that keep their start value.
        clearance: Distance kept from every obstacle [m].
        obstacles: What must not be touched.
        fruits: Fruit; obstacles too, except the one reached for.
    """

    format: Literal["hplan-scene/1"] = FORMAT
    name: Name
    robot: Annotated[str | None, Field(exclude=True)] = None  # no part of the digest: the robot has its own
    start: Start
    goal: Goal
    locked_joints: tuple[str, ...] = ()
    clearance: Annotated[float, Field(ge=0.0, le=FARTHEST_M)] = 0.0
    obstacles: Annotated[tuple[Obstacle, ...], Field(max_length=MOST_OBSTACLES)] = ()
    fruits: Annotated[tuple[Fruit, ...], Field(max_length=MOST_OBSTACLES)] = ()

    @field_validator("robot")
    @classmethod
    def _robot_ships(cls, robot: str | None) -> str | None:
        if robot is not None and robot not in shipped_robots():
            raise ValueError(f"no robot of that name ships with hplan; there are {', '.join(shipped_robots())}")
        return robot

    @model_validator(mode="after")
    def _names_are_unique(self) -> Scene:
        seen: set[str] = set()
        for key, items in (("obstacles", self.obstacles), ("fruits", self.fruits)):
            for index, item in enumerate(items):
                if item.name in seen:
                    raise fault(f"two obstacles are called {item.name!r}; names must differ", key, index, "name")
                seen.add(item.name)
        if self.goal.fruit is not None and self.goal.fruit not in {fruit.name for fruit in self.fruits}:
            raise fault(f"{self.goal.fruit!r} is not among the fruits", "goal", "fruit")
        return self

    @property
    def solids(self) -> tuple[Solid, ...]:
        """All that the arm must keep clear of: the obstacles' solids, and each fruit that is not the goal as a ball.

        Those of one obstacle have its name and stand together.
        """
        return tuple(solid for solid in self.solids_with_goal if solid.name != self.goal.fruit)

    @property
    def solids_with_goal(self) -> tuple[Solid, ...]:
        """As `solids`, the fruit that is the goal among them."""
        balls = (Sphere(name=f.name, center=f.center, radius=f.radius, sigma=f.sigma) for f in self.fruits)
        return (*(solid for obstacle in self.obstacles for solid in obstacle.solids), *balls)

    def with_obstacles(self, obstacles: Sequence[Sphere | Capsule | Cylinder | Box | Mesh | PointCloud]) -> Scene:
        """The same task among other obstacles."""
        return Scene.model_validate(
            {**{key: getattr(self, key) for key in type(self).model_fields}, "obstacles": tuple(obstacles)}
        )
