"""Independent checks of motions: contacts by `studies.validation.judge`, limits by differences."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin
from studies.harness import Row
from studies.validation import judge
from studies.validation.judge import TICK_S, Arm, JudgedObstacle, SampledMotion

from hplan.base.arrays import FloatArray
from hplan.errors import InputError
from hplan.robot.files import named_robot
from hplan.robot.model import Robot
from hplan.scene.cell import CellScene
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import FromData
from hplan.trajectory.trajectory import Trajectory
from hplan.workcell.cell import Cell

#: Time between the samples for limits [s]; distance between looks at a polyline, of the joint that moves most [rad, m].
EVERY_S, EVERY = 1e-3, 5e-3


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """A motion as a function of time: duration [s], and (n,) times -> (n, dof) configurations."""

    duration: float
    positions: Callable[[FloatArray], FloatArray]


#: A motion from any source, or hplan's samples with cubics between them.
Motion = TimedMotion | Trajectory


def contacts(robot: Robot, scene: Scene, motion: Motion) -> tuple[int, int]:
    """Numbers of contacts with obstacles and fruit, and of contacts between bodies of the robot, along a motion."""
    return _contacts_at(robot, scene, np.append(np.arange(0.0, motion.duration, TICK_S), motion.duration), motion)


def path_is_clear(robot: Robot, scene: Scene, path: FloatArray) -> bool:
    """True if closely spaced (n, dof) configurations are all collision-free."""
    numbers = np.arange(len(path), dtype=np.float64)
    return not any(_contacts_at(robot, scene, numbers, TimedMotion(numbers[-1], lambda _: path)))


def polyline_is_clear(robot: Robot, scene: Scene, path: FloatArray) -> bool:
    """True if the straight motions between (m, dof) waypoints are collision-free, looked at every `EVERY`."""
    ends = itertools.pairwise(path)
    parts = [np.linspace(a, b, max(2, int(np.ceil(np.abs(b - a).max() / EVERY)) + 1)) for a, b in ends]
    return path_is_clear(robot, scene, np.concatenate(parts))


def _contacts_at(robot: Robot, scene: Scene, clock: FloatArray, motion: Motion) -> tuple[int, int]:
    found = _found(robot, scene, SampledMotion(robot.joint_names, clock, motion.positions(clock)))
    own = {body.name for body in arm_of(robot).bodies}
    return sum(contact.second not in own for contact in found), sum(contact.second in own for contact in found)


def _found(robot: Robot, scene: Scene, motion: SampledMotion) -> list[judge.Contact]:
    return judge.contacts(arm_of(robot), motion, obstacles_of(scene))


def between_arms(cell: Cell, more: Sequence[pin.GeometryObject] = ()) -> pin.GeometryModel:
    """The original meshes of a workcell and of `more`, with the pairs of different arms."""
    geometry = pin.GeometryModel(cell.robot.collision_model)
    geometry.removeAllCollisionPairs()
    for body in more:
        geometry.addGeometryObject(body)
    frames = cell.robot.model.frames
    owners = [cell.owner(frames[body.parentFrame].name) for body in geometry.geometryObjects]
    for i, j in itertools.combinations(range(len(owners)), 2):
        if owners[i] != owners[j]:
            geometry.addCollisionPair(pin.CollisionPair(i, j))
    return geometry


def obstacles_of(scene: Scene | CellScene) -> list[JudgedObstacle]:
    """Obstacles and fruit for the judge, in the scene's frame."""
    items = [obstacle.model_dump(mode="json", by_alias=True) for obstacle in scene.obstacles]
    for item, obstacle in zip(items, scene.obstacles, strict=True):
        if isinstance(obstacle, FromData):  # dumps have no data; the judge places it itself
            item |= {key: getattr(obstacle._data, key, None) for key in ("vertices", "faces", "points")}
        for key in ("track", "sway"):  # dumps of scenes have neither
            moves = getattr(obstacle, key, None)
            item[key] = None if moves is None else moves.model_dump()
    return judge.read_obstacles([*items, *({"kind": "sphere", **fruit.model_dump()} for fruit in scene.fruits)])


def arm_of(robot: Robot) -> Arm:
    """The robot as the judge reads it."""
    touch = tuple((first, second) for first, second, _ in robot.may_touch)
    # Several arms as one robot have no file. For others the file is read: in the text, held joints are already fixed.
    urdf = robot.urdf_path if robot.urdf_path.is_file() else robot.urdf_text or robot.urdf_path
    return _arm(urdf, tuple(robot.held.items()), touch, robot.tool_frame)


@cache
def _arm(
    urdf: Path | str, held: tuple[tuple[str, float | None], ...], touch: tuple[tuple[str, str], ...], tool_frame: str
) -> Arm:
    if isinstance(urdf, str):
        with TemporaryDirectory() as folder:
            file = Path(folder, "robot.urdf")
            file.write_text(urdf, encoding="utf-8")
            return _arm(file, held, touch, tool_frame)
    folders = [folder for folder in urdf.parents if len(folder.parts) > 2]
    with suppress(InputError):
        folders += named_robot("panda").package_dirs
    return Arm(urdf, held=dict(held), package_dirs=folders, may_touch=touch, tool_frame=tool_frame)


def findings(robot: Robot, scene: Scene, motion: Motion, every_s: float = EVERY_S) -> Row:
    """Contacts and use of limits at fine samples of a motion.

    Velocity and acceleration are differences of equally spaced positions, torque is inverse dynamics of these.
    """
    clock = np.linspace(0.0, motion.duration, max(3, int(np.ceil(motion.duration / every_s)) + 1))
    h, q = clock[1], motion.positions(clock)
    v, a = (q[2:] - q[:-2]) / (2.0 * h), (q[2:] - 2.0 * q[1:-1] + q[:-2]) / h**2
    data = robot.model.createData()
    torque = np.array([pin.rnea(robot.model, data, *row) for row in zip(q[1:-1], v, a, strict=True)])
    found = _found(robot, scene, SampledMotion(robot.joint_names, clock, q))
    return {
        "samples": len(q),
        "contacts": len(found),
        "depth_mm": 1e3 * max((contact.depth_m for contact in found), default=0.0),
        "outside_deg": float(np.degrees(np.maximum(robot.lower - q, q - robot.upper).max().clip(0.0))),
        "velocity": float((np.abs(v) / robot.velocity_limit).max()),
        "acceleration": float((np.abs(a) / robot.acceleration_limit).max()),
        "torque": float((np.abs(torque) / robot.torque_limit).max()),
    }
