"""SHA-256 digests that identify the subjects of a certificate.

The subjects are a robot, a scene and a trajectory. The digests are computed from the parsed data, not from the files:
comments, angle units in a URDF and mesh paths do not affect them; every number that planning or proof uses does.

- **Robot**: names, joint frames and axes, masses, inertias, limits, links, link pairs that may touch, and all collision
  shapes with vertices and triangles of their meshes, and all frames, which goals may name; without the objects that it
  holds, which belong to the scene. Numbers are rounded to 12 decimals, since sines differ in the last bit from machine
  to machine.
- **Scene**: its keys and values as in a scene file, held objects included, and for each mesh or cloud the data instead
  of the file's name.
- **Trajectory**: the joint names and the numbers of the CSV, bit by bit, and the curve between rows unless cubic.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray
from hplan.robot.model import Robot, made_once
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import FromData
from hplan.scene.obstacles import Capsule
from hplan.scene.tracks import Drift, Sway, Track
from hplan.trajectory.trajectory import Trajectory, as_table


class Digests:
    """Digests of the subjects of a certificate, each computed when it is first read.

    Each is the text `sha256:` and 64 hexadecimal digits. A motion that replaces another within milliseconds is followed
    before anybody reads its digests. The subjects cannot change: their arrays are read-only.
    """

    def __init__(self, robot: Robot, scene: Scene, trajectory: Trajectory) -> None:
        self._subjects = robot, scene, trajectory

    @cached_property
    def robot(self) -> str:
        """Digest of the robot."""
        return robot_digest(self._subjects[0])

    @cached_property
    def scene(self) -> str:
        """Digest of the scene."""
        return scene_digest(self._subjects[1])

    @cached_property
    def trajectory(self) -> str:
        """Digest of the trajectory."""
        return trajectory_digest(self._subjects[2])

    def as_dict(self) -> dict[str, str]:
        """The digests by the names of their subjects."""
        return {"robot": self.robot, "scene": self.scene, "trajectory": self.trajectory}

    def __repr__(self) -> str:
        return f"Digests({', '.join(f'{what}={digest!r}' for what, digest in self.as_dict().items())})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Digests) and self.as_dict() == other.as_dict()

    def __hash__(self) -> int:
        return hash(tuple(self.as_dict().values()))

    def __getstate__(self) -> dict[str, str]:
        """The digests without their subjects."""
        return self.as_dict()


def trajectory_digest(trajectory: Trajectory) -> str:
    """Digest of a trajectory; writing to CSV and reading back preserve it."""
    found = _Digest("hplan-trajectory/1")
    found.add_text(*trajectory.joint_names)
    found.add_exactly(as_table(trajectory))
    if trajectory.interpolation != "cubic":
        found.add_text("interpolation", trajectory.interpolation)
    return found.word


def scene_digest(scene: Scene) -> str:
    """Digest of a scene, independent of the paths of its files."""
    found = _Digest(scene.format)
    read = [obstacle for obstacle in scene.obstacles if isinstance(obstacle, FromData)]
    # `exclude` makes the dump five times slower, even if it matches no field.
    found.add_text(scene.model_dump_json(exclude={"obstacles": {"__all__": {"file"}}} if read else None))
    for obstacle in read:
        found.add_text(obstacle.data_digest)
    for held in scene.attached:
        found.add_text("attached", held.model_dump_json(exclude={"object": {"file"}}))
        if isinstance(held.object, FromData):
            found.add_text(held.object.data_digest)
    for name, key, value in _iterate_tracks(scene):
        found.add_text(name, key, value.model_dump_json())
    for item in (*scene.obstacles, *scene.fruits):
        if item.yields:
            found.add_text(item.name, "yields", repr(item.yields))
        if item.covariance is not None:
            found.add_text(item.name, "covariance")
            found.add_exactly(np.array(item.covariance))
    if scene.covariance is not None:
        found.add_text("covariance")
        found.add_exactly(np.array(scene.covariance))
    for fruit in scene.fruits:
        if fruit.hangs_from:
            found.add_text(fruit.name, "hangs_from", *fruit.hangs_from)
        if fruit.grasp_offset:
            found.add_text(fruit.name, "grasp_offset", repr(fruit.grasp_offset))
    if scene.yield_links is not None:
        found.add_text("yield_links", *scene.yield_links)
    if scene.wood is not None:
        found.add_text("wood", scene.wood.model_dump_json())
        found.add_text(*(f"{o.name} {o.parent}" for o in scene.obstacles if isinstance(o, Capsule) and o.parent))
    if scene.upright is not None:
        found.add_text("upright", scene.upright.model_dump_json())
    if scene.start.contact_depth is not None:
        found.add_text("contact_depth", repr(scene.start.contact_depth))
    for key, named in (("start", scene.start.joints), ("goal", scene.goal.joints)):
        if named is not None:
            found.add_text(key, *(f"{name}={value!r}" for name, value in sorted(named.items())))
    if scene.goal.quaternion_xyzw is not None:
        found.add_text("goal", scene.goal.frame or "")
        found.add_exactly(np.array(scene.goal.quaternion_xyzw))
        if scene.goal.rotation_tolerance_deg is not None:
            found.add_exactly(np.array(scene.goal.rotation_tolerance_deg))
    if scene.start.is_moving:
        for key, values in scene.start.rates.items():
            found.add_text(key)
            found.add_exactly(np.array(values))
    return found.word


def _iterate_tracks(scene: Scene) -> Iterator[tuple[str, str, Track | Drift | Sway]]:
    """Name, key and value of tracks, drifts and sways.

    A JSON dump omits these.
    """
    for item in (*scene.obstacles, *scene.fruits):
        drift = None if item.track is None else item.track.drift
        for key, value in (("track", item.track), ("drift", drift), ("sway", item.sway)):
            if value is not None:
                yield item.name, key, value
    if scene.base_track is not None:
        yield "", "base_track", scene.base_track


@made_once
def robot_digest(robot: Robot) -> str:
    """Digest of a robot, cached."""
    robot = robot.loaded.bare
    found, model = _Digest("hplan-robot/2"), robot.model
    found.add_text(robot.name, robot.tool_frame, *robot.joint_names, *itertools.chain(*robot.may_touch))
    for frame in model.frames:  # a goal may name any of them
        found.add_text(frame.name, str(frame.parentJoint))
        for place in _placement_numbers(frame.placement):
            found.add_rounded(place)
    for values in (
        *(robot.lower, robot.upper),
        *(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit),
        *(np.zeros(0) if robot.jerk_limit is None else robot.jerk_limit, model.gravity.linear, model.armature),
    ):
        found.add_rounded(values)
    for number, joint in enumerate(model.joints.tolist()[1:], start=1):
        inertia, axis = model.inertias[number], joint.createData()
        joint.calc(axis, np.zeros(joint.nq))
        found.add_text(joint.shortname(), str(model.parents[number]))
        for values in (
            np.array(axis.S),
            *_placement_numbers(model.jointPlacements[number]),
            inertia.lever,
            inertia.inertia,
        ):
            found.add_rounded(values)
        found.add_rounded(inertia.mass)
    for shape in robot.collision_model.geometryObjects:
        found.add_text(shape.name, str(shape.parentJoint))
        for values in (*_placement_numbers(shape.placement), *_sizes(shape)):
            found.add_rounded(values)
    return found.word


def _placement_numbers(placement: pin.SE3) -> tuple[FloatArray, FloatArray]:
    return placement.rotation, placement.translation


def _sizes(shape: pin.GeometryObject) -> list[ArrayLike]:
    """Dimensions of a shape; of a mesh its vertices and triangles."""
    geometry: Any = shape.geometry
    if isinstance(geometry, coal.BVHModelBase):
        corners = (geometry.tri_indices(number) for number in range(geometry.num_tris))
        return [geometry.vertices(), np.array([[a[0], a[1], a[2]] for a in corners]).reshape(-1, 3)]
    if isinstance(geometry, coal.Box):
        return [geometry.halfSide]
    if isinstance(geometry, coal.Sphere):
        return [geometry.radius]
    if isinstance(geometry, coal.Capsule | coal.Cylinder | coal.Cone):
        return [geometry.radius, geometry.halfLength]
    geometry.computeLocalAABB()
    return [geometry.aabb_local.min_, geometry.aabb_local.max_]


class _Digest:
    """Incremental SHA-256 of texts and arrays, each preceded by its size."""

    def __init__(self, what: str) -> None:
        self._hash = hashlib.sha256()
        self.add_text(what)

    @property
    def word(self) -> str:
        """The digest as text, with the prefix `sha256:`."""
        return f"sha256:{self._hash.hexdigest()}"

    def add_text(self, *texts: str) -> None:
        """Add texts."""
        for text in texts:
            data = text.encode()
            self._hash.update(b"%d:" % len(data))
            self._hash.update(data)

    def add_exactly(self, values: FloatArray) -> None:
        """Add numbers bit by bit; -0.0 counts as 0.0."""
        self._hash.update(str(values.shape).encode())
        self._hash.update(np.ascontiguousarray(values + 0.0, dtype="<f8").tobytes())

    def add_rounded(self, values: ArrayLike) -> None:
        """Add numbers, rounded to 12 decimals."""
        rounded: FloatArray = np.asarray(values, dtype=np.float64).round(12)
        self.add_exactly(rounded)
