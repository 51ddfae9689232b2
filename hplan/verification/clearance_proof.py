r"""Clearance over the whole of a motion: conservative advancement along its cubics, each pair at its own pace.

A pair is a link and an obstacle, a turning shape of the turret and an obstacle, or two parts of the arm. Each has a
mover: that of an obstacle is the link, or the turret, which the yaw alone moves; that of two parts of the arm is one of
them as seen from the other. What a pair has to spare when coal is
asked, less what has been shown so far (at most half of what any pair had to spare), its mover may travel before the
pair is asked again; so at least what is shown remains at all times. Places are counted in rows. Where the proof has to
give up, the rest of the motion is searched for the worst.

**Tracking.** Joints that are off by their deviations bring a pair nearer by its sway, at most :math:`m_r` in piece
:math:`r` of the motion. It is replaced by the piecewise linear :math:`\tilde m` with the values
:math:`M_r = \max(m_{r - 1}, m_r)` at the rows, so that :math:`\tilde m(x) \ge m_r` at every place :math:`x` of piece
:math:`r`. With :math:`T` what the mover travels up to a place and :math:`V` by how much :math:`\tilde m` has risen in
all up to there, both piecewise linear, a pair of distance :math:`d(a)` when coal is asked at :math:`a` has at every
later place

.. math::
    d(x) - \tilde m(x) \ge d(a) - [T(x) - T(a)] - \tilde m(a) - [V(x) - V(a)],

so the advancement counts :math:`T + V` as travel and :math:`d(a) - \tilde m(a)`, less the distance to be kept, as
spare.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import kernel
from hplan.collision.coal_scene import CoalScene, Contact
from hplan.robot.base_shapes import GROUND, TURRET
from hplan.robot.model import Robot
from hplan.robot.self_contact import pair_rates, pair_sway

#: Spare clearance below which the proof gives up [m]: its steps, half of what is spare, would become too small.
SMALLEST_STEP = 1e-5

#: Largest share of what a pair has to spare that its link may travel before the next look: far away, coal's distances
#: are good to a share of them.
MOST_TRAVEL = 0.99


#: Configurations at which the proof may evaluate distances: some, and for each piece of the motion. A motion of 1.8 s
#: that comes to 1.5 mm of an obstacle takes 155.
CHECKS, CHECKS_PER_PIECE = 20_000, 50

#: Longest travel that is bounded [m]: beyond, its sum over the pieces would be good to less than a micrometre.
LONGEST_TRAVEL = 1e5

#: Why a proof ends: the clearance is shown, a pair is too near, or what it may take is used up.
Outcome: TypeAlias = Literal["shown", "too near", "checks", "travel"]


@dataclass(frozen=True)
class Proof:
    """Clearance over the whole motion.

    Attributes:
        outcome: Whether it is shown, or why not: a pair comes too near, more than the stated number of checks would be
            needed, or the motion is too fast or too long for its travel to be bounded.
        clearance_m: How much is shown; else the smallest that was found, less what the tracking error may take [m].
        nearest: The nearest pair that was seen, and its distance; None without pairs.
        checks: Configurations at which distances were evaluated.
        end: Place up to which it was shown, or from which on travel is not bounded, counted in pieces.
    """

    outcome: Outcome
    clearance_m: float
    nearest: Contact | None
    checks: int
    end: float

    @property
    def shown(self) -> bool:
        """Whether the clearance is shown over the whole motion."""
        return self.outcome == "shown"


def prove_clearance(
    robot: Robot, bezier: FloatArray, checker: CoalScene, deviations: FloatArray, needed: float
) -> Proof:
    """Show that every pair keeps its distance at all times, or find where it does not.

    Args:
        robot: The arm.
        bezier: (pieces, 4, dof) Bezier points of the motion's cubics.
        checker: The arm among the obstacles.
        deviations: (pieces, dof) largest deviation of each joint within each cubic, or (1, dof) for all of them [rad].
        needed: Distance to be kept [m].
    """
    # Pairs that touch only beyond the limits, where a deviation leads, are asked too.
    checker = checker.covering(float(deviations.max()), needed)
    if not checker.pairs:
        return Proof("shown", math.inf, None, 0, len(bezier))
    search = _Advancement(robot, bezier, checker, deviations, needed)
    if search.bounded < len(bezier):
        return search.worst("travel")
    budget = CHECKS + CHECKS_PER_PIECE * len(bezier)
    # At the start all pairs at once; those that cannot come near in the whole motion are not asked again.
    distances = checker.pair_distances(bezier[0, 0])
    going = search.take(np.arange(len(distances)), distances, 0.0)
    while going:
        pairs, at, q = _first(search.due, bezier)
        if at == math.inf:
            return Proof("shown", needed + search.shown, search.contact(), search.checks, len(bezier))
        if search.checks >= budget:
            return search.worst("checks")
        search.place(q)
        going = search.ask(pairs, at)
        # Together with the pair that is due, those that would be before it is due again.
        others = _due_before(search.due, pairs)
        if going and len(others):
            going = search.ask(others, at)
    return search.worst("too near")


class _Advancement:
    """How far the motion has been looked at, pair by pair.

    Attributes:
        due: (pairs,) the place where each is to be asked again; infinite where that is after the end.
        shown: What is shown of every pair up to there, beyond what is needed [m].
        nearest: The smallest distance so far [m], and the pair.
        checks: Configurations looked at.
        bounded: How many pieces from the first on have a bounded travel.
    """

    def __init__(
        self, robot: Robot, bezier: FloatArray, checker: CoalScene, deviations: FloatArray, needed: float
    ) -> None:
        self._bezier, self._judge = bezier, checker
        self._mover_of, others = _movers(checker)
        with np.errstate(over="ignore", invalid="ignore"):
            rates = 3.0 * np.diff(bezier, axis=1)
            bounds = [_link_bounds(robot, rates), *(pair_rates(robot, part, other, rates) for part, other in others)]
            moved = np.column_stack(bounds).T
            sways = _sways(robot, others, deviations)
            if checker.links != "capsule":
                moved = moved + _off_axis(checker, others, np.abs(rates).max(axis=1))
                sways = sways + _off_axis(checker, others, deviations)
            self._sway = _at_rows(sways, len(bezier))
            if len(deviations) > 1:
                moved = moved + np.maximum(np.diff(self._sway, axis=1), 0.0)
            self._travel = np.column_stack([np.zeros(len(moved)), np.cumsum(moved, axis=1)])
            within = (self._travel[:, 1:] <= LONGEST_TRAVEL).all(axis=0)
        self.bounded = int(within.sum())
        if self.bounded < len(bezier):
            # For the search of the rows alone: after such a piece every pair may be anywhere.
            moved = np.where(moved <= LONGEST_TRAVEL, moved, LONGEST_TRAVEL)
            self._travel[:, 1:] = np.cumsum(moved, axis=1)
        self._kept = needed + checker.distance_errors
        self._at = 0.0
        self.due = np.full(len(checker.pairs), math.inf)
        self.shown = math.inf
        self.nearest = math.inf, 0
        self.checks = 1

    def place(self, q: FloatArray) -> None:
        """Put the arm at a configuration."""
        self._judge.place(q)
        self.checks += 1

    def ask(self, pairs: IntArray, at: float) -> bool:
        """Ask coal about some pairs, the arm being there; whether the proof goes on."""
        return self.take(pairs, self._judge.distances_of(pairs), at)

    def take(self, pairs: IntArray, distances: FloatArray, at: float) -> bool:
        """Take what coal says of some pairs; whether the proof goes on."""
        self._at = at
        least, self.shown = _put_off(
            pairs, distances, at, self._kept, self._mover_of, self._sway, self._travel, self.shown, self.due
        )
        self.nearest = min(self.nearest, (float(distances[least]), int(pairs[least])))
        return self.shown > 0.0

    def contact(self) -> Contact:
        """The nearest pair by name, and its distance."""
        distance, pair = self.nearest
        return self._judge.contact(*self._judge.pairs[pair], distance)

    def worst(self, outcome: Outcome) -> Proof:
        """What a proof that gave up reports: the smallest distance at the rows from there on.

        A pair is not asked where its mover has not yet travelled what it was farther away than the nearest.
        """
        rows, least = len(self._bezier), math.inf
        first = min(int(self._at), rows - 1)
        end = self._at if outcome != "travel" else float(self.bounded)
        due = [(first, pair) for pair in range(len(self._judge.pairs))]
        while due:
            row = due[0][0]
            # Points of Bezier between the rows may be no numbers.
            self.place(self._bezier[row, 0] if row < rows else self._bezier[-1, 3])
            pairs = []
            while due and due[0][0] == row:
                pairs.append(heapq.heappop(due)[1])
            for pair, distance in zip(pairs, self._judge.distances_of(np.array(pairs)).tolist(), strict=True):
                sway = float(self._sway[self._mover_of[pair], row])
                self.nearest = min(self.nearest, (distance, pair))
                least = min(least, distance - sway)
                farther = min(distance - self.nearest[0], distance - sway - least)
                ahead = place_after(self._travel[self._mover_of[pair]], float(row), farther)
                following = max(math.ceil(min(ahead, rows + 1.0)), row + 1)
                if following <= rows:
                    heapq.heappush(due, (following, pair))
        return Proof(outcome, min(least, self.nearest[0]), self.contact(), self.checks, end)


@kernel
def _point(bezier: FloatArray, at: float) -> FloatArray:
    """Configuration at a place counted in rows."""
    piece = min(int(at), bezier.shape[0] - 1)
    t = at - piece
    u = 1.0 - t
    q = np.empty(bezier.shape[2])
    for j in range(len(q)):
        q[j] = (
            u * u * u * bezier[piece, 0, j]
            + 3.0 * u * u * t * bezier[piece, 1, j]
            + 3.0 * u * t * t * bezier[piece, 2, j]
            + t * t * t * bezier[piece, 3, j]
        )
    return q


@kernel
def _first(due: FloatArray, bezier: FloatArray) -> tuple[IntArray, float, FloatArray]:
    """The pair that is due first, the place (infinite: after the end), and the configuration there."""
    first = np.argmin(due)
    return np.array([first]), due[first], _point(bezier, min(due[first], float(bezier.shape[0])))


@kernel
def _due_before(due: FloatArray, pairs: IntArray) -> IntArray:
    """Pairs that are due before one is; none where that is after the end."""
    place = due[pairs[0]]
    return np.flatnonzero(due < place) if place < math.inf else np.empty(0, dtype=np.int64)


@kernel
def _linear(values: FloatArray, at: float) -> float:
    """What is linear between its values at the rows, at a place."""
    row = min(int(at), len(values) - 2)
    value: float = values[row] + (at - row) * (values[row + 1] - values[row])
    return value


def _at_rows(sway: FloatArray, pieces: int) -> FloatArray:
    """(movers, pieces + 1) the larger sway of the two pieces at each row, from that of the pieces, or of all in one."""
    if sway.shape[1] == 1:
        return np.repeat(sway, pieces + 1, axis=1)
    return np.maximum(np.column_stack([sway[:, :1], sway]), np.column_stack([sway, sway[:, -1:]]))


@kernel
def _put_off(
    pairs: IntArray,
    distances: FloatArray,
    at: float,
    kept: FloatArray,
    mover_of: IntArray,
    sway: FloatArray,
    travel: FloatArray,
    shown: float,
    due: FloatArray,
) -> tuple[int, float]:
    """Write down where pairs are due again that were asked at a place.

    Returns:
        Which of them has the smallest distance, and what is then shown; 0 where the proof has to give up.
    """
    least = 0
    spares = np.empty(len(pairs))
    for i in range(len(pairs)):
        if not distances[i] >= distances[least]:
            least = i
        spare = spares[i] = distances[i] - (_linear(sway[mover_of[pairs[i]]], at) + kept[pairs[i]])
        if not spare > SMALLEST_STEP:
            shown = 0.0
        shown = min(shown, 0.5 * spare)
    if not shown > 0.0:
        return least, 0.0
    for i in range(len(pairs)):
        pair = pairs[i]
        spare = spares[i]
        due[pair] = math.inf
        if spare < math.inf:  # else these two may touch
            place = place_after(travel[mover_of[pair]], at, min(spare - shown, MOST_TRAVEL * spare))
            if place <= travel.shape[1] - 1:
                due[pair] = max(place, np.nextafter(at, math.inf))
    return least, shown


@kernel
def place_after(travel: FloatArray, at: float, part: float) -> float:
    """The place up to which a mover travels no farther than `part`, infinite where that is the end.

    Args:
        travel: (rows + 1,) how far it has travelled at each row; linear within a row.
        at: The place from where it goes on.
        part: How far it may go.
    """
    row = min(int(at), len(travel) - 2)
    limit = travel[row] + (at - row) * (travel[row + 1] - travel[row]) + part
    row = np.searchsorted(travel, limit, side="right") - 1
    if row >= len(travel) - 1:
        return math.inf
    place: float = row + (limit - travel[row]) / (travel[row + 1] - travel[row])
    return place


def pair_sways(checker: CoalScene, deviations: FloatArray) -> FloatArray:
    """By how much each pair may come nearer when joints are off by deviations, (k, dof) [rad] -> (pairs, k) [m]."""
    mover_of, others = _movers(checker)
    return _sways(checker.robot, others, deviations)[mover_of]


def _sways(robot: Robot, others: Sequence[tuple[int, int]], deviations: FloatArray) -> FloatArray:
    """(movers, k) by how much the movers' pairs may come nearer [m]: of the links, then of the others."""
    found = [pair_sway(robot, part, other, deviations) for part, other in others]
    return np.column_stack([robot.sway(deviations), *found]).T


def _off_axis(checker: CoalScene, others: Sequence[tuple[int, int]], turns: FloatArray) -> FloatArray:
    """(movers, k) how much farther than its axis a link that is no capsule moves as joints turn by (k, dof) [m].

    A ball about a point of the axis moves as that point does; what is at most r from the axis by r times the link's
    turn more, which is at most the sum of the turns of the joints before it. Seen from another link, that one's own
    turn comes to it.
    """
    arm = checker.robot.arm
    reach = arm.half_widths * {"capsule": 0.0, "urdf": 1.0, "box": math.sqrt(2.0)}[checker.links]
    first = 1 if checker.robot.has_yaw else 0
    turned = np.cumsum(np.abs(turns), axis=1)[:, first:].T
    found = [reach[link] * turned[link] for link in range(arm.link_count)]
    for part, other in others:
        own = reach[part] * turned[part] if part >= 0 else np.zeros(len(turns))
        found.append(own + (reach[part] * turned[other] if part >= 0 and other >= 0 else 0.0))
    return np.array(found)


def _movers(checker: CoalScene) -> tuple[IntArray, list[tuple[int, int]]]:
    """The mover of each pair, and the movers after the links: a part, and what its motion is seen from.

    The links as seen from the ground are the first movers.
    """
    first, links = len(checker.pairs) - len(checker.own_others), len(checker.link_names)
    seen_from = [GROUND] * first + checker.own_others
    parts = [
        (mover if mover < links else TURRET, other) for (mover, _), other in zip(checker.pairs, seen_from, strict=True)
    ]
    movers = list(dict.fromkeys([*((link, GROUND) for link in range(links)), *parts]))
    numbers = {mover: number for number, mover in enumerate(movers)}
    return np.array([numbers[part] for part in parts], dtype=np.int64), movers[links:]


def _link_bounds(robot: Robot, rates: FloatArray) -> FloatArray:
    """(pieces, links) largest distance that any axis point of a link can travel within each cubic [m].

    A point of link k moves by no more than the sum over links i <= k of length times turn of the absolute angle, plus
    yaw times the largest distance from the yaw axis; the turns are bounded by the hull of the derivative, whose
    (pieces, 3, dof) Bezier points are `rates`.
    """
    arm, first = robot.arm, 1 if robot.has_yaw else 0
    return _travels(rates, first, arm.signs, arm.lengths, robot.yaw_radius)


@kernel
def _travels(
    rates: FloatArray, first: int, signs: FloatArray, lengths: FloatArray, yaw_radius: FloatArray
) -> FloatArray:
    """The compiled part of `_link_bounds`; what is no number stays none."""
    result, turned = np.empty((rates.shape[0], len(lengths))), np.empty(rates.shape[1])
    for piece in range(rates.shape[0]):
        swing = 0.0
        for i in range(len(turned)):
            turned[i] = 0.0
            if first:
                swing = _larger(swing, abs(rates[piece, i, 0]))
        bound = 0.0
        for k in range(len(lengths)):
            turn = 0.0
            for i in range(len(turned)):
                turned[i] += signs[k] * rates[piece, i, first + k]
                turn = _larger(turn, abs(turned[i]))
            bound += lengths[k] * turn
            result[piece, k] = bound + swing * yaw_radius[k] if first else bound
    return result


@kernel
def _larger(first: float, second: float) -> float:
    """The larger of two numbers; none where one of them is none."""
    return second if second > first or second != second else first
