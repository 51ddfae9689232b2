r"""The arm with the objects that it holds: one robot model with their shapes and masses.

Each object is a body frame of the model, its convex solids are collision shapes of the joint that carries its frame,
and its inertia is added to that joint's. Distances, motion bounds, self-collision pairs, torques and pages therefore
treat it as they treat links. A point cloud is held as its convex hull, grown by the radius of its points.

An object that is given a mass alone has the centre of mass and the inertia of a homogeneous solid: those of its shape,
for a mesh those of its convex pieces, weighted by their volumes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import coal
import numpy as np
import pinocchio as pin

from hplan.collision.coal_shapes import solid_shape, triangle_tree
from hplan.collision.collision_bodies import reuse_bodies
from hplan.collision.motion_coefficients import carriers
from hplan.errors import SceneError
from hplan.geometry.cloud import Cloud
from hplan.geometry.hull import whole_hull
from hplan.robot.model import Robot
from hplan.scene.attached import Attached
from hplan.scene.obstacles import Mesh

#: Number of sets of held objects whose robots are cached.
_KNOWN = 8

#: Colour of held objects on pages, and as red, green, blue, opacity.
HELD_COLOR: Final = 0xCC8C40
_COLOR = np.array([*HELD_COLOR.to_bytes(3, "big"), 255]) / 255.0


def holding(robot: Robot, attached: Sequence[Attached]) -> Robot:
    """Return the arm that holds some objects, and no others; cached.

    Args:
        robot: The arm; what it holds already is put away.
        attached: The objects, as `scene.attached`.

    Raises:
        SceneError: A frame or a link in `may_touch` does not exist, or a name is that of a frame of the robot.

    Examples:
        >>> from hplan import load_robot
        >>> from hplan.collision.held_objects import holding
        >>> from hplan.scene import Attached, Box
        >>> crate = Box(name="crate", center=(0.1, 0.0, 0.0), size=(0.1, 0.1, 0.1))
        >>> arm = load_robot()
        >>> loaded = holding(arm, [Attached(object=crate, mass=0.5)])
        >>> round(sum(i.mass for i in loaded.model.inertias) - sum(i.mass for i in arm.model.inertias), 9)
        0.5
        >>> holding(loaded, []) is arm
        True
    """
    attached = tuple(attached)
    if robot.attached == attached:
        return robot
    bare = robot.bare
    turns = np.array(robot.turns or np.zeros(bare.dof))
    if not attached:
        return bare.turned_by(turns)
    kept: deque[Robot] = bare.cache("holding", lambda: deque(maxlen=_KNOWN))
    loaded = next((known for known in kept if known.attached == attached), None)
    if loaded is None:
        loaded = _build(bare, attached)
        kept.append(loaded)
    return loaded.turned_by(turns)


def held_inertia(item: Attached) -> pin.Inertia:
    """Inertia of a held object in the frame that holds it."""
    if item.mass == 0.0:
        return pin.Inertia.Zero()
    parts = [_unit_inertia(placement, geometry) for placement, geometry in _solids(item)]
    whole = sum(parts[1:], parts[0])
    scale = item.mass / whole.mass
    center = whole.lever if item.center_of_mass is None else np.array(item.center_of_mass)
    inertia = scale * whole.inertia if item.inertia is None else np.array(item.inertia)
    return pin.Inertia(item.mass, center, inertia)


def solid_volume(item: Attached) -> float:
    """Volume of a held object, for a mesh that of its convex pieces [m^3]."""
    return math.fsum(float(geometry.computeVolume()) for _, geometry in _solids(item))


def _unit_inertia(placement: pin.SE3, geometry: coal.CollisionGeometry) -> pin.Inertia:
    """Inertia of a solid of density 1 kg/m^3."""
    about = np.array(geometry.computeMomentofInertiaRelatedToCOM())
    own = pin.Inertia(float(geometry.computeVolume()), np.array(geometry.computeCOM()).ravel(), 0.5 * (about + about.T))
    return own.se3Action(placement)


def _solids(item: Attached) -> Iterator[tuple[pin.SE3, coal.CollisionGeometry]]:
    """Convex shapes of a held object, with their placements in the frame that holds it."""
    for solid in item.object.solids:
        if isinstance(solid, Cloud):
            solid = whole_hull(solid.core, solid.name, solid.rounding)
        shape = solid_shape(solid)
        yield shape.placement, shape.geometry


def _drawn(item: Attached) -> Iterator[tuple[pin.SE3, coal.CollisionGeometry]]:
    """Shapes of a held object on pages."""
    if isinstance(item.object, Mesh):
        yield pin.SE3.Identity(), triangle_tree(*item.object.surface)
        return
    for placement, geometry in _solids(item):
        if isinstance(geometry, coal.ConvexBase):
            (hull,) = (whole_hull(solid.core, "", solid.rounding) for solid in item.object.solids)
            geometry = triangle_tree(*hull.surface)
        yield placement, geometry


def _build(robot: Robot, attached: tuple[Attached, ...]) -> Robot:
    """Add objects to a robot that holds none."""
    model = robot.model.copy()
    shapes, drawn = robot.collision_model.copy(), robot.visual_model.copy()
    owners = dict(robot.owners)
    for index, item in enumerate(attached):
        number = _frame_of(robot, item, index)
        frame = model.frames[number]
        joint, place = int(frame.parentJoint), pin.SE3(frame.placement)
        added = model.addBodyFrame(item.name, joint, place, number)
        model.appendBodyToJoint(joint, held_inertia(item), place)
        for part, (placement, geometry) in enumerate(_solids(item)):
            shapes.addGeometryObject(
                pin.GeometryObject(f"{item.name}_{part}", joint, added, place * placement, geometry)
            )
        for part, (placement, geometry) in enumerate(_drawn(item)):
            visual = pin.GeometryObject(f"{item.name}_{part}", joint, added, place * placement, geometry)
            visual.meshColor = _COLOR
            drawn.addGeometryObject(visual)
        owner = next((owners[link] for link in _links_down(robot, number) if link in owners), None)
        if owner is not None:
            owners[item.name] = owner
    loaded = replace(
        robot, model=model, collision_model=shapes, visual_model=drawn, owners=owners, attached=attached,
        may_touch=(*robot.may_touch, *_permitted(robot, attached)), without_attached=robot,
    )  # fmt: skip
    reuse_bodies(loaded, robot)
    return loaded


def _links_down(robot: Robot, number: int) -> Iterator[str]:
    """Names of a frame and the frames that carry it, to the root."""
    while number > 0:
        yield str(robot.model.frames[number].name)
        number = int(robot.model.frames[number].parentFrame)


def _frame_of(robot: Robot, item: Attached, index: int) -> int:
    """Index of the frame that holds an object.

    Raises:
        SceneError: The robot has no such frame, or has one of the object's name.
    """
    name = robot.tool_frame if item.frame is None else item.frame
    if robot.model.existFrame(item.name):
        raise SceneError(
            f"{item.name!r} is a frame of the robot; rename the object", where=f"attached[{index}].object.name"
        )
    if not robot.model.existFrame(name):
        links = ", ".join(frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY)
        raise SceneError(
            f"the robot has no frame {name!r}; its links are {links}", where=f"attached[{index}].frame", value=name
        )
    return robot.frame_number(name)


def hand_links(robot: Robot, item: Attached) -> tuple[str, ...]:
    """Links of the hand that holds an object; empty for an object that is fixed to another part of the arm.

    The hand is all that the joint of the tool frame carries, moving fingers included.
    """
    frame = robot.frame_number(robot.tool_frame if item.frame is None else item.frame)
    tool, joint = robot.tool_joint - 1, int(robot.model.frames[frame].parentJoint) - 1
    if tool not in carriers(robot, joint):
        return ()
    bodies = (frame for frame in robot.model.frames if frame.type == pin.FrameType.BODY)
    return tuple(str(frame.name) for frame in bodies if tool in carriers(robot, int(frame.parentJoint) - 1))


def _permitted(robot: Robot, attached: Sequence[Attached]) -> Iterator[tuple[str, str, str]]:
    """Pairs that may touch because of held objects, with the reason.

    Raises:
        SceneError: A name in `may_touch` is neither a link nor a held object.
    """
    links = {str(frame.name) for frame in robot.model.frames if frame.type == pin.FrameType.BODY}
    names = {item.name for item in attached}
    for index, item in enumerate(attached):
        if item.may_touch is None:
            yield from ((item.name, link, "it is in the hand") for link in hand_links(robot, item))
        for place, name in enumerate(item.may_touch or ()):
            if name not in links | names - {item.name}:
                known = f"{name!r} is neither a link nor another held object; the links are {', '.join(sorted(links))}"
                raise SceneError(known, where=f"attached[{index}].may_touch[{place}]", value=name)
            yield item.name, name, "the scene permits it for a held object"
