"""What gives way, and to which links: solids that some links of an arm may push, so deep and no deeper.

To the links that may push it a solid is as much smaller as it yields; to all others it is what it is. The depth is how
deep the two shapes are in one another: the least shift that takes them apart. Beyond a link's half-width, where its
axis would be in the solid, that says nothing more, so no solid yields more than the half-width of the thinnest link; to
general (non-planar) arms no more than the radii by which body and solid are round.
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
from hplan.robot.model import Robot
from hplan.scene.obstacles import Solid
from hplan.scene.solids import Cloud

#: How deep what a fruit hangs from may be pushed while that fruit may be touched, where it says nothing of it [m].
HANGING_M = 0.02


@dataclass(frozen=True, eq=False)
class LinkedSolids(Record):
    """Solids, and which links have to keep clear of each; one that gives way is there a second time, smaller.

    Attributes:
        solids: The solids that do not give way, those that do, and these again.
        growth: (n,) by how much each is grown [m]; negative where it gives way.
        joints: (n, dof) for each whether what a joint carries keeps clear of it; None for all of all.
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
        """Take solids, those that give way twice.

        Args:
            growth: By how much they are grown [m], one number or one for each.
            yield_links: Names of the links that may push; None for those of the last two joints.
            beyond: By how much those are grown that are pushed, before they yield [m], one number or one for each.
            hanging: Names of those that give way by `HANGING_M` where they say nothing else.

        Raises:
            OptionError: A name of no link.
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
        """The arm among them (`ClearanceField.of`)."""
        return ClearanceField.of(
            robot,
            self.solids,
            clearance=self.growth,
            own_clearance=own_clearance,
            deviation=deviation,
            joints=self.joints,
        )

    def named(self, names: Collection[str]) -> BoolArray:
        """(n,) which of them have one of some names."""
        return np.array([solid.name in names for solid in self.solids], dtype=np.bool_)


def check_yield_links(robot: Robot, names: Sequence[str] | None) -> None:
    """Refuse names of links that the robot does not have, or that do not move, whether anything yields or not.

    Raises:
        OptionError: There is one; names the links that move.
    """
    for name in names or ():
        known = _names(robot)
        if name not in known:
            expected = f"links that move: {', '.join(known)}"
            close = get_close_matches(name, known, 1)
            raise OptionError("yield_links", name, expected + (f"; did you mean {close[0]!r}?" if close else ""))


def pushing_links(robot: Robot, names: Sequence[str] | None) -> tuple[str, ...]:
    """The links that may push what gives way.

    Args:
        names: Their names; None for those of the last two joints.

    Raises:
        OptionError: A name of no link that moves.
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
    """(solids,) how deep each may be pushed by the links that may [m]; None where none may.

    Args:
        yield_links: Names of the links that may push; None for those of the last two joints.
        hanging: Names of those that give way by `HANGING_M` where they say nothing else.

    Raises:
        OptionError: A name of no link.
    """
    depth = np.array([solid.yields or HANGING_M * (solid.name in hanging) for solid in solids], dtype=np.float64)
    if not depth.any():
        return None
    if robot.planar is not None:
        most: ArrayLike = float(robot.arm.half_widths.min())
    else:
        names = pushing_links(robot, yield_links)
        thin = min((body.rounding for body in collision_bodies(robot) if body.name in names), default=0.0)
        # Of the points of a cloud that a body is in coal does not say which is deepest, but that it is in one.
        # How far bodies of general (non-planar) arms stay off the points of a cloud that yields as much as it can [m].
        most = np.array([solid.rounding + (-1e-6 if isinstance(solid, Cloud) else thin) for solid in solids])
    found: FloatArray = np.maximum(0.0, np.minimum(depth, most))
    return found


def _names(robot: Robot) -> tuple[str, ...]:
    """Names of the links that move and have collision shapes; no mesh is cut for that."""
    if robot.planar is not None:
        return robot.arm.link_names
    shapes = (shape for shape in robot.collision_model.geometryObjects if shape.parentJoint > 0)
    return tuple(dict.fromkeys(str(robot.model.frames[shape.parentFrame].name) for shape in shapes))


def _links(robot: Robot) -> dict[str, int]:
    """The links that move, and the joint that carries each."""
    if robot.planar is not None:
        return {name: joint for joint, name in enumerate(robot.arm.link_names, robot.arm_slice.start)}
    bodies = collision_bodies(robot)
    return {name: bodies[numbers[0]].joint for name, numbers in moving_bodies(robot).items()}


def _pushing(robot: Robot, names: Sequence[str]) -> BoolArray:
    """(dof,) for each joint whether it carries a link, and none that may not push."""
    known = _links(robot)
    found = np.zeros(robot.dof, dtype=np.bool_)
    found[[known[name] for name in names]] = True
    found[[joint for name, joint in known.items() if name not in names]] = False
    return found
