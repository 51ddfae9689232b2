"""Errors of a machine in the field that its planner does not know."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from hplan.base.arrays import FloatArray
from hplan.base.checked import NotNegative, Options
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import Convex

#: Standard deviations that certificates cover. Three of those that a seen scene states are the largest error of the
#: base at an obstacle, and for fruit the camera's as well.
SIGMAS = 3.0


@dataclass(frozen=True)
class FieldErrors(Options):
    """Errors of base, camera and masses.

    Attributes:
        base_m: Distance of the base from its assumed position [m].
        base_deg: Error of its heading [deg].
        camera_m: Standard deviation of each coordinate of a fruit in a camera frame [m].
        looks: Number of frames after the stop, to whose mean the fruit is registered; 0 for no registration.
        mass: Relative error of the arm's masses.

    Examples:
        >>> import numpy as np
        >>> from hplan.apps.execution.field_errors import FieldErrors
        >>> from hplan.scene import load_scene
        >>> seen = FieldErrors(looks=0).seen_scene(load_scene("tour"), np.random.default_rng(1))
        >>> seen.fruits[0].sigma > 0.003
        True
    """

    base_m: NotNegative = 0.005
    base_deg: NotNegative = 0.3
    camera_m: NotNegative = 0.003
    looks: Annotated[int, Field(ge=0)] = 30
    mass: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.2

    def mass_factor(self, random: np.random.Generator) -> float:
        """Ratio of the true masses to the model's, too light or too heavy."""
        return 1.0 + self.mass * float(random.choice((-1.0, 1.0)))

    def seen_scene(self, scene: Scene, random: np.random.Generator) -> Scene:
        """Return the scene as the planner sees it.

        The base is off, fruit positions have noise, and the scene states standard deviations for both.

        Args:
            scene: The true scene.
            random: Random number generator.

        Raises:
            MovingObstacleError: The base or an obstacle has a track.
        """
        heading = float(random.uniform(0.0, 2.0 * math.pi))
        off = self.base_m * np.array([math.cos(heading), math.sin(heading), 0.0])
        seen = scene.shift(off, self.base_deg * float(random.choice((-1.0, 1.0))))
        base_sigma: Callable[[Sequence[float]], float] = self._base_sigma
        noise = self.camera_m / math.sqrt(max(1, self.looks))
        if self.looks and scene.fruits:
            seen, base_sigma = self._register(seen, scene, noise, random)
        fruits = tuple(
            fruit.copy_unchecked({
                "center": tuple((np.array(fruit.center) + random.normal(scale=noise, size=3)).tolist()),
                "sigma": math.hypot(base_sigma(fruit.center), noise),
            })
            for fruit in seen.fruits
        )  # fmt: skip
        obstacles = tuple(
            piece.copy_unchecked({"sigma": max(base_sigma(point) for point in piece.core.tolist())})
            for piece in seen.obstacles
            if isinstance(piece, Convex)
        )
        return seen.with_values(obstacles=obstacles, fruits=fruits)

    def _base_sigma(self, point: Sequence[float]) -> float:
        """Standard deviation of which `SIGMAS` are the largest error of a point by that of the base [m]."""
        return (self.base_m + math.radians(self.base_deg) * math.hypot(*point[:2])) / SIGMAS

    def _register(
        self, seen: Scene, scene: Scene, noise: float, random: np.random.Generator
    ) -> tuple[Scene, Callable[[Sequence[float]], float]]:
        """Move the scene to where the camera sees its fruit; state the standard deviation of a point by what remains.

        Heading and shift are the least-squares fit of n fruit. A point is off by the shift of their centre, which has
        the variance s^2 / n in each coordinate, and by the heading, with the variance s^2 over the fruit's squared
        distances from their centre.
        """
        known, true = (np.array([fruit.center for fruit in one.fruits]) for one in (seen, scene))
        found = true + random.normal(scale=noise, size=true.shape)
        center: FloatArray = found.mean(axis=0)
        (x, y), (u, v) = (known - known.mean(axis=0))[:, :2].T, (found - center)[:, :2].T
        heading, squares = math.atan2(float(x @ v - y @ u), float(x @ u + y @ v)), float(u @ u + v @ v)
        turned = seen.shift(np.zeros(3), math.degrees(heading))
        moved = turned.shift(center - np.mean([fruit.center for fruit in turned.fruits], axis=0))

        # A single fruit says nothing of the heading.
        turn = noise / math.sqrt(squares) if len(found) > 1 else math.radians(self.base_deg) / SIGMAS

        def sigma(point: Sequence[float]) -> float:
            return math.hypot(noise / math.sqrt(len(found)), turn * math.dist(point[:2], center[:2].tolist()))

        return moved, sigma
