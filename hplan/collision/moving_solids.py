"""Obstacles that move, for a collision checker: where they are at a time, and how far any point of them travels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from hplan.base.arrays import BoolArray, FloatArray, Record, frozen
from hplan.collision.coal_shapes import solid_shape
from hplan.scene.obstacles import Solid
from hplan.scene.solids import Cloud
from hplan.scene.tracks import Movement

#: What turns no axis away from the vertical by more than this keeps heights.
_UPRIGHT = 1e-12


@dataclass(frozen=True, eq=False)
class MovingSolids(Record):
    """Obstacles, some of which move.

    Attributes:
        solids: All obstacles, where the scene lists them.
        movements: How each of them moves; None for one that stands still.
    """

    solids: tuple[Solid, ...]
    movements: tuple[Movement | None, ...]

    @classmethod
    def of(cls, solids: Sequence[Solid], movements: Sequence[Movement | None]) -> MovingSolids | None:
        """The obstacles with their movements; None where none of them moves."""
        if all(movement is None for movement in movements):
            return None
        return cls(tuple(solids), tuple(movements))

    @cached_property
    def numbers(self) -> tuple[int, ...]:
        """Which of the obstacles move."""
        return tuple(number for number, movement in enumerate(self.movements) if movement is not None)

    @cached_property
    def _distinct(self) -> tuple[tuple[Movement, tuple[tuple[int, pin.SE3], ...]], ...]:
        """The movements, each with the obstacles that move by it and where these are listed."""
        found: dict[int, tuple[Movement, list[tuple[int, pin.SE3]]]] = {}
        for number, (solid, movement) in enumerate(zip(self.solids, self.movements, strict=True)):
            if movement is not None:
                listed = pin.SE3.Identity() if isinstance(solid, Cloud) else solid_shape(solid).placement
                found.setdefault(id(movement), (movement, []))[1].append((number, listed))
        return tuple((movement, tuple(listed)) for movement, listed in found.values())

    @cached_property
    def breaks(self) -> FloatArray:
        """(m,) times at which speeds may change [s]; before the first and after the last nothing moves."""
        return frozen(np.unique(np.concatenate([movement.breaks for movement, _ in self._distinct])))

    def places(self, time_s: float) -> list[tuple[int, pin.SE3]]:
        """Number and place of each obstacle that moves, as coal takes it, at a time [s]."""
        found = []
        for movement, listed in self._distinct:
            rotation, shift = movement.at(np.array([time_s]))
            pose = pin.SE3(rotation[0], shift[0])
            found += [(number, pose * place) for number, place in listed]
        return found

    def travels(self, clock: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far any point of the obstacles travels at most between times, at each interval's largest speed.

        Args:
            clock: (n + 1,) times that do not decrease [s].

        Returns:
            (groups, n) largest speed within each interval times its length [m], and (obstacles,) the group of each, -1
            for one that stands still.
        """
        rows: dict[bytes, int] = {}
        found: list[FloatArray] = []
        group_of = np.full(len(self.solids), -1)
        for number in self.numbers:
            movement, solid = self.movements[number], self.solids[number]
            if movement is not None:
                travel = largest_rates(movement.breaks, movement.rates(solid.core, solid.rounding), clock)
                travel *= np.diff(clock)
                group = rows.setdefault(travel.tobytes(), len(rows))
                group_of[number] = group
                if group == len(found):
                    found.append(travel)
        return np.array(found), frozen(group_of)

    def keep_below(self, below: BoolArray, height: float) -> BoolArray:
        """(obstacles,) mask of those that stay below a height, from that of those that are there where they are listed.

        Of those that move only such as keep upright are.
        """
        kept = below.copy()
        for number in self.numbers:
            movement, solid = self.movements[number], self.solids[number]
            if movement is not None and below[number]:
                rotations, shifts = movement.at(movement.breaks)
                upright = all((np.abs(part.turns[:, :2]) <= _UPRIGHT).all() for part in (movement.own, movement.base))
                upright &= bool((np.abs(rotations[:, 2, 2] - 1.0) <= _UPRIGHT).all())
                top = float(solid.core[:, 2].max()) + solid.rounding + float(shifts[:, 2].max())
                kept[number] = upright and top <= height
        return kept


def largest_rates(breaks: FloatArray, rates: FloatArray, clock: FloatArray) -> FloatArray:
    """Largest value within each interval of a function that is constant between its breaks, and 0 outside them.

    Args:
        breaks: (m,) increasing places.
        rates: (m - 1,) values between them, none negative.
        clock: (n + 1,) ends of the intervals, not decreasing.

    Returns:
        (n,) values; of an interval without length that of the two parts that meet there.
    """
    # Parts 0 and m are before the first and after the last break.
    padded = np.concatenate([[0.0], rates, [0.0]])
    first = np.searchsorted(breaks, clock[:-1], side="left")
    last = np.searchsorted(breaks, clock[1:], side="right")
    found = np.array([padded[low : high + 1].max() for low, high in zip(first.tolist(), last.tolist(), strict=True)])
    return found.astype(np.float64)
