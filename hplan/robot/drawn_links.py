"""Finds drawn links that the collision geometry does not cover.

A certificate holds for the collision geometry. If a link has a `<visual>` and no `<collision>`, or a collision mesh in
other units than the drawn one, the certificate says nothing about the link that the user sees.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arguments import nearest_name
from hplan.base.arrays import FloatArray
from hplan.errors import RobotFileError
from hplan.geometry.coal_hull import convex_shape
from hplan.geometry.hull import CUBE_CORNERS, whole_hull
from hplan.robot.urdf_xml import line_of

#: A link without its own shapes counts as covered if it protrudes from its neighbours' shapes by at most this [m].
_COVERED_M: Final = 1e-3

#: A collision shape smaller than the visuals by this factor does not cover the link.
_SMALLER: Final = 10.0

#: A collision shape larger than the visuals by this factor is in other units, unless the visuals are smaller than
#: `_DUMMY_M` [m].
_LARGER: Final = 100.0
_DUMMY_M: Final = 0.01

#: Shapes thinner than this fraction of the drawn link are flat.
_FLAT: Final = 1e-2

#: A drawn link protrudes from the shapes around it if it does by both this fraction of its size and this distance [m].
_STANDS_OUT: Final = 0.25
_STANDS_OUT_M: Final = 0.03

#: A mesh that fills less than this fraction of its convex hull is not replaced by the hull.
_FILLED_FRACTION: Final = 0.8

#: Directions for comparing the drawn link with the shapes of its neighbours.
_DIRECTIONS: Final = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)], dtype=np.float64) - 1.0


@dataclass(frozen=True)
class ShapeFault:
    """Drawn link whose collision shapes do not match its visuals.

    Attributes:
        link: Name of the link.
        reason: The mismatch, as part of a sentence.
        is_covered: True if the shapes contain the drawn link, but are far larger.
    """

    link: str
    reason: str
    is_covered: bool = False

    def __str__(self) -> str:
        return f"{self.link!r} {self.reason}"


def find_shape_faults(
    model: pin.Model,
    collision_model: pin.GeometryModel,
    visual_model: pin.GeometryModel,
    undrawn: Iterable[str] = (),
) -> tuple[ShapeFault, ...]:
    """List the drawn links with mismatched collision shapes, base first.

    A link without collision shapes is covered if it lies within the shapes of other links on the same joint.

    Args:
        model: Pinocchio's kinematic model.
        collision_model: Pinocchio's collision model.
        visual_model: Pinocchio's visual model.
        undrawn: Names of links whose visual meshes are missing.
    """
    drawn, shapes = _by_link(model, visual_model), _by_link(model, collision_model)
    missing = set(undrawn)
    found = []
    for frame in model.frames:
        name = str(frame.name)
        if frame.type != pin.FrameType.BODY or not (name in drawn or name in missing):
            continue
        points = _points(drawn.get(name, ()))
        if name in shapes:
            around = _points_around(model, collision_model, int(frame.parentJoint))
            fault = _misfit(name, points, _points(shapes[name]), around)
        else:
            fault = ShapeFault(name, "has no collision shape")
        if fault is None or (not fault.is_covered and _is_covered(points, collision_model, int(frame.parentJoint))):
            continue
        found.append(fault)
    return tuple(found)


def describe_shape_faults(robot: str, faults: Iterable[ShapeFault]) -> str:
    """Sentence that names the faults of a robot and the remedy."""
    listed = "; ".join(map(str, faults))
    return (
        f"robot {robot!r}: collision shapes do not match the drawn links, and plans and certificates hold only for the "
        f"shapes: {listed}. collision_from_visual=True (--collision-from-visual) builds them from the visuals"
    )


def shape_links_from_visuals(path: Path, root: ET.Element, links: Collection[str]) -> None:
    """Replace the `<collision>` elements of links by copies of their `<visual>` elements.

    Args:
        path: The file, for messages.
        root: Root element of a URDF; changed in place.
        links: Names of the links.

    Raises:
        RobotFileError: A link does not exist, or has no visual whose file exists.
    """
    elements = {str(link.get("name")): link for link in root.findall("link")}
    for name in links:
        link = elements.get(name)
        if link is None:
            reason = f"collision_from_visual: the robot has no link {name!r}; {nearest_name(name, elements)}"
            raise RobotFileError(path, reason)
        visuals = link.findall("visual")
        if not visuals:
            reason = f"collision_from_visual: link {name!r} has no <visual>, or none whose mesh file exists"
            raise RobotFileError(path, line_of(link) + reason)
        for shape in link.findall("collision"):
            link.remove(shape)
        for visual in visuals:
            shape = deepcopy(visual)
            shape.tag = "collision"
            for material in shape.findall("material"):
                shape.remove(material)
            link.append(shape)


def _by_link(model: pin.Model, geometry: pin.GeometryModel) -> Mapping[str, list[pin.GeometryObject]]:
    found: dict[str, list[pin.GeometryObject]] = {}
    for shape in geometry.geometryObjects:
        found.setdefault(str(model.frames[shape.parentFrame].name), []).append(shape)
    return found


def _points_around(model: pin.Model, geometry: pin.GeometryModel, joint: int) -> FloatArray:
    """(n, 3) points of the shapes on a joint and its neighbours.

    The points are in the joint's frame. Adjacent links often share the shape around their joint. All joints are in
    their neutral position.
    """
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    found = []
    for other in range(model.njoints):
        if other == joint or model.parents[other] == joint or model.parents[joint] == other:
            place = data.oMi[joint].actInv(data.oMi[other])
            points = _points(shape for shape in geometry.geometryObjects if shape.parentJoint == other)
            found.append(points @ place.rotation.T + place.translation)
    return np.concatenate(found)


def _misfit(link: str, drawn: FloatArray, shape: FloatArray, around: FloatArray) -> ShapeFault | None:
    """Mismatch of a link's collision shapes; None if they match.

    Args:
        link: Name of the link.
        drawn: (m, 3) points of its visuals.
        shape: (n, 3) points of its collision shapes.
        around: (k, 3) points of all collision shapes on its joint and the adjacent joints.
    """
    if not len(drawn):
        return None
    ours, theirs = _diagonal(shape), _diagonal(drawn)
    sizes = f"is {theirs:.3g} m across as drawn, but its collision shape is {ours:.3g} m across, as if in other units"
    if ours * _SMALLER <= theirs:
        return ShapeFault(link, sizes)
    if theirs >= _DUMMY_M and ours >= _LARGER * theirs:
        return ShapeFault(link, sizes, is_covered=True)
    if _thickness(shape) < _FLAT * _thickness(drawn):
        return ShapeFault(link, "has a flat collision shape, without the volume of the drawn link")
    directions = _DIRECTIONS.T / np.linalg.norm(_DIRECTIONS, axis=1)
    stands_out = float(((drawn @ directions).max(axis=0) - (around @ directions).max(axis=0)).max())
    if stands_out > max(_STANDS_OUT_M, _STANDS_OUT * theirs):
        return ShapeFault(link, f"protrudes from its collision shape by {1e3 * stands_out:.0f} mm as drawn")
    return None


def _diagonal(points: FloatArray) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _thickness(points: FloatArray) -> float:
    """Minimum standard deviation of (n, 3) points over all directions [m]."""
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(np.cov(points.T, bias=True))[0])))


def _points(shapes: Iterable[pin.GeometryObject]) -> FloatArray:
    """(n, 3) points with about some shapes' bounding box and thickness.

    The points are in the joint's frame.
    """
    placed = [_geometry_corners(s.geometry) @ s.placement.rotation.T + s.placement.translation for s in shapes]
    return np.concatenate([*placed, np.empty((0, 3))])


def _geometry_corners(geometry: coal.CollisionGeometry) -> FloatArray:
    if isinstance(geometry, coal.BVHModelBase):
        return np.asarray(geometry.vertices(), dtype=np.float64).reshape(-1, 3)
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    corners: FloatArray = 0.5 * (box.max_ + box.min_) + 0.5 * (box.max_ - box.min_) * CUBE_CORNERS
    return corners


def _is_covered(drawn: FloatArray, geometry: pin.GeometryModel, joint: int) -> bool:
    """True if the outermost visual points lie within a joint's collision shapes.

    Args:
        drawn: (n, 3) visual points.
        geometry: Pinocchio's collision model.
        joint: Index of the joint.
    """
    bodies = [shape for shape in geometry.geometryObjects if shape.parentJoint == joint]
    if not bodies or not len(drawn):
        return False
    outermost = drawn[(drawn @ _DIRECTIONS.T).argmax(axis=0)]
    solids = [(body.placement, solid) for body in bodies for solid in _convex_solids(body.geometry)]
    point, request = coal.Sphere(1e-9), coal.DistanceRequest()

    def distance(at: FloatArray, placement: pin.SE3, solid: coal.CollisionGeometry) -> float:
        there = coal.Transform3s(np.eye(3), at)
        place = coal.Transform3s(placement.rotation, placement.translation)
        return float(coal.distance(point, there, solid, place, request, coal.DistanceResult()))

    return all(any(distance(at, *solid) <= _COVERED_M for solid in solids) for at in outermost)


def _convex_solids(geometry: coal.CollisionGeometry) -> Iterator[coal.CollisionGeometry]:
    """Convex solids of a shape.

    A convex shape is returned itself; a mesh that nearly fills its hull is replaced by the hull; other meshes give
    nothing.
    """
    if not isinstance(geometry, coal.BVHModelBase):
        yield geometry
        return
    hull = convex_shape(whole_hull(_geometry_corners(geometry)))
    if float(geometry.computeVolume()) >= _FILLED_FRACTION * float(hull.computeVolume()):
        yield hull
