"""Distances from obstacles of bodies that turn in place.

A shape that is round about the axis of the only joint that carries it, such as a turret, is the same at every value of
that joint. Its distances depend on the obstacles alone, and the collision checker (`hplan.collision.coal_scene`) has no
pairs with it. The reported clearance includes such bodies, but not those on the ground.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray
from hplan.certificate.pair_rules import PairRule
from hplan.collision.coal_accuracy import distance_errors, extents
from hplan.collision.coal_arm import BASE_DEPTH, BaseBody, base_bodies
from hplan.collision.coal_cloud import distance_from
from hplan.collision.coal_scene import CoalScene
from hplan.collision.collision_bodies import GROUND
from hplan.scene.obstacles import Solid
from hplan.scene.tracks import Movement

#: Number of sampled times in the distance bound of a moving obstacle.
_TIMES_PER_PIECE: Final = 257

#: Distance up to which the bounds among static obstacles are known [m], and the bounds.
_KNOWN: Final[WeakKeyDictionary[CoalScene, tuple[float, dict[tuple[str, str], float]]]] = WeakKeyDictionary()

#: Rules of the listed pairs.
_TURNS: Final = "they must not touch: it turns in place, so no joint moves it nearer"
_TOUCHES: Final = f"it turns in place within {1e3 * BASE_DEPTH:g} mm of it, as the ground may be"


class ClearanceInPlace(NamedTuple):
    """Distances of the bodies that turn in place.

    Attributes:
        distance_m: Lower bound of all distances, except of bodies that touch an obstacle (within `BASE_DEPTH`);
            infinite without any below the limit [m].
        rules: The pairs that are nearer than the clearance, each with its bound, and the pairs that touch.
    """

    distance_m: float
    rules: tuple[PairRule, ...]


def clearance_in_place(
    checker: CoalScene, span_s: tuple[float, float], clearance: float, most: float
) -> ClearanceInPlace:
    """Distances of the bodies that turn in place from the checker's grown obstacles.

    Args:
        checker: Collision checker of the arm among the obstacles.
        span_s: Time of the first and the last configuration, on the clock of the obstacles' movements [s].
        clearance: Clearance that all other pairs keep [m].
        most: Maximum distance of interest; larger ones are ignored [m].
    """
    rules, least = list[PairRule](), float("inf")
    for (link, obstacle), bound in _bounds_in_place(checker, span_s, most).items():
        if bound <= BASE_DEPTH:
            rules.append(PairRule(link, obstacle, f"not checked: {_TOUCHES}"))
        elif bound <= most:
            least = min(least, bound)
            if bound < clearance:
                rules.append(PairRule(link, obstacle, _TURNS, 0.0, bound))
    return ClearanceInPlace(least, tuple(rules))


def _bounds_in_place(checker: CoalScene, span_s: tuple[float, float], most: float) -> Mapping[tuple[str, str], float]:
    """Lower bounds of the distances up to `most`, by link and obstacle; some larger ones too [m].

    Among static obstacles they are computed once.
    """
    if checker.moving is not None or most < BASE_DEPTH:
        return _compute_bounds(checker, span_s, most)
    known = _KNOWN.get(checker)
    if known is None or known[0] < most:
        known = _KNOWN[checker] = 2.0 * most, _compute_bounds(checker, span_s, 2.0 * most)
    return known[1]


def _compute_bounds(checker: CoalScene, span_s: tuple[float, float], most: float) -> dict[tuple[str, str], float]:
    bounds, (centres, radii) = dict[tuple[str, str], float](), _balls_in(checker, span_s)
    for base in base_bodies(checker.robot):
        near = np.linalg.norm(centres - base.centre, axis=1) - radii - base.radius <= most
        for number in np.flatnonzero(near).tolist() if base.body.joint != GROUND else ():
            solid, growth = checker.grown_obstacles[number]
            movement = None if checker.moving is None else checker.moving.movements[number]
            off = growth + float(distance_errors(extents([base.shape]), [solid], np.zeros((0, 2, 3)))[0])
            if movement is None:
                bound = distance_from(solid, most + off)(base.shape.geometry, base.place)
            else:
                ball = checker.obstacle_balls[number] - np.array([0.0, 0.0, 0.0, growth])
                bound = _lower_bound(base, (solid, ball), movement, span_s, most + off)
            key = base.body.name, solid.name
            bounds[key] = min(bound - off, bounds.get(key, np.inf))
    return bounds


def _balls_in(checker: CoalScene, span_s: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """(n, 3) centres and (n,) radii of balls that each hold a grown obstacle during a time interval [m]."""
    centres, radii = checker.obstacle_balls[:, :3].copy(), checker.obstacle_balls[:, 3].copy()
    if checker.moving is not None:
        rows = list(checker.moving.numbers)
        centres[rows], radii[rows] = checker.moving.swept_balls(*span_s)
        radii[rows] += [checker.grown_obstacles[row][1] for row in rows]
    return centres, radii


def _lower_bound(
    base: BaseBody, obstacle: tuple[Solid, FloatArray], movement: Movement, span_s: tuple[float, float], most: float
) -> float:
    """Lower bound of the distance between a body and a moving obstacle [m].

    Args:
        obstacle: The obstacle and its bounding ball, (4,).
        movement: Its movement.
        span_s: Start and end of the time interval [s].
        most: Maximum distance of interest [m].
    """
    solid, ball = obstacle
    times = np.linspace(*span_s, _TIMES_PER_PIECE)
    rotations, shifts = movement.displacement_at(times)
    steps = movement.rates(solid.core, solid.rounding) * np.diff(movement.breaks)
    travel = np.diff(np.interp(times, movement.breaks, np.concatenate([[0.0], np.cumsum(steps)])))
    centre, radius = base.centre, base.radius
    found = np.linalg.norm(rotations @ ball[:3] + shifts - centre, axis=1) - ball[3] - radius
    distance = distance_from(solid)
    for number in np.flatnonzero(found <= most + float(travel.max() + movement.spread_at(times).max())).tolist():
        place = pin.SE3(rotations[number], shifts[number]).inverse() * base.place
        found[number] = distance(base.shape.geometry, place)
    found = found - movement.spread_at(times)
    # Between two times the distance changes by no more than the obstacle's travel.
    return float((0.5 * (found[:-1] + found[1:] - travel)).min())
