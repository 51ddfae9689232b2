r"""Motion of an obstacle: tracks (piecewise linear poses), drift (bounded error of a track), sway (oscillation).

A track is defined from the first to the last of its times. Before and after, the obstacle keeps its first and its last
pose. Times count from the start of the motion.

**Relative to the base.** A point :math:`x` of a solid, as listed in the scene, is at
:math:`y = T_b(t)^{-1} T_o(t) x` at time :math:`t`: transformed by its own track, and seen from a base with its own
track. Let :math:`c` be a point of the solid, :math:`r` the radius about :math:`c` that contains the solid, :math:`r_o`
the solid's maximum distance from its track's centre of rotation, :math:`p` the base's centre of rotation at that time,
and :math:`v, \omega` speeds. Then

.. math:: |\dot y| \le |v_o - v_b| + \omega_o r_o + \omega_b (\max |T_o c - p| + r),

with the maximum over an interval between times of either track. Velocities and angular speeds are constant in it. The
distance :math:`|T_o c - p|` is at most the distance of two linearly moving points, the solid's centre of rotation
:math:`a` and :math:`p`, which is maximal at an end of the interval, plus :math:`|c - a|`.

**Drift.** An obstacle that is predicted, not controlled, is shifted from its track at time :math:`t` by at most

.. math:: \rho(t) = r + v (t - t_0) + \tfrac{1}{2} a (t - t_0)^2.

At the track's first time :math:`t_0` its position was known within :math:`r` and its velocity within :math:`v`; since
then its acceleration has differed from the track's by at most :math:`a`. Distances are reduced by the piecewise linear
interpolation of :math:`\rho`, which is nowhere smaller since :math:`\rho` is convex, and its slopes are added to the
speeds above. After the track's last time nothing is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Annotated, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from hplan.base.arrays import FloatArray, Record, frozen, readonly
from hplan.base.checked import StrictModel, fault
from hplan.errors import OptionError
from hplan.geometry.rotation import rpy_rotation
from hplan.scene.limits import FARTHEST_M, LONGEST_S, MOST_TRACK_POINTS, Angles, Size, Vector

Time: TypeAlias = Annotated[float, Field(ge=-LONGEST_S, le=LONGEST_S)]

#: A bound of a drift, in SI units.
Bound: TypeAlias = Annotated[float, Field(ge=0.0, le=FARTHEST_M)]

#: Maximum excess of a drift's piecewise linear bound [m], and maximum number of its pieces.
_CHORD_M, _MOST_PIECES = 1e-3, 200


class Drift(StrictModel):
    """Bound of an obstacle's distance from its track, growing from the first time of the track.

    The obstacle is predicted up to the last time of its track; no motion is certified for longer.

    Attributes:
        radius_m: Maximum error of the position at the first time of the track [m].
        speed_m_s: Maximum error of the velocity at that time [m/s].
        acceleration_m_s2: Maximum difference of the acceleration from the track's at all later times [m/s^2].

    Examples:
        >>> from hplan.scene import Drift
        >>> Drift(radius_m=0.01, speed_m_s=0.1, acceleration_m_s2=2.0).spread_after(0.5)
        0.31
    """

    radius_m: Bound = 0.0
    speed_m_s: Bound = 0.0
    acceleration_m_s2: Bound = 0.0

    def spread_after(self, time_s: float) -> float:
        """Return the maximum distance from the track a time after its first time [m]."""
        return self.radius_m + time_s * (self.speed_m_s + 0.5 * time_s * self.acceleration_m_s2)


class Track(StrictModel):
    """Pose of an obstacle over time, relative to its listed pose.

    A listed point x of the obstacle is at `about + shift + R (x - about)`. Between two times the shift is linear, and
    the rotation has a fixed axis and constant speed, along the smaller angle.

    Attributes:
        times_s: Two or more increasing times from the start of the motion [s].
        shifts_m: Shift at each time [m].
        rpy_deg: Rotation at each time, by roll, pitch and yaw about the fixed axes x, y, z [deg]; None for no rotation.
        about: Centre of rotation at the listed pose [m]; required with `rpy_deg`, else None.
        drift: Bound of the distance from this track; None if the obstacle follows it exactly.

    Examples:
        >>> from hplan.scene import Track
        >>> track = Track(times_s=(0.0, 2.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
        >>> rotation, shift = track.pose_at(0.5)
        >>> shift.tolist()
        [0.0, 0.25, 0.0]
    """

    times_s: Annotated[tuple[Time, ...], Field(min_length=2, max_length=MOST_TRACK_POINTS)]
    shifts_m: tuple[Vector, ...]
    rpy_deg: tuple[Angles, ...] | None = None
    about: Vector | None = None
    drift: Annotated[Drift | None, Field(exclude=True)] = None  # digests of exact tracks are those of earlier versions

    @model_validator(mode="after")
    def _is_a_track(self) -> Track:
        for number, (first, second) in enumerate(pairwise(self.times_s), start=1):
            if not second > first:
                raise fault(f"times must increase: {second:g} s follows {first:g} s", "times_s", number)
        for key in ("shifts_m", "rpy_deg"):
            values = getattr(self, key)
            if values is not None and len(values) != len(self.times_s):
                raise fault(f"expected one for each of {len(self.times_s)} times (got {len(values)})", key)
        if (self.rpy_deg is None) != (self.about is None):
            given, missing = ("about", "rpy_deg") if self.rpy_deg is None else ("rpy_deg", "about")
            raise fault(f"this key is missing: {missing} is required with {given}", given)
        turns = () if self.rpy_deg is None else rotation_vectors(self.rotations)
        for number, turn in enumerate(turns, start=1):
            # Obstacles rotate along the smaller angle; near 180 degrees its direction is ambiguous.
            if not np.linalg.norm(turn) <= math.radians(179.0):
                raise fault(
                    "it turns by 180 degrees between two times: give an orientation between them", "rpy_deg", number
                )
        return self

    @property
    def rotations(self) -> FloatArray:
        """(n, 3, 3) rotations at the times."""
        if self.rpy_deg is None:
            return np.tile(np.eye(3), (len(self.times_s), 1, 1))
        return np.array([rpy_rotation(*map(math.radians, angles)) for angles in self.rpy_deg])

    def pose_at(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """Return rotation and shift at a time.

        A listed point x is at R x + s, with R the (3, 3) rotation and s the (3,) shift [m]. For the track of a base, a
        point at x relative to the base is listed at R x + s.
        """
        poses = Poses.from_track(self)
        rotations, places = poses.poses_at(np.array([time_s]))
        shift: FloatArray = places[0] - rotations[0] @ poses.about
        return rotations[0], shift

    def starting_at(self, time_s: float) -> Track:
        """Return the track with its times counted from `time_s` on [s].

        Raises:
            OptionError: A time would be out of range, or two times would coincide.
        """
        times = tuple(time - time_s for time in self.times_s)
        if not (all(abs(time) <= LONGEST_S for time in times) and all(a < b for a, b in pairwise(times))):
            expected = (
                f"a time within {LONGEST_S:g} s of all times of tracks, which must stay distinct floating-point numbers"
            )
            raise OptionError("time_s", time_s, expected)
        return self.copy_unchecked({"times_s": times})


class Sway(StrictModel):
    """Oscillation of an obstacle along a line, to either side.

    The arm keeps its clearance from the swept volume.

    Attributes:
        direction: Direction of the line, of any nonzero length.
        amplitude_m: Maximum distance from the listed position [m].

    Examples:
        >>> from hplan.scene import Capsule, Sway
        >>> sway = Sway(direction=(0.0, 2.0, 0.0), amplitude_m=0.05)
        >>> sway.reach.tolist()
        [0.0, 0.05, 0.0]
        >>> branch = Capsule(name="branch 1", start=(1.0, 0.0, 1.5), end=(1.3, 0.0, 1.6), radius=0.01, sway=sway)
        >>> len(branch.solids[0].core) > len(branch.core)
        True
    """

    direction: Vector
    amplitude_m: Size

    @model_validator(mode="after")
    def _has_a_direction(self) -> Sway:
        if not math.hypot(*self.direction) > 0.0:
            raise fault("expected a direction, not zero", "direction")
        return self

    @property
    def reach(self) -> FloatArray:
        """(3,) shift to one end of the oscillation [m]."""
        direction = np.array(self.direction)
        direction /= np.abs(direction).max()  # avoids underflow of the squares
        return readonly(self.amplitude_m / np.linalg.norm(direction) * direction)


@dataclass(frozen=True, eq=False)
class Poses(Record):
    """Piecewise linear shift and piecewise constant rotation speed over time.

    Attributes:
        times: (n,) times [s].
        shifts: (n, 3) shifts [m].
        rotations: (n, 3, 3) rotations.
        about: (3,) centre of rotation before the shift [m].
        drift: Bound of the distance from these poses; None for exact ones.
    """

    times: FloatArray
    shifts: FloatArray
    rotations: FloatArray
    about: FloatArray
    drift: Drift | None = None

    @classmethod
    def from_track(cls, track: Track | None) -> Poses:
        """Return the poses of a track; None for a static object."""
        if track is None:
            return cls(np.zeros(2), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.zeros(3))
        about = np.zeros(3) if track.about is None else np.array(track.about)
        return cls(np.array(track.times_s), np.array(track.shifts_m), track.rotations, about, track.drift)

    @cached_property
    def turns(self) -> FloatArray:
        """(n - 1, 3) rotation vectors between successive rotations [rad]."""
        if (self.rotations == self.rotations[:1]).all():
            return frozen(np.zeros((len(self.times) - 1, 3)))
        return frozen(rotation_vectors(self.rotations))

    @cached_property
    def spreads(self) -> tuple[FloatArray, FloatArray]:
        """Times [s] and maximum distances from these poses [m] at them, linear between; without a drift none."""
        if self.drift is None:
            return np.zeros(0), np.zeros(0)
        span_s = float(self.times[-1] - self.times[0])
        # The chord of rho over a step h exceeds it by at most a h^2 / 8.
        pieces = math.ceil(span_s * math.sqrt(self.drift.acceleration_m_s2 / (8.0 * _CHORD_M)))
        times = np.linspace(self.times[0], self.times[-1], min(max(1, pieces), _MOST_PIECES) + 1)
        after = (times - self.times[0]).tolist()
        return frozen(times), frozen(np.array([self.drift.spread_after(time) for time in after]))

    def poses_at(self, clock: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations and centres of rotation at times.

        Args:
            clock: (k,) times [s].

        Returns:
            (k, 3, 3) rotations and (k, 3) positions of the centre of rotation [m].
        """
        piece = np.clip(np.searchsorted(self.times, clock, side="right") - 1, 0, len(self.times) - 2)
        begin, span = self.times[piece], self.times[piece + 1] - self.times[piece]
        part = np.clip((clock - begin) / np.where(span > 0.0, span, 1.0), 0.0, 1.0)[:, None]
        places = self.about + self.shifts[piece] + part * (self.shifts[piece + 1] - self.shifts[piece])
        if not self.turns.any():
            return self.rotations[piece], places
        return self.rotations[piece] @ _rotations(part * self.turns[piece]), places

    def speeds(self, clock: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return velocities of the centre of rotation and angular speeds.

        Args:
            clock: (k,) times, different from `times` [s].

        Returns:
            (k, 3) velocities [m/s] and (k,) angular speeds [rad/s].
        """
        if self.times[0] == self.times[-1]:  # static, as the base nearly always is
            return np.zeros((len(clock), 3)), np.zeros(len(clock))
        piece = np.clip(np.searchsorted(self.times, clock) - 1, 0, len(self.times) - 2)
        span = self.times[piece + 1] - self.times[piece]
        moves = (clock > self.times[0]) & (clock < self.times[-1])
        rate = np.where(moves, 1.0 / np.where(span > 0.0, span, 1.0), 0.0)
        velocity = rate[:, None] * (self.shifts[piece + 1] - self.shifts[piece])
        return velocity, rate * np.linalg.norm(self.turns[piece], axis=1)


@dataclass(frozen=True, eq=False)
class Movement(Record):
    """Motion of an obstacle relative to the base.

    Attributes:
        own: Motion of the obstacle.
        base: Motion of the base.
    """

    own: Poses
    base: Poses

    @classmethod
    def relative_to(cls, track: Track | None, base_track: Track | None) -> Movement:
        """Return the movement of a track relative to the base's track."""
        return cls(Poses.from_track(track), Poses.from_track(base_track))

    @cached_property
    def breaks(self) -> FloatArray:
        """(m,) times of possible speed changes; static before and after [s]."""
        return frozen(np.unique(np.concatenate([self.own.times, self.base.times, self.own.spreads[0]])))

    @property
    def known_until_s(self) -> float:
        """Time until which the obstacle is predicted; inf without a drift [s]."""
        return math.inf if self.own.drift is None else float(self.own.times[-1])

    def spread_at(self, clock: FloatArray) -> FloatArray:
        """(k,) maximum distances from the poses of `displacement_at` at (k,) times [m]."""
        times, spreads = self.own.spreads
        return np.interp(clock, times, spreads) if len(times) else np.zeros(len(clock))

    def displacement_at(self, clock: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations and shifts at times.

        A point x is at R x + s at each time.

        Args:
            clock: (k,) times [s].

        Returns:
            (k, 3, 3) rotations R and (k, 3) shifts s [m].
        """
        rotation, place = self.own.poses_at(clock)
        seen, pivot = self.base.poses_at(clock)
        back = np.swapaxes(seen, 1, 2)
        shift = place - rotation @ self.own.about - pivot
        return back @ rotation, (back @ shift[:, :, None])[:, :, 0] + self.base.about

    def rates(self, core: FloatArray, rounding: float) -> FloatArray:
        """Upper bounds of a solid's point speeds between `breaks`, growth of the drift included [m/s].

        Args:
            core: (k, 3) points of the listed solid [m].
            rounding: Radius about them [m].

        Returns:
            (m - 1,) bounds.
        """
        middle = 0.5 * (self.breaks[:-1] + self.breaks[1:])
        (velocity, turning), (base_velocity, base_turning) = self.own.speeds(middle), self.base.speeds(middle)
        rates: FloatArray = np.linalg.norm(velocity - base_velocity, axis=1)
        if self.own.drift is not None:
            times, spreads = self.own.spreads
            piece = np.searchsorted(times, middle)
            rates = rates + np.concatenate([[0.0], np.diff(spreads) / np.diff(times), [0.0]])[piece]
        if turning.any():
            rates = rates + turning * (np.linalg.norm(core - self.own.about, axis=1).max() + rounding)
        if base_turning.any():
            centre = 0.5 * (core.min(axis=0) + core.max(axis=0))
            radius = np.linalg.norm(core - centre, axis=1).max() + rounding
            if turning.any():
                # The solid rotates about `about`, which moves linearly; no point of the solid is farther from it.
                centre, radius = self.own.about, np.linalg.norm(core - self.own.about, axis=1).max() + rounding
            offset = self.own.poses_at(self.breaks)[0] @ (centre - self.own.about)
            apart = np.linalg.norm(
                self.own.poses_at(self.breaks)[1] + offset - self.base.poses_at(self.breaks)[1], axis=1
            )
            rates = rates + base_turning * (np.maximum(apart[:-1], apart[1:]) + radius)
        return rates


def rotation_vectors(rotations: FloatArray) -> FloatArray:
    """Rotation vectors between successive rotations [rad].

    Args:
        rotations: (n, 3, 3) rotations.

    Returns:
        (n - 1, 3) vectors, axis times angle, each in the frame of the earlier rotation.
    """
    from scipy.spatial.transform import Rotation

    between: FloatArray = Rotation.from_matrix(np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]).as_rotvec()
    return between


def _rotations(vectors: FloatArray) -> FloatArray:
    """(k, 3, 3) rotations of (k, 3) rotation vectors."""
    from scipy.spatial.transform import Rotation

    rotations: FloatArray = Rotation.from_rotvec(vectors).as_matrix()
    return rotations
