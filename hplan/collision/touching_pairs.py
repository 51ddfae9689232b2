"""Pairs of a robot's own bodies: those that are checked, and those that may touch, each with the reason.

Looked at are all pairs but

- bodies that no joint, or the same one, carries: they do not move to each other;
- bodies that lie to each other as one joint alone says, where that joint's whole range shows that they cannot touch, or
  that they always do, or that they never come farther apart than `_BEARING`: those are the two sides of the joint;
- bodies that touch at every one of `SAMPLES` random configurations, as where what lies between is short;
- bodies of links that the robot's SRDF, or a filter group of Drake's, lets touch, for another reason than that they
  were never seen to.

What a range of one joint shows is certain, by bisection (`hplan.robot.base_shapes.ever`); what samples show is taken
for how the robot is built, and is listed. A pair that no sample saw touch is checked all the same.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import pinocchio as pin

from hplan.base.arrays import BoolArray, FloatArray, Record, frozen
from hplan.collision.collision_bodies import body_shapes, collision_bodies
from hplan.collision.reach import carriers, joint_axis
from hplan.robot.base_shapes import always, coal_distance, ever
from hplan.robot.model import Robot, made_once
from hplan.robot.self_contact import SLACK

#: Sides of a joint may be this far apart, and are still its own; so are bodies with one link between them [m].
_BEARING: Final = 0.02

#: How far beyond the joint limits pairs are judged, as a tracking error may lead there [rad, m].
BEYOND: Final = 0.1

#: Random configurations.
SAMPLES: Final = 10_000

#: Pairs that were seen this far apart are not asked further [m].
_FAR: Final = 0.25


@dataclass(frozen=True, eq=False)
class SelfPairs(Record):
    """Pairs of bodies, by their places in `hplan.collision.collision_bodies.collision_bodies`.

    Attributes:
        checked: Pairs (i, j), i < j, that must not touch. (The outer body, the one that has more joints below it or is
            later in the URDF, is not always j.)
        allowed: Pairs (i, j), i < j, that are not checked, each with the reason.
        farthest: (checked,) how far apart each pair was seen [m], infinite from 0.25 m on. One that is never farther
            apart than the clearance to keep, or than `_BEARING`, is asked only whether it touches (`needed`).
    """

    checked: tuple[tuple[int, int], ...]
    allowed: tuple[tuple[int, int, str], ...]
    farthest: FloatArray


def needed(farthest: FloatArray, clearance: float) -> FloatArray:
    """Distances that pairs are to keep where a clearance is asked for, by how far apart they were seen at most [m]."""
    return np.where(farthest > max(clearance, _BEARING), clearance, min(clearance, 0.0))


@made_once
def self_pairs(robot: Robot, beyond: float = BEYOND) -> SelfPairs:
    """The pairs of a robot's own bodies, found once.

    Args:
        beyond: How far joints may be beyond their limits [rad, m].
    """
    every = itertools.combinations(range(len(collision_bodies(robot))), 2)
    return pairs_among(robot, every, beyond)


def pairs_among(robot: Robot, chosen: Iterable[tuple[int, int]], beyond: float) -> SelfPairs:
    """As `self_pairs`, of some pairs (i, j), i < j, alone."""
    bodies = collision_bodies(robot)
    may_touch = {frozenset(pair[:2]): pair[2] for pair in robot.may_touch}
    allowed: list[tuple[int, int, str]] = []
    left: list[tuple[int, int]] = []
    for i, j in chosen:
        first, second = bodies[i], bodies[j]
        between = _between(robot, first.joint, second.joint)
        reason: str | None = None
        if not between:
            reason = "they do not move to each other"
        elif first.name != second.name and frozenset((first.name, second.name)) in may_touch:
            reason = f"may touch: {may_touch[frozenset((first.name, second.name))]}"
        elif len(between) == 1:
            reason = _by_one_joint(robot, (i, j), between[0], beyond)
        if reason is None:
            left.append((i, j))
        else:
            allowed.append((i, j, reason))
    touching, farthest = _sampled(robot, left)
    allowed += [
        (*pair, f"they touch at each of {SAMPLES:,} random configurations")
        for pair, touches in zip(left, touching.tolist(), strict=True)
        if touches
    ]
    checked = tuple(pair for pair, touches in zip(left, touching.tolist(), strict=True) if not touches)
    far = np.where(farthest >= _FAR, np.inf, farthest)[~touching]
    return SelfPairs(checked, tuple(sorted(allowed)), frozen(far))


def _between(robot: Robot, first: int, second: int) -> tuple[int, ...]:
    """The joints that say how what one joint carries lies to what another does."""
    a, b = carriers(robot, first), carriers(robot, second)
    return tuple(joint for joint in (*a, *b) if (joint in a) != (joint in b))


class OneJoint(NamedTuple):
    """How far apart two shapes are that one joint alone moves to each other, over its range.

    Attributes:
        distance: The distance where the joint is at a place [m].
        low: Where its range begins, with what it may be beyond.
        high: Where it ends.
        rate: How fast the distance changes with the joint at most.
    """

    distance: Callable[[float], float]
    low: float
    high: float
    rate: float

    def ever(self, level: float) -> bool:
        """True if they come within a distance [m], or nearly so; False is certain."""
        return ever(*self, level)

    def always(self, level: float) -> bool:
        """True if they are within a distance all over [m]; True is certain."""
        return always(*self, level)


def one_joint(
    robot: Robot, shapes: tuple[pin.GeometryObject, pin.GeometryObject], joint: int, beyond: float
) -> OneJoint:
    """Two shapes that one joint alone moves to each other; `beyond` as in `self_pairs`."""
    axis, slides = joint_axis(robot, joint)
    still, moved = shapes
    if still.parentJoint == joint + 1:
        still, moved = moved, still
    at = robot.model.jointPlacements[joint + 1].inverse() * still.placement
    # Where the joint turns, either may be taken to move.
    rate = 1.0 if slides else min(_radius(still, at, axis), _radius(moved, moved.placement, axis))

    def distance(place: float) -> float:
        if slides:
            motion = pin.SE3(np.eye(3), place * axis)
        else:
            motion = pin.SE3(pin.AngleAxis(place, axis).toRotationMatrix(), np.zeros(3))
        return coal_distance(still.geometry, at, moved.geometry, motion * moved.placement)

    # A whole turn farther on bodies are where they were.
    beyond = beyond if slides else min(beyond, math.tau)
    return OneJoint(distance, float(robot.lower[joint]) - beyond, float(robot.upper[joint]) + beyond, rate)


def _by_one_joint(robot: Robot, pair: tuple[int, int], joint: int, beyond: float) -> str | None:
    """Why two bodies that one joint moves to each other may touch, or never do; None where they are to be checked."""
    first, second = (body_shapes(robot)[body] for body in pair)
    decided, name = one_joint(robot, (first, second), joint, beyond), robot.joint_names[joint]
    if decided.always(0.0):
        return f"they touch wherever joint {name!r} is"
    if decided.always(_BEARING):
        return f"they are the two sides of joint {name!r}, never farther apart than {1e3 * _BEARING:g} mm"
    # Bodies apart by less than this count as touching: no proof shows so little [m].
    if not decided.ever(SLACK):
        return f"they cannot touch wherever joint {name!r} is"
    return None


def _radius(shape: pin.GeometryObject, placement: pin.SE3, axis: FloatArray) -> float:
    """Largest distance of a shape's points from an axis through the origin [m]."""
    shape.geometry.computeLocalAABB()
    centre = placement * np.asarray(shape.geometry.aabb_center)
    return float(np.linalg.norm(centre - (centre @ axis) * axis)) + float(shape.geometry.aabb_radius)


def _sampled(robot: Robot, pairs: list[tuple[int, int]]) -> tuple[BoolArray, FloatArray]:
    """(pairs,) which touch at all of the random configurations, and how far apart each was seen, up to `_FAR` [m]."""
    touching, farthest = np.ones(len(pairs), dtype=np.bool_), np.full(len(pairs), -np.inf)
    if not pairs:
        return touching, farthest
    geometry = pin.GeometryModel()
    for shape in body_shapes(robot):
        geometry.addGeometryObject(shape)
    for i, j in pairs:
        geometry.addCollisionPair(pin.CollisionPair(i, j))
    arm, data = robot.model.createData(), geometry.createData()
    open_pairs = np.arange(len(pairs))
    few = min(SAMPLES, 500)
    for number, q in enumerate(np.random.default_rng(0).uniform(robot.lower, robot.upper, (SAMPLES, robot.dof))):
        pin.updateGeometryPlacements(robot.model, arm, geometry, data, q)
        for pair in open_pairs.tolist():
            found = pin.computeDistance(geometry, data, pair).min_distance
            touching[pair] &= found <= 0.0
            farthest[pair] = max(farthest[pair], found)
        # How far apart they come shows soon; that they touch always does not.
        going = touching[open_pairs] | ((farthest[open_pairs] < _FAR) if number < few else False)
        open_pairs = open_pairs[going]
        if not len(open_pairs):
            break
    return touching, farthest
