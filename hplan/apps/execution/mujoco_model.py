"""A robot among a scene's obstacles as a model of MuJoCo, an extra that is imported on first use."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Any

import pinocchio as pin

from hplan.base.lazy_import import extra
from hplan.collision.giving_way import pushing_links, yielded
from hplan.errors import InputError, RobotFileError
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Capsule, Cylinder, Solid, Sphere
from hplan.scene.solids import Cloud

#: Bits of what meets links that may push what gives way, and all others.
_FIRM, _PUSHES = 1, 2


def import_mujoco() -> ModuleType:
    """The module `mujoco`.

    Raises:
        InputError: It is not installed.
    """
    with extra("execution", "executing a motion needs MuJoCo"):
        import mujoco
    module: ModuleType = mujoco
    return module


def mujoco_model(mujoco: ModuleType, robot: Robot, scene: Scene, *, timestep_s: float) -> tuple[Any, dict[int, str]]:
    """The arm with motors among the obstacles, and the obstacle's name for each geometry that is one.

    Raises:
        InputError: A cloud of more than 2,000 balls.
        RobotFileError: MuJoCo refuses the URDF.
    """
    try:
        text = robot.urdf_text
        spec = mujoco.MjSpec.from_file(str(robot.urdf_path)) if text is None else mujoco.MjSpec.from_string(text)
    except ValueError as error:
        raise RobotFileError(robot.urdf_path, f"MuJoCo refuses it: {error}") from error
    for mesh in spec.meshes:
        mesh.file = _mesh_file(mesh.file, robot.urdf_path.parent)
    spec.option.timestep = timestep_s
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    depths = yielded(
        robot, scene.solids, scene.yield_links, () if scene.goal_fruit is None else scene.goal_fruit.hangs_from
    )
    pushing = () if depths is None else pushing_links(robot, scene.yield_links)
    for geom in spec.geoms:
        # Two geometries meet where a bit is in the type of one and the affinity of the other: arm and obstacle only.
        meets = _PUSHES if geom.parent.name in pushing else _FIRM
        geom.contype, geom.conaffinity = meets if geom.contype or geom.conaffinity else 0, 0
    for name, limit in zip(robot.joint_names, robot.torque_limit.tolist(), strict=True):
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)  # a motor, of gain 1
        motor.ctrllimited, motor.ctrlrange = True, [-limit, limit]
    names = {}
    for number, obstacle in enumerate(scene.solids):
        # To links that may push it what gives way offers no resistance until it is as deep as it may be: geometries
        # resist where they are nearer than their margin, and are told where they are nearer than that and their gap.
        yields = 0.0 if depths is None else float(depths[number])
        sides = ((_FIRM | _PUSHES, 0.0),) if yields == 0.0 else ((_FIRM, 0.0), (_PUSHES, yields))
        for part, (shape, (meets, gap)) in enumerate(product(_shapes(mujoco, spec, obstacle, number), sides)):
            label = f"obstacle:{number}:{part}"
            names[label] = obstacle.name
            spec.worldbody.add_geom(name=label, contype=0, conaffinity=meets, margin=-gap, gap=gap, **shape)
    try:
        model = spec.compile()
    except ValueError as error:
        raise RobotFileError(robot.urdf_path, f"MuJoCo refuses it: {error}") from error
    return model, {model.geom(label).id: name for label, name in names.items()}


def _mesh_file(name: str, folder: Path) -> str:
    """A mesh of the URDF where Pinocchio finds it; MuJoCo knows no URLs, and has left one slash of theirs."""
    scheme, colon, rest = name.partition(":")
    if colon and scheme == "package":
        return str((folder / rest.lstrip("/")).resolve())
    if colon and scheme == "file":
        return "/" + rest.lstrip("/")
    return str((folder / name).resolve())


def _shapes(mujoco: ModuleType, spec: Any, obstacle: Solid, number: int) -> list[dict[str, Any]]:
    """Arguments of MuJoCo's geometries for an obstacle."""
    kinds = mujoco.mjtGeom
    if isinstance(obstacle, Sphere):
        return [{"type": kinds.mjGEOM_SPHERE, "pos": obstacle.center, "size": [obstacle.radius, 0.0, 0.0]}]
    if isinstance(obstacle, Capsule):
        size = [obstacle.radius, 0.0, 0.0]
        if math.dist(obstacle.start, obstacle.end) < 1e-9:
            return [{"type": kinds.mjGEOM_SPHERE, "pos": obstacle.start, "size": size}]
        return [{"type": kinds.mjGEOM_CAPSULE, "fromto": [*obstacle.start, *obstacle.end], "size": size}]
    if isinstance(obstacle, Box | Cylinder):
        turn = pin.Quaternion(obstacle.rotation)
        if isinstance(obstacle, Box):
            kind, size = kinds.mjGEOM_BOX, [0.5 * side for side in obstacle.size]
        else:
            kind, size = kinds.mjGEOM_CYLINDER, [obstacle.radius, 0.5 * obstacle.length, 0.0]
        return [{"type": kind, "pos": obstacle.center, "quat": [turn.w, turn.x, turn.y, turn.z], "size": size}]
    # Most balls of a cloud that MuJoCo is given.
    most_balls = 2_000
    if isinstance(obstacle, Cloud):
        if len(obstacle.core) > most_balls:
            raise InputError(
                f"obstacle {obstacle.name!r} has {len(obstacle.core)} balls, too many for MuJoCo; thin its points to "
                f"at most {most_balls} to execute the motion",
                obstacle=obstacle.name,
                balls=len(obstacle.core),
            )
        size = [obstacle.rounding, 0.0, 0.0]
        return [{"type": kinds.mjGEOM_SPHERE, "pos": center, "size": size} for center in obstacle.core]
    name = f"obstacle:{number}"
    mesh = spec.add_mesh(name=name, uservert=obstacle.hull.grown_corners.ravel())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # small pieces have too little volume for it
    return [{"type": kinds.mjGEOM_MESH, "meshname": name}]
