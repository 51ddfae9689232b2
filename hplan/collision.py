"""The scene in coal, by way of Pinocchio: the judge that shares no formula with the analytic planner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.arrays import BoolArray, FloatArray
from hplan.errors import ConfigurationInCollisionError
from hplan.grid import Grid
from hplan.robot import Robot
from hplan.scene import Box, Capsule, Sphere


@dataclass(frozen=True)
class Contact:
    """A link and an obstacle, and the signed distance between them [m]."""

    link: str
    obstacle: str
    distance_m: float


class CollisionScene:
    """Capsule links and obstacles as one geometry model, with the data to query it.

    Links are the capsules of `robot.arm`, which hold the URDF's collision geometry. Pairs are each link with each
    obstacle, link by link. The model is built whole before its data, as Pinocchio demands.
    """

    def __init__(self, robot: Robot, obstacles: Sequence[Sphere | Capsule | Box]) -> None:
        """Build the geometry of a robot among obstacles."""
        self.robot = robot
        self.link_names = robot.arm.link_names
        self.obstacle_names = tuple(obstacle.name for obstacle in obstacles)
        self.geometry = pin.GeometryModel()
        links = [self.geometry.addGeometryObject(shape) for shape in _link_capsules(robot)]
        solids = [self.geometry.addGeometryObject(_solid(obstacle)) for obstacle in obstacles]
        for link in links:
            for solid in solids:
                self.geometry.addCollisionPair(pin.CollisionPair(link, solid))
        self.data = robot.model.createData()
        self.geometry_data = self.geometry.createData()

    def distances(self, q: ArrayLike) -> FloatArray:
        """Signed distances at one configuration, (dof,) -> (links, obstacles) [m]; negative is the depth."""
        pin.computeDistances(
            self.robot.model, self.data, self.geometry, self.geometry_data, np.asarray(q, dtype=np.float64)
        )
        flat = [result.min_distance for result in self.geometry_data.distanceResults]
        return np.array(flat, dtype=np.float64).reshape(len(self.link_names), len(self.obstacle_names))

    def nearest(self, q: ArrayLike) -> Contact | None:
        """The link and obstacle nearest to each other, or None without obstacles."""
        distances = self.distances(q)
        if distances.size == 0:
            return None
        link, obstacle = np.unravel_index(int(distances.argmin()), distances.shape)
        return Contact(self.link_names[link], self.obstacle_names[obstacle], float(distances.min()))

    def in_collision(self, configurations: ArrayLike) -> BoolArray:
        """Whether each of (n, dof) configurations touches an obstacle, in one compiled call."""
        q = np.asfortranarray(np.asarray(configurations, dtype=np.float64).T)
        if not self.obstacle_names:
            return np.zeros(q.shape[1], dtype=np.bool_)
        pool = pin.GeometryPool(self.robot.model, self.geometry, 1)
        return np.asarray(pin.computeCollisionsInParallel(1, pool, q, True, False), dtype=np.bool_)


def check_clear(judge: CollisionScene, q: FloatArray, clearance: float, which: str) -> float:
    """What a configuration has beyond the clearance to keep [m], inf without obstacles.

    Raises:
        ConfigurationInCollisionError: It touches an obstacle, or comes closer than `clearance`; names link, obstacle
            and depth.
    """
    nearest = judge.nearest(q)
    if nearest is None:
        return float("inf")
    beyond = nearest.distance_m - clearance
    if beyond <= 0.0:
        raise ConfigurationInCollisionError(which, nearest.link, nearest.obstacle, -beyond)
    return beyond


def sampled_occupancy(judge: CollisionScene, grid: Grid, yaw: float = 0.0) -> BoolArray:
    """Occupancy of a grid over the planar joints by asking coal at every node.

    Returns:
        Mask of the grid's shape, True where some link touches an obstacle.
    """
    robot = judge.robot
    axes = [grid.axis(number) for number in range(len(grid.shape))]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    if robot.has_yaw:
        nodes = np.column_stack([np.full(len(nodes), yaw), nodes])
    return judge.in_collision(nodes).reshape(grid.shape)


def _link_capsules(robot: Robot) -> list[pin.GeometryObject]:
    """Each link's capsule in the frame of its joint."""
    model, arm = robot.model, robot.arm
    data = model.createData()
    neutral = np.zeros(model.nq)
    pin.forwardKinematics(model, data, neutral)
    points = robot.plane_origin + arm.joint_points(neutral[robot.arm_slice]) @ robot.plane_axes
    first = 2 if robot.has_yaw else 1
    shapes = []
    for k, name in enumerate(arm.link_names):
        placement = _along(points[k], points[k + 1])
        local = data.oMi[first + k].inverse() * placement
        capsule = coal.Capsule(float(arm.half_widths[k]), float(arm.lengths[k]))
        shapes.append(pin.GeometryObject(f"link:{name}", first + k, local, capsule))
    return shapes


def _solid(obstacle: Sphere | Capsule | Box) -> pin.GeometryObject:
    """An obstacle as a fixed geometry object."""
    if isinstance(obstacle, Sphere):
        placement, shape = pin.SE3(np.eye(3), np.array(obstacle.center)), coal.Sphere(float(obstacle.radius))
    elif isinstance(obstacle, Capsule):
        start, end = np.array(obstacle.start), np.array(obstacle.end)
        placement = _along(start, end)
        shape = coal.Capsule(float(obstacle.radius), float(np.linalg.norm(end - start)))
    else:
        placement = pin.SE3(obstacle.rotation, np.array(obstacle.center))
        shape = coal.Box(*(float(size) for size in obstacle.size))
    return pin.GeometryObject(f"obstacle:{obstacle.name}", 0, placement, shape)


def _along(start: FloatArray, end: FloatArray) -> pin.SE3:
    """Placement in the middle of a segment, z along it."""
    axis = end - start
    length = np.linalg.norm(axis)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis / length) if length > 0.0 else None
    rotation = np.eye(3) if turn is None else turn.toRotationMatrix()
    return pin.SE3(rotation, 0.5 * (start + end))
