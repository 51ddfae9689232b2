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

from hplan.base.arrays import BoolArray, FloatArray, IntArray, TableArray
from hplan.base.kernels import kernel
from hplan.certificate.clearance_proof import Advancement, point_at
from hplan.collision.coal_boxes import PairBoxes, box_separation, joints_as_pinocchio
from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_placements import place_joints
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
        whole_depth: Upper bound of the depth in a fruit as it hangs, which is not extended along its stalk [m]; 0 for
            limbs.
    """

    limit: ContactLimit
    joint: int
    share: float
    speed: float
    whole_depth: float = 0.0

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
    (sway, travel), mover_of = search.movers, search.mover_of[pairs]
    nearer = np.broadcast_to(sway, travel.shape)
    asked, may_touch = _possible_contacts(
        bezier, pairs, checker.boxes, joints_as_pinocchio(checker.robot), checker.taken_off[pairs], mover_of,
        _Movers(travel, np.ascontiguousarray(nearer)),
    )  # fmt: skip
    whole = checker.whole_fruit_pairs(pairs)
    distances, from_whole = np.full((2, rows + 1, len(pairs)), math.inf)
    free_until = np.zeros(len(pairs), dtype=np.int64)
    for row in np.flatnonzero(asked.any(axis=1)).tolist():
        near = np.flatnonzero(asked[row] & (free_until <= row))
        if not len(near):
            continue
        search.place(point_at(bezier, float(row)), float(row))
        distances[row, near] = checker.distances_of(pairs[near]) - checker.distance_errors[pairs[near]]
        fruit = near[whole[near] >= 0]
        if len(fruit):
            from_whole[row, fruit] = checker.whole_fruit_distances(pairs[fruit], whole[fruit])
        movers = mover_of[near]
        spare = np.maximum(distances[row, near] - nearer[movers, row], 0.0)
        far = spare > travel[movers, min(row + 1, rows)] - travel[movers, row]
        for pair, mover, free in zip(near[far].tolist(), movers[far].tolist(), spare[far].tolist(), strict=True):
            # A pair that skips samples cannot touch before its next query.
            free_until[pair] = np.searchsorted(travel[mover], travel[mover, row] + free, side="right") - 1
    first, which = np.nonzero(may_touch & (distances[:-1] < math.inf) & (distances[1:] < math.inf))
    movers = mover_of[which]
    travelled = travel[movers, first + 1] - travel[movers, first]
    swayed = np.maximum(nearer[movers, first], nearer[movers, first + 1])
    depths, in_whole = (
        swayed - 0.5 * (found[first, which] + found[first + 1, which] - travelled) for found in (distances, from_whole)
    )
    if proved:
        allowed = -np.broadcast_to(checker.required_distance(clearance), len(checker.pairs))
        depths = np.minimum(depths, allowed[pairs[which]])
    kept = np.flatnonzero(depths > 0.0)
    columns = (first, which, depths, np.maximum(0.0, in_whole), travelled + swayed)
    for row, number, depth, deep, moved in zip(*(column[kept].tolist() for column in columns), strict=True):
        yield _push_of(checker, int(pairs[number]), (depth, deep), moved, (float(time[row]), float(time[row + 1])))


def _push_of(
    checker: CoalScene, pair: int, depths: tuple[float, float], moved: float, span_s: tuple[float, float]
) -> Push:
    """The contact of a pair.

    Args:
        checker: The arm among the obstacles.
        pair: Number of the pair.
        depths: Upper bounds of the deflection, and of the depth in a whole fruit [m].
        moved: Upper bound of the link's travel within the time [m].
        span_s: Begin and end [s].
    """
    (mover, other), (depth, whole_depth) = checker.pairs[pair], depths
    names, limit = (checker.mover_names[mover], checker.obstacle_names[other]), checker.contact_limits[other]
    if limit is None or limit.depth <= 0.0:
        return Push(*names, depth, *span_s)
    speed = min(moved / max(span_s[1] - span_s[0], _TINY_S), limit.rate * depth)
    load = Load(limit, checker.joint_of(pair), depth / limit.depth, speed, whole_depth)
    return Push(*names, depth, *span_s, load.force, 1e-6 * (load.stress + load.impact_stress), load)


class _Movers(NamedTuple):
    """Moving bodies along a motion.

    Attributes:
        travel: (bodies, rows + 1) travel up to each sample [m].
        nearer: (bodies, rows + 1) displacement bound by tracking errors at each sample [m].
    """

    travel: FloatArray
    nearer: FloatArray


@kernel
def _possible_contacts(
    bezier: FloatArray, pairs: IntArray, boxes: PairBoxes, joints: TableArray, taken_off: FloatArray,
    mover_of: IntArray, movers: _Movers,
) -> tuple[BoolArray, BoolArray]:  # fmt: skip
    """Segments in which pairs may touch, by the lower bounds of their boxes' distances.

    Args:
        bezier: (rows, 4, dof) Bezier points of the motion.
        pairs: (k,) indices of the pairs.
        boxes: Their boxes.
        joints: Joints from `joints_as_pinocchio`.
        taken_off: (k,) offsets subtracted from distances [m].
        mover_of: (k,) moving body of each pair.
        movers: The moving bodies.

    Returns:
        (rows + 1, k) mask of the pairs whose distance is required at a sample, and (rows, k) mask of the segments in
        which a pair may touch.
    """
    rows, count, dof = bezier.shape[0], len(pairs), bezier.shape[2]
    asked, may_touch = np.zeros((rows + 1, count), dtype=np.bool_), np.zeros((rows, count), dtype=np.bool_)
    frames, work = np.empty((rows + 1, dof + 1, 12)), np.empty((2, 12))
    for row in range(rows + 1):
        place_joints(point_at(bezier, float(row)), joints, frames[row])
    for i in range(count):
        travel, nearer = movers.travel[mover_of[i]], movers.nearer[mover_of[i]]
        row, bound = 0, box_separation(frames[0], boxes, pairs[i], work) - taken_off[i]
        while row < rows:
            following = row + 1
            while following < rows and travel[following + 1] - travel[row] <= bound - nearer[row]:
                following += 1
            after = box_separation(frames[following], boxes, pairs[i], work) - taken_off[i]
            if following == row + 1:
                least = 0.5 * (bound + after - (travel[following] - travel[row]))
                if least <= max(nearer[row], nearer[following]):
                    may_touch[row, i] = asked[row, i] = asked[following, i] = True
            row, bound = following, after
    return asked, may_touch


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
