"""Own contacts of the C-space, and whether its links are the bodies that everything else checks.

The C-space has a capsule for each link, which encloses the bodies of the URDF, and shapes of turret and pedestal. It
may say that no path exists only if no configuration that it excludes is free for those bodies.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import pinocchio as pin

from hplan.base.arrays import readonly
from hplan.collision.collision_bodies import CollisionBody, collision_bodies
from hplan.collision.self_pairs import required_distances, self_pairs
from hplan.planar.family_reader import family_of, with_planar_arm
from hplan.planar.self_contact import SelfContact, self_contact
from hplan.robot.model import Robot, made_once

#: Tolerance of equal capsules [m].
_SAME_CAPSULE: Final = 1e-7


def checked_contact(robot: Robot, *, deviation: float, clearance: float) -> SelfContact:
    """The own pairs of the C-space, as far as their bodies have to keep the clearance (`self_pairs`).

    Args:
        robot: The robot.
        deviation: Tracking error [rad].
        clearance: Required distance between parts [m].
    """
    contact, pairs = self_contact(robot, deviation=deviation, clearance=clearance), self_pairs(robot)
    if not (contact.links or contact.bodies):
        return contact
    bodies, first = collision_bodies(robot), family_of(robot).arm_slice.start
    required = required_distances(pairs.farthest, clearance) >= clearance
    checked = [pair for pair, is_required in zip(pairs.checked, required.tolist(), strict=True) if is_required]
    of_joints = {frozenset((bodies[i].joint, bodies[j].joint)) for i, j in checked}
    # The C-space has the hull of a mesh, which may be larger than its pieces.
    of_shapes = {
        (shape, bodies[other].joint)
        for pair in checked
        for body, other in (pair, pair[::-1])
        for shape in bodies[body].shapes
        if bodies[body].kind != "mesh piece"
    }
    kept = (
        replace(shape, links=tuple(link for link in shape.links if (shape.number, first + link) in of_shapes))
        for shape in contact.bodies
    )
    return SelfContact(
        links=tuple((i, j) for i, j in contact.links if frozenset((first + i, first + j)) in of_joints),
        bodies=tuple(shape for shape in kept if shape.links),
    )


@made_once
def within_bodies(robot: Robot) -> Robot | None:
    """The robot with links no thicker than its bodies, for proofs; itself if it has such links.

    Each link has the widest capsule that lies along its axis and is one of its bodies. None if a link has no such body:
    then nothing that the C-space excludes is proved.
    """
    bodies, arm = collision_bodies(robot), family_of(robot).arm
    radii = [[body.rounding for body in bodies if _is_along(robot, link, body)] for link in range(arm.link_count)]
    if not all(radii):
        return None
    widths = np.array([max(radius) for radius in radii])
    if (np.abs(widths - arm.half_widths) <= _SAME_CAPSULE).all():
        return robot
    return with_planar_arm(robot, replace(arm, half_widths=readonly(np.minimum(widths, arm.half_widths))))


def _is_along(robot: Robot, link: int, body: CollisionBody) -> bool:
    """True if a body is a capsule from end to end of a link's axis."""
    family = family_of(robot)
    if body.kind != "capsule" or body.joint != family.arm_slice.start + link:
        return False
    arm, plane = family.arm, np.cross(*family.plane_axes)
    data, q = robot.model.createData(), np.zeros(robot.dof)
    pin.forwardKinematics(robot.model, data, q)
    points = family.plane_origin + arm.joint_points(q[family.arm_slice]) @ family.plane_axes + arm.lateral[link] * plane
    place = data.oMi[body.joint + 1]
    core = body.core @ place.rotation.T + place.translation
    ends = points[link : link + 2]
    return bool(min(np.abs(core - ends).max(), np.abs(core - ends[::-1]).max()) <= _SAME_CAPSULE)
