"""Contacts with compliant obstacles: the link, the maximum deflection and the time.

At each sample of the motion coal returns the depth of a pair. Between two samples the travel of the moving body is
bounded (`hplan.certificate.motion_bound`), and a depth changes by no more than the travel. So the depth is at most half
of the sum of both depths and the travel.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, TableArray, frozen
from hplan.base.kernels import kernel
from hplan.certificate.clearance_proof import Advancement, point_at
from hplan.certificate.segment_contacts import CONTACT, SegmentContacts
from hplan.collision.coal_boxes import PairBoxes, box_separation, joints_as_pinocchio
from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_placements import place_joints

#: Shortest time in which a speed is measured [s].
_TINY_S: Final = 1e-9


def pushes_along(
    bezier: FloatArray,
    time: FloatArray,
    checker: CoalScene,
    deviations: FloatArray,
    clearance: float,
    clock: FloatArray | None,
    *,
    proved: bool,
) -> SegmentContacts:
    """Bound the deflection of compliant obstacles within each segment of a motion.

    Args:
        bezier: (pieces, 4, dof) Bezier points of the motion's cubics.
        time: (pieces + 1,) times of the samples [s].
        checker: The arm among the obstacles.
        deviations: (pieces, dof) maximum joint deviations within each cubic, or (1, dof) for all of them [rad].
        clearance: Clearance required from non-compliant obstacles [m].
        clock: (pieces + 1,) times of the samples on the clock of the tracks [s]; required if obstacles move.
        proved: True if the allowed deflection of every pair is certified; it then caps the bound.

    Returns:
        A contact for each segment and pair that may touch in it, in order of time.
    """
    pairs = checker.compliant_pairs
    if not len(pairs):
        return SegmentContacts.none()
    search, rows = Advancement(bezier, checker, deviations, clearance, clock), len(bezier)
    (sway, travel), mover_of = search.movers, search.mover_of[pairs]
    movers = _Movers(travel, np.ascontiguousarray(np.broadcast_to(sway, travel.shape)))
    asked, may_touch = _possible_contacts(
        bezier, pairs, checker.boxes, joints_as_pinocchio(checker.robot), checker.taken_off[pairs], mover_of, movers
    )
    whole = checker.whole_fruit_pairs(pairs)
    errors = np.stack([checker.distance_errors[pairs], np.where(whole >= 0, checker.distance_errors[whole], 0.0)])
    queries = _Queries(
        asked, mover_of, movers, pairs, whole, checker.taken_off[pairs] + errors, np.zeros(len(pairs), dtype=np.int64),
        np.full((2, rows + 1, len(pairs)), math.inf), np.zeros(len(pairs), dtype=np.int64),
        np.zeros(2 * len(pairs), dtype=np.int64),
    )  # fmt: skip
    row, near, count = _next_query(-1, 0, np.zeros(0), queries)
    while count:
        search.place(point_at(bezier, float(row)), float(row))
        row, near, count = _next_query(row, near, checker.shape_distances(queries.pair[:count]), queries)
    distances, from_whole = queries.distances
    first, which = np.nonzero(may_touch & (distances[:-1] < math.inf) & (distances[1:] < math.inf))
    of_each = mover_of[which]
    travelled = travel[of_each, first + 1] - travel[of_each, first]
    swayed = np.maximum(movers.nearer[of_each, first], movers.nearer[of_each, first + 1])
    depths, in_whole = (
        swayed - 0.5 * (found[first, which] + found[first + 1, which] - travelled) for found in (distances, from_whole)
    )
    if proved:
        allowed = -np.broadcast_to(checker.required_distance(clearance), len(checker.pairs))
        depths = np.minimum(depths, allowed[pairs[which]])
    kept = np.flatnonzero(depths > 0.0)
    first, moved = first[kept], (travelled + swayed)[kept]
    return _table_of(
        checker, pairs[which[kept]], (depths[kept], np.maximum(0.0, in_whole[kept])), moved,
        (time[first], time[first + 1]),
    )  # fmt: skip


def _table_of(
    checker: CoalScene, pairs: IntArray, depths: tuple[FloatArray, FloatArray], moved: FloatArray,
    span_s: tuple[FloatArray, FloatArray],
) -> SegmentContacts:  # fmt: skip
    """The contacts of pairs.

    Args:
        checker: The arm among the obstacles.
        pairs: (k,) numbers of the pairs.
        depths: (k,) upper bounds of the deflection, and of the depth in a whole fruit [m].
        moved: (k,) upper bound of the link's travel within the time [m].
        span_s: (k,) begin and end [s].
    """
    rows, (begin_s, end_s) = np.zeros(len(pairs), CONTACT), span_s
    rows["depth"], rows["whole_depth"] = depths
    rows["begin_s"], rows["end_s"] = begin_s, end_s
    used, of_each = np.unique(pairs, return_inverse=True)
    known = np.array([
        (*checker.pairs[pair], limit.depth, limit.rate, checker.joint_of(pair))
        if limit is not None and limit.depth > 0.0 else (*checker.pairs[pair], 0.0, 0.0, 0)
        for pair in used.tolist() for limit in [checker.contact_limits[checker.pairs[pair][1]]]
    ], dtype=np.float64).reshape(-1, 5)[of_each]  # fmt: skip
    most, rate = known[:, 2], known[:, 3]
    rows["link"], rows["obstacle"], rows["joint"] = known[:, 0], known[:, 1], known[:, 4]
    rows["limit"] = np.where(most > 0.0, rows["obstacle"], -1)
    rows["share"] = np.divide(depths[0], most, out=np.zeros(len(rows)), where=most > 0.0)
    rows["speed"] = np.minimum(moved / np.maximum(end_s - begin_s, _TINY_S), rate * depths[0])
    return SegmentContacts(frozen(rows), checker.mover_names, checker.obstacle_names, checker.contact_limits)


class _Queries(NamedTuple):
    """Distance queries along a motion.

    Attributes:
        asked: (rows + 1, k) True where a pair's distance is required.
        mover_of: (k,) moving body of each pair.
        movers: The moving bodies.
        pairs: (k,) numbers of the pairs.
        whole: (k,) those with the whole fruit; -1 for others.
        offsets: (2, k) subtracted from the distances of both [m].
        free_until: (k,) sample until which each pair cannot touch.
        distances: (2, rows + 1, k) lower bounds of the distances of both; infinite where there was no query [m].
        near: Buffer for the pairs of a query, by their places.
        pair: Buffer for their numbers; those with the whole fruit follow.
    """

    asked: BoolArray
    mover_of: IntArray
    movers: _Movers
    pairs: IntArray
    whole: IntArray
    offsets: FloatArray
    free_until: IntArray
    distances: FloatArray
    near: IntArray
    pair: IntArray


@kernel
def _next_query(row: int, near: int, found: FloatArray, queries: _Queries) -> tuple[int, int, int]:
    """Record distances of shapes, and find the next sample with a query.

    A pair that skips samples cannot touch before its next query.

    Args:
        row: Sample of the last query; -1 before the first one.
        near: Number of its pairs.
        found: (count,) the distances [m].
        queries: The queries.

    Returns:
        Sample of the next query, number of its pairs, and of the distances; none after the last one.
    """
    asked, free_until, rows = queries.asked, queries.free_until, len(queries.asked) - 1
    numbers, pair, extra = queries.near, queries.pair, near
    for i in range(near):
        k = numbers[i]
        distance = found[i] - queries.offsets[0, k]
        queries.distances[0, row, k] = distance
        if queries.whole[k] >= 0:
            queries.distances[1, row, k] = found[extra] - queries.offsets[1, k]
            extra += 1
        travel = queries.movers.travel[queries.mover_of[k]]
        spare = max(distance - queries.movers.nearer[queries.mover_of[k], row], 0.0)
        if spare > travel[min(row + 1, rows)] - travel[row]:
            free_until[k] = np.searchsorted(travel, travel[row] + spare, side="right") - 1
    for following in range(row + 1, rows + 1):
        near = 0
        for k in range(len(free_until)):
            if asked[following, k] and free_until[k] <= following:
                numbers[near], pair[near] = k, queries.pairs[k]
                near += 1
        if near > 0:
            count = near
            for i in range(near):
                if queries.whole[numbers[i]] >= 0:
                    pair[count] = queries.whole[numbers[i]]
                    count += 1
            return following, near, count
    return rows, 0, 0


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
