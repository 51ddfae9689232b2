"""Exact set cover: minimum-cost stops for all fruit, and their assignment."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import LinearConstraint, milp
from scipy.sparse import coo_array


def cover(
    costs: Sequence[Mapping[str, float]], each: float, least: int | None = None
) -> tuple[dict[int, list[str]], bool]:
    """Minimum-cost selection of sets that covers the elements.

    One integer program: set i is selected (y_i), element f is covered by set i (x_fi <= y_i), every element once.

    Args:
        costs: For each set, the cost of covering each of its elements.
        each: Cost of a set; infinite to minimize their number first, and the costs of their elements second.
        least: Minimum number of elements to cover, at most all; None for all.

    Returns:
        Indices of the selected sets and the elements that each covers, in the order of the set; and whether this is
        proved optimal.

    Examples:
        >>> cover([{"a": 1.0, "b": 1.0}, {"b": 0.5}], math.inf)
        ({0: ['a', 'b']}, True)
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
    if math.isinf(each):  # scaled so that the sum of all weights is worth less than one set
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
        # Time limit of the solver [s].
        options={"time_limit": 60.0},
    )
    if found.x is None:  # the solver found no cover in time: assign each element to its cheapest set
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
