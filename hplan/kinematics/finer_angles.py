"""Finer approach angles about those that come nearest to being clear, where none of the evenly spaced ones is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.errors import UnreachableError
from hplan.kinematics.approach_angles import Candidates

#: Angles are refined by this factor at a time until they are this near to one another [rad].
_FACTOR, FINEST = 4, np.radians(0.05)

#: So many angles are refined at a time, those with the largest clearance.
_BEST = 8

#: An angle is refined where the clearance that is missing may come within one spacing, at this rate [m / rad].
_RATE = 2.0

#: Continua of configurations that may have the same approach angle: two yaws, two sides of the elbow.
_CONTINUA = 4

_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Refined:
    """Result of a search at finer approach angles.

    Attributes:
        candidates: Configurations with enough clearance; None where there are none.
        tried: Configurations that were tried, the evenly spaced ones not among them.
        best_m: Largest clearance of all that were tried, the evenly spaced ones among them [m].
    """

    candidates: Candidates | None
    tried: int
    best_m: float


def refined(
    evenly: Candidates,
    within: Callable[[tuple[float, float], int], Candidates],
    clearance: Callable[[FloatArray], float],
    enough: float,
    approach_deg: float | tuple[float, float] | None = None,
) -> Refined:
    """Configurations at finer approach angles, about those of the evenly spaced ones with the largest clearance.

    Args:
        evenly: The evenly spaced ones, none with enough clearance.
        within: About so many configurations within an interval of approach angles [deg]; `UnreachableError` where
            there is none.
        clearance: Clearance of a (dof,) configuration [m].
        enough: Clearance that is enough [m].
        approach_deg: Approach angle or interval that is asked for; None for all [deg].
    """
    angles = evenly.approach
    clearances = np.array([clearance(q) for q in evenly.configurations])
    best, tried = float(clearances.max()), 0
    is_interval = isinstance(approach_deg, tuple) and approach_deg[0] < approach_deg[1]
    spacing = _spacing(angles) if approach_deg is None or is_interval else 0.0
    while spacing > FINEST:
        finer, seen = list[Candidates](), list[FloatArray]()
        for angle in _worth_refining(angles, clearances, enough, spacing):
            interval = _clipped(angle, spacing, approach_deg if isinstance(approach_deg, tuple) else None)
            try:
                found = within(interval, 2 * _FACTOR * _CONTINUA)
            except UnreachableError:
                continue  # only an end of a continuum, or a joint's limit, in between
            finer.append(found)
            seen.append(np.array([clearance(q) for q in found.configurations]))
        if not finer:
            break
        angles, clearances = np.concatenate([found.approach for found in finer]), np.concatenate(seen)
        tried, best = tried + len(angles), max(best, float(clearances.max()))
        if best > enough:
            clear = clearances > enough
            every, angles = np.concatenate([found.configurations for found in finer])[clear], angles[clear]
            _, first = np.unique(np.round(every, 7), axis=0, return_index=True)  # intervals may overlap
            return Refined(Candidates(every[first], angles[first]), tried, best)
        spacing /= _FACTOR
    return Refined(None, tried, best)


def _spacing(angles: FloatArray) -> float:
    """Largest distance between neighbouring angles of a continuum, as far as it can be found without knowing which is.

    Of two continua at the same angles each may have every other.
    """
    gaps = np.diff(np.unique(np.round(angles, 9)))
    # Largest spacing that is begun with [rad].
    widest = np.radians(10.0)
    return float(min(widest, _CONTINUA * gaps.max(initial=0.0)))


def _worth_refining(angles: FloatArray, clearances: FloatArray, enough: float, spacing: float) -> list[float]:
    """The angles to refine: the best that are not within a spacing of a better one."""
    kept: list[float] = []
    for which in np.argsort(-np.round(clearances, 9), kind="stable").tolist():
        if len(kept) == _BEST or clearances[which] + _RATE * spacing < enough:
            break
        away = (np.array(kept) - angles[which] + np.pi) % _TURN - np.pi
        if not (np.abs(away) < spacing).any():
            kept.append(float(angles[which]))
    return kept


def _clipped(angle: float, spacing: float, approach_deg: tuple[float, float] | None) -> tuple[float, float]:
    """The interval of a spacing to either side of an angle, within what is asked for [deg]."""
    low, high = np.degrees([angle - spacing, angle + spacing]).tolist()
    if approach_deg is None:
        return low, high
    first, last = approach_deg
    if last - first >= 360.0:
        return low, high
    middle = float(np.degrees(angle))
    middle += 360.0 * np.ceil((first - middle) / 360.0 - 1e-9)  # as it is counted there
    turn = middle - np.degrees(angle)
    return max(first, low + turn), min(last, high + turn)
