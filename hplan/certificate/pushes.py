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

from hplan.base.arrays import FloatArray, IntArray
from hplan.certificate.clearance_proof import Advancement, point_at
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
        share: Upper bound of the depth as a fraction of the limit's.
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
    (sway, travel), mover_of = search.movers, search.mover_of
    allowed = -np.broadcast_to(checker.required_distance(clearance), len(checker.pairs))
    most = allowed if proved else np.full(len(checker.pairs), math.inf)
    before = np.full(len(checker.pairs), math.inf)
    due: dict[int, list[IntArray]] = {0: [pairs]}
    for row in range(rows + 1):
        if row not in due:
            continue
        asked = np.sort(np.concatenate(due.pop(row)))
        search.place(point_at(bezier, float(row)), float(row))
        distances, movers = checker.distances_of(asked) - checker.distance_errors[asked], mover_of[asked]
        last = max(row - 1, 0)
        travelled = (travel[:, row] - travel[:, last])[movers]
        nearer = np.maximum(sway[:, row], sway[:, last])[movers]
        depths = nearer - 0.5 * (before[asked] + distances - travelled)
        for number in np.flatnonzero(depths > 0.0).tolist():
            pair, depth = int(asked[number]), min(float(depths[number]), float(most[asked[number]]))
            mover_name, other = checker.mover_names[checker.pairs[pair][0]], checker.pairs[pair][1]
            span = float(time[last]), float(time[row])
            found = Push(mover_name, checker.obstacle_names[other], depth, *span)
            limit = checker.contact_limits[other]
            if limit is not None and limit.depth > 0.0:
                moved = float(travelled[number] + nearer[number])
                speed = min(moved / max(span[1] - span[0], _TINY_S), limit.rate * depth)
                load = Load(limit, checker.joint_of(pair), depth / limit.depth, speed)
                stress = 1e-6 * (load.stress + load.impact_stress)
                found = replace(found, force_n=load.force, stress_mpa=stress, load=load)
            yield found
        following = np.full(len(asked), rows + 1)
        for mover in np.unique(movers).tolist():
            own = movers == mover
            reached = travel[mover, row] + np.maximum(distances[own] - nearer[own], 0.0)
            following[own] = np.searchsorted(travel[mover], reached, side="right") - 1
        following = np.where(following >= rows, rows + 1, np.maximum(following, row + 1))
        # A pair that skips samples cannot touch before its next query, so its last distance counts as infinite.
        before[asked] = np.where(following == row + 1, distances, math.inf)
        order = np.argsort(following, kind="stable")
        starts = np.flatnonzero(np.diff(following[order], prepend=-1))
        for place, part in zip(following[order][starts].tolist(), np.split(asked[order], starts[1:]), strict=True):
            due.setdefault(place, []).append(part)


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
