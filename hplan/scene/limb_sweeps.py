r"""What is carried along by a pushed limb, and pressed against something else.

A contact of the force f that displaces a limb at x by :math:`\delta` along the normal n displaces a point y of it, or
of a limb on the same clamp, by :math:`u = C_{yx} n f`, with :math:`\delta = f\, n^\top C_{xx} n`. The compliance is
positive semidefinite, so (Cauchy and Schwarz) :math:`|u|^2 \le \lambda_{max}(C_{yy}) f \delta`. A part of the depth d
that is extended by :math:`l d` in the direction s is deflected by :math:`\delta \le d (1 - l |n \cdot s|)`
(`hplan.scene.limb_parts`), so that, whatever the normal,

.. math:: |u| \le r d, \qquad r = \sqrt{\lambda_{max}(C_{yy}) k}, \qquad k C_{xx} + w s s^\top \succeq I,

with :math:`w = \max(l, l^2)`: then :math:`\delta / d \le 1 - w (n \cdot s)^2`, or no contact has this normal. So k is
the maximum force per depth.

Beyond x a limb moves as a rigid body: with the rotation per deflection :math:`\theta`, bounded likewise,
:math:`|u|` is also at most :math:`d (r_x + |y - x| \theta)`.

An obstacle with the stiffness k behind a gap g at y acts at x as one with the stiffness :math:`r^2 k` behind
:math:`g / r`: the limb yields in between, which only lessens the force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.scene.limb_parts import TINY, Pushables, lateral_depth
from hplan.scene.limbs import Limbs
from hplan.scene.wood import MOST_ROTATION, Wood, limits_by_segment


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


def carried_along(pushables: Pushables, stiffness: FloatArray, items: Pushables, limbs: Limbs, wood: Wood) -> Carried:
    """Items on the same limbs as pushed parts, with the ratio of their displacements.

    Args:
        pushables: Parts of limbs that are pushed.
        stiffness: (k,) their maximum force per depth [N/m].
        items: Parts of limbs, or fruit on them.
        limbs: All limbs.
        wood: Young's modulus.
    """
    roots, found = limbs.roots(), list[Carried]()
    of_one = stiffness / limits_by_segment(limbs, wood).stiffest[pushables.segment]  # for 1 Pa
    own, moved = _largest(pushables, limbs), _largest(items, limbs)
    # Its square is the compliance across the part times that of rotation: `parts_between`.
    across = lateral_depth(pushables) / np.maximum(pushables.force, TINY)
    rotation = np.sqrt(across * stiffness) * MOST_ROTATION / np.maximum(pushables.depth, TINY)
    for segment in np.unique(pushables.segment).tolist():
        rows, others = (
            np.flatnonzero(pushables.segment == segment),
            np.flatnonzero(roots[items.segment] == roots[segment]),
        )
        if roots[segment] < 0:
            continue
        pushed, item = np.repeat(rows, len(others)), np.tile(others, len(rows))
        ratio = np.sqrt(moved[item] * of_one[pushed])
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
        turned = np.sqrt(own[pushed] * of_one[pushed]) + lever * rotation[pushed]
        ratio = np.where(beyond, np.minimum(ratio, turned), ratio)
        found.append(Carried(pushed, item, ratio))
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
