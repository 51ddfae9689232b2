"""Pairs of a robot's own bodies: the checked ones, and the exempt ones, each with the reason.

Every pair of bodies of **different arms** (`Robot.owner_of`) is checked with the full clearance, unless the cell
declares that the two links may touch. No other rule applies to it.

Within **one arm** all pairs are checked, except

- two bodies that the same joint carries, or none: they do not move relative to each other;
- links that the robot's SRDF, or a filter group of Drake's, declares to touch for another reason than that no contact
  was seen;
- bodies that always touch: proved by bisection over the joints between them (`_always_touch`), so that no
  configuration could pass a check;
- bodies on both sides of one joint that cannot touch at any value of it: proved by bisection
  (`hplan.robot.base_shapes.ever`);
- bodies on both sides of one joint that are never farther apart than `_BEARING`, also proved. They are **assumed** to
  touch by construction: convex shapes of bearings overlap.

Samples exempt no pair. They only say which checked pairs are so close to each other that a clearance cannot be
required of them (`required_distances`); such a pair must not touch, and the certificate lists it with its own bound.
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
from hplan.collision.reach import carriers, joint_axis, reach_of
from hplan.robot.base_shapes import always, coal_distance, ever
from hplan.robot.model import Robot, made_once
from hplan.robot.self_contact import SLACK

#: Sides of a joint may be this far apart, and are still its own; so are bodies with one link between them [m].
_BEARING: Final = 0.02

#: How far beyond the joint limits pairs are judged, as a tracking error may lead there [rad, m].
BEYOND: Final = 0.1

#: Random configurations.
SAMPLES: Final = 10_000

#: Pairs that were seen this far apart are sampled no further [m].
_FAR: Final = 0.25

#: Boxes of joint values in which `_always_touch` measures a distance before it gives up.
_MOST_BOXES: Final = 4_000

#: Begin of the reason of pairs that do not move relative to each other.
RIGID: Final = "they do not move relative to each other"


@dataclass(frozen=True, eq=False)
class SelfPairs(Record):
    """Pairs of bodies, by their indices in `hplan.collision.collision_bodies.collision_bodies`.

    Attributes:
        checked: Pairs (i, j), i < j, that must not touch. (The outer body, the one that has more joints below it or is
            later in the URDF, is not always j.)
        allowed: Pairs (i, j), i < j, that are not checked, each with the reason.
        farthest: (checked,) largest sampled distance of each pair of one arm [m], infinite from 0.25 m on, and for
            pairs of different arms. It decides which clearance can be required (`required_distances`).
    """

    checked: tuple[tuple[int, int], ...]
    allowed: tuple[tuple[int, int, str], ...]
    farthest: FloatArray


def required_distances(farthest: FloatArray, clearance: float) -> FloatArray:
    """Required distance of each pair [m]: the clearance, or 0 if the pair is never farther apart than that.

    Args:
        farthest: (pairs,) largest distances, as in `SelfPairs` [m].
        clearance: Clearance to keep [m].
    """
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
    """Sort some pairs (i, j), i < j, into checked and exempt ones, as `self_pairs` does with all."""
    bodies = collision_bodies(robot)
    allowed: list[tuple[int, int, str]] = []
    left: list[tuple[int, int]] = []
    for pair in chosen:
        reason = _exemption(robot, pair, beyond)
        if reason is None:
            left.append(pair)
        else:
            allowed.append((*pair, reason))
    is_own = [robot.owner_of(bodies[i].name) == robot.owner_of(bodies[j].name) for i, j in left]
    own = [pair for pair, same_arm in zip(left, is_own, strict=True) if same_arm]
    touching, distances = _sampled(robot, own)
    farthest = dict(zip(own, np.where(distances >= _FAR, np.inf, distances).tolist(), strict=True))
    for pair, touches in zip(own, touching.tolist(), strict=True):
        if touches and _always_touch(robot, pair):
            allowed.append((*pair, f"they touch wherever {_joints_in_words(robot, pair)} are"))
            del farthest[pair]
    checked = tuple(pair for pair, same_arm in zip(left, is_own, strict=True) if not same_arm or pair in farthest)
    return SelfPairs(checked, tuple(sorted(allowed)), frozen(np.array([farthest.get(p, np.inf) for p in checked])))


def _exemption(robot: Robot, pair: tuple[int, int], beyond: float) -> str | None:
    """The reason for which a pair of bodies is not checked; None if it is checked, or if samples are needed first."""
    first, second = (collision_bodies(robot)[body] for body in pair)
    declared = _declared(robot).get(frozenset((first.name, second.name))) if first.name != second.name else None
    declared = None if declared is None else f"may touch: {declared}"
    if robot.owner_of(first.name) != robot.owner_of(second.name):
        return declared
    between = _between(robot, first.joint, second.joint)
    if not between:
        return RIGID
    if declared is None and len(between) == 1:
        return _by_one_joint(robot, pair, between[0], beyond)
    return declared


@made_once
def _declared(robot: Robot) -> dict[frozenset[str], str]:
    """The reason for each pair of links that are declared to touch."""
    return {frozenset(pair[:2]): pair[2] for pair in robot.may_touch}


def _always_touch(robot: Robot, pair: tuple[int, int]) -> bool:
    """True if two bodies touch at all joint values within the limits; True is certain.

    Bisection: the distance at the centre of a box of joint values grows by no more than the half-widths times the
    motion-bound coefficients (`hplan.collision.reach`).
    """
    bodies, shapes = collision_bodies(robot), [body_shapes(robot)[body] for body in pair]
    between = list(_between(robot, *(bodies[body].joint for body in pair)))
    rates = reach_of(robot, [bodies[body] for body in pair]).sum(axis=0)[between]
    low, high = robot.lower[between], robot.upper[between].copy()
    slides = np.array(robot.slides)[between]
    high[~slides] = np.minimum(high, low + math.tau)[~slides]  # a whole turn later bodies are where they were
    q, data = pin.neutral(robot.model), robot.model.createData()
    boxes = [(0.5 * (low + high), 0.5 * (high - low))]
    for _ in range(_MOST_BOXES):
        if not boxes:
            return True
        centre, half = boxes.pop()
        q[between] = centre
        pin.forwardKinematics(robot.model, data, q)
        (a, at), (b, there) = ((each.geometry, data.oMi[each.parentJoint] * each.placement) for each in shapes)
        distance = coal_distance(a, at, b, there)
        if distance > 0.0:
            return False
        travel = rates * half
        if distance + float(travel.sum()) > 0.0:
            widest = int(travel.argmax())
            smaller = half.copy()
            smaller[widest] *= 0.5
            shift = np.zeros(len(half))
            shift[widest] = smaller[widest]
            boxes += [(centre - shift, smaller), (centre + shift, smaller)]
    return not boxes


def _joints_in_words(robot: Robot, pair: tuple[int, int]) -> str:
    """The joints between two bodies, as messages name them."""
    between = sorted(_between(robot, *(collision_bodies(robot)[body].joint for body in pair)))
    return "joints " + ", ".join(repr(robot.joint_names[joint]) for joint in between)


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
    """The reason for which two bodies of one arm with one joint between them are not checked; None if they are."""
    shapes, name = (body_shapes(robot)[pair[0]], body_shapes(robot)[pair[1]]), robot.joint_names[joint]
    if one_joint(robot, shapes, joint, 0.0).always(0.0):
        return f"they touch wherever joint {name!r} is"
    decided = one_joint(robot, shapes, joint, beyond)
    # Bodies apart by less than this count as touching: no proof shows so little [m].
    if not decided.ever(SLACK):
        return f"they cannot touch wherever joint {name!r} is"
    if decided.always(_BEARING):
        sides = f"they are the two sides of joint {name!r}, never farther apart than {1e3 * _BEARING:g} mm"
        return f"{sides}: assumed to touch by construction"
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
