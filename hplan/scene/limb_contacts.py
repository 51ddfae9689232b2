r"""Solids of limbs and fruit that bend: their parts with permitted depths, and what contacts with them do.

Permitted depths follow from `hplan.scene.limb_parts`, `hplan.scene.limb_depths` and `hplan.scene.fruit_depths`.

**Impact.** A link that meets a limb with the speed v exerts at most about :math:`v Z` in addition, with the impedance
of a beam at the frequency at which it equals that of the contact's spring k (Cremer, Heckl and Petersson, Structure-
Borne Sound, chapter 4): :math:`Z = k^{1/3} (2 \sqrt 2)^{2/3} (E I)^{1/6} (\rho A)^{1/2}`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any, Final, TypeAlias, TypeGuard, TypeVar

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.scene.fruit import Fruit
from hplan.scene.fruit_depths import FruitsAlone, permitted_fruit_contacts
from hplan.scene.hanging_point import HangingPoint
from hplan.scene.limb_depths import limb_neighbours, permitted_limb_contacts
from hplan.scene.limb_parts import PermittedContacts, Pushables, divide_limbs, hanging_fruits, pendulum_stiffness
from hplan.scene.limbs import Limbs
from hplan.scene.limits import Size, Vector
from hplan.scene.neighbour_rooms import NeighbourRooms
from hplan.scene.obstacle_kind import ContactLimit, Convex, Name, Sigma, Solid
from hplan.scene.obstacles import Capsule, Obstacle, Sphere
from hplan.scene.wood import DAMPING_RATIO, GRAVITY, IMPACT_FACTOR, MOST_SWING, Wood, limits_by_segment

_T = TypeVar("_T")

#: Number of scenes whose limbs are kept.
_KEPT: Final = 8


def contact_solids(
    obstacles: Sequence[Obstacle], fruits: Sequence[Fruit], wood: Wood
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
    key = len(fruits), wood
    return _kept(_KNOWN_SOLIDS, (*obstacles, *fruits), key, lambda: _contact_solids(obstacles, fruits, wood))


#: Kept results by the identities of obstacles and fruits; they hold these, so that no id is used for another object.
_Kept: TypeAlias = dict[tuple[tuple[int, ...], Hashable], tuple[Any, _T]]
_KNOWN_SOLIDS: Final[_Kept[Mapping[str, tuple[Solid, ...]]]] = {}
_KNOWN_LIMBS: Final[_Kept[Limbs]] = {}


def _kept(known: _Kept[_T], items: tuple[Any, ...], key: Hashable, make: Callable[[], _T]) -> _T:
    """The kept result for some items and a key, or a new one."""
    whole = tuple(map(id, items)), key
    found = known.get(whole)
    if found is None:
        found = known[whole] = items, make()
        while len(known) > _KEPT:
            known.pop(next(iter(known)), None)
    return found[1]


def limbs_of(obstacles: Sequence[Obstacle], wood: Wood) -> Limbs:
    """Limbs among the obstacles of a scene.

    Obstacles that move or sway are none, nor is what grows from them: a push would bend them as well.
    """
    radius, moving = wood.clamp_radius, {piece.name for piece in obstacles if not piece.is_static}
    parents = {piece.name: piece.parent for piece in obstacles if isinstance(piece, Capsule)} if moving else {}
    while more := {name for name, parent in parents.items() if parent in moving} - moving:
        moving |= more
    pieces = tuple(piece for piece in obstacles if _is_still_capsule(piece) and piece.name not in moving)
    return _kept(_KNOWN_LIMBS, pieces, radius, lambda: Limbs.of(pieces, radius))


def _is_still_capsule(piece: Any) -> TypeGuard[Capsule]:
    return isinstance(piece, Capsule) and piece.is_static


def _contact_solids(obstacles: Sequence[Obstacle], fruits: Sequence[Fruit], wood: Wood) -> dict[str, tuple[Solid, ...]]:
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
    limits, slowest = limits_by_segment(limbs, wood), dict[int, float]()
    for segment, rate in zip(hanging.segment.tolist(), decays, strict=True):
        slowest[roots[segment]] = min(rate, slowest.get(roots[segment], math.inf))
    parts, stiffness = divide_limbs(limbs, wood), pendulum_stiffness(hanging).tolist()
    for pushables, table in zip((parts, hanging), _permitted(parts, limbs, hanging, stiff, wood), strict=True):
        for row, name in enumerate(pushables.names):
            depth, segment = float(table.depth[row]), int(pushables.segment[row])
            low, high = pushables.along[row].tolist()
            swing = float(pushables.swing[row])
            point, decay, most_force = None, slowest.get(roots[segment], math.inf), float(limits.force[segment])
            modulus = float(limits.softest[segment]), float(limits.stiffest[segment])
            if swing > 0.0:
                stalk = pushables.stiff_axis[row]
                pendulum = (np.eye(3) - np.outer(stalk, stalk)) / stiffness[row]
                point = HangingPoint(limbs, segment, low, pendulum, modulus)
                decay, most_force = decays[row], wood.of(name).fruit_force
            limit = ContactLimit(
                depth, float(table.force[row]), float(table.stress[row]), segment, roots[segment], (low, high),
                *_impact(limbs, segment, swing, float(pushables.mass[row]), carried.get(roots[segment], 0.0), wood),
                most_force, float(limits.stress[segment]), point, decay, wood.capture_range,
                float(table.pressed[row]), float(pushables.mass[row]), table.roots[row], table.fruits[row],
            )  # fmt: skip
            given = {"name": name, "radius": float(pushables.radius[row]), "sigma": whole[name].sigma, "yields": depth}
            solid = _solid_about(table.cores[row], given)
            found.setdefault(name, (whole[name].met_by("others"),))
            found[name] += (solid.met_by("pushing", limit),)
    for name, solids in found.items():
        if not any(solid.yields for solid in solids):  # rigid, whatever hangs from it
            found[name] = as_rigid(solids)
    return found


def _permitted(
    parts: Pushables, limbs: Limbs, hanging: Pushables, stiff: Sequence[Solid], wood: Wood
) -> tuple[PermittedContacts, PermittedContacts]:
    """Permitted contacts with parts of limbs, and with fruit."""
    of_limbs, alone = limb_neighbours(parts, limbs, hanging, stiff, wood), FruitsAlone.of(hanging)
    of_fruit = alone.neighbours(hanging, limbs, stiff, wood)
    rooms = NeighbourRooms(parts, limbs, of_limbs, alone, of_fruit)
    near = rooms.find(of_limbs.near, of_limbs.by_segment, of_limbs.by_fruit)
    near_fruit = rooms.find(of_fruit, np.full(len(of_fruit.gap), -1), of_fruit.pushable)
    return (
        permitted_limb_contacts(parts, of_limbs, *near, limbs, hanging, wood),
        permitted_fruit_contacts(hanging, alone, *near_fruit),
    )


class RoundedHull(Convex):
    """The hull of some points, grown by a radius.

    Attributes:
        name: Name of the limb or fruit.
        points: The points [m].
        radius: The radius [m].
        sigma: Standard deviation of each coordinate of its position [m].
    """

    name: Name
    points: tuple[Vector, ...]
    radius: Size
    sigma: Sigma = 0.0

    @property
    def core(self) -> FloatArray:
        """(k, 3) the points [m]."""
        return np.array(self.points)

    @property
    def rounding(self) -> float:
        """The radius [m]."""
        return self.radius


def _solid_about(core: FloatArray, given: dict[str, Any]) -> Convex:
    """Solid about the hull of (n, 3) core points [m], with fields that are given."""
    points = [tuple(point) for point in core.tolist()]
    if len(points) == 2:
        return _PART.copy_unchecked(given | {"start": points[0], "end": points[1]})
    return _HULL.copy_unchecked(given | {"points": tuple(points)})


def as_rigid(solids: tuple[Solid, ...]) -> tuple[Solid, ...]:
    """The solids of a limb or hung fruit that nothing may push; its limit is kept."""
    whole: Any = solids[0]
    return (whole.met_by("all", solids[-1].contact_limit),)


def _decay_rates(limbs: Limbs, hanging: Pushables, wood: Wood) -> list[float]:
    """(k,) minimum rates at which swinging fruit come to rest, limbs included [1/s].

    The first frequency is at least that of Dunkerley's formula: the squared periods of all fruit on a limb, each alone
    on the softest wood, and of the pendulum add up.
    """
    found, roots = list[float](), limbs.roots()
    softest = limits_by_segment(limbs, wood).softest[hanging.segment, None, None]
    compliance = limbs.compliance_along(hanging.segment, hanging.along[:, 0])[0] / softest
    squared = hanging.mass * np.linalg.eigvalsh(compliance)[:, -1] if len(hanging.names) else np.zeros(0)
    for row, segment in enumerate(hanging.segment.tolist()):
        root = int(roots[segment])
        limb = float(squared[roots[hanging.segment] == root].sum()) if root >= 0 else 0.0
        pendulum = float(hanging.depth[row]) / MOST_SWING / GRAVITY
        found.append(DAMPING_RATIO / math.sqrt(limb + pendulum))
    return found


#: Solids are copies of these: checked ones take ten times as long.
_PART: Final = Capsule(name="part", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 1.0), radius=1.0)
_HULL: Final = RoundedHull(name="hull", points=((0.0, 0.0, 0.0),), radius=1.0)


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
    radius, stiffest = float(limbs.radius[segment]), float(limits_by_segment(limbs, wood).stiffest[segment])
    rigidity = stiffest * 0.25 * math.pi * radius**4
    per_length = wood.density * math.pi * radius**2
    impedance = wood.contact_stiffness ** (1.0 / 3.0) * 2.0 * rigidity ** (1.0 / 6.0) * math.sqrt(per_length)
    stress = 2.0 * IMPACT_FACTOR * math.sqrt(stiffest * wood.density)
    force = IMPACT_FACTOR * impedance + math.sqrt(wood.contact_stiffness * carried)
    return force, stress, 0.0, wood.contact_stiffness / impedance
