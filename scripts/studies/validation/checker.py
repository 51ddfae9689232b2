"""Contact of everything that a URDF describes, found by Pinocchio and coal alone.

Nothing of hplan's collision code is asked: bodies come from the URDF, obstacles from the numbers of the scene file, and
configurations from the rows of the CSV. Meshes stand for their convex hulls.
"""

from __future__ import annotations

import csv
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
import trimesh

from hplan.base.arrays import BoolArray, FloatArray

#: Time between two looks [s].
TICK_S = 1e-3

#: Random configurations at all of which a pair of bodies touches that is left out.
ALWAYS = 300

#: What does not move may stand in the ground, or carry something, by this much [m].
STANDS_M = 1e-3


@dataclass(frozen=True)
class FirstTouch:
    """The first contact of a pair in a motion.

    Attributes:
        time_s: When [s].
        first: A body of the robot.
        second: Another, or an obstacle.
        depth_m: How deep [m].
    """

    time_s: float
    first: str
    second: str
    depth_m: float


def read_rows(path: Path) -> tuple[list[str], FloatArray, FloatArray, FloatArray]:
    """Joint names, (rows,) time, (rows, dof) position and velocity of an exported CSV."""
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = list(csv.reader(file))
    table = np.array(rows, dtype=np.float64)
    columns = {name: number for number, name in enumerate(header)}
    names = [name.removesuffix("_pos_rad") for name in header if name.endswith("_pos_rad")]
    position = table[:, [columns[f"{name}_pos_rad"] for name in names]]
    velocity = table[:, [columns[f"{name}_vel_rad_s"] for name in names]]
    return names, table[:, columns["time_s"]], position, velocity


def between_rows(time: FloatArray, position: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m,) times every `TICK_S` and (m, dof) configurations, by cubic Hermite polynomials; rows are among them."""
    ticks = np.unique(np.concatenate([np.arange(0.0, time[-1], TICK_S), time]))
    if len(time) == 1:
        return time, position
    row = np.clip(np.searchsorted(time, ticks, side="right") - 1, 0, len(time) - 2)
    width = (time[row + 1] - time[row])[:, None]
    s = (ticks - time[row])[:, None] / width
    p0, p1, v0, v1 = position[row], position[row + 1], velocity[row] * width, velocity[row + 1] * width
    q = (2 * s**3 - 3 * s**2 + 1) * p0 + (s**3 - 2 * s**2 + s) * v0 + (3 * s**2 - 2 * s**3) * p1 + (s**3 - s**2) * v1
    return ticks, q


class PlacedBodies:
    """All collision bodies of a URDF among obstacles."""

    def __init__(self, urdf: Path, scene: Path | None = None, *, fruits: bool = True) -> None:
        """Read both files; without a scene there are no obstacles."""
        self.model = pin.buildModelFromUrdf(str(urdf))
        self.geometry = pin.buildGeomFromUrdf(self.model, str(urdf), pin.GeometryType.COLLISION)
        for shape in self.geometry.geometryObjects:
            if isinstance(shape.geometry, coal.BVHModelBase):
                shape.geometry.buildConvexHull(True, "Qt")
                shape.geometry = shape.geometry.convex
        self.count = self.geometry.ngeoms
        joints = [joint for joint in ElementTree.parse(urdf).iter("joint") if joint.get("type") != "fixed"]
        self._joined = [{end.get("link") for end in joint if end.tag in ("parent", "child")} for joint in joints]
        self.names = [shape.name for shape in self.geometry.geometryObjects]
        self.obstacles: list[str] = []
        if scene is not None:
            for name, body, place in solids_of(scene, fruits=fruits):
                self.geometry.addGeometryObject(pin.GeometryObject(name, 0, place, body))
                self.obstacles.append(name)

    def joint_order(self, names: Sequence[str]) -> list[int]:
        """Where each named joint stands in Pinocchio's configuration."""
        return [self.model.joints[self.model.getJointId(name)].idx_q for name in names]

    def stands(self, number: int) -> bool:
        """True if a body is the same at all configurations: it does not move, or is round about the yaw axis."""
        shape = self.geometry.geometryObjects[number]
        if shape.parentJoint == 0:
            return True
        place, first = shape.placement, shape.parentJoint == 1
        upright = self.model.joints[1].shortname() == "JointModelRZ"
        round_ = isinstance(shape.geometry, coal.Cylinder) and np.hypot(*place.translation[:2]) < 1e-9
        return bool(first and upright and round_ and abs(place.rotation[2, 2]) > 1.0 - 1e-12)

    def own_pairs(self, rng: np.random.Generator) -> list[tuple[int, int]]:
        """Pairs that move against each other, but those joined by a joint or touching at every configuration."""
        shapes = self.geometry.geometryObjects
        pairs = []
        for a, b in itertools.combinations(range(self.count), 2):
            links = {self.model.frames[shapes[k].parentFrame].name for k in (a, b)}
            if shapes[a].parentJoint != shapes[b].parentJoint and links not in self._joined:
                pairs.append((a, b))
        low, high = self.model.lowerPositionLimit, self.model.upperPositionLimit
        q = rng.uniform(low, high, (ALWAYS, self.model.nq))
        always = np.all(self._touching(pairs, q), axis=0)
        return [pair for pair, each in zip(pairs, always, strict=True) if not each]

    def _touching(self, pairs: Sequence[tuple[int, int]], q: FloatArray) -> BoolArray:
        """(configurations, pairs) whether they touch."""
        data = self.model.createData()
        found = np.zeros((len(q), len(pairs)), dtype=np.bool_)
        geometry = self._with(pairs)
        results = geometry.createData()
        for row, each in enumerate(q):
            pin.updateGeometryPlacements(self.model, data, geometry, results, each)
            for column in range(len(pairs)):
                found[row, column] = pin.computeDistance(geometry, results, column).min_distance <= 0.0
        return found

    def _with(self, pairs: Sequence[tuple[int, int]]) -> pin.GeometryModel:
        geometry = self.geometry.copy()
        geometry.removeAllCollisionPairs()
        for a, b in pairs:
            geometry.addCollisionPair(pin.CollisionPair(a, b))
        return geometry

    def first_touch(
        self, times: FloatArray, q: FloatArray, pairs: Sequence[tuple[int, int]], margin: float = 0.0
    ) -> FirstTouch | None:
        """The first configuration at which a pair is nearer than a margin, all configurations looked at.

        Args:
            times: (m,) [s].
            q: (m, nq) configurations.
            pairs: Pairs of bodies and obstacles by their numbers.
            margin: Distance below which bodies touch [m].
        """
        if not pairs:
            return None
        geometry = self._with(pairs)
        pool = pin.GeometryPool(self.model, geometry, 1)
        for request in pool.getGeometryDatas()[0].collisionRequests:
            request.enable_contact = True  # without it coal misses deep contacts
            request.security_margin = margin
        found = np.asarray(pin.computeCollisionsInParallel(1, pool, np.asfortranarray(q.T), True, False), np.bool_)
        for row in np.flatnonzero(found):
            data, results = self.model.createData(), geometry.createData()
            pin.updateGeometryPlacements(self.model, data, geometry, results, q[row])
            pin.computeDistances(geometry, results)
            depths = [-result.min_distance for result in results.distanceResults]
            worst = int(np.argmax(depths))
            if -depths[worst] < margin + 1e-9:
                a, b = (self.geometry.geometryObjects[k].name for k in pairs[worst])
                return FirstTouch(float(times[row]), a, b, float(depths[worst]))
        return None

    def distances(self, q: FloatArray, pairs: Sequence[tuple[int, int]]) -> FloatArray:
        """(m, pairs) signed distances."""
        geometry = self._with(pairs)
        data, results = self.model.createData(), geometry.createData()
        table = np.empty((len(q), len(pairs)))
        for row, each in enumerate(q):
            pin.updateGeometryPlacements(self.model, data, geometry, results, each)
            pin.computeDistances(geometry, results)
            table[row] = [result.min_distance for result in results.distanceResults]
        return table


def solids_of(scene: Path, *, fruits: bool = True) -> list[tuple[str, Any, pin.SE3]]:
    """Name, shape and place of all obstacles of a scene in JSON, points one by one."""
    numbers = json.loads(scene.read_text("utf-8"))
    found: list[tuple[str, Any, pin.SE3]] = []
    for item in numbers.get("obstacles", []):
        found += _solids(item, scene.parent)
    for item in numbers.get("fruits", []) if fruits else []:
        found.append((item["name"], coal.Sphere(item["radius"]), _at(item["center"])))
    return found


def _solids(item: dict[str, Any], folder: Path) -> list[tuple[str, Any, pin.SE3]]:
    name, kind = item["name"], item["kind"]
    turn = pin.rpy.rpyToMatrix(*np.radians(item.get("rpy_deg", (0.0, 0.0, 0.0))))
    if kind == "sphere":
        return [(name, coal.Sphere(item["radius"]), _at(item["center"]))]
    if kind == "box":
        return [(name, coal.Box(*item["size"]), pin.SE3(turn, np.array(item["center"])))]
    if kind == "capsule":
        return [(name, *capsule(np.array(item["from"]), np.array(item["to"]), item["radius"]))]
    place = pin.SE3(turn, np.array(item.get("position", (0.0, 0.0, 0.0))))
    if kind == "points":
        points = np.loadtxt(folder / item["file"], ndmin=2)
        ball = coal.Sphere(item["radius"])
        return [(name, ball, _at(place.rotation @ point + place.translation)) for point in points]
    vertices = np.asarray(trimesh.load(folder / item["file"]).vertices) * item.get("scale", 1.0)
    return [(name, convex(vertices), place)]


def capsule(start: FloatArray, end: FloatArray, radius: float) -> tuple[coal.Capsule, pin.SE3]:
    """A capsule between two points, and its place."""
    length = float(np.linalg.norm(end - start))
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (end - start) / length).matrix()
    return coal.Capsule(radius, length), pin.SE3(turn, 0.5 * (start + end))


def convex(points: FloatArray) -> coal.ConvexBase:
    """The hull of (k, 3) points."""
    corners = coal.StdVec_Vec3s()
    for point in points:
        corners.append(np.asarray(point, dtype=np.float64))
    return coal.Convex.convexHull(corners, True, "Qt")


def _at(point: Sequence[float] | FloatArray) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(point, dtype=np.float64))
