"""Writes members of the robot family as URDF and limits file.

A member has an optional yaw about the vertical, then n >= 1 revolute joints with parallel horizontal axes: a planar arm
on a turret. `ArmSpec` specifies it, `write_robot` writes its two files, and `cross_check` compares the results of two
independent URDF readers, Pinocchio and yourdfpy. The robot that ships with hplan is `HARVESTER`.

Every arm link is a segment along its own +x axis. Its collision shape is an exact capsule around the segment, written
as one `<cylinder>` and two `<sphere>` elements, because URDF has no capsule that every tool reads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin

from hplan.base.arguments import check_integer, file_path, instance
from hplan.base.data_files import LIMITS_SUFFIX
from hplan.base.files import write_text
from hplan.errors import OptionError, OutputError, RobotFileError
from hplan.robot.family.spec import HARVESTER, ArmSpec
from hplan.robot.files import read_models
from hplan.robot.model import Robot, load_robot

__all__ = ["HARVESTER", "ArmSpec", "CrossCheck", "cross_check", "load_member", "write_robot"]


def write_robot(spec: ArmSpec, urdf_path: Path | str) -> tuple[Path, Path]:
    """Write a family member's URDF, and its limits next to it.

    Args:
        urdf_path: Path of the URDF in an existing folder; its suffix is `.urdf`.

    Returns:
        Paths of the URDF and of the limits file (`NAME.urdf` and `NAME.limits.yaml`).

    Raises:
        OptionError: The path does not end in `.urdf`.
        OutputError: A file cannot be written; no partially written file remains.
    """
    from hplan.robot.family.urdf import limits_text, urdf_text

    instance("spec", spec, ArmSpec)
    urdf_path = file_path("urdf_path", urdf_path)
    if urdf_path.suffix != ".urdf":
        raise OptionError("urdf_path", str(urdf_path), "a file name ending in .urdf")
    limits_path = urdf_path.with_suffix(LIMITS_SUFFIX)
    texts = {limits_path: limits_text(spec), urdf_path: urdf_text(spec)}
    for path in texts:
        # Checked before the first file is written, or one file would be left without the other.
        if path.is_dir():
            raise OutputError(path, "it is a folder")
    for path, text in texts.items():
        write_text(path, text)
    return urdf_path, limits_path


def load_member(spec: ArmSpec) -> Robot:
    """Load a family member as a robot, using temporary files.

    Raises:
        OptionError: `spec` is not an `ArmSpec`.
    """
    with TemporaryDirectory() as folder:
        return load_robot(write_robot(instance("spec", spec, ArmSpec), Path(folder) / f"{spec.name}.urdf")[0])


@dataclass(frozen=True)
class CrossCheck:
    """Differences between Pinocchio's and yourdfpy's readings of the same URDF.

    Attributes:
        frames: Names of the compared link frames.
        samples: Number of random configurations.
        max_position_deviation: Maximum distance between the two placements of a frame [m].
        max_rotation_deviation: Maximum angle between them [rad].
        limits_equal: True if position, velocity and effort limits agree to the last bit.
        masses_equal: True if the mass that each joint carries, up to the next joint, agrees to a relative 1e-12.
    """

    frames: tuple[str, ...]
    samples: int
    max_position_deviation: float
    max_rotation_deviation: float
    limits_equal: bool
    masses_equal: bool


def cross_check(urdf_path: Path | str, samples: int = 100, seed: int = 0) -> CrossCheck:
    """Compare Pinocchio's and yourdfpy's readings of a URDF; return the deviations.

    Args:
        urdf_path: The file; all of its movable joints are revolute or prismatic.
        samples: Number of random configurations; all link frames are compared at each.

    Raises:
        OptionError: `samples` is not positive.
        RobotFileError: The file cannot be read, or has a movable joint of another kind.
    """
    import yourdfpy

    check_integer("samples", samples, 1)
    check_integer("seed", seed, 0)
    path = file_path("urdf_path", urdf_path)
    model, _, _ = read_models(path)
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if joint.nq != 1:
            raise RobotFileError(path, f"joint {name!r} is neither revolute nor prismatic")
    reader = yourdfpy.URDF.load(str(path), build_scene_graph=True, load_meshes=False)
    frames = tuple(link.name for link in reader.robot.links)
    position, rotation = _frame_deviations(model, reader, frames, samples, seed)
    return CrossCheck(
        frames=frames,
        samples=samples,
        max_position_deviation=position,
        max_rotation_deviation=rotation,
        limits_equal=_limits_equal(model, reader),
        masses_equal=_masses_equal(model, reader),
    )


def _frame_deviations(model: Any, reader: Any, frames: Sequence[str], samples: int, seed: int) -> tuple[float, float]:
    """Maximum distance [m] and angle [rad] between the two readers' placements."""
    data = model.createData()
    names = list(model.names)[1:]
    lower = np.maximum(model.lowerPositionLimit, -math.pi)
    upper = np.minimum(model.upperPositionLimit, math.pi)
    rng = np.random.default_rng(seed)
    position = rotation = 0.0
    for q in rng.uniform(lower, upper, (samples, model.nq)):
        pin.framesForwardKinematics(model, data, q)
        reader.update_cfg({name: float(angle) for name, angle in zip(names, q, strict=True)})
        for frame in frames:
            placement = data.oMf[model.getFrameId(frame, pin.BODY)].homogeneous
            difference = placement - reader.get_transform(frame)
            position = max(position, float(np.linalg.norm(difference[:3, 3])))
            # From the chord between the rotations: acos of the trace loses half the digits near zero.
            chord = float(np.linalg.norm(difference[:3, :3])) / math.sqrt(8.0)
            rotation = max(rotation, 2.0 * math.asin(min(1.0, chord)))
    return position, rotation


def _limits_equal(model: Any, reader: Any) -> bool:
    joints = [reader.joint_map[name] for name in list(model.names)[1:]]
    pairs = [
        (model.lowerPositionLimit, [joint.limit.lower for joint in joints]),
        (model.upperPositionLimit, [joint.limit.upper for joint in joints]),
        (model.velocityLimit, [joint.limit.velocity for joint in joints]),
        (model.effortLimit, [joint.limit.effort for joint in joints]),
    ]
    return all(np.array_equal(np.asarray(ours), np.asarray(theirs)) for ours, theirs in pairs)


def _masses_equal(model: Any, reader: Any) -> bool:
    """True if the masses agree joint by joint.

    Pinocchio merges links joined by fixed joints.
    """
    movers = {joint.child: joint for joint in reader.robot.joints}
    names = list(model.names)
    totals = [0.0] * len(names)
    for link in reader.robot.links:
        carrier = link.name
        while carrier in movers and movers[carrier].type == "fixed":
            carrier = movers[carrier].parent
        joint = names.index(movers[carrier].name) if carrier in movers else 0
        if link.inertial is not None and link.inertial.mass is not None:
            totals[joint] += link.inertial.mass
    return all(
        math.isclose(inertia.mass, total, rel_tol=1e-12) for inertia, total in zip(model.inertias, totals, strict=True)
    )
