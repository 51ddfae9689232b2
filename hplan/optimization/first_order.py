r"""First-order limits and clearances of a timed spline, as linear program rows.

The unknowns are the changes of the inner control points, :math:`\Delta c`, and the time scale :math:`s`, which
multiplies all times. Velocity, acceleration and jerk of a spline are linear in its control points and scale with
:math:`1/s`, :math:`1/s^2` and :math:`1/s^3`:

.. math:: |V(c)| \le \bar v s, \quad |A(c)| \le \bar a s^2, \quad |J(c)| \le \bar\jmath s^3.

The powers are convex, and replaced by their tangents at :math:`s = 1`, which are lower bounds. A solution of the
program therefore satisfies the true limits, and if the motion before a step satisfied them, so does every fraction of
the step. `A` at the knots and `J` in the pieces are exact; `V` are the control points of the velocity, whose convex
hull contains it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.base.deadline import is_up
from hplan.base.kernels import any_int, inline, kernel
from hplan.collision.compiled_clearance import guessed_slopes
from hplan.collision.compiled_obstacles import FieldArrays
from hplan.optimization.interior_point import ProgramRows

#: Maximum number of sample points for clearances in each piece, and displacement of the arm between them up to which
#: fewer suffice [m]; and their number in a piece that a step leads into contact.
PLACES, APART, CUT_PLACES = any_int(3), 0.05, any_int(8)

#: Bodies with more clearance than `NEAR` are left out of a program; its clearance rows are scaled by 1 / `SCALE` [m].
NEAR, SCALE = 0.06, 0.15

#: From one sample point to the next, the clearance of a body seldom grows by more [m].
FARTHER_M = 0.01

#: If the clearance is below the margin, a step must increase it by this amount where all control points are free [m].
_REGAINED = 5e-4

#: Rows that keep a step clear are those that could become active within this trust region about it [rad].
_CUT_TRUST = 0.05

#: Number of kinematic rows of a joint that depend on the end states: one, two and three at each end.
DRIFTING = any_int(12)


class MotionArrays(NamedTuple):
    """Timed spline, for kernels.

    Attributes:
        control: (n, dof) control points.
        knots: (n + 4,) clamped knots [s].
        drift: (n, dof) derivatives of the control points with respect to the time scale that keep the states at both
            ends fixed.
    """

    control: FloatArray
    knots: FloatArray
    drift: FloatArray


class MotionLimits(NamedTuple):
    """Limits of a motion, for kernels.

    Attributes:
        lower: (dof,) lower joint limits.
        upper: (dof,) upper joint limits.
        rates: (3, dof) maximum velocity [rad/s], acceleration [rad/s^2] and jerk [rad/s^3]; infinite for no limit.
        movable: (k,) indices of the joints that may move.
        sway: (moving bodies, dof) loss of each body's clearance by tracking errors, per unit of each joint's speed
            [m s/rad]; empty if tracking errors do not depend on speed.
    """

    lower: FloatArray
    upper: FloatArray
    rates: FloatArray
    movable: IntArray
    sway: FloatArray


@inline
def _difference_weights(knots: FloatArray, first: int, order: int, weight: FloatArray) -> None:
    """Write the weights of control points in a derivative's control point.

    The control points are `first` to `first + order` of a cubic B-spline.
    """
    d0 = 3.0 / (knots[first + 4] - knots[first + 1])
    weight[0], weight[1] = -d0, d0
    if order > 1:
        d1 = 3.0 / (knots[first + 5] - knots[first + 2])
        e0 = 2.0 / (knots[first + 4] - knots[first + 2])
        weight[0], weight[1], weight[2] = e0 * d0, -e0 * (d0 + d1), e0 * d1
    if order > 2:
        d2 = 3.0 / (knots[first + 6] - knots[first + 3])
        e1 = 2.0 / (knots[first + 5] - knots[first + 3])
        f = 1.0 / (knots[first + 4] - knots[first + 3])
        weight[0], weight[3] = -f * e0 * d0, f * e1 * d2
        weight[1], weight[2] = f * (e1 * d1 + e0 * (d0 + d1)), -f * (e1 * (d1 + d2) + e0 * d1)


@kernel
def basis(knots: FloatArray, piece: int, t: float, weight: FloatArray) -> None:
    """Weights of control points `piece` to `piece + 3` at parameter t.

    `t` is the fraction of the piece; computed by the Cox-de Boor recursion.
    """
    span = piece + 3
    x = knots[span] + t * (knots[span + 1] - knots[span])
    weight[0] = 1.0
    for level in range(1, 4):
        weight[level] = 0.0
        for c in range(level, -1, -1):
            value = 0.0
            if c > 0:
                low = knots[span - level + c]
                value += weight[c - 1] * (x - low) / (knots[span + c] - low)
            if c < level:
                high = knots[span + c + 1]
                value += weight[c] * (high - x) / (high - knots[span - level + c + 1])
            weight[c] = value


@kernel
def least_time_scale(control: FloatArray, knots: FloatArray, limits: MotionLimits) -> float:
    """Minimum time-scaling factor within the velocity, acceleration and jerk limits."""
    n = control.shape[0]
    time_scale, weight = 0.0, np.empty(4)
    for order in range(1, 4):
        use = 0.0
        for k in range(n - order):
            _difference_weights(knots, k, order, weight)
            for j in limits.movable:
                value = 0.0
                for c in range(order + 1):
                    value += weight[c] * control[k + c, j]
                use = max(use, abs(value) / limits.rates[order - 1, j])
        time_scale = max(time_scale, use ** (1.0 / order))
    return time_scale


@kernel
def first_order(
    motion: MotionArrays, limits: MotionLimits, field: FieldArrays, margin: float, trust: float
) -> ProgramRows:
    """Linear program of one step from a motion.

    Args:
        motion: The motion; the outer three control points at each end change with the time scale only. The unknowns are
            the changes of the other control points in the movable joints, one control point after the other.
        limits: Limits of the motion.
        field: Obstacles and bodies.
        margin: Required clearance at the sample points of each piece, or slightly more than the present clearance
            if that is less [m].
        trust: Maximum change of a control point in a joint [rad].
    """
    control, knots, drift = motion
    n, joints = control.shape[0], len(limits.movable)
    matters = margin, trust
    for k in range(n):
        for j in range(control.shape[1]):
            if drift[k, j] != 0.0:
                matters = margin, math.inf
    near = _evaluate_places(control, knots, sample_places(control, knots, field), limits, field, matters)
    links_near = _count_near(near)
    kinematic, free = joints * (3 * n - 6), joints * (n - 6)
    split = 2 * joints * DRIFTING
    most = kinematic + free + links_near + split
    entries_most = 4 * (kinematic + split) + free + 4 * joints * links_near
    rows = ProgramRows(
        np.zeros(most + 1, dtype=np.int32), np.empty(entries_most, dtype=np.int32), np.empty(entries_most),
        np.zeros(most), np.empty(most), np.empty(kinematic + free),
    )  # fmt: skip
    both = _add_kinematics(rows, motion, limits)
    both = _add_bounds(rows, both, control, limits, trust)
    row = _add_drifting(rows, both, motion, limits)
    row = _add_clearances(rows, row, (near, drift, control), limits, field, (margin, _REGAINED))
    used = rows.starts[row]
    return ProgramRows(
        rows.starts[: row + 1], rows.columns[:used], rows.entries[:used],
        rows.time_scale[:row], rows.upper[:row], rows.lower[:both],
    )  # fmt: skip


@kernel
def clearance_cuts(
    motion: MotionArrays,
    change: FloatArray,
    blocked: BoolArray,
    limits: MotionLimits,
    field: FieldArrays,
    margin: float,
) -> ProgramRows:
    """Clearance rows of a motion in contact, for the program of the step that led there.

    They are linear about the motion after the step, at closer sample points than the program's own.

    Args:
        motion: The motion after the step, from rest to rest.
        change: (unknowns,) the step.
        blocked: (pieces,) mask of the pieces that are in contact.
        limits: Limits of the motion.
        field: Obstacles and bodies.
        margin: Required clearance [m].
    """
    control, knots, drift = motion
    joints = len(limits.movable)
    near = _evaluate_places(control, knots, _cut_places(blocked), limits, field, (margin, _CUT_TRUST))
    most = _count_near(near)
    rows = ProgramRows(
        np.zeros(most + 1, dtype=np.int32), np.empty(4 * joints * most, dtype=np.int32), np.empty(4 * joints * most),
        np.zeros(most), np.empty(most), np.empty(0),
    )  # fmt: skip
    count = _add_clearances(rows, 0, (near, drift, control), limits, field, (margin, math.inf))
    used = rows.starts[count]
    for row in range(count):
        for entry in range(rows.starts[row], rows.starts[row + 1]):
            rows.upper[row] += rows.entries[entry] * change[rows.columns[entry]]
    return ProgramRows(
        rows.starts[: count + 1], rows.columns[:used], rows.entries[:used],
        rows.time_scale[:count], rows.upper[:count], rows.lower,
    )  # fmt: skip


@inline
def _drift_of(drift: FloatArray, weight: FloatArray, first: int, order: int, joint: int) -> float:
    """Derivative of a derivative's control point with respect to the time scale."""
    change = 0.0
    for c in range(order + 1):
        change += weight[c] * drift[first + c, joint]
    return change


@kernel
def _add_kinematics(rows: ProgramRows, motion: MotionArrays, limits: MotionLimits) -> int:
    """Add velocity, acceleration and jerk rows, normalized; return the row count.

    Rows whose left-hand side depends on the time scale are left out (`_add_drifting` adds them).
    """
    control, knots, drift = motion
    n, movable = control.shape[0], limits.movable
    joints = len(movable)
    row, entry, weight = 0, 0, np.empty(4)
    for order in range(1, 4):
        for k in range(max(0, 3 - order), min(n - order, n - 3)):  # without rows that are fixed by rest
            _difference_weights(knots, k, order, weight)
            for m in range(joints):
                limit, value = limits.rates[order - 1, movable[m]], 0.0
                if limit == math.inf or _drift_of(drift, weight, k, order, movable[m]) != 0.0:
                    continue
                for c in range(order + 1):
                    value += weight[c] * control[k + c, movable[m]]
                    if 3 <= k + c < n - 3:
                        rows.columns[entry] = (k + c - 3) * joints + m
                        rows.entries[entry] = weight[c] / limit
                        entry += 1
                rows.time_scale[row] = -float(order)
                rows.upper[row], rows.lower[row] = 1.0 - order - value / limit, 1.0 - order + value / limit
                row += 1
                rows.starts[row] = entry
    return row


@kernel
def _add_drifting(rows: ProgramRows, row: int, motion: MotionArrays, limits: MotionLimits) -> int:
    """Add kinematic rows that drift with time scale; return the row count.

    Each becomes two one-sided rows. The states at the ends are fixed, so the pieces there change with the time scale.
    """
    control, knots, drift = motion
    n, movable = control.shape[0], limits.movable
    joints, entry, weight = len(movable), rows.starts[row], np.empty(4)
    for order in range(1, 4):
        for k in range(max(0, 3 - order), min(n - order, n - 3)):
            if 3 <= k < n - 3 - order:
                continue
            _difference_weights(knots, k, order, weight)
            for m in range(joints):
                limit = limits.rates[order - 1, movable[m]]
                change = _drift_of(drift, weight, k, order, movable[m]) / limit
                if limit == math.inf or change == 0.0:
                    continue
                value = 0.0
                for c in range(order + 1):
                    value += weight[c] * control[k + c, movable[m]] / limit
                for side in (1.0, -1.0):
                    for c in range(order + 1):
                        if 3 <= k + c < n - 3:
                            rows.columns[entry] = (k + c - 3) * joints + m
                            rows.entries[entry] = side * weight[c] / limit
                            entry += 1
                    rows.time_scale[row] = side * change - order
                    rows.upper[row] = 1.0 - order + side * (change - value)
                    row += 1
                    rows.starts[row] = entry
    return row


@kernel
def _add_bounds(rows: ProgramRows, row: int, control: FloatArray, limits: MotionLimits, trust: float) -> int:
    """Add joint limits and trust region; return the row count.

    The rows are scaled by the trust.
    """
    joints, entry = len(limits.movable), rows.starts[row]
    for unknown in range(joints * (control.shape[0] - 6)):
        joint = limits.movable[unknown % joints]
        here = control[3 + unknown // joints, joint]
        rows.columns[entry], rows.entries[entry] = unknown, 1.0 / trust
        entry += 1
        rows.upper[row] = min(1.0, max(-0.5, (limits.upper[joint] - here) / trust))
        rows.lower[row] = min(1.0, max(-0.5, (here - limits.lower[joint]) / trust))
        row += 1
        rows.starts[row] = entry
    return row


@kernel
def sample_places(control: FloatArray, knots: FloatArray, field: FieldArrays) -> FloatArray:
    """(places, 2) piece and fraction of it, for sample points between which the arm moves by at most `APART`.

    One to `PLACES` in each piece.
    """
    n, dof = control.shape
    places, count = np.empty(((n - 3) * PLACES, 2)), 0
    reach, weight, here, there = np.zeros(dof), np.empty(4), np.zeros(dof), np.zeros(dof)
    for b in range(len(field.bodies)):
        for j in range(dof):
            reach[j] = max(reach[j], field.reaches[b, j])
    for piece in range(n - 3):
        moved = 0.0
        for end in range(2):
            basis(knots, piece, 1.0 * end, weight)
            for j in range(dof):
                q = 0.0
                for c in range(4):
                    q += weight[c] * control[piece + c, j]
                here[j], there[j] = there[j], q
        for j in range(dof):
            moved += reach[j] * abs(there[j] - here[j])
        share = min(PLACES, max(1, math.ceil(moved / APART)))
        for place in range(share):
            places[count, 0], places[count, 1] = piece, place / share
            count += 1
    return places[:count]


@kernel
def _cut_places(blocked: BoolArray) -> FloatArray:
    """(places, 2) piece and fraction of it, for `CUT_PLACES` sample points of each blocked piece."""
    places, count = np.empty((np.count_nonzero(blocked) * CUT_PLACES, 2)), 0
    for piece in range(len(blocked)):
        if blocked[piece]:
            for place in range(CUT_PLACES):
                places[count, 0], places[count, 1] = piece, (place + 0.5) / CUT_PLACES
                count += 1
    return places


class _Places(NamedTuple):
    """Sample points of a motion.

    Attributes:
        piece: (places,) number of the piece.
        configuration: (places, dof) configurations.
        weight: (places, 4) weights of the control points; the first control point has the index of the piece.
        speed: (places, 4) weights of the control points in the velocity [1/s].
        clear: (places, links) clearances minus the tracking displacement bounds [m]; infinite if the row cannot become
            active.
        gradient: (places, links, joints) derivatives of the clearances with respect to the movable joints [m/rad].
    """

    piece: IntArray
    configuration: FloatArray
    weight: FloatArray
    speed: FloatArray
    clear: FloatArray
    gradient: FloatArray


@kernel
def _evaluate_places(
    control: FloatArray,
    knots: FloatArray,
    places: FloatArray,
    limits: MotionLimits,
    field: FieldArrays,
    matters: tuple[float, float],
) -> _Places:
    """Evaluate sample points.

    A link whose clearance cannot fall below the margin within the trust region, to first order, counts as far: its row
    would never be active.

    Args:
        control: (n, dof) control points.
        knots: (n + 4,) knots.
        places: (places, 2) piece of each sample point, and fraction of it.
        matters: The margin [m] and the trust [rad].
    """
    (margin, trust), movable = matters, limits.movable
    count, dof, bodies = len(places), control.shape[1], len(field.bodies) + len(field.pairs)
    pieces = places[:, 0].astype(np.int64)
    q, weight, clear = np.zeros((count, dof)), np.empty((count, 4)), np.full((count, bodies), np.inf)
    speed, velocity = np.zeros((count, 4)), np.zeros(dof)
    gradient, guesses = np.empty((count, bodies, len(movable))), np.full(bodies, FARTHER_M)
    for place in range(count):
        piece, t = pieces[place], places[place, 1]
        basis(knots, piece, t, weight[place])
        for j in range(dof):
            for c in range(4):
                q[place, j] += weight[place, c] * control[piece + c, j]
        if is_up(field.until):
            break
        guessed_slopes(q[place], field, movable, NEAR, guesses, clear[place], gradient[place])
        for link in range(bodies):
            guesses[link] = max(clear[place, link], 0.0) + FARTHER_M
        if limits.sway.shape[0] > 0:
            _velocity_weights(knots, piece, t, speed[place])
            for j in range(dof):
                velocity[j] = 0.0
                for c in range(4):
                    velocity[j] += speed[place, c] * control[piece + c, j]
            for link in range(clear.shape[1]):
                for j in range(dof):
                    clear[place, link] -= limits.sway[link, j] * abs(velocity[j])
        for link in range(clear.shape[1]):
            change = 0.0
            for m in range(len(movable)):
                change += abs(gradient[place, link, m])
            if clear[place, link] >= NEAR or clear[place, link] - margin > trust * change:
                clear[place, link] = math.inf
    return _Places(pieces, q, weight, speed, clear, gradient)


@kernel
def _count_near(near: _Places) -> int:
    """Number of clearance rows of sample points."""
    count = 0
    for place in range(near.clear.shape[0]):
        for link in range(near.clear.shape[1]):
            count += near.clear[place, link] < NEAR
    return count


@kernel
def _velocity_weights(knots: FloatArray, piece: int, t: float, weight: FloatArray) -> None:
    """Write the weights of a piece's control points in its velocity [1/s].

    The control points are `piece` to `piece + 3`; `t` is the fraction of the piece. The velocity is a quadratic
    B-spline; its control points are differences of the motion's.
    """
    span = piece + 3
    x = knots[span] + t * (knots[span + 1] - knots[span])
    high, low = (knots[span + 1] - x) / (knots[span + 1] - knots[span]), t
    first = high * (knots[span + 1] - x) / (knots[span + 1] - knots[span - 1])
    last = low * (x - knots[span]) / (knots[span + 2] - knots[span])
    middle = 1.0 - first - last
    d0 = 3.0 * first / (knots[span + 1] - knots[span - 2])
    d1 = 3.0 * middle / (knots[span + 2] - knots[span - 1])
    d2 = 3.0 * last / (knots[span + 3] - knots[span])
    weight[0], weight[1], weight[2], weight[3] = -d0, d0 - d1, d1 - d2, d2


@kernel
def _add_clearances(
    rows: ProgramRows,
    row: int,
    places: tuple[_Places, FloatArray, FloatArray],
    limits: MotionLimits,
    field: FieldArrays,
    required: tuple[float, float],
) -> int:
    """Add a clearance row for each near link; return the row count.

    The rows are scaled by 1 / `SCALE`.

    Args:
        row: Number of rows already present.
        places: Sample points, (n, dof) derivatives of the control points with respect to the time scale, and (n, dof)
            control points.
        required: Required clearance [m], and how much more of it than now a step has to reach where all control points
            are free [m].
    """
    (pieces, _, weight, speed, clear, slopes), drift, control = places
    (count, links), sways, (margin, regained) = clear.shape, limits.sway.shape[0] > 0, required
    joints, inner = len(limits.movable), len(control) - 6
    entry = rows.starts[row]
    velocity = np.zeros(joints)
    for place in range(count):
        nearest = math.inf
        for link in range(links):
            nearest = min(nearest, clear[place, link])
        if not nearest < NEAR or is_up(field.until):
            continue
        if sways:
            for m in range(joints):
                velocity[m] = 0.0
                for c in range(4):
                    velocity[m] += speed[place, c] * control[pieces[place] + c, limits.movable[m]]
        for link in range(links):
            distance = clear[place, link]
            if not distance < NEAR:
                continue
            free, time_scale = 0.0, 0.0
            if sways:  # slower motions have smaller tracking errors
                for m in range(joints):
                    time_scale -= limits.sway[link, limits.movable[m]] * abs(velocity[m]) / SCALE
            for c in range(4):
                k = pieces[place] + c - 3
                for m in range(joints):
                    time_scale -= weight[place, c] * slopes[place, link, m] * drift[k + 3, limits.movable[m]] / SCALE
                # At the beginning of a piece the last control point has no weight.
                if 0 <= k < inner and (weight[place, c] != 0.0 or speed[place, c] != 0.0):
                    free += weight[place, c]
                    for m in range(joints):
                        rows.columns[entry] = k * joints + m
                        rows.entries[entry] = -weight[place, c] * slopes[place, link, m] / SCALE
                        if sways:
                            sway = limits.sway[link, limits.movable[m]] * np.sign(velocity[m])
                            rows.entries[entry] += speed[place, c] * sway / SCALE
                        entry += 1
            if entry > rows.starts[row]:
                rows.time_scale[row] = time_scale
                least = margin
                if regained < math.inf:
                    least = min(margin, distance + free * regained)
                rows.upper[row] = (distance - least) / SCALE + time_scale
                row += 1
                rows.starts[row] = entry
    return row
