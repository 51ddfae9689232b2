"""Start and goal of a search, checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hplan.arrays import IntArray
from hplan.errors import InputError
from hplan.grid import Occupancy


def checked_node(occupancy: Occupancy, index: ArrayLike, which: str) -> IntArray:
    """The (d,) index of a free node.

    Raises:
        InputError: It is no node of the grid, or an occupied one.
    """
    node = np.asarray(index)
    shape = occupancy.grid.shape
    if node.shape != (len(shape),) or not np.issubdtype(node.dtype, np.integer):
        raise InputError(f"{which}: expected {len(shape)} whole numbers, got {index!r}", which=which)
    if (node < 0).any() or (node >= shape).any():
        raise InputError(
            f"{which}: node {node.tolist()} is outside the grid of shape {shape}",
            which=which,
            node=node.tolist(),
        )
    if not occupancy.is_free(node):
        raise InputError(f"{which}: node {node.tolist()} is occupied", which=which, node=node.tolist())
    return node.astype(np.int64)
