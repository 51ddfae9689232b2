"""Contacts of a robot's motion as Pinocchio and coal alone find them, without anything that plans or certifies.

The URDF's shapes (meshes by their hulls) and the obstacles are placed at each configuration. Of the robot's own pairs
those are asked that planning looks at (`hplan.bodies.touching_pairs`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from studies.benchmark.measure import times_until
from studies.benchmark.motions import TimedMotion

from hplan.base.arrays import BoolArray, FloatArray
from hplan.bodies.collision_bodies import body_shapes, collision_bodies
from hplan.bodies.touching_pairs import self_pairs
from hplan.robot.model import Robot
from hplan.scene.obstacles import Box, Capsule, PointCloud, Sphere

#: Motions are looked at so often [s].
EVERY_S = 1e-3

#: An obstacle of coal, and where it is.
Placed = tuple[coal.CollisionGeometry, pin.SE3]


@dataclass(frozen=True, eq=False)
class Balls:
    """Balls of one radius.

    Attributes:
        points: (n, 3) their centres [m].
        radius: Of every one [m].
    """

    points: FloatArray
    radius: float


def placed(obstacle: Sphere | Capsule | Box) -> Placed:
    """An obstacle of a scene as a shape of coal."""
    if isinstance(obstacle, Sphere):
        return coal.Sphere(obstacle.radius), pin.SE3(np.eye(3), np.array(obstacle.center))
    if isinstance(obstacle, Box):
        return coal.Box(*obstacle.size), pin.SE3(obstacle.rotation, np.array(obstacle.center))
    start, end = np.array(obstacle.start), np.array(obstacle.end)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end - start).toRotationMatrix()
    return coal.Capsule(obstacle.radius, float(np.linalg.norm(end - start))), pin.SE3(turn, 0.5 * (start + end))


def of_scene(obstacles: Iterable[object]) -> tuple[list[Placed], list[Balls]]:
    """The spheres, boxes, capsules and clouds of a scene."""
    shapes = [placed(obstacle) for obstacle in obstacles if isinstance(obstacle, Sphere | Capsule | Box)]
    clouds = [Balls(cloud.points, cloud.radius) for cloud in obstacles if isinstance(cloud, PointCloud)]
    return shapes, clouds


class OutsideCheck:
    """A robot among obstacles."""

    def __init__(self, robot: Robot, obstacles: Sequence[Placed], clouds: Sequence[Balls] = ()) -> None:
        """Place them."""
        self._robot, self._clouds, geometry = robot, clouds, pin.GeometryModel()
        for shape in body_shapes(robot):
            shape.geometry.computeLocalAABB()
            geometry.addGeometryObject(shape)
        for number, (shape, place) in enumerate(obstacles):
            geometry.addGeometryObject(pin.GeometryObject(f"obstacle {number}", 0, place, shape))
        self._moving = [number for number, body in enumerate(collision_bodies(robot)) if body.joint >= 0]
        first = len(body_shapes(robot))
        met = [(body, first + number) for body in self._moving for number in range(len(obstacles))]
        for pair in (*met, *self_pairs(robot).checked):
            geometry.addCollisionPair(pin.CollisionPair(*pair))
        self._met, self._geometry = len(met), geometry
        self._arm, self._data = robot.model.createData(), geometry.createData()
        self._asked = coal.CollisionRequest()
        for request in (self._asked, *self._data.collisionRequests):
            request.enable_contact = True  # asked for yes or no alone, coal misses some deep contacts

    def touched(self, configurations: FloatArray) -> tuple[BoolArray, BoolArray]:
        """(n,) where an obstacle is touched, and (n,) where the robot touches itself, at (n, dof) configurations."""
        found = np.zeros((2, len(configurations)), dtype=np.bool_)
        for number, q in enumerate(configurations):
            pin.updateGeometryPlacements(self._robot.model, self._arm, self._geometry, self._data, q)
            if pin.computeCollisions(self._geometry, self._data, True):  # it stops at the first one
                pairs = range(len(self._geometry.collisionPairs))
                asked = [pin.computeCollision(self._geometry, self._data, pair) for pair in pairs]
                found[:, number] = any(asked[: self._met]), any(asked[self._met :])
            found[0, number] = found[0, number] or any(map(self._touches, self._clouds))
        return found[0], found[1]

    def contacts(self, motion: TimedMotion) -> tuple[int, int]:
        """At how many milliseconds of a motion an obstacle is touched, and the robot touches itself."""
        obstacles, own = self.touched(motion.positions(times_until(motion.duration, EVERY_S)))
        return int(obstacles.sum()), int(own.sum())

    def distance(self, q: FloatArray) -> float:
        """Least signed distance of the robot from the obstacles, clouds left out, at a (dof,) configuration [m]."""
        pin.updateGeometryPlacements(self._robot.model, self._arm, self._geometry, self._data, q)
        pairs = range(self._met)
        return min(
            (pin.computeDistance(self._geometry, self._data, pair).min_distance for pair in pairs), default=np.inf
        )

    def _touches(self, balls: Balls) -> bool:
        """Whether a body, where it was put, touches one of some balls."""
        ball, result = coal.Sphere(balls.radius), coal.CollisionResult()
        for shape, place, points in self._near(balls):
            for point in points:
                result.clear()
                if coal.collide(shape, place, ball, coal.Transform3s(np.eye(3), point), self._asked, result):
                    return True
        return False

    def _near(self, balls: Balls) -> Iterator[tuple[coal.CollisionGeometry, coal.Transform3s, FloatArray]]:
        """Each body with the centres of balls that touch the box about it."""
        for number in self._moving:
            shape, place = self._geometry.geometryObjects[number].geometry, self._data.oMg[number]
            box = shape.aabb_local
            lower, upper = np.array(box.min_).ravel() - balls.radius, np.array(box.max_).ravel() + balls.radius
            inside = (balls.points - place.translation) @ place.rotation
            near = ((inside >= lower) & (inside <= upper)).all(axis=1)
            if near.any():
                yield shape, coal.Transform3s(place.rotation, place.translation), balls.points[near]
