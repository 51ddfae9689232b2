"""Monte Carlo estimate of how often a motion touches uncertain obstacles.

It complements the bound of `hplan.certificate.touch_risk` and shares with it only the pairs that may touch: Pinocchio
places arm and obstacles, coal computes distances, and each obstacle is placed by the drawn error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arguments import check_integer
from hplan.base.arrays import BoolArray, FloatArray
from hplan.base.deadline import check_deadline
from hplan.certificate.clearance_curve import ProvedStretch, Subject
from hplan.certificate.clearance_proof import point_at
from hplan.certificate.motion_bound import motion_of_movers
from hplan.collision.coal_cloud import distance_from, obstacle_shapes
from hplan.geometry.cloud import Cloud
from hplan.scene.model import Scene
from hplan.scene.obstacles import Solid, Sphere

#: The arm is checked each time its fastest body has travelled this far [m].
EVERY_M = 2e-3

#: Confidence level of the interval.
LEVEL = 0.95


@dataclass(frozen=True)
class TouchEstimate:
    """Frequency of contact over draws of the errors.

    Attributes:
        draws: Number of draws of all errors.
        touching: Number of draws with contact.
        low: Lower end of the 95 % Clopper-Pearson interval.
        high: Upper end of it.
    """

    draws: int
    touching: int
    low: float
    high: float

    @property
    def frequency(self) -> float:
        """Fraction of the draws with contact."""
        return self.touching / self.draws


def touch_estimate(subject: Subject, scene: Scene, draws: int = 10_000, seed: int = 0) -> TouchEstimate:
    """Draw all errors and check the motions for contact.

    Args:
        subject: The certified motions.
        scene: The scene of the certificate; its obstacles have the errors.
        draws: Number of draws.
        seed: Random seed.

    Raises:
        OptionError: `draws` is less than one.
    """
    from scipy.stats import beta

    draws = check_integer("draws", draws, 1)
    random, touched = np.random.default_rng(seed), np.zeros(draws, dtype=np.bool_)
    common = random.multivariate_normal(np.zeros(3), scene.shared_error, size=draws, method="eigh")
    shifts = {
        name: common + random.multivariate_normal(np.zeros(3), error, size=draws, method="eigh")
        for name, error in scene.errors.items()
        if error.any() or scene.covariance is not None
    }
    for motion, _ in subject.motions:
        bezier, _ = motion.trajectory.segments
        for stretch in motion.stretches:
            for solid, distance, places in _iterate_nearby(bezier[stretch.part], stretch, shifts):
                check_deadline()
                left = np.flatnonzero(~touched)
                touched[left[_contact_mask(solid, distance, places, shifts[solid.name][left])]] = True
    count = int(touched.sum())
    low = float(beta.ppf(0.5 - 0.5 * LEVEL, count, draws - count + 1)) if count else 0.0
    high = float(beta.ppf(0.5 + 0.5 * LEVEL, count + 1, draws - count)) if count < draws else 1.0
    return TouchEstimate(draws, count, low, high)


#: Distance function of a placed shape.
_Distance = Callable[[coal.CollisionGeometry, pin.SE3], float]

#: A shape of the arm and its placement, its distance from the solid, and the allowed deflection.
_Place = tuple[coal.CollisionGeometry, pin.SE3, float, float]


def _iterate_nearby(
    bezier: FloatArray, stretch: ProvedStretch, shifts: dict[str, FloatArray]
) -> Iterator[tuple[Solid, _Distance, list[_Place]]]:
    """Obstacles that a draw may bring into contact, with nearby shapes.

    Yields the solid, its distance function, and the placed shapes near it.
    """
    robot, checker = stretch.checker.robot, stretch.checker
    shapes, solids, depths = checker.meetings
    _, moved, _ = motion_of_movers(checker, bezier, np.zeros((1, robot.dof)))
    travelled = np.append(0.0, np.cumsum(moved.max(axis=0, initial=0.0)))
    count = int(np.ceil(travelled[-1] / EVERY_M)) + 1
    rows = np.interp(np.linspace(0.0, travelled[-1], count), travelled, np.arange(len(travelled)))
    data = robot.model.createData()
    reach = {name: float(np.linalg.norm(shift, axis=1).max()) for name, shift in shifts.items()}
    parts = [(number, part) for number, solid in enumerate(solids) if solid.name in reach for part in _convex(solid)]
    if not parts:
        return
    middles = np.array([core.mean(axis=0) for _, (core, _) in parts])
    sizes = np.array(
        [
            float(np.linalg.norm(core - middle, axis=1).max()) + radius + reach[solids[number].name]
            for (number, (core, radius)), middle in zip(parts, middles, strict=True)
        ]
    )
    of_shapes = []
    for shape in shapes:
        shape.geometry.computeLocalAABB()
        of_shapes.append((np.array(shape.geometry.aabb_center), float(shape.geometry.aabb_radius)))
    found: dict[int, list[_Place]] = {}
    asked: dict[int, tuple[Solid, _Distance]] = {}
    for row in rows.tolist():
        pin.forwardKinematics(robot.model, data, point_at(bezier, row))
        for k, shape in enumerate(shapes):
            place = data.oMi[shape.parentJoint] * shape.placement
            centre, radius = of_shapes[k]
            apart = np.linalg.norm(middles - place.act(centre), axis=1) - sizes - radius
            for n in np.flatnonzero(apart < 0.0).tolist():
                number, (core, size) = parts[n]
                depth = float(depths[k, number])
                if depth == np.inf:
                    continue
                if n not in asked:
                    solid = solids[number]
                    if isinstance(solid, Cloud):
                        solid = Sphere(name=solid.name, center=core[0], radius=size)
                    asked[n] = solid, distance_from(solid)
                solid, distance_of = asked[n]
                distance = distance_of(shape.geometry, place) + depth
                if distance <= reach[solid.name]:
                    found.setdefault(n, []).append((shape.geometry, place, distance, depth))
    yield from ((*asked[n], places) for n, places in found.items())


def _convex(solid: Solid) -> Iterator[tuple[FloatArray, float]]:
    """Core and rounding of a solid or of a cloud's balls."""
    cores = solid.core[:, None] if isinstance(solid, Cloud) else [solid.core]
    yield from ((core, solid.rounding) for core in cores)


def _contact_mask(solid: Solid, distance: _Distance, places: list[_Place], shifts: FloatArray) -> BoolArray:
    """(k,) mask of the shifts that bring a solid into contact.

    `shifts` is (k, 3); contact is with any of the shapes in `places`.
    """
    places = sorted(places, key=lambda place: place[2])
    nearest = np.array([place[2] for place in places])
    sizes = np.linalg.norm(shifts, axis=1)
    # A convex solid that stays on its side of the plane between it and a shape does not touch the shape.
    other = obstacle_shapes([solid])[0]
    apart = nearest > np.array([place[3] for place in places])
    side = (shifts @ np.array([_separating_direction(other, place) for place in places]).T >= nearest - 1e-4) | ~apart
    touching = np.zeros(len(shifts), dtype=np.bool_)
    for draw in np.flatnonzero(sizes >= nearest[0]).tolist():
        for k in np.flatnonzero(side[draw] & (nearest <= sizes[draw])).tolist():
            shape, place, _, depth = places[k]
            moved = pin.SE3(place.rotation, place.translation - shifts[draw])
            if distance(shape, moved) + depth <= 0.0:
                touching[draw] = True
                break
    return touching


def _separating_direction(solid: Any, place: _Place) -> FloatArray:
    """(3,) direction from a solid to a placed shape, by coal."""
    result, at = coal.DistanceResult(), place[1]
    where = coal.Transform3s(at.rotation, at.translation)
    there = coal.Transform3s(solid.placement.rotation, solid.placement.translation)
    coal.distance(place[0], where, solid.geometry, there, coal.DistanceRequest(), result)
    return -np.array(result.normal)
