r"""Parts of limbs, and hanging fruit, with the compliance and the forces that they permit.

A limb is divided into parts short enough that its compliance hardly changes within one. Each part is a capsule of its
own that pushing links may enter up to a depth; all other links meet the whole segment.

**Depth from force.** A contact with the normal :math:`n` that displaces the limb by :math:`\delta` along :math:`n`
exerts the force :math:`\delta / (n^\top C n)` (`hplan.scene.limbs`). Let the axis :math:`a` of a part be extended by
:math:`l \delta` at both ends. A convex body that is at most :math:`\delta` deep in the extended part is separated from
the limb by a displacement of at most :math:`\delta (1 - l |n \cdot a|)` along some :math:`n`. That factor is at most
:math:`1 - \max(l, l^2) (n \cdot a)^2` or, if this is negative, zero. So the force is at most :math:`F` for every normal
if

.. math:: \delta \le \lambda_{min}(F C + \max(l, l^2)\, \delta\, a a^\top).

So a twig, which is stiff along its axis, is not met head-on; one that bends on a crooked limb is stiffest in another
direction, and is extended farther. For :math:`l \le 1` a body clear of the limb is clear of the smaller part, too,
unless thin links may not use the whole depth; `hplan.certify` then tries rigid limbs, so that limits forbid no motion
that touches nothing. Within a part, the tangent of :math:`C` bounds it from below, and this eigenvalue is concave in
it: the two ends decide.

The depth is that of the shortest way out. A limb that a deeper body takes along on its other side is bent more: in 1 of
4,455 simulated pushes (`scripts/benchmark.py wood_moving`) the stress was 1.3 times its bound, at any speed, where the
axes of body and limb came within 1 % of both radii. So links keep a fifth of both radii
(`hplan.collision.compliant_solids.LIMB_SHARE`).

**Stress.** A force f at x bends the limb at p by at most :math:`f |x - p|`, and the stress in a round section of radius
r is :math:`4 M / (\pi r^3)`; the limit of stress is one of force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.scene.fruit import Fruit
from hplan.scene.limbs import Limbs
from hplan.scene.wood import (
    GRAVITY,
    LARGE_ROTATION_FORCE,
    LEAST_DEPTH_M,
    MOST_ROTATION,
    MOST_SWING,
    STALK_M,
    STATIC_SHARE,
    Wood,
    limits_by_segment,
)

#: Parts are divided until their depth is this share of that at their middle, or down to this length [m].
_EVEN: Final = 0.65
_SHORTEST_M: Final = 0.01

#: Prevents divisions by zero where a limb is clamped.
TINY: Final = 1e-12

#: Largest extension per depth, and number of extensions that are tried.
_MOST_EXTENDED: Final = 1.5
_EXTENSIONS: Final = 25

#: An extension is better than a smaller one if the depth grows by this factor.
_WORTH: Final = 1.01


class Pushables(NamedTuple):
    """Parts of limbs, and fruit, that links may push.

    Attributes:
        names: Names of their obstacles or fruits.
        segment: (k,) limb segment of each, or the one that a fruit hangs from.
        along: (k, 2) first and last point of a part on the axis of its segment; twice the point of a fruit [m].
        start: (k, 3) first end of the axis [m].
        end: (k, 3) last end [m].
        radius: (k,) radius [m].
        stiff_axis: (k, 3) direction in which a push finds no bending.
        compliance: (2, k, 3, 3) lower bounds of the compliance at both ends, for the stiffest wood [m/N].
        force: (k,) maximum force on it [N].
        stress: (k,) largest stress of the limb per force [Pa/N].
        depth: (k,) maximum deflection within which these hold [m].
        swing: (k,) force on a stalk per squared speed of the link [N s^2/m^2]; 0 for limbs.
        mass: (k,) mass of fruit [kg]; 0 for limbs.
    """

    names: tuple[str, ...]
    segment: IntArray
    along: FloatArray
    start: FloatArray
    end: FloatArray
    radius: FloatArray
    stiff_axis: FloatArray
    compliance: FloatArray
    force: FloatArray
    stress: FloatArray
    depth: FloatArray
    swing: FloatArray
    mass: FloatArray

    def at(self, kept: BoolArray | IntArray) -> Pushables:
        """Those of a mask or of some numbers."""
        rows = np.arange(len(self.names))[kept].tolist()
        fields = self._asdict() | {"names": tuple(self.names[row] for row in rows)}
        for name, value in fields.items():
            if name != "names":
                fields[name] = value[:, kept] if name == "compliance" else value[kept]
        return Pushables(**fields)

    def extended(self, extension: FloatArray) -> list[FloatArray]:
        """(2, 3) ends of each axis, extended by (k,) lengths along the stiff axis [m]."""
        along = extension[:, None] * self.stiff_axis
        return list(np.stack([self.start - along, self.end + along], axis=1))


class PermittedContacts(NamedTuple):
    """Permitted depth of each pushable, and what it does.

    Attributes:
        depth: (k,) permitted depth [m].
        cores: (n, 3) points of each [m]: links that push keep clear of their hull, grown by the radius minus the depth.
        force: (k,) static force at that depth [N].
        pressed: (k,) the part of it by neighbours [N].
        stress: (k,) static stress of the limb at that depth [Pa].
        roots: The roots of neighbours' limbs, of each pushable.
        fruits: The names of neighbouring fruit, of each pushable.
    """

    depth: FloatArray
    cores: list[FloatArray]
    force: FloatArray
    pressed: FloatArray
    stress: FloatArray
    roots: list[frozenset[int]]
    fruits: list[frozenset[str]]


def divide_limbs(limbs: Limbs, wood: Wood) -> Pushables:
    """Divide the limb segments that bend into parts of nearly even compliance."""
    numbers = np.flatnonzero(~limbs.clamped)
    if not len(numbers):
        return parts_between(limbs, numbers, np.zeros(0), np.zeros(0), wood)
    low, high = np.zeros(len(numbers)), limbs.length[numbers].copy()
    done = list[Pushables]()
    while len(numbers):
        parts = parts_between(limbs, numbers, low, high, wood)
        middle = parts_between(limbs, numbers, 0.5 * (low + high), 0.5 * (low + high), wood)
        even = np.minimum(lateral_depth(parts), parts.depth), np.minimum(lateral_depth(middle), middle.depth)
        is_even = (even[0] >= _EVEN * even[1]) | (high - low <= 2.0 * _SHORTEST_M) | (even[1] <= 2.0 * LEAST_DEPTH_M)
        done.append(parts.at(is_even))
        left = ~is_even
        numbers, half = np.repeat(numbers[left], 2), 0.5 * (low + high)[left]
        low, high = np.stack([low[left], half], axis=1).ravel(), np.stack([half, high[left]], axis=1).ravel()
    whole = [np.concatenate([getattr(part, key) for part in done], axis=int(key == "compliance")) for key in _ARRAYS]
    found = Pushables(tuple(name for part in done for name in part.names), *whole)
    return found.at(np.lexsort([found.along[:, 0], found.segment]))


_ARRAYS: Final = Pushables._fields[1:]


def parts_between(limbs: Limbs, numbers: IntArray, low: FloatArray, high: FloatArray, wood: Wood) -> Pushables:
    """Parts of segments between points of their axes."""
    axis, middle, limits = limbs.axis[numbers], 0.5 * (low + high), limits_by_segment(limbs, wood)
    stiffest = limits.stiffest[numbers]
    compliance, slope, rotation = limbs.compliance_along(numbers, middle)
    half = 0.5 * (high - low)[:, None, None]
    ends = np.stack([compliance - half * slope, compliance + half * slope]) / stiffest[:, None, None]
    start, end = (limbs.start[numbers] + at[:, None] * axis for at in (low, high))
    stress = np.maximum(*(limbs.stress_per_force(numbers, point) for point in (start, end)))
    share = STATIC_SHARE * np.minimum(limits.force[numbers], limits.stress[numbers] / np.maximum(stress, TINY))
    lateral = smallest_eigenvalue(ends, axis, 1e3 * ends.trace(axis1=2, axis2=3).max(axis=0))
    # The deflection per rotation is at least the root of compliance over rotation per moment (Cauchy and Schwarz).
    per_rotation = np.sqrt(np.maximum(lateral, 0.0) * stiffest / np.maximum(rotation, TINY))
    turned = np.minimum(MOST_ROTATION, share * np.maximum(lateral, 0.0) / np.maximum(per_rotation, TINY))
    share, depth = share / (1.0 + LARGE_ROTATION_FORCE * turned**2), MOST_ROTATION * per_rotation
    return Pushables(
        tuple(limbs.names[number] for number in numbers.tolist()), numbers, np.stack([low, high], axis=1), start, end,
        limbs.radius[numbers], axis, ends, share, stress, depth, *np.zeros((2, len(numbers))),
    )  # fmt: skip


def hanging_fruits(fruits: Sequence[Fruit], limbs: Limbs, wood: Wood) -> Pushables:
    """Fruit as pendulums on the limbs that they hang from.

    A fruit hangs from the nearest limb of its `hangs_from`, or of all, if that is within `STALK_M`. Along its stalk it
    moves with the limb alone; across it, the fruit swings. A link with the speed v throws it ahead with at most 2 v, so
    that its stalk holds 4 m v^2 / l more.
    """
    rows, limits = list[tuple[Any, ...]](), limits_by_segment(limbs, wood)
    for fruit in fruits:
        if not fruit.is_static:
            continue
        hung = limbs.nearest(np.array(fruit.center), fruit.hangs_from)
        if hung is None or hung[2] - fruit.radius - limbs.radius[hung[0]] > STALK_M:
            continue
        segment, along, arm = hung
        if arm < TINY:  # its centre is in the limb: it has no stalk, and stays rigid
            continue
        point = limbs.start[segment] + along * limbs.axis[segment]
        stalk = (np.array(fruit.center) - point) / arm
        weight = GRAVITY * wood.fruit_density * 4.0 / 3.0 * math.pi * fruit.radius**3
        numbers, at = np.array([segment]), np.array([along])
        limb = limbs.compliance_along(numbers, at)[0][0] / float(limits.stiffest[segment])
        swing = arm * math.sqrt(1.0 - MOST_SWING**2) / weight * (np.eye(3) - np.outer(stalk, stalk))
        stress = float(limbs.stress_per_force(numbers, point[None])[0]) if not limbs.clamped[segment] else 0.0
        force = STATIC_SHARE * min(wood.of(fruit.name).fruit_force, float(limits.stress[segment]) / max(stress, 1e-9))
        rows.append((fruit.name, segment, (along, along), fruit.center, fruit.center, fruit.radius, stalk,
                     (limb + swing, limb + swing), force, stress, MOST_SWING * arm,
                     4.0 * weight / GRAVITY / arm, weight / GRAVITY))  # fmt: skip
    if not rows:
        return parts_between(limbs, np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0), wood)
    columns = list(zip(*rows, strict=True))
    arrays = [np.array(column, dtype=np.float64) for column in columns[2:]]
    arrays[5] = arrays[5].swapaxes(0, 1)
    return Pushables(columns[0], np.array(columns[1], dtype=np.int64), *arrays)


def pendulum_stiffness(hanging: Pushables) -> FloatArray:
    """(k,) force per deflection of fruit on their stalks; the secant one at the maximum swing [N/m]."""
    length = hanging.depth / MOST_SWING
    found: FloatArray = GRAVITY * hanging.mass / (length * math.sqrt(1.0 - MOST_SWING**2))
    return found


def depth_and_extension(pushables: Pushables) -> tuple[FloatArray, FloatArray]:
    """Depth by the maximum force, and the extension of the axis that it takes, (k,) each [m]."""
    scaled, axis = pushables.force[:, None, None] * pushables.compliance, pushables.stiff_axis
    alone = lateral_depth(pushables)
    depth, extension = np.zeros(len(alone)), np.zeros(len(alone))
    for share in np.linspace(0.0, _MOST_EXTENDED, _EXTENSIONS):
        weight = max(share, share**2) * alone
        found = np.clip(smallest_eigenvalue(scaled, axis, weight), 0.0, alone)
        # The weight is max(l, l^2) times the depth.
        tried = np.where(weight <= found, weight, np.sqrt(weight * found))
        better = (found > _WORTH * depth) & (tried <= _MOST_EXTENDED * found)
        depth, extension = np.where(better, found, depth), np.where(better, tried, extension)
    return depth, extension


def lateral_depth(pushables: Pushables) -> FloatArray:
    """(k,) minimum deflection across the stiff axis by the maximum force [m]."""
    scaled = pushables.force[:, None, None] * pushables.compliance
    return np.maximum(
        0.0, smallest_eigenvalue(scaled, pushables.stiff_axis, 1e3 * scaled.trace(axis1=2, axis2=3).max(axis=0))
    )


def smallest_eigenvalue(matrices: FloatArray, axis: FloatArray, weight: FloatArray) -> FloatArray:
    """(k,) minimum over both ends of the smallest eigenvalue of (2, k, 3, 3) matrices + weight a a^T."""
    if not len(axis):
        return np.zeros(0)
    found: FloatArray = np.linalg.eigvalsh(matrices + weight[:, None, None] * axis[:, :, None] * axis[:, None])[
        ..., 0
    ].min(axis=0)
    return found
