r"""What is carried along by a pushed limb, and pressed against something else.

A contact that displaces a limb at x by :math:`\delta` along the normal n displaces a point y of it, or of a limb on the
same clamp, by :math:`u = C_{yx} n \delta / (n^\top C_{xx} n)`. The compliance is positive semidefinite, so
(Cauchy and Schwarz)

.. math:: |u| \le r \delta, \qquad r = \sqrt{\lambda_{max}(C_{yy}) / (n^\top C_{xx} n)}.

Beyond x a limb moves as a rigid body: with the deflection per rotation :math:`\rho` of `hplan.scene.limb_parts`,
:math:`|u|` is also at most :math:`\delta (r_x + |y - x| / \rho)`.

An obstacle with the stiffness k behind a gap g at y acts at x as one with the stiffness :math:`r^2 k` behind
:math:`g / r`: the limb gives way in between, which only lessens the force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.scene.limb_parts import TINY, Pushables
from hplan.scene.limbs import Limbs
from hplan.scene.wood import MOST_ROTATION


class Carried(NamedTuple):
    """Parts of limbs and fruit that pushed ones carry along.

    Attributes:
        pushed: (m,) number of the pushed part of a limb.
        item: (m,) number of what it carries along.
        ratio: (m,) upper bound of the item's displacement per deflection.
    """

    pushed: IntArray
    item: IntArray
    ratio: FloatArray


def carried_along(pushables: Pushables, items: Pushables, limbs: Limbs) -> Carried:
    """Items on the same limbs as pushed parts, with the ratio of their displacements.

    Args:
        pushables: Parts of limbs that are pushed.
        items: Parts of limbs, or fruit on them.
        limbs: All limbs.
    """
    roots, found = limbs.roots(), list[Carried]()
    stiffness = 1.0 / np.maximum(_smallest_across(pushables, limbs), TINY)
    own, moved = _largest(pushables, limbs), _largest(items, limbs)
    per_rotation = np.maximum(pushables.depth / MOST_ROTATION, TINY)
    for segment in np.unique(pushables.segment).tolist():
        rows, others = (
            np.flatnonzero(pushables.segment == segment),
            np.flatnonzero(roots[items.segment] == roots[segment]),
        )
        if roots[segment] < 0:
            continue
        pushed, item = np.repeat(rows, len(others)), np.tile(others, len(rows))
        ratio = np.sqrt(moved[item] * stiffness[pushed])
        on, x = items.segment[item], pushables.along[pushed]
        lever = np.maximum(
            *(np.linalg.norm(end[item] - pushables.start[pushed], axis=1) for end in (items.start, items.end))
        )
        beyond = (on == segment) & (items.along[item, 0] >= x[:, 1])
        for other in np.unique(on).tolist():
            path = limbs.path(other)
            if other != segment and segment in path:
                child = path[path.index(segment) - 1]
                grows_at = float((limbs.joint[child] - limbs.start[segment]) @ limbs.axis[segment])
                beyond |= (on == other) & (grows_at >= x[:, 1])
        turned = np.sqrt(own[pushed] * stiffness[pushed]) + lever / per_rotation[pushed]
        ratio = np.where(beyond, np.minimum(ratio, turned), ratio)
        is_other = (on != segment) | (np.abs(items.along[item] - x).max(axis=1) > 0.0)
        found.append(Carried(pushed[is_other], item[is_other], ratio[is_other]))
    if not found:
        return Carried(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))
    return Carried(*(np.concatenate(columns) for columns in zip(*found, strict=True)))


def _largest(items: Pushables, limbs: Limbs) -> FloatArray:
    """(k,) largest eigenvalue of the compliance of parts, for 1 Pa; a convex function along a segment [m/N]."""
    if not len(items.names):
        return np.zeros(0)
    ends = np.stack([limbs.compliance_along(items.segment, items.along[:, end])[0] for end in (0, 1)])
    found: FloatArray = np.linalg.eigvalsh(ends)[..., -1].max(axis=0)
    return found


def _smallest_across(parts: Pushables, limbs: Limbs) -> FloatArray:
    """(k,) lower bound of the compliance of parts for all directions across them, for 1 Pa [m/N]."""
    if not len(parts.names):
        return np.zeros(0)
    axis = parts.stiff_axis
    low, high = (limbs.compliance_along(parts.segment, parts.along[:, end])[:2] for end in (0, 1))
    half = 0.5 * np.ptp(parts.along, axis=1)[:, None, None]
    flat = np.eye(3) - axis[:, :, None] * axis[:, None]
    # Up to the middle the tangent at the nearer end is a lower bound, whose smallest eigenvalue is concave.
    bounds = flat @ np.stack([low[0], low[0] + half * low[1], high[0] - half * high[1], high[0]]) @ flat
    found: FloatArray = np.linalg.eigvalsh(bounds)[..., 1].min(axis=0)  # the first one is that of the axis, 0
    return found
