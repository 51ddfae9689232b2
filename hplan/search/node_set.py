"""The nodes that a search may use, numbered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import IntArray, ShortArray, WordArray
from hplan.base.kernels import kernel
from hplan.search.bits import popcount


@dataclass(frozen=True, eq=False)
class NodeSet:
    """Set bits, numbered row by row.

    Attributes:
        words: (rows, words) bits with border.
        rows: (k,) the rows with set bits, in the order in which they are numbered.
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
        rows = np.flatnonzero(words.any(axis=1))
        ranks, size = ranked(words, rows)
        return cls(words, rows, ranks, size)


@kernel
def ranked(words: WordArray, rows: IntArray) -> tuple[ShortArray, int]:
    """The number of set bits before each word of some rows, and in all."""
    ranks = np.empty(words.shape, dtype=np.int32)
    size = 0
    for row in rows:
        for word in range(words.shape[1]):
            ranks[row, word] = size
            size += popcount(words[row, word])
    return ranks, size
