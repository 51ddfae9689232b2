"""Moving obstacles of a collision checker: their poses and their travel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray, Record, frozen
from hplan.collision.coal_shapes import solid_shape
from hplan.geometry.cloud import Cloud
from hplan.scene.obstacles import Solid
from hplan.scene.tracks import Movement


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
        return tuple(number for number, movement in enumerate(self.movements) if movement is not None)

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

    def places(self, time_s: float) -> list[tuple[int, pin.SE3]]:
        """Index and coal pose of each moving obstacle at a time [s]."""
        found = []
        for movement, listed in self._distinct:
            rotation, shift = movement.displacement_at(np.array([time_s]))
            pose = pin.SE3(rotation[0], shift[0])
            found += [(number, pose * place) for number, place in listed]
        return found

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
        for number in self.numbers:
            movement, solid = self.movements[number], self.solids[number]
            if movement is not None:
                travel = largest_interval_rates(movement.breaks, movement.rates(solid.core, solid.rounding), clock)
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
    # Pieces 0 and m are before the first and after the last break.
    padded = np.concatenate([[0.0], rates, [0.0]])
    first = np.searchsorted(breaks, clock[:-1], side="left")
    last = np.searchsorted(breaks, clock[1:], side="right")
    found = np.array([padded[low : high + 1].max() for low, high in zip(first.tolist(), last.tolist(), strict=True)])
    return found.astype(np.float64)
