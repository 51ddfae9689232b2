"""Moving obstacles of studies: true trajectories, and predictions for the planner."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from studies.validation import judge
from studies.validation.random_worlds import direction

from hplan.base.arrays import FloatArray
from hplan.errors import InputError
from hplan.scene.obstacles import Box, Obstacle, Sphere
from hplan.scene.tracks import Drift, Track

#: Balls: number; radius [m]; initial speed [m/s] and maximum acceleration [m/s^2]; step [s]; prediction [s].
BALLS, RADIUS_M, SPEED_M_S, MOST_M_S2, STEP_S, BALLS_AHEAD_S = 10, 0.08, 1.0, 3.0, 5e-3, 2.0

#: Maximum errors of a ball's measured position and velocity.
SEEN = Drift(radius_m=2e-3, speed_m_s=0.02, acceleration_m_s2=MOST_M_S2)

#: Objects on their way by a known law: how far ahead they are predicted [s], and rounding.
LAW_AHEAD_S, ROUNDED = 2.0, Drift(radius_m=1e-4)

#: Motions are planned around moving obstacles that are wider by this on each side [m].
WIDER_M = 0.03

#: Motion of objects over a step: (n, 3) places [m] and velocities [m/s] -> those after it.
Law: TypeAlias = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def planned_around(item: Obstacle) -> Obstacle:
    """A seen obstacle for plans: wider, and on its predicted track alone.

    Within a drift that grows for seconds there is no motion.
    """
    track = None if item.track is None else item.track.copy_unchecked({"drift": None})
    if isinstance(item, Box):
        return item.with_values(track=track, size=tuple(length + 2.0 * WIDER_M for length in item.size))
    if isinstance(item, Sphere):
        return item.with_values(track=track, radius=item.radius + WIDER_M)
    raise InputError(f"obstacle {item.name!r}: crowds have boxes and balls", name=item.name)


class Crowd(abc.ABC):
    """Moving obstacles.

    Attributes:
        shapes: The obstacles, at any place.
        step_s: Time between two changes of velocity [s].
        places: (n, 3) centres [m].
        velocities: (n, 3) velocities [m/s].
        path: The centres after each past step.
    """

    def __init__(self, shapes: Sequence[Box | Sphere], places: FloatArray, velocities: FloatArray, step_s: float):
        self.shapes, self.places, self.velocities, self.step_s = shapes, places, velocities, step_s
        self.path = [places]

    @abc.abstractmethod
    def step(self, places: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places and velocities a step later."""

    @abc.abstractmethod
    def seen(self, now: float) -> list[Obstacle]:
        """The obstacles as predicted at a time, with their drift."""

    def advance(self, until_s: float) -> None:
        """Move the obstacles until a time."""
        while len(self.path) * self.step_s <= until_s + 1e-9:
            self.places, self.velocities = self.step(self.places, self.velocities)
            self.path.append(self.places)

    def judged(self) -> list[judge.JudgedObstacle]:
        """The obstacles on their true ways."""
        times, items = self.step_s * np.arange(len(self.path)), []
        for shape, path in zip(self.shapes, np.array(self.path).swapaxes(0, 1), strict=True):
            track = {"times_s": times, "shifts_m": path}
            items.append(shape.model_dump(mode="json", by_alias=True) | {"center": (0.0, 0.0, 0.0), "track": track})
        return judge.read_obstacles(items)


class DriftingBalls(Crowd):
    """Balls that accelerate at random about an arm, seen with errors and predicted at constant velocity."""

    def __init__(self, rng: np.random.Generator, extent: float) -> None:
        self._rng, self._extent = rng, extent
        turns = rng.uniform(-np.pi, np.pi, BALLS)
        ring = np.column_stack([np.cos(turns), np.sin(turns), rng.uniform(0.2, 0.6, BALLS)])
        velocities = np.array([SPEED_M_S * direction(rng) for _ in range(BALLS)])
        shapes = [Sphere(name=f"ball {number}", center=(0.0, 0.0, 0.0), radius=RADIUS_M) for number in range(BALLS)]
        super().__init__(shapes, extent * ring * (0.65, 0.65, 1.0), velocities, STEP_S)

    def step(self, places: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Accelerate at random, within a thick ring about the base."""
        # They do not touch the base, and are no faster than at first if possible.
        level = places * (1.0, 1.0, 0.0)
        back = 0.65 * self._extent * level / np.linalg.norm(level, axis=1, keepdims=True) - places
        back[:, 2] += 0.4 * self._extent
        is_fast = np.linalg.norm(velocities, axis=1, keepdims=True) > SPEED_M_S
        is_out = np.linalg.norm(back, axis=1, keepdims=True) > 0.25 * self._extent
        pull = np.where(is_fast, -velocities, [direction(self._rng) for _ in range(BALLS)])
        pull = np.where(is_out, back, pull)
        push = MOST_M_S2 * pull / np.linalg.norm(pull, axis=1, keepdims=True)
        # The path between two steps is taken as straight: it differs by at most a t^2 / 8, which is 6e-6 m.
        return places + STEP_S * velocities + 0.5 * STEP_S**2 * push, velocities + STEP_S * push

    def seen(self, now: float) -> list[Obstacle]:
        """The balls with errors of place and velocity, on straight tracks."""
        found = list[Obstacle]()
        for shape, place, velocity in zip(self.shapes, self.places, self.velocities, strict=True):
            center = place + 0.99 * SEEN.radius_m * direction(self._rng)
            ahead = BALLS_AHEAD_S * (velocity + 0.99 * SEEN.speed_m_s * direction(self._rng))
            times = now, now + BALLS_AHEAD_S
            track = Track(times_s=times, shifts_m=((0.0, 0.0, 0.0), tuple(ahead.tolist())), drift=SEEN)
            found.append(shape.with_values(center=tuple(center.tolist()), track=track))
        return found


class LawfulObjects(Crowd):
    """Objects on their way by a law, which is known."""

    def __init__(
        self, shapes: Sequence[Box], places: FloatArray, velocities: FloatArray, step_s: float, law: Law
    ) -> None:
        super().__init__(shapes, places, velocities, step_s)
        self._law = law

    def step(self, places: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places and velocities by the law."""
        return self._law(places, velocities)

    def seen(self, now: float) -> list[Obstacle]:
        """The objects on their ways by the law."""
        places, velocities, path, found = self.places, self.velocities, [self.places], list[Obstacle]()
        times = np.arange(now, now + LAW_AHEAD_S, self.step_s)
        for _ in times[1:]:
            places, velocities = self._law(places, velocities)
            path.append(places)
        for shape, way in zip(self.shapes, np.array(path).swapaxes(0, 1), strict=True):
            # Straight between the ends and the steps where the direction changes.
            bends = np.linalg.norm(np.diff(way, 2, axis=0), axis=1) > 1e-9
            rows = np.flatnonzero(np.concatenate([[True], bends, [True]]))
            shifts = tuple(map(tuple, (way[rows] - way[0]).tolist()))
            track = Track(times_s=tuple(times[rows].tolist()), shifts_m=shifts, drift=ROUNDED)
            found.append(shape.with_values(center=tuple(way[0].tolist()), track=track))
        return found


def reflected(
    places: FloatArray, velocities: FloatArray, *, step_s: float, robot: Mapping[str, Any], base: float
) -> tuple[FloatArray, FloatArray]:
    """A step at constant velocity; reflected by ground and workspace, and kept away from the base.

    The law `moveLightDirections` of Covic and Lacevic's program RPMPLv2.

    Args:
        step_s: Length of the step [s].
        robot: Their robot's workspace and maximum velocity.
        base: Radius of its base [m].
    """
    center, radius = np.array(robot["WS_center"]), float(robot["WS_radius"])
    after = places + step_s * velocities
    near = np.maximum(np.linalg.norm(velocities, axis=1) / robot["max_vel"][0], base)
    off, level = after - center, after * (1.0, 1.0, 0.0)
    at_base = (np.linalg.norm(level, axis=1) < near) & (after[:, 2] < center[2])
    cases = [after[:, 2] < 0.0, np.linalg.norm(off, axis=1) > radius, at_base, np.linalg.norm(off, axis=1) < near]
    normals = np.select([case[:, None] for case in cases], [np.tile((0.0, 0.0, 1.0), (len(off), 1)), -off, level, off])
    part = np.einsum("nk,nk->n", after - places, normals) / np.maximum(np.einsum("nk,nk->n", normals, normals), 1e-12)
    turned = 2.0 * after - places - 2.0 * part[:, None] * normals
    changes = np.any(cases, axis=0)[:, None]
    return np.where(changes, turned, after), np.where(changes, (turned - after) / step_s, velocities)


def circled(places: FloatArray, _: FloatArray, *, step_s: float, speed: float) -> tuple[FloatArray, FloatArray]:
    """A step round the base, the law `moveCircular` of their program."""
    turns = np.arctan2(places[:, 1], places[:, 0])
    velocities = speed * np.column_stack([-np.sin(turns), np.cos(turns), 0.0 * turns])
    return places + step_s * velocities, velocities
