r"""Which cells a motion can be in at equally spaced times: more than there are, and never fewer.

Of up to four joints the first has its motion from sample to sample in the state: the number of cells by which it moves
to the next one, its *move*. With cells of size :math:`h` and samples :math:`\tau` apart

- :math:`q_{k+2} - 2 q_{k+1} + q_k` is at most :math:`a \tau^2`, so moves change by less than :math:`a \tau^2 / h + 2`;
- the cells of the others change by less than :math:`V \tau / h + 1`.

A state is kept where its cell is not in contact whole and inside the bounds of that time, and where the cell that its
move leads to is inside those of the next.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, IntArray, WordArray
from hplan.base.kernels import any_int, kernel

#: The first cell or sample, and any move, for kernels.
_FIRST, _ANY = any_int(0), any_int(-1)


class Samples(NamedTuple):
    """Bounds of the motion at its samples; cells are counted along each axis.

    Attributes:
        first: (n, 4) first cells.
        last: (n, 4) last cells.
        first_of: (n, 2 m + 1) first cells of the first axis for each move, from -m to m; none before those of all.
        last_of: (n, 2 m + 1) last cells; none after those of all.
        steps: (4,) by how much the move of the first axis, and the cells of the others, can change.
    """

    first: IntArray
    last: IntArray
    first_of: IntArray
    last_of: IntArray
    steps: IntArray


@kernel
def is_reachable(free: WordArray, samples: Samples) -> bool:
    """True if some sequence of states leads from the first sample to the last.

    Args:
        free: (nx, ny, nz, words) bits of cells not in contact whole, those of the first axis in each row.
        samples: Bounds of the motion at its samples.
    """
    moves = samples.first_of.shape[1]
    states = np.zeros((moves, *free.shape), dtype=np.uint64)
    alive = np.zeros(moves, dtype=np.bool_)
    for move in range(moves):
        alive[move] = _keep(states[move], free, samples, _FIRST, move, True)
    for k in range(1, samples.first.shape[0]):
        if not alive.any():
            return False
        _advance(states, alive, free, samples, k)
    return bool(alive.any())


@kernel
def _advance(states: WordArray, alive: BoolArray, free: WordArray, samples: Samples, k: int) -> None:
    """The states of sample k from those before it, in place."""
    first, last, _, _, steps = samples
    moves, nx, ny, nz, words = states.shape
    low_x, high_x = min(first[k - 1, 1], first[k, 1]), max(last[k - 1, 1], last[k, 1])
    low_y, high_y = min(first[k - 1, 2], first[k, 2]), max(last[k - 1, 2], last[k, 2])
    low_z, high_z = min(first[k - 1, 3], first[k, 3]), max(last[k - 1, 3], last[k, 3])
    for move in range(moves):
        if alive[move]:
            block = states[move]
            for x in range(first[k - 1, 1], last[k - 1, 1] + 1):
                for y in range(first[k - 1, 2], last[k - 1, 2] + 1):
                    _spread(block[x, y], low_z, high_z, steps[3], _FIRST, words)
                rows = block[x].reshape(ny, nz * words)
                _spread(rows, low_y, high_y, steps[2], low_z * words, (high_z + 1) * words)
            rows = block.reshape(nx, ny * nz * words)
            _spread(rows, low_x, high_x, steps[1], low_y * nz * words, (high_y + 1) * nz * words)
            for x in range(low_x, high_x + 1):
                for y in range(low_y, high_y + 1):
                    for z in range(low_z, high_z + 1):
                        _shift(block[x, y, z], move - moves // 2)
            alive[move] = _keep(block, free, samples, k, _ANY, False)
    if k == first.shape[0] - 1:
        return
    for x in range(first[k, 1], last[k, 1] + 1):
        for y in range(first[k, 2], last[k, 2] + 1):
            row = (x * ny + y) * nz
            begin, end = (row + first[k, 3]) * words, (row + last[k, 3] + 1) * words
            _spread(states.reshape(moves, nx * ny * nz * words), _FIRST, moves - 1, steps[0], begin, end)
    before = alive.copy()
    for move in range(moves):
        alive[move] = before[max(0, move - steps[0]) : move + steps[0] + 1].any()
        if alive[move]:
            alive[move] = _keep(states[move], free, samples, k, move, False)


@kernel
def _keep(block: WordArray, free: WordArray, samples: Samples, k: int, move: int, fill: bool) -> bool:
    """Clear the states of one move that are not in the bounds of sample k; true if any are left.

    Args:
        block: (nx, ny, nz, words) the states.
        free: Bits of cells not in contact whole.
        samples: Bounds.
        move: Number of the move; -1 where the bounds for all moves hold.
        fill: Whether all states in the bounds that are free are set before.
    """
    first, last, first_of, last_of, _ = samples
    window = np.zeros(block.shape[3], dtype=np.uint64)
    low, high = (first[k, 0], last[k, 0]) if move < 0 else (first_of[k, move], last_of[k, move])
    for cell in range(low, high + 1):
        window[cell >> 6] |= np.uint64(1) << np.uint64(cell & 63)
    some, before = np.uint64(0), max(k - 1, 0)
    for x in range(min(first[before, 1], first[k, 1]), max(last[before, 1], last[k, 1]) + 1):
        for y in range(min(first[before, 2], first[k, 2]), max(last[before, 2], last[k, 2]) + 1):
            row = first[k, 1] <= x <= last[k, 1] and first[k, 2] <= y <= last[k, 2]
            for z in range(min(first[before, 3], first[k, 3]), max(last[before, 3], last[k, 3]) + 1):
                inside = row and first[k, 3] <= z <= last[k, 3]
                for w in range(block.shape[3]):
                    kept = window[w] & free[x, y, z, w] if inside else np.uint64(0)
                    block[x, y, z, w] = kept if fill else block[x, y, z, w] & kept
                    some |= block[x, y, z, w]
    return bool(some != np.uint64(0))


@kernel
def _spread(rows: WordArray, low: int, high: int, reach: int, begin: int, end: int) -> None:
    """Unite each row from low to high with those up to `reach` before and after it, in columns from begin to end."""
    for i in range(low, high):
        for j in range(i + 1, min(high, i + reach) + 1):
            for w in range(begin, end):
                rows[i, w] |= rows[j, w]
    for i in range(high, low, -1):
        for j in range(i - 1, max(low, i - reach) - 1, -1):
            for w in range(begin, end):
                rows[i, w] |= rows[j, w]


@kernel
def _shift(row: WordArray, by: int) -> None:
    """Move the bits of a row by a number of places, up where it is positive; those beyond its ends are lost."""
    words, whole, part = len(row), abs(by) >> 6, np.uint64(abs(by) & 63)
    rest = np.uint64(64) - part
    if by > 0:
        for w in range(words - 1, -1, -1):
            value = row[w - whole] << part if w >= whole else np.uint64(0)
            if w > whole and part:
                value |= row[w - whole - 1] >> rest
            row[w] = value
    elif by < 0:
        for w in range(words):
            value = row[w + whole] >> part if w + whole < words else np.uint64(0)
            if w + whole + 1 < words and part:
                value |= row[w + whole + 1] << rest
            row[w] = value
