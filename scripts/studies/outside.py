"""Motions looked at from outside: contacts by Pinocchio and coal alone, limits by differences.

The URDF's shapes (meshes by their hulls) and the obstacles are placed anew at each configuration, those that move
where their tracks have them, by other means than what plans and certifies. Of the robot's own pairs those are asked
that planning looks at (`hplan.bodies.touching_pairs`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation, Slerp
from studies.harness import Row

from hplan.base.arrays import FloatArray
from hplan.bodies.collision_bodies import body_shapes, collision_bodies
from hplan.bodies.touching_pairs import self_pairs
from hplan.errors import InputError
from hplan.robot.model import Robot
from hplan.scene.model import Fruit, Scene
from hplan.scene.obstacles import Box, Capsule, Cylinder, PointCloud, Sphere
from hplan.scene.tracks import Track
from hplan.timing.trajectory import Trajectory

#: Motions are looked at so often, and those past what moves [s].
EVERY_S, IN_TIME_S = 1e-3, 5e-4


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """A motion as a function of time: how long it lasts [s], and (n,) times -> (n, dof) configurations."""

    duration: float
    positions: Callable[[FloatArray], FloatArray]


#: A motion of anybody's, or hplan's rows with cubics between them.
Motion = TimedMotion | Trajectory


def times_until(end_s: float, step_s: float) -> FloatArray:
    """Times from 0 on, so far apart, and the end [s]."""
    return np.append(np.arange(0.0, end_s, step_s), end_s)


class OutsideCheck:
    """A robot among obstacles: balls, capsules, cylinders, boxes, clouds, some of the first three on a track."""

    def __init__(self, robot: Robot, obstacles: Sequence[object]) -> None:
        """Place them.

        Raises:
            InputError: An obstacle of another kind.
        """
        self._robot, geometry = robot, pin.GeometryModel()
        self._clouds = [obstacle for obstacle in obstacles if isinstance(obstacle, PointCloud)]
        solids = [obstacle for obstacle in obstacles if not isinstance(obstacle, PointCloud)]
        for shape in body_shapes(robot):
            shape.geometry.computeLocalAABB()
            geometry.addGeometryObject(shape)
        first = geometry.ngeoms
        for number, obstacle in enumerate(solids):
            shape, place = _placed(obstacle)
            geometry.addGeometryObject(pin.GeometryObject(f"obstacle {number}", 0, place, shape))
        tracks = ((first + number, getattr(solid, "track", None)) for number, solid in enumerate(solids))
        self._moving = [
            (number, geometry.geometryObjects[number].placement.copy(), _Tracked(track))
            for number, track in tracks
            if track is not None
        ]
        self._bodies = [number for number, body in enumerate(collision_bodies(robot)) if body.joint >= 0]
        met = [(body, other) for body in self._bodies for other in range(first, geometry.ngeoms)]
        for pair in (*met, *self_pairs(robot).checked):
            geometry.addCollisionPair(pin.CollisionPair(*pair))
        self._met, self._geometry = len(met), geometry
        self._arm, self._data = robot.model.createData(), geometry.createData()
        self._asked = coal.CollisionRequest()
        for request in (self._asked, *self._data.collisionRequests):
            request.enable_contact = True  # asked for yes or no alone, coal misses some deep contacts

    @classmethod
    def of(cls, robot: Robot, scene: Scene) -> OutsideCheck:
        """The obstacles of a scene, and all of its fruit."""
        return cls(robot, [*scene.obstacles, *scene.fruits])

    def _place(self, q: FloatArray, t: float) -> None:
        for number, listed, tracked in self._moving:
            self._geometry.geometryObjects[number].placement = tracked.at(t) * listed
        pin.updateGeometryPlacements(self._robot.model, self._arm, self._geometry, self._data, q)

    def touched(self, q: FloatArray, t: float = 0.0) -> tuple[bool, bool]:
        """Whether an obstacle is touched at a configuration and time [s], and whether the robot touches itself."""
        self._place(q, t)
        found = [False, False]
        if pin.computeCollisions(self._geometry, self._data, True):  # it stops at the first one
            pairs = range(len(self._geometry.collisionPairs))
            asked = [pin.computeCollision(self._geometry, self._data, pair) for pair in pairs]
            found = [any(asked[: self._met]), any(asked[self._met :])]
        return found[0] or any(map(self._in_cloud, self._clouds)), found[1]

    def distance(self, q: FloatArray, t: float = 0.0) -> float:
        """Least signed distance from the obstacles, clouds left out, at a configuration and time [m]."""
        self._place(q, t)
        results = (pin.computeDistance(self._geometry, self._data, pair) for pair in range(self._met))
        return min((result.min_distance for result in results), default=np.inf)

    def contacts(self, motion: Motion, every_s: float = EVERY_S) -> tuple[int, int]:
        """At how many instants of a motion an obstacle is touched, and the robot touches itself."""
        clock = times_until(motion.duration, every_s)
        places = zip(motion.positions(clock), clock.tolist(), strict=True)
        obstacles, own = np.array([self.touched(q, t) for q, t in places]).sum(axis=0).tolist()
        return obstacles, own

    def _in_cloud(self, cloud: PointCloud) -> bool:
        """Whether a body, where it was put, touches one of a cloud's balls."""
        ball, result = coal.Sphere(cloud.radius), coal.CollisionResult()
        for shape, place, points in self._near(cloud):
            for point in points:
                result.clear()
                if coal.collide(shape, place, ball, coal.Transform3s(np.eye(3), point), self._asked, result):
                    return True
        return False

    def _near(self, cloud: PointCloud) -> Iterator[tuple[coal.CollisionGeometry, coal.Transform3s, FloatArray]]:
        """Each body with the centres of balls that touch the box about it."""
        for number in self._bodies:
            shape, place = self._geometry.geometryObjects[number].geometry, self._data.oMg[number]
            box = shape.aabb_local
            lower, upper = np.array(box.min_).ravel() - cloud.radius, np.array(box.max_).ravel() + cloud.radius
            inside = (cloud.points - place.translation) @ place.rotation
            near = ((inside >= lower) & (inside <= upper)).all(axis=1)
            if near.any():
                yield shape, coal.Transform3s(place.rotation, place.translation), cloud.points[near]


class _Tracked:
    """What moves as a track has it, interpolated here and not by what the certificate uses."""

    def __init__(self, track: Track) -> None:
        self._times, self._shifts = np.array(track.times_s), np.array(track.shifts_m)
        self._about = np.zeros(3) if track.about is None else np.array(track.about)
        turns = track.rpy_deg
        self._turns = None if turns is None else Slerp(self._times, Rotation.from_euler("xyz", turns, degrees=True))

    def at(self, t: float) -> pin.SE3:
        """The displacement at a time [s]."""
        inside = float(np.clip(t, self._times[0], self._times[-1]))
        shift = np.array([np.interp(inside, self._times, column) for column in self._shifts.T])
        turn = np.eye(3) if self._turns is None else self._turns(inside).as_matrix()
        return pin.SE3(turn, self._about + shift - turn @ self._about)


def _placed(obstacle: object) -> tuple[coal.CollisionGeometry, pin.SE3]:
    """An obstacle as a shape of coal, and where it is listed."""
    if isinstance(obstacle, Sphere | Fruit):
        return coal.Sphere(obstacle.radius), pin.SE3(np.eye(3), np.array(obstacle.center))
    if isinstance(obstacle, Box):
        return coal.Box(*obstacle.size), pin.SE3(obstacle.rotation, np.array(obstacle.center))
    if isinstance(obstacle, Cylinder):
        place = pin.SE3(obstacle.rotation, np.array(obstacle.center))
        return coal.Cylinder(obstacle.radius, obstacle.length), place
    if isinstance(obstacle, Capsule):
        start, end = np.array(obstacle.start), np.array(obstacle.end)
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end - start).toRotationMatrix()
        length = float(np.linalg.norm(end - start))
        return coal.Capsule(obstacle.radius, length), pin.SE3(turn, 0.5 * (start + end))
    raise InputError(f"{type(obstacle).__name__}: not looked at from outside")


def least_distance(
    robot: Robot, scene: Scene, positions: Callable[[FloatArray], FloatArray], end_s: float, step_s: float = IN_TIME_S
) -> float:
    """Smallest distance of the arm from an obstacle at times from 0 to the end of a motion [m]."""
    check, clock = OutsideCheck.of(robot, scene), times_until(end_s, step_s)
    return min(check.distance(q, t) for q, t in zip(positions(clock), clock.tolist(), strict=True))


def findings(robot: Robot, check: OutsideCheck, motion: Motion, every_s: float = EVERY_S) -> Row:
    """What fine samples of a motion show: contacts, excess over joint limits, shares of the other limits.

    Velocity and acceleration are differences of equally spaced positions, torque is inverse dynamics of these.
    """
    clock = np.linspace(0.0, motion.duration, max(3, int(np.ceil(motion.duration / every_s)) + 1))
    h, q = clock[1], motion.positions(clock)
    v, a = (q[2:] - q[:-2]) / (2.0 * h), (q[2:] - 2.0 * q[1:-1] + q[:-2]) / h**2
    data = robot.model.createData()
    torque = np.array([pin.rnea(robot.model, data, *row) for row in zip(q[1:-1], v, a, strict=True)])
    touching = [row for row, t in zip(q, clock.tolist(), strict=True) if any(check.touched(row, t))]
    return {
        "looks": len(q),
        "contacts": len(touching),
        "depth_mm": 1e3 * max((-check.distance(row) for row in touching), default=0.0),
        "outside_deg": float(np.degrees(np.maximum(robot.lower - q, q - robot.upper).max().clip(0.0))),
        "velocity": float((np.abs(v) / robot.velocity_limit).max()),
        "acceleration": float((np.abs(a) / robot.acceleration_limit).max()),
        "torque": float((np.abs(torque) / robot.torque_limit).max()),
    }
