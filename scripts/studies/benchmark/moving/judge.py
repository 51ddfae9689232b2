"""Motions among what moves, looked at by coal alone: links and obstacles placed anew at times close together."""

from __future__ import annotations

import math
from collections.abc import Callable

import coal
import numpy as np
from scipy.spatial.transform import Rotation, Slerp
from studies.benchmark.measure import times_until

from hplan.base.arrays import FloatArray
from hplan.errors import InputError
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Capsule, Sphere
from hplan.scene.tracks import Track

#: Spacing of the times [s].
STEP_S = 5e-4


def least_distance(
    robot: Robot, scene: Scene, positions: Callable[[FloatArray], FloatArray], end_s: float, step_s: float = STEP_S
) -> float:
    """Smallest distance of a link from an obstacle at times from 0 to the end of a motion [m].

    Args:
        robot: The arm; its links are the capsules about the axes between its joints.
        scene: Balls and capsules, some with a track.
        positions: (n,) times -> (n, dof) configurations.
        end_s: When the motion ends [s].
        step_s: Spacing of the times [s].
    """
    clock = times_until(end_s, step_s)
    configurations = positions(clock)
    shapes, places = [], []
    for item in scene.obstacles:
        if not isinstance(item, (Sphere, Capsule)):
            raise InputError(f"obstacle {item.name!r} is neither ball nor capsule", obstacle=item.name)
        core = item.core
        length = float(np.linalg.norm(core[-1] - core[0]))
        shapes.append(coal.Sphere(item.radius) if length == 0.0 else coal.Capsule(item.radius, length))
        listed = _along(core[0], core[-1])
        places.append([listed] * len(clock) if item.track is None else _placed(item.track, clock, listed))
    request, least = coal.DistanceRequest(), math.inf
    sizes = zip(robot.arm.half_widths, robot.arm.lengths, strict=True)
    links = [coal.Capsule(float(half), float(length)) for half, length in sizes]
    starts, ends = _axes(robot, configurations)
    rotations, middles = _frames(ends - starts), 0.5 * (starts + ends)
    for link, shape in enumerate(links):
        for number in range(len(clock)):
            at = coal.Transform3s(rotations[number, link], middles[number, link])
            for other, where in zip(shapes, places, strict=True):
                least = min(least, coal.distance(shape, at, other, where[number], request, coal.DistanceResult()))
    return least


def _axes(robot: Robot, configurations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, links, 3) both ends of the axes of the links."""
    ends = np.empty((2, len(configurations), robot.arm.link_count, 3))
    for number, q in enumerate(configurations):
        base, axes = robot.plane_at(robot.yaw_of(q))
        joints = base + robot.arm.joint_points(q[robot.arm_slice]) @ axes[:2]
        offset = robot.arm.lateral[:, None] * np.cross(axes[0], axes[1])
        ends[0, number], ends[1, number] = joints[:-1] + offset, joints[1:] + offset
    return ends[0], ends[1]


def _frames(axes: FloatArray) -> FloatArray:
    """(..., 3, 3) rotations whose z is along (..., 3) axes."""
    z = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    x = np.cross(z, np.eye(3)[np.abs(z).argmin(axis=-1)])
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _placed(track: Track, clock: FloatArray, listed: coal.Transform3s) -> list[coal.Transform3s]:
    """Where an obstacle is at times: interpolated here, not by what the certificate uses."""
    inside = np.clip(clock, track.times_s[0], track.times_s[-1])
    shifts = np.array([np.interp(inside, track.times_s, column) for column in np.array(track.shifts_m).T]).T
    turns = np.tile(np.eye(3), (len(clock), 1, 1))
    if track.rpy_deg is not None:
        turns = Slerp(track.times_s, Rotation.from_euler("xyz", track.rpy_deg, degrees=True))(inside).as_matrix()
    about = np.zeros(3) if track.about is None else np.array(track.about)
    place = listed.getTranslation()
    return [
        coal.Transform3s(turn @ listed.getRotation(), about + shift + turn @ (place - about))
        for turn, shift in zip(turns, shifts, strict=True)
    ]


def _along(start: FloatArray, end: FloatArray) -> coal.Transform3s:
    """A place in the middle of a segment, z along it."""
    axis = end - start
    if not axis.any():
        return coal.Transform3s(np.eye(3), start)
    return coal.Transform3s(_frames(axis), 0.5 * (start + end))
