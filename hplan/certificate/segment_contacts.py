"""Contacts of a motion within its single segments, as one table, and the loads that they put on limbs and fruit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, TableArray, frozen
from hplan.scene.obstacle_kind import ContactLimit

#: A contact of a link with an obstacle within one segment of a motion.
#:
#: link, obstacle, limit: Numbers in the names and limits of `SegmentContacts`; the limit is -1 for obstacles that are
#: no part of a limb and no hanging fruit.
#: joint: Pinocchio's number of the joint that carries the link.
#: depth: Upper bound of the deflection, tracking errors included [m].
#: begin_s, end_s: The segment [s].
#: share: Upper bound of the depth as a fraction of the limit's.
#: speed: Upper bound of the speed of the link [m/s], or of that to which a contact of this depth accelerates the limb
#: or fruit, if that is less.
#: whole_depth: Upper bound of the depth in a fruit as it hangs, which is not extended along its stalk [m].
CONTACT: Final = np.dtype([
    *((name, np.int64) for name in ("link", "obstacle", "limit", "joint")),
    *((name, np.float64) for name in ("depth", "begin_s", "end_s", "share", "speed", "whole_depth")),
])  # fmt: skip

#: Fields of `ContactLimit` that loads depend on.
_LIMIT: Final = (
    *("force", "stress", "segment", "root", "impact", "impact_stress", "swing"),
    *("most_force", "most_stress", "pressed", "mass", "decay_rate"),
)


@dataclass(frozen=True)
class Push:
    """Contact of a link with a compliant obstacle.

    Attributes:
        link: Name of the link.
        obstacle: Name of the obstacle or fruit.
        depth_m: Upper bound of the deflection, tracking errors included [m].
        begin_s: No contact before this time [s].
        end_s: No contact after this time, until the next listed contact of the two [s].
        force_n: Upper bound of the force on a limb, or on the stalk of a fruit, impact included [N]; None for obstacles
            without a limb.
        stress_mpa: Upper bound of the bending stress of the limb by this contact, impact included [MPa]; None as above.
    """

    link: str
    obstacle: str
    depth_m: float
    begin_s: float
    end_s: float
    force_n: float | None = None
    stress_mpa: float | None = None


class Loads(NamedTuple):
    """Forces and stresses by contacts with limbs and hanging fruit.

    Attributes:
        row: (k,) number of each contact.
        static: (k,) upper bound of the force of the deflection [N].
        pressed: (k,) the part of it by neighbours that the limb or fruit is pressed against [N].
        impact: (k,) force that the speed adds [N].
        stress: (k,) upper bound of the static bending stress [Pa].
        impact_stress: (k,) bending stress that the speed adds [Pa].
        most_force: (k,) allowed force [N].
        most_stress: (k,) allowed bending stress [Pa].
        segment: (k,) limb segment, or the one that a fruit hangs from.
        root: (k,) first bending segment from the clamp; -1 for fruit on wood that does not bend.
        mass: (k,) mass of fruit [kg]; 0 for limbs.
        decay_rate: (k,) minimum rate at which the fruit, or all on limbs with its root, come to rest [1/s].
    """

    row: IntArray
    static: FloatArray
    pressed: FloatArray
    impact: FloatArray
    stress: FloatArray
    impact_stress: FloatArray
    most_force: FloatArray
    most_stress: FloatArray
    segment: IntArray
    root: IntArray
    mass: FloatArray
    decay_rate: FloatArray

    @property
    def is_fruit(self) -> BoolArray:
        """(k,) True for fruit."""
        return self.mass > 0.0

    @property
    def force(self) -> FloatArray:
        """(k,) upper bound of the force [N]."""
        return self.static + self.impact


class RootStresses(NamedTuple):
    """Bending stress by simultaneous contacts of limbs with one root.

    Attributes:
        order: Numbers of the `Loads`, sorted by time and root.
        first: (k,) place of the first one of each root and time there.
        stress: (k,) their bending stress, impact included [Pa].
        impact: (k,) the part of it that the speed adds [Pa].
        most: (k,) allowed bending stress [Pa].
    """

    order: IntArray
    first: IntArray
    stress: FloatArray
    impact: FloatArray
    most: FloatArray

    def loads(self, number: int) -> IntArray:
        """Numbers of the `Loads` of one root and time."""
        following = self.first[number + 1] if number + 1 < len(self.first) else len(self.order)
        return self.order[self.first[number] : following]


@dataclass(frozen=True, eq=False)
class SegmentContacts(Record):
    """Contacts within single segments of a motion, or of a sequence of motions.

    Attributes:
        rows: (n,) the contacts, of the type `CONTACT`.
        links: Names of links.
        obstacles: Names of obstacles and fruit.
        limits: Contact limits of limbs and fruit; None for other obstacles.
    """

    rows: TableArray
    links: Sequence[str]
    obstacles: Sequence[str]
    limits: Sequence[ContactLimit | None]

    @classmethod
    def none(cls) -> SegmentContacts:
        """No contacts."""
        return cls(frozen(np.zeros(0, CONTACT)), (), (), ())

    @classmethod
    def join(cls, parts: Iterable[SegmentContacts]) -> SegmentContacts:
        """All contacts of several parts, in their order."""
        some = [part for part in parts if len(part.rows)]
        if len(some) <= 1:
            return some[0] if some else cls.none()
        links, obstacles, limits = dict[str, str](), dict[str, str](), dict[int, ContactLimit | None]()
        tables = []
        for part in some:
            table = part.rows.copy()
            _renumber(table["link"], part.links, links)
            _renumber(table["obstacle"], part.obstacles, obstacles)
            of_limbs = table["limit"] >= 0
            numbers = table["limit"][of_limbs]
            _renumber(numbers, part.limits, limits, key=id)
            table["limit"][of_limbs] = numbers
            tables.append(table)
        return cls(frozen(np.concatenate(tables)), tuple(links), tuple(obstacles), tuple(limits.values()))

    def __len__(self) -> int:
        """Number of the contacts."""
        return len(self.rows)

    def shift(self, begin_s: float, *, reversed_after_s: float | None = None) -> SegmentContacts:
        """The contacts of the motion from a start time on.

        Args:
            begin_s: The start time [s].
            reversed_after_s: Duration of the motion if it is run in reverse [s].
        """
        if not len(self.rows) or (begin_s == 0.0 and reversed_after_s is None):
            return self
        rows = self.rows.copy()
        if reversed_after_s is not None:
            rows["begin_s"], rows["end_s"] = (
                reversed_after_s - self.rows["end_s"],
                reversed_after_s - self.rows["begin_s"],
            )
        for name in ("begin_s", "end_s"):
            rows[name] += begin_s
        return SegmentContacts(frozen(rows), self.links, self.obstacles, self.limits)

    def link(self, row: int) -> str:
        """Name of a contact's link."""
        return self.links[int(self.rows["link"][row])]

    def obstacle(self, row: int) -> str:
        """Name of a contact's obstacle."""
        return self.obstacles[int(self.rows["obstacle"][row])]

    @cached_property
    def loads(self) -> Loads:
        """Loads of the contacts with limbs and fruit."""
        row = np.flatnonzero(self.rows["limit"] >= 0)
        table = self.rows[row]
        used, of_row = np.unique(table["limit"], return_inverse=True)
        limits = [self.limits[number] for number in used.tolist()]
        values = np.array([[getattr(limit, name) for name in _LIMIT] for limit in limits], dtype=np.float64)
        columns = dict(zip(_LIMIT, values.reshape(-1, len(_LIMIT))[of_row].T, strict=True))
        share, speed = table["share"], table["speed"]
        impact = columns["impact"] * speed + columns["swing"] * speed**2
        return Loads(
            row, share * columns["force"], share * columns["pressed"], impact, share * columns["stress"],
            columns["impact_stress"] * speed, columns["most_force"], columns["most_stress"],
            columns["segment"].astype(np.int64), columns["root"].astype(np.int64), columns["mass"],
            columns["decay_rate"],
        )  # fmt: skip

    def displacing(self, root: int, fruit: str) -> tuple[BoolArray, BoolArray, BoolArray]:
        """Masks of the `loads` that displace a fruit, one for each kind of contact.

        The first mask is for contacts with the fruit itself. The second adds its limb and everything on that limb. The
        third is for other limbs and fruit, if they may be pressed against these.

        Args:
            root: The first bending segment of its limb from the clamp; -1 for none.
            fruit: Name of the fruit.
        """
        limits = self.limits
        presses = np.array([
            limit is not None and (root in limit.roots or fruit in limit.fruits) for limit in limits
        ], dtype=np.bool_)  # fmt: skip
        named = np.array([name == fruit for name in self.obstacles], dtype=np.bool_)
        rows = self.rows[self.loads.row]
        is_own = named[rows["obstacle"]]
        is_on = is_own | ((self.loads.root == root) & (root >= 0))
        return is_own, is_on, presses[rows["limit"]] & ~is_on

    @cached_property
    def stresses(self) -> RootStresses:
        """Bending stress of limbs with one root at one time.

        Contacts with one segment are on one side of it: their bending moment lies between those that each would cause
        alone, and the largest counts. The stresses by different segments and by fruit add up.
        """
        loads = self.loads
        bent = np.flatnonzero(loads.root >= 0)
        if not len(bent):
            return RootStresses(bent, bent, *np.zeros((3, 0)))
        begin_s = self.rows["begin_s"][loads.row[bent]]
        keys = begin_s, loads.root[bent], loads.segment[bent], loads.is_fruit[bent]
        order = np.lexsort(keys[::-1])
        changes = [np.append(True, np.diff(key[order].astype(np.float64)) != 0.0) for key in keys]
        first = np.flatnonzero(changes[0] | changes[1])
        part = np.flatnonzero(changes[0] | changes[1] | changes[2] | changes[3])
        order = bent[order]
        largest = np.maximum.reduceat(loads.stress[order], part)
        impact = np.maximum.reduceat(loads.impact_stress[order], first)
        static = np.add.reduceat(largest, np.searchsorted(part, first))
        most = np.minimum.reduceat(loads.most_stress[order], first)
        return RootStresses(order, first, static + impact, impact, most)

    @cached_property
    def merged(self) -> tuple[Push, ...]:
        """The contacts by link and obstacle, merged over time if there is no gap between; sorted by start time."""
        if not len(self.rows):
            return ()
        loads, force, stress = self.loads, np.full(len(self.rows), np.nan), np.full(len(self.rows), np.nan)
        force[loads.row], stress[loads.row] = loads.force, 1e-6 * (loads.stress + loads.impact_stress)
        places = [
            np.unique(np.array(names)[self.rows[key]], return_inverse=True)[1]
            for key, names in (("link", self.links), ("obstacle", self.obstacles))
        ]
        pair = places[0] * (int(places[1].max()) + 1) + places[1]
        order = np.lexsort((self.rows["begin_s"], pair))
        rows, pair = self.rows[order], pair[order]
        # Pairs one after the other in time, so that the maximum of one does not reach into the next.
        later = pair * (float(rows["end_s"].max()) - float(rows["begin_s"].min()) + 1.0)
        until = np.maximum.accumulate(rows["end_s"] + later)
        first = np.flatnonzero(np.append(True, rows["begin_s"][1:] + later[1:] > until[:-1]))
        columns = (
            np.maximum.reduceat(rows["depth"], first),
            rows["begin_s"][first],
            np.maximum.reduceat(rows["end_s"], first),
            *(np.fmax.reduceat(values[order], first) for values in (force, stress)),
        )
        found = [
            Push(self.link(row), self.obstacle(row), *values[:3], *(None if np.isnan(x) else x for x in values[3:]))
            for row, *values in zip(order[first].tolist(), *(column.tolist() for column in columns), strict=True)
        ]
        return tuple(sorted(found, key=lambda push: push.begin_s))


def _renumber(numbers: IntArray, items: Sequence[Any], known: dict[Any, Any], key: Any = None) -> None:
    """Replace numbers of items, in place, by those among all known ones, which they are added to."""
    used, of_each = np.unique(numbers, return_inverse=True)
    places = {each: place for place, each in enumerate(known)}
    found = []
    for item in (items[number] for number in used.tolist()):
        name = item if key is None else key(item)
        found.append(places.setdefault(name, len(places)))
        known.setdefault(name, item)
    numbers[:] = np.array(found, dtype=np.int64)[of_each] if found else numbers
