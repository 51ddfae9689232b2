r"""Clearance over the whole of a motion: conservative advancement along its segments, each pair with its own looks.

A pair is a link and an obstacle, a turning shape of the turret and an obstacle, or two parts of the arm. Each has a
moving body: with an obstacle the link, or the turret, which the yaw alone moves; with two parts of the arm one of them
as seen from the other. A pair's spare clearance is its distance, by coal, beyond the one to be kept. A look at a pair
counts to both sides: as far as its moving body travels no more than its spare clearance there, less the clearance shown
so far (at most half of the spare clearance of any pair), before and after, at least the clearance shown remains. (So
the certified clearance is at least halfway from the required distance to the nearest evaluated one. Pairs of the arm's
own that keep less than the required clearance each have a bound of their own, `Proof.own_bounds`.) So the
next look at a pair is further ahead than the last one shows, and where the two leave a gap, there is one in its middle.
Before coal is asked, boxes about the two bound their distance (`hplan.collision.box_bounds`); where the bound leaves
enough, it is taken in its place. Places are counted in rows. Where a pair is too near, the proof goes on as far as it
gets without looking ahead; where it has to give up, the rest of the motion is searched for the worst.

How far a moving body travels within a piece of the motion, and how far tracking errors displace it, is bounded in
`hplan.certificate.motion_bound`. Two parts that can never be as far apart as is asked for must not touch
(`hplan.collision.touching_pairs`).

**Tracking.** Joints that are off by their deviations bring a pair nearer by its displacement bound, at most :math:`m_r`
in piece :math:`r` of the motion. It is replaced by the piecewise linear :math:`\tilde m` with the values
:math:`M_r = \max(m_{r - 1}, m_r)` at the rows, so that :math:`\tilde m(x) \ge m_r` at every place :math:`x` of piece
:math:`r`. With :math:`T` what the moving body travels up to a place and :math:`V` by how much :math:`\tilde m` has
risen and fallen in all up to there, both piecewise linear, a pair of distance :math:`d(a)` when coal is asked at
:math:`a` has at every other place

.. math::
    d(x) - \tilde m(x) \ge d(a) - |T(x) - T(a)| - \tilde m(a) - |V(x) - V(a)|,

so the advancement counts :math:`T + V` as travel and :math:`d(a) - \tilde m(a)`, less the distance to be kept, as
spare clearance.

**Obstacles that move.** Distances are those from where the obstacle is at that time. Where a link and such an obstacle
are a pair, what the obstacle travels comes to what the link does: in each piece the largest speed that any point of it
has there (`hplan.scene.tracks`), all the time that the piece takes.
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
from hplan.collision.box_bounds import apart, joints_as_pinocchio
from hplan.collision.coal_scene import CoalScene, Contact
from hplan.collision.placed_bodies import place_joints
from hplan.trajectory.cubics import cubic_at

#: Spare clearance below which the proof gives up [m]: its steps, half of it, would become too small.
SMALLEST_STEP = 1e-5

#: Largest fraction of a pair's spare clearance that its moving body may travel before the next look: far away, coal's
#: distances are good to a fraction of them.
MOST_TRAVEL = 0.99

#: How far ahead of what is shown a pair is asked next, in parts of what its last look shows to one side. Together with
#: the pair that is due, others are asked that are due before it has gone so many times as far.
_AHEAD, _TOGETHER = 0.8, 8.0

#: So many of the nearest pairs are asked first. A lower bound is enough where it leaves so much spare clearance [m].
FIRST, FAR = 16, 0.02

#: So many looks in which bounds are enough for all pairs, before the deadline is checked again.
_BOUNDED_LOOKS = 256

#: Configurations at which the proof may evaluate distances: some, and for each piece of the motion. A motion of 1.8 s
#: that comes to 1.5 mm of an obstacle takes 155. The deadline is checked after so many: a fraction of a millisecond.
CHECKS, CHECKS_PER_PIECE, _CHECKS_BETWEEN_LOOKS = 20_000, 50, 16

#: Why a proof ends: the clearance is shown, a pair is too near, or what it may take is used up.
Outcome: TypeAlias = Literal["shown", "too near", "checks", "travel"]

#: Pairs that coal is to be asked about, the place, infinite after the end, and the (dof,) configuration there.
Look: TypeAlias = tuple[IntArray, float, FloatArray]


@dataclass(frozen=True)
class Proof:
    """Clearance over the whole motion.

    Attributes:
        outcome: Whether it is shown, or why not: a pair comes too near, more than the stated number of checks would be
            needed, or the motion is too fast or too long for its travel to be bounded.
        clearance_m: Proved: lower bound of every distance along the motion, tracking errors included; else the smallest
            distance found, less the displacement by tracking errors [m]. A compliant obstacle counts as
            `CoalScene.counted` has it.
        nearest: The nearest pair that was seen, and its distance; None without pairs.
        checks: Configurations at which distances were evaluated.
        end: Place up to which it was shown, or from which on travel is not bounded, counted in pieces.
        nearest_at: Where the nearest pair was seen, counted in pieces.
        own_bounds: Pairs of the arm's own that keep less than the required clearance, by their number among the
            checker's pairs, each with a lower bound of its distance along the motion [m].
    """

    outcome: Outcome
    clearance_m: float
    nearest: Contact | None
    checks: int
    end: float
    nearest_at: float = 0.0
    own_bounds: tuple[tuple[int, float], ...] = ()

    @property
    def shown(self) -> bool:
        """True if the clearance is shown over the whole motion."""
        return self.outcome == "shown"


def prove_clearance(
    bezier: FloatArray,
    checker: CoalScene,
    deviations: FloatArray,
    needed: float,
    clock: FloatArray | None = None,
) -> Proof:
    """Show that every pair keeps its distance at all times, or find where it does not.

    Args:
        bezier: (pieces, 4 or 6, dof) Bezier points of the motion's segments.
        deviations: (pieces, dof) largest deviation of each joint within each segment, or (1, dof) for all [rad].
        needed: Distance to be kept [m].
        clock: (pieces + 1,) times of the rows, as tracks count them [s]; needed where obstacles move.
    """
    # Pairs that touch only beyond the limits, where a deviation leads, are asked too.
    checker = checker.covering(float(deviations.max()), needed)
    if not checker.pairs:
        return Proof("shown", math.inf, None, 0, len(bezier))
    search = Advancement(bezier, checker, deviations, needed, clock)
    if search.bounded < len(bezier):
        return search.worst("travel")
    budget = CHECKS + CHECKS_PER_PIECE * len(bezier)
    look = search.first()
    while look[1] < math.inf:
        if search.checks % _CHECKS_BETWEEN_LOOKS == 0 or not len(look[0]):
            check_deadline()
        if search.looks >= budget:
            return search.worst("checks")
        following = search.after(look)
        if following is None:
            return search.worst("too near")
        look = following
    end = float(len(bezier))
    bounds = tuple(search.own_bounds())
    least = min(needed + float(search.shown[0]), *(bound for _, bound in bounds), math.inf)
    return Proof("shown", least, search.contact(), search.checks, end, search.nearest[2], bounds)


class _Search(NamedTuple):
    """What kernels are given of an `Advancement`, and its motion; and room for the next look's pairs and configuration.

    (Each array that a kernel returns costs 2 us.)
    """

    bezier: FloatArray
    mover_of: IntArray
    movers: FloatArray
    pairs: FloatArray
    boxes: FloatArray
    sides: IntArray
    joints: FloatArray
    asked: IntArray
    q: FloatArray
    shown: FloatArray


class Advancement:
    """State of the advancement along a motion, pair by pair.

    Attributes:
        movers: (2, bodies, rows + 1) at each row, how much nearer each moving body may be than in the motion, and how
            far it has travelled [m].
        pairs: (8, pairs) for each pair the distance to be kept, coal's error with it [m]; the place where it is to be
            asked next, infinite where that is after the end; in travel of its moving body, up to where its
            clearance is shown, below 0 before the first look, from where on beyond a gap, infinite for none, and up to
            where then [m]; by how much less than what is needed it has to keep, and what is taken off its bounds [m];
            and the index of its bound in `shown`.
        mover_of: (pairs,) each pair's moving body.
        shown: Clearance proved so far beyond the one to be kept: of all pairs with the required clearance or a
            compliant obstacle, then of each other pair by itself [m].
        checks: Looks in which coal was asked.
        looks: All looks.
        nearest: The smallest distance so far [m], the pair, and where.
        bounded: How many pieces from the first on have a bounded travel.
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
        # Longest travel that is bounded [m]: beyond, its sum over the pieces would be good to less than a micrometre.
        longest_travel = 1e5
        with np.errstate(over="ignore", invalid="ignore"):
            mover_of, moved, nearer = motion_of_movers(checker, bezier, deviations)
            if checker.moving is not None and clock is not None:
                mover_of, moved, nearer = with_obstacles(checker, mover_of, moved, nearer, clock)
            # Written in place: where there are many movers, copies take longer than what is computed.
            self.movers = np.zeros((2, len(moved), len(bezier) + 1))
            sway, travel = self.movers[0], self.movers[1, :, 1:]
            sway[:] = at_rows(nearer)
            if len(deviations) > 1:
                moved = moved + np.abs(np.diff(sway, axis=1))
            np.cumsum(moved, axis=1, out=travel)
        self.bounded = len(bezier)
        if not (travel[:, -1] <= longest_travel).all():
            self.bounded = int((travel <= longest_travel).all(axis=0).sum())
            # For the search of the rows alone: after such a piece every pair may be anywhere.
            np.cumsum(np.where(moved <= longest_travel, moved, longest_travel), axis=1, out=travel)
        none, asked = np.zeros(len(checker.pairs)), checker.kept(needed)
        kept = asked + checker.distance_errors
        may_lack = none + (needed - asked)
        before = none - np.finfo(np.float64).tiny
        self._counted = checker.counted(needed)
        by_itself = may_lack > self._counted
        bound = np.where(by_itself, np.cumsum(by_itself), 0.0)
        self.shown: FloatArray = np.full(1 + int(by_itself.sum()), math.inf)
        self.pairs = np.stack([kept, none, before, none + math.inf, none, may_lack, checker.taken_off, bound])
        self._required = none + asked
        self.mover_of = mover_of
        self._ahead, self.checks, self.looks = _AHEAD, 0, 0
        self.nearest = math.inf, 0, 0.0

    def place(self, q: FloatArray, at: float) -> None:
        """Put the arm at a configuration, that of a place."""
        self._checker.place(q, *self.when(at))
        self.checks += 1
        self.looks += 1

    def when(self, at: float) -> tuple[float, ...]:
        """The time of a place, as the checker takes it: none where nothing moves but the arm."""
        return () if self._clock is None else (_linear(self._clock, at),)

    @cached_property
    def _search(self) -> _Search:
        boxes, sides = self._checker.boxes
        joints, bezier = joints_as_pinocchio(self._checker.robot), np.ascontiguousarray(self._bezier)
        room = np.zeros(len(self.mover_of), dtype=np.int64), np.zeros(bezier.shape[2])
        return _Search(bezier, self.mover_of, self.movers, self.pairs, boxes, sides, joints, *room, self.shown)

    def first(self) -> Look:
        """The look at the nearest pairs at the begin, or at all; others are due there too."""
        pairs, q = np.arange(len(self._checker.pairs)), self._bezier[0, 0]
        if len(pairs) > FIRST:
            nearness = self._checker.lower_bounds(q, pairs) - self.pairs[0]
            pairs = np.sort(np.argpartition(nearness, FIRST)[:FIRST])
        return pairs, 0.0, q

    def after(self, look: Look) -> Look | None:
        """Look there, and find where to look next; None where a pair is too near for the proof to go on."""
        (pairs, at, q), distances = look, np.zeros(0)
        if len(pairs):
            self.place(q, at)
            distances = self._checker.distances_of(pairs)
        distance, pair, is_far, looks, count, there = _look(pairs, distances, at, self._ahead, self._search)
        self.looks += looks
        if distance < self.nearest[0]:
            self.nearest = distance, pair, at
        if is_far:
            return self._search.asked[:count], there, self._search.q
        if self._ahead == 0.0:
            return None
        self._only_forward()
        return pairs[:0], at, q

    def _only_forward(self) -> None:
        """Go on from where clearance is shown, and look no further ahead: that says how far it can be shown."""
        self._ahead = 0.0
        self.pairs[1] = [place if place < len(self._bezier) else math.inf for place in self._places()]
        self.pairs[3] = math.inf

    def _places(self) -> Iterator[float]:
        """Of each pair the place up to which its clearance is shown; infinite where that is the end."""
        for mover, upto in zip(self.mover_of.tolist(), self.pairs[2].tolist(), strict=True):
            yield 0.0 if upto < 0.0 else place_after(self.movers[1, mover], 0.0, upto)

    def _see(self, distance: float, pair: int, at: float) -> float:
        """Take down a distance if it is the smallest; returns it as if the pair had to keep what is needed."""
        distance += float(self.pairs[5, pair])
        self.nearest = min(self.nearest, (distance, pair, at))
        return distance

    def own_bounds(self) -> Iterator[tuple[int, float]]:
        """The pairs with a bound of their own, and the lower bound of the distance of each so far [m]."""
        for pair in np.flatnonzero(self.pairs[7]).tolist():
            yield pair, float(self._required[pair] + self.shown[int(self.pairs[7, pair])])

    def contact(self) -> Contact:
        """The nearest pair by name, and its distance; one that may be nearer than others counts as farther away."""
        distance, pair, _ = self.nearest
        return self._checker.contact(*self._checker.pairs[pair], distance - float(self.pairs[5, pair]))

    def worst(self, outcome: Outcome) -> Proof:
        """The report of a proof that gave up: the smallest distance at the rows from there on.

        A pair is not asked where its moving body has not yet travelled as much as it was farther away than the nearest.
        """
        mover_of, (sway_at_rows, travel) = self.mover_of, self.movers
        rows, least = len(self._bezier), min((bound for _, bound in self.own_bounds()), default=math.inf)
        shown = min(*self._places(), float(rows))
        first = min(int(shown), rows - 1)
        end = shown if outcome != "travel" else float(self.bounded)
        due = [(first, pair) for pair in range(len(self._checker.pairs))]
        while due:
            check_deadline()
            row = due[0][0]
            # Points of Bezier between the rows may be no numbers.
            self.place(self._bezier[row, 0] if row < rows else self._bezier[-1, -1], float(row))
            pairs = []
            while due and due[0][0] == row:
                pairs.append(heapq.heappop(due)[1])
            for pair, distance in zip(pairs, self._checker.distances_of(np.array(pairs)).tolist(), strict=True):
                nearer = distance + float(self._counted[pair]) - float(sway_at_rows[mover_of[pair], row])
                distance = self._see(distance, pair, float(row))
                least = min(least, nearer)
                farther = min(distance - self.nearest[0], nearer - least)
                ahead = place_after(travel[mover_of[pair]], float(row), farther)
                following = max(math.ceil(min(ahead, rows + 1.0)), row + 1)
                if following <= rows:
                    heapq.heappush(due, (following, pair))
        near = self.contact()
        least = min(least, near.distance_m + float(self._counted[self.nearest[1]]))
        return Proof(outcome, least, near, self.checks, end, self.nearest[2])


@kernel
def point_at(bezier: FloatArray, at: float) -> FloatArray:
    """Configuration at a place counted in rows."""
    piece = min(int(at), bezier.shape[0] - 1)
    t = at - piece
    u = 1.0 - t
    q = np.empty(bezier.shape[2])
    for j in range(len(q)):
        p0, p1, p2, p3 = cubic_at(bezier, piece, j, t)
        q[j] = u * u * u * p0 + 3.0 * u * u * t * p1 + 3.0 * u * t * t * p2 + t * t * t * p3
    return q


@kernel
def _look(
    pairs: IntArray, distances: FloatArray, at: float, ahead: float, search: _Search
) -> tuple[float, int, bool, int, int, float]:
    """Write down what a look shows, and find the next one in which bounds are not enough for all pairs.

    Returns:
        Distance and number of the nearest pair, and whether none is too near, as `_put_off`; the number of looks in
        which bounds were enough; how many pairs the next one is at, none after the end or very many of those; and its
        place.
    """
    bezier = search.bezier
    least, is_far = _put_off(pairs, distances, at, ahead, search)
    nearest, which, count, looks = math.inf, 0, 0, 0
    if len(pairs):
        nearest, which = distances[least] + search.pairs[5, pairs[least]], pairs[least]
    frames, work = np.empty((bezier.shape[2] + 1, 12)), np.empty((2, 12))
    while is_far and count == 0 and looks < _BOUNDED_LOOKS:
        count, at = _next(search)
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
def _next(search: _Search) -> tuple[int, float]:
    """How many pairs are looked at next: the one due first, and others that may as well be; the place, or infinity."""
    due, upto, mover_of, travels = search.pairs[1], search.pairs[2], search.mover_of, search.movers[1]
    first, at, count = 0, due[0], 0
    for pair in range(len(due)):
        if due[pair] < at:
            first, at = pair, due[pair]
    if not at < math.inf:
        return 0, at
    travel = travels[mover_of[first]]
    before = min(place_after(travel, at, _TOGETHER * (_linear(travel, at) - upto[first])), len(travel) - 1.0)
    before = max(before, at)  # by rounding errors it may be less
    for pair in range(len(due)):
        if due[pair] <= before and (pair == first or upto[pair] <= _linear(travels[mover_of[pair]], at)):
            search.asked[count] = pair
            count += 1
    return count, at


@kernel
def _linear(values: FloatArray, at: float) -> float:
    """Value at a place of a function that is linear between its values at the rows."""
    row = min(int(at), len(values) - 2)
    value: float = values[row] + (at - row) * (values[row + 1] - values[row])
    return value


@kernel
def _put_off(pairs: IntArray, distances: FloatArray, at: float, ahead: float, search: _Search) -> tuple[int, bool]:
    """Write down what looks at a place show, and where the pairs are due again.

    Returns:
        Which of them is nearest, as if all had to keep what is needed, and whether none is too near.
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
    """As `_put_off` by lower bounds of distances, of the pairs whose bounds are large and leave the clearance shown.

    Args:
        count: How many pairs are looked at.
        frames: As `apart`, as `work`.
        place: Where it is, and how far ahead pairs are looked at.

    Returns:
        How many other pairs are left.
    """
    mover_of, sway, all_pairs = search.mover_of, search.movers[0], search.pairs
    kept, taken_off = all_pairs[0], all_pairs[6]
    at, ahead = place
    left = 0
    for i in range(count):
        pair = search.asked[i]
        bound = apart(frames, search.boxes, search.sides[pair], work) - taken_off[pair]
        spare_clearance = bound - (_linear(sway[mover_of[pair]], at) + kept[pair])
        shown = search.shown[int(all_pairs[7, pair])]
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
    """Write down how far to both sides a look at a pair shows the clearance, and where the pair is due again."""
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
    """The place up to which a moving body travels no farther than `part`, infinite where that is the end.

    Args:
        travel: (rows + 1,) how far it has travelled at each row; linear within a row.
        at: The place from where it goes on.
    """
    row = min(int(at), len(travel) - 2)
    limit = travel[row] + (at - row) * (travel[row + 1] - travel[row]) + part
    row, beyond = -1, len(travel)
    while row + 1 < beyond:  # the last row that is no farther
        middle = (row + beyond) // 2
        if travel[middle] <= limit:
            row = middle
        else:
            beyond = middle
    if row == len(travel) - 1:
        return math.inf
    place: float = row + (limit - travel[row]) / (travel[row + 1] - travel[row])
    return place
