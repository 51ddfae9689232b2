r"""Neighbouring links that can fold into one another, and the joint angles at which they do.

Two neighbours overlap about the joint that they share, and that is their own. Let :math:`R` be the distance that their
axes have to keep: both half-widths and the clearance. What of a link is farther than :math:`D = 3 R` from the joint
must keep that distance from the whole of the other link. At an angle :math:`\alpha` between them, 0 where they are
folded flat, the nearest point of such a part is the one at the distance :math:`D` from the joint, and it is

.. math:: D \sin \alpha \quad (D \cos \alpha \le L), \qquad
    \sqrt{D^2 + L^2 - 2 D L \cos \alpha} \quad \text{beyond the end of the other link}

away from the other link of length :math:`L`, in the arm plane; both grow with :math:`\alpha`. Where the links lie
beside each other at a distance :math:`a`, the distance to keep in the plane is :math:`\sqrt{R^2 - a^2}`. So what is
blocked is an interval of the joint angle about the fold, of half-width :math:`\arcsin(1 / 3)`, 19.5 degrees, or less
where a link is short.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from hplan.robot.planar_family import PlanarArm

_TURN: Final = 2.0 * math.pi


@dataclass(frozen=True)
class Fold:
    """Two neighbours that can fold into one another.

    Attributes:
        inner: The one nearer to the base; the other one is `inner + 1`.
        own_reach: Distance from their joint up to which they may overlap [m].
        trims: Which of them reach farther than that: `inner`, `inner + 1` or both.
    """

    inner: int
    own_reach: float
    trims: tuple[int, ...]


def folds(arm: PlanarArm, clearance: float, slack: float) -> tuple[Fold, ...]:
    """The neighbours that can fold into one another.

    Args:
        arm: The planar chain, between whose limits its joints turn.
        clearance: Distance that links keep from one another [m].
        slack: Distance up to which they count as touching, beyond the clearance [m].
    """
    found = []
    # Neighbours may overlap up to this many times the distance to keep from their joint: a link ends in a cap as wide
    # as it is thick, and links that meet at an angle overlap up to 1 / sin(angle) times their half-widths. 3 leaves
    # them all angles down to 19.5 degrees between the two.
    fold_reach = 3.0
    for inner in range(arm.link_count - 1):
        radius = float(arm.half_widths[inner] + arm.half_widths[inner + 1]) + clearance
        reach = fold_reach * radius
        trims = tuple(link for link in (inner, inner + 1) if arm.lengths[link] > reach)
        fold = Fold(inner, reach, trims)
        if trims and folded_angles(arm, fold, radius + slack):
            found.append(fold)
    return tuple(found)


def folded_angles(arm: PlanarArm, fold: Fold, radius: float) -> list[tuple[float, float]]:
    """Intervals of the joint angle at which two neighbours are nearer than a radius, those that limits cut.

    Args:
        arm: The planar chain; its limits are those that count.
        radius: Distance of their axes [m].
    """
    joint = fold.inner + 1
    apart = float(arm.lateral[joint] - arm.lateral[fold.inner])
    if radius <= abs(apart):
        return []
    # Seen along the plane's normal, they are nearer to each other than the radius by what they lie beside each other.
    radius = math.sqrt(radius * radius - apart * apart) if apart else radius
    # Where both reach beyond the joint's own region, either is long enough to give the same angle.
    half = _half_angle(fold.own_reach, float(arm.lengths[_other(fold, fold.trims[0])]), radius)
    if half < 0.0:
        return []
    # The outer link lies on the inner one where it is turned by half a turn.
    middle = float(arm.signs[joint] * (math.pi - arm.offsets[joint]))
    low, high = float(arm.lower[joint]), float(arm.upper[joint])
    first, last = math.ceil((low - half - middle) / _TURN), math.floor((high + half - middle) / _TURN)
    return [(middle + _TURN * k - half, middle + _TURN * k + half) for k in range(first, last + 1)]


def _other(fold: Fold, link: int) -> int:
    return fold.inner if link != fold.inner else fold.inner + 1


def _half_angle(reach: float, length: float, radius: float) -> float:
    """Largest angle at which a point at `reach` from the joint is within `radius` of a link; -1 where there is none."""
    if radius >= reach:
        return math.pi
    if reach > length + radius:
        return -1.0
    if reach * reach <= length * length + radius * radius:
        return math.asin(radius / reach)
    cosine = (length * length + reach * reach - radius * radius) / (2.0 * length * reach)
    return math.acos(min(1.0, max(-1.0, cosine)))
