"""Markers for a planning node: the arm's collision bodies, its motion, and what blocks it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import coal
import numpy as np

from hplan.apps.ros import marked_scene as mark
from hplan.apps.ros.marked_motion import path_marker, words_marker
from hplan.apps.ros.marked_scene import Marker, scene_markers
from hplan.apps.ros.transforms import xyz
from hplan.certificate.certificate import Certificate
from hplan.collision.collision_bodies import body_shapes, collision_bodies
from hplan.errors import HplanError
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.trajectory.trajectory import Trajectory

#: Namespaces, and the most points of a path.
_ARM, _PROBLEM, _POINTS = "arm", "problem", 200


def arm_markers(robot: Robot) -> list[Marker]:
    """Collision bodies of an arm in the frames of its links, which `/tf` moves.

    Examples:
        >>> from hplan import load_robot
        >>> markers = arm_markers(load_robot())
        >>> markers[0]["ns"], len({marker["header"]["frame_id"] for marker in markers}) > 1
        ('arm', True)
    """
    frames = {frame.name: frame for frame in robot.model.frames.tolist()}
    found = list[Marker]()
    for body, shape in zip(collision_bodies(robot), body_shapes(robot), strict=True):
        frame = frames.get(body.name)
        if frame is None:
            continue
        place = frame.placement.actInv(shape.placement)
        for part in _parts_of(shape.geometry, place):
            top = mark.head(frame_id=body.name, ns=_ARM, number=len(found))
            found.append(top | part | {"color": mark.color(0x8C959F, 0.35)})
    return found


def _parts_of(geometry: Any, place: Any) -> Iterable[Marker]:
    """Markers of a shape at a pose."""
    at = mark.pose(place.translation, place.rotation)
    if isinstance(geometry, coal.Sphere):
        yield mark.ball(place.translation, geometry.radius)
    elif isinstance(geometry, coal.Box):
        yield {"type": mark.CUBE, "pose": at, "scale": xyz(2.0 * geometry.halfSide)}
    elif isinstance(geometry, coal.Capsule):
        wide, half = 2.0 * geometry.radius, geometry.halfLength
        yield {"type": mark.CYLINDER, "pose": at, "scale": xyz((wide, wide, 2.0 * half))}
        for side in (-half, half):
            yield mark.ball(place.act(np.array([0.0, 0.0, side])), geometry.radius)
    elif isinstance(geometry, coal.ConvexBase):
        points = geometry.points()
        faces = [geometry.polygons(number) for number in range(geometry.num_polygons)]
        corners = np.array([points[face[corner]] for face in faces for corner in range(3)])
        one = xyz((1.0, 1.0, 1.0))
        yield {"type": mark.TRIANGLES, "pose": at, "scale": one, "points": mark.points(corners)}


def motion_markers(robot: Robot, trajectory: Trajectory, certificate: Certificate, frame_id: str) -> list[Marker]:
    """Path of the tool and the certificate in words; removes the markers of a problem."""
    clock = np.linspace(0.0, trajectory.duration, _POINTS)
    positions = trajectory.positions(clock)
    shown = [path_marker(robot, positions, frame_id), words_marker(robot, positions, certificate, frame_id)]
    return [*_no_problem(frame_id), *shown]


def problem_markers(robot: Robot, scene: Scene, error: HplanError, frame_id: str) -> list[Marker]:
    """The message of an error above the base, and the obstacle that it names, in red."""
    height_m = 0.06
    top = float(robot.tool_positions(robot.lower[None])[0, 2])
    words = mark.head(frame_id=frame_id, ns=_PROBLEM, number=0) | {
        "type": mark.TEXT,
        "pose": mark.pose((0.0, 0.0, max(top, 0.0) + 0.5)),
        "scale": xyz((0.0, 0.0, height_m)),
        "color": mark.color(0xD7263D),
        "text": error.message[:200],
    }
    name = getattr(error, "obstacle", None)
    blocking = tuple(item for item in scene.obstacles if item.name == name)
    alone = scene.copy_unchecked({"obstacles": blocking, "fruits": ()})
    shapes = scene_markers(alone, frame_id) if blocking else []
    return [
        *_no_problem(frame_id),
        words,
        *(marker | {"ns": _PROBLEM, "id": k, "color": mark.color(0xD7263D, 0.8)} for k, marker in enumerate(shapes, 1)),
    ]


def _no_problem(frame_id: str) -> list[Marker]:
    """Markers that remove those of a problem: an obstacle has at most a few."""
    most = 8
    return [mark.head(frame_id=frame_id, ns=_PROBLEM, number=k) | {"action": mark.DELETE} for k in range(most)]
