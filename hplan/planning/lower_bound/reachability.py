r"""Which cells a motion can be in at equally spaced times: more than there are, and never fewer.

Cells are as large as joints can move at full speed from one sample to the next, so that from cell to cell a joint
changes by one at most. A cell is kept where it is not in contact whole and inside the bounds of that time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import IntArray, WordArray
from hplan.base.kernels import any_int, kernel

#: The first cell or sample, for kernels.
_FIRST = any_int(0)


class Samples(NamedTuple):
    """Bounds of the motion at its samples; cells are counted along each axis.

    Attributes:
        first: (n, 3) first cells.
        last: (n, 3) last cells.
    """

    first: IntArray
    last: IntArray


@kernel
def is_reachable(free: WordArray, samples: Samples) -> bool:
    """True if some sequence of cells leads from the first sample to the last.

    Args:
        free: (nx, ny, words) bits of cells not in contact whole, those of the first axis in each row.
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
    """Add the neighbours of the cells of the sample before k, in place."""
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
    """Clear the cells that are not in the bounds of sample k, or in contact whole; true if any are left.

    Args:
        states: (nx, ny, words) the cells.
        free: Bits of cells not in contact whole.
        samples: Bounds.
    """
    first, last = samples
    window = np.zeros(states.shape[2], dtype=np.uint64)
    for cell in range(first[k, 0], last[k, 0] + 1):
        window[cell >> 6] |= np.uint64(1) << np.uint64(cell & 63)
    # Cells of the first sample are sought among all, those of the others among neighbours.
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
    """Unite each row from low to high with those before and after it, in columns from begin to end."""
    for i in range(low, high):
        for w in range(begin, end):
            rows[i, w] |= rows[i + 1, w]
    for i in range(high, low, -1):
        for w in range(begin, end):
            rows[i, w] |= rows[i - 1, w]


@kernel
def _widen(row: WordArray) -> None:
    """Unite the bits of a row with those before and after them."""
    one, last, below = np.uint64(1), np.uint64(63), np.uint64(0)
    for w in range(len(row)):
        value = row[w]
        above = row[w + 1] << last if w + 1 < len(row) else np.uint64(0)
        row[w] = value | value << one | value >> one | below | above
        below = value >> last
