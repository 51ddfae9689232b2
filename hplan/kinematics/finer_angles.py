"""Finer approach angles about those that come nearest to being clear, where none of the evenly spaced ones is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hplan.base.arrays import FloatArray, Record
from hplan.kinematics.approach_angles import Candidates, Window

#: Angles are refined by this factor at a time until they are this near to one another [rad].
_FACTOR, FINEST = 4, np.radians(0.05)


@dataclass(frozen=True, eq=False)
class Measured(Record):
    """Configurations with the tool at a point, and how clear they are.

    Attributes:
        candidates: The configurations.
        rooms: (k, moving bodies) clearances, first of their links [m].
    """

    candidates: Candidates
    rooms: FloatArray

    @cached_property
    def least(self) -> FloatArray:
        """(k,) least clearance of any link at each [m]."""
        least: FloatArray = self.rooms.min(axis=1)
        return least

    @property
    def most(self) -> float:
        """The largest of these [m]."""
        return float(self.least.max())


def finer_angles(
    evenly: Measured,
    at: Callable[[FloatArray], Measured | None],
    enough: float,
    lengths: FloatArray,
    approach_deg: float | tuple[float, float] | None = None,
) -> Iterator[Measured]:
    """Configurations at finer and finer approach angles, about those with the largest clearance so far.

    Args:
        evenly: The evenly spaced ones.
        at: All configurations at (j,) approach angles [rad]; None where there is none.
        enough: Clearance that is enough: angles that cannot have it are not refined [m].
        lengths: (links,) of the links: about the tool, no point of the last one moves faster than its length [m / rad].
        approach_deg: Approach angle or interval that is asked for; None for all [deg].
    """
    window = Window.of(approach_deg)
    angles, rooms = evenly.candidates.approach, evenly.rooms
    # An angle is refined where the clearance that is missing may come within one spacing, at this rate [m / rad].
    rate = 2.0
    rates = np.full(rooms.shape[1], rate)
    rates[len(lengths) - 1] = min(rate, float(lengths[-1]))
    spacing = 0.0 if window is not None and window.width == 0.0 else _spacing(angles)
    between = np.arange(1 - _FACTOR, _FACTOR) / _FACTOR
    while spacing > FINEST:
        hopeful = (rooms + rates * spacing >= enough).all(axis=1)
        refined = _apart(angles[hopeful], rooms[hopeful].min(axis=1), spacing)
        tried = np.ravel(np.array(refined)[:, None] + spacing * between[between != 0.0])
        found = at(tried if window is None else tried[window.holds(tried)])
        if found is not None:
            yield found
            angles = np.concatenate([angles, found.candidates.approach])
            rooms = np.concatenate([rooms, found.rooms])
        spacing /= _FACTOR


def _spacing(angles: FloatArray) -> float:
    """Largest distance between neighbouring angles of a continuum, as far as it can be found without knowing which is.

    Of two continua at the same angles each may have every other.
    """
    gaps = np.diff(np.unique(np.round(angles, 9)))
    # Largest spacing that is begun with [rad].
    widest = np.radians(10.0)
    # Continua of configurations that may have the same approach angle: two yaws, two sides of the elbow.
    return float(min(widest, 4 * gaps.max(initial=0.0)))


def _apart(angles: FloatArray, clearances: FloatArray, spacing: float) -> list[float]:
    """The angles to refine: the best that are not within a spacing of a better one."""
    kept: list[float] = []
    for which in np.argsort(-np.round(clearances, 9), kind="stable").tolist():
        away = (np.array(kept) - angles[which] + np.pi) % math.tau - np.pi
        if not (np.abs(away) < spacing).any():
            kept.append(float(angles[which]))
            # So many angles are refined at a time, those with the largest clearance.
            if len(kept) == 8:
                break
    return kept
