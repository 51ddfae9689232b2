"""Kernels of `hplan.online.frame`: bin a frame's points into voxels.

The voxels form a regular grid in `base_link`, in blocks of 4 x 4 x 4. A block is created when the first point falls
into it. The distance of its centre from a body then decides whether all its points are in the body, no points, or some
points: only in the last case each point is tested. The remaining points are sorted by blocks and the voxels filled
block by block, so all data that a point changes is in the processor's cache for any order of the points, and
neighbouring voxels are listed near each other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, ShortArray
from hplan.base.kernels import any_int, inline, kernel
from hplan.geometry.vectors import Vector
from hplan.online.body_distances import Bodies, distance_from_bodies

#: Indices of a tally: rows that are not finite, points out of range, points of the arm, ignored points, rows (0, 0, 0)
#: that depth cameras write for pixels without a return, and points out of range that are `FAR_M` from the camera.
NOT_FINITE, OUT_OF_REACH, OF_ARM, IGNORED, NO_RETURN, FAR = range(6)

#: Maximum plausible range of a depth camera [m]: if most points are farther, they are probably in millimetres.
FAR_M = 100.0

#: Fraction of a block inside a body.
_NONE, _ALL, _SOME = 0, 1, 2

#: Columns of the hash table (open addressing, size a power of two): the packed position of a block, -1 for an empty
#: slot, and the block's index.
_KEY, _VALUE = 0, 1

#: Columns of a block: its fraction in the arm, plus four times its fraction in ignored objects; its number of points.
_PART, _POINTS = 0, 1

#: Voxels along each side of a block, a power of two: its exponent and its value.
_BITS = any_int(2)
_SIDE = any_int(4)

#: Column of a voxel for its number of points, after the minimum and maximum coordinates of its points.
COUNT_COLUMN = 6

#: Positions along an axis are counted in voxels from the centre of the ball of interest. Bits of a packed position, and
#: the offset that makes positions non-negative; three positions fit one integer.
BITS, MIDDLE = 21, 2**20


class Placement(NamedTuple):
    """Camera pose and range of interest of a frame.

    Attributes:
        rotation: (3, 3) camera to `base_link`.
        position: (3,) position of the camera [m].
        reach: (4,) centre and radius of the ball of interest [m].
        edge: (1,) edge of a voxel [m].
    """

    rotation: FloatArray
    position: FloatArray
    reach: FloatArray
    edge: FloatArray


@kernel
def _part_inside(middle: Vector, rows: FloatArray, data: FloatArray, half: float) -> int:
    """Fraction of a block inside a body: `_NONE`, `_ALL` or `_SOME`.

    `half` is half the diagonal of the block [m].
    """
    if rows.shape[0] == 0:
        return _NONE
    apart = distance_from_bodies(middle, rows, data, half)
    if apart > half:
        return _NONE
    return _ALL if apart <= -half else _SOME


@inline
def _transform_point(x: float, y: float, z: float, rotation: FloatArray, position: FloatArray) -> Vector:
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + position[0],
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + position[1],
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + position[2],
    )


class Scratch:
    """Buffers that successive frames share, because allocation costs as much as processing.

    They are as large as the largest frame required. Only one frame at a time may use them.
    """

    def __init__(self) -> None:
        self._rows: ShortArray = np.empty((2, 0), dtype=np.int32)
        self._placed: FloatArray = np.empty((0, 3))
        self._voxels: FloatArray = np.empty((0, COUNT_COLUMN + 1))
        first_blocks = 4096
        self._blocks, self._table = _room_for(first_blocks)

    def put_into_voxels(
        self, points: FloatArray, placement: Placement, arm: Bodies, ignored: Bodies
    ) -> tuple[FloatArray, FloatArray, ShortArray, IntArray]:
        """Bin the points of a frame that remain into voxels.

        Args:
            points: (n, 3) points in the camera's frame, float32 or float64 [m].
            placement: Camera pose and ball of interest, with a radius of fewer than `MIDDLE` voxels.
            arm: The arm's bodies, grown by their padding.
            ignored: Objects to leave out, grown by their padding.

        Returns:
            (m, 7) the voxels that contain remaining points: minimum and maximum coordinates of their points [m], and
            their number; (k, 3) these points in `base_link` [m]; (k,) the voxel of each; (6,) the tally of the other
            points, by reason. All but the last are valid until the next call.
        """
        if self._rows.shape[1] < len(points):
            self._rows = np.empty((2, len(points)), dtype=np.int32)
        rows, numbers = self._rows
        found = FoundBlocks(np.zeros(3, dtype=np.int64), rows, numbers, np.zeros(FAR + 1, dtype=np.int64))
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
            self._placed, self._voxels = np.empty((kept, 3)), np.empty((kept, COUNT_COLUMN + 1))
        blocks, placed = self._blocks[:count], self._placed[:kept]
        _sort_by_block(points, placement, found, blocks, placed)
        # Sorted points belong to known blocks, so the voxel indices may overwrite the block indices.
        voxels = _fill(placed, placement, blocks, self._voxels, numbers)
        return self._voxels[:voxels], placed, numbers[:kept], found.tally


def _room_for(count: int) -> tuple[IntArray, IntArray]:
    """Buffers for a number of blocks, and an empty hash table."""
    return np.empty((count, 2), dtype=np.int64), np.full((4 * count, 2), -1, dtype=np.int64)


@inline
def _pack(i: int, j: int, k: int) -> int:
    return ((i + MIDDLE) << (2 * BITS)) | ((j + MIDDLE) << BITS) | (k + MIDDLE)


@kernel
def _table_slot(key: int, table: IntArray) -> int:
    """Slot of a key in a table, or its free slot (-1).

    Four adjacent cells have adjacent slots, because a memory access takes as long as all the rest.
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
            place = _table_slot(smaller[entry, _KEY], table)
            table[place, _KEY], table[place, _VALUE] = smaller[entry, _KEY], smaller[entry, _VALUE]


class FoundBlocks(NamedTuple):
    """Intermediate results of `_find_blocks`.

    Attributes:
        done: Number of points processed, of blocks, and of remaining points.
        rows: Rows of the remaining points.
        in_block: Block of each remaining point.
        tally: Number of removed points, by reason.
    """

    done: IntArray
    rows: ShortArray
    in_block: ShortArray
    tally: IntArray


# The arrays are never replaced in here: if a loop allocates larger ones, numba counts references of all arrays in every
# iteration, 200 ns.
@kernel
def _find_blocks(
    points: FloatArray, placement: Placement, arm: Bodies, ignored: Bodies, blocks: IntArray, table: IntArray,
    found: FoundBlocks,
) -> None:  # fmt: skip
    """Find the blocks of the remaining points.

    Returns early if there is no space for another block.
    """
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
        x, y, z = _transform_point(u, v, w, rotation, position)
        dx, dy, dz = x - reach[0], y - reach[1], z - reach[2]
        if not dx * dx + dy * dy + dz * dz <= square:  # Sums of huge values may be NaN.
            tally[OUT_OF_REACH] += 1
            if u * u + v * v + w * w > FAR_M * FAR_M:
                tally[FAR] += 1
            continue
        i, j, k = math.floor(dx * per_metre), math.floor(dy * per_metre), math.floor(dz * per_metre)
        i, j, k = i >> _BITS, j >> _BITS, k >> _BITS
        key = _pack(i, j, k)
        if key != last:  # Neighbours in a frame are often in one block.
            place = _table_slot(key, table)
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
    """Fractions of a block inside arm and ignored objects, packed.

    The first plus four times the second.
    """
    half = 0.5 * math.sqrt(3.0) * side
    of_arm = _part_inside(middle, arm.rows, arm.data, half)
    return of_arm + 4 * _part_inside(middle, ignored.rows, ignored.data, half)


@kernel
def _sort_by_block(
    points: FloatArray, placement: Placement, found: FoundBlocks, blocks: IntArray, placed: FloatArray
) -> None:
    """Write the remaining points in the order of their blocks.

    On return each block holds the end of its points.
    """
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
        placed[place, 0], placed[place, 1], placed[place, 2] = _transform_point(
            np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2]), rotation, position
        )


@kernel
def _fill(placed: FloatArray, placement: Placement, blocks: IntArray, voxels: FloatArray, numbers: ShortArray) -> int:
    """Write the voxels of points sorted by blocks.

    Also writes the voxel of each point, and returns the number of voxels.
    """
    reach, per_metre, within = placement.reach, 1.0 / placement.edge[0], _SIDE - 1
    # The voxels of a block, -1 for an empty one.
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
                voxels[count, COUNT_COLUMN] = 0.0
                for axis in range(3):
                    voxels[count, axis], voxels[count, 3 + axis] = math.inf, -math.inf
                count += 1
        for place in range(begin, blocks[block, _POINTS]):
            number = numbers[place] = known[numbers[place]]
            x, y, z = placed[place, 0], placed[place, 1], placed[place, 2]
            voxels[number, COUNT_COLUMN] += 1.0
            voxels[number, 0], voxels[number, 3] = min(voxels[number, 0], x), max(voxels[number, 3], x)
            voxels[number, 1], voxels[number, 4] = min(voxels[number, 1], y), max(voxels[number, 4], y)
            voxels[number, 2], voxels[number, 5] = min(voxels[number, 2], z), max(voxels[number, 5], z)
        begin = blocks[block, _POINTS]
    return count


@kernel
def mark_isolated(voxels: FloatArray, placement: Placement, least: int, distance: float, isolated: BoolArray) -> None:
    """Mark voxels with few points in their neighbourhood.

    The neighbourhood are the voxels whose point boxes are within a distance. Voxels are binned into larger cells by the
    minimum corners of their boxes; the neighbours of a voxel are then in at most two cells along each axis.

    Args:
        least: Minimum number of points.
        distance: A point remains if at least `least` points are within this distance, itself included [m].
        isolated: (m,) output.
    """
    # Rounding may place the points of a voxel farther apart than its edge.
    middle, edge = placement.reach, (1.0 + 1e-9) * placement.edge[0]
    side, square = 2.0 * (distance + edge), distance * distance
    # Cell of each voxel; the number of changes bounds the number of cells.
    keys, changes, size = np.empty(len(voxels), dtype=np.int64), 0, 64
    for number in range(len(voxels)):
        i, j, k = _cells_at(voxels[number, 0], voxels[number, 1], voxels[number, 2], middle, side)
        keys[number] = _pack(i, j, k)
        changes += number == 0 or keys[number] != keys[number - 1]
    while size < 2 * changes:
        size *= 2
    # The last voxel of each cell, and for each voxel the previous one in its cell.
    cells = np.full((size, 2), -1, dtype=np.int64)
    before = np.empty(len(voxels), dtype=np.int32)
    place = 0
    for number in range(len(voxels)):
        if keys[number] != cells[place, _KEY]:
            place = _table_slot(keys[number], cells)
            cells[place, _KEY] = keys[number]
        before[number] = cells[place, _VALUE]
        cells[place, _VALUE] = number
    for number in range(len(voxels)):
        if voxels[number, COUNT_COLUMN] >= least or _has_enough(voxels, number, least, square):
            continue
        back, x, y, z = distance + edge, voxels[number, 0], voxels[number, 1], voxels[number, 2]
        first = _cells_at(x - back, y - back, z - back, middle, side)
        x, y, z = voxels[number, 3] + distance, voxels[number, 4] + distance, voxels[number, 5] + distance
        last = _cells_at(x, y, z, middle, side)
        near = 0.0
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    other = cells[_table_slot(_pack(i, j, k), cells), _VALUE]
                    while other >= 0 and near < least:
                        if _are_near(voxels, number, other, square):
                            near += voxels[other, COUNT_COLUMN]
                        other = before[other]
        isolated[number] = near < least


@inline
def _cells_at(x: float, y: float, z: float, middle: FloatArray, side: float) -> tuple[int, int, int]:
    return math.floor((x - middle[0]) / side), math.floor((y - middle[1]) / side), math.floor((z - middle[2]) / side)


@kernel
def _has_enough(voxels: FloatArray, number: int, least: int, square: float) -> bool:
    """True if the voxels adjacent in the list hold enough near points.

    These are most often the near ones.
    """
    near = voxels[number, COUNT_COLUMN]
    for step in range(1, 5):
        before, after = number - step, number + step
        if before >= 0 and _are_near(voxels, number, before, square):
            near += voxels[before, COUNT_COLUMN]
        if after < len(voxels) and _are_near(voxels, number, after, square):
            near += voxels[after, COUNT_COLUMN]
        if near >= least:
            return True
    return False


@inline
def _are_near(voxels: FloatArray, a: int, b: int, square: float) -> bool:
    """True if the squared distance between two voxels' boxes is <= `square`."""
    x = max(0.0, max(voxels[a, 0] - voxels[b, 3], voxels[b, 0] - voxels[a, 3]))
    y = max(0.0, max(voxels[a, 1] - voxels[b, 4], voxels[b, 1] - voxels[a, 4]))
    z = max(0.0, max(voxels[a, 2] - voxels[b, 5], voxels[b, 2] - voxels[a, 5]))
    return bool(x * x + y * y + z * z <= square)


@kernel
def middles(
    points: FloatArray, numbers: ShortArray, voxels: FloatArray, dropped: BoolArray
) -> tuple[FloatArray, float]:
    """One point for each voxel: the centre of its points' bounding box.

    Args:
        points: (n, 3) points [m].
        numbers: (n,) the voxel of each point.
        voxels: (m, 7) the voxels, from `Scratch.put_into_voxels`.
        dropped: (m,) mask of the voxels to remove.

    Returns:
        (k, 3) points, and the maximum distance of a point from its voxel's point [m].
    """
    found, halves = np.empty((len(voxels), 3)), np.empty(len(voxels))
    for number in range(len(voxels)):
        square = 0.0
        for axis in range(3):
            low, high = voxels[number, axis], voxels[number, 3 + axis]
            found[number, axis] = low if low == high else 0.5 * (low + high)
            square += 0.25 * (high - low) * (high - low)
        halves[number] = square if voxels[number, COUNT_COLUMN] > 1 and not dropped[number] else -1.0
    # No point is farther than half the diagonal of its box, so most voxels are decided by their box alone.
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
