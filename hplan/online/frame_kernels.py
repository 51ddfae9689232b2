"""Kernels of `hplan.online.frame`: a frame's points that stay, put into voxels of a regular grid in `base_link`.

Voxels stand in blocks of 4 x 4 x 4. A block is made when the first point falls into it. Then it is decided, by the
distance of its middle from a body, whether all its points are in the body, none, or some: only of the last kind every
point is asked. What stays is sorted by blocks, so that a block's voxels are filled one after another: what a point
changes is in the processor's cache, in whatever order points come, and voxels near to one another are listed so.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, ShortArray
from hplan.base.kernels import any_int, inlined, kernel
from hplan.collision.distances import Vector
from hplan.online.body_distances import Bodies, distance_from_bodies

#: Places in a tally: rows that are not finite, points out of reach, points of the arm, ignored points, rows (0, 0, 0)
#: that depth cameras write for pixels without a return, and points out of reach that are `FAR_M` from the camera.
NOT_FINITE, OUT_OF_REACH, OF_ARM, IGNORED, NO_RETURN, FAR = range(6)

#: Maximum plausible range of a depth camera [m]: farther points are taken for millimetres if they are the majority.
FAR_M = 100.0

#: How much of a block is in a body.
_NONE, _ALL, _SOME = 0, 1, 2

#: Columns of the hash table, which has open addressing and is as large as a power of two: the packed place of a block,
#: -1 where there is none, and its number.
_KEY, _VALUE = 0, 1

#: Columns of a block: how much of it is in the arm, and four times how much in what is ignored; how many points it has.
_PART, _POINTS = 0, 1

#: A block has so many voxels along each side, a power of two by so many bits.
_BITS = any_int(2)
_SIDE = any_int(4)

#: Column of a voxel with how many points it has, behind the least and largest coordinates of its points.
COUNT = 6

#: Places along an axis are counted from the middle of reach, this much added; so three fit one number.
BITS, MIDDLE = 21, 2**20


class Placement(NamedTuple):
    """Where a frame is seen from, and what of it matters.

    Attributes:
        rotation: (3, 3) camera to `base_link`.
        position: (3,) of the camera [m].
        reach: (4,) centre and radius of a ball [m].
        edge: (1,) edge of a voxel [m].
    """

    rotation: FloatArray
    position: FloatArray
    reach: FloatArray
    edge: FloatArray


@kernel
def _part_inside(middle: Vector, rows: FloatArray, data: FloatArray, half: float) -> int:
    """How much of a block of half a diagonal can be in a body."""
    if rows.shape[0] == 0:
        return _NONE
    apart = distance_from_bodies(middle, rows, data, half)
    if apart > half:
        return _NONE
    return _ALL if apart <= -half else _SOME


@inlined
def _transformed(x: float, y: float, z: float, rotation: FloatArray, position: FloatArray) -> Vector:
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + position[0],
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + position[1],
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + position[2],
    )


class Scratch:
    """Arrays that one frame leaves for the next: fresh memory costs as much time as the points.

    They are as large as the largest frame has needed. One frame at a time may use them.
    """

    def __init__(self) -> None:
        self._rows: ShortArray = np.empty((2, 0), dtype=np.int32)
        self._placed: FloatArray = np.empty((0, 3))
        self._voxels: FloatArray = np.empty((0, COUNT + 1))
        first_blocks = 4096
        self._blocks, self._table = _room_for(first_blocks)

    def put_into_voxels(
        self, points: FloatArray, placement: Placement, arm: Bodies, ignored: Bodies
    ) -> tuple[FloatArray, FloatArray, ShortArray, IntArray]:
        """Put the points of a frame that stay into voxels.

        Args:
            points: (n, 3) points in the camera's frame, float32 or float64 [m].
            placement: Where the camera is, and what is within reach: fewer than `MIDDLE` voxels to either side.
            arm: The arm, grown by its padding.
            ignored: What is to be left out, grown by its padding.

        Returns:
            (m, 7) the voxels that hold points which stay: least and largest coordinates of their points [m], and how
            many; (k, 3) these points in `base_link` [m]; (k,) the voxel of each; (6,) the tally of the other points, by
            the reason. All but the last until the next frame is put.
        """
        if self._rows.shape[1] < len(points):
            self._rows = np.empty((2, len(points)), dtype=np.int32)
        rows, numbers = self._rows
        found = Found(np.zeros(3, dtype=np.int64), rows, numbers, np.zeros(FAR + 1, dtype=np.int64))
        self._table[:, _KEY] = -1
        while True:
            _find_blocks(points, placement, arm, ignored, self._blocks, self._table, found)
            looked_at, count, kept = found.done.tolist()
            if looked_at == len(points):
                break
            more, table = _room_for(4 * len(self._blocks))
            more[:count] = self._blocks
            _copy_table(self._table, table)
            self._blocks, self._table = more, table
        if len(self._placed) < kept:
            self._placed, self._voxels = np.empty((kept, 3)), np.empty((kept, COUNT + 1))
        blocks, placed = self._blocks[:count], self._placed[:kept]
        _sort_by_block(points, placement, found, blocks, placed)
        # Of the sorted points the blocks are known: voxels are numbered where these stood.
        voxels = _fill(placed, placement, blocks, self._voxels, numbers)
        return self._voxels[:voxels], placed, numbers[:kept], found.tally


def _room_for(count: int) -> tuple[IntArray, IntArray]:
    """Room for so many blocks, and a table with none in it."""
    return np.empty((count, 2), dtype=np.int64), np.full((4 * count, 2), -1, dtype=np.int64)


@inlined
def _packed(i: int, j: int, k: int) -> int:
    return ((i + MIDDLE) << (2 * BITS)) | ((j + MIDDLE) << BITS) | (k + MIDDLE)


@kernel
def _place(key: int, table: IntArray) -> int:
    """Where a key stands in a table, or where it belongs: there stands -1.

    Four cells in a row have places in a row: going to memory takes as long as all the rest.
    """
    mask = len(table) - 1
    row: int = np.int64((np.uint64(key >> 2) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(38))  # type: ignore[assignment]
    place = ((row << 2) | (key & 3)) & mask
    while table[place, _KEY] >= 0 and table[place, _KEY] != key:
        place = (place + 1) & mask
    return place


@kernel
def _copy_table(smaller: IntArray, table: IntArray) -> None:
    for entry in range(len(smaller)):
        if smaller[entry, _KEY] >= 0:
            place = _place(smaller[entry, _KEY], table)
            table[place, _KEY], table[place, _VALUE] = smaller[entry, _KEY], smaller[entry, _VALUE]


class Found(NamedTuple):
    """What `_find_blocks` has found so far.

    Attributes:
        done: How many points were looked at, how many blocks there are, how many points stay.
        rows: The rows of the points that stay.
        in_block: The block of each of these.
        tally: How many points do not stay, by the reason.
    """

    done: IntArray
    rows: ShortArray
    in_block: ShortArray
    tally: IntArray


# The arrays stay the same in here: where a loop makes larger ones, numba counts all of them at every turn, 200 ns.
@kernel
def _find_blocks(
    points: FloatArray, placement: Placement, arm: Bodies, ignored: Bodies, blocks: IntArray, table: IntArray,
    found: Found,
) -> None:  # fmt: skip
    """Find the blocks of the points that stay until all are, or there is no room for another block."""
    rotation, position, reach, edge = placement.rotation, placement.position, placement.reach, placement.edge[0]
    done, rows, in_block, tally = found.done, found.rows, found.in_block, found.tally
    arm_rows, arm_data, ignored_rows, ignored_data = arm.rows, arm.data, ignored.rows, ignored.data
    per_metre, square, side = 1.0 / edge, reach[3] * reach[3], _SIDE * edge
    last, number, part = -1, 0, _NONE
    first, count, kept = done[0], done[1], done[2]
    for n in range(first, points.shape[0]):
        if not (math.isfinite(points[n, 0]) and math.isfinite(points[n, 1]) and math.isfinite(points[n, 2])):
            tally[NOT_FINITE] += 1
            continue
        u, v, w = np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2])
        if u == 0.0 and v == 0.0 and w == 0.0:
            tally[NO_RETURN] += 1
            continue
        x, y, z = _transformed(u, v, w, rotation, position)
        dx, dy, dz = x - reach[0], y - reach[1], z - reach[2]
        if not dx * dx + dy * dy + dz * dz <= square:  # sums of what is huge may be no number
            tally[OUT_OF_REACH] += 1
            if u * u + v * v + w * w > FAR_M * FAR_M:
                tally[FAR] += 1
            continue
        i, j, k = math.floor(dx * per_metre), math.floor(dy * per_metre), math.floor(dz * per_metre)
        i, j, k = i >> _BITS, j >> _BITS, k >> _BITS
        key = _packed(i, j, k)
        if key != last:  # neighbours in a frame are often in one block
            place = _place(key, table)
            if table[place, _KEY] < 0:
                if count == len(blocks):
                    done[0], done[1], done[2] = n, count, kept
                    return
                middle = (reach[0] + (i + 0.5) * side, reach[1] + (j + 0.5) * side, reach[2] + (k + 0.5) * side)
                blocks[count, _PART], blocks[count, _POINTS] = _parts_inside(middle, arm, ignored, side), 0
                table[place, _KEY], table[place, _VALUE] = key, count
                count += 1
            last, number = key, table[place, _VALUE]
            part = blocks[number, _PART]
        if part != _NONE:
            of_arm, of_ignored = part % 4, part // 4
            if of_arm == _ALL or (of_arm == _SOME and distance_from_bodies((x, y, z), arm_rows, arm_data, 0.0) <= 0.0):
                tally[OF_ARM] += 1
                continue
            if of_ignored == _ALL or (
                of_ignored == _SOME and distance_from_bodies((x, y, z), ignored_rows, ignored_data, 0.0) <= 0.0
            ):
                tally[IGNORED] += 1
                continue
        rows[kept], in_block[kept] = n, number
        blocks[number, _POINTS] += 1
        kept += 1
    done[0], done[1], done[2] = points.shape[0], count, kept


@kernel
def _parts_inside(middle: Vector, arm: Bodies, ignored: Bodies, side: float) -> int:
    """How much of a block is in the arm, and four times how much in what is ignored."""
    half = 0.5 * math.sqrt(3.0) * side
    of_arm = _part_inside(middle, arm.rows, arm.data, half)
    return of_arm + 4 * _part_inside(middle, ignored.rows, ignored.data, half)


@kernel
def _sort_by_block(
    points: FloatArray, placement: Placement, found: Found, blocks: IntArray, placed: FloatArray
) -> None:
    """Write the points that stay in the order of their blocks; a block gets where those after it begin."""
    rotation, position, rows, in_block = placement.rotation, placement.position, found.rows, found.in_block
    begin = 0
    for number in range(len(blocks)):
        count = blocks[number, _POINTS]
        blocks[number, _POINTS] = begin
        begin += count
    for row in range(begin):
        n, number = rows[row], in_block[row]
        place = blocks[number, _POINTS]
        blocks[number, _POINTS] += 1
        placed[place, 0], placed[place, 1], placed[place, 2] = _transformed(
            np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2]), rotation, position
        )


@kernel
def _fill(placed: FloatArray, placement: Placement, blocks: IntArray, voxels: FloatArray, numbers: ShortArray) -> int:
    """Write the voxels of points sorted by their blocks, and the voxel of each; return how many voxels there are."""
    reach, per_metre, within = placement.reach, 1.0 / placement.edge[0], _SIDE - 1
    # The voxels of a block, -1 where there is none.
    known = np.empty(_SIDE * _SIDE * _SIDE, dtype=np.int64)
    count, begin = 0, 0
    for block in range(len(blocks)):
        if blocks[block, _POINTS] == begin:
            continue
        for slot in range(len(known)):
            known[slot] = -1
        for place in range(begin, blocks[block, _POINTS]):
            x, y, z = placed[place, 0], placed[place, 1], placed[place, 2]
            i, j, k = (
                math.floor((x - reach[0]) * per_metre) & within,
                math.floor((y - reach[1]) * per_metre) & within,
                math.floor((z - reach[2]) * per_metre) & within,
            )
            numbers[place] = (i * _SIDE + j) * _SIDE + k
            known[numbers[place]] = 0
        for slot in range(len(known)):
            if known[slot] == 0:
                known[slot] = count
                voxels[count, COUNT] = 0.0
                for axis in range(3):
                    voxels[count, axis], voxels[count, 3 + axis] = math.inf, -math.inf
                count += 1
        for place in range(begin, blocks[block, _POINTS]):
            number = numbers[place] = known[numbers[place]]
            x, y, z = placed[place, 0], placed[place, 1], placed[place, 2]
            voxels[number, COUNT] += 1.0
            voxels[number, 0], voxels[number, 3] = min(voxels[number, 0], x), max(voxels[number, 3], x)
            voxels[number, 1], voxels[number, 4] = min(voxels[number, 1], y), max(voxels[number, 4], y)
            voxels[number, 2], voxels[number, 5] = min(voxels[number, 2], z), max(voxels[number, 5], z)
        begin = blocks[block, _POINTS]
    return count


@kernel
def mark_isolated(voxels: FloatArray, placement: Placement, least: int, distance: float, isolated: BoolArray) -> None:
    """Mark voxels with few points about them: in voxels whose boxes are within a distance of theirs.

    Voxels stand in larger cells, by the first corners of their boxes: those within the distance of one are in two cells
    along each axis at most.

    Args:
        distance: A point with so many within this distance, itself among them, stays [m].
        isolated: (m,) written.
    """
    # The points of a voxel may be farther apart than its edge by what is rounded.
    middle, edge = placement.reach, (1.0 + 1e-9) * placement.edge[0]
    side, square = 2.0 * (distance + edge), distance * distance
    # Of each voxel its cell; there are no more cells than times that this changes.
    keys, changes, size = np.empty(len(voxels), dtype=np.int64), 0, 64
    for number in range(len(voxels)):
        i, j, k = _cells_at(voxels[number, 0], voxels[number, 1], voxels[number, 2], middle, side)
        keys[number] = _packed(i, j, k)
        changes += number == 0 or keys[number] != keys[number - 1]
    while size < 2 * changes:
        size *= 2
    # The last voxel of each cell, and of each voxel the one before it in its cell.
    cells = np.full((size, 2), -1, dtype=np.int64)
    before = np.empty(len(voxels), dtype=np.int32)
    place = 0
    for number in range(len(voxels)):
        if keys[number] != cells[place, _KEY]:
            place = _place(keys[number], cells)
            cells[place, _KEY] = keys[number]
        before[number] = cells[place, _VALUE]
        cells[place, _VALUE] = number
    for number in range(len(voxels)):
        if voxels[number, COUNT] >= least or _has_enough(voxels, number, least, square):
            continue
        back, x, y, z = distance + edge, voxels[number, 0], voxels[number, 1], voxels[number, 2]
        first = _cells_at(x - back, y - back, z - back, middle, side)
        x, y, z = voxels[number, 3] + distance, voxels[number, 4] + distance, voxels[number, 5] + distance
        last = _cells_at(x, y, z, middle, side)
        near = 0.0
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    other = cells[_place(_packed(i, j, k), cells), _VALUE]
                    while other >= 0 and near < least:
                        if _are_near(voxels, number, other, square):
                            near += voxels[other, COUNT]
                        other = before[other]
        isolated[number] = near < least


@inlined
def _cells_at(x: float, y: float, z: float, middle: FloatArray, side: float) -> tuple[int, int, int]:
    return math.floor((x - middle[0]) / side), math.floor((y - middle[1]) / side), math.floor((z - middle[2]) / side)


@kernel
def _has_enough(voxels: FloatArray, number: int, least: int, square: float) -> bool:
    """Whether there is enough about a voxel in the few that are listed beside it, which are most often near."""
    near = voxels[number, COUNT]
    for step in range(1, 5):
        before, after = number - step, number + step
        if before >= 0 and _are_near(voxels, number, before, square):
            near += voxels[before, COUNT]
        if after < len(voxels) and _are_near(voxels, number, after, square):
            near += voxels[after, COUNT]
        if near >= least:
            return True
    return False


@inlined
def _are_near(voxels: FloatArray, a: int, b: int, square: float) -> bool:
    """Whether the square of the distance between the boxes of two voxels is at most that."""
    x = max(0.0, max(voxels[a, 0] - voxels[b, 3], voxels[b, 0] - voxels[a, 3]))
    y = max(0.0, max(voxels[a, 1] - voxels[b, 4], voxels[b, 1] - voxels[a, 4]))
    z = max(0.0, max(voxels[a, 2] - voxels[b, 5], voxels[b, 2] - voxels[a, 5]))
    return bool(x * x + y * y + z * z <= square)


@kernel
def middles(
    points: FloatArray, numbers: ShortArray, voxels: FloatArray, dropped: BoolArray
) -> tuple[FloatArray, float]:
    """One point for each voxel: the middle of the box about its points.

    Args:
        points: (n, 3) points [m].
        numbers: (n,) the voxel of each.
        dropped: (m,) voxels that do not stay.

    Returns:
        (k, 3) points, and the largest distance of a point from the one of its voxel [m].
    """
    found, halves = np.empty((len(voxels), 3)), np.empty(len(voxels))
    for number in range(len(voxels)):
        square = 0.0
        for axis in range(3):
            low, high = voxels[number, axis], voxels[number, 3 + axis]
            found[number, axis] = low if low == high else 0.5 * (low + high)
            square += 0.25 * (high - low) * (high - low)
        halves[number] = square if voxels[number, COUNT] > 1 and not dropped[number] else -1.0
    # No point is farther than half the diagonal of its box: most voxels need no second look.
    growth = 0.0
    for place in range(len(numbers)):
        number = numbers[place]
        if halves[number] > growth:
            square = 0.0
            for axis in range(3):
                square += (points[place, axis] - found[number, axis]) * (points[place, axis] - found[number, axis])
            growth = max(growth, square)
    count = 0
    for number in range(len(voxels)):
        if not dropped[number]:
            for axis in range(3):
                found[count, axis] = found[number, axis]
            count += 1
    return found[:count].copy(), math.sqrt(growth)
