r"""Upper bounds of joint torques along cubics or quintics.

Torques are sampled, and the change of torque between two samples is bounded. Between two samples :math:`h` apart a
twice differentiable function exceeds the larger of them by no more than :math:`h^2 / 8 \max |\ddot \tau|` (the error of
linear interpolation). So the torque of joint j on a segment obeys

.. math:: |\tau_j(t)| \le \max(|\tau_j(t_0)|, |\tau_j(t_1)|) + \tfrac18 (t_1 - t_0)^2 \, T_j,

with both samples taken *on that segment*: the acceleration may jump at its ends. :math:`T_j` bounds :math:`|\ddot
\tau_j|`. It follows from the recursive Newton-Euler equations in world coordinates,

.. math::
    \tau_j = z_j \cdot n_j, \quad n_j = \sum_{i \ge j} \bigl( (c_i - o_j) \times m_i (\ddot c_i - g)
        + \tfrac{d}{dt} (I_i \omega_i) \bigr),

by bounding the norm of each vector and of its time derivatives, from the base outward and back:

- products: :math:`|(x y)^{(n)}| \le \sum_k \binom nk |x^{(k)}| |y^{(n - k)}|` (Leibniz);
- a vector fixed in a body rotates with it, :math:`\dot x = \omega \times x`; an inertia obeys
  :math:`|\dot I| \le 2 |\omega| |I|`;
- :math:`\omega_i = \omega_{i - 1} + z_i \dot q_i`, with :math:`|\dot q|, |\ddot q|, |\dddot q|` bounded by the Bezier
  points of the segment's derivatives, and likewise the fourth derivative, which is zero for cubics;
- a prismatic joint rotates with its parent, :math:`\omega_i = \omega_{i - 1}`, and lies at :math:`s_i + q_i z_i` from
  the parent's joint, both vectors fixed in the parent and :math:`|q|` bounded by the Bezier points; its force is
  :math:`z_i \cdot f_i`, with :math:`f_i = \sum_{j \ge i} m_j (\ddot c_j - g)`.

The rotor adds its inertia times the fourth derivative. Segments whose bound could exceed the maximum sample by more
than a given fraction of the limit are halved, each time with a quarter of the remainder, up to a fixed number of
samples; segments still unresolved then keep their current bound.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import any_int, kernel
from hplan.errors import InputError
from hplan.robot.dynamics import InverseDynamics, newton_euler
from hplan.trajectory.cubics import cubic_at

#: Segments are halved until the bound exceeds the maximum sample by at most this fraction of the limit.
GAP = 5e-5

#: Maximum number of samples spent on halving: a constant, and a number for each segment.
SAMPLES, SAMPLES_PER_PIECE = 20_000, 16

#: Number of consecutive segments that share one remainder: it takes longer to compute than the maximum rates of a
#: group.
_ALIKE = any_int(4)

#: Number of derivatives required: of axes and inertias, and of vectors in bodies.
_OF_AXES, _OF_VECTORS = any_int(3), any_int(4)

_CHOOSE = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 1.0, 0.0, 0.0, 0.0],
        [1.0, 2.0, 1.0, 0.0, 0.0],
        [1.0, 3.0, 3.0, 1.0, 0.0],
        [1.0, 4.0, 6.0, 4.0, 1.0],
    ]
)


def largest_torques(
    dynamics: InverseDynamics, bezier: FloatArray, duration: FloatArray, limit: FloatArray
) -> FloatArray:
    """Upper bounds of |torque| along a motion of cubics or quintics.

    Args:
        dynamics: Inverse dynamics of the robot.
        bezier: (pieces, 4 or 6, dof) Bezier points [rad, m].
        duration: (pieces,) durations [s].
        limit: (dof,) torque limits, force limits for prismatic joints; they set the required accuracy [N m, N].

    Returns:
        (dof,) bounds [N m, N]; the bound nearest to its limit exceeds the true maximum by at most `GAP` of the limit,
        unless the samples do not suffice because the motion is too fast or its segments are too long. Infinite if
        numbers overflow.

    Raises:
        InputError: A joint of the model is neither revolute about a fixed axis nor prismatic along one.
    """
    if dynamics.bodies is None or dynamics.sizes is None:
        raise InputError("torques are bounded only for joints that turn about a fixed axis or slide along one")
    most = SAMPLES + SAMPLES_PER_PIECE * len(bezier)
    gravity = np.array(dynamics.model.gravity.linear)
    scale = np.where(limit > 0.0, limit, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        return _largest(bezier, duration, dynamics.bodies, dynamics.sizes, gravity, scale, most)


@kernel
def _largest(
    bezier: FloatArray,
    duration: FloatArray,
    bodies: FloatArray,
    sizes: FloatArray,
    gravity: FloatArray,
    scale: FloatArray,
    most: int,
) -> FloatArray:
    count, dof = bezier.shape[0], bezier.shape[2]
    slack = _remainders(bezier, duration, sizes, _norm(gravity))
    # Open intervals: their segments, their starts, their lengths as a fraction of the segment, |torque| at both ends.
    piece, begin, width = np.empty(count, dtype=np.int64), np.zeros(count), np.empty(count)
    for i in range(count):
        piece[i], width[i] = i, 1.0
    first = _torques_at(bezier, duration, piece, begin, bodies, gravity)
    last = _torques_at(bezier, duration, piece, width, bodies, gravity)
    peak, bound, spent = np.zeros(dof), np.zeros(dof), 0
    for i in range(count):
        for j in range(dof):
            peak[j] = max(peak[j], first[i, j], last[i, j])
    while True:
        enough = GAP
        for j in range(dof):
            enough = max(enough, peak[j] / scale[j] + GAP)
        is_open = np.zeros(len(piece), dtype=np.bool_)
        for i in range(len(piece)):
            for j in range(dof):
                high = max(first[i, j], last[i, j]) + width[i] * width[i] * slack[piece[i], j]
                is_open[i] |= high > enough * scale[j]
        halved = 0
        for i in range(len(piece)):
            halved += is_open[i]
        if spent + halved > most:
            halved = 0
        for i in range(len(piece)):
            if halved == 0 or not is_open[i]:
                for j in range(dof):
                    high = max(first[i, j], last[i, j]) + width[i] * width[i] * slack[piece[i], j]
                    bound[j] = max(bound[j], high)
        if halved == 0:
            return bound
        spent += halved
        # The first halves, then the second ones.
        pieces, begins, widths = np.empty(2 * halved, dtype=np.int64), np.empty(2 * halved), np.empty(2 * halved)
        firsts, lasts, n = np.empty((2 * halved, dof)), np.empty((2 * halved, dof)), 0
        for i in range(len(piece)):
            if is_open[i]:
                half = 0.5 * width[i]
                pieces[n], begins[n], widths[n] = piece[i], begin[i], half
                pieces[halved + n], begins[halved + n], widths[halved + n] = piece[i], begin[i] + half, half
                for j in range(dof):
                    firsts[n, j], lasts[halved + n, j] = first[i, j], last[i, j]
                n += 1
        middle = _torques_at(bezier, duration, pieces[halved:], begins[halved:], bodies, gravity)
        for n in range(halved):
            for j in range(dof):
                peak[j] = max(peak[j], middle[n, j])
                lasts[n, j] = firsts[halved + n, j] = middle[n, j]
        piece, begin, width, first, last = pieces, begins, widths, firsts, lasts


@kernel
def _norm(vector: FloatArray) -> float:
    """Euclidean norm."""
    total = 0.0
    for value in vector:
        total += value * value
    return float(np.sqrt(total))


@kernel
def _torques_at(
    bezier: FloatArray, duration: FloatArray, piece: IntArray, at: FloatArray, bodies: FloatArray, gravity: FloatArray
) -> FloatArray:
    """(n, dof) |torque| at points within segments, with NaN replaced by infinity."""
    count, dof, degree = len(piece), bezier.shape[2], bezier.shape[1] - 1.0
    q, v, a, torque = np.empty((count, dof)), np.empty((count, dof)), np.empty((count, dof)), np.empty((count, dof))
    for i in range(count):
        h, t = duration[piece[i]], at[i]
        u = 1.0 - t
        for j in range(dof):
            p0, p1, p2, p3 = cubic_at(bezier, piece[i], j, t)
            q[i, j] = u * u * u * p0 + 3.0 * u * u * t * p1 + 3.0 * u * t * t * p2 + t * t * t * p3
            v[i, j] = degree * (u * u * (p1 - p0) + 2.0 * u * t * (p2 - p1) + t * t * (p3 - p2)) / h
            a[i, j] = degree * (degree - 1.0) * (u * ((p2 - p1) - (p1 - p0)) + t * ((p3 - p2) - (p2 - p1))) / (h * h)
    newton_euler(q, v, a, bodies, gravity, torque)
    for i in range(count):
        for j in range(dof):
            value = abs(torque[i, j])
            torque[i, j] = value if value < np.inf else np.inf
    return torque


@kernel
def _remainders(bezier: FloatArray, duration: FloatArray, sizes: FloatArray, gravity: float) -> FloatArray:
    """(pieces, dof) maximum excess of |torque| in a segment over its ends.

    It is h^2 / 8 times the bound :math:`T_j` of the module's text. Rows of `w`, `z`, `s`, `d`, `tensor`, `acc`,
    `force`, `moment` are norms: of a body's angular velocity, its joint's axis, the vectors from the parent's joint to
    its own and on to its centre of mass, its inertia, the acceleration of its joint, and force and moment there; column
    n is the n-th time derivative. Column n of `slide` is the n-th derivative of a prismatic joint's displacement, or 0.
    Consecutive segments share the maximum rates of their group.
    """
    count, bodies = bezier.shape[0], sizes.shape[0]
    w, acc = np.zeros((bodies + 1, 4)), np.zeros((bodies + 1, 3))  # The last row belongs to the base.
    acc[bodies, 0] = gravity
    z, s, d = np.zeros((bodies, 5)), np.zeros((bodies, 5)), np.zeros((bodies, 5))
    tensor, force, moment = np.zeros((bodies, 4)), np.zeros((bodies, 3)), np.zeros((bodies, 3))
    rate, slide, rotor, work = np.zeros(5), np.zeros(5), np.zeros(bodies), np.empty(bezier.shape[1])
    slack = np.zeros((count, bodies))
    for first in range(0, count, _ALIKE):
        end = min(first + _ALIKE, count)
        for k in range(bodies):
            farthest = 0.0
            for n in range(1, 5):
                rate[n] = 0.0
            for i in range(first, end):
                for n in range(len(work)):
                    work[n] = bezier[i, n, k]
                    farthest = _maximum_of(farthest, abs(work[n]))
                left, scale = len(work) - 1, 1.0
                for n in range(1, min(left, 4) + 1):
                    scale *= left / duration[i]
                    for m in range(left):
                        work[m] = work[m + 1] - work[m]
                        rate[n] = _maximum_of(rate[n], scale * abs(work[m]))
                    left -= 1
            rotor[k] = sizes[k, 6] * rate[4]
            above = int(sizes[k, 4])
            z[k, 0], s[k, 0], d[k, 0], tensor[k, 0] = 1.0, sizes[k, 0], sizes[k, 1], sizes[k, 3]
            _rotate_derivatives(w[above], z[k], _OF_VECTORS, 1.0)
            _rotate_derivatives(w[above], s[k], _OF_VECTORS, 1.0)
            slides = sizes[k, 5] > 0.0
            if slides:
                for n in range(5):
                    slide[n] = rate[n] if n > 0 else farthest
                    for m in range(n + 1):
                        s[k, n] += _CHOOSE[n, m] * z[k, n - m] * slide[m]
            for n in range(4):
                w[k, n] = w[above, n]
                for m in range(n + 1 if not slides else 0):
                    w[k, n] += _CHOOSE[n, m] * z[k, m] * rate[n - m + 1]
            _rotate_derivatives(w[k], d[k], _OF_VECTORS, 1.0)
            _rotate_derivatives(w[k], tensor[k], _OF_AXES, 2.0)
            for n in range(3):
                acc[k, n] = acc[above, n] + s[k, n + 2]
                force[k, n] = sizes[k, 2] * (acc[k, n] + d[k, n + 2])
                moment[k, n] = 0.0
                for m in range(n + 2):
                    moment[k, n] += _CHOOSE[n + 1, m] * tensor[k, m] * w[k, n + 1 - m]
                for m in range(n + 1):
                    moment[k, n] += _CHOOSE[n, m] * d[k, m] * force[k, n - m]
        for k in range(bodies - 1, -1, -1):
            above = int(sizes[k, 4])
            bend = rotor[k]
            for m in range(3):
                bend += _CHOOSE[2, m] * z[k, m] * (force[k, 2 - m] if sizes[k, 5] > 0.0 else moment[k, 2 - m])
            for i in range(first, end):
                most = bend
                if bend > 0.0:  # Zero times infinity would be NaN, in a long pause.
                    most *= 0.125 * duration[i] * duration[i]
                slack[i, k] = most if most < np.inf else np.inf
            if above < bodies:
                for n in range(3):
                    force[above, n] += force[k, n]
                    moment[above, n] += moment[k, n]
                    for m in range(n + 1):
                        moment[above, n] += _CHOOSE[n, m] * s[k, m] * force[k, n - m]
    return slack


@kernel
def _maximum_of(one: float, other: float) -> float:
    """Maximum of non-negative numbers, with NaN in `other` treated as infinity."""
    return max(one, other) if other < np.inf else np.inf


@kernel
def _rotate_derivatives(w: FloatArray, x: FloatArray, orders: int, factor: float) -> None:
    """Fill in the derivatives of a quantity that rotates with a body."""
    for n in range(orders):
        x[n + 1] = 0.0
        for m in range(n + 1):
            x[n + 1] += factor * _CHOOSE[n, m] * w[m] * x[n - m]
