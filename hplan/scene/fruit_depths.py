r"""Permitted depths of hanging fruit, by the direction in which they are pushed.

A fruit of radius r hangs on a stalk with the direction a. Its compliance C is not below that of a pendulum,
:math:`C_0 = P / k` with :math:`P = \mathbf 1 - a a^\top`. Neighbours at gaps :math:`g_i` in directions :math:`n_i`
press it with :math:`N_i \ge 0`. A link that pushes it by :math:`\delta` along u with the force f displaces it by
:math:`w = C (f u - \sum N_i n_i)`, where :math:`u \cdot w = \delta`, and :math:`n_i \cdot w = g_i` if :math:`N_i > 0`.

**Force.** The neighbours act as one with :math:`n = \sum m_i n_i` and :math:`g = \sum m_i g_i` for some
:math:`m_i \ge 0`. Without its force, :math:`\delta = f (u - y n)^\top C (u - y n) + y g` with
:math:`y = u^\top C n / n^\top C n`, which grows with f, and with C for any y. So f is at most :math:`k d` if

.. math:: \delta \le \min_{y_i \ge 0} \; d \, |P (u - \sum y_i n_i)|^2 + \sum y_i g_i .

**Solid.** Let :math:`q_i` be the unit vectors along :math:`P n_i`, and :math:`e_i = g_i / (2 d |P n_i|)`. For
directions v between the neighbours, let :math:`\rho(v) = 1 - \min \sum \kappa_i e_i` over all :math:`\kappa_i \ge 0`
with :math:`\sum \kappa_i q_i = v`. The minimum above is at least :math:`d - h(u)`, where h is the support function of
the half ellipses

.. math:: d \cos \varphi \, a + \rho(v) \, d \sin \varphi \, v, \qquad 0 \le \varphi \le \pi :

with :math:`m = \sum y_i P n_i` at the minimum, :math:`u \cdot m = |m|^2 + \sum y_i g_i / (2 d)`, so that m is at most
:math:`\rho(v) |P u| v`, and the minimum at least :math:`d (1 - (u \cdot a)^2 - u \cdot m)`. Links keep clear of the
mirror images, grown by :math:`r - d`: a fruit may be pushed away from its neighbours and past them, but not towards
them. A neighbour that no deflection of length d reaches is left out.

**Springs.** A neighbour that bends far enough, with the stiffness :math:`s_i`, adds :math:`k y_i^2 / s_i` to
:math:`|m|^2`. At an angle of :math:`\beta \le \pi / 2` or more beyond the directions between other neighbours, this
divides :math:`\rho` by at least :math:`1 + k \sin^2 \beta / \sum s_i`. Others press with at most
:math:`k d / (c |P n_i|)`, where c is the distance of the hull of the :math:`q_i` from the stalk. If they bend, but not
far enough, they must bear that force.

**Rise.** A pendulum of length l that is displaced by :math:`|w| \le d` rises by at most :math:`z |w|`, with
:math:`z = \tan(\tfrac 1 2 \arcsin(d / l))`. A neighbour above it counts as two that are turned about the stalk by
:math:`\pm \psi`, with :math:`\sin \psi = -z \, (n \cdot a) / |P n|` and gaps of
:math:`g \cos \psi / (1 + \sin \psi)`.

Friction is neglected, as for limbs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from hplan.base import ties
from hplan.base.arrays import BoolArray, FloatArray
from hplan.scene.limb_parts import TINY, PermittedContacts, Pushables, depth_and_extension, pendulum_stiffness
from hplan.scene.limbs import Limbs, skew
from hplan.scene.neighbours import Neighbours, find_neighbours
from hplan.scene.obstacle_kind import Solid
from hplan.scene.wood import LEAST_DEPTH_M, MOST_SWING, Wood

#: Depths that are tried, in proportion to the largest one.
_SHARES: Final = 0.75 ** np.arange(10.0)

#: Number of directions across the stalk, the angle between two, and their unit vectors.
_COUNT: Final = 16
_STEP: Final = 2.0 * math.pi / _COUNT
_FAN: Final = np.stack([np.cos(_STEP * np.arange(_COUNT)), np.sin(_STEP * np.arange(_COUNT))], axis=1)

#: Corners of a polygon about the half circle: along the stalk, and across it.
_TANGENT: Final = math.tan(math.pi / 8.0)
_CORNERS: Final = np.array([(-1.0, _TANGENT), (-_TANGENT, 1.0), (_TANGENT, 1.0), (1.0, _TANGENT)])
_ENDS: Final = np.array([[-1.0], [1.0]])


def _combinations() -> FloatArray:
    """(n, n, n, 2) weights of two directions of the fan that add up to a third one; infinite if they do not."""
    third, one, other = np.meshgrid(*(np.arange(_COUNT),) * 3, indexing="ij")
    before, after = np.mod(third - one, _COUNT), np.mod(other - third, _COUNT)
    found = np.full((_COUNT, _COUNT, _COUNT, 2), np.inf)
    between = (before > 0) & (after > 0) & (before + after < _COUNT // 2)
    sines = np.sin(_STEP * np.stack([after, before], axis=-1)[between])
    found[between] = sines / np.sin(_STEP * (before + after)[between])[:, None]
    found[np.arange(_COUNT), np.arange(_COUNT), np.arange(_COUNT)] = 0.5
    return found


_COMBINED: Final = _combinations()


class FruitsAlone(NamedTuple):
    """Hanging fruit as if they had no neighbours.

    Attributes:
        whole: (k,) depth by the maximum force [m].
        extension: (k,) extension of the axis per depth.
        depth: (k,) maximum depth [m]; 0 for rigid fruit.
        pendulums: The fruit on their stalks.
    """

    whole: FloatArray
    extension: FloatArray
    depth: FloatArray
    pendulums: Sequence[Pendulum]

    @classmethod
    def of(cls, hanging: Pushables) -> FruitsAlone:
        """All of them."""
        whole, lengths = depth_and_extension(hanging)
        depth, stiffness = np.clip(whole, 0.0, hanging.depth), pendulum_stiffness(hanging)
        depth[depth < LEAST_DEPTH_M] = 0.0
        extension = np.divide(lengths, whole, out=np.zeros(len(whole)), where=whole > 0.0)
        most = np.minimum(depth, hanging.force / np.maximum(stiffness, TINY))
        columns = hanging.stiff_axis, (hanging.depth / MOST_SWING).tolist(), most.tolist(), stiffness.tolist()
        return cls(whole, extension, depth, [Pendulum(*values) for values in zip(*columns, strict=True)])

    def neighbours(self, hanging: Pushables, limbs: Limbs, stiff: Sequence[Solid], wood: Wood) -> Neighbours:
        """Their neighbours: a fruit moves by at most its depth, and rises by half of it."""
        return find_neighbours(hanging, _FARTHEST * self.depth, limbs, hanging, stiff, wood)


#: Distance per depth within which neighbours are sought.
_FARTHEST: Final = math.hypot(1.0, 0.5)


def permitted_fruit_contacts(
    hanging: Pushables, alone: FruitsAlone, near: Neighbours, behind: Mapping[int, Neighbours]
) -> PermittedContacts:
    """Depths of fruit within the limits of force, by direction.

    Args:
        hanging: Fruit on limbs.
        alone: The same without neighbours.
        near: Their neighbours with the rooms that `hplan.scene.neighbour_rooms` finds.
        behind: Obstacles that these may be pressed against, by their places.
    """
    depth, per_depth = alone.depth.copy(), hanging.force / np.maximum(alone.whole, TINY)
    count = len(depth)
    pressed, roots, fruits = np.zeros(count), [frozenset[int]()] * count, [frozenset[str]()] * count
    across = dict[int, FloatArray]()
    for row, places in near.by_pushable():
        pendulum, mine = alone.pendulums[row], near.at(places)
        push = deepest_push(pendulum, mine)
        depth[row] = push.depth if push.depth >= LEAST_DEPTH_M else 0.0
        if depth[row] > 0.0 and push.reached.any():
            per_depth[row], pressed[row] = pendulum.stiffness, pendulum.stiffness * push.depth
            across[row] = push.corners
            reached = places[push.reached].tolist()
            moved = Neighbours.join([mine.at(push.reached), *(behind[at] for at in reached if at in behind)])
            roots[row], fruits[row] = moved.limb_roots, moved.fruit_names(hanging)
    cores = hanging.extended(alone.extension * depth)
    for row, corners in across.items():
        cores[row] = hanging.start[row] - corners
    force = per_depth * depth
    return PermittedContacts(depth, cores, force, pressed, force * hanging.stress, roots, fruits)


class Pendulum(NamedTuple):
    """A fruit on its stalk.

    Attributes:
        stalk: (3,) direction of the stalk, towards the fruit.
        length: Length of the pendulum [m].
        depth: Maximum depth without neighbours [m].
        stiffness: Force per deflection [N/m].
    """

    stalk: FloatArray
    length: float
    depth: float
    stiffness: float


class FruitPush(NamedTuple):
    """A fruit that is pushed among its neighbours.

    Attributes:
        depth: Depth when it is pushed away from all neighbours [m]; 0 if it may not be pushed.
        corners: (m, 3) corners of a solid about the half ellipses, from the centre [m].
        reached: (k,) mask of the neighbours that it may touch.
        mean_depth: Mean permitted depth across the stalk [m].
    """

    depth: float
    corners: FloatArray
    reached: BoolArray
    mean_depth: float

    def permitted_depth(self, direction: FloatArray) -> float:
        """Permitted depth in the direction of a (3,) unit vector [m]."""
        return max(0.0, self.depth - float((self.corners @ direction).max(initial=0.0)))


def deepest_push(fruit: Pendulum, near: Neighbours, direction: FloatArray | None = None) -> FruitPush:
    """The push with the largest permitted depth in a direction, or in the mean of all directions across the stalk."""
    tried, depths = [FruitPush(0.0, np.zeros((0, 3)), np.zeros(len(near.gap), dtype=np.bool_), 0.0)], [0.0]
    for depth in (_SHARES * fruit.depth).tolist():
        if depth <= max(depths):  # nor would a smaller one permit more
            break
        tried.append(push_among(fruit, depth, near))
        depths.append(tried[-1].mean_depth if direction is None else tried[-1].permitted_depth(direction))
    return tried[ties.argmax(depths)]


def push_among(fruit: Pendulum, depth: float, near: Neighbours) -> FruitPush:
    """A push to a depth.

    Args:
        fruit: The fruit.
        depth: Depth when it is pushed away from all neighbours [m].
        near: The neighbours.
    """
    along = near.direction @ fruit.stalk
    flat = near.direction - along[:, None] * fruit.stalk
    sideways, above = np.linalg.norm(flat, axis=1), np.maximum(0.0, -along)
    is_known = np.linalg.norm(near.direction, axis=1) > 0.5
    sine = depth / fruit.length
    rise = sine / (1.0 + math.sqrt(1.0 - sine**2))
    farthest = np.where(is_known, sideways + rise * above, math.hypot(1.0, rise)) * depth
    reached = farthest > near.gap
    if not reached.any():
        return FruitPush(depth, depth * _ENDS * fruit.stalk, reached, depth)
    never, stops = FruitPush(0.0, np.zeros((0, 3)), np.zeros_like(reached), 0.0), np.flatnonzero(reached)
    flat, sideways, above = flat[stops], sideways[stops], above[stops]
    if not np.all(is_known[stops] & (rise * above < sideways)):
        return never
    tilt = np.arcsin(rise * above / sideways)
    gap = near.gap[stops] / sideways * np.cos(tilt) / (1.0 + np.sin(tilt))
    nearest = ties.argmin(gap)
    first = flat[nearest] / sideways[nearest]
    second = skew(fruit.stalk) @ first
    angle = np.arctan2(flat @ second, flat @ first)
    is_spring = np.isfinite(near.stiffness[stops]) & (farthest[stops] - near.gap[stops] <= near.depth[stops])
    share, firm = gap / (2.0 * depth), ~is_spring
    least = _least_combination(angle, tilt, share)
    most_force = (near.most_force[stops] * sideways)[firm].min(initial=np.inf)
    if np.isfinite(most_force) and fruit.stiffness * depth > most_force * _distance_of_hull(np.isfinite(least)):
        return never
    length, divisor = np.where(np.isfinite(least), 1.0 - least, -np.inf), np.ones(_COUNT)
    if is_spring.any():
        is_firm = np.isfinite(_least_combination(angle[firm], tilt[firm], share[firm]))
        springs = float(near.stiffness[stops][is_spring].sum())
        divisor += fruit.stiffness / springs * _sine_beyond(is_firm) ** 2
    # Between two directions, the length is at most the larger one, and the divisor at least the smaller one. A chord
    # about the arc has its corners in both directions.
    following, ends = np.roll(length, -1), np.maximum(0.0, length / divisor)
    arc = np.maximum(length, following) / np.minimum(divisor, np.roll(divisor, -1)) / math.cos(0.5 * _STEP)
    arc = np.where(np.isfinite(length) & np.isfinite(following), np.maximum(0.0, arc), 0.0)
    corner = np.maximum(ends, np.maximum(arc, np.roll(arc, 1)))
    lost = np.maximum(0.0, (_FAN @ (corner[:, None] * _FAN).T).max(axis=1))
    kept = np.flatnonzero(corner > 0.0)
    axes = corner[kept, None] * (_FAN[kept] @ np.stack([first, second]))
    along = _CORNERS[:, :1] * fruit.stalk
    corners = np.concatenate([_ENDS * fruit.stalk, (along + _CORNERS[:, 1:] * axes[:, None]).reshape(-1, 3)])
    return FruitPush(depth, depth * corners, reached, depth * float(np.maximum(0.0, 1.0 - lost).mean()))


def _least_combination(angle: FloatArray, tilt: FloatArray, cost: FloatArray) -> FloatArray:
    """Minimum cost of combinations of neighbours for each direction of the fan.

    Neighbours between two directions of the fan count for both.

    Args:
        angle: (k,) angles of the neighbours [rad].
        tilt: (k,) half of the angle between the two that each counts for [rad].
        cost: (k,) cost of each.

    Returns:
        (n,) costs; infinite for directions that are not between neighbours.
    """
    turns = np.concatenate([angle - tilt, angle + tilt]) / _STEP
    near = np.rint(turns)
    is_on = np.abs(turns - near) < _ON
    least = np.full(_COUNT, np.inf)
    for side in (np.where(is_on, near, np.floor(turns)), np.where(is_on, near, np.ceil(turns))):
        np.minimum.at(least, np.mod(side, _COUNT).astype(np.int64), math.cos(0.5 * _STEP) * np.tile(cost, 2))
    with np.errstate(invalid="ignore"):  # 0 times infinity, which `fmin` leaves out
        costs = _COMBINED[..., 0] * least[None, :, None] + _COMBINED[..., 1] * least[None, None, :]
    found: FloatArray = np.fmin.reduce(costs.reshape(_COUNT, -1), axis=1)
    return found


#: Angles nearer than this to a direction of the fan are in it, in angles between two.
_ON: Final = 1e-9


def _distance_of_hull(is_between: BoolArray) -> float:
    """Distance of the hull of marked directions, all next to each other, from the origin; 0 if that is in it."""
    count = int(is_between.sum())
    return math.cos(0.5 * _STEP * (count - 1)) if 2 * (count - 1) < _COUNT else 0.0


def _sine_beyond(is_between: BoolArray) -> FloatArray:
    """(n,) sine of the angle from the nearest marked direction of the fan; 1 from a right angle on, and without any."""
    steps = np.abs(np.arange(_COUNT)[:, None] - np.flatnonzero(is_between))
    steps = np.minimum(steps, _COUNT - steps).min(axis=1, initial=_COUNT // 4)
    found: FloatArray = np.sin(_STEP * steps)
    return found
