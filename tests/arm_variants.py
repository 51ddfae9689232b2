"""Arms with other zeros, planes and signs, random obstacles, and coal references.

The references use coal without hplan's formulas.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import solid_shape
from hplan.collision.collision_bodies import collision_bodies
from hplan.planar.family_reader import family_of
from hplan.planar.self_contact import SelfContact
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Capsule, Sphere
from hplan.trajectory.trajectory import Trajectory

UP = "0 -1 0"  # a positive angle lifts the arm
DOWN = "0 1 0"

#: has_yaw, place and turn of the shoulder, axis of each planar joint.
VARIANTS: dict[str, tuple[bool, str, str, tuple[str, ...]]] = {
    "upright on a yaw": (True, "0 0 0.6", "0 0 0", (UP, UP, UP)),
    "signs -1": (True, "0 0 0.6", "0 0 0", (DOWN, UP, DOWN)),
    "shoulder beside the yaw axis": (True, "0.25 0 0.5", "0 0 0", (UP, UP, UP)),
    "shoulder aside and behind, arm turned": (True, "-0.12 0.16 0.5", "0 -0.7 -0.9272952180016122", (UP, DOWN, UP)),
    "one link on a yaw": (True, "0.1 0 0.4", "0 0.3 0", (UP,)),
    "five links on a yaw": (True, "0 0 0.5", "0 0 0", (UP, UP, DOWN, UP, UP)),
    "no yaw": (False, "0.2 -0.3 0.4", "0 0 0.5", (UP, UP)),
    "tilted plane": (False, "0.1 0.2 0.7", "0.5 0.3 -0.4", (UP, DOWN, UP)),
    "horizontal plane": (False, "0 0.1 0.4", "0 0 0.2", ("0 0 1", "0 0 -1", "0 0 1")),
    "horizontal plane from below": (False, "0 0 0.4", "3.141592653589793 0 0", ("0 0 1", "0 0 1")),
    "yaw axis off the origin": (True, "0.1 0 0.5", "0 0 0", (UP, UP, UP)),
    "plane off the yaw axis": (True, "-0.05 0.22 0.5", "0 0 0.4", (UP, DOWN, UP)),
    "links next to each other, off the axis": (True, "0.1 -0.15 0.5", "0 0 0", (DOWN, UP, UP)),
    "links beside each other, no yaw": (False, "0.2 -0.3 0.4", "0 0 0.5", (UP, DOWN)),
}

#: Arms with offsets: position of the yaw axis, offset of each joint and of the tool from the joint before it, and
#: offset of each link's body from its joint.
OFFSETS: dict[str, tuple[str, tuple[float, ...], tuple[float, ...]]] = {
    "yaw axis off the origin": ("0.4 -0.3 0", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    "plane off the yaw axis": ("0 0 0.1", (0.05, -0.12, 0.03), (0.0, 0.0, 0.0)),
    "links next to each other, off the axis": ("-0.3 0.2 0", (0.04, 0.0, -0.02), (0.13, -0.05, 0.0)),
    "links beside each other, no yaw": ("0 0 0", (0.1, -0.2), (0.06, 0.0)),
}


def load_variant(name: str, folder: Path) -> Robot:
    """Write the URDF of a variant into a folder and load it.

    Joints may turn by +-2.5 rad, the yaw by +-3. Self-collision is disabled, so that tests are about obstacles alone.
    """
    has_yaw, xyz, rpy, axes = VARIANTS[name]
    foot, aside, body = OFFSETS.get(name, ("0 0 0", (0.0,) * len(axes), (0.0,) * len(axes)))
    lengths = [0.8, 0.6, 0.45, 0.3, 0.25][: len(axes)]
    widths = [0.06, 0.05, 0.04, 0.03, 0.02][: len(axes)]
    limit = '<limit lower="-%g" upper="%g" velocity="2" effort="300"/>'
    parts = ['<robot name="variant"><link name="base_link"/>']
    parent, place = "base_link", f'<origin xyz="{xyz}" rpy="{rpy}"/>'
    names = []
    if has_yaw:
        parts.append(
            f'<link name="turret"/><joint name="yaw" type="revolute"><parent link="base_link"/><child link="turret"/>'
            f'<origin xyz="{foot}"/><axis xyz="0 0 1"/>{limit % (3, 3)}</joint>'
        )
        parent = "turret"
        names.append("yaw")
    for k, axis in enumerate(axes):
        parts.append(
            f'<joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/>{place}'
            f'<axis xyz="{axis}"/>{limit % (2.5, 2.5)}</joint><link name="l{k}"><inertial><mass value="1"/>'
            f'<origin xyz="{0.5 * lengths[k]} 0 0"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
            f"{_capsule(lengths[k], widths[k], body[k])}</link>"
        )
        parent, place = f"l{k}", f'<origin xyz="{lengths[k]} {aside[k]} 0"/>'
        names.append(f"j{k}")
    parts.append(
        f'<joint name="tool" type="fixed"><parent link="{parent}"/><child link="tool0"/>{place}</joint>'
        '<link name="tool0"/></robot>'
    )
    path = folder / "variant.urdf"
    path.write_text("\n".join(parts))
    table = ", ".join(f"{joint}: 5" for joint in names)
    (folder / "variant.limits.yaml").write_text(f"format: hplan-limits/1\nacceleration_rad_s2: {{{table}}}\n")
    robot = load_robot(path)
    np.testing.assert_allclose(family_of(robot).arm.half_widths, widths, rtol=1e-12)
    links = {body.name for body in collision_bodies(robot)}
    robot = replace(robot, may_touch=tuple((*pair, "a test") for pair in itertools.combinations(sorted(links), 2)))
    robot.cache("self_contact", lambda: lambda *_: SelfContact())  # for any tracking error and clearance
    return robot


def _capsule(length: float, width: float, aside: float) -> str:
    """A capsule along x, as URDF has it: a cylinder with a ball at either end."""
    parts = [(0.5 * length, f'<cylinder radius="{width}" length="{length}"/>')]
    parts += [(end, f'<sphere radius="{width}"/>') for end in (0.0, length)]
    return "".join(
        f'<collision><origin xyz="{x} {aside} 0" rpy="0 1.5707963267948966 0"/><geometry>{shape}</geometry></collision>'
        for x, shape in parts
    )


def from_obstacles(checker: CoalScene, q: np.ndarray) -> np.ndarray:
    """(links, obstacles) signed distances of the links that move from the obstacles alone."""
    return checker.distances(q)[: len(checker.link_names), : checker.own_first]


def axis_points(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(links + 1, 3) joint positions and the tool's, as Pinocchio places them."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.asarray(q, dtype=float))
    first = 2 if family_of(robot).has_yaw else 1
    joints = [data.oMi[j].translation.copy() for j in range(first, robot.model.njoints)]
    return np.array([*joints, data.oMf[robot.model.getFrameId(robot.tool_frame)].translation])


def link_axes(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(links, 2, 3) both ends of each link's axis, along x in its frame, and at the y of its first collision shape."""
    points, data = axis_points(robot, q), robot.model.createData()
    pin.forwardKinematics(robot.model, data, np.asarray(q, dtype=float))
    first, ends = robot.model.njoints - family_of(robot).arm.link_count, []
    for joint, tip in enumerate(points[1:], start=first):
        shape = next(g for g in robot.collision_model.geometryObjects if g.parentJoint == joint)
        place, y = data.oMi[joint], shape.placement.translation[1]
        x, _, z = place.actInv(tip)
        ends.append([place.act(np.array([0.0, y, 0.0])), place.act(np.array([x, y, z]))])
    return np.array(ends)


def random_obstacles(rng: np.random.Generator, count: int = 6) -> list[Sphere | Capsule | Box]:
    """Spheres, capsules and rotated boxes in turn, within reach of the arms above."""
    obstacles: list[Sphere | Capsule | Box] = []
    for index in range(count):
        center = rng.uniform([-1.8, -1.8, -0.6], [1.8, 1.8, 2.0])
        size = rng.uniform(0.02, 0.2)
        name = f"o{index}"
        if index % 3 == 0:
            obstacles.append(Sphere(name=name, center=tuple(center), radius=size))
        elif index % 3 == 1:
            end = center + rng.uniform(-0.8, 0.8, 3)
            obstacles.append(Capsule(name=name, start=tuple(center), end=tuple(end), radius=size))
        else:
            edges, rpy = rng.uniform(0.05, 0.6, 3), rng.uniform(-180.0, 180.0, 3)
            obstacles.append(Box(name=name, center=tuple(center), size=tuple(edges), rpy_deg=tuple(rpy)))
    return obstacles


def upright_capsule(start: np.ndarray, end: np.ndarray, radius: float) -> tuple[coal.Capsule, coal.Transform3s]:
    length = float(np.linalg.norm(end - start))
    rotation = np.eye(3)
    if length > 0.0:
        z = (end - start) / length
        x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(z, x), z], axis=1)
    return coal.Capsule(float(radius), length), coal.Transform3s(rotation, 0.5 * (start + end))


def _placed(obstacle: Sphere | Capsule | Box) -> tuple[coal.ShapeBase, coal.Transform3s]:
    if isinstance(obstacle, Sphere):
        return coal.Sphere(float(obstacle.radius)), coal.Transform3s(np.eye(3), np.array(obstacle.center))
    if isinstance(obstacle, Capsule):
        return upright_capsule(np.array(obstacle.start), np.array(obstacle.end), obstacle.radius)
    turn = pin.rpy.rpyToMatrix(*np.radians(obstacle.rpy_deg))
    return coal.Box(*map(float, obstacle.size)), coal.Transform3s(turn, np.array(obstacle.center))


def coal_distances(robot: Robot, q: np.ndarray, obstacles: Sequence[Sphere | Capsule | Box]) -> np.ndarray:
    """(links, obstacles) signed distances of capsule links placed by Pinocchio."""
    points = link_axes(robot, q)
    solids = [_placed(obstacle) for obstacle in obstacles]
    table = np.empty((family_of(robot).arm.link_count, len(solids)))
    for k, half_width in enumerate(family_of(robot).arm.half_widths):
        capsule, place = upright_capsule(*points[k], half_width)
        for s, (solid, at) in enumerate(solids):
            table[k, s] = coal.distance(capsule, place, solid, at, coal.DistanceRequest(), coal.DistanceResult())
    return table


def least_by_coal(
    robot: Robot, scene: Scene, trajectory: Trajectory, step_s: float = 2e-3, begin_s: float = 0.0
) -> float:
    """Minimum distance of a link from an obstacle at times, moving obstacles included."""
    clock = np.append(np.arange(0.0, trajectory.duration, step_s), trajectory.duration)
    poses, least = scene.poses_at(begin_s + clock), np.inf
    solids = [(obstacle.name, solid_shape(obstacle)) for obstacle in scene.obstacles]
    for number, q in enumerate(trajectory.positions(clock)):
        links = [
            upright_capsule(*axis, half)
            for axis, half in zip(link_axes(robot, q), family_of(robot).arm.half_widths, strict=True)
        ]
        for name, solid in solids:
            there = solid.placement
            if name in poses:
                rotations, shifts = poses[name]
                there = pin.SE3(rotations[number], shifts[number]) * there
            place = coal.Transform3s(there.rotation, there.translation)
            for link, at in links:
                found = coal.distance(link, at, solid.geometry, place, coal.DistanceRequest(), coal.DistanceResult())
                least = min(least, found)
    return float(least)
