r"""Cells of the joint grid that are in contact whole: no motion passes them.

The configurations of a cell differ from its middle by half of its size :math:`e` at most, so no point of the axis of
link :math:`k` is farther than :math:`s_k = \sum_{i \le k} L_i \sum_{j \le i} e_j` from where it is at the middle. The
distance of the axis from the core of an obstacle changes by no more than that. So if the middle's clearance, distance
of axis and core less both radii and less the clearance to keep, is below :math:`-s_k`, the whole cell is in contact.

Along one joint clearances change by no more than the link's reach from it for each radian: cells between are known.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, WordArray
from hplan.base.kernels import kernel
from hplan.collision.body_kernels import body_clearances
from hplan.collision.obstacle_rows import FieldArrays

#: What kernels' distances are exact to; a hull that is flat made thicker is in it, and joints that are locked to the
#: certificate's tolerance [m].
ACCURACY = 1e-4

#: Larger clearances are not looked for [m].
_FAR = 1.0


class Cells(NamedTuple):
    """A grid over three joints; the first axis is the one whose cells are bits.

    Attributes:
        joints: (3,) numbers of the joints in a configuration.
        lower: (3,) where the first cells begin [rad].
        sizes: (3,) sizes of cells [rad].
        counts: (3,) numbers of cells.
        parts: (3,) into how many parts each cell is cut, of which one that is not in contact is enough.
        sway: (links,) how far links move from the middle of a part at most [m].
        reach: (links,) how far they move for each radian of the first axis' joint at most [m].
    """

    joints: IntArray
    lower: FloatArray
    sizes: FloatArray
    counts: IntArray
    parts: IntArray
    sway: FloatArray
    reach: FloatArray


@kernel
def free_cells(q: FloatArray, field: FieldArrays, cells: Cells) -> WordArray:
    """Bits of the cells that are not shown to be in contact whole.

    Args:
        q: (dof,) a configuration; it is changed.
        field: Obstacles, and the links that count.

    Returns:
        (counts[1], counts[2], words) bit i of a row is cell i of the first axis.
    """
    joints, lower, sizes, counts, parts, sway, reach = cells
    free = np.zeros((counts[1], counts[2], (counts[0] + 63) >> 6), dtype=np.uint64)
    clear = np.empty(field.movers.shape[0])
    for i in range(counts[1] * parts[1]):
        q[joints[1]] = lower[1] + (i + 0.5) * sizes[1] / parts[1]
        for j in range(counts[2] * parts[2]):
            q[joints[2]] = lower[2] + (j + 0.5) * sizes[2] / parts[2]
            row = free[i // parts[1], j // parts[2]]
            part, end = 0, counts[0] * parts[0]
            while part < end:
                q[joints[0]] = lower[0] + (part + 0.5) * sizes[0] / parts[0]
                body_clearances(q, field, _FAR, clear)
                # Parts from here on that are in contact, and that are not shown to be, as far as is known.
                occupied, unknown = 0.0, np.inf
                for k in range(len(clear)):
                    beyond = clear[k] + sway[k] + ACCURACY
                    travel = reach[k] * sizes[0] / parts[0]
                    known = abs(beyond) / travel if travel > 0.0 else np.inf
                    if beyond < 0.0:
                        occupied = max(occupied, known)
                    else:
                        unknown = min(unknown, known)
                if occupied > 0.0:
                    part += int(min(float(end), np.ceil(occupied)))
                else:
                    last = part + int(min(float(end), max(1.0, np.ceil(unknown))))
                    for cell in range(part // parts[0], (min(last, end) - 1) // parts[0] + 1):
                        row[cell >> 6] |= np.uint64(1) << np.uint64(cell & 63)
                    part = last
    return free
