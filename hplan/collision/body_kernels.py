r"""Kernels for arms of any kind: clearances of all movers at a configuration, and how they change with the joints.

What movers are, and the clearance of one of them, is in `hplan.collision.mover_clearance`. While joints turn in
proportion by :math:`\Delta q` no point of a body moves farther than :math:`\sum_j R_{bj} |\Delta q_j|`
(`hplan.bodies.reach`), and no pair comes nearer by more than its own sum.
"""

from __future__ import annotations

import math

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import kernel
from hplan.bodies import flat_bodies as flat
from hplan.bodies.convex_distance import WORK, Vector
from hplan.collision.mover_clearance import BodyArrays, Look, mover_clearance, placed_arm
from hplan.collision.obstacle_rows import FieldArrays

#: By which fraction of itself a clearance may be told too small: where it is to be known, and where a motion goes on.
EXACT, ROUGH = 1e-10, 2e-2

#: Larger clearances are not looked for [m].
FAR = 0.2


@kernel
def body_clearances(q: FloatArray, field: FieldArrays, result: FloatArray) -> None:
    """Clearance of each mover at one configuration, `FAR` where it is more; of bodies that no joint moves always."""
    arm, look = placed_arm(q, field), Look(-math.inf, EXACT, True)
    for k in range(len(result)):
        result[k] = mover_clearance(arm, k, FAR, look)


@kernel
def body_advance(q: FloatArray, field: FieldArrays, bounds: FloatArray, margin: float, most: float) -> float:
    """The part of a motion, at most `most`, that cannot use up any mover's clearance; -1 where one is below the margin.

    Args:
        q: (dof,) configuration.
        field: Arm and obstacles.
        bounds: (movers,) how far each mover moves in the whole motion at most [m].
        margin: Clearance asked for at the configuration [m].
        most: The part that is left of the motion.
    """
    arm, look = placed_arm(q, field), Look(margin, ROUGH, False)
    bodies, advance = arm.placed.shape[0], most
    # From the tip on: what is carried by more joints moves farther, and is in contact more often.
    for turn in range(len(bounds)):
        k = bodies - 1 - turn if turn < bodies else turn
        enough = max(margin, advance * bounds[k])
        clear = mover_clearance(arm, k, enough, look)
        if not clear >= margin:
            return -1.0
        if clear < enough:
            advance = clear / bounds[k]
    return advance


@kernel
def body_slopes(
    q: FloatArray, field: FieldArrays, joints: IntArray, enough: float, clear: FloatArray, gradient: FloatArray
) -> None:
    """Write the (movers,) clearances, `enough` where there is more, and their (movers, k) gradients by k joints.

    A gradient is the velocity of the nearest points along the line between them; zeros where there is enough.
    """
    arm, look = placed_arm(q, field), Look(-math.inf, EXACT, True)
    movers, work, bodies = arm.movers, arm.work, arm.placed.shape[0]
    for k in range(len(clear)):
        clear[k] = mover_clearance(arm, k, enough, look)
        for m in range(len(joints)):
            gradient[k, m] = 0.0
        if not clear[k] < enough:
            continue
        outer, inner = k, -1
        if k >= bodies:
            outer, inner = int(movers[k, flat.OUTER]), int(movers[k, flat.INNER])
        n = (work[WORK], work[WORK + 1], work[WORK + 2])
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if not length > 0.0:
            continue
        n = (n[0] / length, n[1] / length, n[2] / length)
        at = (work[WORK + 3], work[WORK + 4], work[WORK + 5])
        for m in range(len(joints)):
            gradient[k, m] = _rate(arm, outer, joints[m], n, at)
        if inner >= 0:
            # What carries both does not count, wherever the nearest point of the inner one is along the line.
            for m in range(len(joints)):
                if _carries(arm, inner, joints[m]):
                    gradient[k, m] -= _rate(arm, inner, joints[m], n, at)


@kernel
def _carries(arm: BodyArrays, b: int, joint: int) -> bool:
    """True if a joint moves a body."""
    numbers = arm.numbers
    first, dof, j = int(numbers[flat.JOINTS]), int(numbers[flat.DOF]), int(arm.movers[b, flat.JOINT])
    while j < dof and j != joint:
        j = int(numbers[first + flat.JOINT_SIZE * j + flat.PARENT])
    return j == joint and j < dof


@kernel
def _rate(arm: BodyArrays, b: int, joint: int, n: Vector, at: Vector) -> float:
    """Velocity in a direction of a body's point while a joint alone moves at unit rate [m/rad, m/m]."""
    if not _carries(arm, b, joint):
        return 0.0
    numbers, frames = arm.numbers, arm.frames
    own = int(numbers[flat.JOINTS]) + flat.JOINT_SIZE * joint
    tx, ty, tz = numbers[own + flat.TURN], numbers[own + flat.TURN + 1], numbers[own + flat.TURN + 2]
    if tx == 0.0 and ty == 0.0 and tz == 0.0:
        below, rate = int(numbers[own + flat.PARENT]), 0.0
        for r in range(3):
            for c in range(3):
                rate += n[r] * frames[below, 3 * r + c] * numbers[own + flat.SHIFT + c]
        return rate
    x = frames[joint, 0] * tx + frames[joint, 1] * ty + frames[joint, 2] * tz
    y = frames[joint, 3] * tx + frames[joint, 4] * ty + frames[joint, 5] * tz
    z = frames[joint, 6] * tx + frames[joint, 7] * ty + frames[joint, 8] * tz
    dx, dy, dz = at[0] - frames[joint, 9], at[1] - frames[joint, 10], at[2] - frames[joint, 11]
    moved: float = n[0] * (y * dz - z * dy) + n[1] * (z * dx - x * dz) + n[2] * (x * dy - y * dx)
    return moved


@kernel
def least_body_clearance(q: FloatArray, field: FieldArrays, enough: float) -> float:
    """The smallest clearance of all movers at one configuration, or `enough` where it is no less [m]."""
    arm, look = placed_arm(q, field), Look(-math.inf, EXACT, True)
    bodies, least = arm.placed.shape[0], enough
    for turn in range(arm.movers.shape[0]):
        k = bodies - 1 - turn if turn < bodies else turn
        least = mover_clearance(arm, k, least, look)
    return least
