r"""Ceiling of the path speed where the path is tight and tracking errors grow with speed.

At the path speed :math:`\dot s` every joint may be off by the delay times :math:`|q_j'(s)| \, \dot s` beyond its
deviation at rest, and link :math:`k` sways by :math:`\dot s` times the delay times :math:`\sigma_k(|q'(s)|)`, with
:math:`\sigma_k` the linear form of `hplan.robot.model.Robot.sway`. Where the link has the clearance :math:`d_k(s)`
beyond the one to keep and its sway at rest,

.. math:: \dot s \le \min_k \frac{\lambda \, d_k(s)}{\text{delay} \cdot \sigma_k(|q'(s)|)},

:math:`\lambda < 1` leaving the rest to the proof. Rows are averages over a little time (`hplan.timing.retime`): what
holds at a tight place holds for as long before and after it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.bodies.reach import largest_sway
from hplan.collision.clearance_field import ClearanceField
from hplan.robot.limits import GeometricPath, Limits
from hplan.robot.model import Robot

#: Clearance that counts at least, so that motions end [m].
LEAST = 2e-5

#: Samples of the clearance in each interval of the grid.
SAMPLES = 2


@dataclass(frozen=True, eq=False)
class SpeedCeiling:
    """Largest path speeds at which the sway fits into the clearance.

    Attributes:
        robot: The arm.
        path: The path.
        field: Arm and obstacles; deviations at rest are allowed for in it.
        delay_s: Deviation of a joint for each rad/s [s].
        fraction: Part of the clearance that the sway may take.
        averaged_s: Rows of the motion are averages over this long before and after [s].
    """

    robot: Robot
    path: GeometricPath
    field: ClearanceField
    delay_s: float
    fraction: float
    averaged_s: float

    def __call__(self, grid: FloatArray) -> FloatArray:
        """(n,) increasing path parameters -> (n,) largest ds/dt there, infinite where nothing is near."""
        inner = np.arange(SAMPLES) / SAMPLES
        samples = np.append((grid[:-1, None] + np.diff(grid)[:, None] * inner).ravel(), grid[-1])
        clear = np.maximum(self.field.along(self.path.evaluate(samples)), LEAST)
        rates = np.abs(self.path.evaluate(samples, 1))
        if self.robot.planar is not None:
            sway = self.delay_s * self.robot.planar.sway(rates)
        else:  # of whatever moves most, against the least clearance
            sway, clear = self.delay_s * largest_sway(self.robot, rates)[:, None], clear.min(axis=1, keepdims=True)
        with np.errstate(divide="ignore"):
            ceiling = (self.fraction * clear / sway).min(axis=1)
        tight = np.flatnonzero(ceiling < self._fastest(samples))
        result = np.full(len(grid), np.inf)
        # A sample holds at both ends of its interval, and as far as the averages reach from there.
        reach = ceiling * self.averaged_s
        first = np.searchsorted(grid, samples - reach, side="right") - 1
        last = np.searchsorted(grid, samples + reach, side="left")
        for sample in tight.tolist():
            part = slice(max(first[sample], 0), last[sample] + 1)
            result[part] = np.minimum(result[part], ceiling[sample])
        return result

    def _fastest(self, samples: FloatArray) -> FloatArray:
        """(n,) path speeds that the joints' velocity limits do not let pass."""
        rates = np.maximum(np.abs(self.path.evaluate(samples, 1)), 1e-300)
        fastest: FloatArray = (self.robot.velocity_limit / rates).min(axis=1)
        return fastest


def averaging_s(limits: Limits, rate_hz: float) -> float:
    """Longest time before and after a row that its averages reach over [s] (`hplan.timing.retime`)."""
    moves = limits.acceleration > 0.0
    window = 0.0 if limits.jerk is None else float((limits.acceleration[moves] / limits.jerk[moves]).max(initial=0.0))
    return window + 1.0 / rate_hz
