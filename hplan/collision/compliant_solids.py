"""Compliant obstacles: solids that some links may deflect to a maximum depth.

For the links that may push it, a compliant solid is smaller by its maximum deflection; for all others it has its full
size. The depth of a contact is the penetration depth: the minimum translation that separates the two shapes. It is not
meaningful once the cores of both meet, for example the axes of two capsules. Deflections are therefore limited to the
rounding radii of the solid and of the thinnest body that may push it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, Record, frozen
from hplan.collision.coal_arm import supports
from hplan.collision.collision_bodies import GROUND, collision_bodies
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.motion_coefficients import carriers
from hplan.errors import OptionError
from hplan.geometry.cloud import Cloud
from hplan.robot.model import Robot
from hplan.robot.upright import UprightTool
from hplan.scene.obstacles import Solid

#: Maximum depth in a limb as a share of the radii of the limb and of the thinnest body that may push it.
LIMB_SHARE = 0.8

#: Default maximum deflection of the obstacles that a fruit hangs from, while that fruit may be touched [m].
HANGING_M = 0.02


@dataclass(frozen=True, eq=False)
class LinkedSolids(Record):
    """Solids with the links that must keep clear of each.

    A compliant solid occurs twice: at full size for links that may not push it, and smaller for links that may. Limbs
    have solids of their own for both (`hplan.scene.limb_contacts`).

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
    def build(
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
        depth, clear = maximum_deflection(robot, solids, yield_links, hanging), _unsupported_joints(robot, solids)
        if depth is None:
            return cls(tuple(solids), frozen(grown.copy()), None if clear.all() else frozen(clear))
        pushing = _pushing_joints(robot, pushing_links(robot, yield_links))
        meets = np.array([solid.meets for solid in solids])
        firm = np.flatnonzero((depth == 0.0) & (meets == "all"))
        whole = np.flatnonzero(((depth > 0.0) & (meets == "all")) | (meets == "others"))
        entered = np.flatnonzero(((depth > 0.0) & (meets == "all")) | (meets == "pushing"))
        smaller = np.broadcast_to(np.asarray(beyond, dtype=np.float64), (len(solids),)) - depth
        order = np.concatenate([firm, whole, entered])
        of_each = (np.ones_like(pushing), ~pushing, pushing)
        joints = np.repeat(of_each, [len(firm), len(whole), len(entered)], axis=0) & clear[order]
        entered_growth = np.where(depth > 0.0, smaller, grown)[entered]
        growths = np.concatenate([grown[firm], grown[whole], entered_growth])
        return cls(tuple(solids[number] for number in order.tolist()), frozen(growths), frozen(joints))

    def with_nearer(
        self, dof: int, solids: Sequence[Solid], near: Sequence[tuple[int, int, float]], growth: FloatArray
    ) -> LinkedSolids:
        """Solids that the links of a joint may come nearer to.

        Args:
            dof: Number of joints.
            solids: The solids, each once.
            near: Number of the solid in that list, joint, and required distance for the links on the joint [m].
            growth: (solids,) growth of each solid for its position uncertainty [m].
        """
        if not near:
            return self
        joints = np.ones((len(self.solids), dof), dtype=np.bool_) if self.joints is None else np.array(self.joints)
        nearer = np.zeros((len(near), dof), dtype=np.bool_)
        for row, (number, joint, _) in enumerate(near):
            joints[[solid is solids[number] for solid in self.solids], joint] = False
            nearer[row, joint] = True
        return LinkedSolids(
            (*self.solids, *(solids[number] for number, _, _ in near)),
            frozen(np.append(self.growth, [growth[number] + required for number, _, required in near])),
            frozen(np.concatenate([joints, nearer])),
        )

    def field(
        self,
        robot: Robot,
        *,
        own_clearance: float | None = None,
        deviation: float = 0.0,
        upright: UprightTool | None = None,
    ) -> ClearanceField:
        """Clearance field of the arm among the solids (see `ClearanceField.build`)."""
        return ClearanceField.build(
            robot,
            self.solids,
            clearance=self.growth,
            own_clearance=own_clearance,
            deviation=deviation,
            joints=self.joints,
            upright=upright,
        )

    def name_mask(self, names: Collection[str]) -> BoolArray:
        """(n,) mask of the solids with one of the given names."""
        return np.array([solid.name in names for solid in self.solids], dtype=np.bool_)


def _unsupported_joints(robot: Robot, solids: Sequence[Solid]) -> BoolArray:
    """(solids, dof) mask of the joints whose bodies a solid does not support (`hplan.collision.coal_arm.supports`)."""
    found = np.ones((len(solids), robot.dof), dtype=np.bool_)
    bodies = collision_bodies(robot)
    for body, number in zip(*np.nonzero(supports(robot, solids)), strict=True):
        found[number, bodies[body].joint] = False
    return found


def check_yield_links(robot: Robot, names: Sequence[str] | None) -> None:
    """Validate names of pushing links, even if no obstacle is compliant.

    Raises:
        OptionError: A name is not a moving link of the robot; the message lists the moving links.
    """
    for name in names or ():
        known = _moving_link_names(robot)
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


def maximum_deflection(
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
    depth = np.array(
        [solid.yields or HANGING_M * (solid.name in hanging and not solid.is_limb) for solid in solids],
        dtype=np.float64,
    )
    if not depth.any():
        return None
    names = pushing_links(robot, yield_links)
    pushing = [body for body in collision_bodies(robot) if body.name in names]
    thin = min((body.rounding for body in pushing), default=0.0)
    # When the core of a body contains points of a cloud, coal reports the contact but not the depth of the deepest
    # point. Of all bodies only capsules know their cores (`hplan.collision.coal_cloud`). So the axes of capsules, and
    # other bodies as a whole, keep at least 1e-6 m from the points of a compliant cloud.
    in_cloud = (thin if all(body.kind == "capsule" for body in pushing) else 0.0) - 1e-6
    most = np.array([solid.rounding + (in_cloud if isinstance(solid, Cloud) else thin) for solid in solids])
    # A limb that is nearly crossed may stay on the far side, where the shortest way out does not bound its deflection.
    most = np.where([solid.is_limb for solid in solids], LIMB_SHARE * most, most)
    found: FloatArray = np.maximum(0.0, np.minimum(depth, most))
    return found


def _moving_link_names(robot: Robot) -> tuple[str, ...]:
    """Names of the moving links with collision shapes, without decomposing meshes."""
    shapes = (shape for shape in robot.collision_model.geometryObjects if shape.parentJoint > 0)
    return tuple(dict.fromkeys(str(robot.model.frames[shape.parentFrame].name) for shape in shapes))


def _links(robot: Robot) -> dict[str, int]:
    """Moving links, each with the joint that carries it."""
    return {body.name: body.joint for body in collision_bodies(robot) if body.joint != GROUND}


def _pushing_joints(robot: Robot, names: Sequence[str]) -> BoolArray:
    """(dof,) mask of the joints whose links all may push compliant obstacles."""
    known = _links(robot)
    found = np.zeros(robot.dof, dtype=np.bool_)
    found[[known[name] for name in names]] = True
    found[[joint for name, joint in known.items() if name not in names]] = False
    return found
