r"""How an obstacle moves: its track, a pose that is piecewise linear in time; and its sway, an amplitude along a line.

A track holds from the first of its times to the last. Before and after, the obstacle stays as it is at the first and at
the last. Times count from the begin of the motion.

**Seen from the base.** A point :math:`x` of a solid, as the scene lists it, is at :math:`y = T_b(t)^{-1} T_o(t) x` at
time :math:`t`: moved by its own track, and seen from a base that moves by its own. With :math:`c` a point of the solid,
all of which is within :math:`r` of it, :math:`r_o` its largest distance from the point about which its track turns it,
:math:`p` the point about which the base turns, where it is then, and :math:`v, \omega` speeds,

.. math:: |\dot y| \le |v_o - v_b| + \omega_o r_o + \omega_b (\max |T_o c - p| + r),

the maximum over an interval between times of either track. Velocities and angular speeds are constant in it; the
distance :math:`|T_o c - p|` is at most that of points moved linearly, :math:`a`, about which the solid turns, from
:math:`p`, which is largest at an end of it, and :math:`|c - a|`.
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
from hplan.errors import OptionError
from hplan.scene.fault import StrictModel, fault
from hplan.scene.limits import LONGEST_S, MOST_TRACK_POINTS, Angles, Size, Vector
from hplan.scene.solids import rpy_rotation

Time: TypeAlias = Annotated[float, Field(ge=-LONGEST_S, le=LONGEST_S)]


class Track(StrictModel):
    """A pose over time: a shift, and a turn about a point, from where the obstacle is listed.

    A point x of the obstacle is at `about + shift + R (x - about)`. Between two times the shift is linear, and the turn
    is about one axis at constant speed, by the smaller angle.

    Attributes:
        times_s: Two or more times from the begin of the motion, increasing [s].
        shifts_m: The shift at each of them [m].
        rpy_deg: The turn at each, by roll, pitch and yaw about the fixed axes x, y, z [deg]; None for none.
        about: The point about which it turns, where the obstacle is listed [m]; given with `rpy_deg`, and only then.
    """

    times_s: Annotated[tuple[Time, ...], Field(min_length=2, max_length=MOST_TRACK_POINTS)]
    shifts_m: tuple[Vector, ...]
    rpy_deg: tuple[Angles, ...] | None = None
    about: Vector | None = None

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
            raise fault(f"this key is missing: {missing}, for {given} is given", given)
        for number, turn in enumerate(rotation_vectors(self.rotations), start=1):
            # Obstacles turn by the smaller angle; of a larger turn the sense would not be clear.
            if not np.linalg.norm(turn) <= math.radians(179.0):
                raise fault("it turns by 180 degrees between two times: give one between", "rpy_deg", number)
        return self

    @property
    def rotations(self) -> FloatArray:
        """(n, 3, 3) rotations at the times."""
        if self.rpy_deg is None:
            return np.tile(np.eye(3), (len(self.times_s), 1, 1))
        return np.array([rpy_rotation(*map(math.radians, angles)) for angles in self.rpy_deg])

    def pose_at(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """(3, 3) rotation R and (3,) shift s at a time: a point that is listed at x is at R x + s [m].

        Of the track of a base, a point that it sees at x is listed at R x + s.
        """
        poses = Poses.of(self)
        rotations, places = poses.at(np.array([time_s]))
        shift: FloatArray = places[0] - rotations[0] @ poses.about
        return rotations[0], shift

    def since(self, time_s: float) -> Track:
        """The track with its times counted from a time on [s].

        Raises:
            OptionError: Times would be too far off, or two of them the same number.
        """
        times = tuple(time - time_s for time in self.times_s)
        if not (all(abs(time) <= LONGEST_S for time in times) and all(a < b for a, b in pairwise(times))):
            expected = f"a time from which the times of tracks are within {LONGEST_S:g} s, and apart as numbers"
            raise OptionError("time_s", time_s, expected)
        return self.copy_unchecked({"times_s": times})


class Sway(StrictModel):
    """How far an obstacle may swing out of its place along a line, to either side: what it sweeps is kept clear.

    Attributes:
        direction: Direction of the line, of any length but zero.
        amplitude_m: How far it may be from its place along the line [m].
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
        """(3,) shift to one of the ends of the swing [m]."""
        direction = np.array(self.direction)
        direction /= np.abs(direction).max()  # so that the squares of small numbers do not vanish
        return readonly(self.amplitude_m / np.linalg.norm(direction) * direction)


@dataclass(frozen=True, eq=False)
class Poses(Record):
    """A pose over time: piecewise linear shift, turns about a point at piecewise constant speed.

    Attributes:
        times: (n,) times [s].
        shifts: (n, 3) shifts [m].
        rotations: (n, 3, 3) rotations.
        about: (3,) the point about which it turns, before the shift [m].
    """

    times: FloatArray
    shifts: FloatArray
    rotations: FloatArray
    about: FloatArray

    @classmethod
    def of(cls, track: Track | None) -> Poses:
        """The poses of a track; of none those of what stands still."""
        if track is None:
            return cls(np.zeros(2), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.zeros(3))
        about = np.zeros(3) if track.about is None else np.array(track.about)
        return cls(np.array(track.times_s), np.array(track.shifts_m), track.rotations, about)

    @cached_property
    def turns(self) -> FloatArray:
        """(n - 1, 3) rotation vectors from each rotation to the next."""
        return frozen(rotation_vectors(self.rotations))

    def at(self, clock: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k, 3, 3) rotations and (k, 3) places of the point about which it turns, at (k,) times."""
        piece = np.clip(np.searchsorted(self.times, clock, side="right") - 1, 0, len(self.times) - 2)
        begin, span = self.times[piece], self.times[piece + 1] - self.times[piece]
        part = np.clip((clock - begin) / np.where(span > 0.0, span, 1.0), 0.0, 1.0)[:, None]
        places = self.about + self.shifts[piece] + part * (self.shifts[piece + 1] - self.shifts[piece])
        if not self.turns.any():
            return self.rotations[piece], places
        return self.rotations[piece] @ _rotations(part * self.turns[piece]), places

    def speeds(self, clock: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k, 3) velocities of that point [m/s] and (k,) angular speeds [rad/s] at (k,) times, none of them `times`."""
        piece = np.clip(np.searchsorted(self.times, clock) - 1, 0, len(self.times) - 2)
        span = self.times[piece + 1] - self.times[piece]
        moves = (clock > self.times[0]) & (clock < self.times[-1])
        rate = np.where(moves, 1.0 / np.where(span > 0.0, span, 1.0), 0.0)
        velocity = rate[:, None] * (self.shifts[piece + 1] - self.shifts[piece])
        return velocity, rate * np.linalg.norm(self.turns[piece], axis=1)


@dataclass(frozen=True, eq=False)
class Movement(Record):
    """How an obstacle moves as seen from the base.

    Attributes:
        own: How it moves.
        base: How the base moves.
    """

    own: Poses
    base: Poses

    @classmethod
    def of(cls, track: Track | None, base_track: Track | None) -> Movement:
        """The movement by a track, seen from a base that has one."""
        return cls(Poses.of(track), Poses.of(base_track))

    @cached_property
    def breaks(self) -> FloatArray:
        """(m,) times at which speeds may change [s]; before the first and after the last nothing moves."""
        return frozen(np.unique(np.concatenate([part.times for part in (self.own, self.base)])))

    def at(self, clock: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(k, 3, 3) rotations R and (k, 3) shifts s at (k,) times: a point x is at R x + s [m]."""
        rotation, place = self.own.at(clock)
        seen, pivot = self.base.at(clock)
        back = np.swapaxes(seen, 1, 2)
        shift = place - rotation @ self.own.about - pivot
        return back @ rotation, (back @ shift[:, :, None])[:, :, 0] + self.base.about

    def rates(self, core: FloatArray, rounding: float) -> FloatArray:
        """(m - 1,) bounds of the speed of any point of a solid between the `breaks` [m/s].

        Args:
            core: (k, 3) points of the solid where the scene lists it [m].
            rounding: Radius about them [m].
        """
        middle = 0.5 * (self.breaks[:-1] + self.breaks[1:])
        (velocity, turning), (base_velocity, base_turning) = self.own.speeds(middle), self.base.speeds(middle)
        rates: FloatArray = np.linalg.norm(velocity - base_velocity, axis=1)
        if turning.any():
            rates = rates + turning * (np.linalg.norm(core - self.own.about, axis=1).max() + rounding)
        if base_turning.any():
            centre = 0.5 * (core.min(axis=0) + core.max(axis=0))
            radius = np.linalg.norm(core - centre, axis=1).max() + rounding
            if turning.any():
                # The solid turns about `about`: that point moves linearly, and nothing is farther from it than this.
                centre, radius = self.own.about, np.linalg.norm(core - self.own.about, axis=1).max() + rounding
            offset = self.own.at(self.breaks)[0] @ (centre - self.own.about)
            apart = np.linalg.norm(self.own.at(self.breaks)[1] + offset - self.base.at(self.breaks)[1], axis=1)
            rates = rates + base_turning * (np.maximum(apart[:-1], apart[1:]) + radius)
        return rates


def rotation_vectors(rotations: FloatArray) -> FloatArray:
    """(n - 1, 3) turns from each of (n, 3, 3) rotations to the next, in the frame of the first: axis times angle."""
    from scipy.spatial.transform import Rotation

    between: FloatArray = Rotation.from_matrix(np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]).as_rotvec()
    return between


def _rotations(vectors: FloatArray) -> FloatArray:
    """(k, 3, 3) rotations by (k, 3) rotation vectors."""
    from scipy.spatial.transform import Rotation

    rotations: FloatArray = Rotation.from_rotvec(vectors).as_matrix()
    return rotations
