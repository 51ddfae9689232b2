"""Contacts of a path of straight motions, and near contacts.

Motions that the compiled distances verify are clear. On each of the others the place with the minimum clearance is
searched among closely spaced configurations, and coal determines the bodies and the depth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray
from hplan.collision.reach import reach
from hplan.errors import ConfigurationInCollisionError, PathInContactError
from hplan.planning.finishing.given_path import GivenPath
from hplan.planning.world import World

#: Maximum displacement of any point of the arm between two sampled configurations [m], and the maximum number of steps.
STEP_M, MOST_STEPS = 2e-3, 4000

#: Number of valleys, and of other configurations with too little clearance, that coal checks on each motion.
_VALLEYS, _SPREAD = 12, 48


class Place(NamedTuple):
    """A place on a path in contact or with too little clearance.

    Attributes:
        number: Number of the waypoint, or of the first waypoint of the motion, from 0.
        fraction: Fraction of the motion before the place; 0 at a waypoint.
        at_waypoint: True if the waypoint itself is the place.
        error: Link, obstacle, depth and required clearance.
    """

    number: int
    fraction: float
    at_waypoint: bool
    error: ConfigurationInCollisionError

    @property
    def touches(self) -> bool:
        """True if the bodies touch; False if they are only too close."""
        return self.error.depth_m >= self.error.clearance_m


def places_of(world: World, path: GivenPath, margin: float) -> Iterator[Place]:
    """The places of a path in contact or too close, in order.

    They are waypoints, and places on motions between clear waypoints.

    Args:
        margin: Clearance beyond the required one for motions to be verified collision-free [m].
    """
    points = path.points
    low = np.flatnonzero(world.field.along(points).min(axis=1) < margin).tolist()
    near = {number: _judged(world, points[number]) for number in low}
    for number in range(len(points)):
        error = near.get(number)
        if error is not None:
            yield Place(number, 0.0, True, error)
        ends = points[number : number + 2]
        free = error is None and near.get(number + 1) is None
        if len(ends) == 2 and free and not world.field.is_clear(ends, margin):
            place = _nearest(world, ends, number)
            if place is not None:
                yield place


def refuse(path: GivenPath, places: list[Place]) -> PathInContactError:
    """The error that names one or more places of a path."""
    facts = [_facts(path, place) for place in places]
    first, fact = places[0], facts[0]
    if first.at_waypoint:
        where = f"waypoint {fact['waypoint']}"
    else:
        after = int(path.numbers[first.number + 1])
        where = f"at {100.0 * first.fraction:.1f} % between waypoints {fact['segment']} and {after}, the path"
    more = f"; {len(places) - 1} more such places follow" if len(places) > 1 else ""
    words = first.error.message.removeprefix(first.error.which).lstrip()
    return PathInContactError(f"{where} {words}{more}", facts)


def _facts(path: GivenPath, place: Place) -> dict[str, object]:
    number, error = int(path.numbers[place.number]), place.error
    return {
        "waypoint": number if place.at_waypoint else None,
        # With repeated waypoints the motion starts at the last of them.
        "segment": None if place.at_waypoint else int(path.numbers[place.number + 1]) - 1,
        "fraction": place.fraction,
        "link": error.link,
        "obstacle": error.obstacle,
        "depth_m": error.depth_m,
        "clearance_m": error.clearance_m,
        "touches": place.touches,
    }


def _judged(world: World, q: FloatArray) -> ConfigurationInCollisionError | None:
    """Check a configuration with coal: the error, or None if clear."""
    try:
        world.check_clear(q, "it")
    except ConfigurationInCollisionError as error:
        return error.with_traceback(None)
    return None


def _nearest(world: World, ends: FloatArray, number: int) -> Place | None:
    """The deepest contact found between two clear waypoints, or None."""
    first, step = ends[0], ends[1] - ends[0]
    travel = float((reach(world.robot) @ np.abs(step)).max(initial=0.0))
    count = int(min(max(2, math.ceil(travel / STEP_M)), MOST_STEPS))
    fractions = np.linspace(0.0, 1.0, count + 1)
    clearances = world.field.along(first + fractions[:, None] * step).min(axis=1)
    deepest: tuple[float, ConfigurationInCollisionError] | None = None

    def look_at(fraction: float) -> None:
        nonlocal deepest
        error = _judged(world, first + fraction * step)
        if error is not None and (deepest is None or _excess(error) > _excess(deepest[1])):
            deepest = fraction, error

    for at in _candidates(clearances).tolist():
        look_at(float(fractions[at]))
    if deepest is None:
        valley = int(ties.argmin(clearances))
        centre = float(fractions[valley])
    else:
        centre = deepest[0]
    width = 1.0 / count
    # Bisection around the nearest configuration.
    for _ in range(12):
        width *= 0.5
        tried = np.clip([centre - width, centre, centre + width], 0.0, 1.0)
        if deepest is None:
            centre = float(tried[ties.argmin(world.field.along(first + tried[:, None] * step).min(axis=1))])
            look_at(centre)
        else:
            for fraction in (tried[0], tried[2]):
                look_at(float(fraction))
            centre = deepest[0]
    return None if deepest is None else Place(number, deepest[0], False, deepest[1])


def _excess(error: ConfigurationInCollisionError) -> float:
    return error.depth_m - error.clearance_m


def _candidates(clearances: FloatArray) -> IntArray:
    """Indices of the configurations along a motion that coal checks.

    They are the lowest valleys, and evenly spread ones of those without clearance.
    """
    padded = np.concatenate([[math.inf], clearances, [math.inf]])
    valleys = np.flatnonzero((clearances <= padded[:-2]) & (clearances <= padded[2:]))
    lowest = valleys[np.argsort(clearances[valleys], kind="stable")[:_VALLEYS]]
    low = np.flatnonzero(clearances <= 0.0)
    spread = low[np.unique(np.linspace(0, len(low) - 1, min(_SPREAD, len(low))).astype(np.int64))] if len(low) else low
    return np.unique(np.concatenate([lowest, spread]))
