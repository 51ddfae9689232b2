"""What stands about an arm by chance: known obstacles, fruit, what a camera sees, and how all of it moves.

A world is numbers alone, as scenes list them. `World.scene` is what hplan is told, `World.things` what is there. Of
what is seen hplan is told points in the camera's frame, and the judge the same points in the world's.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from pydantic import TypeAdapter
from scipy.spatial import ConvexHull
from studies.validation.arms import DrawnArm
from studies.validation.judge import Moves, Thing, things_of
from studies.validation.random_scenes import direction
from studies.validation.scenes import stock

from hplan.base.arrays import FloatArray
from hplan.scene.model import Scene
from hplan.scene.obstacles import Mesh, Obstacle, PointCloud
from hplan.scene.tracks import Sway, Track

_MODEL: TypeAdapter[Obstacle] = TypeAdapter(Obstacle)

#: An obstacle as scenes list it, with a mesh's or cloud's data in place of its file.
Item: TypeAlias = dict[str, Any]

#: Kinds of obstacles.
KINDS = ("sphere", "capsule", "cylinder", "box", "mesh", "points")

#: Name of what a camera sees; radius of the balls about its points [m].
SEEN, BALL_M = "seen", 0.012

#: Obstacles stay so far from start and goal [m]: known ones, and what is seen, from the boxes about bodies: a filter
#: takes what is near for the arm itself.
ROOM_M, ROOM_OF_SEEN_M = 0.01, 0.1

#: Tries to find what is asked for.
_TRIES = 60


@dataclass(frozen=True)
class World:
    """What stands about the arm, and the task.

    Attributes:
        start: (dof,) configuration.
        goal: (dof,) configuration.
        items: Known obstacles.
        fruits: Fruit, as spheres.
        target: Name of the fruit to be picked; None for the configuration.
        base: Track of the base.
        begin_s: When the first motion begins, on the clock of the tracks [s].
        clearance: Distance to keep [m].
        seen: (n, 3) points that a camera sees, where the base is without a shift; None without a camera [m].
    """

    start: FloatArray
    goal: FloatArray
    items: tuple[Item, ...] = ()
    fruits: tuple[Item, ...] = ()
    target: str | None = None
    base: Item | None = None
    begin_s: float = 0.0
    clearance: float = 0.0
    seen: FloatArray | None = field(default=None, repr=False)

    @property
    def moves(self) -> Moves | None:
        """How the base moves."""
        return None if self.base is None else Moves(self.base)

    @property
    def things(self) -> list[Thing]:
        """All that is there."""
        found = things_of([*self.items, *self.fruits])
        if self.seen is not None and len(self.seen):
            found.append(Thing({"name": SEEN, "kind": "points", "points": self.seen, "radius": BALL_M}))
        return found

    def balls_at(self, time_s: float) -> list[Item]:
        """Fruit and known balls, where they are at a time: what a camera may be told to ignore."""
        found = [item for item in (*self.items, *self.fruits) if item["kind"] == "sphere" and "sway" not in item]
        for k, item in enumerate(found):
            if "track" in item:
                pose = Moves(item["track"]).at(np.array([time_s]))[0]
                found[k] = {**item, "center": (pose[:3, :3] @ item["center"] + pose[:3, 3]).tolist()}
        return found

    def scene(self) -> Scene:
        """What hplan is told, but for what is seen."""
        goal = {"joints_rad": self.goal.tolist()} if self.target is None else {"fruit": self.target}
        fruits = [{key: value for key, value in item.items() if key != "kind"} for item in self.fruits]
        task = {"name": "drawn", "start": {"joints_rad": self.start.tolist()}, "goal": goal, "fruits": fruits}
        scene = Scene.model_validate_json(json.dumps({**task, "base_track": self.base, "clearance": self.clearance}))
        return scene.with_(obstacles=tuple(obstacle(item) for item in self.items))


def bad_frame(
    rng: np.random.Generator, points: FloatArray, own: FloatArray, pose: FloatArray, time_s: float
) -> dict[str, Any]:
    """What is wrong with a frame, as arguments of `set_cloud`: a failing camera, a wrong unit or pose, an old stamp.

    Args:
        rng: Source of random numbers.
        points: (n, 3) points of a good frame, in the camera's frame [m].
        own: (k, 3) points of the arm, in the camera's frame [m].
        pose: (4, 4) camera to `base_link`.
        time_s: Time stamp of the good frame [s].
    """
    nothing = float(rng.choice([0.0, np.nan, np.inf, -np.inf]))
    lost = np.where(rng.random((len(points), 1)) < rng.uniform(0.6, 1.0), nothing, points)
    skewed, far, turned = pose.copy(), pose.copy(), pose.copy()
    skewed[:3, :3] *= rng.uniform(1.01, 2.0)
    far[:3, 3] = 1e3 * pose[:3, 3] + 1e3
    turned[:3, 3] += 30.0 * direction(rng)
    rays = points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-9)
    faults: tuple[dict[str, Any], ...] = (
        {"points": np.full_like(points, nothing)},
        {"points": lost},
        {"points": points[:0]},
        {"points": 1e3 * points},
        {"points": np.rint(1e3 * points).astype(np.int32)},
        {"points": rng.choice([20.0, 65.535, 1e30]) * rays},
        {"points": own},
        {"points": points[:, :2]},
        {"points": points.astype(str)},
        {"pose": skewed},
        {"pose": far},
        {"pose": turned},
        {"time_s": time_s - rng.uniform(1e-3, 10.0)},
        {"points": points[:0], "time_s": time_s - rng.uniform(1e-3, 10.0)},
        {"time_s": None},
    )
    return faults[int(rng.integers(len(faults)))]


def obstacle(item: Item) -> Any:
    """An obstacle as hplan has it."""
    placed: Item = {key: item[key] for key in ("radius", "position", "rpy_deg", "track", "sway") if key in item}
    placed |= {key: model(**placed[key]) for key, model in (("track", Track), ("sway", Sway)) if key in placed}
    placed |= {key: tuple(placed[key]) for key in ("position", "rpy_deg") if key in placed}
    if "stock" in item:  # cut into convex pieces once
        return stock(item["stock"]).with_(name=item["name"], **placed)
    if item["kind"] == "mesh":
        return Mesh.of(item["name"], item["vertices"], item["faces"], **placed)
    if item["kind"] == "points":
        radius = placed.pop("radius")
        return PointCloud.of(item["name"], item["points"], radius, **placed)
    return _MODEL.validate_json(json.dumps(item))


def draw_world(drawn: DrawnArm, rng: np.random.Generator, *, moving: bool, camera: bool) -> World | None:
    """A world in which start and goal are free; None where the arm touches itself nearly everywhere.

    Args:
        camera: Whether something is seen by a camera.
    """
    clearance = float(rng.choice([0.0, 0.005, 0.02], p=[0.5, 0.3, 0.2]))
    ends = draw_ends(drawn, rng, clearance)
    if ends is None:
        return None
    world = World(*ends, clearance=clearance, begin_s=float(rng.choice([0.0, rng.uniform(-5.0, 50.0)])))
    if moving and rng.random() < 0.5:
        world = replace(world, base=draw_track(rng, world.begin_s, rng.uniform(-0.3, 0.3, 3).tolist(), 20.0))
    items = [draw_item(drawn, world, rng, f"o{k}") for k in range(int(rng.integers(2, 9)))]
    if moving:
        for k in range(len(items)):
            if rng.random() < (0.6 if world.base is None else 0.3) or (k == 0 and world.base is None):
                items[k] = {**items[k], "track": draw_track(rng, world.begin_s, middle_of(items[k]), 60.0)}
    for k, item in enumerate(items):
        if "track" not in item and rng.random() < 0.15:
            sway = {"direction": tuple(direction(rng).tolist()), "amplitude_m": float(rng.uniform(0.005, 0.05))}
            items[k] = {**item, "sway": sway}
    world = replace(world, items=tuple(free(drawn, world, items)))
    if drawn.arm.last_joint and world.base is None and rng.random() < 0.35:
        world = _with_fruits(drawn, world, rng)
    return replace(world, seen=draw_seen(drawn, world, rng)) if camera else world


def draw_ends(drawn: DrawnArm, rng: np.random.Generator, clearance: float) -> tuple[FloatArray, FloatArray] | None:
    """Start and goal at which the arm does not touch itself."""
    arm, robot = drawn.arm, drawn.robot
    room_m = 0.015 + clearance
    for start in arm.drawn(rng, _TRIES):
        span = (robot.upper - robot.lower) * rng.uniform(0.1, 0.5)
        goal = np.clip(start + rng.uniform(-1.0, 1.0, robot.dof) * span, robot.lower, robot.upper)
        if arm.has_room(start, room_m) and arm.has_room(goal, room_m):
            return start, goal
    return None


def draw_item(drawn: DrawnArm, world: World, rng: np.random.Generator, name: str) -> Item:
    """An obstacle about where the arm passes."""
    kind = KINDS[int(rng.integers(len(KINDS)))]
    size = float(np.exp(rng.uniform(np.log(0.015), np.log(0.15))))
    at = _passed(drawn, world, rng) + direction(rng) * (size + float(rng.uniform(0.0, 0.3)))
    item: Item = {"name": name, "kind": kind}
    turn = rng.uniform(-180.0, 180.0, 3).tolist()
    if kind == "sphere":
        return {**item, "center": at.tolist(), "radius": size}
    if kind == "capsule":
        half = direction(rng) * rng.uniform(0.05, 0.5)
        return {**item, "from": (at - half).tolist(), "to": (at + half).tolist(), "radius": 0.3 * size}
    if kind == "cylinder":
        length = float(rng.uniform(0.05, 0.6))
        return {**item, "center": at.tolist(), "length": length, "radius": 0.5 * size, "rpy_deg": turn}
    if kind == "box":
        return {**item, "center": at.tolist(), "size": (rng.uniform(0.4, 3.0, 3) * size).tolist(), "rpy_deg": turn}
    if kind == "mesh":
        if rng.random() < 0.3:
            item["stock"] = int(rng.integers(6))
            vertices, faces = stock(item["stock"]).surface
        else:
            hull = ConvexHull(rng.normal(size=(int(rng.integers(6, 40)), 3)) * rng.uniform(0.5, 1.5, 3) * size)
            vertices, faces = _outward(hull)
        return {**item, "vertices": vertices, "faces": faces, "position": at.tolist(), "rpy_deg": turn}
    points = surface(rng, {"kind": "sphere", "center": [0.0] * 3, "radius": size}, 0.02)
    return {**item, "points": points, "radius": BALL_M, "position": at.tolist(), "rpy_deg": turn}


def _outward(hull: ConvexHull) -> tuple[FloatArray, Any]:
    """(n, 3) corners of a hull and its triangles, counter-clockwise from outside."""
    number = {old: new for new, old in enumerate(hull.vertices)}
    faces = []
    for simplex, plane in zip(hull.simplices, hull.equations, strict=True):
        a, b, c = hull.points[simplex]
        turned = simplex if np.cross(b - a, c - a) @ plane[:3] > 0.0 else simplex[::-1]
        faces.append([number[each] for each in turned])
    return hull.points[hull.vertices], np.array(faces)


def _passed(drawn: DrawnArm, world: World, rng: np.random.Generator) -> FloatArray:
    """A place where some body is on the straight way from start to goal."""
    q = world.start + rng.random() * (world.goal - world.start)
    places = drawn.arm.places(drawn.arm.configurations(drawn.arm.joints, q[None])[0])
    moving = [k for k, body in enumerate(drawn.arm.bodies) if body.joint > 0]
    k = moving[int(rng.integers(len(moving)))]
    place: FloatArray = places[k].act(drawn.arm.bodies[k].middle)
    return place


def middle_of(item: Item) -> list[float]:
    """The middle of an obstacle."""
    if item["kind"] == "capsule":
        return [0.5 * (a + b) for a, b in zip(item["from"], item["to"], strict=True)]
    return list(item["center"] if "center" in item else item["position"])


def draw_track(rng: np.random.Generator, begin_s: float, about: list[float], turn_deg: float) -> Item:
    """Somewhere else in a second or a few, and perhaps on from there."""
    count = int(rng.integers(2, 5))
    times = begin_s + np.cumsum(rng.uniform(0.2, 2.0, count)) - rng.uniform(0.0, 1.0)
    shifts = np.cumsum(rng.uniform(-0.2, 0.2, (count, 3)), axis=0)
    track: Item = {"times_s": tuple(times.tolist()), "shifts_m": tuple(map(tuple, shifts.tolist()))}
    if rng.random() < 0.5:
        turns = rng.uniform(-turn_deg, turn_deg, (count, 3)) * rng.choice([0.1, 1.0], 3)
        track |= {"rpy_deg": tuple(map(tuple, turns.tolist())), "about": tuple(about)}
    return track


def free(
    drawn: DrawnArm, world: World, items: list[Item], q: FloatArray | None = None, time_s: float | None = None
) -> list[Item]:
    """Those that leave the arm free where it stands; at start and goal at the beginning, unless that is told."""
    time_s = world.begin_s if time_s is None else time_s
    for at in (world.start, world.goal) if q is None else (q,):
        near: dict[str, float] = {}
        found = things_of(items)
        for thing, gap in zip(found, drawn.arm.clearances(at, found, world.moves, time_s), strict=True):
            near[thing.name] = min(gap, near.get(thing.name, np.inf))
        items = [item for item in items if near[item["name"]] > ROOM_M + world.clearance]
    return items


def _with_fruits(drawn: DrawnArm, world: World, rng: np.random.Generator) -> World:
    """Fruit, one of it where the tool is at the goal."""
    centre = drawn.robot.tool_positions(world.goal)
    at = [centre, *(centre + direction(rng) * rng.uniform(0.1, 0.5) for _ in range(int(rng.integers(3))))]
    fruits = [
        {"name": f"fruit {k}", "kind": "sphere", "center": place.tolist(), "radius": float(rng.uniform(0.025, 0.045))}
        for k, place in enumerate(at)
    ]
    gaps = drawn.arm.clearances(world.start, things_of(fruits), None, 0.0)
    if gaps[0] <= 0.05:
        return world
    far = tuple(fruit for fruit, gap in zip(fruits, gaps, strict=True) if gap > 0.02)
    return replace(world, fruits=far, target="fruit 0")


def draw_seen(
    drawn: DrawnArm, world: World, rng: np.random.Generator, q: FloatArray | None = None, time_s: float | None = None
) -> FloatArray:
    """(n, 3) points on surfaces about where the arm passes, none near the arm or near what may be ignored.

    Args:
        q: (dof,) where the arm is; None for its start.
        time_s: When it is there; None for when the first motion begins.
    """
    parts = [surface(rng, _simple(draw_item(drawn, world, rng, "seen")), 0.02) for _ in range(int(rng.integers(1, 6)))]
    points = np.concatenate(parts)
    points = points[drawn.arm.beside(world.start if q is None else q, points) > ROOM_OF_SEEN_M]
    if q is None:
        points = points[drawn.arm.beside(world.goal, points) > BALL_M + ROOM_M + world.clearance]
    time_s = world.begin_s if time_s is None else time_s
    if world.moves is not None:  # from where the base is to where it has no shift
        pose = world.moves.at(np.array([time_s]))[0]
        points = points @ pose[:3, :3].T + pose[:3, 3]
    # Points stay so far from what may be ignored [m].
    beside_ignored_m = 0.035
    for ball in world.balls_at(time_s):
        points = points[np.linalg.norm(points - ball["center"], axis=1) > ball["radius"] + beside_ignored_m]
    return points


def seen_from_base(world: World, points: FloatArray, time_s: float) -> FloatArray:
    """(n, 3) points as seen from the base at a time."""
    if world.moves is None:
        return points
    pose = world.moves.at(np.array([time_s]))[0]
    seen: FloatArray = (points - pose[:3, 3]) @ pose[:3, :3]
    return seen


def camera_pose(rng: np.random.Generator, far_m: float) -> FloatArray:
    """(4, 4) of a camera somewhere, turned in any way."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, rng.uniform(-far_m, far_m, 3)
    return pose


def _simple(item: Item) -> Item:
    """Something whose surface is drawn from easily: a sphere, a box or a capsule, about as large."""
    if item["kind"] in ("sphere", "box", "capsule"):
        return item
    return {"kind": "sphere", "center": middle_of(item), "radius": 0.08}


def surface(rng: np.random.Generator, item: Item, apart_m: float) -> FloatArray:
    """(n, 3) points on a sphere, a box or a capsule, about so far apart [m]."""
    points: FloatArray
    if item["kind"] == "box":
        size = np.array(item["size"])
        area = 2.0 * (size[0] * size[1] + size[1] * size[2] + size[2] * size[0])
        points = rng.uniform(-0.5, 0.5, (max(24, int(area / apart_m**2)), 3))
        points[np.arange(len(points)), rng.integers(3, size=len(points))] = 0.5
        points *= rng.choice([-1.0, 1.0], (len(points), 1)) * size
        points = points @ pin.rpy.rpyToMatrix(*np.radians(item["rpy_deg"])).T + item["center"]
        return points
    start, end = (np.array(item.get(key, item.get("center"))) for key in ("from", "to"))
    area = 2.0 * np.pi * item["radius"] * (2.0 * item["radius"] + float(np.linalg.norm(end - start)))
    rays = rng.normal(size=(max(12, int(area / apart_m**2)), 3))
    rays *= item["radius"] / np.linalg.norm(rays, axis=1, keepdims=True)
    points = start + rng.random((len(rays), 1)) * (end - start) + rays
    return points
