"""MuJoCo model of a robot among a scene's obstacles.

MuJoCo is an optional dependency, imported on first use.
"""

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
from hplan.geometry.cloud import Cloud
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Capsule, Cylinder, Solid, Sphere

#: Contact bits of the links that may not push compliant obstacles, and of the links that may.
_FIRM, _PUSHES = 1, 2


def import_mujoco() -> ModuleType:
    """Import the module `mujoco`.

    Raises:
        InputError: MuJoCo is not installed.
    """
    with extra("execution", "executing a motion needs MuJoCo"):
        import mujoco
    module: ModuleType = mujoco
    return module


def mujoco_model(mujoco: ModuleType, robot: Robot, scene: Scene, *, timestep_s: float) -> tuple[Any, dict[int, str]]:
    """Build the MuJoCo model of the arm, with motors, among the obstacles.

    Args:
        mujoco: The module.
        robot: The arm; MuJoCo reads its URDF. Each joint gets a motor limited to the joint's torque limit.
        scene: The obstacles.
        timestep_s: Step of the simulation [s].

    Returns:
        The compiled `MjModel`, and the obstacle's name by the number of each of its geometries.

    Raises:
        InputError: A cloud has more than 2,000 balls.
        MovingObstacleError: An obstacle of the scene moves.
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
        # MuJoCo checks two geometries if contype of one and conaffinity of the other share a bit. Links have a contype
        # only and obstacles a conaffinity only, so contacts are between the arm and obstacles.
        meets = _PUSHES if geom.parent.name in pushing else _FIRM
        geom.contype, geom.conaffinity = meets if geom.contype or geom.conaffinity else 0, 0
    for name, limit in zip(robot.joint_names, robot.torque_limit.tolist(), strict=True):
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)  # a motor, of gain 1
        motor.ctrllimited, motor.ctrlrange = True, [-limit, limit]
    names = {}
    for number, obstacle in enumerate(scene.solids):
        # A compliant obstacle resists a link that may push it only from the permitted depth on: MuJoCo applies forces
        # at distances below the margin, and reports contacts at distances below margin + gap, which is 0 here.
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
    """Path of a URDF mesh, resolved as Pinocchio does.

    MuJoCo does not resolve URLs, and its parser keeps only one slash after the scheme.
    """
    scheme, colon, rest = name.partition(":")
    if colon and scheme == "package":
        return str((folder / rest.lstrip("/")).resolve())
    if colon and scheme == "file":
        return "/" + rest.lstrip("/")
    return str((folder / name).resolve())


def _shapes(mujoco: ModuleType, spec: Any, obstacle: Solid, number: int) -> list[dict[str, Any]]:
    """Arguments of the MuJoCo geometries that represent an obstacle."""
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
    # Maximum number of balls of a cloud, which bounds the cost of the simulation.
    most_balls = 2_000
    if isinstance(obstacle, Cloud):
        if len(obstacle.core) > most_balls:
            raise InputError(
                f"obstacle {obstacle.name!r} has {len(obstacle.core)} balls, too many for MuJoCo; downsample it to "
                f"at most {most_balls} points to execute the motion",
                obstacle=obstacle.name,
                balls=len(obstacle.core),
            )
        size = [obstacle.rounding, 0.0, 0.0]
        return [{"type": kinds.mjGEOM_SPHERE, "pos": center, "size": size} for center in obstacle.core]
    name = f"obstacle:{number}"
    mesh = spec.add_mesh(name=name, uservert=obstacle.hull.grown_corners.ravel())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # small hulls have too little volume for a solid inertia
    return [{"type": kinds.mjGEOM_MESH, "meshname": name}]
