"""Contacts with compliant obstacles: the link, the maximum deflection and the time.

At each sample of the motion coal returns the depth of a pair. Between two samples the travel of the moving body is
bounded (`hplan.certificate.motion_bound`), and a depth changes by no more than the travel. So the depth is at most half
of the sum of both depths and the travel.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.certificate.clearance_proof import Advancement, place_after, point_at
from hplan.collision.coal_scene import CoalScene
from hplan.scene.obstacle_kind import ContactLimit


@dataclass(frozen=True)
class Push:
    """Contact of a link with a compliant obstacle.

    Attributes:
        link: Name of the link.
        obstacle: Name of the obstacle or fruit.
        depth_m: Upper bound of the deflection, tracking errors included [m].
        begin_s: No contact before this time [s].
        end_s: No contact after this time, until the next listed contact of the two [s].
        force_n: Upper bound of the force on a limb, or on the stalk of a fruit, impact included [N]; None for obstacles
            without a limb.
        stress_mpa: Upper bound of the bending stress of the limb by this contact, impact included [MPa]; None as above.
        load: Details for `hplan.certificate.limb_loads`; None as above, and for merged contacts.
    """

    link: str
    obstacle: str
    depth_m: float
    begin_s: float
    end_s: float
    force_n: float | None = None
    stress_mpa: float | None = None
    load: Load | None = field(default=None, repr=False, compare=False)


class Load(NamedTuple):
    """A contact with a part of a limb or with a fruit, within one segment of a motion.

    Attributes:
        limit: What the deepest permitted contact does.
        joint: Joint that carries the link.
        share: Upper bound of the depth as a fraction of the permitted one.
        speed: Upper bound of the speed of the link [m/s], or of that to which a contact of this depth accelerates the
            limb or fruit, if that is less.
    """

    limit: ContactLimit
    joint: int
    share: float
    speed: float

    @property
    def force(self) -> float:
        """Upper bound of the force [N]."""
        return self.share * self.limit.force + self.impact

    @property
    def impact(self) -> float:
        """The part of the force that the speed adds [N]."""
        return self.limit.impact * self.speed + self.limit.swing * self.speed**2

    @property
    def stress(self) -> float:
        """Upper bound of the static bending stress [Pa]."""
        return self.share * self.limit.stress

    @property
    def impact_stress(self) -> float:
        """Bending stress that the speed adds [Pa]."""
        return self.limit.impact_stress * self.speed


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
    """Bound the deflection of compliant obstacles within each segment of a motion.

    Args:
        bezier: (pieces, 4, dof) Bezier points of the motion's cubics.
        time: (pieces + 1,) times of the samples [s].
        checker: The arm among the obstacles.
        deviations: (pieces, dof) maximum joint deviations within each cubic, or (1, dof) for all of them [rad].
        clearance: Clearance required from non-compliant obstacles [m].
        clock: (pieces + 1,) times of the samples on the clock of the tracks [s]; required if obstacles move.
        proved: True if the allowed deflection of every pair is certified; it then caps the bound.

    Yields:
        A contact for each segment and pair that may touch in it.
    """
    pairs = checker.compliant_pairs
    if not len(pairs):
        return
    search, rows = Advancement(bezier, checker, deviations, clearance, clock), len(bezier)
    (sway, travel), mover_of = search.movers, search.mover_of.tolist()
    allowed = -np.broadcast_to(checker.required_distance(clearance), len(checker.pairs))
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
                depth = min(depth, float(most[pair]))
                found = Push(mover_name, checker.obstacle_names[other], depth, *span)
                limit = checker.contact_limits[other]
                if limit is not None and limit.depth > 0.0:
                    speed = min((travelled + nearer) / max(span[1] - span[0], _TINY_S), limit.rate * depth)
                    load = Load(limit, checker.joint_of(pair), depth / float(allowed[pair]), speed)
                    stress = 1e-6 * (load.stress + load.impact_stress)
                    found = replace(found, force_n=load.force, stress_mpa=stress, load=load)
                yield found
            ahead = place_after(travel[mover], float(row), max(distance - nearer, 0.0))
            following = max(row + 1, math.floor(min(ahead, rows + 1.0)))
            # A pair that skips samples cannot touch before its next query, so its last distance counts as infinite.
            before[pair] = distance if following == row + 1 else math.inf
            due.setdefault(following, []).append(pair)


#: Shortest time in which a speed is measured [s].
_TINY_S = 1e-9


def _larger(one: float | None, other: float | None) -> float | None:
    """The larger of two values that may be missing."""
    known = [value for value in (one, other) if value is not None]
    return max(known, default=None)


def merge_contacts(found: Iterable[Push]) -> tuple[Push, ...]:
    """Merge contacts of a link and obstacle without a gap between.

    The result is sorted by start time.
    """
    whole: list[Push] = []
    for push in sorted(found, key=lambda push: (push.link, push.obstacle, push.begin_s)):
        last = whole[-1] if whole else push
        same = whole and (last.link, last.obstacle) == (push.link, push.obstacle)
        if same and push.begin_s <= last.end_s:
            whole[-1] = replace(
                last, depth_m=max(last.depth_m, push.depth_m), end_s=max(last.end_s, push.end_s),
                force_n=_larger(last.force_n, push.force_n), stress_mpa=_larger(last.stress_mpa, push.stress_mpa),
            )  # fmt: skip
        else:
            whole.append(replace(push, load=None))
    return tuple(sorted(whole, key=lambda push: push.begin_s))
