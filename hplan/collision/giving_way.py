"""Compliant obstacles: solids that some links may deflect to a maximum depth.

For the links that may push it, a compliant solid is smaller by its maximum deflection; for all others it has its full
size. The depth of a contact is the penetration depth: the minimum translation that separates the two shapes. It is not
meaningful beyond a link's half-width, when the link's axis is inside the solid. Deflections are therefore limited to
the half-width of the thinnest link, and for general (non-planar) arms to the rounding radii of body and solid.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, Record, frozen
from hplan.collision.arm_pairs import moving_bodies
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.reach import carriers
from hplan.errors import OptionError
from hplan.geometry.cloud import Cloud
from hplan.robot.model import Robot
from hplan.scene.obstacles import Solid

#: Default maximum deflection of the obstacles that a fruit hangs from, while that fruit may be touched [m].
HANGING_M = 0.02


@dataclass(frozen=True, eq=False)
class LinkedSolids(Record):
    """Solids with the links that must keep clear of each.

    A compliant solid occurs twice: at full size for links that may not push it, and smaller for links that may.

    Attributes:
        solids: The rigid solids, then the compliant ones twice.
        growth: (n,) growth of each solid [m]; reduced by the maximum deflection for the second copy of a compliant one.
        joints: (n, dof) True if the links on a joint must keep clear of the solid; None if all links must keep clear of
            all solids.
    """

    solids: tuple[Solid, ...]
    growth: FloatArray
    joints: BoolArray | None = None

    @classmethod
    def of(
        cls,
        robot: Robot,
        solids: Sequence[Solid],
        growth: ArrayLike,
        yield_links: Sequence[str] | None,
        beyond: ArrayLike = 0.0,
        hanging: Collection[str] = (),
    ) -> LinkedSolids:
        """Pair solids with links; compliant solids are taken twice.

        Args:
            robot: The robot.
            solids: The solids.
            growth: Growth of the solids [m], one number or one for each.
            yield_links: Names of the links that may push compliant solids; None for the links on the last two joints.
            beyond: Growth of the second copies of compliant solids, before the deflection is subtracted [m], one number
                or one for each.
            hanging: Names of solids whose deflection defaults to `HANGING_M`.

        Raises:
            OptionError: A name in `yield_links` is not a moving link.
        """
        grown = np.broadcast_to(np.asarray(growth, dtype=np.float64), (len(solids),))
        depth = yielded(robot, solids, yield_links, hanging)
        if depth is None:
            return cls(tuple(solids), frozen(grown.copy()))
        pushing = _pushing(robot, pushing_links(robot, yield_links))
        firm, soft = np.flatnonzero(depth == 0.0), np.flatnonzero(depth)
        smaller = np.broadcast_to(np.asarray(beyond, dtype=np.float64), (len(solids),)) - depth
        order = np.concatenate([firm, soft, soft])
        of_each = (np.ones_like(pushing), ~pushing, pushing)
        joints = np.repeat(of_each, [len(firm), len(soft), len(soft)], axis=0)
        growths = np.concatenate([grown[firm], grown[soft], smaller[soft]])
        return cls(tuple(solids[number] for number in order.tolist()), frozen(growths), frozen(joints))

    def field(self, robot: Robot, *, own_clearance: float | None = None, deviation: float = 0.0) -> ClearanceField:
        """Clearance field of the arm among the solids (see `ClearanceField.of`)."""
        return ClearanceField.of(
            robot,
            self.solids,
            clearance=self.growth,
            own_clearance=own_clearance,
            deviation=deviation,
            joints=self.joints,
        )

    def named(self, names: Collection[str]) -> BoolArray:
        """(n,) mask of the solids with one of the given names."""
        return np.array([solid.name in names for solid in self.solids], dtype=np.bool_)


def check_yield_links(robot: Robot, names: Sequence[str] | None) -> None:
    """Validate names of pushing links, even if no obstacle is compliant.

    Raises:
        OptionError: A name is not a moving link of the robot; the message lists the moving links.
    """
    for name in names or ():
        known = _names(robot)
        if name not in known:
            expected = f"moving links: {', '.join(known)}"
            close = get_close_matches(name, known, 1)
            raise OptionError("yield_links", name, expected + (f"; did you mean {close[0]!r}?" if close else ""))


def pushing_links(robot: Robot, names: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the links that may push compliant obstacles.

    Args:
        robot: The robot.
        names: Their names; None for the links on the last two joints.

    Raises:
        OptionError: A name is not a moving link.
    """
    known = _links(robot)
    if names is None:
        last = carriers(robot, robot.tool_joint - 1)[:2]
        return tuple(name for name, joint in known.items() if joint in last)
    check_yield_links(robot, names)
    return tuple(names)


def yielded(
    robot: Robot, solids: Sequence[Solid], yield_links: Sequence[str] | None, hanging: Collection[str] = ()
) -> FloatArray | None:
    """Maximum deflection of each solid, (solids,) [m]; None if all are rigid.

    Args:
        robot: The robot.
        solids: The solids.
        yield_links: Names of the links that may push compliant solids; None for the links on the last two joints.
        hanging: Names of solids whose deflection defaults to `HANGING_M`.

    Raises:
        OptionError: A name in `yield_links` is not a moving link.
    """
    depth = np.array([solid.yields or HANGING_M * (solid.name in hanging) for solid in solids], dtype=np.float64)
    if not depth.any():
        return None
    if robot.planar is not None:
        most: ArrayLike = float(robot.arm.half_widths.min())
    else:
        names = pushing_links(robot, yield_links)
        thin = min((body.rounding for body in collision_bodies(robot) if body.name in names), default=0.0)
        # When a body contains points of a cloud, coal reports the contact but not the depth of the deepest point.
        # So bodies of general (non-planar) arms keep at least 1e-6 m from the points of a compliant cloud.
        most = np.array([solid.rounding + (-1e-6 if isinstance(solid, Cloud) else thin) for solid in solids])
    found: FloatArray = np.maximum(0.0, np.minimum(depth, most))
    return found


def _names(robot: Robot) -> tuple[str, ...]:
    """Names of the moving links with collision shapes, without decomposing meshes."""
    if robot.planar is not None:
        return robot.arm.link_names
    shapes = (shape for shape in robot.collision_model.geometryObjects if shape.parentJoint > 0)
    return tuple(dict.fromkeys(str(robot.model.frames[shape.parentFrame].name) for shape in shapes))


def _links(robot: Robot) -> dict[str, int]:
    """Moving links, each with the joint that carries it."""
    if robot.planar is not None:
        return {name: joint for joint, name in enumerate(robot.arm.link_names, robot.arm_slice.start)}
    bodies = collision_bodies(robot)
    return {name: bodies[numbers[0]].joint for name, numbers in moving_bodies(robot).items()}


def _pushing(robot: Robot, names: Sequence[str]) -> BoolArray:
    """(dof,) mask of the joints whose links all may push compliant obstacles."""
    known = _links(robot)
    found = np.zeros(robot.dof, dtype=np.bool_)
    found[[known[name] for name in names]] = True
    found[[joint for name, joint in known.items() if name not in names]] = False
    return found
