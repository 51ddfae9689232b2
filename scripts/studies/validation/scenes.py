r"""Random scenes of one kind of obstacle each, standing where the arm passes.

An obstacle is put near a random point of a random link at a random configuration whose yaw is in the scene's sector, so
that what is asked of the C-space there is not answered by distance alone. Sizes are spread evenly over their
logarithm, from a twig to a crate. Everything follows from seed, kind and number.

Cutting a mesh into convex pieces takes seconds; so hollow and notched shapes are drawn from a stock of
`_STOCK` that is made when it is first asked for, and placed anew in every scene. Convex ones are always new.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from studies.validation.random_scenes import direction, vector

from hplan.base.arrays import FloatArray, IntArray
from hplan.errors import OptionError
from hplan.geometry.hull import hull_of
from hplan.robot.model import Robot
from hplan.scene.limits import Vector
from hplan.scene.model import Fruit, Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Mesh, Obstacle, PointCloud, Sphere

#: What a scene may hold.
Kind: TypeAlias = Literal["sphere", "capsule", "box", "mesh", "points", "fruits"]
KINDS: Final[tuple[Kind, ...]] = ("sphere", "capsule", "box", "mesh", "points", "fruits")

#: Obstacles of a scene at most; fruits come in clusters.
_MOST, _MOST_FRUITS = 4, 20

#: Half of a scene's sector of yaw.
_SECTOR: Final = math.radians(25.0)

#: How far an obstacle stays off the shoulder, where all configurations would collide [m]; so many places are tried.
_OFF_SHOULDER, _TRIES = 0.15, 20

#: Half of the scenes keep a clearance of up to this [m].
_CLEARANCE: Final = 0.03

#: Share of meshes that are convex, and shapes of those that are not.
_CONVEX: Final = 0.4
_STOCK: Final = 24


@dataclass(frozen=True)
class RandomScene:
    """A scene, and the yaws at which the arm meets its obstacles.

    Attributes:
        scene: The obstacles and the clearance to keep; start and goal are in the middle of the joint range.
        sector: First and last yaw.
    """

    scene: Scene
    sector: tuple[float, float]


def random_scene(robot: Robot, kind: Kind, number: int, *, seed: int = 0) -> RandomScene:
    """The scene of a kind with a number.

    Args:
        robot: The arm that is to meet the obstacles.
        number: Which of the scenes of this kind.
    """
    if kind not in KINDS:
        raise OptionError("kind", kind, f"one of {', '.join(KINDS)}")
    for name, value in (("number", number), ("seed", seed)):
        if value < 0:
            raise OptionError(name, value, "a whole number >= 0")
    rng = np.random.default_rng([seed, KINDS.index(kind), number])
    low, high = (robot.lower[0], robot.upper[0]) if robot.has_yaw else (0.0, 0.0)
    middle = rng.uniform(low, high)
    sector = (max(low, middle - _SECTOR), min(high, middle + _SECTOR)) if robot.has_yaw else (0.0, 0.0)
    rest = tuple((0.5 * (robot.lower + robot.upper)).tolist())
    obstacles: tuple[Obstacle, ...] = ()
    fruits: tuple[Fruit, ...] = ()
    if kind == "fruits":
        fruits = _cluster(robot, rng, sector)
    else:
        make = _MAKERS[kind]
        obstacles = tuple(
            make(f"{kind} {index}", rng, lambda size: _spot(robot, rng, sector, size))
            for index in range(int(rng.integers(1, _MOST + 1)))
        )
    scene = Scene(
        name=f"{kind} {number}",
        start=Start(joints_rad=rest),
        goal=Goal(joints_rad=rest),
        clearance=float(rng.uniform(0.0, _CLEARANCE)) if rng.random() < 0.5 else 0.0,
        obstacles=obstacles,
        fruits=fruits,
    )
    return RandomScene(scene, sector)


def _spot(robot: Robot, rng: np.random.Generator, sector: tuple[float, float], size: float) -> Vector:
    """A place about as far from some link's axis as something of this radius touches it, and off the shoulder."""
    place = np.zeros(3)
    # How far an obstacle's middle may be from the link's axis that it is put at, besides its own size [m].
    around = 0.05
    for _ in range(_TRIES):
        points = robot.arm.joint_points(rng.uniform(robot.arm.lower, robot.arm.upper))
        link = int(rng.integers(robot.arm.link_count))
        on_axis = points[link] + rng.random() * (points[link + 1] - points[link])
        origin, axes = robot.plane_at(float(rng.uniform(*sector)))
        place = origin + on_axis @ axes[:2] + direction(rng) * rng.random() * (size + around)
        if np.linalg.norm(place - origin) >= size + _OFF_SHOULDER:
            break
    return vector(place)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is spread evenly."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _turn(rng: np.random.Generator) -> Vector:
    return vector(rng.uniform(-180.0, 180.0, 3))


_Place: TypeAlias = Callable[[float], Vector]


def _sphere(name: str, rng: np.random.Generator, place: _Place) -> Sphere:
    radius = _between(rng, 0.01, 0.25)
    return Sphere(name=name, center=place(radius), radius=radius)


def _capsule(name: str, rng: np.random.Generator, place: _Place) -> Capsule:
    radius = _between(rng, 0.003, 0.1)
    middle = np.array(place(radius))
    half = 0.5 * _between(rng, 0.05, 2.0) * direction(rng)
    shift = rng.uniform(-1.0, 1.0) * half
    ends = {"from": vector(middle + shift - half), "to": vector(middle + shift + half)}
    return Capsule.model_validate({"name": name, "radius": radius, **ends})


def _box(name: str, rng: np.random.Generator, place: _Place) -> Box:
    size = (_between(rng, 0.01, 0.8), _between(rng, 0.01, 0.8), _between(rng, 0.01, 0.8))
    return Box(name=name, center=place(0.5 * max(size)), size=size, rpy_deg=_turn(rng))


def _mesh(name: str, rng: np.random.Generator, place: _Place) -> Mesh:
    convex = rng.random() < _CONVEX
    mesh = Mesh.of(name, *_convex_surface(rng)) if convex else stock(int(rng.integers(_STOCK)))
    size = 0.5 * float(np.ptp(mesh.surface[0], axis=0).max())
    return mesh.with_(name=name, position=place(size), rpy_deg=_turn(rng))


def _points(name: str, rng: np.random.Generator, place: _Place) -> PointCloud:
    count, size = int(_between(rng, 30.0, 3000.0)), _between(rng, 0.02, 0.4)
    directions = rng.normal(size=(count, 3)) * rng.uniform(0.1, 1.0, 3)
    if rng.random() < 0.5:  # a scan sees surfaces
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = size * np.clip(0.5 * directions, -1.0, 1.0)
    radius = _between(rng, 0.004, 0.03)
    return PointCloud.of(name, points, radius, position=place(size + radius), rpy_deg=_turn(rng))


_MAKERS: Final[dict[Kind, Callable[[str, np.random.Generator, _Place], Obstacle]]] = {
    "sphere": _sphere,
    "capsule": _capsule,
    "box": _box,
    "mesh": _mesh,
    "points": _points,
}


def _cluster(robot: Robot, rng: np.random.Generator, sector: tuple[float, float]) -> tuple[Fruit, ...]:
    """Fruit about one place, here and there two in each other."""
    middle = np.array(_spot(robot, rng, sector, 0.1))
    spread = _between(rng, 0.05, 0.4)
    fruits = []
    for index in range(int(rng.integers(1, _MOST_FRUITS + 1))):
        center = vector(middle + spread * rng.normal(size=3))
        fruits.append(Fruit(name=f"fruit {index}", center=center, radius=rng.uniform(0.02, 0.06)))
    return tuple(fruits)


@functools.cache
def stock(number: int) -> Mesh:
    """A mesh that is not convex: a bucket, a ring or pipe, a notched plate or block."""
    rng = np.random.default_rng([_STOCK, number])
    surface = (_bucket, _ring, _notched)[number % 3](rng)
    return Mesh.of("shape", *surface)


def _convex_surface(rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """The hull of points about an ellipsoid: from a tetrahedron to something round."""
    count = int(_between(rng, 4.0, 400.0))
    points = rng.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points *= rng.uniform(0.8, 1.0, (count, 1)) * [_between(rng, 0.02, 0.3) for _ in range(3)]
    hull = hull_of(points, most=count)
    return hull.core, hull.faces


def _bucket(rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """Open above, its wall leaning outwards."""
    foot, height, wall = rng.uniform(0.08, 0.2), rng.uniform(0.1, 0.35), rng.uniform(0.005, 0.02)
    rim = foot * rng.uniform(1.0, 1.4)
    profile = [(0.0, 0.0), (foot, 0.0), (rim, height), (rim - wall, height), (foot - wall, wall), (0.0, wall)]
    return _revolved(np.array(profile), int(rng.integers(4, 24)))


def _ring(rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """A ring of any convex cross-section, flat or long as a pipe."""
    radius, sides = rng.uniform(0.12, 0.3), int(rng.integers(3, 9))
    angles = 2.0 * np.pi * (np.arange(sides) + rng.random()) / sides
    across, along = rng.uniform(0.01, 0.09), _between(rng, 0.01, 0.3)
    profile = np.column_stack([radius + across * np.cos(angles), along * np.sin(angles)])
    return _revolved(profile, int(rng.integers(5, 20)))


def _revolved(profile: FloatArray, count: int) -> tuple[FloatArray, IntArray]:
    """A closed profile of (distance from the axis, height), counter-clockwise, turned about the axis."""
    angles = 2.0 * np.pi * np.arange(count) / count
    radius, height = profile[:, 0], profile[:, 1]
    vertices = np.stack(
        [np.outer(np.cos(angles), radius), np.outer(np.sin(angles), radius), np.tile(height, (count, 1))], axis=-1
    )
    i, j = np.meshgrid(np.arange(count), np.arange(len(profile)), indexing="ij")
    a, b = i * len(profile) + j, (i + 1) % count * len(profile) + j
    c, d = (i + 1) % count * len(profile) + (j + 1) % len(profile), i * len(profile) + (j + 1) % len(profile)
    faces = np.concatenate([np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)])
    return vertices.reshape(-1, 3) + 0.0, faces


def _notched(rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """A prism on a polygon whose corners stand now far, now near."""
    corners = int(rng.integers(5, 10))
    angles = 2.0 * np.pi * (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) / corners
    radii = rng.uniform(0.06, 0.3, corners)
    radii[::2] *= rng.uniform(0.3, 1.0)
    outline = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    half = 0.5 * _between(rng, 0.01, 0.4)
    # The middle of either end, then the outline below and above.
    vertices = np.array([[0.0, 0.0, -half], [0.0, 0.0, half], *((x, y, z) for z in (-half, half) for x, y in outline)])
    j = np.arange(corners)
    below, above, next_below = 2 + j, 2 + corners + j, 2 + (j + 1) % corners
    next_above, none = next_below + corners, np.zeros(corners, dtype=np.int64)
    faces = [
        (none, next_below, below), (none + 1, above, next_above),
        (below, next_below, next_above), (below, next_above, above),
    ]  # fmt: skip
    return vertices, np.concatenate([np.column_stack(part) for part in faces])
