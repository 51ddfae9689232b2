r"""Cells of a joint grid that are in contact whole, whatever the joints do that have no axis: no motion passes them.

The configurations of a box differ from its middle by half of its size, :math:`e_j` of joint :math:`j`, at most, so
body :math:`k` of the arm is nowhere farther than :math:`s_k = \sum_j R_{kj} e_j` from where it is at the middle, with
the motion-bound coefficients :math:`R` (`hplan.collision.reach`), and its clearance, negative by the depth in contact,
is nowhere larger by more than that. If it is below :math:`-s_k` at the middle, the whole box is in contact.

A cell is cut into parts for that, and so are the ranges of the joints that have no axis: it is in contact whole if each
part is. Along the first axis clearances change by no more than :math:`R_{kj}` for each radian: cells between are known.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, WordArray
from hplan.base.kernels import kernel
from hplan.collision.body_kernels import body_clearances
from hplan.collision.obstacle_rows import FieldArrays

#: What kernels' distances are exact to; a hull that is flat made thicker is in it [m].
ACCURACY = 1e-4

#: Axes of a grid; those that are missing have one cell.
AXES = 3

#: Larger clearances are not looked for [m].
_FAR = 0.1


class Cells(NamedTuple):
    """A grid over some joints; the first axis is the one whose cells are bits.

    Attributes:
        joints: (AXES,) numbers of the joints in a configuration; -1 for an axis without one.
        lower: (dof,) where the first cells of joints with an axis begin, and the ranges of the others [rad, m].
        sizes: (dof,) sizes of cells, and of the ranges of joints that have no axis [rad, m].
        parts: (dof,) into how many parts each of them is cut; 1 for the first axis.
        first: (n, AXES) first cells where the joints can be at some times.
        last: (n, AXES) last cells; others are not looked at.
        coefficients: (bodies, dof) motion-bound coefficients [m, 1].
        excess: (bodies,) by how much bodies are larger than the shapes that they stand for, at most [m].
        most_looks: After so many configurations no further row is looked at: its cells stay.
    """

    joints: IntArray
    lower: FloatArray
    sizes: FloatArray
    parts: IntArray
    first: IntArray
    last: IntArray
    coefficients: FloatArray
    excess: FloatArray
    most_looks: int


@kernel
def take_occupied(free: WordArray, field: FieldArrays, cells: Cells) -> None:
    """Clear the bits of cells that are shown to be in contact whole.

    Args:
        free: (counts[1], counts[2], words) bit i of a row is cell i of the first axis.
        field: Obstacles and bodies, without pairs of them.
    """
    bodies, dof = cells.coefficients.shape
    sway, clear = cells.excess + ACCURACY, np.empty(bodies)
    for k in range(bodies):
        for j in range(dof):
            if j != cells.joints[0]:
                sway[k] += 0.5 * cells.coefficients[k, j] * cells.sizes[j] / cells.parts[j]
    held, origin, q = np.empty(64 * free.shape[2], dtype=np.bool_), np.empty(dof), np.empty(dof)
    at, looks = np.zeros(AXES, dtype=np.int64), 0
    for x in range(free.shape[0]):
        for y in range(free.shape[1]):
            at[1], at[2] = x, y
            low, high = _window(cells, at)
            for j in range(dof):
                origin[j] = cells.lower[j]
            for axis in range(1, AXES):
                if cells.joints[axis] >= 0:
                    origin[cells.joints[axis]] += at[axis] * cells.sizes[cells.joints[axis]]
            for cell in range(low, high + 1):
                held[cell] = (free[x, y, cell >> 6] >> np.uint64(cell & 63)) & np.uint64(1) != np.uint64(0)
            if looks > cells.most_looks:
                return
            if low <= high:
                looks += _sift_row(held, (low, high), (origin, q, sway, clear), field, cells)
            for cell in range(low, high + 1):
                if held[cell]:
                    free[x, y, cell >> 6] &= ~(np.uint64(1) << np.uint64(cell & 63))


@kernel
def _window(cells: Cells, at: IntArray) -> tuple[int, int]:
    """First and last cell of the first axis where the joints can be while the others are in a row."""
    low, high = cells.last.max(), -1
    for sample in range(cells.first.shape[0]):
        inside = True
        for axis in range(1, AXES):
            if cells.joints[axis] >= 0:
                inside &= cells.first[sample, axis] <= at[axis] <= cells.last[sample, axis]
        if inside:
            low, high = min(low, cells.first[sample, 0]), max(high, cells.last[sample, 0])
    return low, high


@kernel
def _sift_row(
    held: BoolArray,
    window: tuple[int, int],
    work: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    field: FieldArrays,
    cells: Cells,
) -> int:
    """Leave those cells of a row held that are in contact whole; how many configurations were looked at.

    Args:
        held: Cells that are looked at.
        window: The first of them and the last.
        work: (dof,) where the row begins, (dof,) numbers, (bodies,) how far bodies move from the middle of a part and
            by how much they are too large, (bodies,) numbers.
    """
    origin, q, sway, clear = work
    first, (low, high) = cells.joints[0], window
    looks = 0
    for part in range(cells.parts.prod()):
        number = part
        for j in range(len(q)):
            q[j] = origin[j] + (number % cells.parts[j] + 0.5) * cells.sizes[j] / cells.parts[j]
            number //= cells.parts[j]
        some, cell = False, low
        while cell <= high:
            if not held[cell]:
                cell += 1
                continue
            q[first] = cells.lower[first] + (cell + 0.5) * cells.sizes[first]
            body_clearances(q, field, _FAR, clear)
            looks += 1
            # Cells from here on that are in contact, and that are not shown to be, as far as is known.
            occupied, unknown = 0.0, np.inf
            for k in range(len(clear)):
                travel = cells.coefficients[k, first] * cells.sizes[first]
                beyond = clear[k] + sway[k] + 0.5 * travel
                known = abs(beyond) / travel if travel > 0.0 else np.inf
                if beyond < 0.0:
                    occupied = max(occupied, known)
                else:
                    unknown = min(unknown, known)
            if occupied > 0.0:
                some = True
                cell += int(min(high + 1.0, np.ceil(occupied)))
            else:
                end = cell + int(min(high + 1.0, max(1.0, np.ceil(unknown))))
                for other in range(cell, min(end, high + 1)):
                    held[other] = False
                cell = end
        if not some:
            break
    return looks
