"""Markers of a motion and its certificate.

They show the tool path, the nearest pair, picked fruit, and the certificate in words.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from hplan.apps.ros import marked_scene as mark
from hplan.apps.ros.marked_scene import FRUITS, Marker, fruit_marker
from hplan.apps.ros.transforms import LinkFrames, xyz
from hplan.apps.view.scenery import PICKED_COLOR, Pick
from hplan.base.arrays import FloatArray
from hplan.base.units import at_least_mm
from hplan.certificate.certificate import Certificate
from hplan.certificate.clearance_curve import ClearanceCurve
from hplan.collision.coal_shapes import link_shapes, solid_shape
from hplan.geometry.cloud import Cloud
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.trajectory.trajectory import Trajectory

#: Namespace of the markers of motion and certificate, with ids 0 to 2.
_CERTIFICATE: Final = "certificate"


def path_marker(robot: Robot, positions: FloatArray, frame_id: str) -> Marker:
    """Line marker of the tool path through (n, dof) configurations."""
    line = mark.points(robot.tool_positions(positions))
    if len(line) == 1:
        line *= 2
    return mark.head(frame_id=frame_id, ns=_CERTIFICATE, number=0) | {
        "type": mark.LINE_STRIP,
        "pose": mark.pose(),
        "scale": xyz((0.004, 0.0, 0.0)),
        "color": mark.color(0x1F6FEB),
        "points": line,
    }


def words_marker(robot: Robot, positions: FloatArray, certificate: Certificate, frame_id: str) -> Marker:
    """Text marker with the certificate's verdict.

    It is above the base and above all tool positions of the (n, dof) configurations.
    """
    height_m = 0.08
    place = [0.0, 0.0, float(robot.tool_positions(positions)[:, 2].max()) + 2.0 * height_m]
    return mark.head(frame_id=frame_id, ns=_CERTIFICATE, number=1) | {
        "type": mark.TEXT,
        "pose": mark.pose(place),
        "scale": xyz((0.0, 0.0, height_m)),
        "color": mark.color(0x2DA44E if certificate.verified else 0xD7263D),
        "text": certificate_text(certificate),
    }


def certificate_text(certificate: Certificate) -> str:
    """Certificate in two lines: verdict and clearance, then the nearest pair."""
    if not certificate.verified:
        return f"not certified\n{certificate.violations[0] if certificate.violations else ''}".rstrip()
    if certificate.nearest is None:
        return "certified\nno obstacles"
    words = f"certified: {at_least_mm(certificate.min_clearance_m)} mm or more, for all times"
    return f"{words}\nnearest: {certificate.nearest.link} to {certificate.nearest.obstacle}"


class NearestPairs:
    """Lines between the nearest links and obstacles of a motion."""

    def __init__(self, robot: Robot, scene: Scene, certificate: Certificate, frame_id: str) -> None:
        self._robot, self._frame_id = robot, frame_id
        self._curve: ClearanceCurve | None = certificate.clearance_curve
        self._pairs: Sequence[tuple[str, str]] = ()
        if self._curve is not None:
            self._pairs = self._curve.pairs
        elif certificate.nearest is not None:
            self._pairs = ((certificate.nearest.link, certificate.nearest.obstacle),)
        self._links: dict[str, pin.GeometryObject] = {}
        if robot.planar is not None:
            self._links = dict(zip(robot.arm.link_names, link_shapes(robot, "capsule"), strict=True))
        self._data = robot.model.createData()
        self._solids: dict[str, list[pin.GeometryObject | Cloud]] = {name: [] for _, name in self._pairs}
        for solid in scene.listed_solids:
            if solid.name in self._solids:
                self._solids[solid.name].append(solid if isinstance(solid, Cloud) else solid_shape(solid))

    def clearance_m(self, time_s: float) -> float | None:
        """Certified clearance at a time [m]; None if unknown."""
        if self._curve is None:
            return None
        found = float(np.interp(time_s, self._curve.time, self._curve.clearance_m))
        return found if np.isfinite(found) else None

    def marker(self, time_s: float, q: FloatArray, moved: Mapping[str, pin.SE3]) -> Marker:
        """Line marker of the nearest pair at a time and configuration.

        It is empty for a self-collision pair and without a pair.

        Args:
            time_s: Time of the motion [s].
            q: (dof,) configuration.
            moved: Displacements of moving obstacles at this time relative to their poses in the scene.
        """
        head = mark.head(frame_id=self._frame_id, ns=_CERTIFICATE, number=2)
        link, name = self._pair(time_s)
        shapes = self._solids.get(name, [])
        if link not in self._links or not shapes:
            return head | {"action": mark.DELETE}
        shape = self._links[link]
        pin.forwardKinematics(self._robot.model, self._data, q)
        place = self._data.oMi[shape.parentJoint] * shape.placement
        stands = moved.get(name, pin.SE3.Identity())
        seen = stands.actInv(place)
        ends = min((_nearest_points(shape, seen, solid) for solid in shapes), key=lambda found: found[0])[1]
        ends = ends @ stands.rotation.T + stands.translation
        return head | {
            "type": mark.LINE_LIST,
            "pose": mark.pose(),
            "scale": xyz((0.008, 0.0, 0.0)),
            "color": mark.color(0xFFC53D),
            "points": mark.points(ends),
        }

    def _pair(self, time_s: float) -> tuple[str, str]:
        """Names of the nearest pair; empty without a pair."""
        if self._curve is None:
            return self._pairs[0] if self._pairs else ("", "")
        station = int(np.abs(self._curve.time - time_s).argmin())
        number = int(self._curve.nearest[station])
        return self._pairs[number] if number >= 0 else ("", "")


def fruit_events(
    robot: Robot, scene: Scene, trajectory: Trajectory, picks: Sequence[Pick]
) -> Iterator[tuple[float, Marker]]:
    """Times and markers of picked fruit.

    Each fruit is attached to the tool at one time and removed at another.
    """
    frames = LinkFrames(robot)
    for pick in picks:
        frames.place(trajectory.positions(np.array([pick.since]))[0])
        tool = pick.tool or robot.tool_frame
        held = fruit_marker(scene, pick.fruit, tool, is_goal=True)
        place = frames.pose(tool).actInv(np.array(pick.fruit.center))
        yield pick.since, held | {"pose": mark.pose(place), "color": mark.color(PICKED_COLOR)}
        if np.isfinite(pick.until):
            gone = mark.head(frame_id=tool, ns=FRUITS, number=held["id"])
            yield pick.until, gone | {"action": mark.DELETE}


def _nearest_points(
    link: pin.GeometryObject, place: pin.SE3, solid: pin.GeometryObject | Cloud
) -> tuple[float, FloatArray]:
    """Distance and nearest points of a link's capsule and a solid.

    The nearest points are (2, 3), first on the link.
    """
    if isinstance(solid, Cloud):
        radius, half = float(link.geometry.radius), float(link.geometry.halfLength) * place.rotation[:, 2]
        from_middle = solid.core - place.translation
        along = np.clip(from_middle @ half / max(float(half @ half), 1e-300), -1.0, 1.0)
        apart = np.linalg.norm(from_middle - along[:, None] * half, axis=1)
        nearest = int(apart.argmin())
        ends = np.array([place.translation + along[nearest] * half, solid.core[nearest]])
        direction = (ends[1] - ends[0]) / max(float(apart[nearest]), 1e-300)
        between = float(apart[nearest]) - radius - solid.rounding
        return between, ends + np.outer([radius, -solid.rounding], direction)
    result = coal.DistanceResult()
    at, other = (coal.Transform3s(each.rotation, each.translation) for each in (place, solid.placement))
    distance = coal.distance(link.geometry, at, solid.geometry, other, coal.DistanceRequest(), result)
    return float(distance), np.array([result.getNearestPoint1(), result.getNearestPoint2()])
