"""Set cover, exactly: the stops from which all fruit can be picked, and which of them picks what."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import LinearConstraint, milp
from scipy.sparse import coo_array


def cover(
    costs: Sequence[Mapping[str, float]], each: float, least: int | None = None
) -> tuple[dict[int, list[str]], bool]:
    """Sets that together hold all elements that any holds, at the least cost.

    One integer program: set i is taken (y_i), element f by set i (x_fi <= y_i), every element once.

    Args:
        costs: For each set what it costs to take each of its elements in it.
        each: What a set costs; infinite for as few sets as can be, the costs of their elements deciding among those.
        least: How many elements have to be taken at least, of as many as there are; None for all.

    Returns:
        Numbers of the sets and the elements that each takes, in the order of the set; and whether that is shown to be
        the best.
    """
    pairs = [(i, name, cost) for i, held in enumerate(costs) for name, cost in held.items()]
    names = list(dict.fromkeys(name for _, name, _ in pairs))
    if not names or (least is not None and least <= 0):
        return {}, True
    sets, count = len(costs), len(pairs)
    number = {name: n for n, name in enumerate(names)}
    element = np.array([number[name] for _, name, _ in pairs])
    owner = np.array([i for i, _, _ in pairs])
    weights = np.array([cost for _, _, cost in pairs])
    if math.isinf(each):  # so small in all that one set less is worth more
        each, weights = 1.0, weights * (0.5 / max(1e-9, len(names) * weights.max()))
    column, one = sets + np.arange(count), np.ones(count)
    taken = coo_array((one, (element, column)), (len(names), sets + count))
    rows = np.tile(np.arange(count), 2)
    within = coo_array((np.r_[one, -one], (rows, np.r_[column, owner])), (count, sets + count))
    enough = coo_array((one, (np.zeros(count, dtype=int), column)), (1, sets + count))
    least = len(names) if least is None else min(least, len(names))
    found = milp(
        np.r_[np.full(sets, each), weights],
        integrality=np.r_[np.ones(sets), np.zeros(count)],
        bounds=(0.0, 1.0),
        constraints=[
            LinearConstraint(taken.tocsr(), 0.0 if least < len(names) else 1.0, 1.0),
            LinearConstraint(within.tocsr(), -np.inf, 0.0),
            LinearConstraint(enough.tocsr(), float(least), np.inf),
        ],
        # How long the solver may look for a better cover [s].
        options={"time_limit": 60.0},
    )
    if found.x is None:  # no time for any: sets as they come
        best: dict[str, tuple[float, int]] = {}
        for i, name, cost in pairs:
            best[name] = min(best.get(name, (math.inf, 0)), (cost, i))
        return _by_set({name: i for name, (_, i) in best.items()}, costs), False
    most: dict[str, tuple[float, int]] = {}
    for (i, name, _), part in zip(pairs, found.x[sets:].tolist(), strict=True):
        if part > max(1e-6, most.get(name, (0.0, 0))[0]):
            most[name] = part, i
    return _by_set({name: i for name, (_, i) in most.items()}, costs), found.status == 0


def _by_set(owner: Mapping[str, int], costs: Sequence[Mapping[str, float]]) -> dict[int, list[str]]:
    chosen = {i: [name for name in held if owner.get(name) == i] for i, held in enumerate(costs)}
    return {i: names for i, names in chosen.items() if names}
