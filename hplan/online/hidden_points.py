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
from hplan.base.kernels import inlined, kernel

#: Cells along each side of the cube.
CELLS: Final = 180


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
def _note_ranges(points: FloatArray, ranges: FloatArray) -> None:
    """Write the least squared range of each direction, of points in the camera's frame."""
    for n in range(points.shape[0]):
        x, y, z = np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2])
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(z):
            square = x * x + y * y + z * z
            if 0.0 < square < math.inf:
                cell = _direction(x, y, z)
                ranges[cell] = min(ranges[cell], square)


@kernel
def _mark_hidden(points: FloatArray, ranges: FloatArray, tolerance: float, hidden: BoolArray) -> None:
    """Mark the points, in the camera's frame, that a frame does not see."""
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        least = ranges[_direction(x, y, z)]
        hidden[n] = least == math.inf or math.sqrt(least) < math.sqrt(x * x + y * y + z * z) - tolerance


def shortest_ranges(frame: FloatArray) -> FloatArray:
    """(6 CELLS^2,) least squared range of each direction of (n, 3) points in the camera's frame; infinite for none."""
    ranges = np.full(6 * CELLS * CELLS, np.inf)
    _note_ranges(frame, ranges)
    return ranges


def hidden(points: FloatArray, frame: FloatArray) -> BoolArray:
    """(k,) mask of the points that a frame does not see, being behind something or out of view.

    Args:
        points: (k, 3) points in the camera's frame [m].
        frame: (n, 3) the frame's points in the camera's frame; not finite ones are no measurements [m].
    """
    ranges = shortest_ranges(frame)
    found = np.zeros(len(points), dtype=np.bool_)
    # A point counts as seen where what was measured in its cell is nearer by less than this [m]: noise, and the size
    # of a voxel, do not hide a point behind itself.
    _mark_hidden(np.ascontiguousarray(points), ranges, 0.03, found)
    return found
