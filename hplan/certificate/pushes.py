"""What gives way during a motion: which link pushes it, how deep at most, and when.

At each row of the motion coal says how deep a pair is. Between two rows, the moving body travels a known distance at
most (`hplan.certificate.motion_bound`), and a depth changes by no more than that: so it is at most half of the sum of
both depths and that distance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.certificate.clearance_proof import Advancement, place_after, point_at
from hplan.collision.coal_scene import CoalScene


@dataclass(frozen=True)
class Push:
    """A link that pushes something that gives way.

    Attributes:
        link: Name of the link.
        obstacle: Name of the obstacle or fruit.
        depth_m: How deep the link is in it at most, tracking errors included [m].
        begin_s: Before this time the two do not touch [s].
        end_s: Nor after this one, until they are said to touch again [s].
    """

    link: str
    obstacle: str
    depth_m: float
    begin_s: float
    end_s: float


def pushes_along(
    bezier: FloatArray,
    time: FloatArray,
    checker: CoalScene,
    deviations: FloatArray,
    clearance: float,
    clock: FloatArray | None,
    *,
    proved: bool,
) -> Iterator[Push]:
    """Compute the deflection of compliant obstacles within each piece of a motion.

    Args:
        bezier: (pieces, 4, dof) Bezier points of the motion's cubics.
        time: (pieces + 1,) times of the rows [s].
        checker: The arm among the obstacles.
        deviations: (pieces, dof) largest deviation of each joint within each cubic, or (1, dof) for all of them [rad].
        clearance: Distance that all else is to keep [m].
        clock: (pieces + 1,) times of the rows, as tracks count them [s]; needed where obstacles move.
        proved: True if no pair is deeper than it may be, which then bounds its depth.
    """
    pairs = checker.pushed
    if not len(pairs):
        return
    search, rows = Advancement(bezier, checker, deviations, clearance, clock), len(bezier)
    (sway, travel), mover_of = search.movers, search.mover_of.tolist()
    allowed = -np.broadcast_to(checker.kept(clearance), len(checker.pairs))
    most = allowed if proved else np.full(len(checker.pairs), math.inf)
    before = np.full(len(checker.pairs), math.inf)
    due: dict[int, list[int]] = {0: pairs.tolist()}
    for row in range(rows + 1):
        asked = np.array(due.pop(row, []), dtype=np.int64)
        if not len(asked):
            continue
        search.place(point_at(bezier, float(row)), float(row))
        distances = checker.distances_of(asked) - checker.distance_errors[asked]
        for pair, distance in zip(asked.tolist(), distances.tolist(), strict=True):
            mover = mover_of[pair]
            travelled = float(travel[mover, row] - travel[mover, max(row - 1, 0)])
            nearer = float(max(sway[mover, row], sway[mover, max(row - 1, 0)]))
            depth = nearer - 0.5 * (float(before[pair]) + distance - travelled)
            if depth > 0.0:
                mover_name, other = checker.mover_names[checker.pairs[pair][0]], checker.pairs[pair][1]
                span = float(time[row - 1]), float(time[row])
                yield Push(mover_name, checker.obstacle_names[other], min(depth, float(most[pair])), *span)
            ahead = place_after(travel[mover], float(row), max(distance - nearer, 0.0))
            following = max(row + 1, math.floor(min(ahead, rows + 1.0)))
            # What cannot touch up to the next look has not touched before it.
            before[pair] = distance if following == row + 1 else math.inf
            due.setdefault(following, []).append(pair)


def joined(found: Iterable[Push]) -> tuple[Push, ...]:
    """Pushes as one for each time that a link touches an obstacle without a break, in the order of their begins."""
    whole: list[Push] = []
    for push in sorted(found, key=lambda push: (push.link, push.obstacle, push.begin_s)):
        last = whole[-1] if whole else push
        same = whole and (last.link, last.obstacle) == (push.link, push.obstacle)
        if same and push.begin_s <= last.end_s:
            whole[-1] = replace(last, depth_m=max(last.depth_m, push.depth_m), end_s=max(last.end_s, push.end_s))
        else:
            whole.append(push)
    return tuple(sorted(whole, key=lambda push: push.begin_s))
