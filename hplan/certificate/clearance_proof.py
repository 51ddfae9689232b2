r"""Clearance over a whole motion by conservative advancement, pair by pair.

A pair is a link and an obstacle, a rotating shape of the turret and an obstacle, or two parts of the arm. Each pair has
a moving body: with an obstacle the link, or the turret, which only the yaw moves; with two parts of the arm one of them
relative to the other. A pair's spare clearance is its distance, by coal, minus the required distance. A distance query
of a pair counts on both sides: as far as its moving body travels no more than its spare clearance there minus the
clearance certified before (at most half of the spare clearance of any pair), before and after, at least the certified
clearance remains. (So the certified clearance is at least halfway from the required distance to the nearest evaluated
one. Self-collision pairs whose required distance is less than the required clearance each have a bound of their own,
`Proof.own_bounds`.) So the next query of a pair lies farther ahead than the last one certifies, and if the two leave a
gap, another query follows in its middle. Before coal is called, boxes around the two bound their distance
(`hplan.collision.coal_boxes`); if the bound leaves enough, it replaces the query. Places are counted in samples. If a
pair is too near, the proof continues as far as possible without querying ahead; if it has to give up, the rest of the
motion is searched for the minimum distance.

A pair that is too near by the hull or a piece of a closed mesh counts by its triangles (`hplan.collision.coal_meshes`):
the part of the solid in the piece is at least as far away as either. Its travel is at most that of the piece.

`hplan.certificate.motion_bound` bounds the travel of a moving body within a segment of the motion, and its displacement
by tracking errors. Two parts that can never be as far apart as required must not touch
(`hplan.collision.self_pairs`).

**Tracking.** Joint deviations bring a pair nearer by its displacement bound, at most :math:`m_r` in segment :math:`r`
of the motion. It is replaced by the piecewise linear :math:`\tilde m` with the values :math:`M_r = \max(m_{r - 1},
m_r)` at the samples, so that :math:`\tilde m(x) \ge m_r` at every place :math:`x` of segment :math:`r`. Let :math:`T`
be the travel of the moving body up to a place and :math:`V` the total variation of :math:`\tilde m` up to there, both
piecewise linear. A pair with the distance :math:`d(a)` from a query at :math:`a` has at every other place

.. math::
    d(x) - \tilde m(x) \ge d(a) - |T(x) - T(a)| - \tilde m(a) - |V(x) - V(a)|,

so the advancement counts :math:`T + V` as travel and :math:`d(a) - \tilde m(a)`, minus the required distance, as spare
clearance.

**Moving obstacles.** Distances are measured from the obstacle's pose at that time. For a pair of a link and a moving
obstacle, the travel of the obstacle is added to the travel of the link: in each segment the maximum speed of its points
there (`hplan.scene.tracks`) times the duration of the segment.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.deadline import check_deadline
from hplan.base.kernels import kernel
from hplan.certificate.motion_bound import at_rows, motion_of_movers, with_obstacles
from hplan.collision.coal_boxes import PairBoxes, box_separation, hull_separation, joints_as_pinocchio
from hplan.collision.coal_scene import CoalScene, Contact
from hplan.collision.compiled_placements import place_joints
from hplan.geometry.convex_distance import WORK
from hplan.trajectory.cubics import cubic_at

#: Spare clearance below which the proof gives up [m]: its steps, half of it, would become too small.
SMALLEST_STEP = 1e-5

#: Maximum fraction of a pair's spare clearance that its moving body may travel before the next query: far away, coal's
#: distances have a relative error.
MOST_TRAVEL = 0.99

#: Distance of a pair's next query beyond its certified part, as a fraction of the length that the last query certified
#: on one side. A query includes other pairs that are due before the first pair has travelled this multiple of that
#: distance.
_AHEAD, _TOGETHER = 0.8, 8.0

#: Number of nearest pairs in the first query. A lower bound suffices if it leaves this much spare clearance [m].
FIRST, FAR = 16, 4e-3

#: Number of queries answered by lower bounds between checks of the deadline.
_BOUNDED_LOOKS = 256

#: Maximum number of configurations with distance queries: a constant, and a number for each segment of the motion. A
#: motion of 1.8 s that comes to 1.5 mm of an obstacle takes 155. The deadline is checked after the third number: a
#: fraction of a millisecond.
CHECKS, CHECKS_PER_PIECE, _CHECKS_BETWEEN_LOOKS = 20_000, 50, 16

#: Number of coal queries after which the rest of the motion is searched for a contact, and approximate minimum of
#: configurations in a search of a whole motion.
SEARCHED_AFTER, SAMPLES = 1_000, 199

#: Outcome of a proof: the clearance is certified, a pair is too near, or the budget of queries or of travel is used up.
Outcome: TypeAlias = Literal["shown", "too near", "checks", "travel"]

#: Pairs for a coal query, its place (infinite after the end), and the (dof,) configuration there.
Look: TypeAlias = tuple[IntArray, float, FloatArray]


@dataclass(frozen=True)
class Proof:
    """Clearance over the whole motion.

    Attributes:
        outcome: Success, or the reason of failure: a pair comes too near, the proof would require more than the maximum
            number of queries, or the motion is too fast or too long for its travel to be bounded.
        clearance_m: If proved, the lower bound of every distance along the motion, tracking errors included; otherwise
            the minimum distance found, minus the displacement by tracking errors [m]. Compliant obstacles count as in
            `CoalScene.deflection_offsets`.
        nearest: The nearest pair found, and its distance; None without pairs.
        checks: Number of configurations with distance queries.
        end: End of the certified part, or start of the part with unbounded travel, counted in segments.
        nearest_at: Place of the nearest pair found, counted in segments.
        own_bounds: Self-collision pairs whose required distance is less than the required clearance, by their index
            among the checker's pairs, each with a lower bound of its distance along the motion [m].
    """

    outcome: Outcome
    clearance_m: float
    nearest: Contact | None
    checks: int
    end: float
    nearest_at: float = 0.0
    own_bounds: tuple[tuple[int, float], ...] = ()

    @property
    def is_certified(self) -> bool:
        """True if the clearance is certified over the whole motion."""
        return self.outcome == "shown"


def prove_clearance(
    bezier: FloatArray,
    checker: CoalScene,
    deviations: FloatArray,
    needed: float,
    clock: FloatArray | None = None,
    *,
    measured: bool = True,
) -> Proof:
    """Certify every pair's distance at all times, or find a violation.

    Args:
        bezier: (pieces, 4 or 6, dof) Bezier points of the motion's segments.
        checker: The arm among the obstacles.
        deviations: (pieces, dof) maximum joint deviations within each segment, or (1, dof) for all [rad].
        needed: Required distance [m].
        clock: (pieces + 1,) times of the samples on the clock of the tracks [s]; required if obstacles move.
        measured: Whether the rest of the motion is searched for the minimum distance if the proof fails.
    """
    # Pairs that touch only beyond the joint limits, where a deviation may lead, are included.
    checker = checker.with_margins(float(deviations.max()), needed)
    if not checker.pairs:
        return Proof("shown", math.inf, None, 0, len(bezier))
    search = Advancement(bezier, checker, deviations, needed, clock)
    if search.bounded < len(bezier):
        return search.worst("travel")
    budget = CHECKS + CHECKS_PER_PIECE * len(bezier)
    look, is_searched = search.first_query(), False
    while look[1] < math.inf:
        if search.checks % _CHECKS_BETWEEN_LOOKS == 0 or not len(look[0]):
            check_deadline()
        if search.checks >= SEARCHED_AFTER and not is_searched:
            found, is_searched = search.worst("too near"), True
            if search.is_violated:
                return found
        if search.looks >= budget:
            return search.worst("checks")
        following = search.next_query(look)
        if following is None:
            return search.worst("too near", measured=measured)
        look = following
    end = float(len(bezier))
    bounds = tuple(search.own_bounds())
    least = min(needed + float(search.shown[0]), *(bound for _, bound in bounds), math.inf)
    return Proof("shown", least, search.contact(), search.checks, end, search.nearest[2], bounds)


class _Search(NamedTuple):
    """Arrays of an `Advancement` and its motion for kernels.

    Includes buffers for the next query's pairs and configuration, and the lower bounds of the pairs' distances at the
    start. (Each array that a kernel returns costs 2 us.)
    """

    bezier: FloatArray
    mover_of: IntArray
    movers: FloatArray
    pairs: FloatArray
    boxes: PairBoxes
    joints: FloatArray
    asked: IntArray
    q: FloatArray
    shown: FloatArray
    at_start: FloatArray


class Advancement:
    """State of the advancement along a motion, pair by pair.

    Attributes:
        movers: (2, bodies, rows + 1) at each sample, the displacement bound of each moving body by tracking errors, and
            its travel up to there [m].
        pairs: (8, pairs) for each pair: the required distance plus coal's error [m]; the place of its next query,
            infinite after the end; in travel of its moving body, the end of its certified part, negative before the
            first query, the start of the certified part beyond a gap, infinite without a gap, and the end of that part
            [m]; the difference between the required clearance and its own required distance, and the error subtracted
            from its bounds [m]; and the index of its bound in `shown`.
        mover_of: (pairs,) index of each pair's moving body.
        shown: Clearance certified until now beyond the required distance: first for all pairs with the required
            clearance or a compliant obstacle, then for each other pair on its own [m].
        checks: Number of coal queries.
        looks: Number of all queries, lower bounds included.
        nearest: The minimum distance found [m], its pair and its place.
        bounded: Number of segments, from the first one on, with bounded travel.
        is_violated: True if a sample of `worst` is nearer than required.
    """

    def __init__(
        self,
        bezier: FloatArray,
        checker: CoalScene,
        deviations: FloatArray,
        needed: float,
        clock: FloatArray | None = None,
    ) -> None:
        self._bezier, self._checker = bezier, checker
        self._clock = None if checker.moving is None else clock
        # Maximum travel that is bounded [m]: beyond it, its sum over the segments would have an error of more than a
        # micrometre.
        longest_travel = 1e5
        with np.errstate(over="ignore", invalid="ignore"):
            mover_of, moved, nearer = motion_of_movers(checker, bezier, deviations)
            if checker.moving is not None and clock is not None:
                mover_of, moved, nearer = with_obstacles(checker, mover_of, moved, nearer, clock)
            # Written in place: with many moving bodies, copies take longer than the computation.
            self.movers = np.zeros((2, len(moved), len(bezier) + 1))
            sway, travel = self.movers[0], self.movers[1, :, 1:]
            sway[:] = at_rows(nearer)
            if len(deviations) > 1:
                moved = moved + np.abs(np.diff(sway, axis=1))
            np.cumsum(moved, axis=1, out=travel)
        self.bounded = len(bezier)
        if not (travel[:, -1] <= longest_travel).all():
            self.bounded = int((travel <= longest_travel).all(axis=0).sum())
            # Only for the search of the samples: after such a segment every pair may be anywhere.
            np.cumsum(np.where(moved <= longest_travel, moved, longest_travel), axis=1, out=travel)
        none, asked = np.zeros(len(checker.pairs)), checker.required_distance(needed)
        kept = asked + checker.distance_errors
        may_lack = none + (needed - asked)
        # Pairs that may touch are certified from the beginning.
        is_free = checker.taken_off == -math.inf
        due = np.where(is_free, math.inf, 0.0)
        upto = np.where(is_free, travel[mover_of, -1], -np.finfo(np.float64).tiny)
        self._counted = checker.deflection_offsets(needed)
        by_itself = may_lack > self._counted
        bound = np.where(by_itself, np.cumsum(by_itself), 0.0)
        self.shown: FloatArray = np.full(1 + int(by_itself.sum()), math.inf)
        self.pairs = np.stack([kept, due, upto, none + math.inf, none, may_lack, checker.taken_off, bound])
        self._required, self._at_start = none + asked, np.full(len(none), -math.inf)
        self.mover_of = mover_of
        self._ahead, self.checks, self.looks = _AHEAD, 0, 0
        self.nearest = math.inf, 0, 0.0
        self.is_violated = False

    def place(self, q: FloatArray, at: float) -> None:
        """Place the arm at the configuration of a place."""
        self._checker.place(q, *self.time_of(at))
        self.checks += 1
        self.looks += 1

    def time_of(self, at: float) -> tuple[float, ...]:
        """Time of a place; empty if only the arm moves."""
        return () if self._clock is None else (_linear(self._clock, at),)

    @cached_property
    def _search(self) -> _Search:
        joints, bezier = joints_as_pinocchio(self._checker.robot), np.ascontiguousarray(self._bezier)
        room = np.zeros(len(self.mover_of), dtype=np.int64), np.zeros(bezier.shape[2])
        return _Search(
            bezier, self.mover_of, self.movers, self.pairs, self._checker.boxes, joints, *room, self.shown,
            self._at_start,
        )  # fmt: skip

    def first_query(self) -> Look:
        """The first query: the nearest pairs at the start, or all.

        The other pairs are due there too.
        """
        pairs, q = self._checker.meeting_pairs, self._bezier[0, 0]
        self._at_start[pairs] = nearness = self._checker.lower_bounds(q, pairs)
        if len(pairs) > FIRST:
            pairs = pairs[np.sort(np.argpartition(nearness - self.pairs[0, pairs], FIRST)[:FIRST])]
        return pairs, 0.0, q

    def next_query(self, look: Look) -> Look | None:
        """Run a query and find the next.

        None if a pair is too near for the proof to continue.
        """
        (pairs, at, q), distances = look, np.zeros(0)
        if len(pairs):
            self.place(q, at)
            distances = self._checker.distances_of(pairs)
        distance, pair, is_far, looks, count, there = _record_query(pairs, distances, at, self._ahead, self._search)
        if not is_far:
            distances = self._by_meshes(pairs, distances, at)
            distance, pair, is_far, looks, count, there = _record_query(pairs, distances, at, self._ahead, self._search)
        self.looks += looks
        if distance < self.nearest[0]:
            self.nearest = distance, pair, at
        if is_far:
            return self._search.asked[:count], there, self._search.q
        if self._ahead == 0.0:
            return None
        self._only_forward()
        return pairs[:0], at, q

    def distances_of(self, pairs: IntArray, at: float) -> FloatArray:
        """Distances of (k,) pairs at a place, where the arm was placed last, (k,) [m]."""
        return self._by_meshes(pairs, self._checker.distances_of(pairs), at)

    def _by_meshes(self, pairs: IntArray, distances: FloatArray, at: float) -> FloatArray:
        """Distances in which pairs that are too near by hulls or pieces of closed meshes count by the meshes."""
        kept = self.pairs[0, pairs]
        spare_clearances = distances - kept - at_place(self.movers[0][self.mover_of[pairs]], at)
        # The depth of a contact is known by hulls alone, so compliant obstacles count by these.
        close = np.flatnonzero((kept >= 0.0) & ~(spare_clearances > SMALLEST_STEP))
        if not len(close):
            return distances
        found = distances.copy()
        found[close] = np.maximum(found[close], self._checker.mesh_distances(pairs[close]))
        return found

    def _only_forward(self) -> None:
        """Continue from the certified part without querying ahead.

        This finds how far the clearance can be certified.
        """
        self._ahead = 0.0
        self.pairs[1] = [place if place < len(self._bezier) else math.inf for place in self._places()]
        self.pairs[3] = math.inf

    def _places(self) -> Iterator[float]:
        """End of each pair's certified part; infinite for the motion's end."""
        for mover, upto in zip(self.mover_of.tolist(), self.pairs[2].tolist(), strict=True):
            yield 0.0 if upto < 0.0 else place_after(self.movers[1, mover], 0.0, upto)

    def _see(self, distance: float, pair: int, at: float) -> float:
        """Record a distance if it is the minimum, and return it.

        The distance is shifted as if the pair's required distance were the required clearance.
        """
        distance += float(self.pairs[5, pair])
        self.nearest = min(self.nearest, (distance, pair, at))
        return distance

    def own_bounds(self) -> Iterator[tuple[int, float]]:
        """Pairs with their own bound, each with its lower bound [m]."""
        for pair in np.flatnonzero(self.pairs[7]).tolist():
            yield pair, float(self._required[pair] + self.shown[int(self.pairs[7, pair])])

    def contact(self) -> Contact:
        """The nearest pair by name, and its distance.

        A pair with a smaller required distance counts as farther away.
        """
        distance, pair, _ = self.nearest
        return self._checker.contact(*self._checker.pairs[pair], distance - float(self.pairs[5, pair]))

    def worst(self, outcome: Outcome, *, measured: bool = True) -> Proof:
        """Report of a failed proof: the minimum distance at samples of the rest of the motion, if it is measured.

        A pair is skipped until its moving body has travelled as much as the pair was farther away than the nearest one.
        """
        mover_of, (sway, travel) = self.mover_of, self.movers
        rows, least = len(self._bezier), min((bound for _, bound in self.own_bounds()), default=math.inf)
        # Bezier points between the samples may be NaN if the travel is not bounded.
        share = 1 if outcome == "travel" else max(1, SAMPLES // rows)
        shown = min(*self._places(), float(rows))
        end = shown if outcome != "travel" else float(self.bounded)
        first = min(int(shown * share), rows * share - 1)
        due = [(first, pair) for pair in self._checker.meeting_pairs.tolist()] if measured else []
        while due:
            check_deadline()
            sample = due[0][0]
            at = sample / share
            self.place(self._bezier[-1, -1] if at >= rows else _at_sample(self._bezier, sample, share), at)
            pairs = []
            while due and due[0][0] == sample:
                pairs.append(heapq.heappop(due)[1])
            for pair, distance in zip(pairs, self.distances_of(np.array(pairs), at).tolist(), strict=True):
                displacement = float(_linear(sway[mover_of[pair]], at))
                self.is_violated |= distance - displacement <= self.pairs[0, pair]
                nearer = distance + float(self._counted[pair]) - displacement
                distance = self._see(distance, pair, at)
                least = min(least, nearer)
                farther = min(distance - self.nearest[0], nearer - least)
                ahead = place_after(travel[mover_of[pair]], at, farther)
                following = max(math.ceil(min(ahead, rows + 1.0) * share), sample + 1)
                if following <= rows * share:
                    heapq.heappush(due, (following, pair))
        near = self.contact()
        least = min(least, near.distance_m + float(self._counted[self.nearest[1]]))
        return Proof(outcome, least, near, self.checks, end, self.nearest[2])


def _at_sample(bezier: FloatArray, sample: int, share: int) -> FloatArray:
    """Configuration at a sample, with a number of samples in each segment."""
    piece, part = divmod(sample, share)
    found: FloatArray = point_at(bezier, sample / share) if part else bezier[piece, 0]
    return found


@kernel
def point_at(bezier: FloatArray, at: float) -> FloatArray:
    """Configuration at a place counted in samples."""
    piece = min(int(at), bezier.shape[0] - 1)
    t = at - piece
    u = 1.0 - t
    q = np.empty(bezier.shape[2])
    for j in range(len(q)):
        p0, p1, p2, p3 = cubic_at(bezier, piece, j, t)
        q[j] = u * u * u * p0 + 3.0 * u * u * t * p1 + 3.0 * u * t * t * p2 + t * t * t * p3
    return q


@kernel
def _record_query(
    pairs: IntArray, distances: FloatArray, at: float, ahead: float, search: _Search
) -> tuple[float, int, bool, int, int, float]:
    """Record a query's results and find the next one for coal.

    Returns:
        Distance and index of the nearest pair, and whether no pair is too near, as in `_put_off`; the number of queries
        answered by lower bounds; the number of pairs of the next query, zero after the end or after very many such
        queries; and its place.
    """
    bezier = search.bezier
    least, is_far = _put_off(pairs, distances, at, ahead, search)
    nearest, which, count, looks = math.inf, 0, 0, 0
    if len(pairs):
        nearest, which = distances[least] + search.pairs[5, pairs[least]], pairs[least]
    frames, work = np.empty((bezier.shape[2] + 1, 12)), np.empty((2, WORK))
    while is_far and count == 0 and looks < _BOUNDED_LOOKS:
        count, at = _next_query(search)
        if at == math.inf:
            break
        q = point_at(bezier, at)
        for j in range(len(q)):
            search.q[j] = q[j]
        place_joints(q, search.joints, frames)
        count = _put_off_far(count, frames, work, (at, ahead), search)
        looks += count == 0
    return nearest, which, is_far, looks, count, at


@kernel
def _next_query(search: _Search) -> tuple[int, float]:
    """Number of pairs in the next query, and its place, or infinity.

    The pairs are the one due first, and others that can be queried together with it.
    """
    due, upto, mover_of, travels = search.pairs[1], search.pairs[2], search.mover_of, search.movers[1]
    first, at, count = 0, due[0], 0
    for pair in range(len(due)):
        if due[pair] < at:
            first, at = pair, due[pair]
    if not at < math.inf:
        return 0, at
    travel = travels[mover_of[first]]
    before = min(place_after(travel, at, _TOGETHER * (_linear(travel, at) - upto[first])), len(travel) - 1.0)
    before = max(before, at)  # Rounding errors may make it smaller.
    for pair in range(len(due)):
        if due[pair] <= before and (pair == first or upto[pair] <= _linear(travels[mover_of[pair]], at)):
            search.asked[count] = pair
            count += 1
    return count, at


@kernel
def _linear(values: FloatArray, at: float) -> float:
    """Value at a place of a function linear between the samples."""
    row = min(int(at), len(values) - 2)
    value: float = values[row] + (at - row) * (values[row + 1] - values[row])
    return value


def at_place(values: FloatArray, at: float) -> FloatArray:
    """(k,) values at a place of (k, samples) functions linear between the samples."""
    row = min(int(at), values.shape[1] - 2)
    found: FloatArray = values[:, row] + (at - row) * (values[:, row + 1] - values[:, row])
    return found


@kernel
def _put_off(pairs: IntArray, distances: FloatArray, at: float, ahead: float, search: _Search) -> tuple[int, bool]:
    """Record queries at a place and the pairs' next due places.

    Returns:
        Index of the nearest pair, as if all pairs had the same required distance, and whether no pair is too near.
    """
    mover_of, sway, all_pairs = search.mover_of, search.movers[0], search.pairs
    kept, may_lack = all_pairs[0], all_pairs[5]
    least, is_far = 0, True
    spare_clearances = np.empty(len(pairs))
    for i in range(len(pairs)):
        if not distances[i] + may_lack[pairs[i]] >= distances[least] + may_lack[pairs[least]]:
            least = i
        spare_clearance = distances[i] - (_linear(sway[mover_of[pairs[i]]], at) + kept[pairs[i]])
        spare_clearances[i] = spare_clearance
        if not spare_clearance > SMALLEST_STEP:
            is_far = False
    if not is_far:
        return least, False
    for i in range(len(pairs)):
        bound = int(all_pairs[7, pairs[i]])
        search.shown[bound] = min(search.shown[bound], 0.5 * spare_clearances[i])
    for i in range(len(pairs)):
        shown = search.shown[int(all_pairs[7, pairs[i]])]
        _take_down(pairs[i], at, spare_clearances[i], shown, ahead, search.movers[1, mover_of[pairs[i]]], all_pairs)
    return least, True


@kernel
def _put_off_far(count: int, frames: FloatArray, work: FloatArray, place: tuple[float, float], search: _Search) -> int:
    """Apply lower bounds of distances in place of queries, as in `_put_off`.

    Applies to pairs whose bounds are large and leave the certified clearance unchanged.

    Args:
        count: Number of pairs of the query.
        frames: Frames of joints and base, as in `box_separation`.
        work: Buffer, as in `hull_separation`.
        place: Place of the query, and the look-ahead fraction.

    Returns:
        Number of pairs that still require a query.
    """
    mover_of, sway, all_pairs = search.mover_of, search.movers[0], search.pairs
    kept, taken_off = all_pairs[0], all_pairs[6]
    at, ahead = place
    left = 0
    for i in range(count):
        pair = search.asked[i]
        bound = search.at_start[pair]
        if at > 0.0:
            bound = box_separation(frames, search.boxes, pair, work) - taken_off[pair]
        used = _linear(sway[mover_of[pair]], at) + kept[pair]
        shown, spare_clearance = search.shown[int(all_pairs[7, pair])], bound - used
        far = max(FAR, 2.0 * shown)
        if spare_clearance < far < math.inf:
            # Twice as much makes longer steps.
            bound = hull_separation(frames, search.boxes, pair, 2.0 * far + used + taken_off[pair], work)
            spare_clearance = max(spare_clearance, bound - taken_off[pair] - used)
        if spare_clearance >= FAR and 0.5 * spare_clearance >= shown:
            _take_down(pair, at, spare_clearance, shown, ahead, search.movers[1, mover_of[pair]], all_pairs)
        else:
            search.asked[left] = pair
            left += 1
    return left


@kernel
def _take_down(
    pair: int, at: float, spare_clearance: float, shown: float, ahead: float, travel: FloatArray, all_pairs: FloatArray
) -> None:
    """Record a query's certified part and the pair's next due place."""
    due, upto, gap_end, then_to = all_pairs[1], all_pairs[2], all_pairs[3], all_pairs[4]
    here, end = _linear(travel, at), travel[-1]
    step = min(spare_clearance - shown, MOST_TRAVEL * spare_clearance)
    if here - step <= upto[pair]:
        upto[pair] = max(upto[pair], here + step)
        if gap_end[pair] <= upto[pair]:
            upto[pair] = max(upto[pair], then_to[pair])
            gap_end[pair] = math.inf
    elif gap_end[pair] <= here + step and here - step <= then_to[pair]:
        gap_end[pair], then_to[pair] = min(gap_end[pair], here - step), max(then_to[pair], here + step)
    elif here - step < gap_end[pair]:
        gap_end[pair], then_to[pair] = here - step, here + step
    if upto[pair] >= end:
        due[pair] = math.inf
        return
    part = 0.5 * (gap_end[pair] - upto[pair])
    if not part < math.inf:
        part = min(ahead * step, 0.5 * (end - upto[pair]))
    due[pair] = min(place_after(travel, 0.0, upto[pair] + part), len(travel) - 1.0)


@kernel
def place_after(travel: FloatArray, at: float, part: float) -> float:
    """Last place that a body reaches with travel at most `part`.

    Infinite if that is beyond the end.

    Args:
        travel: (rows + 1,) travel up to each sample; linear between samples.
        at: Start place.
    """
    row = min(int(at), len(travel) - 2)
    limit = travel[row] + (at - row) * (travel[row + 1] - travel[row]) + part
    row, beyond = -1, len(travel)
    while row + 1 < beyond:  # The last sample with a travel of at most the limit.
        middle = (row + beyond) // 2
        if travel[middle] <= limit:
            row = middle
        else:
            beyond = middle
    if row == len(travel) - 1:
        return math.inf
    place: float = row + (limit - travel[row]) / (travel[row + 1] - travel[row])
    return place
