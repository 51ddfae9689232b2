"""Checked and exempt self-collision pairs of a robot, with the reasons.

Every pair of bodies of **different arms** (`Robot.owner_of`) is checked with the full clearance, unless the cell
declares that the two links may touch. No other rule applies to it.

Within **one arm** all pairs are checked, except

- two bodies that are carried by the same joint or both by the ground, or that are round about the joints between them:
  no joint changes their distance;
- links that the robot's SRDF, or a Drake collision filter group, allows to touch, unless the reason is only that
  sampling found no contact;
- bodies that always touch: proved by bisection over the joints between them (`_always_touch`), so that no
  configuration could pass a check;
- bodies on both sides of one joint that cannot touch at any value of it: proved by bisection
  (`hplan.geometry.lipschitz.may_reach`);
- bodies on both sides of one joint that are never farther apart than `BEARING`, also proved. They are **assumed** to
  touch by construction: convex shapes of bearings overlap.

The last two rules and the proof of constant contact do not hold for **held objects** (`Robot.attached`): such a pair is
checked unless the scene permits the contact.

Of two bodies on both sides of one revolute joint that always touch, or are assumed to, the parts beyond the joint are
checked nevertheless (`hplan.collision.self_folds`).

Samples exempt no pair. They only find the checked pairs that are too close to each other for a clearance requirement
(`required_distances`); such a pair must not touch, and the certificate lists it with its own bound.
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
from hplan.collision.motion_coefficients import carriers, joint_axis, joints_between, reach_of
from hplan.geometry.lipschitz import is_always_within, may_reach
from hplan.geometry.shape_outline import coal_distance
from hplan.robot.model import Robot, made_once

#: Maximum distance of the two sides of a bearing; also used for bodies with one link between them [m].
BEARING: Final = 0.02

#: Bodies within this distance count as able to touch [m]: positions hold to 1e-6 rad, distances to 1e-5 m.
SLACK: Final = 1e-4

#: Margin beyond the joint limits within which pairs are classified, to cover tracking errors [rad, m].
BEYOND: Final = 0.1

#: Number of random configurations.
RANDOM_SAMPLES: Final = 10_000

#: The sampling of a pair stops at this distance [m].
_FAR_PAIR_M: Final = 0.25

#: Maximum number of boxes of joint values, each with a distance query, in `_always_touch`.
_MOST_BOXES: Final = 4_000

#: Reasons for exempting pairs whose distance no joint changes.
RIGID: Final = "they do not move relative to each other"
ROUND: Final = "no joint changes their distance: they are round about the joints between them"


@dataclass(frozen=True, eq=False)
class SelfPairs(Record):
    """Pairs of bodies, by their indices in `hplan.collision.collision_bodies.collision_bodies`.

    Attributes:
        checked: Pairs (i, j), i < j, that must not touch. (The outer body, the one that has more joints below it or is
            later in the URDF, is not always j.)
        allowed: Pairs (i, j), i < j, that are not checked, each with the reason.
        farthest: (checked,) maximum sampled distance of each pair of one arm [m]; infinite from 0.25 m on, and for
            pairs of different arms. It determines the clearance that can be required (`required_distances`).
        hinged: Pairs (i, j), i < j, that are not checked because they are in contact about the one joint between them,
            and that joint.
    """

    checked: tuple[tuple[int, int], ...]
    allowed: tuple[tuple[int, int, str], ...]
    farthest: FloatArray
    hinged: tuple[tuple[int, int, int], ...] = ()


def rounded_up(deviation: float) -> float:
    """Round a tracking error up to one of few values [rad].

    A motion's tracking error depends on its speed; rounding lets caches be shared between motions.
    """
    if not deviation < math.tau:
        return math.tau  # a whole turn either way covers all angles
    # Tracking errors are rounded up to multiples of this [rad].
    deviation_step = 5e-3
    return deviation_step * math.ceil(deviation / deviation_step - 1e-9)


def required_distances(farthest: FloatArray, clearance: float) -> FloatArray:
    """Required distance of each pair, (pairs,) [m].

    It is the clearance, or 0 if the pair is never farther apart than the clearance or `BEARING`, whichever is larger.
    A negative clearance is required of all pairs.

    Args:
        farthest: (pairs,) maximum distances, as in `SelfPairs` [m].
        clearance: Required clearance [m].
    """
    return np.where(farthest > max(clearance, BEARING), clearance, min(clearance, 0.0))


@made_once
def self_pairs(robot: Robot, beyond: float = BEYOND) -> SelfPairs:
    """Classify all pairs of a robot's own bodies; cached.

    Args:
        robot: The robot.
        beyond: Maximum excess over the joint limits [rad, m].
    """
    count = len(collision_bodies(robot))
    if not robot.attached:
        return pairs_among(robot, itertools.combinations(range(count), 2), beyond)
    # The bodies of held objects come last; pairs of links are those of the robot without them.
    links, first = self_pairs(robot.bare, beyond), len(collision_bodies(robot.bare))
    held = pairs_among(robot, ((i, j) for j in range(first, count) for i in range(j)), beyond)
    return SelfPairs(
        (*links.checked, *held.checked),
        (*links.allowed, *held.allowed),
        frozen(np.append(links.farthest, held.farthest)),
        links.hinged,
    )


def pairs_among(robot: Robot, chosen: Iterable[tuple[int, int]], beyond: float) -> SelfPairs:
    """Classify pairs (i, j), i < j, as checked or exempt."""
    bodies = collision_bodies(robot)
    allowed: list[tuple[int, int, str]] = []
    left: list[tuple[int, int]] = []
    hinged: list[tuple[int, int, int]] = []
    for pair in chosen:
        reason = _exemption(robot, pair, beyond)
        if reason is None:
            left.append(pair)
        else:
            allowed.append((*pair, reason))
            between = joints_between(robot, *(bodies[body] for body in pair))
            if len(between) == 1 and reason in _in_contact(robot, between[0]):
                hinged.append((*pair, between[0]))
    is_own = [robot.owner_of(bodies[i].name) == robot.owner_of(bodies[j].name) for i, j in left]
    own = [pair for pair, same_arm in zip(left, is_own, strict=True) if same_arm]
    touching, distances = _sample_touching(robot, own)
    farthest = dict(zip(own, np.where(distances >= _FAR_PAIR_M, np.inf, distances).tolist(), strict=True))
    for pair, touches in zip(own, touching.tolist(), strict=True):
        if touches and not _is_held(robot, pair) and _always_touch(robot, pair):
            allowed.append((*pair, f"they touch at all positions of {_joints_in_words(robot, pair)}"))
            del farthest[pair]
    checked = tuple(pair for pair, same_arm in zip(left, is_own, strict=True) if not same_arm or pair in farthest)
    apart = frozen(np.array([farthest.get(p, np.inf) for p in checked]))
    return SelfPairs(checked, tuple(sorted(allowed)), apart, tuple(hinged))


def _exemption(robot: Robot, pair: tuple[int, int], beyond: float) -> str | None:
    """Reason for exempting a pair; None without one.

    Without one the pair is checked, or requires samples.
    """
    first, second = (collision_bodies(robot)[body] for body in pair)
    declared = _declared_pairs(robot).get(frozenset((first.name, second.name))) if first.name != second.name else None
    declared = None if declared is None else f"may touch: {declared}"
    if robot.owner_of(first.name) != robot.owner_of(second.name):
        return declared
    if first.joint == second.joint:
        return RIGID
    between = joints_between(robot, first, second)
    if not between:
        return ROUND
    if declared is None and len(between) == 1 and not _is_held(robot, pair):
        return _by_one_joint(robot, pair, between[0], beyond)
    return declared


def _is_held(robot: Robot, pair: tuple[int, int]) -> bool:
    """True for pairs with a held object: no construction makes it touch a link, and the scene can permit it."""
    held = {item.name for item in robot.attached}
    return any(collision_bodies(robot)[body].name in held for body in pair)


@made_once
def _declared_pairs(robot: Robot) -> dict[frozenset[str], str]:
    """Reason for each pair of links that are declared to touch."""
    return {frozenset(pair[:2]): pair[2] for pair in robot.may_touch}


def _always_touch(robot: Robot, pair: tuple[int, int]) -> bool:
    """True if two bodies provably touch at all joint values.

    The joint values are within the limits; True is certain.

    Bisection: the distance at the centre of a box of joint values grows by no more than the half-widths times the
    motion-bound coefficients (`hplan.collision.motion_coefficients`).
    """
    bodies, shapes = collision_bodies(robot), [body_shapes(robot)[body] for body in pair]
    between = list(joints_between(robot, *(bodies[body] for body in pair)))
    rates = reach_of(robot, [bodies[body] for body in pair]).sum(axis=0)[between]
    low, high = robot.lower[between], robot.upper[between].copy()
    slides = np.array(robot.slides)[between]
    high[~slides] = np.minimum(high, low + math.tau)[~slides]  # poses repeat after a whole turn
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
    """Names of the joints between two bodies, for messages."""
    between = sorted(joints_between(robot, *(collision_bodies(robot)[body] for body in pair)))
    return "joints " + ", ".join(repr(robot.joint_names[joint]) for joint in between)


class OneJoint(NamedTuple):
    """Distance of two shapes as a function of their joint.

    Attributes:
        distance: Function from the joint value to the distance [m].
        low: Lower end of the joint's range, extended by the maximum excess [rad, m].
        high: Upper end of the range, likewise [rad, m].
        rate: Maximum rate of change of the distance with the joint value [m/rad, m/m].
    """

    distance: Callable[[float], float]
    low: float
    high: float
    rate: float

    def may_reach(self, level: float) -> bool:
        """True if the distance may fall to `level` [m]; False is proved."""
        return may_reach(*self, level)

    def is_always_within(self, level: float) -> bool:
        """True if the distance never exceeds `level` [m]; True is proved."""
        return is_always_within(*self, level)


def one_joint(
    robot: Robot, shapes: tuple[pin.GeometryObject, pin.GeometryObject], joint: int, beyond: float
) -> OneJoint:
    """Distance function of two shapes whose distance one joint determines.

    Args:
        robot: The robot.
        shapes: The two shapes.
        joint: The joint.
        beyond: Maximum excess over the joint limits [rad, m].
    """
    axis, slides = joint_axis(robot, joint)
    still, moved = shapes
    if joint in carriers(robot, int(still.parentJoint) - 1):
        still, moved = moved, still
    # Poses in the joint's frame, with this joint and all that do not matter at 0.
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, np.zeros(robot.dof))
    at, place = (data.oMi[joint + 1].actInv(data.oMi[each.parentJoint] * each.placement) for each in (still, moved))
    # With a revolute joint, either shape can be regarded as the moving one.
    rate = 1.0 if slides else min(_radius(still, at, axis), _radius(moved, place, axis))

    def distance(value: float) -> float:
        if slides:
            motion = pin.SE3(np.eye(3), value * axis)
        else:
            motion = pin.SE3(pin.AngleAxis(value, axis).toRotationMatrix(), np.zeros(3))
        return coal_distance(still.geometry, at, moved.geometry, motion * place)

    # Poses repeat after a whole turn.
    beyond = beyond if slides else min(beyond, math.tau)
    return OneJoint(distance, float(robot.lower[joint]) - beyond, float(robot.upper[joint]) + beyond, rate)


def _in_contact(robot: Robot, joint: int) -> tuple[str, str]:
    """Reasons for exempting bodies about a joint: they always touch, or are assumed to."""
    name = robot.joint_names[joint]
    sides = f"they are the two sides of joint {name!r}, never farther apart than {1e3 * BEARING:g} mm"
    return f"they touch wherever joint {name!r} is", f"{sides}: assumed to touch by construction"


def _by_one_joint(robot: Robot, pair: tuple[int, int], joint: int, beyond: float) -> str | None:
    """Reason for exempting two bodies on one joint; None if checked."""
    shapes, name = (body_shapes(robot)[pair[0]], body_shapes(robot)[pair[1]]), robot.joint_names[joint]
    touching, assumed = _in_contact(robot, joint)
    if one_joint(robot, shapes, joint, 0.0).is_always_within(0.0):
        return touching
    decided = one_joint(robot, shapes, joint, beyond)
    # Bodies nearer than `SLACK` count as touching: the bisection cannot resolve smaller distances [m].
    if not decided.may_reach(SLACK):
        return f"they cannot touch wherever joint {name!r} is"
    return assumed if decided.is_always_within(BEARING) else None


def _radius(shape: pin.GeometryObject, placement: pin.SE3, axis: FloatArray) -> float:
    """Upper bound of the distance of a shape from an axis [m].

    Of all points of the shape.
    """
    shape.geometry.computeLocalAABB()
    centre = placement * np.asarray(shape.geometry.aabb_center)
    return float(np.linalg.norm(centre - (centre @ axis) * axis)) + float(shape.geometry.aabb_radius)


def _sample_touching(robot: Robot, pairs: list[tuple[int, int]]) -> tuple[BoolArray, FloatArray]:
    """Pairs that touch at every random configuration, and their maximum sampled distances.

    Returns:
        (pairs,) True for pairs that touch at every sample, and (pairs,) maximum distances [m]. The sampling of a pair
        may stop once its distance is at least `_FAR_PAIR_M`.
    """
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
    few = min(RANDOM_SAMPLES, 500)
    for number, q in enumerate(np.random.default_rng(0).uniform(robot.lower, robot.upper, (RANDOM_SAMPLES, robot.dof))):
        pin.updateGeometryPlacements(robot.model, arm, geometry, data, q)
        for pair in open_pairs.tolist():
            found = pin.computeDistance(geometry, data, pair).min_distance
            touching[pair] &= found <= 0.0
            farthest[pair] = max(farthest[pair], found)
        # A few samples suffice for the maximum distance, but not to find pairs that always touch.
        going = touching[open_pairs] | ((farthest[open_pairs] < _FAR_PAIR_M) if number < few else False)
        open_pairs = open_pairs[going]
        if not len(open_pairs):
            break
    return touching, farthest
