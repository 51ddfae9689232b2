"""The arm as solids for camera models, and its workspace."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin

from hplan.base.arrays import BoolArray, FloatArray, Record
from hplan.collision.collision_bodies import GROUND, collision_bodies
from hplan.collision.compiled_obstacles import convex_solid
from hplan.robot.model import Robot
from hplan.scene.obstacle_kind import transform_solid
from hplan.scene.obstacles import Solid
from hplan.scene.tracks import Poses, Track


@dataclass(frozen=True, eq=False)
class SweptReach(Record):
    """A ball that is carried along a track.

    Attributes:
        centres: (k, 3) its centre at some times, in `base_link` at zero displacement of the base [m].
        radius: Radius of the balls around them that contain everything it sweeps [m].
    """

    centres: FloatArray
    radius: float

    @classmethod
    def sweep(cls, ball: FloatArray, track: Track) -> SweptReach:
        """Sweep a ball fixed to the base along a track.

        `ball` is (4,), centre and radius [m].
        """
        poses = Poses.from_track(track)
        offset = ball[:3] - poses.about
        # Upper bound of the centre's travel between two times of the track.
        travel = np.linalg.norm(np.diff(poses.shifts, axis=0), axis=1)
        travel += np.linalg.norm(poses.turns, axis=1) * np.linalg.norm(offset)
        # Spacing of the samples along a track [m], and their maximum number, which may enlarge the spacing.
        spacing_m, most_places = 0.05, 4096
        parts = np.maximum(np.ceil(travel / max(spacing_m, float(travel.sum()) / most_places)), 1.0)
        spans = zip(poses.times[:-1], poses.times[1:], parts.astype(int).tolist(), strict=True)
        clock = np.concatenate([np.linspace(*span, endpoint=False) for span in spans] + [poses.times[-1:]])
        rotations, places = poses.poses_at(clock)
        # Between two samples it is within half of its travel of one of them.
        return cls(places + rotations @ offset, float(ball[3] + 0.5 * (travel / parts).max()))

    def ball_seen_from(self, rotation: FloatArray, shift: FloatArray) -> FloatArray:
        """(4,) a ball around the swept volume [m].

        In the frame of the base at a pose.
        """
        seen = (self.centres - shift) @ rotation
        middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
        return np.append(middle, self.radius + np.linalg.norm(seen - middle, axis=1).max())

    def comes_near(self, points: FloatArray, distance: float) -> BoolArray:
        """(n,) mask of the points that the ball may come near.

        Points are (n, 3), in `base_link` at zero displacement of the base [m].
        """
        from scipy.spatial import KDTree

        near, _ = KDTree(self.centres).query(points, distance_upper_bound=self.radius + distance)
        found: BoolArray = np.isfinite(near)
        return found


def arm_solids(robot: Robot, q: FloatArray) -> tuple[Solid, ...]:
    """Collision bodies of a robot at a (dof,) configuration.

    Each body's solid is cached and only its pose is changed.
    """
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    found = []
    for number, body in enumerate(collision_bodies(robot)):
        make = partial(convex_solid, body.name, body.core, body.rounding)
        solid = robot.cache(("body_solid", number), make)
        if body.joint != GROUND:
            place = data.oMi[body.joint + 1]
            solid = transform_solid(solid, place.rotation, place.translation)
        found.append(solid)
    return tuple(found)
