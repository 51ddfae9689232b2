"""The nodes that a search may use, numbered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.arrays import IntArray, ShortArray, WordArray
from hplan.kernels import kernel
from hplan.search.bits import popcount


@dataclass(frozen=True, eq=False)
class NodeSet:
    """Set bits, numbered in their order.

    Attributes:
        words: (rows, words) bits with border.
        rows: (k,) rows with set bits, ascending.
        ranks: (rows, words) number of the first node of each word; written for rows with set bits only.
        size: Number of nodes.
    """

    words: WordArray
    rows: IntArray
    ranks: ShortArray
    size: int

    @classmethod
    def of(cls, words: WordArray) -> NodeSet:
        """The nodes of (rows, words) bits."""
        rows, ranks, size = _numbered(words)
        return cls(words, rows, ranks, int(size))


@kernel
def _numbered(words: WordArray) -> tuple[IntArray, ShortArray, int]:
    """Rows with set bits, the number of set bits before each of their words, and in all."""
    ranks = np.empty(words.shape, dtype=np.int32)
    rows = np.empty(words.shape[0], dtype=np.int64)
    count, size = 0, 0
    for row in range(words.shape[0]):
        bits = np.uint64(0)
        for word in range(words.shape[1]):
            bits |= words[row, word]
        if bits == np.uint64(0):
            continue
        rows[count] = row
        count += 1
        for word in range(words.shape[1]):
            ranks[row, word] = size
            size += popcount(words[row, word])
    return rows[:count].copy(), ranks, size
