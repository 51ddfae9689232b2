"""Open list of the searches: a binary heap with decrease-key.

It records the slot of each node, so that a key can be lowered. The functions are inlined at their call sites: a call
with array arguments costs more than the work itself.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from hplan.base.arrays import FloatArray, IntArray, ShortArray
from hplan.base.kernels import inline

#: Arrays of nodes or slots, of either integer size.
Numbers: TypeAlias = IntArray | ShortArray

#: `slot` of a node that was never in the heap, and of a node that was removed from it.
NEW, TAKEN = -1, -2


@inline
def priority(cost: float, ahead: float, scale: float) -> float:
    """Key of a node: rounded f plus a tie-breaking fraction.

    f is rounded to 1e-10 of the total.

    The rounding makes sums of the same moves in another order tie. The fraction decreases towards the goal and decides
    ties.

    Args:
        cost: Cost from the start.
        ahead: Lower bound of the cost to the goal.
        scale: One over that bound at the start.
    """
    return math.floor((cost + ahead) * scale * 1e10 + 0.5) + min(0.9, 0.1 * ahead * scale)


@inline
def begin(keys: FloatArray, nodes: Numbers, slot: Numbers, node: int) -> int:
    """Initialize the heap with one node of key 0."""
    keys[0], nodes[0], slot[node] = 0.0, node, 0
    return 1


@inline
def pop(keys: FloatArray, nodes: Numbers, slot: Numbers, size: int) -> int:
    """Remove and return the node with the smallest key.

    `size - 1` entries remain.

    Args:
        keys: (capacity,) keys in heap order.
        nodes: (capacity,) their nodes.
        slot: Heap position of each node, `NEW` or `TAKEN`.
        size: Number of entries in the heap, at least one.
    """
    taken: int = nodes[0]
    size -= 1
    last_key, last_node = keys[size], nodes[size]
    hole = 0
    child = 1
    while child < size:
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= last_key:
            break
        keys[hole], nodes[hole] = keys[child], nodes[child]
        slot[nodes[hole]] = hole
        hole = child
        child = 2 * hole + 1
    keys[hole], nodes[hole] = last_key, last_node
    slot[last_node] = hole
    slot[taken] = TAKEN
    return taken


@inline
def push(keys: FloatArray, nodes: Numbers, slot: Numbers, size: int, key: float, node: int) -> int:
    """Insert a node, or lower its key in the heap.

    Args:
        keys: (capacity,) keys in heap order.
        nodes: (capacity,) their nodes.
        slot: Heap position of each node, `NEW` or `TAKEN`.

    Returns:
        Number of entries in the heap afterwards.
    """
    hole = slot[node]
    if hole < 0:
        hole = size
        size += 1
    while hole > 0:
        above = (hole - 1) >> 1
        if keys[above] <= key:
            break
        keys[hole], nodes[hole] = keys[above], nodes[above]
        slot[nodes[hole]] = hole
        hole = above
    keys[hole], nodes[hole] = key, node
    slot[node] = hole
    return size
