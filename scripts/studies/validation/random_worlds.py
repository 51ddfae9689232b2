"""Random obstacles, fruit and camera points around an arm, and their motion.

A world consists of numbers, as scenes list them. `World.scene` is the scene that hplan plans in, `World.obstacles` the
one that the judge checks. Camera points reach hplan in the camera's frame, and the judge in the world's.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
import trimesh
from pydantic import TypeAdapter
from studies.validation.judge import JudgedObstacle, PoseTrack, read_obstacles
from studies.validation.random_arms import DrawnArm

from hplan.base.arrays import FloatArray
from hplan.scene.model import Scene
from hplan.scene.obstacles import Mesh, Obstacle, PointCloud
from hplan.scene.tracks import Sway, Track

_MODEL: TypeAdapter[Obstacle] = TypeAdapter(Obstacle)

#: An obstacle as scenes list it, with the data of a mesh or cloud instead of its file.
Item: TypeAlias = dict[str, Any]

#: Kinds of obstacles, and the range of their sizes [m].
KINDS, SIZES_M = ("sphere", "capsule", "cylinder", "box", "mesh", "points"), (0.01, 0.2)

#: Name of the camera's cloud; radius of the balls around its points [m].
SEEN, BALL_M = "seen", 0.012

#: Minimum distance of start and goal from known obstacles, and of the boxes around bodies from camera points, which the
#: filter would otherwise take for the arm [m].
CLEAR_M, CLEAR_OF_SEEN_M = 0.01, 0.1

#: Number of prepared meshes that are not convex (cutting one into convex pieces takes seconds), and their share.
_STOCK, _NOT_CONVEX = 8, 0.4

#: Number of attempts to draw free configurations.
_TRIES = 60


@dataclass(frozen=True)
class World:
    """The surroundings of an arm, and its task.

    Attributes:
        start: (dof,) configuration.
        goal: (dof,) configuration.
        items: Known obstacles.
        fruits: Fruit, as spheres.
        target: Name of the fruit to pick; None for the goal configuration.
        base: Track of the base.
        start_time_s: Start of the first motion, on the clock of the tracks [s].
        clearance: Distance to keep [m].
        seen: (n, 3) camera points in the frame of the base before it moves; None without a camera [m].
    """

    start: FloatArray
    goal: FloatArray
    items: tuple[Item, ...] = ()
    fruits: tuple[Item, ...] = ()
    target: str | None = None
    base: Item | None = None
    start_time_s: float = 0.0
    clearance: float = 0.0
    seen: FloatArray | None = field(default=None, repr=False)

    @property
    def base_track(self) -> PoseTrack | None:
        """Motion of the base."""
        return None if self.base is None else PoseTrack(self.base)

    @property
    def obstacles(self) -> list[JudgedObstacle]:
        """All obstacles, fruit and camera points, for the judge."""
        found = read_obstacles([*self.items, *self.fruits])
        if self.seen is not None and len(self.seen):
            found.append(JudgedObstacle({"name": SEEN, "kind": "points", "points": self.seen, "radius": BALL_M}))
        return found

    def balls_at(self, time_s: float) -> list[Item]:
        """Fruit and known spheres at a time; the camera may ignore them."""
        found = [item for item in (*self.items, *self.fruits) if item["kind"] == "sphere" and "sway" not in item]
        for k, item in enumerate(found):
            if "track" in item:
                pose = PoseTrack(item["track"]).at(np.array([time_s]))[0]
                found[k] = {**item, "center": (pose[:3, :3] @ item["center"] + pose[:3, 3]).tolist()}
        return found

    def scene(self) -> Scene:
        """The scene for hplan, without the camera points."""
        goal = {"joints_rad": self.goal.tolist()} if self.target is None else {"fruit": self.target}
        fruits = [{key: value for key, value in item.items() if key != "kind"} for item in self.fruits]
        task = {"name": "drawn", "start": {"joints_rad": self.start.tolist()}, "goal": goal, "fruits": fruits}
        scene = Scene.model_validate_json(json.dumps({**task, "base_track": self.base, "clearance": self.clearance}))
        return scene.with_values(obstacles=tuple(map(obstacle_of, self.items)))

    def from_base(self, points: FloatArray, time_s: float) -> FloatArray:
        """(n, 3) points in the frame of the base at a time."""
        if self.base_track is None:
            return points
        pose = self.base_track.at(np.array([time_s]))[0]
        local: FloatArray = (points - pose[:3, 3]) @ pose[:3, :3]
        return local


def direction(rng: np.random.Generator) -> FloatArray:
    """(3,) unit vector, uniformly distributed."""
    drawn = rng.normal(size=3)
    unit: FloatArray = drawn / np.linalg.norm(drawn)
    return unit


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniformly distributed."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def obstacle_of(item: Item) -> Any:
    """Hplan's obstacle."""
    placed: Item = {key: item[key] for key in ("radius", "position", "rpy_deg", "track", "sway") if key in item}
    placed |= {key: model(**placed[key]) for key, model in (("track", Track), ("sway", Sway)) if key in placed}
    placed |= {key: tuple(placed[key]) for key in ("position", "rpy_deg") if key in placed}
    if "stock" in item:  # cut into convex pieces once
        return stock(item["stock"]).with_values(name=item["name"], **placed)
    if item["kind"] == "mesh":
        return Mesh.from_arrays(item["name"], item["vertices"], item["faces"], **placed)
    if item["kind"] == "points":
        return PointCloud.from_points(item["name"], item["points"], placed.pop("radius"), **placed)
    return _MODEL.validate_json(json.dumps(item))


def draw_obstacle(
    rng: np.random.Generator, name: str, kind: str, place: Callable[[float], FloatArray],
    sizes_m: tuple[float, float] = SIZES_M,
) -> Item:  # fmt: skip
    """An obstacle of a kind and a random size; `place` maps the size to a position [m]."""
    size = log_uniform(rng, *sizes_m)
    item: Item = {"name": name, "kind": kind}
    turn = rng.uniform(-180.0, 180.0, 3).tolist()
    if kind == "sphere":
        return {**item, "center": place(size).tolist(), "radius": size}
    if kind == "capsule":
        half, radius = direction(rng) * log_uniform(rng, 0.025, 1.0), 0.3 * size
        middle = place(radius) + rng.uniform(-1.0, 1.0) * half
        return {**item, "from": (middle - half).tolist(), "to": (middle + half).tolist(), "radius": radius}
    if kind == "cylinder":
        length = float(rng.uniform(0.05, 0.6))
        return {**item, "center": place(size).tolist(), "length": length, "radius": 0.5 * size, "rpy_deg": turn}
    if kind == "box":
        sides = [log_uniform(rng, 0.4, 3.0) * size for _ in range(3)]
        return {**item, "center": place(0.5 * max(sides)).tolist(), "size": sides, "rpy_deg": turn}
    if kind == "mesh":
        if rng.random() < _NOT_CONVEX:
            item["stock"] = int(rng.integers(_STOCK))
            vertices, faces = stock(item["stock"]).surface
        else:
            points = rng.normal(size=(int(log_uniform(rng, 4.0, 200.0)), 3)) * rng.uniform(0.3, 1.5, 3) * size
            hull = trimesh.convex.convex_hull(points)
            vertices, faces = np.array(hull.vertices), np.array(hull.faces)
        at = place(0.5 * float(np.ptp(vertices, axis=0).max()))
        return {**item, "vertices": vertices, "faces": faces, "position": at.tolist(), "rpy_deg": turn}
    if kind == "points":
        points = rng.normal(size=(int(log_uniform(rng, 30.0, 2000.0)), 3)) * rng.uniform(0.2, 1.0, 3)
        if rng.random() < 0.5:  # a scan contains surfaces only
            points /= np.linalg.norm(points, axis=1, keepdims=True)
        points = size * np.clip(points, -2.0, 2.0)
        return {**item, "points": points, "radius": BALL_M, "position": place(size).tolist(), "rpy_deg": turn}
    raise ValueError(f"unknown kind of obstacle: {kind}")


@functools.cache
def stock(number: int) -> Mesh:
    """A mesh that is not convex: a bucket, a ring or pipe, or a notched plate or block."""
    rng = np.random.default_rng([_STOCK, number])
    if number % 3 == 2:
        return Mesh.from_arrays("shape", *_notched(rng))
    if number % 3 == 0:
        foot, height, wall = rng.uniform(0.08, 0.2), rng.uniform(0.1, 0.35), rng.uniform(0.005, 0.02)
        rim = foot * rng.uniform(1.0, 1.4)
        profile = [(0.0, 0.0), (foot, 0.0), (rim, height), (rim - wall, height), (foot - wall, wall), (0.0, wall)]
    else:
        radius, sides = rng.uniform(0.12, 0.3), int(rng.integers(3, 9))
        angles = 2.0 * np.pi * (np.arange(sides) + rng.random()) / sides
        across, along = rng.uniform(0.01, 0.09), log_uniform(rng, 0.01, 0.3)
        profile = list(zip(radius + across * np.cos(angles), along * np.sin(angles), strict=True))
        profile.append(profile[0])
    shape = trimesh.creation.revolve(np.array(profile), sections=int(rng.integers(4, 10)))
    return Mesh.from_arrays("shape", np.array(shape.vertices), np.array(shape.faces))


def _notched(rng: np.random.Generator) -> tuple[FloatArray, Any]:
    """Vertices and faces of a prism on a star-shaped polygon."""
    corners = int(rng.integers(5, 10))
    angles = 2.0 * np.pi * (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) / corners
    radii = rng.uniform(0.06, 0.3, corners)
    radii[::2] *= rng.uniform(0.3, 0.6)
    half = 0.5 * log_uniform(rng, 0.01, 0.4)
    outline = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(corners)])
    up = np.array([0.0, 0.0, half])
    # The centers of the lower and upper face, then the outline below and above.
    vertices = np.vstack([-up, up, outline - up, outline + up])
    j = np.arange(corners)
    low, next_low = 2 + j, 2 + (j + 1) % corners
    high, next_high, zero = low + corners, next_low + corners, 0 * j
    triangles = ((zero, next_low, low), (zero + 1, high, next_high), (low, next_low, next_high), (low, next_high, high))
    return vertices, np.concatenate([np.column_stack(corner) for corner in triangles])


def draw_world(drawn: DrawnArm, rng: np.random.Generator, *, moving: bool, camera: bool) -> World | None:
    """A world with free start and goal, or None if the arm is nearly always in self-collision."""
    clearance = float(rng.choice([0.0, 0.005, 0.02], p=[0.5, 0.3, 0.2]))
    ends = draw_ends(drawn, rng, clearance)
    if ends is None:
        return None
    world = World(*ends, clearance=clearance, start_time_s=float(rng.choice([0.0, rng.uniform(-5.0, 50.0)])))
    if moving and rng.random() < 0.5:
        world = replace(world, base=draw_track(rng, world.start_time_s, rng.uniform(-0.3, 0.3, 3).tolist(), 20.0))
    items = [draw_item(drawn, world, rng, f"o{k}") for k in range(int(rng.integers(2, 9)))]
    for k, item in enumerate(items):
        if moving and (rng.random() < (0.6 if world.base is None else 0.3) or (k == 0 and world.base is None)):
            items[k] = {**item, "track": draw_track(rng, world.start_time_s, middle_of(item), 60.0)}
        elif rng.random() < 0.15:
            sway = {"direction": tuple(direction(rng).tolist()), "amplitude_m": float(rng.uniform(0.005, 0.05))}
            items[k] = {**item, "sway": sway}
    world = replace(world, items=tuple(free(drawn, world, items)))
    if drawn.arm.last_joint and world.base is None and rng.random() < 0.35:
        world = _with_fruits(drawn, world, rng)
    return replace(world, seen=draw_seen(drawn, world, rng)) if camera else world


def draw_ends(drawn: DrawnArm, rng: np.random.Generator, clearance: float) -> tuple[FloatArray, FloatArray] | None:
    """Start and goal without self-collision, or None."""
    arm, robot = drawn.arm, drawn.robot
    least_m = 0.015 + clearance
    for start in arm.drawn(rng, _TRIES):
        span = (robot.upper - robot.lower) * rng.uniform(0.1, 0.5)
        goal = np.clip(start + rng.uniform(-1.0, 1.0, robot.dof) * span, robot.lower, robot.upper)
        if arm.is_clear_of_itself(start, least_m) and arm.is_clear_of_itself(goal, least_m):
            return start, goal
    return None


def draw_item(drawn: DrawnArm, world: World, rng: np.random.Generator, name: str) -> Item:
    """An obstacle near the straight path from start to goal."""
    q = world.start + rng.random() * (world.goal - world.start)
    places = drawn.arm.places(drawn.arm.configurations(drawn.arm.joints, q[None])[0])
    k = int(rng.choice([k for k, body in enumerate(drawn.arm.bodies) if body.joint > 0]))
    passed = places[k].act(drawn.arm.bodies[k].middle)

    def place(size: float) -> FloatArray:
        return np.asarray(passed + direction(rng) * (size + float(rng.uniform(0.0, 0.3))))

    return draw_obstacle(rng, name, str(rng.choice(KINDS)), place)


def middle_of(item: Item) -> list[float]:
    """Center of an obstacle."""
    if item["kind"] == "capsule":
        return [0.5 * (a + b) for a, b in zip(item["from"], item["to"], strict=True)]
    return list(item["center"] if "center" in item else item["position"])


def shifted(item: Item, shift: FloatArray) -> Item:
    """The obstacle at another position."""
    keys = ("from", "to") if item["kind"] == "capsule" else ("center",) if "center" in item else ("position",)
    return {**item, **{key: (np.array(item[key]) + shift).tolist() for key in keys}}


def draw_track(rng: np.random.Generator, start_time_s: float, about: list[float], turn_deg: float) -> Item:
    """A track with two to four poses, one every 0.2 to 2 s."""
    count = int(rng.integers(2, 5))
    times = start_time_s + np.cumsum(rng.uniform(0.2, 2.0, count)) - rng.uniform(0.0, 1.0)
    shifts = np.cumsum(rng.uniform(-0.2, 0.2, (count, 3)), axis=0)
    track: Item = {"times_s": tuple(times.tolist()), "shifts_m": tuple(map(tuple, shifts.tolist()))}
    if rng.random() < 0.5:
        turns = rng.uniform(-turn_deg, turn_deg, (count, 3)) * rng.choice([0.1, 1.0], 3)
        track |= {"rpy_deg": tuple(map(tuple, turns.tolist())), "about": tuple(about)}
    return track


def free(
    drawn: DrawnArm, world: World, items: Sequence[Item], q: FloatArray | None = None, time_s: float | None = None
) -> list[Item]:
    """Obstacles clear of the arm at `q`, or by default at start and goal when the first motion starts."""
    time_s, kept = world.start_time_s if time_s is None else time_s, list(items)
    for at in (world.start, world.goal) if q is None else (q,):
        near: dict[str, float] = {}
        found = read_obstacles(kept)
        for each, gap in zip(found, drawn.arm.clearances(at, found, world.base_track, time_s), strict=True):
            near[each.name] = min(gap, near.get(each.name, np.inf))
        kept = [item for item in kept if near[item["name"]] > CLEAR_M + world.clearance]
    return kept


def _with_fruits(drawn: DrawnArm, world: World, rng: np.random.Generator) -> World:
    """The world with fruit, one at the tool's position at the goal."""
    center = drawn.robot.tool_positions(world.goal)
    at = [center, *(center + direction(rng) * rng.uniform(0.1, 0.5) for _ in range(int(rng.integers(3))))]
    fruits = [
        {"name": f"fruit {k}", "kind": "sphere", "center": place.tolist(), "radius": float(rng.uniform(0.025, 0.045))}
        for k, place in enumerate(at)
    ]
    gaps = drawn.arm.clearances(world.start, read_obstacles(fruits), None, 0.0)
    if gaps[0] <= 0.05:
        return world
    far = tuple(fruit for fruit, gap in zip(fruits, gaps, strict=True) if gap > 0.02)
    return replace(world, fruits=far, target="fruit 0")


def draw_seen(
    drawn: DrawnArm, world: World, rng: np.random.Generator, q: FloatArray | None = None, time_s: float | None = None
) -> FloatArray:
    """(n, 3) points on surfaces near the path, away from the arm and from obstacles that the camera may ignore.

    Args:
        q: (dof,) configuration of the arm; None for its start.
        time_s: Time of the frame; None for the start of the first motion.
    """
    items = [draw_item(drawn, world, rng, "seen") for _ in range(int(rng.integers(1, 6)))]
    points = np.concatenate([surface(rng, item, 0.02) for item in items])
    points = points[drawn.arm.box_distances(world.start if q is None else q, points) > CLEAR_OF_SEEN_M]
    if q is None:
        points = points[drawn.arm.box_distances(world.goal, points) > BALL_M + CLEAR_M + world.clearance]
    time_s = world.start_time_s if time_s is None else time_s
    if world.base_track is not None:
        pose = world.base_track.at(np.array([time_s]))[0]
        points = points @ pose[:3, :3].T + pose[:3, 3]
    # Minimum distance of points from obstacles that may be ignored [m].
    apart_m = 0.035
    for ball in world.balls_at(time_s):
        points = points[np.linalg.norm(points - ball["center"], axis=1) > ball["radius"] + apart_m]
    return points


def camera_pose(rng: np.random.Generator, far_m: float) -> FloatArray:
    """(4, 4) random pose of a camera, with coordinates up to `far_m`."""
    pose = np.eye(4)
    pose[:3, :3] = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    pose[:3, 3] = rng.uniform(-far_m, far_m, 3)
    return pose


def surface(rng: np.random.Generator, item: Item, spacing_m: float) -> FloatArray:
    """(n, 3) points on a box or capsule, with about this spacing; other shapes count as a sphere [m]."""
    points: FloatArray
    if item["kind"] == "box":
        size = np.array(item["size"])
        area = 2.0 * (size[0] * size[1] + size[1] * size[2] + size[2] * size[0])
        points = rng.uniform(-0.5, 0.5, (max(24, int(area / spacing_m**2)), 3))
        points[np.arange(len(points)), rng.integers(3, size=len(points))] = 0.5
        points *= rng.choice([-1.0, 1.0], (len(points), 1)) * size
        points = points @ pin.rpy.rpyToMatrix(*np.radians(item["rpy_deg"])).T + item["center"]
        return points
    start, end = (np.array(item.get(key, middle_of(item))) for key in ("from", "to"))
    radius = item["radius"] if item["kind"] in ("sphere", "capsule") else 0.08
    area = 2.0 * np.pi * radius * (2.0 * radius + float(np.linalg.norm(end - start)))
    rays = rng.normal(size=(max(12, int(area / spacing_m**2)), 3))
    rays *= radius / np.linalg.norm(rays, axis=1, keepdims=True)
    points = start + rng.random((len(rays), 1)) * (end - start) + rays
    return points
