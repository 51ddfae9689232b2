"""Moving obstacles of a collision checker: their poses and their travel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, IntArray, Record, frozen
from hplan.base.kernels import kernel
from hplan.collision.coal_shapes import solid_shape
from hplan.geometry.cloud import Cloud
from hplan.scene.obstacles import Solid
from hplan.scene.tracks import Movement, Poses


class _Routes(NamedTuple):
    """Poses of several bodies over time, one after the other, as in `hplan.scene.tracks.Poses`.

    Attributes:
        ends: (bodies + 1,) index of the first pose of each body, and the number of poses.
        times: (n,) times [s].
        shifts: (n, 3) shifts [m].
        rotations: (n, 3, 3) rotations.
        turns: (n, 3) rotation vector to the next rotation of the same body [rad]; zeros for its last.
        about: (bodies, 3) centres of rotation before the shift [m].
    """

    ends: IntArray
    times: FloatArray
    shifts: FloatArray
    rotations: FloatArray
    turns: FloatArray
    about: FloatArray

    @classmethod
    def join(cls, bodies: Sequence[Poses]) -> _Routes:
        """The poses of some bodies."""
        turns = [np.vstack([body.turns, np.zeros((1, 3))]) for body in bodies]
        return cls(
            np.cumsum([0, *(len(body.times) for body in bodies)]),
            np.concatenate([body.times for body in bodies], dtype=np.float64),
            np.concatenate([body.shifts for body in bodies], dtype=np.float64),
            np.concatenate([body.rotations for body in bodies], dtype=np.float64),
            np.concatenate(turns),
            np.stack([body.about for body in bodies]),
        )


@kernel
def _pose_at(time_s: float, route: _Routes, body: int, rotation: FloatArray, place: FloatArray) -> None:
    """Write rotation and centre of rotation of a body at a time, as `hplan.scene.tracks.Poses.poses_at`."""
    first, end = route.ends[body], route.ends[body + 1]
    k = first
    while k < end - 2 and time_s >= route.times[k + 1]:
        k += 1
    span = route.times[k + 1] - route.times[k]
    part = min(1.0, max(0.0, (time_s - route.times[k]) / (span if span > 0.0 else 1.0)))
    for c in range(3):
        place[c] = route.about[body, c] + route.shifts[k, c] + part * (route.shifts[k + 1, c] - route.shifts[k, c])
    x, y, z = part * route.turns[k, 0], part * route.turns[k, 1], part * route.turns[k, 2]
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        for r in range(3):
            for c in range(3):
                rotation[r, c] = route.rotations[k, r, c]
        return
    x, y, z = x / angle, y / angle, z / angle
    cos, sin = math.cos(angle), math.sin(angle)
    rest = 1.0 - cos
    for r in range(3):
        a, b, c = route.rotations[k, r, 0], route.rotations[k, r, 1], route.rotations[k, r, 2]
        rotation[r, 0] = a * (cos + x * x * rest) + b * (y * x * rest + z * sin) + c * (z * x * rest - y * sin)
        rotation[r, 1] = a * (x * y * rest - z * sin) + b * (cos + y * y * rest) + c * (z * y * rest + x * sin)
        rotation[r, 2] = a * (x * z * rest + y * sin) + b * (y * z * rest - x * sin) + c * (cos + z * z * rest)


@kernel
def _place_routes(time_s: float, own: _Routes, base: _Routes, rotations: FloatArray, shifts: FloatArray) -> None:
    """Write rotations and shifts of bodies relative to the base, as `Movement.displacement_at`."""
    turned, seen, place, pivot, shift = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    for body in range(len(rotations)):
        _pose_at(time_s, own, body, turned, place)
        _pose_at(time_s, base, body, seen, pivot)
        for r in range(3):
            shift[r] = place[r] - pivot[r]
            for c in range(3):
                shift[r] -= turned[r, c] * own.about[body, c]
        for r in range(3):
            shifts[body, r] = base.about[body, r]
            for c in range(3):
                shifts[body, r] += seen[c, r] * shift[c]
                rotations[body, r, c] = 0.0
                for m in range(3):
                    rotations[body, r, c] += seen[m, r] * turned[m, c]


@dataclass(frozen=True, eq=False)
class MovingSolids(Record):
    """All obstacles of a scene and their movements.

    Attributes:
        solids: All obstacles at their listed poses.
        movements: Movement of each obstacle; None for a static one.
    """

    solids: tuple[Solid, ...]
    movements: tuple[Movement | None, ...]

    @classmethod
    def combine(cls, solids: Sequence[Solid], movements: Sequence[Movement | None]) -> MovingSolids | None:
        """Combine obstacles and movements; None if all obstacles are static."""
        if all(movement is None for movement in movements):
            return None
        return cls(tuple(solids), tuple(movements))

    @cached_property
    def numbers(self) -> tuple[int, ...]:
        """Indices of the moving obstacles."""
        return tuple(number for number, _ in self._moving)

    @cached_property
    def _moving(self) -> tuple[tuple[int, Movement], ...]:
        """The moving obstacles, by index, with their movements."""
        return tuple((number, how) for number, how in enumerate(self.movements) if how is not None)

    @cached_property
    def _distinct(self) -> tuple[tuple[Movement, tuple[tuple[int, pin.SE3], ...]], ...]:
        """The distinct movements, each with its obstacles and their listed poses."""
        found: dict[int, tuple[Movement, list[tuple[int, pin.SE3]]]] = {}
        for number, (solid, movement) in enumerate(zip(self.solids, self.movements, strict=True)):
            if movement is not None:
                listed = pin.SE3.Identity() if isinstance(solid, Cloud) else solid_shape(solid).placement
                found.setdefault(id(movement), (movement, []))[1].append((number, listed))
        return tuple((movement, tuple(listed)) for movement, listed in found.values())

    @cached_property
    def breaks(self) -> FloatArray:
        """(m,) times of possible speed changes [s]; obstacles rest outside them."""
        return frozen(np.unique(np.concatenate([movement.breaks for movement, _ in self._distinct])))

    @cached_property
    def _routes(self) -> tuple[_Routes, ...]:
        """The distinct movements for kernels: those of the obstacles, then those of the base."""
        return tuple(
            _Routes.join([getattr(movement, part) for movement, _ in self._distinct]) for part in ("own", "base")
        )

    def _displacements(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Rotations and shifts of the distinct movements at a time, as `Movement.displacement_at`."""
        (own, base), count = self._routes, len(self._distinct)
        rotations, shifts = np.empty((count, 3, 3)), np.empty((count, 3))
        _place_routes(time_s, own, base, rotations, shifts)
        return rotations, shifts

    def places(self, time_s: float) -> list[tuple[int, pin.SE3]]:
        """Index and coal pose of each moving obstacle at a time [s]."""
        found = []
        for (_, listed), rotation, shift in zip(self._distinct, *self._displacements(time_s), strict=True):
            pose = pin.SE3(rotation, shift)
            found += [(number, pose * place) for number, place in listed]
        return found

    @cached_property
    def _drifting(self) -> tuple[tuple[int, Movement], ...]:
        """Obstacles that may leave their tracks, with their movements."""
        return tuple((number, how) for number, how in self._moving if how.own.drift is not None)

    @cached_property
    def known_until(self) -> tuple[float, str]:
        """Time until which all obstacles are predicted [s], and the first that is not afterwards; inf if always."""
        times = ((how.known_until_s, self.solids[number].name) for number, how in self._drifting)
        return min(times, default=(math.inf, ""))

    def spreads(self, time_s: float) -> FloatArray | None:
        """(obstacles,) maximum distances of the obstacles from `places` [m]; None if no obstacle has a drift."""
        if not self._drifting:
            return None
        numbers, begins, steps, pieces, table = self._spread_table
        along = np.clip((time_s - begins) / steps, 0.0, pieces)
        rows, k = np.arange(len(numbers)), np.minimum(along.astype(np.int64), pieces - 1)
        before = table[rows, k]
        found = np.zeros(len(self.solids))
        found[numbers] = before + (along - k) * (table[rows, k + 1] - before)
        return found

    @cached_property
    def _spread_table(self) -> tuple[IntArray, FloatArray, FloatArray, IntArray, FloatArray]:
        """Of each obstacle with a drift, number, start and step of its spreads [s], number of pieces, and spreads [m].

        The last is a (drifts, largest number of pieces + 1) table.
        """
        spreads = [movement.own.spreads for _, movement in self._drifting]
        pieces = np.array([len(times) - 1 for times, _ in spreads])
        begins, ends = np.array([(times[0], times[-1]) for times, _ in spreads]).T
        table = np.array([np.pad(values, (0, pieces.max() + 1 - len(values))) for _, values in spreads])
        numbers = np.array([number for number, _ in self._drifting])
        return numbers, begins, (ends - begins) / pieces, pieces, table

    @cached_property
    def rates(self) -> dict[int, FloatArray]:
        """Upper bounds of the moving obstacles' point speeds between the breaks of their movements, by number [m/s]."""
        return {n: how.rates(self.solids[n].core, self.solids[n].rounding) for n, how in self._moving}

    @cached_property
    def travelled(self) -> dict[int, FloatArray]:
        """Upper bounds of the moving obstacles' travel up to the breaks of their movements, by number [m]."""
        return {n: np.concatenate([[0.0], np.cumsum(self.rates[n] * np.diff(how.breaks))]) for n, how in self._moving}

    @cached_property
    def _balls(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Distinct movement, and centre and radius of a ball, of each moving obstacle as listed [m]."""
        which = {number: row for row, (_, listed) in enumerate(self._distinct) for number, _ in listed}
        cores = [self.solids[number].core for number in self.numbers]
        centres = np.array([0.5 * (core.min(axis=0) + core.max(axis=0)) for core in cores])
        pairs = zip(cores, centres, strict=True)
        radii = np.array([np.linalg.norm(core - centre, axis=1).max() for core, centre in pairs])
        radii += [self.solids[number].rounding for number in self.numbers]
        return np.array([which[number] for number in self.numbers]), centres, radii

    def swept_balls(self, begin_s: float, end_s: float) -> tuple[FloatArray, FloatArray]:
        """Balls that each hold a moving obstacle during a time interval [s], drift included.

        Returns:
            (k, 3) centres and (k,) radii, in the order of `numbers` [m].
        """
        which, centres, radii = self._balls
        rotations, shifts = self._displacements(begin_s)
        places: FloatArray = np.einsum("kij,kj->ki", rotations[which], centres) + shifts[which]
        ways = [
            np.subtract(*np.interp((end_s, begin_s), movement.breaks, self.travelled[number]))
            for number, movement in self._moving
        ]
        spreads = self.spreads(begin_s)
        return places, radii + ways + (0.0 if spreads is None else spreads[list(self.numbers)])

    def travels(self, clock: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Upper bound of the obstacles' travel between times, from their maximum speeds.

        Args:
            clock: (n + 1,) non-decreasing times [s].

        Returns:
            (groups, n) maximum speed within each interval times its length [m], and (obstacles,) the group of each
            obstacle, -1 for a static one.
        """
        rows: dict[bytes, int] = {}
        found: list[FloatArray] = []
        group_of = np.full(len(self.solids), -1)
        for number, movement in self._moving:
            travel = largest_interval_rates(movement.breaks, self.rates[number], clock)
            travel *= np.diff(clock)
            group = rows.setdefault(travel.tobytes(), len(rows))
            group_of[number] = group
            if group == len(found):
                found.append(travel)
        return np.array(found), frozen(group_of)


def largest_interval_rates(breaks: FloatArray, rates: FloatArray, clock: FloatArray) -> FloatArray:
    """Maximum of a piecewise constant function within each interval.

    The function is constant between its breaks and 0 outside them.

    Args:
        breaks: (m,) increasing positions.
        rates: (m - 1,) non-negative values between them.
        clock: (n + 1,) non-decreasing ends of the intervals.

    Returns:
        (n,) values; for an interval of zero length the maximum of the two pieces that meet there.
    """
    # Pieces 0 and m are before the first and after the last break; the last value ends the last range.
    padded = np.concatenate([[0.0], rates, [0.0, 0.0]])
    first = np.searchsorted(breaks, clock[:-1], side="left")
    last = np.searchsorted(breaks, clock[1:], side="right")
    found: FloatArray = np.maximum.reduceat(padded, np.column_stack([first, last + 1]).ravel())[::2]
    return found
