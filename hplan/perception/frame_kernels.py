"""Kernels of `hplan.perception.frame`: one pass over a frame's points, which puts those that stay into voxels.

A voxel of a regular grid in `base_link` is made when the first point falls into it. Then it is decided, by the distance
of its middle from a body, whether all its points are in the body, none, or some: only of the last kind every point is
asked. So a point costs what it takes to find its voxel, and the body costs what there are of voxels at its surface.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, ShortArray
from hplan.base.kernels import inlined, kernel
from hplan.collision import obstacle_rows as row
from hplan.collision.distances import Vector, point_segment, segment_box, segment_hull
from hplan.scene.cloud_tree import cell_place, larger_table

#: Places in a tally: rows that are not finite, points out of reach, of the arm, of what is ignored.
NOT_FINITE, OUT_OF_REACH, OF_ARM, IGNORED = 0, 1, 2, 3

#: How much of a voxel is in a body.
_NONE, _ALL, _SOME = 0, 1, 2

_FIRST_CELLS = 16_384
_UNUSED = -(2**62)


class Bodies(NamedTuple):
    """Solids grown by a padding, as `hplan.collision.obstacle_rows.solid_rows` gives them."""

    rows: FloatArray
    data: FloatArray


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


class Voxels(NamedTuple):
    """Voxels with points in them, numbered as they first appear.

    Attributes:
        cells: (m, 3) place in the grid.
        boxes: (m, 6) least and largest coordinates of its points [m].
        counts: (m,) how many points it has.
        parts: (m,) how much of it is in the arm, and four times how much is in what is ignored.
    """

    cells: IntArray
    boxes: FloatArray
    counts: ShortArray
    parts: ShortArray


@kernel
def distance_from_bodies(point: Vector, rows: FloatArray, data: FloatArray, enough: float) -> float:
    """Distance of a point from the nearest solid, negative in its rounding; infinite where it is above `enough`."""
    least, still, following = math.inf, (0.0, 0.0, 0.0), 0
    limit = enough
    while following < rows.shape[0]:
        s = following
        following = s + 1
        dx, dy, dz = (
            rows[s, row.CENTRE] - point[0],
            rows[s, row.CENTRE + 1] - point[1],
            rows[s, row.CENTRE + 2] - point[2],
        )
        within = limit + rows[s, row.BOUND]
        kind = rows[s, row.KIND]
        if dx * dx + dy * dy + dz * dz > within * within or within < 0.0:
            following = int(rows[s, row.NEXT]) if kind >= row.NODE else s + 1
            continue
        ax, ay, az = rows[s, row.SHAPE], rows[s, row.SHAPE + 1], rows[s, row.SHAPE + 2]
        apart = math.inf
        if kind == row.POINT:
            apart = math.sqrt(dx * dx + dy * dy + dz * dz)
        elif kind == row.SEGMENT:
            bx, by, bz = rows[s, row.SECOND_END], rows[s, row.SECOND_END + 1], rows[s, row.SECOND_END + 2]
            apart = point_segment(point, (ax, ay, az), (bx - ax, by - ay, bz - az))
        elif kind == row.BOX:
            apart = _box_distance((-dx, -dy, -dz), rows[s], still)
        elif kind == row.HULL:
            apart = segment_hull(point, still, data, int(ax), int(ay), int(az), limit + rows[s, row.RADIUS])
        elif kind == row.LOT:
            for p in range(int(rows[s, row.POINTS]), int(rows[s, row.POINTS_END]), 3):
                apart = min(apart, point_segment((data[p], data[p + 1], data[p + 2]), point, still))
        least = min(least, apart - rows[s, row.RADIUS])
        limit = min(limit, least)
    return least if least <= enough else math.inf


@kernel
def _box_distance(offset: Vector, solid: FloatArray, still: Vector) -> float:
    """Distance of a point, seen from the box's middle, from a row that is a box."""
    a, (x, y, z) = row.AXES, offset
    local = (
        x * solid[a] + y * solid[a + 1] + z * solid[a + 2],
        x * solid[a + 3] + y * solid[a + 4] + z * solid[a + 5],
        x * solid[a + 6] + y * solid[a + 7] + z * solid[a + 8],
    )
    apart: float = segment_box(local, still, (solid[row.SHAPE], solid[row.SHAPE + 1], solid[row.SHAPE + 2]))
    return apart


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


def put_into_voxels(
    points: FloatArray, placement: Placement, arm: Bodies, ignored: Bodies, numbers: ShortArray, tally: IntArray
) -> Voxels:
    """Put the points of a frame that stay into voxels.

    Args:
        points: (n, 3) points in the camera's frame, float32 or float64 [m].
        placement: Where the camera is, and what is within reach.
        arm: The arm, grown by its padding.
        ignored: What is to be left out, grown by its padding.
        numbers: (n,) the voxel of each point, written; -1 where it does not stay.
        tally: (4,) how many do not stay, by the reason, written.

    Returns:
        The voxels; some may hold no point.
    """
    room, done, count = _FIRST_CELLS, 0, 0
    voxels, table = _room_for(room), np.full(2 * room, -1, dtype=np.int32)
    while True:
        done, count = _fill(points, placement, arm, ignored, voxels, table, (done, count), numbers, tally)
        if done == len(points):
            cells, boxes, counts, parts = voxels
            return Voxels(cells[:count], boxes[:count], counts[:count], parts[:count])
        room *= 4
        more = _room_for(room)
        more.cells[:count], more.boxes[:count], more.counts[:count], more.parts[:count] = voxels
        voxels, table = more, larger_table(more.cells, count, 2 * room)


def _room_for(count: int) -> Voxels:
    return Voxels(
        np.empty((count, 3), dtype=np.int64),
        np.empty((count, 6)),
        np.zeros(count, dtype=np.int32),
        np.zeros(count, dtype=np.int32),
    )


# The arrays stay the same in here: where a loop makes larger ones, numba counts all of them at every turn, 200 ns.
@kernel
def _fill(
    points: FloatArray, placement: Placement, arm: Bodies, ignored: Bodies, voxels: Voxels, table: ShortArray,
    begin: tuple[int, int], numbers: ShortArray, tally: IntArray,
) -> tuple[int, int]:  # fmt: skip
    """Put points into voxels until there is no room for another voxel.

    Returns:
        How many points are done, and how many voxels there are.
    """
    rotation, position, reach, edge = placement.rotation, placement.position, placement.reach, placement.edge[0]
    cells, boxes, counts, parts = voxels
    half, per_metre, square = 0.5 * math.sqrt(3.0) * edge, 1.0 / edge, reach[3] * reach[3]
    first, count = begin
    i, j, k, number = _UNUSED, 0, 0, 0
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
        a, b, c = math.floor(x * per_metre), math.floor(y * per_metre), math.floor(z * per_metre)
        if a != i or b != j or c != k:  # neighbours in a frame are often in one voxel
            place = cell_place(a, b, c, cells, table)
            if table[place] < 0:
                if count == len(counts):
                    return n, count
                middle = ((a + 0.5) * edge, (b + 0.5) * edge, (c + 0.5) * edge)
                parts[count] = _part_inside(middle, arm.rows, arm.data, half)
                parts[count] += 4 * _part_inside(middle, ignored.rows, ignored.data, half)
                cells[count, 0], cells[count, 1], cells[count, 2] = a, b, c
                for axis in range(3):
                    boxes[count, axis], boxes[count, 3 + axis] = math.inf, -math.inf
                table[place] = count
                count += 1
            i, j, k, number = a, b, c, table[place]
        if parts[number] != 0:
            if _is_inside(parts[number] % 4, (x, y, z), arm.rows, arm.data):
                tally[OF_ARM] += 1
                continue
            if _is_inside(parts[number] // 4, (x, y, z), ignored.rows, ignored.data):
                tally[IGNORED] += 1
                continue
        numbers[n] = number
        counts[number] += 1
        boxes[number, 0], boxes[number, 3] = min(boxes[number, 0], x), max(boxes[number, 3], x)
        boxes[number, 1], boxes[number, 4] = min(boxes[number, 1], y), max(boxes[number, 4], y)
        boxes[number, 2], boxes[number, 5] = min(boxes[number, 2], z), max(boxes[number, 5], z)
    return points.shape[0], count


@kernel
def mark_isolated(voxels: Voxels, least: int, isolated: BoolArray) -> None:
    """Mark voxels that hold, with the 26 about them, fewer points than `least`."""
    cells, _, counts, _ = voxels
    size = 64
    while size < 2 * len(counts):
        size *= 2
    table = larger_table(cells, len(counts), size)
    for number in range(len(counts)):
        found = counts[number]
        for step in range(27):
            if found >= least:
                break
            if step == 13:
                continue
            i, j, k = step // 9 - 1, step // 3 % 3 - 1, step % 3 - 1
            other = table[cell_place(cells[number, 0] + i, cells[number, 1] + j, cells[number, 2] + k, cells, table)]
            if other >= 0:
                found += counts[other]
        isolated[number] = found < least


@kernel
def middles(
    points: FloatArray, placement: Placement, numbers: ShortArray, voxels: Voxels, dropped: BoolArray
) -> tuple[FloatArray, float]:
    """One point for each voxel: the middle of the box about its points.

    Args:
        points: (n, 3) points in the camera's frame [m].
        placement: Where the camera is.
        numbers: (n,) the voxel of each point; -1 for none.
        voxels: The voxels.
        dropped: (m,) voxels that do not stay.

    Returns:
        (k, 3) points, and the largest distance of a point from the one of its voxel [m].
    """
    rotation, position = placement.rotation, placement.position
    _, boxes, counts, _ = voxels
    found, halves = np.empty((len(counts), 3)), np.empty(len(counts))
    for number in range(len(counts)):
        square = 0.0
        for axis in range(3):
            low, high = boxes[number, axis], boxes[number, 3 + axis]
            found[number, axis] = low if low == high else 0.5 * (low + high)
            square += 0.25 * (high - low) * (high - low)
        halves[number] = square if counts[number] > 1 and not dropped[number] else -1.0
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
    for number in range(len(counts)):
        if counts[number] > 0 and not dropped[number]:
            found[count] = found[number]
            count += 1
    return found[:count].copy(), math.sqrt(growth)


@kernel
def _distances_from_bodies(points: FloatArray, rows: FloatArray, data: FloatArray, found: FloatArray) -> None:
    for n in range(points.shape[0]):
        found[n] = distance_from_bodies((points[n, 0], points[n, 1], points[n, 2]), rows, data, math.inf)


def distances_from_bodies(points: FloatArray, rows: FloatArray, data: FloatArray) -> FloatArray:
    """(n,) distances of (n, 3) points from the nearest solid, negative in its rounding; infinite without any [m]."""
    found = np.empty(len(points))
    _distances_from_bodies(np.array(points, dtype=np.float64, order="C"), rows, data, found)
    return found
