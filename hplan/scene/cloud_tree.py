"""The points of a cloud, merged where they are near to one another, and the tree over them: compiled.

The tree is split near the median of the longest side of the box about a node's points, until few are left. Neighbours
stand together in its order.

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


@kernel
def _put_first(points: FloatArray, first: int, last: int, axis: int, bound: float) -> int:
    """Rearrange the points first..last - 1 so that those with a coordinate below a bound come first.

    Points change places without a branch: half of the time it would be guessed wrong, which costs most of all.

    Returns:
        Where the others begin.
    """
    end = first
    for i in range(first, last):
        x, y, z, at = points[i, 0], points[i, 1], points[i, 2], points[i, axis]
        points[i, 0], points[i, 1], points[i, 2] = points[end, 0], points[end, 1], points[end, 2]
        points[end, 0], points[end, 1], points[end, 2] = x, y, z
        end += int(at < bound)
    return end


@inlined
def _median(a: float, b: float, c: float) -> float:
    return max(min(a, b), min(max(a, b), c))


@kernel
def _part(points: FloatArray, first: int, last: int, axis: int) -> int:
    """Rearrange the points first..last - 1 in two parts: no coordinate in the first is larger than any in the other.

    A selection that ends near the middle, the pivot a median of three medians.

    Returns:
        Where the other part begins: off the middle by an eighth of the points at most.
    """
    middle, slack = (first + last) // 2, (last - first) // 8
    while last - first > 1:
        at, step = points[first:last, axis], (last - first - 1) // 8
        pivot = _median(
            _median(at[0], at[step], at[2 * step]),
            _median(at[3 * step], at[4 * step], at[5 * step]),
            _median(at[6 * step], at[7 * step], at[-1]),
        )
        others = _put_first(points, first, last, axis, pivot)
        if abs(others - middle) <= slack:
            return others
        if middle < others:
            last = others
        elif others > first:
            first = others
        else:  # nothing is below the pivot: those at it come first
            first = _put_first(points, first, last, axis, np.nextafter(pivot, np.inf))
            if middle < first:
                break
    return middle


@kernel
def _bounds(points: FloatArray, first: int, last: int, node: FloatArray) -> int:
    """Write the ball about the points first..last - 1 into a node: about the middle of their box.

    Returns:
        The longest side of the box.
    """
    x = right = points[first, 0]
    y = far = points[first, 1]
    z = top = points[first, 2]
    for i in range(first + 1, last):  # all axes at once: none waits for the one before
        x, right = min(x, points[i, 0]), max(right, points[i, 0])
        y, far = min(y, points[i, 1]), max(far, points[i, 1])
        z, top = min(z, points[i, 2]), max(top, points[i, 2])
    wide, deep, high = right - x, far - y, top - z
    longest = 0 if wide >= deep and wide >= high else 1 if deep >= high else 2
    x, y, z, square = 0.5 * (x + right), 0.5 * (y + far), 0.5 * (z + top), 0.0
    node[3], node[4], node[5] = x, y, z
    for i in range(first, last):
        dx, dy, dz = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
        square = max(square, dx * dx + dy * dy + dz * dz)
    node[6] = math.sqrt(square)
    return longest


@kernel
def tree_of(points: FloatArray, leaf: int) -> FloatArray:
    """Put points into the order of a tree split near medians, in place.

    Args:
        points: (n, 3) points, n > 0; rearranged.
        leaf: Most points of a leaf.

    Returns:
        (nodes, 7) its nodes, as in `hplan.scene.solids.Cloud`.
    """
    # What is parted has more points than a leaf; so no leaf has fewer than this, but where it is all there is.
    count, fewest = points.shape[0], (leaf + 1) // 2 - (leaf + 1) // 8
    nodes = np.empty((1 + 2 * (count // fewest), _COLUMNS))
    # A node's place on the stack is its parts still to come; what is finished learns where the next one begins.
    stack = np.empty((3 * 64, 3), dtype=np.int64)
    stack[0] = (0, count, -1)
    height, number = 1, 0
    while height > 0:
        height -= 1
        first, last, closes = stack[height, 0], stack[height, 1], stack[height, 2]
        if closes >= 0:
            nodes[closes, 2] = number
            continue
        nodes[number, 0], nodes[number, 1], nodes[number, 2] = first, last, number + 1
        longest = _bounds(points, first, last, nodes[number])
        if last - first > leaf:
            middle = _part(points, first, last, longest)
            stack[height] = (0, 0, number)
            stack[height + 1] = (middle, last, -1)
            stack[height + 2] = (first, middle, -1)
            height += 3
        number += 1
    return nodes[:number].copy()
