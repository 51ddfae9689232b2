r"""Kernels for arms of any kind: the clearance of every body of the arm, and of its pairs, at a configuration.

Movers are the bodies of the arm (`hplan.bodies.flat_bodies`) and, after them, the pairs of bodies that must not touch:
the distance of a pair is seen from one of the two, so that a joint that carries both does not count as motion. Bodies
and obstacles are hulls of points, grown by radii; their distance is that of the hulls (`hplan.collision.
convex_distance`) less both radii. Bounding balls come first, then whatever direction separates by as much as is asked.

**Enough.** Each mover has a clearance that is enough: no more is looked for than is needed to tell whether there is
less. Where all that matters is how far a motion may go on, that saves most of the work.

**Depth.** Two hulls that share points are as far inside of each other as the least shift that takes them apart
(`hplan.collision.penetration`), and the radii come to that. Where no clearance is asked for beyond the sign (`Look`),
the depth of the hulls counts as 0.

While joints turn in proportion by :math:`\Delta q` no point of a body moves farther than
:math:`\sum_j R_{bj} |\Delta q_j|` (`hplan.bodies.reach`), and no pair comes nearer by more than its own sum.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray
from hplan.base.deadline import is_up
from hplan.base.kernels import any_int, inlined, kernel
from hplan.bodies import flat_bodies as flat
from hplan.bodies.placed_bodies import ALONG, CENTRE, PLACED, START, place_bodies
from hplan.collision import obstacle_rows as row
from hplan.collision.convex_distance import NEAREST, WORK, Pose, Span, Wanted, core_distance
from hplan.collision.distances import point_segment
from hplan.collision.obstacle_rows import FieldArrays
from hplan.collision.penetration import penetration

_FIRST_ROW, _FRAME = any_int(0), any_int(12)

#: By which fraction of itself a clearance may be told too small: where it is to be known, and where a motion goes on.
EXACT, ROUGH = 1e-10, 2e-2

#: Most looks at the clearance along one motion.
_MOST_LOOKS = any_int(1_000_000)

#: Larger clearances are not looked for [m].
FAR = 0.2


class Look(NamedTuple):
    """How exactly a clearance is looked for.

    Attributes:
        too_little: Where it is shown to be less, whatever is less may be told [m].
        fraction: By which fraction of itself it may be told too small.
        depth: Whether the depth of hulls in each other is to be known.
    """

    too_little: float
    fraction: float
    depth: bool


class BodyArrays(NamedTuple):
    """An arm of any kind among obstacles, and what is worked with.

    Attributes:
        movers: As `hplan.bodies.flat_bodies.FlatBodies`.
        numbers: The same.
        solids: As `hplan.collision.clearance_field.ClearanceField`.
        data: The same.
        placed: (bodies, 21) each body where it is.
        work: (WORK,) numbers.
    """

    movers: FloatArray
    numbers: FloatArray
    solids: FloatArray
    data: FloatArray
    placed: FloatArray
    work: FloatArray


@kernel
def placed_arm(q: FloatArray, field: FieldArrays) -> BodyArrays:
    """The arm at a configuration among obstacles."""
    movers, numbers, solids, data = field.chain, field.base, field.solids, field.data
    placed = np.empty((int(numbers[flat.BODIES]), PLACED))
    place_bodies(q, movers, numbers, placed)
    return BodyArrays(movers, numbers, solids, data, placed, np.empty(WORK))


@inlined
def _pose_of(placed: FloatArray, b: int) -> Pose:
    return (
        placed[b, 0], placed[b, 1], placed[b, 2], placed[b, 3], placed[b, 4], placed[b, 5],
        placed[b, 6], placed[b, 7], placed[b, 8], placed[b, 9], placed[b, 10], placed[b, 11],
    )  # fmt: skip


@inlined
def _span_of(movers: FloatArray, b: int) -> Span:
    return int(movers[b, flat.FIRST]), int(movers[b, flat.LAST]), int(movers[b, flat.TABLE])


@inlined
def _difference(placed: FloatArray, j: int, i: int) -> Pose:
    """Where body j is as seen from body i."""
    a, b = placed[i], placed[j]
    x, y, z = b[9] - a[9], b[10] - a[10], b[11] - a[11]
    return (
        a[0] * b[0] + a[3] * b[3] + a[6] * b[6],
        a[0] * b[1] + a[3] * b[4] + a[6] * b[7],
        a[0] * b[2] + a[3] * b[5] + a[6] * b[8],
        a[1] * b[0] + a[4] * b[3] + a[7] * b[6],
        a[1] * b[1] + a[4] * b[4] + a[7] * b[7],
        a[1] * b[2] + a[4] * b[5] + a[7] * b[8],
        a[2] * b[0] + a[5] * b[3] + a[8] * b[6],
        a[2] * b[1] + a[5] * b[4] + a[8] * b[7],
        a[2] * b[2] + a[5] * b[5] + a[8] * b[8],
        a[0] * x + a[3] * y + a[6] * z,
        a[1] * x + a[4] * y + a[7] * z,
        a[2] * x + a[5] * y + a[8] * z,
    )


@kernel
def _body_clearance(arm: BodyArrays, b: int, enough: float, look: Look) -> float:
    """Clearance of a body from obstacles, or `enough` where it is no less [m]."""
    movers, _, solids, _, placed, _ = arm
    x, y, z = placed[b, CENTRE], placed[b, CENTRE + 1], placed[b, CENTRE + 2]
    ball, joint, least = movers[b, flat.BALL_RADIUS], movers[b, flat.JOINT], enough
    following = _FIRST_ROW
    while following < solids.shape[0]:
        s = following
        dx, dy, dz = solids[s, row.CENTRE] - x, solids[s, row.CENTRE + 1] - y, solids[s, row.CENTRE + 2] - z
        within = least + ball + solids[s, row.BOUND]
        kind = solids[s, row.KIND]
        if not within > 0.0 or dx * dx + dy * dy + dz * dz > within * within:
            following = int(solids[s, row.NEXT]) if kind >= row.NODE else s + 1
            continue
        following = s + 1
        if kind == row.GATE:
            if not solids[s, row.FIRST_LINK] <= joint <= solids[s, row.LAST_LINK]:
                following = int(solids[s, row.NEXT])
        elif kind == row.NODE or kind == row.LOT:
            start = (placed[b, START], placed[b, START + 1], placed[b, START + 2])
            along = (placed[b, ALONG], placed[b, ALONG + 1], placed[b, ALONG + 2])
            centre = (solids[s, row.CENTRE], solids[s, row.CENTRE + 1], solids[s, row.CENTRE + 2])
            if point_segment(centre, start, along) > least + movers[b, flat.AXIS_RADIUS] + solids[s, row.BOUND]:
                following = int(solids[s, row.NEXT])
            elif kind == row.LOT:
                least = _lot_clearance(arm, b, s, least, look)
        else:
            least = _row_clearance(arm, b, s, least, look)
        if not least >= look.too_little:
            break
    return least


@kernel
def _hull_clearance(arm: BodyArrays, k: int, other: tuple[FloatArray, Span, float], least: float, look: Look) -> float:
    """Clearance of a body from a hull grown by a radius, or `least` where it is no less."""
    points, other_span, radius = other
    movers, numbers, _, _, placed, work = arm
    radii = radius + movers[k, flat.ROUNDING]
    span, pose = _span_of(movers, k), _pose_of(placed, k)
    wanted = Wanted(least + radii, look.too_little + radii, look.fraction, radii)
    distance = core_distance(numbers, span, pose, points, other_span, wanted, work)
    if distance == 0.0 and look.depth and least + radii > 0.0:
        distance = -penetration((numbers, span, pose, points, other_span), work)
    return least if least <= distance - radii else distance - radii


@kernel
def _row_clearance(arm: BodyArrays, k: int, s: int, least: float, look: Look) -> float:
    """Clearance of a body from the solid of a row, or `least` where it is no less."""
    _, _, solids, _, placed, work = arm
    for c in range(3):
        work[NEAREST + c] = placed[k, CENTRE + c] - solids[s, row.CENTRE + c]
    span = int(solids[s, row.CORNERS]), int(solids[s, row.CORNERS_END]), int(solids[s, row.TABLE])
    return _hull_clearance(arm, k, (arm.data, span, solids[s, row.RADIUS]), least, look)


@kernel
def _lot_clearance(arm: BodyArrays, k: int, s: int, least: float, look: Look) -> float:
    """Clearance of a body from the balls of a lot, or `least` where it is no less."""
    movers, _, solids, data, placed, work = arm
    radius, beside = solids[s, row.RADIUS], movers[k, flat.AXIS_RADIUS]
    start = (placed[k, START], placed[k, START + 1], placed[k, START + 2])
    along = (placed[k, ALONG], placed[k, ALONG + 1], placed[k, ALONG + 2])
    for p in range(int(solids[s, row.POINTS]), int(solids[s, row.POINTS_END]), 3):
        if point_segment((data[p], data[p + 1], data[p + 2]), start, along) < least + beside + radius:
            for c in range(3):
                work[NEAREST + c] = placed[k, CENTRE + c] - data[p + c]
            least = _hull_clearance(arm, k, (data, (p, p + 3, 0), radius), least, look)
    return least


@inlined
def _apart(movers: FloatArray, placed: FloatArray, k: int, enough: float) -> bool:
    """True if the balls of a pair show that it has a clearance."""
    j, i = int(movers[k, flat.OUTER]), int(movers[k, flat.INNER])
    dx = placed[j, CENTRE] - placed[i, CENTRE]
    dy = placed[j, CENTRE + 1] - placed[i, CENTRE + 1]
    dz = placed[j, CENTRE + 2] - placed[i, CENTRE + 2]
    within = enough + movers[k, flat.BALLS]
    apart: bool = dx * dx + dy * dy + dz * dz >= within * within
    return apart


@kernel
def _pair_clearance(arm: BodyArrays, k: int, enough: float, look: Look) -> float:
    """Clearance of a pair of the arm's own bodies, or `enough` where it is no less."""
    movers, numbers, _, _, placed, work = arm
    j, i, touching = int(movers[k, flat.OUTER]), int(movers[k, flat.INNER]), movers[k, flat.TOUCHING]
    dx = placed[j, CENTRE] - placed[i, CENTRE]
    dy = placed[j, CENTRE + 1] - placed[i, CENTRE + 1]
    dz = placed[j, CENTRE + 2] - placed[i, CENTRE + 2]
    work[NEAREST] = placed[i, 0] * dx + placed[i, 3] * dy + placed[i, 6] * dz
    work[NEAREST + 1] = placed[i, 1] * dx + placed[i, 4] * dy + placed[i, 7] * dz
    work[NEAREST + 2] = placed[i, 2] * dx + placed[i, 5] * dy + placed[i, 8] * dz
    pose = _difference(placed, j, i)
    span, other = _span_of(movers, j), _span_of(movers, i)
    wanted = Wanted(enough + touching, look.too_little + touching, look.fraction, touching)
    distance = core_distance(numbers, span, pose, numbers, other, wanted, work)
    if distance == 0.0 and look.depth:
        distance = -penetration((numbers, span, pose, numbers, other), work)
    return enough if enough <= distance - touching else distance - touching


@kernel
def body_clearances(q: FloatArray, field: FieldArrays, result: FloatArray) -> None:
    """Clearance of each mover at one configuration, `FAR` where it is more; of the ground always."""
    arm, look = placed_arm(q, field), Look(-math.inf, EXACT, True)
    movers, numbers, placed = arm.movers, arm.numbers, arm.placed
    bodies, dof = placed.shape[0], numbers[flat.DOF]
    for k in range(len(result)):
        result[k] = FAR
        if k >= bodies:
            if not _apart(movers, placed, k, FAR):
                result[k] = _pair_clearance(arm, k, FAR, look)
        elif movers[k, flat.JOINT] < dof:
            result[k] = _body_clearance(arm, k, FAR, look)


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
    movers, numbers, placed = arm.movers, arm.numbers, arm.placed
    bodies, dof, advance = placed.shape[0], numbers[flat.DOF], most
    # From the tip on: what is carried by more joints moves farther, and is in contact more often.
    for turn in range(len(bounds)):
        k = bodies - 1 - turn if turn < bodies else turn
        enough = max(margin, advance * bounds[k])
        if k >= bodies:
            if _apart(movers, placed, k, enough):
                continue
            clear = _pair_clearance(arm, k, enough, look)
        elif movers[k, flat.JOINT] < dof:
            clear = _body_clearance(arm, k, enough, look)
        else:
            continue
        if not clear >= margin:
            return -1.0
        if clear < enough:
            advance = clear / bounds[k]
    return advance


@kernel
def body_bounds(turns: FloatArray, movers: FloatArray, numbers: FloatArray, result: FloatArray) -> None:
    """Largest displacement of any point of each mover while joints move in proportion, by `turns` in all."""
    dof = len(turns)
    at = int(numbers[flat.REACHES])
    for k in range(movers.shape[0]):
        bound = 0.0
        for j in range(dof):
            bound += numbers[at + dof * k + j] * abs(turns[j])
        result[k] = bound


@kernel
def body_shown_part(
    start: FloatArray, turns: FloatArray, field: FieldArrays, margin: float, looks: int
) -> tuple[float, int]:
    """The part of a straight joint-space motion that a few looks at the clearance show clear, and how many it took."""
    dof = len(start)
    bounds, q = np.empty(field.chain.shape[0]), np.empty(dof)
    body_bounds(turns, field.chain, field.base, bounds)
    shown, at = 0.0, 0.0
    for used in range(looks):
        for i in range(dof):
            q[i] = start[i] + at * turns[i]
        advance = body_advance(q, field, bounds, margin, 1.0 - at)
        if advance < 0.0:
            return shown, used + 1
        shown = at
        if at >= 1.0 or is_up(field.until):
            return shown, used + 1
        at = min(1.0, at + advance)
    return shown, looks


@kernel
def body_segment_is_clear(start: FloatArray, end: FloatArray, field: FieldArrays, margin: float) -> bool:
    """As `hplan.collision.clearance_kernels.segment_is_clear`."""
    dof = len(start)
    turns, middle, bounds = np.empty(dof), np.empty(dof), np.zeros(field.chain.shape[0])
    for i in range(dof):
        turns[i] = end[i] - start[i]
        middle[i] = start[i] + 0.5 * turns[i]
    # The middle first: where a motion fails it often fails there.
    if body_advance(middle, field, bounds, margin, 0.0) < 0.0:
        return False
    shown, _ = body_shown_part(start, turns, field, margin, _MOST_LOOKS)
    return shown == 1.0


@kernel
def body_piece_is_clear(piece: FloatArray, field: FieldArrays, margin: float, stride: float) -> bool:
    """As `hplan.smoothing.spline.piece_is_clear`."""
    dof = piece.shape[1]
    bounds, q, fastest = np.empty(field.chain.shape[0]), np.empty(dof), np.zeros(dof)
    for j in range(dof):
        for c in range(3):
            fastest[j] = max(fastest[j], 3.0 * abs(piece[c + 1, j] - piece[c, j]))
    body_bounds(fastest, field.chain, field.base, bounds)
    t = 0.0
    while True:
        u = 1.0 - t
        w0, w1, w2, w3 = u * u * u, 3.0 * u * u * t, 3.0 * u * t * t, t * t * t
        for i in range(dof):
            q[i] = w0 * piece[0, i] + w1 * piece[1, i] + w2 * piece[2, i] + w3 * piece[3, i]
        advance = body_advance(q, field, bounds, margin, 1.0 - t)
        if advance < 0.0:
            return False
        if t >= 1.0:
            return True
        if is_up(field.until):
            return False
        t = min(1.0, t + max(stride, advance))


@kernel
def mark_near_bodies(path: FloatArray, arrays: FieldArrays, distance: float, near: BoolArray) -> None:
    """Mark the rows whose bounding ball comes within a distance of a body at some configuration."""
    movers, numbers, solids = arrays.chain, arrays.base, arrays.solids
    placed = np.empty((int(numbers[flat.BODIES]), PLACED))
    for i in range(path.shape[0]):
        place_bodies(path[i], movers, numbers, placed)
        for b in range(placed.shape[0]):
            start = (placed[b, START], placed[b, START + 1], placed[b, START + 2])
            along = (placed[b, ALONG], placed[b, ALONG + 1], placed[b, ALONG + 2])
            for s in range(solids.shape[0]):
                if not near[s]:
                    centre = (solids[s, row.CENTRE], solids[s, row.CENTRE + 1], solids[s, row.CENTRE + 2])
                    beyond = distance + solids[s, row.BOUND] + movers[b, flat.AXIS_RADIUS]
                    near[s] = (
                        movers[b, flat.JOINT] < numbers[flat.DOF] and point_segment(centre, start, along) <= beyond
                    )
