"""Finds the link and obstacle pairs that block a path.

They bound the region reached from the start if no path exists.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hplan.base.arrays import BoolArray
from hplan.planar.grid.grid import Grid
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.grid.sections import ArmSections, meeting_pairs, select_sections
from hplan.planar.planar_family import PlanarArm


def blockers(arm: PlanarArm, sections: ArmSections, grid: Grid, reached: BoolArray) -> list[dict[str, Any]]:
    """Link and obstacle pairs that occupy the reached region's border.

    The largest share is first.

    Args:
        reached: Mask of the grid's shape, True for nodes connected to the start.

    Returns:
        For each pair `obstacle`, `link`, `cells` (occupied border nodes) and `slices_deg` (first and last value of
        the last joint among them).
    """
    border = _dilate(reached) & ~reached
    last = np.degrees(grid.axis(len(grid.shape) - 1))
    found = []
    for link, obstacle in meeting_pairs(sections):
        link_name, obstacle_name = arm.link_names[link], sections.obstacle_names[obstacle]
        cells = occupancy(arm, select_sections(sections, link, obstacle), grid).occupied_mask & border
        count = int(cells.sum())
        if count == 0:
            continue
        slices = np.flatnonzero(cells.any(axis=tuple(range(cells.ndim - 1))))
        found.append(
            {
                "obstacle": obstacle_name,
                "link": link_name,
                "cells": count,
                "slices_deg": [round(float(last[slices[0]]), 6), round(float(last[slices[-1]]), 6)],
            }
        )
    return sorted(found, key=lambda item: -item["cells"])


def _dilate(mask: BoolArray) -> BoolArray:
    """Dilate a mask by one node, also across corners."""
    grown = mask.copy()
    for axis in range(mask.ndim):
        moved = np.moveaxis(grown, axis, 0)
        spread = moved.copy()
        spread[1:] |= moved[:-1]
        spread[:-1] |= moved[1:]
        grown = np.moveaxis(spread, 0, axis)
    return grown
