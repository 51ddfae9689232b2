"""Time-optimal path speed on a parameter grid, and its motion.

toppra enforces the limits at grid points (`hplan.trajectory.topp`). The grid is refined wherever the path bends sharply
between two of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.errors import OptionError
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.limits import GeometricPath, Limits
from hplan.trajectory.cubics import sample_spline

#: Maximum number of grid points of longer motions; this many take a tenth of a second.
MOST_GRID_POINTS = 4000

#: A path on which no joint moves farther than this is empty [rad].
EMPTY_PATH = 1e-7

#: Maximum number of samples of a motion; this many take 0.2 GB.
MOST_ROWS = 400_000

#: If samples exceed a limit by more than `LITTLE`, grid intervals around them are split into `_SPLIT`, at most
#: `_MOST_REFINEMENTS` times, unless they are shorter than `_SHORTEST_INTERVAL` as a fraction of the path.
LITTLE, _SPLIT, _MOST_REFINEMENTS, _SHORTEST_INTERVAL = 0.01, 4, 6, 1e-7


def check_row_count(rows: float, duration: float, rate_hz: float) -> None:
    """Refuse a motion of too many samples, before they are made.

    Args:
        rows: Number of samples; may be infinite or NaN.
        duration: Duration of the motion [s].
        rate_hz: Samples per second.

    Raises:
        OptionError: There are more than `MOST_ROWS`.
    """
    if not rows <= MOST_ROWS:
        raise OptionError(
            "rate_hz",
            round(rate_hz, 9),
            f"at most {MOST_ROWS:,} samples, but the motion of {duration:.4g} s would have {rows:,.0f}: "
            "use a lower rate or a higher speed",
        )


def parameter_grid(path: GeometricPath, points: int) -> FloatArray:
    """Path parameters, denser towards the ends, including the pieces' break points.

    From rest the parameter grows with the square of time; cosine spacing makes the first intervals as short in time as
    the others.
    """
    last = float(path.breaks[-1])
    inner = path.breaks[(path.breaks > 0.0) & (path.breaks < last)]
    spaced = 0.5 * last * (1.0 - np.cos(np.linspace(0.0, np.pi, points)))
    if len(inner) == 0:
        return spaced
    # Spaced points close to a piece's end are dropped in favour of it, so that few intervals become very short.
    following = np.searchsorted(inner, spaced)
    nearest = np.minimum(
        np.abs(spaced - inner[np.minimum(following, len(inner) - 1)]),
        np.abs(spaced - inner[np.maximum(following - 1, 0)]),
    )
    kept = nearest > 0.3 * np.gradient(spaced)
    kept[[0, -1]] = True
    grid: FloatArray = np.union1d(spaced[kept], inner)
    return grid


@dataclass(frozen=True, eq=False)
class SpeedProfile:
    """Time-optimal motion along a path, in continuous time.

    The path speed is linear in time between grid points; before the first and after the last the arm is at rest.

    Attributes:
        path: The path.
        grid: (n,) path parameters.
        speed: (n,) path speeds ds/dt at the grid points.
        arrival: (n,) times at the grid points [s].
    """

    path: GeometricPath
    grid: FloatArray
    speed: FloatArray
    arrival: FloatArray

    @classmethod
    def compute(cls, path: GeometricPath, dynamics: InverseDynamics, limits: Limits, grid: FloatArray) -> SpeedProfile:
        """Compute the profile with toppra, from rest to rest."""
        from hplan.trajectory.topp import fastest_speed

        return cls.from_speed(path, grid, fastest_speed(path, dynamics, limits, grid))

    @classmethod
    def from_speed(cls, path: GeometricPath, grid: FloatArray, speed: FloatArray) -> SpeedProfile:
        """Build the profile from the path speed at the grid points."""
        # The path acceleration is constant between grid points, so each interval takes 2 ds / (sum of its speeds).
        durations = 2.0 * np.diff(grid) / (speed[:-1] + speed[1:])
        return cls(path, grid, speed, np.concatenate([[0.0], np.cumsum(durations)]))

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.arrival[-1])

    def positions(self, clock: FloatArray) -> FloatArray:
        """(k, dof) configurations at (k,) times [s]."""
        time = np.clip(clock, 0.0, self.arrival[-1])
        interval = np.clip(np.searchsorted(self.arrival, time, side="right") - 1, 0, len(self.arrival) - 2)
        since = time - self.arrival[interval]
        durations = self.arrival[interval + 1] - self.arrival[interval]
        acceleration = (self.speed[interval + 1] - self.speed[interval]) / durations
        parameter = self.grid[interval] + since * (self.speed[interval] + 0.5 * acceleration * since)
        return np.array(self.path.evaluate(parameter))

    @cached_property
    def ends(self) -> FloatArray:
        """(2, dof) configurations at both ends of the path."""
        return self.path.evaluate(np.array([0.0, self.path.breaks[-1]]))


def refine(profile: SpeedProfile, dynamics: InverseDynamics, limits: Limits, period: float) -> SpeedProfile:
    """Refine the grid wherever samples between grid points exceed a limit.

    toppra enforces the limits at the grid points. If the path bends sharply between two of them, samples in between may
    exceed a limit many times over; slowing the whole motion down for these few samples would waste time.
    """
    for _ in range(_MOST_REFINEMENTS):
        over = _rows_over(profile, dynamics, limits, period)
        if len(over) == 0 or len(profile.grid) > MOST_GRID_POINTS:
            return profile
        # Each sample's control points average over a period on either side.
        first = np.searchsorted(profile.arrival, over - 1.5 * period, side="right") - 1
        last = np.searchsorted(profile.arrival, over + 1.5 * period, side="left")
        split = np.zeros(len(profile.grid) - 1, dtype=np.bool_)
        for low, high in zip(np.maximum(first, 0).tolist(), last.tolist(), strict=True):
            split[low:high] = True
        at = np.flatnonzero(split & (np.diff(profile.grid) > _SHORTEST_INTERVAL * profile.grid[-1]))
        if len(at) == 0:
            return profile
        inner = profile.grid[at, None] + np.diff(profile.grid)[at, None] * (np.arange(1, _SPLIT) / _SPLIT)
        grid = np.union1d(profile.grid, inner)
        profile = SpeedProfile.compute(profile.path, dynamics, limits, grid)
    return profile


def _rows_over(profile: SpeedProfile, dynamics: InverseDynamics, limits: Limits, period: float) -> FloatArray:
    """Times of samples that exceed a limit by more than `LITTLE` [s]."""
    steps = int(np.ceil(profile.arrival[-1] / period)) + 1
    if steps > MOST_ROWS:
        return np.empty(0)
    clock = np.arange(-1, steps + 1, dtype=np.float64) * period
    control = profile.positions(clock)
    change = np.diff(control, axis=0) / period
    _, velocity, acceleration = sample_spline(control, period)
    moves = np.ptp(control, axis=0) > EMPTY_PATH
    fast = np.any(np.abs(change[:, moves]) > (1.0 + LITTLE) * limits.velocity[moves], axis=1)
    over = np.any(np.abs(acceleration[:, moves]) > (1.0 + LITTLE) ** 2 * limits.acceleration[moves], axis=1)
    over |= fast[1:] | fast[:-1]
    if limits.torque is not None:
        torque = dynamics.torques(control[1:-1], velocity, acceleration)
        over |= np.any(np.abs(torque) > (1.0 + LITTLE) * limits.torque, axis=1)
    found: FloatArray = clock[1:-1][over]
    return found
