"""Allocates fruits to arms, to minimize the finishing time and mutual waiting.

The duration of an arm's tour is computed from the costs of its motions. Starting from the fruits nearest to each arm,
or the lowest ones, fruits are moved to another arm or exchanged as long as this reduces the finishing time of all. If
two arms would be close to each other at two fruits, one may have to wait: the expected waiting time grows with the
fraction of such pairs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.planning.cell import Cell, between
from hplan.tour.ordering import Costs, along, best

#: Proximity of an arm at a fruit to another arm at another fruit: 0 if far, 1 for contact.
Nearness: TypeAlias = Mapping[tuple[str, str, str, str], float]


@dataclass(frozen=True, eq=False)
class Share:
    """Allocation of fruits to an arm, with its known motion costs.

    Attributes:
        grasps: (k, dof) configurations at each fruit that the arm can reach.
        costs: Costs between them, in this order.
        order: Names of the allocated fruits, in picking order.
        more_s: Excess of the actual duration over the costs [s].
    """

    grasps: Mapping[str, FloatArray]
    costs: Costs
    order: tuple[str, ...] = ()
    more_s: float = 0.0

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Index of each fruit in the costs."""
        return {fruit: number for number, fruit in enumerate(self.grasps)}

    @cached_property
    def seconds(self) -> float:
        """Duration of the tour [s]."""
        return self._seconds(self.order)

    @cached_property
    def gains_s(self) -> dict[str, float]:
        """Approximate time saved without each allocated fruit, or with another one [s].

        Adding a fruit saves a negative time.
        """
        order, gains = self.order, dict[str, float]()
        for fruit in self.grasps:
            if fruit in order:
                others = [tuple(each for each in order if each != fruit)]
            else:
                others = [(*order[:at], fruit, *order[at:]) for at in range(len(order) + 1)]
            gains[fruit] = self.seconds - min(map(self._seconds, others))
        return gains

    def over(self, fruits: Collection[str]) -> Share:
        """Allocation of other fruits, in their optimal order."""
        order = [fruit for fruit in dict.fromkeys((*self.order, *self.grasps)) if fruit in fruits]
        if order:
            costs = self.costs.over([self.numbers[fruit] for fruit in order])
            places = best(costs, np.arange(len(order)), kicked=False).places
            order = [order[number] for number in costs.fruit_of[places].tolist()]
        return replace(self, order=tuple(order))

    def _seconds(self, order: Sequence[str]) -> float:
        return self.more_s + along(self.costs, [self.numbers[fruit] for fruit in order]).cost


def nearness(cell: Cell, shares: Mapping[str, Share]) -> Nearness:
    """Proximity of the arms to each other at their reachable fruits."""
    found = dict[tuple[str, str, str, str], float]()
    # Distance below which arms are expected to block each other [m].
    far = 0.3
    for a, b in itertools.combinations(shares, 2):
        pairs = itertools.product(shares[a].grasps.items(), shares[b].grasps.items())
        for (f, ours), (g, theirs) in pairs:
            q = cell.configuration({a: np.repeat(ours, len(theirs), axis=0), b: np.tile(theirs, (len(ours), 1))})
            found[a, f, b, g] = float(np.clip(1.0 - between(cell, q, a, [b]) / far, 0.0, 1.0).mean())
    return found


def first_share(cell: Cell, able: Mapping[str, Sequence[str]], lowest: Sequence[str] = ()) -> dict[str, list[str]]:
    """Initial allocation with about the same number of fruits per arm.

    Each arm gets the fruits near it or, if `lowest` is given, the first of these arms gets the lowest fruits.

    Args:
        cell: The workcell.
        able: Arms that can pick each fruit, nearest first.
        lowest: Names of the arms; empty to allocate by distance.
    """
    bases = {arm.name: np.array(arm.position) for arm in cell.scene.robots}
    shares: dict[str, list[str]] = {name: [] for name in bases}
    shared = []
    for fruit in cell.scene.fruits:
        names = sorted(able[fruit.name], key=lowest.index) if lowest else list(able[fruit.name])
        if len(names) == 1:
            shares[names[0]].append(fruit.name)
        elif names:
            near, far = (float(np.linalg.norm(fruit.center - bases[name])) for name in names[:2])
            shared.append((round(fruit.center[2] if lowest else near - far, 6), fruit.name, names))
    most = math.ceil((len(shared) + sum(map(len, shares.values()))) / len(shares))
    for _, fruit_name, names in sorted(shared):  # fruits with the clearest preference are allocated first
        with_room = [name for name in names if len(shares[name]) < most]
        shares[(with_room or names)[0]].append(fruit_name)
    return shares


def exchanged(shares: Mapping[str, Share], near: Nearness, weight: float) -> dict[str, Share]:
    """Improve an allocation by moving or exchanging fruits between arms.

    Args:
        shares: Allocation of each arm, by name.
        near: Proximity of the arms to each other.
        weight: Fraction of the time that arms wait if they always block each other.
    """
    found = dict(shares)
    # Maximum number of changes evaluated, the most promising first.
    most = 32

    def ends(seconds: Mapping[str, float], fruits: Mapping[str, Collection[str]]) -> tuple[float, float]:
        in_the_way = 0.0
        for a, b in itertools.combinations(fruits, 2):
            met = sum(near[a, f, b, g] for f in fruits[a] for g in fruits[b])
            in_the_way += met / max(1, len(fruits[a]) * len(fruits[b]))
        return round(max(seconds.values()) * (1.0 + weight * in_the_way), 6), round(sum(seconds.values()), 6)

    def changes() -> list[tuple[tuple[float, float], dict[str, list[str]]]]:
        """Estimated finishing times after each change, with the changed allocations."""
        seconds = {n: share.seconds for n, share in found.items()}
        fruits = {n: share.order for n, share in found.items()}
        promised = []
        for a, b in itertools.permutations(found, 2):
            swaps = ([], *([g] for g in found[b].order if a < b and g in found[a].grasps))
            for f, swap in itertools.product((f for f in found[a].order if f in found[b].grasps), swaps):
                after = {
                    a: [*(each for each in fruits[a] if each != f), *swap],
                    b: [*(each for each in fruits[b] if each not in swap), f],
                }
                then = {n: seconds[n] - sum(found[n].gains_s[each] for each in (f, *swap)) for n in after}
                promised.append((ends(seconds | then, {**fruits, **after}), after))
        return sorted(promised, key=lambda change: change[0])[:most]

    def end(shares: Mapping[str, Share]) -> tuple[float, float]:
        return ends({n: share.seconds for n, share in shares.items()}, {n: share.order for n, share in shares.items()})

    def changed(change: Mapping[str, Collection[str]]) -> dict[str, Share]:
        return found | {name: found[name].over(fruits) for name, fruits in change.items()}

    while True:
        now = end(found)
        trials = [change for promised, change in changes() if promised < now]
        better = next((trial for trial in map(changed, trials) if end(trial) < now), None)
        if better is None:
            return found
        found = better
