r"""The probability that a motion touches anything, where obstacles are not quite where they were seen.

Of each obstacle the error of its place is drawn once for the whole motion: a shift :math:`e`, Gaussian with a
covariance. With a unit vector :math:`n`, some convex part of the obstacle and a body of the arm that are apart by
:math:`g` along it,

.. math:: \min_{a \in \text{body}} n \cdot a - \max_{o \in \text{part}} n \cdot o \ge g,

touch after the shift only if :math:`n \cdot e \ge g`. Such half-spaces are found along the motion, for each body and
each part, by the greatest such gap at some configurations (`hplan.collision.convex_distance`, which returns the gap of
the direction that it gives: that it is the greatest need not be right). About one of them a gap is less by what the
body travels and by what tracking errors displace it (`hplan.certificate.motion_bound`); each time of the motion belongs
to a half-space of its pair, or has a distance of more than :math:`7` standard deviations in all directions. So the
obstacle is touched at some time only if its error is in one of the half-spaces, or that far off: sums are over
obstacles, not over time.

**How probable that is.** In coordinates in which :math:`e` is a standard normal variable, the half-spaces are those
beyond planes at distances :math:`\delta_k` in directions :math:`m_k`. In a direction :math:`u` they begin at
:math:`t(u) = \min_k \delta_k / (m_k \cdot u)_+`, so the probability is the mean over the sphere of
:math:`P(\chi_3 > t(u))`. The sphere is cut into cells; with the largest :math:`m_k \cdot u` of each cell that is an
upper bound. Of one plane it is the half-space bound :math:`\Phi(-\delta)`, of planes all round the ball's
:math:`P(\chi_3 > \delta)`, and what is between of all others.

**Errors that are common to all.** The obstacle's shift is :math:`e_i + e_0`, with the same :math:`e_0` of all (of the
camera, of the base). Two bounds hold: the sum over obstacles with the sum of both covariances; and, as
:math:`n \cdot (e_i + e_0) \ge g` only if :math:`n \cdot e_0 \ge \lambda g` or :math:`n \cdot e_i \ge (1 - \lambda) g`,
the probability of all half-spaces of :math:`e_0` together, and of each obstacle's own. The smaller one is taken.

Assumed: errors shift an obstacle and do not turn it. No motion changes what pedestal, and what of the turret is round,
stand in, nor what the turret stands on or turns over: that is not counted. What the motion may touch (the fruit that is
picked) counts only where it may not; what gives way may be pushed as deep as it yields.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Final

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, frozen
from hplan.base.deadline import check_deadline
from hplan.base.kernels import any_int, kernel
from hplan.certificate.clearance_curve import ProvedMotion, ProvedStretch, Subject
from hplan.certificate.clearance_proof import Advancement, place_after, point_at
from hplan.certificate.touch_estimate import TouchEstimate, touch_estimate
from hplan.collision import flat_bodies as flat
from hplan.collision.body_kernels import pose_of
from hplan.collision.coal_scene import CoalScene
from hplan.collision.convex_distance import SEPARATING, WORK, Wanted, core_distance
from hplan.collision.placed_bodies import place_joints
from hplan.collision.sweep import STILL
from hplan.robot.family_reader import outline
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import largest_deviation
from hplan.scene.solids import Cloud

#: Beyond so many standard deviations nothing is looked at: 2e-10 of a place's errors are farther off.
FAR: Final = 7.0

#: Part of a gap that a body may travel before the next half-space, where it is near.
_STEP: Final = 0.03

#: A gap below which an obstacle counts as touched [m]; half-spaces that are looked for at most in a stretch.
_LEAST, _MOST = 1e-6, any_int(2_000_000)

#: Columns of a moving shape, then of a part of an obstacle: first and last place of its points, radius; then joint and
#: displacement bound of the shape, or the gap from which on the part is far.
_FIRST, _LAST, _RADIUS, _JOINT, _SWAY, _FARTHEST = 0, 1, 2, 3, 4, 3

#: Columns of a half-space: the obstacle (the part, in the kernel), the direction from it to the arm, the gap.
_OBSTACLE, _NORMAL, _GAP = 0, 1, 4


@dataclass(frozen=True)
class Share:
    """An obstacle, and the probability of its part.

    Attributes:
        obstacle: Its name.
        probability: Upper bound of the probability that its own error brings it into the motion.
        clearance_m: Distance that the motion keeps from it where it was seen, at least; inf where it is far [m].
    """

    obstacle: str
    probability: float
    clearance_m: float


@dataclass(frozen=True)
class TouchRisk:
    """The probability that a motion touches anything.

    Attributes:
        asked: What it is to be at most.
        bound: What it is shown to be at most.
        shares: What each obstacle has of it, the largest first; none of those that are far.
        shared: What the error that is common to all has of it; 0 where it was added to each obstacle's own.
        subject: The motions.
        scene: What they are among.
    """

    asked: float
    bound: float
    shares: tuple[Share, ...]
    shared: float
    subject: Subject = field(compare=False, repr=False)
    scene: Scene = field(compare=False, repr=False)

    @cached_property
    def estimate(self) -> TouchEstimate:
        """How often something is touched in 10,000 draws of all errors; drawn when it is first asked for."""
        return touch_estimate(self.subject, self.scene)

    @property
    def violation(self) -> str:
        """What is to be said where the bound is larger than what was asked for."""
        most = f", most of it {self.shares[0].obstacle!r}" if self.shares else ""
        return (
            f"it may touch something with a probability of {self.bound:.3g}{most}; to be shown: at most {self.asked:g}"
        )


def touch_risk(subject: Subject, scene: Scene, asked: float) -> TouchRisk:
    """Bound the probability that the motions of a certificate touch anything.

    Args:
        scene: What they were certified among; its obstacles have the errors.
        asked: What the probability is to be at most.
    """
    errors, shared = scene.errors, scene.shared_error
    # Far is what is far in both ways to count the shared error: what it is added to, and what it is beside.
    far = {name: FAR * (largest_deviation(error) + largest_deviation(shared)) for name, error in errors.items()}
    names = list(far)
    found = [rows for motion, _ in subject.motions for rows in _along(motion, far)]
    rows = np.concatenate([np.zeros((0, 5)), *found])
    owner = rows[:, _OBSTACLE].astype(np.int64)
    uncertain = [number for number, name in enumerate(names) if far[name] > 0.0]
    order = np.argsort(owner, kind="stable")
    rows, owner = rows[order], owner[order]
    starts = np.searchsorted(owner, np.arange(len(names) + 1))
    parts = {n: rows[starts[n] : starts[n + 1]] for n in uncertain}
    whole = {n: _beyond(part[:, 1:4], part[:, _GAP], errors[names[n]] + shared) for n, part in parts.items()}
    bound, common, own = sum(whole.values()), 0.0, whole
    if shared.any() and all((part[:, _GAP] > 0.0).all() for part in parts.values()):
        of_all, alone = [np.zeros((0, 4))], {}
        for n, part in parts.items():
            normals, error = part[:, 1:4], errors[names[n]]
            of_shared, of_own = _deviations(normals, shared), _deviations(normals, error)
            # The gap is for both, in proportion to what either may be; for one alone where the other is none.
            share = part[:, _GAP] / np.maximum(of_shared + of_own, 1e-300)
            moved = of_own > 0.0
            alone[n] = _beyond(normals[moved], (share * of_own)[moved], error) if error.any() else 0.0
            moved = of_shared > 0.0
            of_all.append(np.column_stack([normals, share * of_shared])[moved])
        together = np.concatenate(of_all)
        common_part = _beyond(together[:, :3], together[:, 3], shared)
        if common_part + sum(alone.values()) < bound:
            bound, common, own = common_part + sum(alone.values()), common_part, alone
    least = {n: float(part[:, _GAP].min(initial=math.inf)) for n, part in parts.items()}
    shares = [Share(names[n], own[n], least[n]) for n in uncertain if least[n] < math.inf]
    shares.sort(key=lambda share: (-share.probability, share.obstacle))
    return TouchRisk(asked, min(1.0, float(bound)), tuple(shares), common, subject, scene)


def _along(motion: ProvedMotion, far: dict[str, float]) -> Iterator[FloatArray]:
    """Half-spaces of the stretches of a motion."""
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
        # Nothing is known of it: each obstacle may be touched.
        touched = np.unique(obstacle[obstacle >= 0])
        return np.column_stack([touched, np.zeros((len(touched), 4))])
    bodies, parts, numbers = _numbers_of(robot, checker, far)
    (sway, travel), first = search.movers, search.mover_of[:: len(solids)][: len(shapes)]
    bodies[:, _SWAY] = sway[first].max(axis=1)
    solid_of = parts[:, -1].astype(np.int64)
    allowed = np.ascontiguousarray(depths[:, solid_of])
    rows = _half_spaces(np.ascontiguousarray(bezier), numbers, bodies, travel[first], parts, allowed)
    rows[:, _OBSTACLE] = obstacle[solid_of[rows[:, _OBSTACLE].astype(np.int64)]]
    return rows


def _numbers_of(robot: Robot, checker: CoalScene, far: dict[str, float]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Moving shapes, parts of the obstacles that have errors (last which of the solids each is of), numbers of both."""
    shapes, solids, _ = checker.meetings
    numbers = [flat.joints_alone(robot)]
    end = len(numbers[0])

    def placed(points: FloatArray) -> tuple[int, int]:
        nonlocal end
        numbers.append(points.ravel())
        end += points.size
        return end - points.size, end

    bodies = np.zeros((len(shapes), 5))
    for row, shape in enumerate(shapes):
        points, radius = outline(shape, rim_from_outside=True)
        at: pin.SE3 = shape.placement
        bodies[row, :_SWAY] = *placed(points @ at.rotation.T + at.translation), radius, shape.parentJoint - 1
    parts = [np.zeros((0, 5))]
    for number, solid in enumerate(solids):
        if far.get(solid.name, 0.0) > 0.0:
            begin, last = placed(solid.core)
            firsts = np.arange(begin, last, 3 if isinstance(solid, Cloud) else last - begin)
            each = np.full(len(firsts), 1.0)
            lasts = np.append(firsts[1:], last)
            parts.append(np.column_stack([firsts, lasts, *np.outer([solid.rounding, far[solid.name], number], each)]))
    return bodies, np.concatenate(parts), np.concatenate(numbers)


def _root(covariance: FloatArray) -> FloatArray:
    """(3, 3) a matrix that makes of standard normal numbers an error of a covariance."""
    values, axes = np.linalg.eigh(covariance)
    root: FloatArray = axes * np.sqrt(np.maximum(values, 0.0))
    return root


def _deviations(normals: FloatArray, covariance: FloatArray) -> FloatArray:
    """(k,) standard deviations of an error along directions."""
    deviations: FloatArray = np.sqrt(((normals @ _root(covariance)) ** 2).sum(axis=1))
    return deviations


def _beyond(normals: FloatArray, gaps: FloatArray, covariance: FloatArray) -> float:
    """Upper bound of the probability that an error is in one of some half-spaces, or far off.

    Args:
        normals: (k, 3) unit vectors.
        gaps: (k,) how far along each a half-space begins [m].
        covariance: (3, 3) of the error [m^2].
    """
    if not covariance.any():
        return float((gaps <= 0.0).any())
    if not (gaps > 0.0).all():
        return 1.0
    along = normals @ _root(covariance)
    lengths = np.sqrt((along * along).sum(axis=1))
    kept = gaps < FAR * lengths
    if not kept.any():
        return float(beyond_sigmas(FAR))
    starts = gaps[kept] / lengths[kept]
    order = np.argsort(starts)
    directions = np.ascontiguousarray((along[kept] / lengths[kept, None])[order])
    centres, weights, radius = _cells()
    return _mean_beyond(centres, weights, radius, directions, np.ascontiguousarray(starts[order]))


@cache
def _cells() -> tuple[FloatArray, FloatArray, float]:
    """Cells of a sphere: (c, 3) centres, (c,) parts of the area, and how far any point is from its centre [rad]."""
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
    # How often the triangles of an icosahedron are cut into four, for the cells of a sphere.
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
    """Mean over the cells of the probability that a standard normal variable is beyond one of some planes, or far.

    Args:
        directions: (k, 3) of the planes.
        starts: (k,) distances of the planes, the nearest first.
    """
    cos, sin, total = math.cos(radius), math.sin(radius), 0.0
    for cell in range(len(weights)):
        begins = FAR
        for k in range(len(starts)):
            if starts[k] >= begins:
                break
            along = (
                centres[cell, 0] * directions[k, 0]
                + centres[cell, 1] * directions[k, 1]
                + centres[cell, 2] * directions[k, 2]
            )
            # The cosine of an angle that is smaller by the cell's radius, at most larger by that radius.
            if begins * (along + radius) <= starts[k]:
                continue
            most = 1.0 if along >= cos else along * cos + math.sqrt(1.0 - along * along) * sin
            if begins * most > starts[k]:
                begins = starts[k] / most
        total += weights[cell] * beyond_sigmas(begins)
    return total


@kernel
def beyond_sigmas(sigmas: float) -> float:
    """Probability that a place is off by more than so many sigmas, sigma being that of each coordinate in space.

    The distance has the chi distribution of three degrees of freedom: beyond three sigmas are 2.9 %, not the 0.3 % of a
    single coordinate.
    """
    tail: float = math.erfc(sigmas / math.sqrt(2.0))
    return tail + math.sqrt(2.0 / math.pi) * sigmas * math.exp(-0.5 * sigmas * sigmas)


@kernel
def _half_spaces(
    bezier: FloatArray, numbers: FloatArray, bodies: FloatArray, travels: FloatArray, parts: FloatArray,
    allowed: FloatArray,
) -> FloatArray:  # fmt: skip
    """(k, 5) half-spaces, so that each time of each pair belongs to one, or has a distance that is far.

    Args:
        bezier: (pieces, 4, dof) Bezier points of the motion's cubics.
        numbers: Head, joints, and points of bodies and parts.
        bodies: (bodies, 5) rows of moving shapes.
        travels: (bodies, pieces + 1) how far each has travelled at most at each row.
        parts: (parts, 5) rows of parts of obstacles.
        allowed: (bodies, parts) how deep the two may be in one another; infinite where that is not asked.
    """
    dof, rows = bezier.shape[2], float(bezier.shape[0])
    frames, work = np.empty((dof + 1, 12)), np.zeros(WORK)
    found, count = np.empty((256, 5)), 0
    for b in range(len(bodies)):
        span, joint = (int(bodies[b, _FIRST]), int(bodies[b, _LAST]), 0), int(bodies[b, _JOINT])
        travel = travels[b]
        for p in range(len(parts)):
            if allowed[b, p] == math.inf:
                continue
            other = (int(parts[p, _FIRST]), int(parts[p, _LAST]), 0)
            radii, far = bodies[b, _RADIUS] + parts[p, _RADIUS], parts[p, _FARTHEST]
            beyond = radii + bodies[b, _SWAY] - allowed[b, p]
            for c in range(WORK):
                work[c] = 0.0
            place, back, going = 0.0, 0.0, True
            while going:
                row = min(int(place), len(travel) - 2)
                now = travel[row] + (place - row) * (travel[row + 1] - travel[row])
                left = max(0.0, travel[len(travel) - 1] - now)
                place_joints(point_at(bezier, place), numbers, frames)
                wanted = Wanted(math.inf, 0.0, 1e-4, radii, STILL)
                gap = core_distance(numbers, span, pose_of(frames, joint), numbers, other, wanted, work) - beyond
                x, y, z = work[SEPARATING], work[SEPARATING + 1], work[SEPARATING + 2]
                length = math.sqrt(x * x + y * y + z * z)
                loss, step = back, 0.0
                if not (gap > _LEAST and length > 0.0) or count >= _MOST:
                    gap, loss, going = 0.0, 0.0, False
                    length = 1.0
                elif gap - far >= min(left, _STEP * gap):
                    # Up to the next place it is far.
                    step, going, back = gap - far, gap - far < left, 0.0
                else:
                    step = _STEP * gap
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
