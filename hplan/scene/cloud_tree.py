"""The points of a cloud, merged where they are near to one another, and the tree over them: compiled.

Points stand along a curve through cells of a cube about them, by the bits of all three coordinates in turn (Morton). A
node is a stretch of it, parted where the highest bit changes that does, until few points are left.

Voxels are numbered as they first appear, by a hash table with open addressing: an array of numbers, empty places -1,
its size a power of two. The cells themselves are rows of three whole numbers; two are one if all three are the same.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, ShortArray
from hplan.base.kernels import inlined, kernel

#: Columns of a node: as in `hplan.scene.solids.Cloud`.
_COLUMNS = 7

#: Bits of a point's number, which stands behind its place along the curve, so that both are sorted at once.
_NUMBER = 26


@inlined
def cell_hash(i: int, j: int, k: int) -> int:
    """A number whose last bits differ from cell to cell, neighbours included."""
    mixed = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
    mixed ^= np.uint64(k) * np.uint64(0x165667B19E3779F9)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    return np.int64(mixed >> np.uint64(34))  # type: ignore[return-value]  # an int to numba


@kernel
def cell_place(i: int, j: int, k: int, cells: IntArray, table: ShortArray) -> int:
    """The place in the table where a cell's number stands, or where it belongs: there stands -1."""
    mask = len(table) - 1
    place = cell_hash(i, j, k) & mask
    number = table[place]
    while number >= 0 and (cells[number, 0] != i or cells[number, 1] != j or cells[number, 2] != k):
        place = (place + 1) & mask
        number = table[place]
    return place


@kernel
def number_cells(rows: IntArray) -> tuple[ShortArray, int]:
    """Number equal rows alike, in the order in which they first appear.

    Args:
        rows: (n, 3) whole numbers.

    Returns:
        (n,) numbers, and how many different ones there are.
    """
    size = 64
    while size < 2 * rows.shape[0]:
        size *= 2
    numbers = np.empty(rows.shape[0], dtype=np.int32)
    cells = np.empty((rows.shape[0], 3), dtype=np.int64)
    table = np.full(size, -1, dtype=np.int32)
    count = 0
    for row in range(rows.shape[0]):
        i, j, k = rows[row, 0], rows[row, 1], rows[row, 2]
        place = cell_place(i, j, k, cells, table)
        if table[place] < 0:
            table[place] = count
            cells[count, 0], cells[count, 1], cells[count, 2] = i, j, k
            count += 1
        numbers[row] = table[place]
    return numbers, count


def merged(points: FloatArray, edge: float) -> tuple[FloatArray, float]:
    """Points of one voxel as the middle of the box about them, where that makes them notably fewer.

    Args:
        points: (n, 3) points [m]; such as are equal become one in any case.
        edge: Edge of a voxel [m].

    Returns:
        (m, 3) fewer points, and the distance of the farthest old one from its new one [m].
    """
    points = points + 0.0  # so that -0.0 and 0.0 are one
    numbers, count = number_cells(points.view(np.int64))
    if count < len(points):
        points, _ = box_centres(points, numbers, count)
    numbers, count = number_cells(np.floor(points / edge).astype(np.int64))
    # Points are merged where that leaves at most this fraction of the balls.
    worth_merging = 0.7
    if count > worth_merging * len(points):
        return points, 0.0
    return box_centres(points, numbers, count)


@kernel
def box_centres(points: FloatArray, numbers: ShortArray, count: int) -> tuple[FloatArray, float]:
    """The middle of the box about the points of each number.

    Args:
        points: (n, 3) points.
        numbers: (n,) number of each.

    Returns:
        (count, 3) middles, and the distance of the farthest point from its one.
    """
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for i in range(points.shape[0]):
        number = numbers[i]
        for axis in range(3):
            low[number, axis] = min(low[number, axis], points[i, axis])
            high[number, axis] = max(high[number, axis], points[i, axis])
    for number in range(count):
        for axis in range(3):
            if low[number, axis] < high[number, axis]:  # else it stays, to the last digit
                low[number, axis] = 0.5 * (low[number, axis] + high[number, axis])
    farthest = 0.0
    for i in range(points.shape[0]):
        number = numbers[i]
        dx, dy, dz = points[i, 0] - low[number, 0], points[i, 1] - low[number, 1], points[i, 2] - low[number, 2]
        farthest = max(farthest, dx * dx + dy * dy + dz * dz)
    return low, math.sqrt(farthest)


@inlined
def _every_third(cell: int) -> int:
    """The last 16 bits of a number, each followed by two that are 0."""
    bits = (cell | (cell << 16)) & 0x0000FF0000FF
    bits = (bits | (bits << 8)) & 0x00F00F00F00F
    bits = (bits | (bits << 4)) & 0x0C30C30C30C3
    return (bits | (bits << 2)) & 0x249249249249


@inlined
def _bounds(points: FloatArray, first: int, last: int) -> tuple[float, float, float, float, float, float]:
    """The least and the largest coordinates of the points first..last - 1."""
    x, y, z = right, far, top = points[first, 0], points[first, 1], points[first, 2]
    for n in range(first + 1, last):  # all axes at once: none waits for the one before
        x, right = min(x, points[n, 0]), max(right, points[n, 0])
        y, far = min(y, points[n, 1]), max(far, points[n, 1])
        z, top = min(z, points[n, 2]), max(top, points[n, 2])
    return x, y, z, right, far, top


@kernel
def _places(points: FloatArray) -> IntArray:
    """(n,) where each of (n, 3) points is along the curve, and behind that, in `_NUMBER` bits, its number."""
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
    """Where a stretch is parted: at the first place with the highest bit that not all have, else in the middle."""
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
    nodes = np.empty((1 + 2 * (count // fewest), _COLUMNS))
    # A node's place on the stack is its parts still to come; what is finished learns where the next one begins, and
    # leaves its box.
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
            _around(nodes, boxes[done - 1], closes)
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
def _around(nodes: FloatArray, box: FloatArray, number: int) -> None:
    """Write a ball about the middle of the box about a node's two parts that holds their points."""
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
    """Points in the order of a tree, and the tree.

    Args:
        points: (n, 3) points, 0 < n < 2^26.
        leaf: Most points of a leaf, 4 or more.

    Returns:
        (n, 3) the points, and (nodes, 7) the nodes, as in `hplan.scene.solids.Cloud`.
    """
    places = _places(points)
    places.sort()
    core: FloatArray = np.take(points, places & ((1 << _NUMBER) - 1), axis=0)
    return core, _nodes(core, places, leaf)
