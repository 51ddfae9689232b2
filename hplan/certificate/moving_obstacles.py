"""Checks of moving obstacles beyond the motion itself.

They cover the base during the motion and the arm at rest after it.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray
from hplan.certificate.clearance_proof import MOST_TRAVEL, SMALLEST_STEP, prove_clearance
from hplan.collision.coal_arm import BASE_DEPTH, BaseBody, base_bodies
from hplan.collision.coal_cloud import distance_from
from hplan.collision.coal_moving_solids import MovingSolids
from hplan.collision.coal_scene import CoalScene, Leaving
from hplan.errors import MovingObstacleError
from hplan.robot.model import Robot
from hplan.robot.upright import UprightTool
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import Sigmas, Solid, growths
from hplan.scene.tracks import Movement


def checker_in_time(robot: Robot, scene: Scene, sigmas: Sigmas) -> CoalScene:
    """Collision checker of the arm among all solids of a scene.

    Fruits are included.

    Each solid is grown for its position uncertainty. If some solids move, the checker is time-dependent. The robot
    keeps the last one for as long as the scene exists: motions that are judged one after another share it.
    """
    kept: list[_LastChecker] = robot.cache(checker_in_time, list)
    for last in kept[:]:
        if last.scene() is scene and last.sigmas == sigmas:
            return last.checker
    solids, leaving = scene.listed_solids, leaving_of(robot, scene)
    movements = scene.movements if scene.moves else ()
    grown = growths(solids, sigmas)
    checker = CoalScene(
        robot, solids, growth=grown, movements=movements, yield_links=scene.yield_links,
        clearance=0.0 if leaving is None else scene.clearance, leaving=leaving,
        upright=UprightTool.of_scene(robot, scene),
    )  # fmt: skip
    asked = dict(sigmas) if isinstance(sigmas, Mapping) else sigmas
    kept[:] = [_LastChecker(weakref.ref(scene, lambda _: kept.clear()), asked, checker)]
    return checker


class _LastChecker(NamedTuple):
    """The last checker of a robot, and what it was built for."""

    scene: weakref.ref[Scene]
    sigmas: Sigmas
    checker: CoalScene


def end_violations(checker: CoalScene, q: FloatArray, clearance: float) -> Iterator[str]:
    """Messages about pairs that were too near at the start and are still so at the end of a motion.

    Args:
        checker: The arm among the obstacles.
        q: (dof,) configuration at the end.
        clearance: Required clearance [m].
    """
    if not len(checker.near_pairs):
        return
    distances = checker.pair_distances(q)
    for pair in checker.near_pairs.tolist():
        if distances[pair] < clearance:
            name = checker.obstacle_names[checker.pairs[pair][1]]
            yield f"the motion ends {1e3 * distances[pair]:.4g} mm from obstacle {name!r}, which it has to leave"


def leaving_of(robot: Robot, scene: Scene) -> Leaving | None:
    """The start of a scene that may be nearer to obstacles than the clearance; None without `Start.contact_depth`.

    Raises:
        MovingObstacleError: An obstacle moves: nearness at the start says nothing about it.
    """
    if scene.start.contact_depth is None:
        return None
    if scene.moves:
        raise MovingObstacleError(scene.first_moving, "start.contact_depth takes scenes without moving obstacles")
    return Leaving(tuple(robot.joints_of(scene.start, "start").tolist()), scene.start.contact_depth)


def prediction_violations(moving: MovingSolids, end_s: float) -> Iterator[str]:
    """Messages about an obstacle that is not predicted up to the end of a motion.

    Args:
        moving: The obstacles.
        end_s: End of the motion on the clock of the tracks [s].
    """
    until_s, name = moving.known_until
    if end_s > until_s:
        yield (
            f"obstacle {name!r} is predicted until {until_s:.6g} s, the end of its track; the motion ends at "
            f"{end_s:.6g} s"
        )


def moving_base_contacts(robot: Robot, moving: MovingSolids, begin_s: float, end_s: float) -> Iterator[str]:
    """Messages about moving obstacles that penetrate the base deeper than `BASE_DEPTH`.

    The check is a conservative advancement in time.

    Args:
        moving: The obstacles; static ones are not checked.
        begin_s: Start of the time interval [s].
        end_s: End of the time interval [s].
    """
    centres, radii = moving.swept_balls(begin_s, end_s)
    for number, centre, radius in zip(moving.numbers, centres, radii.tolist(), strict=True):
        solid, movement = moving.solids[number], moving.movements[number]
        if movement is None or solid.meets == "pushing":
            continue
        for base in base_bodies(robot):
            if float(np.linalg.norm(centre - base.centre)) > radius + base.radius:
                continue
            at = _too_deep(base, solid, movement, moving.travelled[number], (begin_s, end_s))
            if at is not None:
                name = base.body.name
                yield f"obstacle {solid.name!r} comes into the robot's {name!r}, which does not move, at {at:.6g} s"


def _too_deep(
    base: BaseBody, solid: Solid, movement: Movement, travel: FloatArray, span_s: tuple[float, float]
) -> float | None:
    """First time of excessive penetration of a base body [s].

    An inconclusive check counts as penetration. None if there is no such time. `travel` bounds the way of the solid's
    points up to each of the movement's breaks [m].
    """
    breaks, distance, steps = movement.breaks, distance_from(solid), np.diff(travel)
    at, end_s = span_s
    # Maximum number of distance queries for one obstacle and one shape of the base. A depth within `SMALLEST_STEP` of
    # the limit counts as too deep, so an obstacle that travels 100 m along the base may need more queries.
    most_looks = 100_000
    for _ in range(most_looks):
        clock = np.array([at])
        rotation, shift = movement.displacement_at(clock)
        # In the frame of the obstacle as the scene lists it.
        spare = distance(base.shape.geometry, pin.SE3(rotation[0], shift[0]).inverse() * base.place) + BASE_DEPTH
        spare -= float(movement.spread_at(clock)[0])
        if not spare > SMALLEST_STEP:
            return at
        upto = float(np.interp(at, breaks, travel)) + MOST_TRAVEL * spare
        if upto >= travel[-1]:
            return None
        row = int(np.searchsorted(travel, upto, side="right")) - 1
        at = float(breaks[row] + (upto - travel[row]) / steps[row] * (breaks[row + 1] - breaks[row]))
        if at >= end_s:
            return None
    return at


def clear_until(q: FloatArray, checker: CoalScene, deviations: FloatArray, needed: float, from_s: float) -> float:
    """Time until which the arm at rest provably keeps its clearance [s].

    Args:
        q: (dof,) configuration.
        checker: Collision checker of the arm among the obstacles.
        deviations: (1, dof) maximum deviation of each joint [rad; m for prismatic joints].
        needed: Required clearance [m].
        from_s: Start of the rest [s].

    Returns:
        The time; infinite if the clearance is certified for all times. No later than the end of the first prediction.
    """
    if checker.moving is None:
        return math.inf
    known_until_s, _ = checker.moving.known_until
    if from_s >= checker.moving.breaks[-1]:
        return known_until_s
    breaks = checker.moving.breaks
    clock = np.concatenate([[from_s], breaks[breaks > from_s]])
    still = np.tile(q, (len(clock) - 1, 4, 1))
    # The certified part alone counts: it needs no search for the minimum distance afterwards.
    proof = prove_clearance(still, checker, deviations, needed, clock, measured=False)
    if proof.is_certified:
        return known_until_s
    return min(known_until_s, float(np.interp(proof.end, np.arange(len(clock)), clock)))
