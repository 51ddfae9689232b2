"""Memory of points seen earlier and hidden in the current frame.

Points are kept for a limited time, and removed when the camera looks through them. The directions around the camera are
divided into cells on the six sides of a cube, each about half a degree wide. For every cell the minimum range in the
frame is recorded, of the arm and of points out of range as well. A remembered point in a cell

- with a nearer measurement is hidden: it remains;
- without measurements is out of view, or in a direction without a return: it remains;
- with all measurements at the point's range or beyond is visible: the frame decides.

Points within the arm's padding cannot be distinguished from the arm, and remain too, unless the arm is in their ball
(`hplan.online.frame`). So a point is removed only if the camera sees that it is gone, or by its age. A measured outlier
in front of a point keeps the point for as long. A point next to the edge of a nearer object counts as hidden over the
whole of its cell.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray
from hplan.base.kernels import any_int, inline, kernel

#: Cells along each side of the cube.
CELLS: Final = 180
_CELLS: Final = any_int(CELLS)


@inline
def side_of_cube(x: float, y: float, z: float) -> tuple[int, float, float, float]:
    """Side of the cube that a direction meets, and its coordinates there.

    The side is given by the longest coordinate; its length and the other two coordinates follow.
    """
    ax, ay, az = abs(x), abs(y), abs(z)
    if az >= ax and az >= ay:
        found = ((0 if z > 0.0 else 1), az, x, y)
    elif ax >= ay:
        found = ((2 if x > 0.0 else 3), ax, y, z)
    else:
        found = ((4 if y > 0.0 else 5), ay, x, z)
    return found


@inline
def _direction_indices(x: float, y: float, z: float) -> int:
    """Index of the cell of a direction."""
    side, longest, u, v = side_of_cube(x, y, z)
    scale = 0.5 * CELLS / max(longest, 1e-300)
    column = min(int(u * scale + 0.5 * CELLS), CELLS - 1)
    line = min(int(v * scale + 0.5 * CELLS), CELLS - 1)
    return (side * CELLS + column) * CELLS + line


@kernel
def cells_about(x: float, y: float, z: float, radius: float, cells: int) -> tuple[int, int, int, int, int]:
    """Cells of all directions to a ball: a rectangle on one side.

    Sides are divided into `cells` cells along each axis. Returns the first cell of the side, first and last column, and
    first and last line. The range of columns is empty (the last before the first) if the ball contains the camera, or
    extends over more than one side of the cube.
    """
    side, longest, u, v = side_of_cube(x, y, z)
    near, far = longest - radius, longest + radius
    if near <= 0.0:
        return 0, 0, -1, 0, -1
    left, right, low, high = u - radius, u + radius, v - radius, v + radius
    left, right = left / (near if left < 0.0 else far), right / (near if right > 0.0 else far)
    low, high = low / (near if low < 0.0 else far), high / (near if high > 0.0 else far)
    if left < -1.0 or right > 1.0 or low < -1.0 or high > 1.0:
        return 0, 0, -1, 0, -1
    half = 0.5 * cells
    columns = int(left * half + half), min(int(right * half + half), cells - 1)
    lines = int(low * half + half), min(int(high * half + half), cells - 1)
    return side * cells * cells, columns[0], columns[1], lines[0], lines[1]


@kernel
def _note_ranges(points: FloatArray, balls: FloatArray, ranges: FloatArray) -> None:
    """Write the minimum squared range of each direction.

    `points` are in the camera's frame. A point inside one of the balls, (k, 4) centres and radii, counts as the exit
    point of its ray from the ball.
    """
    meets = np.zeros(ranges.shape[0], dtype=np.bool_)
    for b in range(balls.shape[0]):
        begin, first, last, top, bottom = cells_about(balls[b, 0], balls[b, 1], balls[b, 2], balls[b, 3], _CELLS)
        for column in range(first, last + 1):
            for line in range(top, bottom + 1):
                meets[begin + column * CELLS + line] = True
    for n in range(points.shape[0]):
        x, y, z = np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2])
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            continue
        square = x * x + y * y + z * z
        if not 0.0 < square < math.inf:
            continue
        cell = _direction_indices(x, y, z)
        if meets[cell]:
            length = math.sqrt(square)
            away = float(length)
            for b in range(balls.shape[0]):
                bx, by, bz = balls[b, 0], balls[b, 1], balls[b, 2]
                along = (x * bx + y * by + z * bz) / length
                within = balls[b, 3] * balls[b, 3] - (bx * bx + by * by + bz * bz - along * along)
                if within > 0.0 and abs(away - along) <= math.sqrt(within):
                    away = along + math.sqrt(within)
            square = np.float64(away * away)
        ranges[cell] = min(ranges[cell], square)


# (A product with such a thin matrix may wait for all processors.)
@kernel
def _mark_hidden(
    points: FloatArray, pose: tuple[FloatArray, FloatArray], ranges: FloatArray, tolerance: float, hidden: BoolArray
) -> None:
    """Mark the points that a frame does not see."""
    turn, position = pose
    for n in range(points.shape[0]):
        dx, dy, dz = points[n, 0] - position[0], points[n, 1] - position[1], points[n, 2] - position[2]
        x = turn[0, 0] * dx + turn[1, 0] * dy + turn[2, 0] * dz
        y = turn[0, 1] * dx + turn[1, 1] * dy + turn[2, 1] * dz
        z = turn[0, 2] * dx + turn[1, 2] * dy + turn[2, 2] * dz
        least = ranges[_direction_indices(x, y, z)]
        hidden[n] = least == math.inf or math.sqrt(least) < math.sqrt(x * x + y * y + z * z) - tolerance


def shortest_ranges(frame: FloatArray, through: FloatArray | None = None) -> FloatArray:
    """(6 CELLS^2,) minimum squared range of each direction; infinite without measurements.

    `frame` is (n, 3) in the camera's frame [m].

    Args:
        through: (k, 4) centres and radii of balls in the camera's frame: a point in a ball counts as the exit point of
            its ray [m].
    """
    ranges = np.full(6 * CELLS * CELLS, np.inf)
    _note_ranges(frame, np.zeros((0, 4)) if through is None else through, ranges)
    return ranges


def hidden(points: FloatArray, frame: FloatArray, pose: tuple[FloatArray, FloatArray]) -> BoolArray:
    """(k,) mask of the points behind something or out of view.

    Args:
        points: (k, 3) points [m].
        frame: (n, 3) the frame's points in the camera's frame; points that are not finite are no measurements [m].
        pose: (3, 3) rotation and (3,) position of the camera, in the frame of `points` [m].
    """
    ranges = shortest_ranges(frame)
    found = np.zeros(len(points), dtype=np.bool_)
    # A point counts as visible if the measurement in its cell is nearer by less than this [m]: noise, and the size of a
    # voxel, do not hide a point behind itself.
    _mark_hidden(points, pose, ranges, 0.03, found)
    return found
