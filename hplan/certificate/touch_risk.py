r"""Probability bound of contact with obstacles of uncertain position.

The position error of each obstacle is drawn once for the whole motion: a translation :math:`e`, Gaussian with a
covariance. Let a convex part of the obstacle and a body of the arm be separated by :math:`g` along a unit vector
:math:`n`,

.. math:: \min_{a \in \text{body}} n \cdot a - \max_{o \in \text{part}} n \cdot o \ge g.

After the translation they touch only if :math:`n \cdot e \ge g`. Such half-spaces are found along the motion, for each
body and each part, from the maximum gap at some configurations (`hplan.geometry.convex_distance`, which returns the
gap of the direction that it returns: the proof does not need it to be the maximum). Around such a configuration a gap
shrinks by the travel of the body and by the displacement due to tracking errors (`hplan.certificate.motion_bound`);
each time of the motion belongs to a half-space of its pair, or has a distance of more than :math:`7` standard
deviations in all directions. So the obstacle is touched at some time only if its error is in one of the half-spaces, or
that large: the sums are over obstacles, not over time.

**Probability of the half-spaces.** In coordinates in which :math:`e` is a standard normal variable, the half-spaces lie
beyond planes at distances :math:`\delta_k` in directions :math:`m_k`. In a direction :math:`u` they start at
:math:`t(u) = \min_k \delta_k / (m_k \cdot u)_+`, so the probability is the mean over the sphere of :math:`P(\chi_3 >
t(u))`. The sphere is divided into cells; with the maximum :math:`m_k \cdot u` of each cell this is an upper bound. For
one plane it is the half-space bound :math:`\Phi(-\delta)`, for planes in all directions the bound of the ball,
:math:`P(\chi_3 > \delta)`, and a value between them otherwise.

**Errors common to all obstacles.** The translation of an obstacle is :math:`e_i + e_0`, with :math:`e_0` the same for
all (of the camera, of the base). Two bounds hold: the sum over obstacles with the sum of both covariances; and, as
:math:`n \cdot (e_i + e_0) \ge g` only if :math:`n \cdot e_0 \ge \lambda g` or :math:`n \cdot e_i \ge (1 - \lambda) g`,
the probability of all half-spaces of :math:`e_0` together, plus the sum over each obstacle's own. The smaller one is
used.

Assumptions: errors translate an obstacle and do not rotate it. No motion changes the contact of obstacles with the
base, with bodies that turn in place and with bodies that they support: this is not counted. An obstacle that the motion
may touch (the fruit to pick) counts only while contact is not allowed; a compliant obstacle may be deflected up to its
compliance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Final

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, TableArray, frozen
from hplan.base.deadline import check_deadline
from hplan.base.kernels import any_int, kernel
from hplan.certificate.clearance_curve import ProvedMotion, ProvedStretch, Subject
from hplan.certificate.clearance_proof import Advancement, place_after, point_at
from hplan.certificate.touch_estimate import TouchEstimate, touch_estimate
from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_bodies import joint_table
from hplan.collision.compiled_clearance import pose_of
from hplan.collision.compiled_placements import place_joints
from hplan.geometry.cloud import Cloud
from hplan.geometry.convex_distance import SEPARATING, WORK, Wanted, core_distance
from hplan.geometry.shape_outline import outline
from hplan.geometry.sweep import STILL
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import largest_deviation

#: Standard deviations beyond which obstacles are ignored: 2e-10 of a position's errors are larger.
FAR_SIGMAS: Final = 7.0

#: Fraction of a gap that a body may travel to the next half-space, if the obstacle is near.
_GAP_FRACTION: Final = 0.03

#: Gap below which an obstacle counts as touched [m]; maximum number of half-spaces in a segment.
_LEAST, _MOST = 1e-6, any_int(2_000_000)

#: Columns of a moving shape: start and end index of its points, radius, joint and displacement bound.
_SHAPE = np.dtype(
    [
        ("first", np.int64),
        ("last", np.int64),
        ("radius", np.float64),
        ("joint", np.int64),
        ("sway", np.float64),
    ],
    align=True,
)

#: Columns of a part of an obstacle: start and end index of its points, radius, the gap above which it is far, and the
#: index of its solid.
_PART = np.dtype(
    [
        ("first", np.int64),
        ("last", np.int64),
        ("radius", np.float64),
        ("far", np.float64),
        ("solid", np.int64),
    ],
    align=True,
)

#: Columns of a half-space: the obstacle (the part, in the kernel), the direction from it to the arm, the gap.
_OBSTACLE, _NORMAL, _GAP = 0, 1, 4


@dataclass(frozen=True)
class RiskShare:
    """An obstacle and its share of the probability.

    Attributes:
        obstacle: Name of the obstacle.
        probability: Upper bound of the probability that its own error causes contact.
        clearance_m: Lower bound of the motion's distance from the obstacle's observed pose; inf if it is far [m].
    """

    obstacle: str
    probability: float
    clearance_m: float


@dataclass(frozen=True)
class TouchRisk:
    """Bound of the probability that a motion touches anything.

    Attributes:
        asked: Maximum allowed probability.
        bound: Certified upper bound of the probability.
        shares: Share of each obstacle, the largest first; far obstacles are left out.
        shared: Share of the error common to all obstacles; 0 if it was added to each obstacle's own error.
        subject: The motions.
        scene: The scene of the motions.
    """

    asked: float
    bound: float
    shares: tuple[RiskShare, ...]
    shared: float
    subject: Subject = field(compare=False, repr=False)
    scene: Scene = field(compare=False, repr=False)

    @cached_property
    def estimate(self) -> TouchEstimate:
        """Contact frequency over 10,000 draws of all errors; computed on first use."""
        return touch_estimate(self.subject, self.scene)

    @property
    def violation(self) -> str:
        """Message for a bound above the required maximum."""
        most = f", mostly {self.shares[0].obstacle!r}" if self.shares else ""
        return (
            f"the probability of a contact is bounded by {self.bound:.3g} only{most}; required: at most {self.asked:g}"
        )


def touch_risk(subject: Subject, scene: Scene, asked: float) -> TouchRisk:
    """Bound the probability that the motions of a certificate touch anything.

    Args:
        subject: The certified motions.
        scene: The scene of the certificate; its obstacles have the errors.
        asked: Maximum allowed probability.
    """
    errors, shared = scene.errors, scene.shared_error
    # An obstacle is far if it is far for both ways of counting the shared error: added, or separate.
    far = {name: FAR_SIGMAS * (largest_deviation(error) + largest_deviation(shared)) for name, error in errors.items()}
    names = list(far)
    found = [rows for motion, _ in subject.motions for rows in _iterate_half_spaces(motion, far)]
    rows = np.concatenate([np.zeros((0, 5)), *found])
    owner = rows[:, _OBSTACLE].astype(np.int64)
    uncertain = [number for number, name in enumerate(names) if far[name] > 0.0]
    order = np.argsort(owner, kind="stable")
    rows, owner = rows[order], owner[order]
    starts = np.searchsorted(owner, np.arange(len(names) + 1))
    parts = {n: rows[starts[n] : starts[n + 1]] for n in uncertain}
    whole = {n: _exit_probability(part[:, 1:4], part[:, _GAP], errors[names[n]] + shared) for n, part in parts.items()}
    bound, common, own = sum(whole.values()), 0.0, whole
    if shared.any() and all((part[:, _GAP] > 0.0).all() for part in parts.values()):
        of_all, alone = [np.zeros((0, 4))], {}
        for n, part in parts.items():
            normals, error = part[:, 1:4], errors[names[n]]
            of_shared, of_own = _deviations(normals, shared), _deviations(normals, error)
            # The gap is divided in proportion to both standard deviations; if one is zero, the other gets it all.
            share = part[:, _GAP] / np.maximum(of_shared + of_own, 1e-300)
            moved = of_own > 0.0
            alone[n] = _exit_probability(normals[moved], (share * of_own)[moved], error) if error.any() else 0.0
            moved = of_shared > 0.0
            of_all.append(np.column_stack([normals, share * of_shared])[moved])
        together = np.concatenate(of_all)
        common_part = _exit_probability(together[:, :3], together[:, 3], shared)
        if common_part + sum(alone.values()) < bound:
            bound, common, own = common_part + sum(alone.values()), common_part, alone
    least = {n: float(part[:, _GAP].min(initial=math.inf)) for n, part in parts.items()}
    shares = [RiskShare(names[n], own[n], least[n]) for n in uncertain if least[n] < math.inf]
    shares.sort(key=lambda share: (-share.probability, share.obstacle))
    return TouchRisk(asked, min(1.0, float(bound)), tuple(shares), common, subject, scene)


def _iterate_half_spaces(motion: ProvedMotion, far: dict[str, float]) -> Iterator[FloatArray]:
    """Half-spaces of the segments of a motion."""
    bezier, _ = motion.trajectory.segments
    for stretch in motion.stretches:
        check_deadline()
        yield _of_stretch(motion.robot, bezier[stretch.part], stretch, motion.clearance, far)


def _of_stretch(
    robot: Robot, bezier: FloatArray, stretch: ProvedStretch, clearance: float, far: dict[str, float]
) -> FloatArray:
    checker, deviations = stretch.checker, stretch.deviations
    shapes, solids, depths = checker.meetings
    places = {name: place for place, (name, distance) in enumerate(far.items()) if distance > 0.0}
    obstacle = np.array([places.get(solid.name, -1) for solid in solids], dtype=np.int64)
    if (obstacle < 0).all():
        return np.zeros((0, 5))
    search = Advancement(bezier, checker, deviations, clearance)
    if search.bounded < len(bezier):
        # Nothing is known about it: each obstacle may be touched.
        touched = np.unique(obstacle[obstacle >= 0])
        return np.column_stack([touched, np.zeros((len(touched), 4))])
    bodies, parts, points = _tables_of(checker, far)
    (sway, travel), first = search.movers, search.mover_of[:: len(solids)][: len(shapes)]
    bodies["sway"] = sway[first].max(axis=1)
    solid_of = parts["solid"]
    allowed = np.ascontiguousarray(depths[:, solid_of])
    arm = joint_table(robot), points, bodies, parts
    rows = _half_spaces(np.ascontiguousarray(bezier), *arm, travel[first], allowed)
    rows[:, _OBSTACLE] = obstacle[solid_of[rows[:, _OBSTACLE].astype(np.int64)]]
    return rows


def _tables_of(checker: CoalScene, far: dict[str, float]) -> tuple[TableArray, TableArray, FloatArray]:
    """Moving shapes, parts of uncertain obstacles, and the points of both."""
    shapes, solids, _ = checker.meetings
    points, count = [np.zeros(0)], 0

    def number_of(corners: FloatArray) -> tuple[int, int]:
        nonlocal count
        points.append(corners.ravel())
        count += corners.size
        return count - corners.size, count

    bodies = np.zeros(len(shapes), _SHAPE)
    for row, shape in zip(bodies, shapes, strict=True):
        corners, row["radius"] = outline(shape, rim_from_outside=True)
        at: pin.SE3 = shape.placement
        row["first"], row["last"] = number_of(corners @ at.rotation.T + at.translation)
        row["joint"] = shape.parentJoint - 1
    parts = [np.zeros(0, _PART)]
    for number, solid in enumerate(solids):
        if far.get(solid.name, 0.0) > 0.0:
            begin, last = number_of(solid.core)
            firsts = np.arange(begin, last, 3 if isinstance(solid, Cloud) else last - begin)
            rows = np.zeros(len(firsts), _PART)
            rows["first"], rows["last"] = firsts, np.append(firsts[1:], last)
            rows["radius"], rows["far"], rows["solid"] = solid.rounding, far[solid.name], number
            parts.append(rows)
    return bodies, np.concatenate(parts), np.concatenate(points)


def _root(covariance: FloatArray) -> FloatArray:
    """(3, 3) matrix that maps standard normals to a covariance's errors."""
    values, axes = np.linalg.eigh(covariance)
    root: FloatArray = axes * np.sqrt(np.maximum(values, 0.0))
    return root


def _deviations(normals: FloatArray, covariance: FloatArray) -> FloatArray:
    """(k,) standard deviations of an error along directions."""
    deviations: FloatArray = np.sqrt(((normals @ _root(covariance)) ** 2).sum(axis=1))
    return deviations


def _exit_probability(normals: FloatArray, gaps: FloatArray, covariance: FloatArray) -> float:
    """Probability bound of an error in half-spaces or beyond `FAR` sigmas.

    An upper bound.

    Args:
        normals: (k, 3) unit vectors.
        gaps: (k,) start of each half-space along its normal [m].
        covariance: (3, 3) covariance of the error [m^2].
    """
    if not covariance.any():
        return float((gaps <= 0.0).any())
    if not (gaps > 0.0).all():
        return 1.0
    along = normals @ _root(covariance)
    lengths = np.sqrt((along * along).sum(axis=1))
    kept = gaps < FAR_SIGMAS * lengths
    if not kept.any():
        return float(beyond_sigmas(FAR_SIGMAS))
    starts = gaps[kept] / lengths[kept]
    order = np.argsort(starts)
    directions = np.ascontiguousarray((along[kept] / lengths[kept, None])[order])
    centres, weights, radius = _cells()
    return _mean_beyond(centres, weights, radius, directions, np.ascontiguousarray(starts[order]))


@cache
def _cells() -> tuple[FloatArray, FloatArray, float]:
    """Cells of a sphere: centres, area fractions, maximum radius.

    (c, 3) centres, (c,) area fractions, and the maximum angle between a point and the centre of its cell [rad].
    """
    golden = 0.5 * (1.0 + math.sqrt(5.0))
    corners = np.array([(0.0, a, b * golden) for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    corners = np.concatenate([np.roll(corners, turn, axis=1) for turn in range(3)])
    corners /= np.linalg.norm(corners[0])
    edge = np.linalg.norm(corners[:, None] - corners, axis=2)
    near = edge < 1.2 * edge[edge > 0.1].min()
    triangles = np.array(
        [
            corners[[i, j, k]]
            for i in range(12)
            for j in range(i + 1, 12)
            for k in range(j + 1, 12)
            if near[i, j] and near[j, k] and near[i, k]
        ]
    )
    # Each pass divides every triangle of the icosahedron into four cells of the sphere.
    for _ in range(4):
        a, b, c = triangles.transpose(1, 0, 2)
        ab, bc, ca = a + b, b + c, c + a
        cut = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(three, axis=1) for three in cut])
        triangles /= np.linalg.norm(triangles, axis=2, keepdims=True)
    a, b, c = triangles.transpose(1, 0, 2)
    volume = np.abs((a * np.cross(b, c)).sum(axis=1))
    areas = 2.0 * np.arctan2(volume, 1.0 + (a * b).sum(axis=1) + (b * c).sum(axis=1) + (c * a).sum(axis=1))
    centres = a + b + c
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    radius = float(np.arccos(np.einsum("nij,nj->ni", triangles, centres).min())) * (1.0 + 1e-9)
    return frozen(np.ascontiguousarray(centres)), frozen(areas / areas.sum()), radius


@kernel
def _mean_beyond(
    centres: FloatArray, weights: FloatArray, radius: float, directions: FloatArray, starts: FloatArray
) -> float:
    """Mean over the cells of the probability beyond some plane or `FAR`.

    The variable is standard normal in space.

    Args:
        centres: (c, 3) centres of the cells.
        weights: (c,) area fractions of the cells.
        radius: Maximum angle between a point of a cell and its centre [rad].
        directions: (k, 3) directions of the planes.
        starts: (k,) distances of the planes, the nearest first.
    """
    cos, sin, total = math.cos(radius), math.sin(radius), 0.0
    for cell in range(len(weights)):
        begins = FAR_SIGMAS
        for k in range(len(starts)):
            if starts[k] >= begins:
                break
            along = (
                centres[cell, 0] * directions[k, 0]
                + centres[cell, 1] * directions[k, 1]
                + centres[cell, 2] * directions[k, 2]
            )
            # The cosine of an angle smaller by the cell's radius exceeds the cosine of the angle by at most that
            # radius.
            if begins * (along + radius) <= starts[k]:
                continue
            most = 1.0 if along >= cos else along * cos + math.sqrt(1.0 - along * along) * sin
            if begins * most > starts[k]:
                begins = starts[k] / most
        total += weights[cell] * beyond_sigmas(begins)
    return total


@kernel
def beyond_sigmas(sigmas: float) -> float:
    """Probability that a position error exceeds a number of sigmas.

    Sigma is the standard deviation of each coordinate in space. The distance has the chi distribution with three
    degrees of freedom: 2.9 % are beyond three sigmas, not the 0.3 % of a single coordinate.
    """
    tail: float = math.erfc(sigmas / math.sqrt(2.0))
    return tail + math.sqrt(2.0 / math.pi) * sigmas * math.exp(-0.5 * sigmas * sigmas)


@kernel
def _half_spaces(
    bezier: FloatArray, joints: TableArray, points: FloatArray, bodies: TableArray, parts: TableArray,
    travels: FloatArray, allowed: FloatArray,
) -> FloatArray:  # fmt: skip
    """(k, 5) half-spaces that cover each pair's times, except far ones.

    At each time a pair belongs to a half-space, or its gap is larger than the part's far gap.

    Args:
        bezier: (pieces, 4, dof) Bezier points of the motion's cubics.
        joints: Joints from `hplan.collision.compiled_bodies.joint_table`.
        points: Points of bodies and parts.
        bodies: Moving shapes.
        parts: Parts of obstacles.
        travels: (bodies, pieces + 1) upper bound of each body's travel up to each sample [m].
        allowed: (bodies, parts) allowed deflection of each pair [m]; infinite for a pair that is not checked.
    """
    dof, rows = bezier.shape[2], float(bezier.shape[0])
    frames, work = np.empty((dof + 1, 12)), np.zeros(WORK)
    found, count = np.empty((256, 5)), 0
    for b in range(len(bodies)):
        body, travel = bodies[b], travels[b]
        span = body.first, body.last, 0
        for p in range(len(parts)):
            if allowed[b, p] == math.inf:
                continue
            part = parts[p]
            other, radii, far = (part.first, part.last, 0), body.radius + part.radius, part.far
            beyond = radii + body.sway - allowed[b, p]
            for c in range(WORK):
                work[c] = 0.0
            place, back, going = 0.0, 0.0, True
            while going:
                row = min(int(place), len(travel) - 2)
                now = travel[row] + (place - row) * (travel[row + 1] - travel[row])
                left = max(0.0, travel[len(travel) - 1] - now)
                place_joints(point_at(bezier, place), joints, frames)
                wanted = Wanted(math.inf, 0.0, 1e-4, radii, STILL)
                gap = core_distance(points, span, pose_of(frames, body.joint), points, other, wanted, work) - beyond
                x, y, z = work[SEPARATING], work[SEPARATING + 1], work[SEPARATING + 2]
                length = math.sqrt(x * x + y * y + z * z)
                loss, step = back, 0.0
                if not (gap > _LEAST and length > 0.0) or count >= _MOST:
                    gap, loss, going = 0.0, 0.0, False
                    length = 1.0
                elif gap - far >= min(left, _GAP_FRACTION * gap):
                    # It is far up to the next place.
                    step, going, back = gap - far, gap - far < left, 0.0
                else:
                    step = _GAP_FRACTION * gap
                    if step >= left:
                        loss, going = max(loss, left), False
                    else:
                        back = 0.5 * step
                        loss = max(loss, back)
                if gap - loss < far:
                    if count == len(found):
                        larger = np.empty((2 * count, 5))
                        larger[:count] = found
                        found = larger
                    found[count, 0] = float(p)
                    found[count, 1], found[count, 2], found[count, 3] = x / length, y / length, z / length
                    found[count, 4] = gap - loss
                    count += 1
                if going:
                    place = max(min(place_after(travel, place, step), rows), np.nextafter(place, math.inf))
    return found[:count].copy()
