r"""Cells of a joint grid that a motion can reach in time.

No motion passes the cells that are entirely in contact. They are in contact for all values of the joints without an
axis. The configurations of a box differ from its center by at most half of its size, :math:`e_j` in joint :math:`j`.
Body :math:`k` of the arm is therefore nowhere farther than :math:`s_k = \sum_j R_{kj} e_j` from its position at the
center, with the motion-bound coefficients :math:`R` (`hplan.collision.motion_coefficients`), and its clearance
(negative by the depth in contact) is nowhere larger by more than that. If it is below :math:`-s_k` at the center, the
whole box is in contact.

A cell is divided into parts for this test, and so are the ranges of the joints without an axis: it is entirely in
contact if each part is. Along the first axis clearances change by at most :math:`R_{kj}` per radian, which decides the
cells in between.

The times are equally spaced. Cells are as large as the joints can move at full speed from one sample to the next, so
that a joint moves by at most one cell per sample. A cell is reached if it is not entirely in contact and is within the
bounds of that time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, WordArray
from hplan.base.kernels import any_int, kernel
from hplan.collision.compiled_clearance import body_clearances
from hplan.collision.compiled_obstacles import FieldArrays

#: Accuracy of the kernels' distances, including the thickness added to flat hulls [m].
ACCURACY = 1e-4

#: Number of axes of a grid; missing axes have one cell.
AXES = 3

#: Clearances are clamped to this value [m].
_FAR = 0.1


class ClearCells(NamedTuple):
    """A grid over some joints; bits run along the first axis.

    Attributes:
        joints: (AXES,) numbers of the joints in a configuration; -1 for an axis without one.
        lower: (dof,) lower edges of the first cells of joints with an axis, and of the ranges of the others [rad, m].
        sizes: (dof,) sizes of cells, and of the ranges of joints without an axis [rad, m].
        parts: (dof,) number of parts of each of them; 1 for the first axis.
        first: (n, AXES) first cells that the joints can occupy at some times.
        last: (n, AXES) last cells that the joints can occupy at these times; cells outside are not checked.
        coefficients: (bodies, dof) motion-bound coefficients [m, 1].
        excess: (bodies,) maximum excess of bodies over the shapes that they represent [m].
        most_looks: Number of distance queries after which no further row is checked: its cells stay.
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
def take_occupied(free: WordArray, field: FieldArrays, cells: ClearCells) -> None:
    """Clear the bits of cells proved to be entirely in contact.

    Args:
        free: (counts[1], counts[2], words) bit i of a row is cell i of the first axis.
        field: Obstacles and bodies, without pairs of bodies.
        cells: The grid.
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
def _window(cells: ClearCells, at: IntArray) -> tuple[int, int]:
    """First and last cell of a row that a motion can occupy.

    `at` has the cells of the other axes.
    """
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
    cells: ClearCells,
) -> int:
    """Mark the cells of a row that are entirely in contact.

    Args:
        held: Cells to check; those not proved to be in contact become False.
        window: The first and the last of them.
        work: (dof,) the configuration where the row begins, (dof,) scratch, (bodies,) maximum travel of bodies from the
            center of a part plus their excess, (bodies,) scratch.
        field: Obstacles and bodies, without pairs of bodies.
        cells: The grid.

    Returns:
        The number of distance queries.
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
            # Numbers of cells from here on that are in contact, and that are not proved to be, as far as is known.
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


#: The first cell or sample, for kernels.
_FIRST = any_int(0)


class Samples(NamedTuple):
    """Bounds of the motion at its samples, in cells along each axis.

    Attributes:
        first: (n, 3) first cells.
        last: (n, 3) last cells.
    """

    first: IntArray
    last: IntArray


@kernel
def is_reachable(free: WordArray, samples: Samples) -> bool:
    """True if cells connect the first sample with the last.

    Args:
        free: (nx, ny, words) bits of the cells not entirely in contact; the first axis is along the words.
        samples: Bounds of the motion at its samples.
    """
    states = free.copy()
    some = _keep(states, free, samples, _FIRST)
    for k in range(1, samples.first.shape[0]):
        if not some:
            return False
        _advance(states, samples, k)
        some = _keep(states, free, samples, k)
    return some


@kernel
def _advance(states: WordArray, samples: Samples, k: int) -> None:
    """Add the neighbours of sample k - 1's cells, in place."""
    first, last = samples
    _, ny, words = states.shape
    low_x, high_x = min(first[k - 1, 1], first[k, 1]), max(last[k - 1, 1], last[k, 1])
    low_y, high_y = min(first[k - 1, 2], first[k, 2]), max(last[k - 1, 2], last[k, 2])
    for x in range(first[k - 1, 1], last[k - 1, 1] + 1):
        for y in range(first[k - 1, 2], last[k - 1, 2] + 1):
            _widen(states[x, y])
        _spread(states[x], low_y, high_y, _FIRST, words)
    _spread(states.reshape(len(states), ny * words), low_x, high_x, low_y * words, (high_y + 1) * words)


@kernel
def _keep(states: WordArray, free: WordArray, samples: Samples, k: int) -> bool:
    """Clear cells out of bounds at sample k or entirely in contact.

    Args:
        states: (nx, ny, words) the cells.
        free: Bits of the cells not entirely in contact.
        samples: Bounds of the motion at its samples.
        k: Number of the sample.

    Returns:
        True if any cell is left.
    """
    first, last = samples
    window = np.zeros(states.shape[2], dtype=np.uint64)
    for cell in range(first[k, 0], last[k, 0] + 1):
        window[cell >> 6] |= np.uint64(1) << np.uint64(cell & 63)
    # The first sample starts with all cells, later ones with the neighbours of the previous sample's cells.
    low_x, high_x, low_y, high_y = 0, states.shape[0] - 1, 0, states.shape[1] - 1
    if k > 0:
        low_x, high_x = min(first[k - 1, 1], first[k, 1]), max(last[k - 1, 1], last[k, 1])
        low_y, high_y = min(first[k - 1, 2], first[k, 2]), max(last[k - 1, 2], last[k, 2])
    some = np.uint64(0)
    for x in range(low_x, high_x + 1):
        for y in range(low_y, high_y + 1):
            inside = first[k, 1] <= x <= last[k, 1] and first[k, 2] <= y <= last[k, 2]
            for w in range(len(window)):
                states[x, y, w] &= window[w] & free[x, y, w] if inside else np.uint64(0)
                some |= states[x, y, w]
    return bool(some != np.uint64(0))


@kernel
def _spread(rows: WordArray, low: int, high: int, begin: int, end: int) -> None:
    """Unite the rows low to high with their neighbours, in place."""
    for i in range(low, high):
        for w in range(begin, end):
            rows[i, w] |= rows[i + 1, w]
    for i in range(high, low, -1):
        for w in range(begin, end):
            rows[i, w] |= rows[i - 1, w]


@kernel
def _widen(row: WordArray) -> None:
    """Unite the bits of a row with their neighbours."""
    one, last, below = np.uint64(1), np.uint64(63), np.uint64(0)
    for w in range(len(row)):
        value = row[w]
        above = row[w + 1] << last if w + 1 < len(row) else np.uint64(0)
        row[w] = value | value << one | value >> one | below | above
        below = value >> last
