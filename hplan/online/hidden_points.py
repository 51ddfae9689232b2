"""What was seen earlier and is hidden now: remembered for a time, forgotten where the camera looks through it.

The directions about the camera are cut into cells on the six sides of a cube, each about half a degree wide. In every
cell the shortest range of a frame is noted, of the arm and of what is out of reach too. A remembered point in a cell

- in which something nearer was measured is hidden: it stays;
- in which nothing was measured is out of view, or in a direction without a return: it stays;
- in which everything that was measured is as far away as the point, or farther, is seen: the frame says what is there.

What is within the arm's padding cannot be told from the arm, and stays too, unless the arm stands in it
(`hplan.online.frame`). So nothing is taken away that the camera does not see to be gone, but for its age. An
outlier in front keeps what is behind it for as long. A point at the edge of something nearer counts as hidden with the
whole of its cell.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray
from hplan.base.kernels import any_int, inlined, kernel

#: Cells along each side of the cube.
CELLS: Final = 180
_CELLS: Final = any_int(CELLS)


@inlined
def side_of_cube(x: float, y: float, z: float) -> tuple[int, float, float, float]:
    """The side of the cube that a direction meets, by its longest coordinate; that one's length, and the others."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if az >= ax and az >= ay:
        found = ((0 if z > 0.0 else 1), az, x, y)
    elif ax >= ay:
        found = ((2 if x > 0.0 else 3), ax, y, z)
    else:
        found = ((4 if y > 0.0 else 5), ay, x, z)
    return found


@inlined
def _direction(x: float, y: float, z: float) -> int:
    """Number of the cell in which a direction lies."""
    side, longest, u, v = side_of_cube(x, y, z)
    scale = 0.5 * CELLS / max(longest, 1e-300)
    column = min(int(u * scale + 0.5 * CELLS), CELLS - 1)
    line = min(int(v * scale + 0.5 * CELLS), CELLS - 1)
    return (side * CELLS + column) * CELLS + line


@kernel
def cells_about(x: float, y: float, z: float, radius: float, cells: int) -> tuple[int, int, int, int, int]:
    """The cells of all directions to a ball: the side's first cell, first and last column, first and last line.

    Sides are cut into so many cells each way. There is no column (the last before the first) where the ball is about
    the camera, or on more than one side of the cube.
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
    """Write the least squared range of each direction, of points in the camera's frame.

    A point on the way through a ball, (k, 4) centres and radii, counts as where the ray comes out of it.
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
        cell = _direction(x, y, z)
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


# (A product with so thin a matrix may wait for all processors.)
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
        least = ranges[_direction(x, y, z)]
        hidden[n] = least == math.inf or math.sqrt(least) < math.sqrt(x * x + y * y + z * z) - tolerance


def shortest_ranges(frame: FloatArray, through: FloatArray | None = None) -> FloatArray:
    """(6 CELLS^2,) least squared range of each direction of (n, 3) points in the camera's frame; infinite for none.

    Args:
        through: (k, 4) centres and radii of balls in the camera's frame: a point in one counts as where the ray through
            it comes out of the ball [m].
    """
    ranges = np.full(6 * CELLS * CELLS, np.inf)
    _note_ranges(frame, np.zeros((0, 4)) if through is None else through, ranges)
    return ranges


def hidden(points: FloatArray, frame: FloatArray, pose: tuple[FloatArray, FloatArray]) -> BoolArray:
    """(k,) mask of the points that a frame does not see, being behind something or out of view.

    Args:
        points: (k, 3) points [m].
        frame: (n, 3) the frame's points in the camera's frame; not finite ones are no measurements [m].
        pose: (3, 3) rotation and (3,) position of the camera, as the points are given [m].
    """
    ranges = shortest_ranges(frame)
    found = np.zeros(len(points), dtype=np.bool_)
    # A point counts as seen where what was measured in its cell is nearer by less than this [m]: noise, and the size
    # of a voxel, do not hide a point behind itself.
    _mark_hidden(points, pose, ranges, 0.03, found)
    return found
