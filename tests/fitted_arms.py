"""Members of the family with added boxes and meshes, and coal on all shapes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from planned import straight

from hplan.planar.family_reader import family_of, is_planar
from hplan.robot.family.members import write_robot
from hplan.robot.family.spec import ArmSpec
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.trajectory.trajectory import Trajectory

LENGTHS, WIDTHS = (1.0, 0.8, 0.4), (0.05, 0.04, 0.03)


def box(size, at, rpy=(0.0, 0.0, 0.0)) -> str:
    """A collision box of a URDF."""
    return (
        f'<collision><origin xyz="{_text(at)}" rpy="{_text(rpy)}"/>'
        f'<geometry><box size="{_text(size)}"/></geometry></collision>'
    )


def mesh(path: Path, corners, at=(0.0, 0.0, 0.0)) -> str:
    """A collision mesh of a URDF: the hull of a few corners."""
    faces = coal.Convex.convexHull(_points(corners), True, "Qt")
    lines = [f"v {_text(faces.point(i))}" for i in range(faces.num_points)]
    for i in range(faces.num_polygons):
        face = faces.polygons(i)
        lines.append("f " + " ".join(str(face[k] + 1) for k in range(3)))
    path.write_text("\n".join(lines) + "\n")
    return f'<collision><origin xyz="{_text(at)}"/><geometry><mesh filename="{path}"/></geometry></collision>'


def _points(corners) -> coal.StdVec_Vec3s:
    points = coal.StdVec_Vec3s()
    for corner in np.asarray(corners, dtype=float):
        points.append(corner)
    return points


def _text(values) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)


def fitted(
    folder: Path,
    more: Mapping[str, Sequence[str]] | None = None,
    *,
    low: object = 0.0,
    high: object = 90.0,
    yaw_deg: float | None = 180.0,
    lengths: Sequence[float] = LENGTHS,
    widths: Sequence[float] = WIDTHS,
    hung: Mapping[str, tuple[str, Sequence[float], str]] | None = None,
    name: str = "fitted",
    **more_of_spec: Any,
) -> Robot:
    """A member of the family with collision shapes of a URDF added.

    Args:
        folder: Output folder.
        more: Shapes to add, by link.
        low: Lower limits of the planar joints [deg].
        high: Upper limits of the planar joints [deg].
        yaw_deg: Range of the yaw to either side; None for none.
        lengths: Lengths of the links.
        widths: Half-widths of the links.
        hung: Fixed links to add, by name: parent link, position and shape.
        name: Name of the file.
        **more_of_spec: Other entries of the specification, such as offsets.
    """
    count = len(lengths)
    low, high = (np.radians(np.broadcast_to(limit, (count,))).tolist() for limit in (low, high))
    yaw = () if yaw_deg is None else (math.radians(yaw_deg),)
    joints = count + len(yaw)
    spec = ArmSpec(
        name=name,
        has_yaw=bool(yaw),
        link_lengths=tuple(lengths),
        link_half_widths=tuple(widths),
        link_masses=(4.0, 3.0, 1.0, 1.0, 1.0)[:count],
        lower=(*(-limit for limit in yaw), *low),
        upper=(*yaw, *high),
        velocity=(1.5,) * joints,
        effort=(400.0,) * joints,
        acceleration=(3.0,) * joints,
        jerk=(150.0,) * joints,
        **more_of_spec,
    )
    path = write_robot(spec, folder / f"{name}.urdf")[0]
    text = path.read_text()
    for link, shapes in (more or {}).items():
        start = text.index(f'<link name="{link}"')
        if text[text.index(">", start) - 1] == "/":
            text = text[: text.index(">", start) - 1] + "></link>" + text[text.index(">", start) + 1 :]
        end = text.index("</link>", start)
        text = text[:end] + "".join(shapes) + text[end:]
    for added, (parent, at, shape) in (hung or {}).items():
        text = text.replace(
            "</robot>",
            f'<link name="{added}">{shape}</link><joint name="{added}_mount" type="fixed"><parent link="{parent}"/>'
            f'<child link="{added}"/><origin xyz="{_text(at)}"/></joint></robot>',
        )
    path.write_text(text)
    return load_robot(path)


class Bodies:
    """All shapes of a robot's URDF in coal, independent of hplan."""

    def __init__(self, robot: Robot, *, samples: int = 200) -> None:
        self.robot = robot
        self.data = robot.model.createData()
        self.shapes = [
            (geometry.parentJoint, robot.model.frames[geometry.parentFrame].name, _convex(geometry), geometry.placement)
            for geometry in robot.collision_model.geometryObjects
        ]
        self.moving = 2 if is_planar(robot) and family_of(robot).has_yaw else 1
        pairs = [
            (a, b)
            for a, b in itertools.combinations(range(len(self.shapes)), 2)
            if self.shapes[a][0] != self.shapes[b][0] and not self._neighbours(a, b)
        ]
        # Pairs that touch in all configurations are left out.
        rng = np.random.default_rng(0)
        apart = np.zeros(len(pairs), dtype=bool)
        self.pairs = pairs
        for q in rng.uniform(robot.lower, robot.upper, (samples, robot.dof)):
            apart |= self.distances(q) > 0.0
        self.pairs = [pair for pair, ever in zip(pairs, apart, strict=True) if ever]

    def _neighbours(self, a: int, b: int) -> bool:
        """True if two shapes belong to links that share a joint."""
        low, high = sorted((self.shapes[a][0], self.shapes[b][0]))
        return low >= self.moving and high == low + 1

    def distances(self, q, pairs=None) -> np.ndarray:
        """Signed distance of each pair."""
        pin.forwardKinematics(self.robot.model, self.data, np.asarray(q, dtype=float))
        placed = []
        for joint, _, geometry, placement in self.shapes:
            at = self.data.oMi[joint] * placement
            placed.append((geometry, coal.Transform3s(at.rotation, at.translation)))
        return np.array([distance(*placed[a], *placed[b]) for a, b in (self.pairs if pairs is None else pairs)])

    def clearance(self, q, obstacles=()) -> float:
        """Minimum distance of all pairs and of moving bodies from obstacles.

        Obstacles are pairs of geometry and transform.
        """
        return min(float(self.distances(q).min(initial=math.inf)), self.from_obstacles(q, obstacles))

    def from_obstacles(self, q, obstacles) -> float:
        """Minimum distance of moving bodies from obstacles (geometry, transform)."""
        pin.forwardKinematics(self.robot.model, self.data, np.asarray(q, dtype=float))
        found = []
        for joint, _, geometry, placement in self.shapes:
            if joint == 0:
                continue
            at = self.data.oMi[joint] * placement
            where = coal.Transform3s(at.rotation, at.translation)
            found += [distance(geometry, where, *obstacle) for obstacle in obstacles]
        return min(found, default=math.inf)


def distance(*pair) -> float:
    return coal.distance(*pair, coal.DistanceRequest(), coal.DistanceResult())


def _convex(geometry: pin.GeometryObject) -> coal.CollisionGeometry:
    shape = geometry.geometry
    if isinstance(shape, coal.BVHModelBase):
        shape.buildConvexHull(True, "Qt")
        return shape.convex
    return shape


def quintic(robot: Robot, start_deg, end_deg, duration: float = 6.0, count: int = 301) -> Trajectory:
    """A straight motion from rest to rest."""
    return straight(robot, np.radians(start_deg), np.radians(end_deg), duration, (count - 1) / duration)


def scene_of(start_deg, goal_deg=None, obstacles=(), **more) -> Scene:
    """A scene from one configuration to another."""
    goal = more.pop("goal", None) or Goal(joints_deg=tuple(start_deg if goal_deg is None else goal_deg))
    return Scene(name="s", start=Start(joints_deg=tuple(start_deg)), goal=goal, obstacles=tuple(obstacles), **more)
