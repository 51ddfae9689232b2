"""Distances of the round shapes of a planar arm's turret from obstacles.

A turn about the yaw axis leaves such a shape as it is, so its distances depend on the obstacles alone, and the
collision checker (`hplan.collision.coal_scene`) has no pairs of it. The base, which no joint moves, is not part of a
reported clearance; the turret is.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import pinocchio as pin

from hplan.certificate.pair_rules import PairRule
from hplan.collision.coal_accuracy import distance_errors, extents
from hplan.collision.coal_cloud import distance_from
from hplan.collision.coal_scene import CoalScene
from hplan.robot.base_shapes import BASE_DEPTH, TURRET, BaseShape, base_joints, base_shapes
from hplan.robot.model import Robot
from hplan.scene.obstacles import Solid
from hplan.scene.tracks import Movement

#: Number of times at which distances from an obstacle that moves are computed.
_TIMES: Final = 257

#: The rules of pairs.
_TURNS: Final = "they must not touch: no joint moves a round shape of the turret nearer to it"
_TOUCHES: Final = f"a round shape of the turret is within {1e3 * BASE_DEPTH:g} mm of it, as the ground may be"


class TurretClearance(NamedTuple):
    """Distances of the turret's round shapes.

    Attributes:
        distance_m: Lower bound of all of them, but for those in `touching`; infinite without any below the limit [m].
        rules: The pairs that are nearer than the clearance, each with its bound, and those that touch.
    """

    distance_m: float
    rules: tuple[PairRule, ...]


def turret_clearance(checker: CoalScene, span_s: tuple[float, float], clearance: float, most: float) -> TurretClearance:
    """Distances of the turret's round shapes from obstacles, which are grown as the checker has them.

    Args:
        checker: The arm among the obstacles.
        span_s: Time of the first and the last configuration, as the movements of obstacles count it [s].
        clearance: Clearance that all other pairs keep [m].
        most: Distances above this do not matter [m].
    """
    shapes, bounds = _round_shapes(checker.robot), dict[tuple[str, str], float]()
    for number, (solid, growth) in enumerate(checker.grown_obstacles if shapes else ()):
        movement = None if checker.moving is None else checker.moving.movements[number]
        for shape in shapes:
            key = shape.name, solid.name
            off = growth + float(distance_errors(extents([shape.placed]), [solid], np.zeros((0, 2, 3)))[0])
            bound = _lower_bound(shape, solid, movement, span_s, most + off) - off
            bounds[key] = min(bound, bounds.get(key, np.inf))
    rules, least = list[PairRule](), float("inf")
    for (link, obstacle), bound in bounds.items():
        if bound <= BASE_DEPTH:
            rules.append(PairRule(link, obstacle, f"not checked: {_TOUCHES}"))
        elif bound <= most:
            least = min(least, bound)
            if bound < clearance:
                rules.append(PairRule(link, obstacle, _TURNS, 0.0, bound))
    return TurretClearance(least, tuple(rules))


def _round_shapes(robot: Robot) -> tuple[BaseShape, ...]:
    """Shapes of a planar arm that turn with the yaw joint and are round about its axis."""
    shapes = base_shapes(robot) if base_joints(robot) else ()
    return tuple(shape for shape in shapes if shape.carrier == TURRET and shape.is_round)


def _lower_bound(
    shape: BaseShape, solid: Solid, movement: Movement | None, span_s: tuple[float, float], most: float
) -> float:
    """Lower bound of the distance of a shape from an obstacle within a span of time [m]."""
    body, distance = shape.placed.geometry, distance_from(solid, most if movement is None else np.inf)
    if movement is None:
        return distance(body, shape.placement)
    times = np.linspace(*span_s, _TIMES)
    rotations, shifts = movement.at(times)
    found = np.array(
        [
            distance(body, pin.SE3(rotation, shift).inverse() * shape.placement)
            for rotation, shift in zip(rotations, shifts, strict=True)
        ]
    )
    steps = movement.rates(solid.core, solid.rounding) * np.diff(movement.breaks)
    travel = np.interp(times, movement.breaks, np.concatenate([[0.0], np.cumsum(steps)]))
    # Between two times it loses as much as the obstacle travels at most.
    return float((0.5 * (found[:-1] + found[1:] - np.diff(travel))).min())
