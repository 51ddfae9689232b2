r"""Where a joint can be at which time of a motion from rest to rest within its limits, whatever the other joints do.

At time :math:`t` of a motion of length :math:`T` a joint that has velocity :math:`v` has come from rest, and comes to
rest. With :math:`|\ddot q| \le a` its velocity at an earlier time :math:`\sigma` is at most :math:`a \sigma`, at most
the limit :math:`V`, and at most :math:`v + a (t - \sigma)`, so that it is at most

.. math:: P(t, v) = \int_0^t \min(a \sigma,\; V,\; v + a (t - \sigma)) \, d\sigma

beyond its start. Seen backwards in time, it is at most :math:`P(T - t, -v)` beyond its goal. P grows with v, the other
falls: the place of a joint at t is bounded by the smaller of both at the velocity at which they are equal.

With a jerk limit :math:`j` the velocity is at most :math:`j \sigma^2 / 2` at first, then
:math:`a (\sigma - \delta)`, :math:`\delta = a / 2 j`. The first exceeds the second, where that is positive, and 0
elsewhere, by :math:`a^3 / 24 j^2` in all; so :math:`P(t - \delta, v) + a^3 / 24 j^2` is a bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, Record
from hplan.certificate.task_check import SAME
from hplan.robot.limits import rest_to_rest

#: Deviation of positions that the certificate's tolerances and rounding may make [rad].
SLACK = SAME + 2e-6


@dataclass(frozen=True, eq=False)
class JointMotions(Record):
    """Motions of some joints from rest to rest.

    Attributes:
        start: (n,) where they begin [rad].
        goal: (n,) where they end [rad].
        lower: (n,) where the joints can be: lower ends.
        upper: (n,) upper ends.
        velocity: (n,) largest speeds [rad/s]; 0 for a joint that stands still.
        acceleration: (n,) largest accelerations, positive [rad/s^2].
        jerk: (n,) largest jerks [rad/s^3]; infinite where there is no limit.
    """

    start: FloatArray
    goal: FloatArray
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray

    def only(self, joints: IntArray | list[int]) -> JointMotions:
        """The motions of some of the joints, by their numbers."""
        return JointMotions(**{name: values[joints] for name, values in vars(self).items()})

    def with_still_ones(self, count: int) -> JointMotions:
        """The motions, and behind them joints that stand still at 0, so many in all."""
        still = dict.fromkeys(vars(self), 0.0) | {"acceleration": 1.0, "jerk": np.inf}
        more = count - len(self.start)
        return JointMotions(
            **{name: np.append(values, np.full(more, still[name])) for name, values in vars(self).items()}
        )

    @property
    def least_durations(self) -> FloatArray:
        """(n,) shortest durations of each joint alone; infinite where one cannot move and has to [s]."""
        distance = np.maximum(np.abs(self.goal - self.start) - 2.0 * SLACK, 0.0)
        moving = self.velocity > 0.0
        alone: FloatArray = rest_to_rest(distance, np.where(moving, self.velocity, 1.0), self.acceleration, self.jerk)
        return np.where(moving | (distance == 0.0), alone, np.inf)

    def places(self, time: FloatArray, total: float) -> tuple[FloatArray, FloatArray]:
        """Bounds of where the joints are at some times of a motion.

        Args:
            time: (..., 1) times, or (..., n), in [0, total] [s].
            total: Length of the motion [s].

        Returns:
            (..., n) lower and upper bounds [rad]; lower ones above upper ones where no such motion exists.
        """
        upper = self._top(time, total, self.start, self.goal)
        lower = self._top(time, total, -self.start, -self.goal)
        return np.maximum(self.lower - SLACK, -lower), np.minimum(self.upper + SLACK, upper)

    def ranges(self, total: float, samples: int) -> tuple[FloatArray, FloatArray]:
        """Bounds of where the joints are at any time of a motion, (n,) lower and (n,) upper ones [rad].

        Args:
            total: Length of the motion, or of a longer one [s].
            samples: Into how many parts it is cut; of more the bounds are tighter.
        """
        lower, upper = self.places(np.linspace(0.0, total, samples + 1)[:, None], total)
        # Between samples a joint is no farther than half of its travel from where it is at one of them.
        half = 0.5 * self.velocity * (1.0 + 1e-9) * total / samples
        return (
            np.maximum(self.lower - SLACK, lower.min(axis=0) - half),
            np.minimum(self.upper + SLACK, upper.max(axis=0) + half),
        )

    def _top(self, time: FloatArray, total: float, start: FloatArray, goal: FloatArray) -> FloatArray:
        """Upper bounds of places for given ends."""
        delay = 0.5 * self.acceleration / self.jerk
        since, until = np.maximum(time - delay, 0.0), np.maximum(total - time - delay, 0.0)
        # With a jerk limit the velocity can be so much above the delayed ramp at first, and the place in all.
        faster, farther = 0.25 * self.acceleration * delay, self.acceleration * delay**2 / 6.0 + SLACK
        high = np.minimum(self.velocity, self.acceleration * np.minimum(since, until) + faster) + SLACK
        low = -high
        # Halvings of the range of velocities; the bound holds after any number of them.
        for _ in range(26):
            middle = 0.5 * (low + high)
            short = start + self._travel(since, middle) < goal + self._travel(until, -middle)
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        return np.minimum(start + self._travel(since, high), goal + self._travel(until, -low)) + farther

    def _travel(self, time: FloatArray, velocity: FloatArray) -> FloatArray:
        """P of the module's text, for a velocity that is not reached in that time that of the nearest one that is."""
        a, limit = self.acceleration, self.velocity
        most = np.minimum(limit, a * time)
        velocity = np.clip(velocity, -most, most)
        peak = 0.5 * (velocity + a * time)
        held = np.maximum(time - (2.0 * limit - velocity) / a, 0.0)
        return (2.0 * np.minimum(peak, limit) ** 2 - velocity**2) / (2.0 * a) + limit * held
