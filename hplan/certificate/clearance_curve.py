r"""Clearance of a motion over time, with lower bounds between stations.

Far from obstacles the proof makes few distance queries and does not measure the distance. The curve therefore makes its
own queries at stations along the motion, on first access. The spacing of the stations decreases with the distance of
the nearest pair. Coal is queried only for the pairs that may be the nearest before the next station.

With :math:`T` the travel of a pair's moving body (`hplan.certificate.clearance_proof`), the pair's distance between two
stations :math:`a < b` changes by no more than the travel: :math:`d(x) \ge d(a) - [T(x) - T(a)]` and
:math:`d(x) \ge d(b) - [T(b) - T(x)]`, so, by their mean,

.. math:: d(x) \ge \tfrac{1}{2} (d(a) + d(b) - [T(b) - T(a)]) \quad \text{for all } x \in [a, b].

The inequality also holds with lower bounds of both distances. Coal's error and the tracking displacement bound are
subtracted from it. The value at each station is the minimum of the bounds before and after it, so straight lines
between stations are nowhere above the bounds.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hplan.base import ties
from hplan.base.arguments import check_integer
from hplan.base.arrays import FloatArray, IntArray, Record, frozen
from hplan.certificate.clearance_proof import Advancement, Proof, at_place, place_after, point_at
from hplan.certificate.pushes import pushes_along
from hplan.certificate.segment_contacts import Push, SegmentContacts
from hplan.collision.coal_scene import CoalScene
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import SAME_TIME, Trajectory

#: Travel between two stations: a fraction of the distance of the nearest pair, and its bounds [m].
_STATION_FRACTION, _STATION_M = 0.08, (1e-3, 0.05)


@dataclass(frozen=True, eq=False)
class ClearanceCurve(Record):
    """Clearance of a motion over time, piecewise linear between stations.

    Attributes:
        time: (n,) increasing times of the stations [s].
        clearance_m: (n,) certified clearance: at no time is any pair nearer than the line through these values,
            tracking errors included [m]; infinite without pairs, minus infinity without a bound.
        distance_m: (n,) distance of the nearest pair at the station itself, without tracking errors [m].
        nearest: (n,) index of the nearest pair in `pairs`; -1 without pairs.
        pairs: Names of link and obstacle, or of link and other part of the arm.
    """

    time: FloatArray
    clearance_m: FloatArray
    distance_m: FloatArray
    nearest: IntArray
    pairs: tuple[tuple[str, str], ...]

    @property
    def report_curve(self) -> ClearanceCurve:
        """The curve thinned for display in reports; nowhere higher."""
        # Minimum number of displayed stations, number for each second, and maximum number.
        shown_stations, shown_per_s, most_shown = 300, 40.0, 1200
        wanted = max(shown_stations, round(shown_per_s * float(self.time[-1])))
        return self.thin(min(wanted, most_shown))

    def thin(self, count: int) -> ClearanceCurve:
        """The curve at `count` evenly spaced times, if it has more stations.

        It is nowhere higher than this curve.

        Raises:
            OptionError: `count` is not an integer, or is below 2.
        """
        count = check_integer("count", count, 2)
        if len(self.time) <= count:
            return self
        clock = np.linspace(self.time[0], self.time[-1], count)
        time = np.union1d(clock, self.time)
        marks = np.searchsorted(time, clock)
        bound = _on_lines(time, self.time, self.clearance_m)
        lowest = [bound[a : b + 1].min() for a, b in pairwise(marks.tolist())]
        # Each time takes the minimum distance of the stations around it.
        ends = np.searchsorted(self.time, 0.5 * (clock[1:] + clock[:-1])).tolist()
        seen = [
            slice(max(0, min(a, len(self.time) - 1)), max(b, a + 1)) for a, b in pairwise([0, *ends, len(self.time)])
        ]
        found = [each.start + int(self.distance_m[each].argmin()) for each in seen]
        return ClearanceCurve(
            frozen(clock),
            frozen(_lower_of_both(np.array(lowest))),
            frozen(self.distance_m[found]),
            frozen(self.nearest[found]),
            self.pairs,
        )


class ProvedStretch(NamedTuple):
    """A range of a motion's segments and its clearance proof.

    Attributes:
        part: The range of segments.
        checker: The collision checker that is valid there.
        deviations: (segments, dof) maximum deviation of each joint within each segment, or (1, dof) for all [rad; m for
            prismatic joints].
        proof: The clearance proof.
        clock: Times of its samples on the clock of the obstacles' movements [s]; None if no obstacle moves.
    """

    part: slice
    checker: CoalScene
    deviations: FloatArray
    proof: Proof
    clock: FloatArray | None = None

    def cut(self, rows: slice) -> ProvedStretch:
        """The part of the stretch in a range of the motion's segments, numbered from there on."""
        first, last = max(self.part.start, rows.start), min(self.part.stop, rows.stop)
        inside = slice(first - self.part.start, last - self.part.start)
        deviations = self.deviations if len(self.deviations) == 1 else self.deviations[inside]
        clock = None if self.clock is None else self.clock[inside.start : inside.stop + 1]
        return ProvedStretch(slice(first - rows.start, last - rows.start), self.checker, deviations, self.proof, clock)


@dataclass(frozen=True, eq=False)
class ProvedMotion(Record):
    """A motion and its clearance proofs, verified or not, for its curve.

    Attributes:
        robot: The arm.
        trajectory: The motion.
        stretches: The proofs of its ranges, in order.
        clearance: Required clearance [m].
    """

    robot: Robot
    trajectory: Trajectory
    stretches: tuple[ProvedStretch, ...]
    clearance: float

    @cached_property
    def curve(self) -> ClearanceCurve:
        """Clearance of the motion over time."""
        bezier, _ = self.trajectory.segments
        rows, time = np.arange(self.trajectory.samples, dtype=np.float64), self.trajectory.time
        found = []
        for stretch in self.stretches:
            curve = _curve_over_places(bezier[stretch.part], stretch, self.clearance)
            clock = np.interp(curve.time + stretch.part.start, rows, time)
            found.append(replace(curve, time=clock))
        return _one_after_the_other(found)

    @cached_property
    def pushes_by_segment(self) -> SegmentContacts:
        """Contacts of the motion with compliant obstacles within each segment."""
        bezier, _ = self.trajectory.segments
        return SegmentContacts.join(
            pushes_along(
                bezier[stretch.part], self.trajectory.time[stretch.part.start : stretch.part.stop + 1],
                stretch.checker, stretch.deviations, self.clearance, stretch.clock, proved=stretch.proof.is_certified,
            )
            for stretch in self.stretches
        )  # fmt: skip

    def cut(self, begin_s: float, end_s: float) -> ProvedMotion | None:
        """The motion between the first sample and the last sample within two times; None without a segment."""
        time = self.trajectory.time
        first = int(np.searchsorted(time, begin_s - SAME_TIME))
        last = int(np.searchsorted(time, end_s + SAME_TIME, side="right")) - 1
        if first >= last:
            return None
        rows = slice(first, last)
        inside = (each for each in self.stretches if each.part.start < last and first < each.part.stop)
        part = self.trajectory.cut_after(last).cut_before(first)
        return replace(self, trajectory=part, stretches=tuple(stretch.cut(rows) for stretch in inside))


@dataclass(frozen=True, eq=False)
class Subject(Record):
    """Sequence of certified motions, whose curves are computed on first access.

    Attributes:
        motions: The motions, each with True if it is run in reverse.
    """

    motions: tuple[tuple[ProvedMotion, bool], ...]

    @property
    def has_limbs(self) -> bool:
        """True if a link may push a part of a limb or a hanging fruit in one of the motions."""
        return any(stretch.checker.has_limbs for motion, _ in self.motions for stretch in motion.stretches)

    @property
    def reversal(self) -> Subject:
        """The sequence in reverse."""
        return Subject(tuple((motion, not backwards) for motion, backwards in self.motions[::-1]))

    def cut(self, begin_s: float, end_s: float) -> tuple[Subject, list[int]]:
        """The sequence between two of its samples, by their times, and the numbers of the motions in it."""
        found, numbers, offset_s = list[tuple[ProvedMotion, bool]](), list[int](), 0.0
        for number, (motion, backwards) in enumerate(self.motions):
            duration_s = motion.trajectory.duration
            first_s, last_s = begin_s - offset_s, end_s - offset_s
            span = (duration_s - last_s, duration_s - first_s) if backwards else (first_s, last_s)
            part = motion.cut(*span)
            if part is not None:
                found.append((part, backwards))
                numbers.append(number)
            offset_s += duration_s
        return Subject(tuple(found)), numbers

    @cached_property
    def curve(self) -> ClearanceCurve:
        """Clearance over the total time of all motions."""
        found, begin = [], 0.0
        for motion, backwards in self.motions:
            curve = _backwards(motion.curve) if backwards else motion.curve
            found.append(replace(curve, time=begin + curve.time))
            begin += motion.trajectory.duration
        return _one_after_the_other(found)

    @cached_property
    def pushes_by_segment(self) -> SegmentContacts:
        """Contacts with compliant obstacles within single segments, over the total time of all motions."""
        found, begin_s = list[SegmentContacts](), 0.0
        for motion, backwards in self.motions:
            duration_s = motion.trajectory.duration
            found.append(motion.pushes_by_segment.shift(begin_s, reversed_after_s=duration_s if backwards else None))
            begin_s += duration_s
        return SegmentContacts.join(found)

    @property
    def pushes(self) -> tuple[Push, ...]:
        """Contacts with compliant obstacles, merged over the total time of all motions."""
        return self.pushes_by_segment.merged


def joined_subjects(parts: Iterable[Subject | None]) -> Subject | None:
    """Concatenated motions of several certificates; None if one of them is None."""
    known = list(parts)
    found = [part for part in known if part is not None]
    return Subject(tuple(motion for part in found for motion in part.motions)) if len(found) == len(known) else None


def _backwards(curve: ClearanceCurve) -> ClearanceCurve:
    return ClearanceCurve(
        curve.time[-1] - curve.time[::-1],
        curve.clearance_m[::-1],
        curve.distance_m[::-1],
        curve.nearest[::-1],
        curve.pairs,
    )


def _one_after_the_other(curves: Sequence[ClearanceCurve]) -> ClearanceCurve:
    """Concatenate curves; at a common time the lower values are kept."""
    names = dict.fromkeys(pair for curve in curves for pair in curve.pairs)
    numbers = {pair: number for number, pair in enumerate(names)}
    time, clearance, distance = (
        np.concatenate([getattr(curve, name) for curve in curves]) for name in ("time", "clearance_m", "distance_m")
    )
    nearest = np.concatenate(
        [np.array([*(numbers[pair] for pair in curve.pairs), -1], dtype=np.int64)[curve.nearest] for curve in curves]
    )
    # Sort stations with equal times by distance.
    order = np.lexsort((distance, time))
    first = np.flatnonzero(np.diff(time[order], prepend=-np.inf) > 0.0)
    return ClearanceCurve(
        frozen(time[order][first]),
        frozen(np.minimum.reduceat(clearance[order], first)),
        frozen(distance[order][first]),
        frozen(nearest[order][first]),
        tuple(names),
    )


def _curve_over_places(bezier: FloatArray, stretch: ProvedStretch, clearance: float) -> ClearanceCurve:
    """Curve of one range, with positions in samples instead of times."""
    deviations, proof = stretch.deviations, stretch.proof
    checker = stretch.checker.with_margins(float(deviations.max()), clearance)
    if not checker.pairs:
        nothing = np.full(2, np.inf)
        return ClearanceCurve(np.array([0.0, float(len(bezier))]), nothing, nothing, np.full(2, -1), ())
    search = Advancement(bezier, checker, deviations, clearance, stretch.clock)
    looks = list(_looks(search, bezier, checker, checker.deflection_offsets(clearance)))
    places, nearest = np.array([look.place for look in looks]), np.array([look.nearest for look in looks])
    bounds = _lower_of_both(np.array([look.bound_m for look in looks[1:]]))
    if proof.is_certified:
        bounds = np.maximum(bounds, proof.clearance_m)
    seen = np.unique(nearest[nearest >= 0])
    numbers = np.where(nearest < 0, -1, np.searchsorted(seen, nearest))
    contacts = [checker.contact(*checker.pairs[int(pair)], 0.0) for pair in seen]
    return ClearanceCurve(
        places,
        bounds,
        np.array([look.distance_m for look in looks]),
        numbers,
        tuple((contact.link, contact.obstacle) for contact in contacts),
    )


class _Look(NamedTuple):
    """A station: position, nearest pair, its distance, and preceding bound [m]."""

    place: float
    nearest: int
    distance_m: float
    bound_m: float


class _Stations:
    """Spacing of the stations."""

    def __init__(self, travel: FloatArray, bounded: int) -> None:
        """Take the travel of the moving bodies, (bodies, segments + 1) [m].

        It is bounded up to the sample `bounded`.
        """
        self._travel = np.append(0.0, np.cumsum(np.diff(travel, axis=1).max(axis=0)))
        self._bounded = bounded
        # A minimum spacing limits the stations of a range to about 20,000.
        self._least = max(_STATION_M[0], float(self._travel[bounded]) / 20_000)

    def next_station(self, place: float, nearest: float) -> float:
        """Next station after `place`, with the nearest pair at distance `nearest` [m]."""
        step = max(min(_STATION_FRACTION * nearest, _STATION_M[1]), self._least)
        following: float = place_after(self._travel, place, step)
        if following > self._bounded:  # sample by sample from there on
            following = max(float(self._bounded), np.floor(place) + 1.0)
        return max(min(following, len(self._travel) - 1.0), math.nextafter(place, math.inf))


def _looks(search: Advancement, bezier: FloatArray, checker: CoalScene, counted: FloatArray) -> Iterator[_Look]:
    """Stations of a range, in order.

    Each pair has a lower bound of its distance: coal's last result minus the travel of its moving body since then.
    """
    sway, travel = search.movers
    mover_of, errors, end = search.mover_of, checker.distance_errors, float(len(bezier))
    stations = _Stations(travel, search.bounded)
    place, pair, bound = 0.0, 0, np.inf
    lower = np.full(len(mover_of), -np.inf)
    travelled, swayed = travel[:, 0], sway[:, 0]
    # Relative error of coal's distances far away; they may be too large by this fraction.
    far_error = 1e-3
    while True:
        search.place(point_at(bezier, place), place)
        nearest = float(search.distances_of(np.array([pair]), place)[0] + counted[pair])
        now, sways = at_place(travel, place), at_place(sway, place)
        forward = lower - (now - travelled)[mover_of]
        # Pairs that may be nearer than this one before the next station; they may shorten the step to it.
        ahead = at_place(travel, stations.next_station(place, nearest))
        asked = np.flatnonzero(forward - (ahead - now)[mover_of] < nearest)
        if len(asked):
            distances = search.distances_of(asked, place) + counted[asked]
            pair = int(asked[ties.argmin(distances)])
            nearest = float(distances.min())
            least = distances * (1.0 - far_error * np.sign(distances)) - errors[asked]
            known = forward.copy()
            known[asked] = np.maximum(forward[asked], least)
        else:
            known = forward
        # By its closed mesh a pair is farther apart than by the piece that is measured here.
        nearest = max(nearest, float(known.min()))
        if place > 0.0:
            between = 0.5 * (forward + known) - np.maximum(swayed, sways)[mover_of]
            bound = float(between.min()) if place <= search.bounded else -np.inf
        yield _Look(place, pair if nearest < np.inf else -1, nearest, bound)
        if place >= end:
            return
        lower, travelled, swayed, place = known, now, sways, stations.next_station(place, nearest)


def _lower_of_both(bounds: FloatArray) -> FloatArray:
    """Minimum of the bounds before and after each station.

    (n - 1,) -> (n,).
    """
    lower: FloatArray = np.minimum(np.append(bounds[0], bounds), np.append(bounds, bounds[-1]))
    return lower


def _on_lines(clock: FloatArray, time: FloatArray, values: FloatArray) -> FloatArray:
    """Linear interpolation at times `clock` of values that may be infinite."""
    # Finite substitute for an infinite clearance in the interpolation [m].
    far_m = 1e12
    lines: FloatArray = np.interp(clock, time, np.clip(values, -far_m, far_m))
    lines[np.abs(lines) > 1e-3 * far_m] *= np.inf
    return lines
