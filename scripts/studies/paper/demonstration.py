"""The paper's workspace demonstration: a ball in the middle of 21 layers."""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import IntArray
from hplan.search.grid import Grid, Occupancy

# All in the paper's unit.
DEMO_SIZE = (60.0, 60.0)
DEMO_LAYERS = (5.0, 25.0)
DEMO_CENTRE = (30.0, 30.0, 15.0)
DEMO_DIAMETER = 15.0
DEMO_START = (5.0, 10.0, 5.0)
DEMO_GOAL = (55.0, 50.0, 25.0)


def demonstration() -> tuple[Occupancy, IntArray, IntArray]:
    """The paper's workspace demonstration: grid, start and goal node."""
    lower = (0.0, 0.0, DEMO_LAYERS[0])
    upper = (*DEMO_SIZE, DEMO_LAYERS[1])
    grid = Grid.over(lower, upper, 1.0)
    mesh = np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)
    inside = np.linalg.norm(mesh - np.array(DEMO_CENTRE), axis=-1) <= 0.5 * DEMO_DIAMETER
    return Occupancy.from_mask(grid, inside), grid.nearest(DEMO_START), grid.nearest(DEMO_GOAL)
