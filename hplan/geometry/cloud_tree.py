"""Compiled construction of a point cloud's tree of bounding balls.

Points are sorted along a Morton curve through the cells of a bounding cube, by the interleaved bits of the three
coordinates. A node is an interval of the curve, split where its highest differing bit changes, down to small leaves.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import inline, kernel

#: Number of columns of a node, as in `hplan.geometry.cloud.Cloud`.
_NODE_COLUMNS = 7

#: Number of low bits that hold a point's index; the bits above hold its Morton code, so one sort orders both.
_NUMBER = 26


@inline
def _every_third(cell: int) -> int:
    """Spread the lowest 16 bits, with two zero bits after each."""
    bits = (cell | (cell << 16)) & 0x0000FF0000FF
    bits = (bits | (bits << 8)) & 0x00F00F00F00F
    bits = (bits | (bits << 4)) & 0x0C30C30C30C3
    return (bits | (bits << 2)) & 0x249249249249


@inline
def _bounds(points: FloatArray, first: int, last: int) -> tuple[float, float, float, float, float, float]:
    """Minimum and maximum coordinates of points[first:last]."""
    x, y, z = right, far, top = points[first, 0], points[first, 1], points[first, 2]
    for n in range(first + 1, last):  # interleaved axes: no operation waits for the previous one
        x, right = min(x, points[n, 0]), max(right, points[n, 0])
        y, far = min(y, points[n, 1]), max(far, points[n, 1])
        z, top = min(z, points[n, 2]), max(top, points[n, 2])
    return x, y, z, right, far, top


@kernel
def _sort_keys(points: FloatArray) -> IntArray:
    """Sort keys of (n, 3) points: Morton code, then `_NUMBER` index bits.

    Returns:
        (n,) keys.
    """
    x, y, z, right, far, top = _bounds(points, 0, points.shape[0])
    per_metre = 4095.0 / max(right - x, far - y, top - z, 1e-9)
    found = np.empty(points.shape[0], dtype=np.int64)
    for n in range(points.shape[0]):
        i, j, k = (points[n, 0] - x) * per_metre, (points[n, 1] - y) * per_metre, (points[n, 2] - z) * per_metre
        place = (_every_third(int(i)) << 2) | (_every_third(int(j)) << 1) | _every_third(int(k))
        found[n] = (place << _NUMBER) | n
    return found


@kernel
def _first_after(places: IntArray, first: int, last: int) -> int:
    """Split position of an interval: its highest differing bit, else the middle."""
    differ, bit, begin, end = (places[first] ^ places[last - 1]) >> _NUMBER, 1 << _NUMBER, first, last
    if differ == 0:
        return (first + last) // 2
    while differ > 1:
        differ, bit = differ >> 1, bit << 1
    while begin < end:
        middle = (begin + end) // 2
        if places[middle] & bit:
            end = middle
        else:
            begin = middle + 1
    return begin


@kernel
def _nodes(points: FloatArray, places: IntArray, leaf: int) -> FloatArray:
    count, fewest = points.shape[0], leaf // 4
    nodes = np.empty((1 + 2 * (count // fewest), _NODE_COLUMNS))
    # The stack holds the pending intervals of each node; a finished node gets the index of the next node, and its
    # bounding box is kept.
    stack, boxes = np.empty((3 * 64, 3), dtype=np.int64), np.empty((64, 6))
    stack[0] = (0, count, -1)
    height, number, done = 1, 0, 0
    while height > 0:
        height -= 1
        first, last, closes = stack[height, 0], stack[height, 1], stack[height, 2]
        if closes >= 0:
            nodes[closes, 2] = number
            done -= 1
            for axis in range(3):
                boxes[done - 1, axis] = min(boxes[done - 1, axis], boxes[done, axis])
                boxes[done - 1, 3 + axis] = max(boxes[done - 1, 3 + axis], boxes[done, 3 + axis])
            _write_bounding_ball(nodes, boxes[done - 1], closes)
            continue
        nodes[number, 0], nodes[number, 1], nodes[number, 2] = first, last, number + 1
        if last - first > leaf:
            middle = min(max(_first_after(places, first, last), first + fewest), last - fewest)
            stack[height] = (0, 0, number)
            stack[height + 1] = (middle, last, -1)
            stack[height + 2] = (first, middle, -1)
            height += 3
        else:
            x, y, z, right, far, top = _bounds(points, first, last)
            boxes[done] = (x, y, z, right, far, top)
            done += 1
            x, y, z, square = 0.5 * (x + right), 0.5 * (y + far), 0.5 * (z + top), 0.0
            nodes[number, 3], nodes[number, 4], nodes[number, 5] = x, y, z
            for n in range(first, last):
                dx, dy, dz = points[n, 0] - x, points[n, 1] - y, points[n, 2] - z
                square = max(square, dx * dx + dy * dy + dz * dz)
            nodes[number, 6] = math.sqrt(square)
        number += 1
    return nodes[:number].copy()


@kernel
def _write_bounding_ball(nodes: FloatArray, box: FloatArray, number: int) -> None:
    """Write a bounding ball of a node's children, centred in their box."""
    square, farthest, node = 0.0, 0.0, nodes[number]
    for axis in range(3):
        low, high = box[axis], box[3 + axis]
        node[3 + axis] = 0.5 * (low + high)
        square += 0.25 * (high - low) * (high - low)
    for part in (number + 1, int(nodes[number + 1, 2])):
        x, y, z = nodes[part, 3] - node[3], nodes[part, 4] - node[4], nodes[part, 5] - node[5]
        farthest = max(farthest, math.sqrt(x * x + y * y + z * z) + nodes[part, 6])
    node[6] = min(math.sqrt(square), farthest)


def tree_of(points: FloatArray, leaf: int) -> tuple[FloatArray, FloatArray]:
    """Sort points in tree order and build the tree.

    Args:
        points: (n, 3) points, 0 < n < 2^26.
        leaf: Maximum number of points of a leaf, at least 4.

    Returns:
        (n, 3) sorted points, and (nodes, 7) nodes, as in `hplan.geometry.cloud.Cloud`.
    """
    places = _sort_keys(points)
    places.sort()
    core: FloatArray = np.take(points, places & ((1 << _NUMBER) - 1), axis=0)
    return core, _nodes(core, places, leaf)
