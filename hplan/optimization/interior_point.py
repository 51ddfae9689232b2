r"""Interior-point solver for linear programs over a spline and time scale.

With :math:`y` the changes of the control points and :math:`s` the time scale,

.. math:: \min_{y, s} \; s + \tfrac \varepsilon 2 |y|^2 \quad \text{with} \quad
    g_r y + p_r s \le u_r \;\; \text{for all rows}, \quad -g_r y + p_r s \le l_r \;\; \text{for two-sided rows}.

A row involves the control points of one piece only. With the joints of a control point adjacent to each other, the
normal equations are therefore banded, except for the row and column of the time scale, and are factored in time linear
in the number of pieces. General sparse solvers take several times as long (piqp 2.5, Clarabel 15, HiGHS 40 times). The
method is Mehrotra's predictor-corrector (SIAM J. Optim. 2, 1992).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, ShortArray
from hplan.base.deadline import is_up
from hplan.base.kernels import any_int, inline, kernel

#: Weight of the squared changes: selects the nearest among motions of equal duration.
NEARBY = 1e-4

#: Maximum residual of a solution, as a multiple of the required accuracy; and the residual and accuracy accepted if
#: rounding permits no further step.
_RESIDUAL, _NEARLY = 0.1, 1e-5

#: Rows with more entries than this are checked for consecutive columns.
_MANY_ENTRIES = any_int(8)

#: Fraction of the longest step that keeps slacks and multipliers positive.
_INSIDE = 0.995


class ProgramRows(NamedTuple):
    """Inequalities of a program; the two-sided rows come first.

    Attributes:
        starts: (rows + 1,) index of the first entry of each row.
        columns: (entries,) indices of the unknowns, ascending within a row and within `band` of each other.
        entries: (entries,) coefficients g.
        time_scale: (rows,) coefficients p of the time scale.
        upper: (rows,) right-hand sides u.
        lower: (two_sided,) right-hand sides l.
    """

    starts: ShortArray
    columns: ShortArray
    entries: FloatArray
    time_scale: FloatArray
    upper: FloatArray
    lower: FloatArray


class _Point(NamedTuple):
    """Iterate or direction: unknowns, slacks, multipliers; upper sides before lower ones.

    Attributes:
        x: (count + 1,) unknowns, the time scale last.
        slack: (sides,) slacks.
        dual: (sides,) multipliers.
    """

    x: FloatArray
    slack: FloatArray
    dual: FloatArray


class _Normal(NamedTuple):
    """Factored normal equations.

    Attributes:
        factor: (count, band + 1) Cholesky factor of the band.
        border: (count,) column of the time scale.
        solved: (count,) solution of the band for that column.
    """

    factor: FloatArray
    border: FloatArray
    solved: FloatArray


@kernel
def solve_program(
    rows: ProgramRows, count: int, band: int, accuracy: tuple[float, float], until: FloatArray
) -> tuple[bool, FloatArray]:
    """Solve a linear program.

    Args:
        rows: Inequalities of the program.
        count: Number of unknowns without the time scale.
        band: Maximum difference between the columns of a row.
        accuracy: Maximum duality gap, and the same as a fraction of the gain in time scale, whichever is larger; rows
            are satisfied to a tenth of it.
        until: Deadline (`hplan.base.deadline`).

    Returns:
        Whether a solution was found, and (count + 1,) the unknowns, the time scale last.
    """
    sides = len(rows.upper) + len(rows.lower)
    point = _Point(np.zeros(count + 1), np.empty(sides), np.empty(sides))
    step = _Point(np.empty(count + 1), np.empty(sides), np.empty(sides))
    normal = _Normal(np.empty((count, band + 1)), np.empty(count), np.empty(count))
    residual, product, value = np.empty(sides), np.empty(sides), np.empty(len(rows.upper))
    gradient = np.empty(count + 1)
    x, slack, dual = point
    _begin(rows, point, value, residual)
    worst, gap = math.inf, math.inf
    # Maximum number of iterations; nearly all successful solves take 6 to 20.
    for _ in range(30):
        worst = max(_residuals(rows, point, value, residual), _gradient(rows, point, gradient))
        gap = 0.0
        for side in range(sides):
            gap += slack[side] * dual[side]
        enough = max(accuracy[0], accuracy[1] * (1.0 - x[count]))
        if worst < _RESIDUAL * enough and gap < enough:
            return True, x
        if is_up(until):
            break
        corner = _normal_equations(rows, slack, dual, normal.factor, normal.border)
        # Beyond this residual the iteration does not recover.
        if not (worst < 1e12 and _factor(normal.factor)):
            break
        for i in range(count):
            normal.solved[i] = normal.border[i]
        _substitute(normal.factor, normal.solved)
        for i in range(count):
            corner -= normal.border[i] * normal.solved[i]
        # The predictor aims at zero complementarity; its progress sets the target of the corrector.
        for side in range(sides):
            product[side] = slack[side] * dual[side]
        _search_direction(rows, point, (residual, product, gradient, value), normal, corner, step)
        primal, other = _longest_step(slack, step.slack), _longest_step(dual, step.dual)
        ahead = 0.0
        for side in range(sides):
            ahead += (slack[side] + primal * step.slack[side]) * (dual[side] + other * step.dual[side])
        centre = gap / sides * (ahead / gap) ** 3
        for side in range(sides):
            product[side] += step.slack[side] * step.dual[side] - centre
        _search_direction(rows, point, (residual, product, gradient, value), normal, corner, step)
        primal, other = _longest_step(slack, step.slack), _longest_step(dual, step.dual)
        for i in range(count + 1):
            x[i] += primal * step.x[i]
        for side in range(sides):
            slack[side] += primal * step.slack[side]
            dual[side] += other * step.dual[side]
    return worst < _NEARLY and gap < _NEARLY, x


@kernel
def _begin(rows: ProgramRows, point: _Point, value: FloatArray, residual: FloatArray) -> None:
    """Write the initial point: no change, and its minimum time scale.

    The multipliers are scaled so that their gradient with respect to the time scale does not exceed the objective's.
    """
    x, slack, dual = point
    total, last = len(rows.upper), len(x) - 1
    for r in range(total):
        if rows.time_scale[r] < 0.0:
            x[last] = max(x[last], -rows.upper[r] / -rows.time_scale[r])
            if r < len(rows.lower):
                x[last] = max(x[last], -rows.lower[r] / -rows.time_scale[r])
    slack[:] = 0.0
    _residuals(rows, point, value, residual)
    slope = 0.0
    for side in range(len(slack)):
        # Minimum initial slack.
        slack[side] = max(0.1, -residual[side])
        dual[side] = 1.0 / slack[side]
        slope += max(0.0, -rows.time_scale[side if side < total else side - total]) * dual[side]
    for side in range(len(slack)):
        dual[side] /= max(slope, 1.0)


@kernel
def _residuals(rows: ProgramRows, point: _Point, value: FloatArray, residual: FloatArray) -> float:
    """Write the residual of each side, slack included; return the maximum magnitude."""
    total, time_scale = len(rows.upper), point.x[-1]
    _products(rows, point.x, value)
    worst = 0.0
    for r in range(total):
        residual[r] = value[r] + rows.time_scale[r] * time_scale + point.slack[r] - rows.upper[r]
        worst = max(worst, abs(residual[r]))
    for r in range(len(rows.lower)):
        residual[total + r] = rows.time_scale[r] * time_scale - value[r] + point.slack[total + r] - rows.lower[r]
        worst = max(worst, abs(residual[total + r]))
    return worst


@kernel
def _gradient(rows: ProgramRows, point: _Point, gradient: FloatArray) -> float:
    """Write the gradient of the Lagrangian; return its maximum magnitude."""
    count = len(gradient) - 1
    for i in range(count):
        gradient[i] = NEARBY * point.x[i]
    gradient[count] = 1.0
    _add_transposed(rows, point.dual, gradient)
    worst = 0.0
    for value in gradient:
        worst = max(worst, abs(value))
    return worst


@kernel
def _search_direction(
    rows: ProgramRows,
    point: _Point,
    known: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    normal: _Normal,
    corner: float,
    step: _Point,
) -> None:
    """Write the Newton direction towards zero residuals and complementarity into `step`.

    Args:
        point: The current iterate.
        known: Residuals; products of slack and multiplier to be removed; gradient; and workspace of one value per row.
        normal: Factored normal equations.
        corner: Schur complement of the time scale: the coefficient of the last equation after eliminating the others.
    """
    residual, product, gradient, move = known
    count, total = len(gradient) - 1, len(rows.upper)
    for side in range(len(residual)):
        step.slack[side] = (point.dual[side] * residual[side] - product[side]) / point.slack[side]
    step.x[:] = 0.0
    _add_transposed(rows, step.slack, step.x)
    for i in range(count + 1):
        step.x[i] = -gradient[i] - step.x[i]
    _substitute(normal.factor, step.x[:count])
    last = step.x[count]
    for i in range(count):
        last -= normal.border[i] * step.x[i]
    last /= corner
    step.x[count] = last
    for i in range(count):
        step.x[i] -= normal.solved[i] * last
    _products(rows, step.x, move)
    for r in range(total):
        step.slack[r] = -residual[r] - move[r] - rows.time_scale[r] * last
    for r in range(len(rows.lower)):
        step.slack[total + r] = -residual[total + r] + move[r] - rows.time_scale[r] * last
    for side in range(len(residual)):
        step.dual[side] = -(product[side] + point.dual[side] * step.slack[side]) / point.slack[side]


@kernel
def _longest_step(values: FloatArray, step: FloatArray) -> float:
    """Largest step fraction that keeps all values positive; at most 1."""
    part = 1.0
    for i in range(len(values)):
        if values[i] + part * step[i] < (1.0 - _INSIDE) * values[i]:
            part = -_INSIDE * values[i] / step[i]
    return part


@inline
def _is_gapless(columns: ShortArray, first: int, end: int) -> bool:
    """True if a row has many entries in consecutive columns.

    Clearance rows are of this kind; their columns need no look-up.
    """
    gapless: bool = end - first > _MANY_ENTRIES and columns[end - 1] - columns[first] == end - 1 - first
    return gapless


@kernel
def _products(rows: ProgramRows, x: FloatArray, value: FloatArray) -> None:
    """Write each row's product with the unknowns, time scale excluded."""
    starts, columns, entries = rows.starts, rows.columns, rows.entries
    for r in range(len(value)):
        first, end = starts[r], starts[r + 1]
        total = 0.0
        if _is_gapless(columns, first, end):
            j = columns[first]
            # Four independent sums, so that additions do not wait for each other.
            a, b, c, d = 0.0, 0.0, 0.0, 0.0
            while first + 4 <= end:
                a += entries[first] * x[j]
                b += entries[first + 1] * x[j + 1]
                c += entries[first + 2] * x[j + 2]
                d += entries[first + 3] * x[j + 3]
                first += 4
                j += 4
            total = (a + b) + (c + d)
        for e in range(first, end):
            total += entries[e] * x[columns[e]]
        value[r] = total


@kernel
def _add_transposed(rows: ProgramRows, weights: FloatArray, result: FloatArray) -> None:
    """Add the transposed rows, weighted by both of their sides, to `result`."""
    starts, columns, entries, time_scale = rows.starts, rows.columns, rows.entries, rows.time_scale
    total, both, last = len(rows.upper), len(rows.lower), len(result) - 1
    for r in range(total):
        above, below = weights[r], 0.0
        if r < both:
            below = weights[total + r]
        first, end, weight = starts[r], starts[r + 1], above - below
        if _is_gapless(columns, first, end):
            row = entries[first:end]
            part = result[columns[first] : columns[first] + len(row)]
            for e in range(len(row)):
                part[e] += weight * row[e]
        else:
            for e in range(first, end):
                result[columns[e]] += weight * entries[e]
        result[last] += (above + below) * time_scale[r]


@kernel
def _normal_equations(
    rows: ProgramRows, slack: FloatArray, dual: FloatArray, factor: FloatArray, border: FloatArray
) -> float:
    """Write the band and border of the normal equations; return the corner.

    Row j of `factor` is column j of the lower triangle, from the diagonal downward.
    """
    starts, columns, entries, time_scale = rows.starts, rows.columns, rows.entries, rows.time_scale
    total, both = len(rows.upper), len(rows.lower)
    factor[:] = 0.0
    border[:] = 0.0
    for i in range(len(factor)):
        factor[i, 0] = NEARBY
    corner, r = 0.0, 0
    while r < total:
        above, below = dual[r] / slack[r], 0.0
        if r < both:
            below = dual[total + r] / slack[total + r]
        first, end, weight, tilt = starts[r], starts[r + 1], above + below, (above - below) * time_scale[r]
        corner += weight * time_scale[r] * time_scale[r]
        if not _is_gapless(columns, first, end):
            for e in range(first, end):
                j = columns[e]
                border[j] += tilt * entries[e]
                for f in range(e, end):
                    factor[j, columns[f] - j] += weight * entries[e] * entries[f]
            r += 1
            continue
        # Clearance rows of several bodies at one sample point have the same columns. Two rows at a time halve the reads
        # and writes of the factor, which dominate the run time.
        start, row, second, other, rise = columns[first], entries[first:end], entries[first:end], 0.0, 0.0
        if (
            both <= r < total - 1
            and starts[r + 2] - end == len(row)
            and columns[end] == start
            and _is_gapless(columns, end, starts[r + 2])
        ):
            second, other = entries[end : starts[r + 2]], dual[r + 1] / slack[r + 1]
            rise = other * time_scale[r + 1]
            corner += rise * time_scale[r + 1]
            r += 1
        for e in range(len(row)):
            one, two, column = weight * row[e], other * second[e], factor[start + e]
            border[start + e] += tilt * row[e] + rise * second[e]
            for f in range(len(row) - e):
                column[f] += one * row[e + f] + two * second[e + f]
        r += 1
    return corner


@kernel
def _factor(factor: FloatArray) -> bool:
    """Cholesky-factor a banded matrix in place; False if not positive definite."""
    count, width = factor.shape
    for j in range(count):
        if not factor[j, 0] > 0.0:
            return False
        inverse = 1.0 / math.sqrt(factor[j, 0])
        reach = min(width, count - j)
        for i in range(reach):
            factor[j, i] *= inverse
        for k in range(1, reach):
            pivot = factor[j, k]
            for i in range(reach - k):
                factor[j + k, i] -= pivot * factor[j, k + i]
    return True


@kernel
def _substitute(factor: FloatArray, right: FloatArray) -> None:
    """Solve with the factor and its transpose, in place."""
    count, width = factor.shape
    for j in range(count):
        right[j] /= factor[j, 0]
        value = right[j]
        for i in range(1, min(width, count - j)):
            right[j + i] -= value * factor[j, i]
    for j in range(count - 1, -1, -1):
        end, i = min(width, count - j), 1
        # Four independent sums, so that additions do not wait for each other.
        a, b, c, d = 0.0, 0.0, 0.0, 0.0
        while i + 4 <= end:
            a += factor[j, i] * right[j + i]
            b += factor[j, i + 1] * right[j + i + 1]
            c += factor[j, i + 2] * right[j + i + 2]
            d += factor[j, i + 3] * right[j + i + 3]
            i += 4
        total = (a + b) + (c + d)
        while i < end:
            total += factor[j, i] * right[j + i]
            i += 1
        right[j] = (right[j] - total) / factor[j, 0]
