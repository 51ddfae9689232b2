r"""Bounds of a joint's position over time in rest-to-rest motions.

They hold for all motions of the other joints, within the joint's limits. At time :math:`t` of a motion of duration
:math:`T`, a joint with velocity :math:`v` has started from rest, and will come to rest. With :math:`|\ddot q| \le a`
its velocity at an earlier time :math:`\sigma` is at most :math:`a \sigma`, at most the limit :math:`V`, and at most
:math:`v + a (t - \sigma)`. It is therefore at most

.. math:: P(t, v) = \int_0^t \min(a \sigma,\; V,\; v + a (t - \sigma)) \, d\sigma

beyond its start. Backwards in time, it is at most :math:`P(T - t, -v)` beyond its goal. P increases with v, the other
bound decreases: the position at t is bounded by the smaller of both at the velocity that makes them equal.

With a jerk limit :math:`j` the velocity is at most :math:`j \sigma^2 / 2` at first, then :math:`a (\sigma - \delta)`,
:math:`\delta = a / 2 j`. The integral of the first over the second, with negative values of the second replaced by 0,
is :math:`a^3 / 24 j^2`; so :math:`P(t - \delta, v) + a^3 / 24 j^2` is a bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, Record
from hplan.certificate.task_check import TASK_TOLERANCE
from hplan.robot.limits import rest_to_rest

#: Position error allowed for the certificate's tolerances and rounding [rad].
SLACK = TASK_TOLERANCE + 2e-6


@dataclass(frozen=True, eq=False)
class JointMotions(Record):
    """Rest-to-rest motions of some joints.

    Attributes:
        start: (n,) start positions [rad].
        goal: (n,) goal positions [rad].
        lower: (n,) lower joint limits [rad].
        upper: (n,) upper joint limits [rad].
        velocity: (n,) velocity limits [rad/s]; 0 for a joint at rest.
        acceleration: (n,) acceleration limits, positive [rad/s^2].
        jerk: (n,) jerk limits [rad/s^3]; inf for no limit.
    """

    start: FloatArray
    goal: FloatArray
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray

    def select(self, joints: IntArray | list[int]) -> JointMotions:
        """The motions of some of the joints, by their numbers."""
        return JointMotions(**{name: values[joints] for name, values in vars(self).items()})

    def with_still_ones(self, count: int) -> JointMotions:
        """The motions with joints at rest at 0 appended, `count` in all."""
        still = dict.fromkeys(vars(self), 0.0) | {"acceleration": 1.0, "jerk": np.inf}
        more = count - len(self.start)
        return JointMotions(
            **{name: np.append(values, np.full(more, still[name])) for name, values in vars(self).items()}
        )

    @property
    def least_durations(self) -> FloatArray:
        """(n,) minimum duration of each joint alone [s].

        Infinite for a joint that cannot move but has to.
        """
        distance = np.maximum(np.abs(self.goal - self.start) - 2.0 * SLACK, 0.0)
        moving = self.velocity > 0.0
        alone: FloatArray = rest_to_rest(distance, np.where(moving, self.velocity, 1.0), self.acceleration, self.jerk)
        return np.where(moving | (distance == 0.0), alone, np.inf)

    def places(self, time: FloatArray, total: float) -> tuple[FloatArray, FloatArray]:
        """Bounds of the joints' positions at some times of a motion.

        Args:
            time: (..., 1) or (..., n) times in [0, total] [s].
            total: Duration of the motion [s].

        Returns:
            (..., n) lower and upper bounds [rad]; a lower bound above the upper one if no such motion exists.
        """
        upper = self._top(time, total, self.start, self.goal)
        lower = self._top(time, total, -self.start, -self.goal)
        return np.maximum(self.lower - SLACK, -lower), np.minimum(self.upper + SLACK, upper)

    def ranges(self, total: float, samples: int) -> tuple[FloatArray, FloatArray]:
        """(n,) lower and upper bounds of the positions during a motion [rad].

        Args:
            total: Duration of the motion, or of a longer one [s].
            samples: Number of intervals; more intervals give tighter bounds.
        """
        lower, upper = self.places(np.linspace(0.0, total, samples + 1)[:, None], total)
        # Between samples a joint is at most half of its maximum travel away from its position at one of them.
        half = 0.5 * self.velocity * (1.0 + 1e-9) * total / samples
        return (
            np.maximum(self.lower - SLACK, lower.min(axis=0) - half),
            np.minimum(self.upper + SLACK, upper.max(axis=0) + half),
        )

    def _top(self, time: FloatArray, total: float, start: FloatArray, goal: FloatArray) -> FloatArray:
        """Upper bounds of positions for given ends."""
        delay = 0.5 * self.acceleration / self.jerk
        since, until = np.maximum(time - delay, 0.0), np.maximum(total - time - delay, 0.0)
        # With a jerk limit the velocity exceeds the delayed ramp by at most this at first, and the position by this in
        # total.
        faster, farther = 0.25 * self.acceleration * delay, self.acceleration * delay**2 / 6.0 + SLACK
        high = np.minimum(self.velocity, self.acceleration * np.minimum(since, until) + faster) + SLACK
        low = -high
        # Bisection of the velocity range; the bound holds after any number of steps.
        for _ in range(26):
            middle = 0.5 * (low + high)
            short = start + self._travel(since, middle) < goal + self._travel(until, -middle)
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        return np.minimum(start + self._travel(since, high), goal + self._travel(until, -low)) + farther

    def _travel(self, time: FloatArray, velocity: FloatArray) -> FloatArray:
        """P of the module's docstring.

        A velocity that is unreachable in that time is replaced by the nearest reachable one.
        """
        a, limit = self.acceleration, self.velocity
        most = np.minimum(limit, a * time)
        velocity = np.clip(velocity, -most, most)
        peak = 0.5 * (velocity + a * time)
        held = np.maximum(time - (2.0 * limit - velocity) / a, 0.0)
        return (2.0 * np.minimum(peak, limit) ** 2 - velocity**2) / (2.0 * a) + limit * held
