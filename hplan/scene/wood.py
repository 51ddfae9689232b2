r"""Wood that bends: how deep limbs and fruit may be pushed within limits of force and stress.

A limb is divided into parts short enough that its compliance hardly changes within one. Each part is a capsule of its
own that pushing links may enter up to a depth; all other links meet the whole segment.

**Depth from force.** A contact with the normal :math:`n` that displaces the limb by :math:`\delta` along :math:`n`
exerts the force :math:`\delta / (n^\top C n)` (`hplan.scene.limbs`). Let the axis :math:`a` of a part be extended by
:math:`\epsilon` at both ends. A convex body that is at most :math:`\delta` deep in the extended part is separated from
the limb by a displacement of at most :math:`\delta - \epsilon |n \cdot a|` along some :math:`n`. As
:math:`|n \cdot a| \ge (n \cdot a)^2`, the force is at most :math:`F` for every normal if

.. math:: \delta \le \lambda_{min}(F C + \epsilon\, a a^\top).

So a twig, which is stiff along its axis, is not met head-on. For :math:`\epsilon \le \delta` what is clear of the limb
is clear of the smaller part, too, unless thin links may not use the whole depth; `hplan.certify` then tries rigid
limbs, so that limits forbid no motion that touches nothing. Within a part, the tangent of
:math:`C` bounds it from below, and this eigenvalue is concave in it: the two ends decide.

The depth is that of the shortest way out. A limb that a deeper body takes along on its other side is bent more: in 1 of
4,455 simulated pushes (`scripts/benchmark.py wood_moving`) the stress was 1.3 times its bound, at any speed, where the
axes of body and limb came within 1 % of both radii. So links keep a fifth of both radii
(`hplan.collision.compliant_solids.LIMB_SHARE`).

**Stress.** A force f at x bends the limb at p by at most :math:`f |x - p|`, and the stress in a round section of radius
r is :math:`4 M / (\pi r^3)`; the limit of stress is one of force.

**Neighbours.** A limb that is pushed against another one, or against anything else, bends that as well: behind a gap g,
a neighbour with the compliance :math:`c_2` adds :math:`(\delta - g) / c_2`, and a rigid one stops it.

**Impact.** A link that meets a limb with the speed v exerts at most about :math:`v Z` in addition, with the impedance
of a beam at the frequency at which it equals that of the contact's spring k (Cremer, Heckl and Petersson, Structure-
Borne Sound, chapter 4): :math:`Z = k^{1/3} (2 \sqrt 2)^{2/3} (E I)^{1/6} (\rho A)^{1/2}`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Final, NamedTuple, Protocol, TypeGuard

import numpy as np
from pydantic import Field, model_validator

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, readonly
from hplan.base.checked import StrictModel, fault
from hplan.geometry.cloud import Cloud
from hplan.scene.limbs import CLAMP_RADIUS_M, Limbs
from hplan.scene.obstacle_kind import ContactLimit, Solid
from hplan.scene.obstacles import Capsule, Obstacle, Sphere

#: Share of the limits of force and stress for the deflection; the rest is for impacts.
STATIC_SHARE: Final = 0.7

#: Impacts in a row, the return of a limb that was thrown ahead, and forks near a contact raise the first impact by at
#: most this factor: the largest one found in 800 simulated pushes was 2.4 (`scripts/benchmark.py wood_moving`).
IMPACT_FACTOR: Final = 2.6

#: Maximum rotation of a limb at a contact, and the growth of its force over that of small deflections with the square
#: of the rotation. A cantilever that is bent by a third of its length turns by 0.46 and needs 1.1 times the force of
#: linear theory (Bisshopp and Drucker 1945), and the normal of the contact turns with it, which adds 1 / cos.
MOST_ROTATION: Final = 0.45
LARGE_ROTATION_FORCE: Final = 1.2

#: Depths below this count as rigid [m].
LEAST_DEPTH_M: Final = 5e-4

#: Parts are divided until their depth is this share of that at their middle, or down to this length [m].
_EVEN: Final = 0.65
_SHORTEST_M: Final = 0.01

#: Maximum distance between the surfaces of a fruit and the limb that it hangs from [m].
STALK_M: Final = 0.03

#: Maximum deflection of a fruit per length of its pendulum. The force is counted with the secant stiffness there.
MOST_SWING: Final = 0.8

#: Acceleration of gravity [m/s^2].
GRAVITY: Final = 9.81

#: Assumed minimum damping ratio of limbs, and of fruit on their stalks, after a push.
DAMPING_RATIO: Final = 0.05

#: Prevents divisions by zero where a limb is clamped.
_TINY: Final = 1e-12

#: Number of extensions that are tried, from none to the depth across the axis.
_SHARES: Final = 17

#: Number of limb parts whose neighbours are found together.
_TOGETHER: Final = 256

#: Number of scenes whose limbs are kept.
_KEPT: Final = 8

#: Number of normals for which the displacement of a limb by a pushed fruit is examined.
_SPHERE: Final = 400


class HangingFruit(Protocol):
    """A fruit of a scene, as far as it matters here (`hplan.scene.model.Fruit`)."""

    @property
    def name(self) -> str:
        """Name."""
        ...

    @property
    def center(self) -> tuple[float, float, float]:
        """Centre [m]."""
        ...

    @property
    def radius(self) -> float:
        """Radius [m]."""
        ...

    @property
    def sigma(self) -> float:
        """Standard deviation of its position [m]."""
        ...

    @property
    def hangs_from(self) -> tuple[str, ...]:
        """Names of the obstacles that it is attached to."""
        ...

    @property
    def is_static(self) -> bool:
        """True if it neither moves nor sways."""
        ...


_Positive = Annotated[float, Field(gt=0.0, le=1e12)]


class Wood(StrictModel):
    """Limits for contact with wood and fruit, and the mechanical properties that they are bounded with.

    Young's modulus is an interval: the stiffer end bounds forces. Living branches have 0.7 to 4.6 GPa (Cannell and
    Morgan 1987), green timber up to 7.5 GPa; green stems break at 35 to 50 MPa, branches at 38 to 70 MPa, and apples
    detach at 20 to 25 N (Hussain 2022). Certificates hold for wood within these values.

    Attributes:
        contact_force: Maximum force of a link on a limb [N].
        wood_stress_mpa: Maximum bending stress of a limb [MPa].
        fruit_force: Maximum force on the stalk of a fruit that a link pushes aside [N].
        youngs_modulus_gpa: Minimum and maximum of Young's modulus [GPa].
        clamp_radius: Radius from which wood does not bend [m].
        density: Density of wood [kg/m^3].
        fruit_density: Density of fruit [kg/m^3].
        contact_stiffness: Stiffness of the contact between link and limb, for impacts [N/m].
        capture_range: Maximum displacement of the goal fruit at the grasp by the limbs that are pushed [m].

    Examples:
        >>> from hplan.scene import Wood
        >>> Wood(contact_force=5.0).youngs_modulus_gpa
        (0.7, 5.0)
    """

    contact_force: _Positive = 10.0
    wood_stress_mpa: _Positive = 30.0
    fruit_force: _Positive = 8.0
    youngs_modulus_gpa: tuple[_Positive, _Positive] = (0.7, 5.0)
    clamp_radius: _Positive = CLAMP_RADIUS_M
    density: _Positive = 1000.0
    fruit_density: _Positive = 850.0
    contact_stiffness: _Positive = 2000.0
    capture_range: _Positive = 0.02

    @model_validator(mode="after")
    def _is_interval(self) -> Wood:
        low, high = self.youngs_modulus_gpa
        if low > high:
            raise fault(f"expected the minimum first, got {low:g} and {high:g}", "youngs_modulus_gpa")
        return self

    @property
    def wood_stress(self) -> float:
        """Maximum bending stress [Pa]."""
        return 1e6 * self.wood_stress_mpa

    @property
    def stiffest(self) -> float:
        """Maximum of Young's modulus [Pa]."""
        return 1e9 * self.youngs_modulus_gpa[1]

    @property
    def softest(self) -> float:
        """Minimum of Young's modulus [Pa]."""
        return 1e9 * self.youngs_modulus_gpa[0]

    def scale(self, share: float) -> Wood:
        """The same wood with a fraction of the limits of force and stress."""
        limits = ("contact_force", "wood_stress_mpa", "fruit_force")
        return self.with_values(**{key: share * getattr(self, key) for key in limits})

    @property
    def as_rigid(self) -> Wood:
        """The same wood with limits within which no limb yields."""
        return self.scale(_NOTHING)


#: Fraction of the limits within which no limb yields.
_NOTHING: Final = 1e-9


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


def contact_solids(
    obstacles: Sequence[Obstacle], fruits: Sequence[HangingFruit], wood: Wood
) -> Mapping[str, tuple[Solid, ...]]:
    """Solids of the limbs and the fruit that bend, by name.

    The first solid of each name is the whole obstacle, which links meet that may not push; the others are the parts
    that pushing links meet, unless the whole is rigid. Obstacles and fruits that are no limbs and hang from none are
    missing. Results are kept for the same obstacles and fruits.

    Args:
        obstacles: All obstacles of a scene; its limbs are the capsules with a parent, and the parents.
        fruits: All fruits.
        wood: Limits and properties.
    """
    items = (*obstacles, *fruits)
    key = tuple(map(id, items)), len(fruits), wood
    known = _KNOWN.get(key)
    if known is None:
        known = items, _contact_solids(obstacles, fruits, wood)
        _KNOWN[key] = known
        while len(_KNOWN) > _KEPT:
            _KNOWN.pop(next(iter(_KNOWN)), None)
    return known[1]


#: Parts are copies of this capsule: a checked one takes ten times as long.
_TEMPLATE: Final = Capsule(name="part", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 1.0), radius=1.0)

#: Kept results of `contact_solids`; they hold obstacles and fruits, so that no id is used for another object.
_KNOWN: Final[dict[tuple[tuple[int, ...], int, Wood], tuple[Any, Mapping[str, tuple[Solid, ...]]]]] = {}


def limbs_of(obstacles: Sequence[Obstacle], wood: Wood) -> Limbs:
    """Limbs among the obstacles of a scene; obstacles that move or sway are none."""
    return Limbs.of([piece for piece in obstacles if _is_still_capsule(piece)], wood.clamp_radius)


def _is_still_capsule(piece: Any) -> TypeGuard[Capsule]:
    return isinstance(piece, Capsule) and piece.is_static


def _contact_solids(
    obstacles: Sequence[Obstacle], fruits: Sequence[HangingFruit], wood: Wood
) -> dict[str, tuple[Solid, ...]]:
    limbs = limbs_of(obstacles, wood)
    if not len(limbs.names):
        return {}
    whole: dict[str, Any] = {piece.name: piece for piece in obstacles if _is_still_capsule(piece)}
    whole |= {f.name: Sphere(name=f.name, center=f.center, radius=f.radius, sigma=f.sigma) for f in fruits}
    names = set(limbs.names)
    stiff = [solid for piece in obstacles if piece.name not in names for solid in piece.solids]
    hanging, roots = hanging_fruits(fruits, limbs, wood), limbs.roots().tolist()
    carried: dict[int, float] = {}
    for segment, mass in zip(hanging.segment.tolist(), hanging.mass.tolist(), strict=True):
        carried[roots[segment]] = carried.get(roots[segment], 0.0) + mass
    found, decays = dict[str, tuple[Solid, ...]](), _decay_rates(limbs, hanging, wood)
    for pushables, most_force in ((divide_limbs(limbs, wood), wood.contact_force), (hanging, wood.fruit_force)):
        table = permitted_contacts(pushables, limbs, hanging, stiff, wood)
        extension = table.extension[:, None] * pushables.stiff_axis
        starts, ends = (pushables.start - extension).tolist(), (pushables.end + extension).tolist()
        for row, name in enumerate(pushables.names):
            depth, segment = float(table.depth[row]), int(pushables.segment[row])
            low, high = pushables.along[row].tolist()
            swing = float(pushables.swing[row])
            point, decay = None, 0.0
            if swing > 0.0:
                pendulum = _pendulum_compliance(pushables, row)
                point = HangingPoint(limbs, segment, low, pendulum, (wood.softest, wood.stiffest))
                decay = decays[row]
            limit = ContactLimit(
                depth, float(table.force[row]), float(table.stress[row]), segment, roots[segment], (low, high),
                *_impact(limbs, segment, swing, float(pushables.mass[row]), carried.get(roots[segment], 0.0), wood),
                most_force, wood.wood_stress, point, decay, wood.capture_range,
            )  # fmt: skip
            solid = _TEMPLATE.copy_unchecked({
                "name": name, "start": tuple(starts[row]), "end": tuple(ends[row]),
                "radius": float(pushables.radius[row]), "sigma": whole[name].sigma, "yields": depth,
            })  # fmt: skip
            found.setdefault(name, (whole[name].met_by("others"),))
            found[name] += (solid.met_by("pushing", limit),)
    for name, solids in found.items():
        if not any(solid.yields for solid in solids):  # rigid, whatever hangs from it
            found[name] = (whole[name].met_by("all", solids[-1].contact_limit),)
    return found


@dataclass(frozen=True, eq=False)
class HangingPoint(Record):
    """Point of a limb that a fruit hangs from.

    Attributes:
        limbs: All limbs.
        segment: Number of the segment.
        along: Distance from its start [m].
        swing: (3, 3) compliance of the pendulum [m/N].
        youngs_modulus: Minimum and maximum of Young's modulus [Pa].
    """

    limbs: Limbs
    segment: int
    along: float
    swing: FloatArray
    youngs_modulus: tuple[float, float]

    def __call__(self, limit: ContactLimit) -> tuple[float, bool]:
        r"""Largest displacement per deflection of a part of a limb, and True if one of both carries the other.

        A contact with the normal n deflects the part by its depth along n, and displaces this point by the depth times
        :math:`|C_{fx} n| / (n^\top C_{xx} n)`. The maximum over all n across the part is bounded between samples by
        the derivatives of both quadratic forms.
        """
        if isinstance(limit.displacement, HangingPoint):
            return self._ratio_by_fruit(limit, limit.displacement), False
        modulus = self.youngs_modulus[1]
        limbs, numbers = self.limbs, (self.segment, limit.segment)
        path, other = limbs.path(self.segment), limbs.path(limit.segment)
        if not path or not other or path[-1] != other[-1]:
            return 0.0, False
        here, axis = limbs.start[self.segment] + self.along * limbs.axis[self.segment], limbs.axis[limit.segment]
        across = _across(axis)
        largest = 0.0
        for along in limit.along:
            at = limbs.start[limit.segment] + along * axis
            moved = limbs.mutual_compliance(numbers, np.stack([here, at]), modulus) @ across.T
            own = limbs.compliance(limit.segment, along / float(limbs.length[limit.segment]), modulus)
            largest = max(largest, _largest_ratio(moved.T @ moved, across @ own[:3, :3] @ across.T))
        return largest, limit.segment in path or self.segment in other

    def _ratio_by_fruit(self, limit: ContactLimit, other: HangingPoint) -> float:
        """Largest displacement per deflection of another fruit on the same limb.

        A push of the depth d along n exerts d / (n C n) with the compliance C of limb and pendulum, and at most the
        limit's force. The softest limb is displaced most, since the pendulum does not depend on it. Many normals are
        examined.
        """
        limbs, numbers, soft = self.limbs, (self.segment, other.segment), self.youngs_modulus[0]
        points = np.stack([
            limbs.start[point.segment] + point.along * limbs.axis[point.segment] for point in (self, other)
        ])  # fmt: skip
        own = limbs.mutual_compliance((other.segment, other.segment), points[[1, 1]], soft) + other.swing
        normals = _half_sphere(_SPHERE)
        moved = np.linalg.norm(normals @ limbs.mutual_compliance(numbers, points, soft).T, axis=1)
        per_depth = 1.0 / np.maximum(np.einsum("ni,ij,nj->n", normals, own, normals), _TINY)
        return float((moved * np.minimum(per_depth, limit.force / max(limit.depth, _TINY))).max())


#: Number of normals across a limb between which the displacement is bounded.
_NORMALS: Final = 256


def _across(axis: FloatArray) -> FloatArray:
    """(2, 3) unit vectors across an axis."""
    first = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)])


def _largest_ratio(above: FloatArray, below: FloatArray) -> float:
    """Upper bound of sqrt(n^T above n) / (n^T below n) for unit vectors n of the plane, for (2, 2) matrices."""
    angle = np.arange(_NORMALS) * math.pi / _NORMALS
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    step = 0.5 * math.pi / _NORMALS  # from the nearest sample; a quadratic form changes by its spread per radian
    tops, bottoms = (np.einsum("ki,ij,kj->k", normals, matrix, normals) for matrix in (above, below))
    spreads = [float(np.ptp(np.linalg.eigvalsh(matrix))) for matrix in (above, below)]
    lowest = np.maximum(bottoms - step * spreads[1], float(np.linalg.eigvalsh(below)[0]))
    if float(lowest.min()) <= 0.0:
        return math.inf
    return float((np.sqrt(tops + step * spreads[0]) / lowest).max())


@cache
def _half_sphere(count: int) -> FloatArray:
    """(count, 3) evenly distributed directions with z > 0."""
    rank = np.arange(count) + 0.5
    height, turn = rank / count, math.pi * (1.0 + math.sqrt(5.0)) * rank
    across = np.sqrt(1.0 - height**2)
    return readonly(np.column_stack([across * np.cos(turn), across * np.sin(turn), height]))


def _decay_rates(limbs: Limbs, hanging: Pushables, wood: Wood) -> list[float]:
    """(k,) minimum rates at which swinging fruit come to rest, limbs included [1/s].

    The first frequency is at least that of Dunkerley's formula: the squared periods of all fruit on a limb, each alone
    on the softest wood, and of the pendulum add up.
    """
    found, roots = list[float](), limbs.roots()
    compliance = limbs.compliance_along(hanging.segment, hanging.along[:, 0])[0] / wood.softest
    squared = hanging.mass * np.linalg.eigvalsh(compliance)[:, -1] if len(hanging.names) else np.zeros(0)
    for row, segment in enumerate(hanging.segment.tolist()):
        root = int(roots[segment])
        limb = float(squared[roots[hanging.segment] == root].sum()) if root >= 0 else 0.0
        pendulum = float(hanging.depth[row]) / MOST_SWING / GRAVITY
        found.append(DAMPING_RATIO / math.sqrt(limb + pendulum))
    return found


def _pendulum_compliance(hanging: Pushables, row: int) -> FloatArray:
    """(3, 3) compliance of a fruit on its stalk [m/N]; the secant one at the maximum swing."""
    stalk, arm = hanging.stiff_axis[row], float(hanging.depth[row]) / MOST_SWING
    stiffness = GRAVITY * float(hanging.mass[row]) / (arm * math.sqrt(1.0 - MOST_SWING**2))
    found: FloatArray = (np.eye(3) - np.outer(stalk, stalk)) / stiffness
    return found


def _impact(
    limbs: Limbs, segment: int, swing: float, mass: float, carried: float, wood: Wood
) -> tuple[float, float, float, float]:
    """Impact, impact stress, swing and rate of `ContactLimit`.

    The force is that of the contact's spring on a beam (see the module), and on the fruit that hang from the same first
    bending segment: stalks are stiff along their axis. A beam that is set in motion with the speed v is bent by a wave
    with the stress 2 v sqrt(E rho), which is reflected at its clamp and its forks.

    Args:
        limbs: All limbs.
        segment: Number of the segment.
        swing: The swing of a fruit, 0 for a limb [N s^2/m^2].
        mass: Mass of the fruit [kg].
        carried: Mass of all fruit on limbs with the same root [kg].
        wood: Limits and properties.
    """
    if swing > 0.0:
        return 0.0, 0.0, swing, math.sqrt(wood.contact_stiffness / mass)
    radius = float(limbs.radius[segment])
    rigidity = wood.stiffest * 0.25 * math.pi * radius**4
    per_length = wood.density * math.pi * radius**2
    impedance = wood.contact_stiffness ** (1.0 / 3.0) * 2.0 * rigidity ** (1.0 / 6.0) * math.sqrt(per_length)
    stress = 2.0 * IMPACT_FACTOR * math.sqrt(wood.stiffest * wood.density)
    force = IMPACT_FACTOR * impedance + math.sqrt(wood.contact_stiffness * carried)
    return force, stress, 0.0, wood.contact_stiffness / impedance


def divide_limbs(limbs: Limbs, wood: Wood) -> Pushables:
    """Divide the limb segments that bend into parts of nearly even compliance."""
    numbers = np.flatnonzero(~limbs.clamped)
    if not len(numbers):
        return _parts(limbs, numbers, np.zeros(0), np.zeros(0), wood)
    low, high = np.zeros(len(numbers)), limbs.length[numbers].copy()
    done = list[Pushables]()
    while len(numbers):
        parts = _parts(limbs, numbers, low, high, wood)
        middle = _parts(limbs, numbers, 0.5 * (low + high), 0.5 * (low + high), wood)
        even = np.minimum(_lateral_depth(parts), parts.depth), np.minimum(_lateral_depth(middle), middle.depth)
        is_even = (even[0] >= _EVEN * even[1]) | (high - low <= 2.0 * _SHORTEST_M) | (even[1] <= 2.0 * LEAST_DEPTH_M)
        done.append(parts.at(is_even))
        left = ~is_even
        numbers, half = np.repeat(numbers[left], 2), 0.5 * (low + high)[left]
        low, high = np.stack([low[left], half], axis=1).ravel(), np.stack([half, high[left]], axis=1).ravel()
    whole = [np.concatenate([getattr(part, key) for part in done], axis=int(key == "compliance")) for key in _ARRAYS]
    found = Pushables(tuple(name for part in done for name in part.names), *whole)
    return found.at(np.lexsort([found.along[:, 0], found.segment]))


_ARRAYS: Final = Pushables._fields[1:]


def _parts(limbs: Limbs, numbers: IntArray, low: FloatArray, high: FloatArray, wood: Wood) -> Pushables:
    """Parts of segments between points of their axes."""
    axis, middle = limbs.axis[numbers], 0.5 * (low + high)
    compliance, slope, rotation = limbs.compliance_along(numbers, middle)
    half = 0.5 * (high - low)[:, None, None]
    ends = np.stack([compliance - half * slope, compliance + half * slope]) / wood.stiffest
    start, end = (limbs.start[numbers] + at[:, None] * axis for at in (low, high))
    stress = np.maximum(*(limbs.stress_per_force(numbers, point) for point in (start, end)))
    share = STATIC_SHARE * np.minimum(wood.contact_force, wood.wood_stress / np.maximum(stress, _TINY))
    lateral = _smallest(ends, axis, 1e3 * ends.trace(axis1=2, axis2=3).max(axis=0))
    # The deflection per rotation is at least the root of compliance over rotation per moment (Cauchy and Schwarz).
    per_rotation = np.sqrt(np.maximum(lateral, 0.0) * wood.stiffest / np.maximum(rotation, _TINY))
    turned = np.minimum(MOST_ROTATION, share * np.maximum(lateral, 0.0) / np.maximum(per_rotation, _TINY))
    share, depth = share / (1.0 + LARGE_ROTATION_FORCE * turned**2), MOST_ROTATION * per_rotation
    return Pushables(
        tuple(limbs.names[number] for number in numbers.tolist()), numbers, np.stack([low, high], axis=1), start, end,
        limbs.radius[numbers], axis, ends, share, stress, depth, *np.zeros((2, len(numbers))),
    )  # fmt: skip


def hanging_fruits(fruits: Sequence[HangingFruit], limbs: Limbs, wood: Wood) -> Pushables:
    """Fruit as pendulums on the limbs that they hang from.

    A fruit hangs from the nearest limb of its `hangs_from`, or of all, if that is within `STALK_M`. Along its stalk it
    moves with the limb alone; across it, the fruit swings. A link with the speed v throws it ahead with at most 2 v, so
    that its stalk holds 4 m v^2 / l more.
    """
    rows = list[tuple[Any, ...]]()
    for fruit in fruits:
        if not fruit.is_static:
            continue
        hung = limbs.nearest(np.array(fruit.center), fruit.hangs_from)
        if hung is None or hung[2] - fruit.radius - limbs.radius[hung[0]] > STALK_M:
            continue
        segment, along, arm = hung
        if arm < _TINY:  # its centre is in the limb: it has no stalk, and stays rigid
            continue
        point = limbs.start[segment] + along * limbs.axis[segment]
        stalk = (np.array(fruit.center) - point) / arm
        weight = GRAVITY * wood.fruit_density * 4.0 / 3.0 * math.pi * fruit.radius**3
        numbers, at = np.array([segment]), np.array([along])
        limb = limbs.compliance_along(numbers, at)[0][0] / wood.stiffest
        swing = arm * math.sqrt(1.0 - MOST_SWING**2) / weight * (np.eye(3) - np.outer(stalk, stalk))
        stress = float(limbs.stress_per_force(numbers, point[None])[0]) if not limbs.clamped[segment] else 0.0
        force = STATIC_SHARE * min(wood.fruit_force, wood.wood_stress / max(stress, 1e-9))
        rows.append((fruit.name, segment, (along, along), fruit.center, fruit.center, fruit.radius, stalk,
                     (limb + swing, limb + swing), force, stress, MOST_SWING * arm,
                     4.0 * weight / GRAVITY / arm, weight / GRAVITY))  # fmt: skip
    if not rows:
        return _parts(limbs, np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0), wood)
    columns = list(zip(*rows, strict=True))
    arrays = [np.array(column, dtype=np.float64) for column in columns[2:]]
    arrays[5] = arrays[5].swapaxes(0, 1)
    return Pushables(columns[0], np.array(columns[1], dtype=np.int64), *arrays)


class PermittedContacts(NamedTuple):
    """Permitted depth of each pushable, and what it does.

    Attributes:
        depth: (k,) permitted depth [m].
        extension: (k,) extension of both ends along the stiff axis [m].
        force: (k,) static force at that depth [N].
        stress: (k,) static stress of the limb at that depth [Pa].
    """

    depth: FloatArray
    extension: FloatArray
    force: FloatArray
    stress: FloatArray


def permitted_contacts(
    pushables: Pushables, limbs: Limbs, hanging: Pushables, stiff: Sequence[Solid], wood: Wood
) -> PermittedContacts:
    """Depths within the limits of force and stress, with the neighbours that are pushed as well.

    Args:
        pushables: Parts of limbs, or fruit.
        limbs: All limbs.
        hanging: All fruit that hang from them.
        stiff: Solids of all other obstacles.
        wood: Limits and properties.
    """
    count = len(pushables.names)
    whole, lengths = _depth_and_extension(pushables)
    per_depth = pushables.force / np.maximum(whole, 1e-12)  # of the limb alone [N/m]
    most = np.clip(whole, 0.0, pushables.depth)
    found = _neighbours(pushables, most, limbs, hanging, stiff, wood)
    depth, limit = most.copy(), STATIC_SHARE * wood.contact_force
    for row in np.unique(found.pushable).tolist():
        mine = found.at(found.pushable == row)
        depth[row] = _squeezed_depth(float(most[row]), float(per_depth[row]), limit, mine)
    depth[depth < LEAST_DEPTH_M] = 0.0
    force = per_depth * depth
    pushed_on = np.maximum(0.0, depth[found.pushable] - found.gap)
    squeezed = np.bincount(found.pushable, np.multiply(found.stiffness, pushed_on, where=pushed_on > 0.0,
                                                       out=np.zeros(len(pushed_on))), count)  # fmt: skip
    extension = np.divide(lengths * depth, whole, out=np.zeros(count), where=whole > 0.0)
    return PermittedContacts(depth, extension, force + squeezed, force * pushables.stress)


def _depth_and_extension(pushables: Pushables) -> tuple[FloatArray, FloatArray]:
    """Depth by the maximum force, and the extension of the axis that it takes, (k,) each [m].

    The extension is at most the depth: then a body that is clear of the limb is clear of the extended, smaller part,
    so that limits never forbid a motion that touches nothing.
    """
    scaled, axis = pushables.force[:, None, None] * pushables.compliance, pushables.stiff_axis
    alone = _lateral_depth(pushables)
    depth, extension = np.zeros(len(alone)), np.zeros(len(alone))
    for share in np.linspace(0.0, 1.0, _SHARES):
        tried = share * alone
        found = np.clip(_smallest(scaled, axis, tried), 0.0, alone)
        better = (found > depth * (1.0 + 1e-9)) & (tried <= found * (1.0 + 1e-9))
        depth, extension = np.where(better, found, depth), np.where(better, tried, extension)
    return depth, extension


class Neighbours(NamedTuple):
    """Obstacles that pushed limbs or fruit may be pressed against.

    Attributes:
        pushable: (m,) the pushed limb part or fruit.
        gap: (m,) gap between both [m].
        stiffness: (m,) stiffness of the neighbour [N/m]; inf if it is rigid.
        depth: (m,) maximum deflection of the neighbour [m].
    """

    pushable: IntArray
    gap: FloatArray
    stiffness: FloatArray
    depth: FloatArray

    def at(self, kept: BoolArray) -> Neighbours:
        """Those of a mask."""
        return Neighbours(self.pushable[kept], self.gap[kept], self.stiffness[kept], self.depth[kept])


def _squeezed_depth(most: float, per_depth: float, limit: float, neighbours: Neighbours) -> float:
    """Depth at which limb and neighbours together exert the limit of force [m]."""
    most = min(most, float((neighbours.gap + neighbours.depth).min()))
    slope, force, at = per_depth, 0.0, 0.0
    for row in np.argsort(neighbours.gap, kind="stable").tolist():
        gap = float(neighbours.gap[row])
        if gap >= most or force + slope * (gap - at) >= limit:
            break
        force, at, slope = force + slope * (gap - at), gap, slope + float(neighbours.stiffness[row])
    return min(most, at + (limit - force) / slope)


def _neighbours(
    pushables: Pushables, depth: FloatArray, limbs: Limbs, hanging: Pushables, stiff: Sequence[Solid], wood: Wood
) -> Neighbours:
    """Obstacles within the depth of pushed limbs or fruit, but for the limbs that they grow from and those on them."""
    related = limbs.related()[pushables.segment]
    moved = np.flatnonzero(depth >= LEAST_DEPTH_M)
    found = list[Neighbours]()
    start, end = pushables.start, pushables.end
    for first in range(0, len(moved), _TOGETHER):
        rows = moved[first : first + _TOGETHER]
        middles, halves = 0.5 * (start[rows] + end[rows]), 0.5 * np.linalg.norm(end[rows] - start[rows], axis=1)
        apart = np.linalg.norm(middles[:, None] - 0.5 * (limbs.start + limbs.end), axis=2) - halves[:, None]
        reach = (depth + pushables.radius)[rows, None] + limbs.radius + 0.5 * limbs.length
        row, other = np.nonzero((apart < reach) & ~related[rows])
        row = rows[row]
        distance, along = _axis_distance(start[row], end[row], limbs.start[other], limbs.end[other])
        gap = np.maximum(0.0, distance - pushables.radius[row] - limbs.radius[other])
        near = gap < depth[row]
        row, other, gap, along = row[near], other[near], gap[near], along[near]
        point = _parts(limbs, other, along, along, wood)
        soft = _smallest(point.compliance, point.stiff_axis, np.ones(len(other)))
        soft[limbs.clamped[other]] = 0.0
        stiffness = np.divide(1.0, soft, out=np.full(len(soft), np.inf), where=soft > 1e-12)
        room = np.where(soft > 1e-12, np.minimum(point.force * soft, point.depth), 0.0)
        found.append(Neighbours(row, gap, stiffness, room))
        found.append(_fruit_neighbours(pushables, rows, depth, hanging, related))
        for solid in stiff:
            gap = _solid_distance(start[rows], end[rows], solid) - pushables.radius[rows]
            near = gap < depth[rows]
            rigid = np.full(int(near.sum()), np.inf)
            found.append(Neighbours(rows[near], np.maximum(0.0, gap[near]), rigid, np.zeros(len(rigid))))
    if not found:
        return Neighbours(np.zeros(0, dtype=np.int64), *(np.zeros(0) for _ in range(3)))
    return Neighbours(*(np.concatenate(columns) for columns in zip(*found, strict=True)))


def _fruit_neighbours(
    pushables: Pushables, rows: IntArray, depth: FloatArray, hanging: Pushables, related: BoolArray
) -> Neighbours:
    """Fruit within the depth of pushed limbs or other fruit, but for the fruit on the pushed limbs."""
    start, along = pushables.start[rows], (pushables.end - pushables.start)[rows]
    offset = hanging.start - start[:, None]
    fraction = np.einsum("kfj,kj->kf", offset, along) / np.maximum(np.einsum("kj,kj->k", along, along), _TINY)[:, None]
    apart = offset - np.clip(fraction, 0.0, 1.0)[:, :, None] * along[:, None]
    distance = np.linalg.norm(apart, axis=2)
    gap = np.maximum(0.0, distance - pushables.radius[rows, None] - hanging.radius)
    own = related[rows][:, hanging.segment] & (pushables.swing[rows] == 0.0)[:, None]
    own |= np.array(pushables.names)[rows, None] == np.array(hanging.names) if len(hanging.names) else False
    row, other = np.nonzero((gap < depth[rows, None]) & ~own)
    direction = apart[row, other] / np.maximum(distance[row, other], _TINY)[:, None]
    soft = 0.5 * np.einsum("mi,mij,mj->m", direction, hanging.compliance[0][other], direction)
    room = np.minimum(hanging.force[other] * soft, hanging.depth[other])
    return Neighbours(rows[row], gap[row, other], 1.0 / np.maximum(soft, _TINY), room)


def _solid_distance(start: FloatArray, end: FloatArray, solid: Solid) -> FloatArray:
    """(k,) lower bounds of the distances of axes between (k, 3) points from a solid [m]."""
    core = solid.core
    if isinstance(solid, Cloud):
        from scipy.spatial import cKDTree

        count = 9  # points of each axis; between two of them the distance is at most half a step smaller
        points = np.linspace(start, end, count)
        step = np.linalg.norm(end - start, axis=1) / (count - 1)
        distance = cKDTree(core).query(points)[0].min(axis=0) - 0.5 * step
    elif len(core) <= 2:
        distance = _axis_distance(start, end, *(np.broadcast_to(core[at], start.shape) for at in (0, -1)))[0]
    else:  # of the boxes about both
        low, high = np.minimum(start, end), np.maximum(start, end)
        apart = np.maximum(core.min(axis=0) - high, low - core.max(axis=0))
        distance = np.linalg.norm(np.maximum(apart, 0.0), axis=1)
    found: FloatArray = distance - solid.rounding
    return found


def _axis_distance(
    start: FloatArray, end: FloatArray, other_start: FloatArray, other_end: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(k,) distances of (k, 3) axes, and the nearest points' distances from the other axes' starts [m]."""
    u, v, w = end - start, other_end - other_start, start - other_start
    uu, uv, vv, uw, vw = (np.einsum("kj,kj->k", *pair) for pair in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    tiny = 1e-18
    determinant = uu * vv - uv * uv
    inner = np.divide(uv * vw - vv * uw, determinant, out=np.zeros_like(uu), where=determinant > 1e-12 * uu * vv + tiny)
    best, at = np.full(len(u), np.inf), np.zeros(len(u))
    for s in (np.clip(inner, 0.0, 1.0), np.zeros_like(uu), np.ones_like(uu)):
        t = np.clip((uv * s + vw) / np.maximum(vv, tiny), 0.0, 1.0)
        s = np.clip((uv * t - uw) / np.maximum(uu, tiny), 0.0, 1.0)
        distance = np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1)
        at = np.where(distance < best, t * np.sqrt(vv), at)
        best = np.minimum(best, distance)
    return best, at


def _lateral_depth(pushables: Pushables) -> FloatArray:
    """(k,) minimum deflection across the stiff axis by the maximum force [m]."""
    scaled = pushables.force[:, None, None] * pushables.compliance
    return np.maximum(0.0, _smallest(scaled, pushables.stiff_axis, 1e3 * scaled.trace(axis1=2, axis2=3).max(axis=0)))


def _smallest(matrices: FloatArray, axis: FloatArray, weight: FloatArray) -> FloatArray:
    """(k,) minimum over both ends of the smallest eigenvalue of (2, k, 3, 3) matrices + weight a a^T."""
    if not len(axis):
        return np.zeros(0)
    found: FloatArray = np.linalg.eigvalsh(matrices + weight[:, None, None] * axis[:, :, None] * axis[:, None])[
        ..., 0
    ].min(axis=0)
    return found
