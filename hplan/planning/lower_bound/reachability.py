r"""Superset of the reachable cells of a joint grid over time.

The times are equally spaced. Cells are as large as the joints can move at full speed from one sample to the next, so
that a joint moves by at most one cell per sample. A cell is kept if it is not entirely in contact and is within the
bounds of that time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import IntArray, WordArray
from hplan.base.kernels import any_int, kernel

#: The first cell or sample, for kernels.
_FIRST = any_int(0)


class Samples(NamedTuple):
    """Bounds of the motion at its samples, in cells along each axis.

    Attributes:
        first: (n, 3) first cells.
        last: (n, 3) last cells.
    """

    first: IntArray
    last: IntArray


@kernel
def is_reachable(free: WordArray, samples: Samples) -> bool:
    """True if cells connect the first sample with the last.

    Args:
        free: (nx, ny, words) bits of the cells not entirely in contact; the first axis is along the words.
        samples: Bounds of the motion at its samples.
    """
    states = free.copy()
    some = _keep(states, free, samples, _FIRST)
    for k in range(1, samples.first.shape[0]):
        if not some:
            return False
        _advance(states, samples, k)
        some = _keep(states, free, samples, k)
    return some


@kernel
def _advance(states: WordArray, samples: Samples, k: int) -> None:
    """Add the neighbours of sample k - 1's cells, in place."""
    first, last = samples
    _, ny, words = states.shape
    low_x, high_x = min(first[k - 1, 1], first[k, 1]), max(last[k - 1, 1], last[k, 1])
    low_y, high_y = min(first[k - 1, 2], first[k, 2]), max(last[k - 1, 2], last[k, 2])
    for x in range(first[k - 1, 1], last[k - 1, 1] + 1):
        for y in range(first[k - 1, 2], last[k - 1, 2] + 1):
            _widen(states[x, y])
        _spread(states[x], low_y, high_y, _FIRST, words)
    _spread(states.reshape(len(states), ny * words), low_x, high_x, low_y * words, (high_y + 1) * words)


@kernel
def _keep(states: WordArray, free: WordArray, samples: Samples, k: int) -> bool:
    """Clear cells out of bounds at sample k or entirely in contact.

    Args:
        states: (nx, ny, words) the cells.
        free: Bits of the cells not entirely in contact.
        samples: Bounds of the motion at its samples.
        k: Number of the sample.

    Returns:
        True if any cell is left.
    """
    first, last = samples
    window = np.zeros(states.shape[2], dtype=np.uint64)
    for cell in range(first[k, 0], last[k, 0] + 1):
        window[cell >> 6] |= np.uint64(1) << np.uint64(cell & 63)
    # The first sample starts with all cells, later ones with the neighbours of the previous sample's cells.
    low_x, high_x, low_y, high_y = 0, states.shape[0] - 1, 0, states.shape[1] - 1
    if k > 0:
        low_x, high_x = min(first[k - 1, 1], first[k, 1]), max(last[k - 1, 1], last[k, 1])
        low_y, high_y = min(first[k - 1, 2], first[k, 2]), max(last[k - 1, 2], last[k, 2])
    some = np.uint64(0)
    for x in range(low_x, high_x + 1):
        for y in range(low_y, high_y + 1):
            inside = first[k, 1] <= x <= last[k, 1] and first[k, 2] <= y <= last[k, 2]
            for w in range(len(window)):
                states[x, y, w] &= window[w] & free[x, y, w] if inside else np.uint64(0)
                some |= states[x, y, w]
    return bool(some != np.uint64(0))


@kernel
def _spread(rows: WordArray, low: int, high: int, begin: int, end: int) -> None:
    """Unite the rows low to high with their neighbours, in place."""
    for i in range(low, high):
        for w in range(begin, end):
            rows[i, w] |= rows[i + 1, w]
    for i in range(high, low, -1):
        for w in range(begin, end):
            rows[i, w] |= rows[i - 1, w]


@kernel
def _widen(row: WordArray) -> None:
    """Unite the bits of a row with their neighbours."""
    one, last, below = np.uint64(1), np.uint64(63), np.uint64(0)
    for w in range(len(row)):
        value = row[w]
        above = row[w + 1] << last if w + 1 < len(row) else np.uint64(0)
        row[w] = value | value << one | value >> one | below | above
        below = value >> last
