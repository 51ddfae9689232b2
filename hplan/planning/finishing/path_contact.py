"""Where a path of straight motions touches something, or comes closer to it than the clearance to keep.

Motions that the compiled distances show clear are. Of the others the place that comes nearest is looked for among
configurations close to each other, and coal says what is there.
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

#: No point of the arm moves farther than this between two configurations that are looked at [m], unless they are as
#: many as the most.
STEP_M, MOST_STEPS = 2e-3, 4000

#: Of the configurations with the least clearance along a motion, so many valleys and so many others are put to coal.
_VALLEYS, _SPREAD = 12, 48


class Place(NamedTuple):
    """A place along a path that touches something, or comes too close.

    Attributes:
        number: Of the waypoint, or of the first of the motion's two, among those of the path, from 0.
        fraction: How far along the motion it is; 0 at a waypoint.
        at_waypoint: True if the waypoint itself is the place.
        error: Link, obstacle, depth and clearance to keep.
    """

    number: int
    fraction: float
    at_waypoint: bool
    error: ConfigurationInCollisionError

    @property
    def touches(self) -> bool:
        """True if the bodies touch; False if they are only closer than the clearance to keep."""
        return self.error.depth_m >= self.error.clearance_m


def places_of(world: World, path: GivenPath, margin: float) -> Iterator[Place]:
    """The places of a path where it is in contact or too close, in order: waypoints, and motions between free ones.

    Args:
        margin: Clearance beyond the one to keep with which motions are verified collision-free [m].
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
    """The error that names places of a path, one or more."""
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
        # Of repeated waypoints the motion leads away from the last.
        "segment": None if place.at_waypoint else int(path.numbers[place.number + 1]) - 1,
        "fraction": place.fraction,
        "link": error.link,
        "obstacle": error.obstacle,
        "depth_m": error.depth_m,
        "clearance_m": error.clearance_m,
        "touches": place.touches,
    }


def _judged(world: World, q: FloatArray) -> ConfigurationInCollisionError | None:
    """What a configuration touches or comes too close to, by coal; None for nothing."""
    try:
        world.check_clear(q, "it")
    except ConfigurationInCollisionError as error:
        return error.with_traceback(None)
    return None


def _nearest(world: World, ends: FloatArray, number: int) -> Place | None:
    """The deepest place found on a motion between two free waypoints; None where coal finds it clear."""
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
    # Halvings of the distance between two configurations about the nearest one.
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
    """Of the configurations along a motion those that coal is to look at: the lowest valleys, and some of the rest."""
    padded = np.concatenate([[math.inf], clearances, [math.inf]])
    valleys = np.flatnonzero((clearances <= padded[:-2]) & (clearances <= padded[2:]))
    lowest = valleys[np.argsort(clearances[valleys], kind="stable")[:_VALLEYS]]
    low = np.flatnonzero(clearances <= 0.0)
    spread = low[np.unique(np.linspace(0, len(low) - 1, min(_SPREAD, len(low))).astype(np.int64))] if len(low) else low
    return np.unique(np.concatenate([lowest, spread]))
