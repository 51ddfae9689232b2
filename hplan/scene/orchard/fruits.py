"""Placement of fruit: touching wood, not inside it, without overlap.

A fruit of radius r touches a capsule of radius w if its centre is r + w from the capsule's axis. Centres are multiples
of 0.1 mm, for short scene files; so touching fruit is placed 0.1 mm further out, and the gap is 0 to 0.2 mm.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from hplan.base.arguments import check_between, check_integer, instance, list_of
from hplan.base.arrays import FloatArray
from hplan.errors import OptionError
from hplan.scene.fruit import Fruit
from hplan.scene.model import is_trellis
from hplan.scene.obstacles import Capsule, Obstacle
from hplan.scene.orchard.options import FruitZone, OrchardOptions
from hplan.scene.orchard.wood import DECIMALS

#: Gap larger than the rounding error [m].
_GAP = 1e-4

#: Number of consecutive failed placements after which the zone counts as full.
_FAILED_PLACEMENTS = 3000

_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(eq=False)
class Canopy:
    """Wood with the fruit placed on it.

    Attributes:
        wood: Wood, an obstacle for fruit.
        radius: Radius of every fruit [m].
        zone: Zone of the fruits' centres.
        centers: (3,) centres of the placed fruit [m].
    """

    wood: Sequence[Capsule]
    radius: float
    zone: FruitZone
    centers: list[FloatArray] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Convert the capsules to arrays."""
        self._start = np.array([capsule.start for capsule in self.wood]).reshape(-1, 3)
        self._along = np.array([capsule.end for capsule in self.wood]).reshape(-1, 3) - self._start
        self._square = np.maximum(np.einsum("ij,ij->i", self._along, self._along), 1e-18)
        self._radius = np.array([capsule.radius for capsule in self.wood])

    def wood_distances(self, point: FloatArray) -> FloatArray:
        """(capsules,) signed distances of a point from the capsules' surfaces [m].

        Negative inside.
        """
        offset = point - self._start
        fraction = np.clip(np.einsum("ij,ij->i", offset, self._along) / self._square, 0.0, 1.0)
        distances: FloatArray = np.linalg.norm(offset - fraction[:, None] * self._along, axis=1) - self._radius
        return distances

    def depth(self, center: FloatArray) -> float:
        """Penetration depth of a fruit in the wood [m].

        Infinite outside the zone or in another fruit.
        """
        if not self.zone.holds(*center.tolist()):
            return math.inf
        if self.centers and np.linalg.norm(np.array(self.centers) - center, axis=1).min() < 2.0 * self.radius:
            return math.inf
        return self.radius - float(self.wood_distances(center).min(initial=math.inf))

    def fruits(self, picked: Sequence[int] = ()) -> tuple[Fruit, ...]:
        """Return the fruit, numbered from the base's axis outwards.

        Fruits whose number is in `picked` are then removed, and the rest is renumbered.
        """
        places = sorted((center.tolist() for center in self.centers), key=lambda p: (math.hypot(p[0], p[1]), *p))
        places = [place for number, place in enumerate(places, start=1) if number not in picked]
        digits = max(2, len(str(len(places))))
        return tuple(
            Fruit(name=f"fruit {number:0{digits}d}", center=(x, y, z), radius=self.radius)
            for number, (x, y, z) in enumerate(places, start=1)
        )


def hang_fruits(wood: Sequence[Capsule], options: OrchardOptions, random: np.random.Generator) -> tuple[Fruit, ...]:
    """Place fruit under branches, arms and shoots at random, uniform in length.

    Args:
        wood: Wood that fruit must not penetrate; trunks, wires and posts, recognized by name, bear no fruit.
        options: Number of fruits, their zone, and the numbers of picked ones.
        random: Random number generator.

    Raises:
        OptionError: The zone has no room for this number of fruits.
    """
    count, radius = options.fruits, options.fruit_radius
    bearing = [capsule for capsule in wood if _bears(capsule)]
    canopy = Canopy(wood, radius, options.fruit_zone)
    ends = np.cumsum([0.0, *(math.dist(capsule.start, capsule.end) for capsule in bearing)])
    misses = 0
    while bearing and len(canopy.centers) < count and misses < _FAILED_PLACEMENTS:
        place, gap, lean = random.random(3)
        piece = int(np.clip(np.searchsorted(ends, place * ends[-1], side="right") - 1, 0, len(bearing) - 1))
        start, end = bearing[piece].core
        fraction = (place * ends[-1] - ends[piece]) / (ends[piece + 1] - ends[piece])
        under = _rotate_about(_downward_normal(end - start), end - start, (lean - 0.5) * math.pi / 2.0)
        touching = start + fraction * (end - start) + (bearing[piece].radius + radius + _GAP) * under
        center = np.round(touching + gap * options.stem * _DOWN, DECIMALS)
        if canopy.depth(center) <= 0.0:
            canopy.centers.append(center)
            misses = 0
        else:
            misses += 1
    if len(canopy.centers) < count:
        raise OptionError("fruits", count, f"at most {len(canopy.centers)}, for which there was room in the zone")
    return canopy.fruits(options.picked)


def fruit_at_tips(
    capsules: Sequence[Capsule],
    count: int,
    radius: float = 0.04,
    seed: int = 0,
    *,
    zone: FruitZone | None = None,
) -> tuple[Fruit, ...]:
    """Place fruit at the tips of branches, each touching its branch.

    A tip is the far end of a capsule that lies in no other capsule; capsules named trunk, wire or post have no tip. In
    an order shuffled by the seed, every tip gets a fruit straight ahead or, if other wood is there, lower or to a side.
    If there are fewer tips than fruits, further fruits hang behind the first, under the branches. Only if all free
    places are taken are fruits placed with minimum penetration into wood.

    Args:
        capsules: The wood.
        count: Number of fruits.
        radius: Radius of a fruit [m].
        seed: Seed of the order of tips.
        zone: Zone of the fruits' centres; None for anywhere.

    Returns:
        Fruits `fruit 01`, `fruit 02`, ..., numbered from the base's axis outwards; no two overlap.

    Raises:
        OptionError: A value is out of range, or there is no room for this number of fruits.
    """
    count = check_integer("count", count, 0, 10_000)
    radius = check_between("radius", radius, 1e-3, 1.0)
    seed = check_integer("seed", seed, 0)
    capsules = list_of("capsules", capsules, Capsule, "capsules")
    canopy = Canopy(capsules, radius, FruitZone() if zone is None else instance("zone", zone, FruitZone))
    tips = _tips(canopy)
    order = np.argsort(np.random.default_rng(seed).random(len(tips)), kind="stable")
    taken: set[tuple[int, int]] = set()
    spots = 1 + max((int(_length(capsule) / _spacing(radius)) for capsule in tips), default=0)
    for deepest in (0.0, radius):
        for spot in range(spots):
            for number in order:
                if len(canopy.centers) == count:
                    return canopy.fruits()
                if (number, spot) in taken:
                    continue
                depth, place = _shallowest(canopy, _places(tips[number], spot, radius))
                if depth <= deepest:
                    canopy.centers.append(place)
                    taken.add((number, spot))
    if len(canopy.centers) < count:
        raise OptionError("count", count, f"at most {len(canopy.centers)}, for which there was room at these branches")
    return canopy.fruits()


def attach_fruits(fruits: Sequence[Fruit], wood: Sequence[Obstacle], within: float) -> tuple[Fruit, ...]:
    """Attach fruits to all bearing wood within a distance [m]."""
    bearing = [piece for piece in wood if isinstance(piece, Capsule) and _bears(piece)]
    canopy = Canopy(bearing, 0.0, FruitZone())
    near = [canopy.wood_distances(np.array(fruit.center)) <= fruit.radius + within for fruit in fruits]
    return tuple(
        fruit.copy_unchecked({"hangs_from": tuple(bearing[number].name for number in np.flatnonzero(which))})
        for fruit, which in zip(fruits, near, strict=True)
    )


def _shallowest(canopy: Canopy, places: Iterable[FloatArray]) -> tuple[float, FloatArray]:
    """First collision-free place, else the one with minimum depth.

    Returns:
        Depth, at least 0 [m], and place.
    """
    best = math.inf, _DOWN
    for place in places:
        depth = max(canopy.depth(place), 0.0)
        if depth < best[0]:
            best = depth, place
        if depth == 0.0:
            break
    return best


def _bears(capsule: Capsule) -> bool:
    return not is_trellis(capsule.name) and "trunk" not in capsule.name.lower().split()


def _length(capsule: Capsule) -> float:
    return math.dist(capsule.start, capsule.end)


def _spacing(radius: float) -> float:
    """Distance of neighbouring fruits along a branch [m]."""
    return 2.0 * radius + 4.0 * _GAP


def _tips(canopy: Canopy) -> list[Capsule]:
    """Capsules that bear fruit and end outside other wood."""
    tips = []
    for index, capsule in enumerate(canopy.wood):
        others = np.delete(canopy.wood_distances(np.array(capsule.end)), index)
        if _bears(capsule) and _length(capsule) > 0.0 and others.min(initial=math.inf) > 0.0:
            tips.append(capsule)
    return tips


def _places(capsule: Capsule, spot: int, radius: float) -> Iterator[FloatArray]:
    """Iterate over centres that touch a branch, best first.

    Spot 0 is at the tip, others are further back.
    """
    start, end = capsule.core
    along = (end - start) / _length(capsule)
    back = spot * _spacing(radius)
    if back > _length(capsule):
        return
    away = capsule.radius + radius + _GAP
    beneath = _downward_normal(along)
    # At a tip any direction is allowed that does not point back along the branch; behind it only perpendicular ones.
    for slope in np.radians([90.0, 60.0, 30.0, 0.0] if spot == 0 else [0.0]):
        for turn in np.radians([0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0]):
            across = _rotate_about(beneath, along, turn)
            yield np.round(end - back * along + away * (math.sin(slope) * along + math.cos(slope) * across), DECIMALS)


def _downward_normal(along: FloatArray) -> FloatArray:
    """Most downward unit vector perpendicular to a direction.

    +x for a vertical direction.
    """
    along = along / np.linalg.norm(along)
    across = _DOWN - (_DOWN @ along) * along
    norm = float(np.linalg.norm(across))
    return across / norm if norm > 1e-6 else np.array([1.0, 0.0, 0.0])


def _rotate_about(across: FloatArray, along: FloatArray, angle: float) -> FloatArray:
    """Rotate a perpendicular unit vector about a direction."""
    along = along / np.linalg.norm(along)
    turned: FloatArray = math.cos(angle) * across + math.sin(angle) * np.cross(along, across)
    return turned
