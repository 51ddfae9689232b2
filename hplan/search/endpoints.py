"""Start and goal of a search, checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import instance
from hplan.base.arrays import IntArray
from hplan.errors import InputError
from hplan.search.grid import Occupancy


def check_occupancy(occupancy: Occupancy) -> None:
    """Refuse what is none.

    Raises:
        OptionError: It is none.
    """
    instance("occupancy", occupancy, Occupancy, "Occupancy.from_mask")


def checked_node(occupancy: Occupancy, index: ArrayLike, which: str) -> IntArray:
    """The (d,) index of a free node.

    Raises:
        InputError: It is no node of the grid, or an occupied one.
    """
    check_occupancy(occupancy)
    try:
        node = np.asarray(index)
    except ValueError:  # rows of different lengths
        node = np.empty(0)
    shape = occupancy.grid.shape
    if node.shape != (len(shape),) or not np.issubdtype(node.dtype, np.integer):
        raise InputError(f"{which}: expected {len(shape)} whole numbers, got {index!r}", which=which)
    places = node.tolist()
    if not all(0 <= place < count for place, count in zip(places, shape, strict=True)):
        raise InputError(
            f"{which}: node {places} is outside the grid of shape {shape}",
            which=which,
            node=places,
        )
    if not occupancy.is_free(node):
        raise InputError(f"{which}: node {places} is occupied", which=which, node=places)
    return node.astype(np.int64)
