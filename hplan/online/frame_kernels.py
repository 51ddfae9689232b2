"""Kernels of `hplan.online.frame`: one pass over a frame's points, which puts those that stay into voxels.

A voxel of a regular grid in `base_link` is made when the first point falls into it. Then it is decided, by the distance
of its middle from a body, whether all its points are in the body, none, or some: only of the last kind every point is
asked. So a point costs what it takes to find its voxel, and the body costs what there are of voxels at its surface.
Points of few bodies that are to be ignored, such as the ground, are known as such without a voxel: seen from afar there
are as many voxels as points.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, ShortArray
from hplan.base.kernels import any_int, inlined, kernel
from hplan.collision.distances import Vector
from hplan.online.body_distances import Bodies, distance_from_bodies

#: Places in a tally: rows that are not finite, points out of reach, of the arm, of what is ignored.
NOT_FINITE, OUT_OF_REACH, OF_ARM, IGNORED = 0, 1, 2, 3

#: How much of a voxel is in a body.
_NONE, _ALL, _SOME = 0, 1, 2

#: In place of the number of a voxel: all of it is of the arm, or of what is ignored.
_ARM_ALONE, _IGNORED_ALONE = -2, -3

#: Columns of the hash table, which has open addressing and is as large as a power of two: the packed place of a voxel,
#: -1 where there is none; and `_PARTS` times its number, and how much of it is in the arm, and four times how much is
#: in what is ignored. What a point changes stands together: going to memory takes as long as all the rest.
_KEY, _VALUE, _PARTS = 0, 1, 16

#: Column of a voxel with how many points it has, behind the least and largest coordinates of its points.
COUNT = 6

#: Of no more bodies than this to be ignored each point is asked that is not in the voxel of the one before.
_FEW = any_int(4)

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
    """How much of a voxel of half a diagonal can be in a body."""
    if rows.shape[0] == 0:
        return _NONE
    apart = distance_from_bodies(middle, rows, data, half)
    if apart > half:
        return _NONE
    return _ALL if apart <= -half else _SOME


@kernel
def _is_inside(part: int, point: Vector, rows: FloatArray, data: FloatArray) -> bool:
    """Whether a point of a voxel of which so much is in a body is in it."""
    if part == _SOME:
        return distance_from_bodies(point, rows, data, 0.0) <= 0.0
    return part == _ALL


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
        self._numbers: ShortArray = np.empty(0, dtype=np.int32)
        first_voxels = 16_384
        self._voxels, self._table = _room_for(first_voxels)

    def put_into_voxels(
        self, points: FloatArray, placement: Placement, arm: Bodies, ignored: Bodies
    ) -> tuple[FloatArray, ShortArray, IntArray]:
        """Put the points of a frame that stay into voxels.

        Args:
            points: (n, 3) points in the camera's frame, float32 or float64 [m].
            placement: Where the camera is, and what is within reach: fewer than `MIDDLE` voxels to either side.
            arm: The arm, grown by its padding.
            ignored: What is to be left out, grown by its padding.

        Returns:
            (m, 7) the voxels that may hold points which stay, as they first appear: least and largest coordinates of
            their points [m], and how many; (n,) the voxel of each point, -1 where it does not stay; (4,) how many do
            not stay, by the reason. All but the last until the next frame is put.
        """
        if len(self._numbers) < len(points):
            self._numbers = np.empty(len(points), dtype=np.int32)
        numbers, tally = self._numbers[: len(points)], np.zeros(4, dtype=np.int64)
        done = np.zeros(3, dtype=np.int64)
        self._table[:, _KEY] = -1
        while True:
            _fill(points, placement, arm, ignored, self._voxels, self._table, done, numbers, tally)
            count = int(done[1])
            if done[0] == len(points):
                return self._voxels[:count], numbers, tally
            more, table = _room_for(4 * len(self._voxels))
            more[:count] = self._voxels[:count]
            _copy_table(self._table, table)
            self._voxels, self._table = more, table


def _room_for(count: int) -> tuple[FloatArray, IntArray]:
    """Room for so many voxels, and a table with none in it."""
    return np.empty((count, COUNT + 1)), np.full((2 * count, 2), -1, dtype=np.int64)


@inlined
def _packed(i: int, j: int, k: int) -> int:
    return ((i + MIDDLE) << (2 * BITS)) | ((j + MIDDLE) << BITS) | (k + MIDDLE)


@kernel
def _place(key: int, table: IntArray) -> int:
    """Where a key stands in a table, or where it belongs: there stands -1."""
    mask = len(table) - 1
    place: int = np.int64((np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(38)) & mask  # type: ignore[assignment]
    while table[place, _KEY] >= 0 and table[place, _KEY] != key:
        place = (place + 1) & mask
    return place


@kernel
def _copy_table(smaller: IntArray, table: IntArray) -> None:
    for entry in range(len(smaller)):
        if smaller[entry, _KEY] >= 0:
            place = _place(smaller[entry, _KEY], table)
            table[place, _KEY], table[place, _VALUE] = smaller[entry, _KEY], smaller[entry, _VALUE]


# The arrays stay the same in here: where a loop makes larger ones, numba counts all of them at every turn, 200 ns.
@kernel
def _fill(
    points: FloatArray, placement: Placement, arm: Bodies, ignored: Bodies, voxels: FloatArray, table: IntArray,
    done: IntArray, numbers: ShortArray, tally: IntArray,
) -> None:  # fmt: skip
    """Put points into voxels until all are, or there is no room for another voxel.

    `done` has how many points were put before, how many voxels there are, and how many places of the table are used.
    """
    rotation, position, reach, edge = placement.rotation, placement.position, placement.reach, placement.edge[0]
    per_metre, square = 1.0 / edge, reach[3] * reach[3]
    last, number, part, few = -1, 0, _NONE, ignored.rows.shape[0] <= _FEW
    first, count, used = done[0], done[1], done[2]
    for n in range(first, points.shape[0]):
        numbers[n] = -1
        if not (math.isfinite(points[n, 0]) and math.isfinite(points[n, 1]) and math.isfinite(points[n, 2])):
            tally[NOT_FINITE] += 1
            continue
        x, y, z = _transformed(
            np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2]), rotation, position
        )
        dx, dy, dz = x - reach[0], y - reach[1], z - reach[2]
        if not dx * dx + dy * dy + dz * dz <= square:  # sums of what is huge may be no number
            tally[OUT_OF_REACH] += 1
            continue
        i, j, k = math.floor(dx * per_metre), math.floor(dy * per_metre), math.floor(dz * per_metre)
        key = _packed(i, j, k)
        if key != last:  # neighbours in a frame are often in one voxel
            if few and _is_ignored_alone((x, y, z), arm, ignored):
                tally[IGNORED] += 1
                continue
            place = _place(key, table)
            if table[place, _KEY] < 0:
                if count == len(voxels) or 2 * used >= len(table):
                    done[0], done[1], done[2] = n, count, used
                    return
                middle = (reach[0] + (i + 0.5) * edge, reach[1] + (j + 0.5) * edge, reach[2] + (k + 0.5) * edge)
                part = _parts_inside(middle, arm, ignored, edge)
                table[place, _KEY], table[place, _VALUE] = key, part
                used += 1
                if part >= 0:
                    table[place, _VALUE], voxels[count, COUNT] = _PARTS * count + part, 0.0
                    for axis in range(3):
                        voxels[count, axis], voxels[count, 3 + axis] = math.inf, -math.inf
                    count += 1
            last, number = key, table[place, _VALUE]
            if number >= 0:
                number, part = number // _PARTS, number % _PARTS
        if number < 0:
            tally[OF_ARM if number == _ARM_ALONE else IGNORED] += 1
            continue
        if part != _NONE:
            if _is_inside(part % 4, (x, y, z), arm.rows, arm.data):
                tally[OF_ARM] += 1
                continue
            if _is_inside(part // 4, (x, y, z), ignored.rows, ignored.data):
                tally[IGNORED] += 1
                continue
        numbers[n] = number
        voxels[number, COUNT] += 1.0
        voxels[number, 0], voxels[number, 3] = min(voxels[number, 0], x), max(voxels[number, 3], x)
        voxels[number, 1], voxels[number, 4] = min(voxels[number, 1], y), max(voxels[number, 4], y)
        voxels[number, 2], voxels[number, 5] = min(voxels[number, 2], z), max(voxels[number, 5], z)
    done[0], done[1], done[2] = points.shape[0], count, used


@kernel
def _is_ignored_alone(point: Vector, arm: Bodies, ignored: Bodies) -> bool:
    """Whether a point is in what is to be ignored, and not in the arm, which comes first."""
    return (
        distance_from_bodies(point, ignored.rows, ignored.data, 0.0) <= 0.0
        and distance_from_bodies(point, arm.rows, arm.data, 0.0) > 0.0
    )


@kernel
def _parts_inside(middle: Vector, arm: Bodies, ignored: Bodies, edge: float) -> int:
    """How much of a voxel is in the arm, and four times how much in what is ignored; less than 0 where none stays."""
    half = 0.5 * math.sqrt(3.0) * edge
    of_arm = _part_inside(middle, arm.rows, arm.data, half)
    if of_arm == _ALL:
        return _ARM_ALONE
    of_ignored = _part_inside(middle, ignored.rows, ignored.data, half)
    return _IGNORED_ALONE if of_arm == _NONE and of_ignored == _ALL else of_arm + 4 * of_ignored


@kernel
def mark_isolated(voxels: FloatArray, placement: Placement, least: int, distance: float, isolated: BoolArray) -> None:
    """Mark voxels with few points about them: in voxels whose boxes are within a distance of theirs.

    Voxels stand in larger cells, by the first corners of their boxes: of two within the distance these are in one cell,
    or in two that touch.

    Args:
        distance: A point with so many within this distance, itself among them, stays [m].
        isolated: (m,) written.
    """
    reach = placement.reach
    edge = max(distance, placement.edge[0]) + placement.edge[0]
    size = 64
    while size < 2 * len(voxels):
        size *= 2
    # The last voxel of each cell, and of each voxel the one before it in its cell.
    cells = np.full((size, 2), -1, dtype=np.int64)
    before = np.empty(len(voxels), dtype=np.int32)
    for number in range(len(voxels)):
        if voxels[number, COUNT] > 0:
            key = _cell_of(voxels[number], reach, edge)
            place = _place(key, cells)
            before[number] = cells[place, _VALUE]
            cells[place, _KEY], cells[place, _VALUE] = key, number
    for number in range(len(voxels)):
        if 0 < voxels[number, COUNT] < least:
            near, key = 0.0, _cell_of(voxels[number], reach, edge)
            for turn in range(27):
                if near >= least:
                    break
                step = (turn + 13) % 27  # its own cell first
                offset = ((step // 9 - 1) << (2 * BITS)) + ((step // 3 % 3 - 1) << BITS) + step % 3 - 1
                other = cells[_place(key + offset, cells), _VALUE]
                while other >= 0 and near < least:
                    if _box_gap(voxels[number], voxels[other]) <= distance:
                        near += voxels[other, COUNT]
                    other = before[other]
            isolated[number] = near < least


@inlined
def _box_gap(a: FloatArray, b: FloatArray) -> float:
    """Distance between two boxes of least and largest coordinates."""
    x = max(0.0, max(a[0] - b[3], b[0] - a[3]))
    y = max(0.0, max(a[1] - b[4], b[1] - a[4]))
    z = max(0.0, max(a[2] - b[5], b[2] - a[5]))
    return math.sqrt(x * x + y * y + z * z)


@inlined
def _cell_of(box: FloatArray, middle: FloatArray, edge: float) -> int:
    return _packed(
        math.floor((box[0] - middle[0]) / edge),
        math.floor((box[1] - middle[1]) / edge),
        math.floor((box[2] - middle[2]) / edge),
    )


@kernel
def middles(
    points: FloatArray, placement: Placement, numbers: ShortArray, voxels: FloatArray, dropped: BoolArray
) -> tuple[FloatArray, float]:
    """One point for each voxel: the middle of the box about its points.

    Args:
        points: (n, 3) points in the camera's frame [m].
        numbers: (n,) the voxel of each point; -1 for none.
        dropped: (m,) voxels that do not stay.

    Returns:
        (k, 3) points, and the largest distance of a point from the one of its voxel [m].
    """
    rotation, position = placement.rotation, placement.position
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
    for n in range(points.shape[0]):
        number = numbers[n]
        if number >= 0 and halves[number] > growth:
            x, y, z = _transformed(
                np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2]), rotation, position
            )
            dx, dy, dz = x - found[number, 0], y - found[number, 1], z - found[number, 2]
            growth = max(growth, dx * dx + dy * dy + dz * dz)
    count = 0
    for number in range(len(voxels)):
        if voxels[number, COUNT] > 0 and not dropped[number]:
            for axis in range(3):
                found[count, axis] = found[number, axis]
            count += 1
    return found[:count].copy(), math.sqrt(growth)
