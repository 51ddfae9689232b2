r"""Clearance over time: how near the nearest pair is along a motion, and what is certain between the looks.

Where the proof looks seldom, far from obstacles, nothing says how far they are; so the curve is drawn by looks of its
own, at stations along the motion, and only once somebody asks for it. Stations are the closer, the nearer the nearest
pair is. Coal is asked about those pairs alone that may be the nearest before the next station.

With :math:`T` what a pair's moving body travels (`hplan.certificate.clearance_proof`), the pair's distance changes
between two stations :math:`a < b` by no more than that: :math:`d(x) \ge d(a) - [T(x) - T(a)]` and
:math:`d(x) \ge d(b) - [T(b) - T(x)]`, so, by their mean,

.. math:: d(x) \ge \tfrac{1}{2} (d(a) + d(b) - [T(b) - T(a)]) \quad \text{for all } x \in [a, b].

That holds with lower bounds of both distances too. From it are taken coal's error and what tracking errors may bring
the pair nearer. At each station stands the smaller of the bounds before and after it: so straight lines between
stations are nowhere above them.
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
from hplan.base.arguments import whole
from hplan.base.arrays import FloatArray, IntArray, Record, frozen
from hplan.certificate.clearance_proof import Advancement, Proof, place_after, point_at
from hplan.certificate.pushes import Push, joined, pushes_along
from hplan.collision.coal_scene import CoalScene
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Trajectory

#: Travel between two stations: a part of the distance of the nearest pair, within bounds [m].
_STATION_FRACTION, _STATION_M = 0.08, (1e-3, 0.05)


@dataclass(frozen=True, eq=False)
class ClearanceCurve(Record):
    """Clearance of a motion over time; between its stations the values are those of straight lines.

    Attributes:
        time: (n,) increasing times of the stations [s].
        clearance_m: (n,) certain clearance: at no time is any pair nearer than the line through these, tracking errors
            included [m]; infinite where there is nothing to meet, minus infinity where nothing is certain.
        distance_m: (n,) distance of the nearest pair at the station itself, without tracking errors [m].
        nearest: (n,) which of `pairs` that is; -1 where there is none.
        pairs: Link and obstacle, or other part of the arm, by name.
    """

    time: FloatArray
    clearance_m: FloatArray
    distance_m: FloatArray
    nearest: IntArray
    pairs: tuple[tuple[str, str], ...]

    @property
    def shown(self) -> ClearanceCurve:
        """The curve with as many stations as can be seen, for reports and pages; nowhere higher."""
        # Stations of a curve that is to be shown: so many, or for each second, up to so many.
        shown_stations, shown_per_s, most_shown = 300, 40.0, 1200
        wanted = max(shown_stations, round(shown_per_s * float(self.time[-1])))
        return self.thinned(min(wanted, most_shown))

    def thinned(self, count: int) -> ClearanceCurve:
        """The curve at so many evenly spaced times, where it has more stations; nowhere higher.

        Raises:
            OptionError: No whole number, or less than 2.
        """
        count = whole("count", count, 2)
        if len(self.time) <= count:
            return self
        clock = np.linspace(self.time[0], self.time[-1], count)
        time = np.union1d(clock, self.time)
        marks = np.searchsorted(time, clock)
        bound = _on_lines(time, self.time, self.clearance_m)
        lowest = [bound[a : b + 1].min() for a, b in pairwise(marks.tolist())]
        # What was seen nearest to each time stands for it: the least distance of the stations about it.
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
    """A range of a motion's cubics, and what was shown there.

    Attributes:
        deviations: (pieces, dof) largest deviation of each joint within each cubic, or (1, dof) for all [rad].
        proof: What was shown.
        clock: Times of its rows, as movements of obstacles count them [s]; None where nothing moves.
    """

    part: slice
    checker: CoalScene
    deviations: FloatArray
    proof: Proof
    clock: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class ProvedMotion(Record):
    """A motion of which clearance was to be shown, for its curve.

    Attributes:
        stretches: What was shown, stretch by stretch.
        clearance: Clearance to keep [m].
    """

    robot: Robot
    trajectory: Trajectory
    stretches: tuple[ProvedStretch, ...]
    clearance: float

    @cached_property
    def curve(self) -> ClearanceCurve:
        """Its clearance over time."""
        bezier, _ = self.trajectory.segments
        rows, time = np.arange(self.trajectory.samples, dtype=np.float64), self.trajectory.time
        found = []
        for stretch in self.stretches:
            curve = _curve_over_places(bezier[stretch.part], stretch, self.clearance)
            clock = np.interp(curve.time + stretch.part.start, rows, time)
            found.append(replace(curve, time=clock))
        return _one_after_the_other(found)

    @cached_property
    def pushes(self) -> tuple[Push, ...]:
        """What gives way in it."""
        bezier, _ = self.trajectory.segments
        found = list[Push]()
        for stretch in self.stretches:
            part, time = stretch.part, self.trajectory.time[stretch.part.start : stretch.part.stop + 1]
            found += pushes_along(
                bezier[part], time, stretch.checker, stretch.deviations, self.clearance, stretch.clock,
                proved=stretch.proof.shown,
            )  # fmt: skip
        return joined(found)


@dataclass(frozen=True, eq=False)
class Subject(Record):
    """The motions that a certificate is about, one after the other; their curves are computed when asked for.

    Attributes:
        motions: The motions, and whether each is run backwards.
    """

    motions: tuple[tuple[ProvedMotion, bool], ...]

    @property
    def reversed(self) -> Subject:
        """The subject backwards."""
        return Subject(tuple((motion, not backwards) for motion, backwards in self.motions[::-1]))

    @cached_property
    def curve(self) -> ClearanceCurve:
        """Clearance over the time of all motions."""
        found, begin = [], 0.0
        for motion, backwards in self.motions:
            curve = _backwards(motion.curve) if backwards else motion.curve
            found.append(replace(curve, time=begin + curve.time))
            begin += motion.trajectory.duration
        return _one_after_the_other(found)

    @cached_property
    def pushes(self) -> tuple[Push, ...]:
        """What gives way, by the time of all motions."""
        found, begin = list[Push](), 0.0
        for motion, backwards in self.motions:
            duration = motion.trajectory.duration
            for push in motion.pushes:
                span = (duration - push.end_s, duration - push.begin_s) if backwards else (push.begin_s, push.end_s)
                found.append(replace(push, begin_s=begin + span[0], end_s=begin + span[1]))
            begin += duration
        return joined(found)


def joined_subjects(parts: Iterable[Subject | None]) -> Subject | None:
    """The motions of several certificates one after the other; None where one of them does not say which they are."""
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
    """One curve of several; where one begins as another ends, the lower values of both hold."""
    names = dict.fromkeys(pair for curve in curves for pair in curve.pairs)
    numbers = {pair: number for number, pair in enumerate(names)}
    time, clearance, distance = (
        np.concatenate([getattr(curve, name) for curve in curves]) for name in ("time", "clearance_m", "distance_m")
    )
    nearest = np.concatenate(
        [np.array([*(numbers[pair] for pair in curve.pairs), -1], dtype=np.int64)[curve.nearest] for curve in curves]
    )
    # Of stations at one time the nearest comes first.
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
    """The curve of one stretch; its times are places counted in rows of the stretch."""
    deviations, proof = stretch.deviations, stretch.proof
    checker = stretch.checker.covering(float(deviations.max()), clearance)
    if not checker.pairs:
        nothing = np.full(2, np.inf)
        return ClearanceCurve(np.array([0.0, float(len(bezier))]), nothing, nothing, np.full(2, -1), ())
    search = Advancement(bezier, checker, deviations, clearance, stretch.clock)
    looks = list(_looks(search, bezier, checker, checker.counted(clearance)))
    places, nearest = np.array([look.place for look in looks]), np.array([look.nearest for look in looks])
    bounds = _lower_of_both(np.array([look.bound_m for look in looks[1:]]))
    if proof.shown:
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
    """A station: its place, the nearest pair and its distance, and the bound since the station before [m]."""

    place: float
    nearest: int
    distance_m: float
    bound_m: float


class _Stations:
    """Where to look next."""

    def __init__(self, travel: FloatArray, bounded: int) -> None:
        """Take what the moving bodies travel up to each row, (bodies, rows + 1) [m]; it is bounded up to a row."""
        self._travel = np.append(0.0, np.cumsum(np.diff(travel, axis=1).max(axis=0)))
        self._bounded = bounded
        # Most stations of a stretch, about.
        self._least = max(_STATION_M[0], float(self._travel[bounded]) / 20_000)

    def after(self, place: float, nearest: float) -> float:
        """The station after a place at which the nearest pair is at a distance [m]."""
        step = max(min(_STATION_FRACTION * nearest, _STATION_M[1]), self._least)
        following: float = place_after(self._travel, place, step)
        if following > self._bounded:  # from there on row by row
            following = max(float(self._bounded), np.floor(place) + 1.0)
        return max(min(following, len(self._travel) - 1.0), math.nextafter(place, math.inf))


def _looks(search: Advancement, bezier: FloatArray, checker: CoalScene, counted: FloatArray) -> Iterator[_Look]:
    """Go through a stretch from station to station.

    Of each pair a lower bound of its distance is kept: coal's last one, less what its moving body has travelled since.
    """
    sway, travel = search.movers
    mover_of, errors, end = search.mover_of, checker.distance_errors, float(len(bezier))
    stations = _Stations(travel, search.bounded)
    place, pair, bound = 0.0, 0, np.inf
    lower = np.full(len(mover_of), -np.inf)
    travelled, swayed = travel[:, 0], sway[:, 0]
    # Part of a distance by which coal's may be too large far away.
    far_error = 1e-3
    while True:
        search.place(point_at(bezier, place), place)
        nearest = float(checker.distances_of(np.array([pair]))[0] + counted[pair])
        now, sways = _at(travel, place), _at(sway, place)
        forward = lower - (now - travelled)[mover_of]
        # All that may be nearer than this one before the next station; there may be such that bring that nearer.
        ahead = _at(travel, stations.after(place, nearest))
        asked = np.flatnonzero(forward - (ahead - now)[mover_of] < nearest)
        if len(asked):
            distances = checker.distances_of(asked) + counted[asked]
            pair = int(asked[ties.argmin(distances)])
            nearest = float(distances.min())
            least = distances * (1.0 - far_error * np.sign(distances)) - errors[asked]
            known = forward.copy()
            known[asked] = np.maximum(forward[asked], least)
        else:
            known = forward
        if place > 0.0:
            between = 0.5 * (forward + known) - np.maximum(swayed, sways)[mover_of]
            bound = float(between.min()) if place <= search.bounded else -np.inf
        yield _Look(place, pair if nearest < np.inf else -1, nearest, bound)
        if place >= end:
            return
        lower, travelled, swayed, place = known, now, sways, stations.after(place, nearest)


def _at(values: FloatArray, place: float) -> FloatArray:
    """(bodies,) values at a place of what is linear between its values at the rows, (bodies, rows + 1)."""
    row = min(int(place), values.shape[1] - 2)
    result: FloatArray = values[:, row] + (place - row) * (values[:, row + 1] - values[:, row])
    return result


def _lower_of_both(bounds: FloatArray) -> FloatArray:
    """(n,) at each station the lower one of the bounds before and after it, (n - 1,)."""
    lower: FloatArray = np.minimum(np.append(bounds[0], bounds), np.append(bounds, bounds[-1]))
    return lower


def _on_lines(clock: FloatArray, time: FloatArray, values: FloatArray) -> FloatArray:
    """Values at times, on straight lines between the values at others; those may be infinite."""
    # Stands for an infinite clearance where lines are drawn [m].
    far_m = 1e12
    lines: FloatArray = np.interp(clock, time, np.clip(values, -far_m, far_m))
    lines[np.abs(lines) > 1e-3 * far_m] *= np.inf
    return lines
