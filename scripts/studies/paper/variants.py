"""The method to the letter by everything that the paper's text leaves open."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from studies.paper.plain import RESTORATIONS, path_found, plain_two_level
from studies.paper.results import Variant
from studies.paper.ties import equal_slice_paths, try_ties

from hplan.base.arrays import IntArray
from hplan.cspace.sections import LinkModel
from hplan.search.grid import Occupancy


def try_variants(
    occupancies: Mapping[LinkModel, Occupancy],
    start: IntArray,
    goal: IntArray,
    choices: int,
    report: Callable[[str], None] = lambda _: None,
) -> tuple[Variant, ...]:
    """Run each link model with the slices up to the goal's and with all, and with both readings of the restoration.

    Args:
        occupancies: The C-space by each link model.
        start: (3,) node index.
        goal: (3,) node index.
        choices: Sets of slice paths tried for the ties, at least 2.
        report: Told what is being done.
    """
    result = []
    for link_model, occupancy in occupancies.items():
        degrees = [round(math.degrees(value)) for value in occupancy.grid.axis(2)]
        for last in (int(goal[2]), len(degrees) - 1):
            report(f"slices 0..{degrees[last]} deg, link model {link_model}")
            equal = None
            for restoration in RESTORATIONS:
                run = plain_two_level(occupancy, start, goal, last_slice=last, restoration=restoration)
                equal = equal or equal_slice_paths(occupancy, run, start, goal, choices)
                result.append(
                    Variant(
                        link_model=link_model,
                        last_slice_deg=degrees[last],
                        restoration=restoration,
                        cost_deg=math.degrees(run.second.cost),
                        points=len(path_found(run.second)),
                        layer_expansions=sum(run.expansions.values()),
                        path_expansions=run.second.expansions.total,
                        sparse_nodes=int(run.union.sum()),
                        ties=try_ties(occupancy, equal, start, goal, restoration),
                    )
                )
    return tuple(result)
