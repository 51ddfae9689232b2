"""How far the arm reaches from a base that moves, over the whole of its track."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, Record
from hplan.scene.tracks import Poses, Track


@dataclass(frozen=True, eq=False)
class SweptReach(Record):
    """A ball that is carried along a track.

    Attributes:
        centres: (k, 3) its centre at some times, where the base has no shift [m].
        radius: Radius of balls about them that hold all that it sweeps [m].
    """

    centres: FloatArray
    radius: float

    @classmethod
    def of(cls, ball: FloatArray, track: Track) -> SweptReach:
        """Of a (4,) ball about something of the base, centre and radius [m], and the track of the base."""
        poses = Poses.of(track)
        offset = ball[:3] - poses.about
        # The centre travels no farther than this between two times of the track.
        travel = np.linalg.norm(np.diff(poses.shifts, axis=0), axis=1)
        travel += np.linalg.norm(poses.turns, axis=1) * np.linalg.norm(offset)
        # Spacing of the places along a track at which the reach is taken [m], or of so many of them where that is more.
        spacing_m, most_places = 0.05, 4096
        parts = np.maximum(np.ceil(travel / max(spacing_m, float(travel.sum()) / most_places)), 1.0)
        spans = zip(poses.times[:-1], poses.times[1:], parts.astype(int).tolist(), strict=True)
        clock = np.concatenate([np.linspace(*span, endpoint=False) for span in spans] + [poses.times[-1:]])
        rotations, places = poses.at(clock)
        # Between two of these places it is no farther from one of them than half of what it travels.
        return cls(places + rotations @ offset, float(ball[3] + 0.5 * (travel / parts).max()))

    def ball_seen_from(self, rotation: FloatArray, shift: FloatArray) -> FloatArray:
        """(4,) a ball about all that is swept, as the base sees it from a pose [m]."""
        seen = (self.centres - shift) @ rotation
        middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
        return np.append(middle, self.radius + np.linalg.norm(seen - middle, axis=1).max())

    def comes_near(self, points: FloatArray, distance: float) -> BoolArray:
        """(n,) whether some ball may come within a distance of (n, 3) points, where the base has no shift [m]."""
        from scipy.spatial import KDTree

        near, _ = KDTree(self.centres).query(points, distance_upper_bound=self.radius + distance)
        found: BoolArray = np.isfinite(near)
        return found
