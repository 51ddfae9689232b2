"""Converts the points of a depth camera to balls as obstacles.

A frame's points are transformed to `base_link` at the time of the frame. Then points are removed in this order: rows
that are not finite or mean no return; points that the arm cannot come near at any configuration, anywhere on its base's
track; points of the arm itself as it was at the time of the frame; and points of ignored objects. The remaining points
are binned into voxels; each voxel becomes one point, the centre of its points' bounding box, and all balls grow by the
maximum distance of a point from its voxel's point. So every remaining point, with a ball of the requested radius, is
inside a ball of the result. All removed points are counted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hplan.base.arguments import instance, number
from hplan.base.arrays import FloatArray, Record, as_array, frozen, numbers, readonly
from hplan.base.checked import Options
from hplan.base.units import FARTHEST_JOINT
from hplan.collision.compiled_obstacles import solid_rows
from hplan.collision.motion_coefficients import tight_reach_ball
from hplan.errors import InputError, OptionError
from hplan.geometry.rotation import rpy_rotation
from hplan.online.arm_shape import SweptReach, arm_solids
from hplan.online.body_distances import Bodies, distances_from_bodies
from hplan.online.frame_kernels import (
    COUNT_COLUMN,
    FAR,
    IGNORED,
    MIDDLE,
    NO_RETURN,
    NOT_FINITE,
    OF_ARM,
    OUT_OF_REACH,
    Placement,
    Scratch,
    mark_isolated,
    middles,
)
from hplan.online.hidden_points import hidden
from hplan.robot.model import Robot
from hplan.scene.limits import FARTHEST_M
from hplan.scene.obstacle_kind import Convex, Solid
from hplan.scene.tracks import Track

_Length: TypeAlias = Annotated[float, Field(ge=0.0, le=FARTHEST_M)]


@dataclass(frozen=True)
class CloudOptions(Options):
    """Options for converting camera frames into obstacles.

    Attributes:
        growth_m: Maximum growth of a ball that merges several points; the voxels' edge is 1.15 times that [m].
        arm_padding_m: Points within this distance of the arm are removed as its own if the joints are given: noise,
            calibration error and motion of the arm since then [m]. Points farther away are never removed as the arm's.
            An obstacle within it is not detected, and only kept if it was seen before (`keep_s`).
        ignore_padding_m: Points within this distance of an ignored object are left out, even if they belong to other
            objects: use the sensor's maximum error and no more [m]. A branch within it is not detected, and no
            certificate covers it.
        reach_margin_m: Points farther from all positions of the arm than this plus the required clearance are left out
            [m]. Reported distances are correct up to there.
        least_points: Points with fewer points than this in their neighbourhood, themselves included, are left out as
            outliers; 1 leaves out none. This also removes thin or far objects if the camera's pixel spacing is too
            large for it.
        neighbour_m: Radius of that neighbourhood: any point with `least_points` points within it remains [m]. Three
            times the pixel spacing on the objects to be detected is a good choice.
        most_remembered: Maximum number of hidden points that are kept; the oldest are dropped first.
        unseen_edge_m: Edge of the voxels of unknown space, if that is solid (`hplan.online.seen_space`); the value of
            the first frame is used [m].
        allow_empty: Accept a frame that leaves no obstacle although no ignored point is visible either, because the
            camera may see nothing within range. Otherwise such a frame is refused, and the obstacles of the last one
            stay.
        max_lost: Acceptable loss of returns, as a share of the returns in earlier frames of the cloud: a frame with
            fewer is refused. With `allow_empty`, 1 accepts frames without any return, for example of the sky.
        max_age_s: Age limit for plans that rely on the frame; None for no limit [s].
        known_free: Shapes of space known to be free without being seen, if unknown space is solid, for example the lane
            that the machine has driven in: they free the voxels whose centres they contain. Meshes and clouds are not
            accepted.
    """

    growth_m: Annotated[float, Field(ge=1e-4, le=1.0)] = 5e-3
    arm_padding_m: _Length = 0.03
    ignore_padding_m: _Length = 0.02
    reach_margin_m: _Length = 0.1
    least_points: Annotated[int, Field(ge=1)] = 1
    neighbour_m: _Length = 0.02
    most_remembered: Annotated[int, Field(ge=0)] = 100_000
    unseen_edge_m: Annotated[float, Field(ge=1e-3, le=1.0)] = 0.05
    allow_empty: bool = False
    max_lost: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    max_age_s: Annotated[float, Field(ge=0.0)] | None = None
    known_free: tuple[Convex, ...] = ()


@dataclass(frozen=True)
class FrameReport:
    """Numbers of points and balls from a frame, by outcome.

    Attributes:
        given: Points of the frame.
        not_finite: Rows with a value that is not finite.
        no_return: Rows (0, 0, 0) in the camera's frame, which depth cameras write for pixels without a return.
        out_of_reach: Points that the arm cannot come near.
        of_arm: Points of the arm itself.
        ignored: Points of ignored objects.
        isolated: Points with too few neighbours.
        kept: Balls that represent the remaining points.
        remembered: Balls kept from earlier frames because they are hidden now.
        forgotten: Hidden points dropped because there were too many.
        growth_m: Growth of all balls due to merged points [m].
        radius_m: Radius of the balls, growth included [m].
        far: Points out of range that are more than 100 m from the camera.
    """

    given: int
    not_finite: int
    no_return: int
    out_of_reach: int
    of_arm: int
    ignored: int
    isolated: int
    kept: int
    remembered: int
    forgotten: int
    growth_m: float
    radius_m: float
    far: int


@dataclass(frozen=True, eq=False)
class Frame(Record):
    """A validated frame.

    Attributes:
        points: (n, 3) points in the camera's frame, float32 or float64; any of them may be not finite [m].
        radius: Radius of the ball around each point [m].
        rotation: (3, 3) camera to `base_link`.
        position: (3,) position of the camera [m].
        joints: (dof,) configuration of the arm at the time of the frame; None to remove no points of the arm.
        keep_s: Hidden points are remembered this long [s].
        time_s: Time of the frame [s].
        base_track: Motion of the base; None for a fixed base. The points are seen from the base at `time_s`, and listed
            at zero displacement of the base, like obstacles of a scene.
    """

    points: FloatArray
    radius: float
    rotation: FloatArray
    position: FloatArray
    joints: FloatArray | None = None
    keep_s: float = 0.0
    time_s: float = 0.0
    base_track: Track | None = None

    @classmethod
    def validate(
        cls,
        robot: Robot,
        points: ArrayLike,
        *,
        radius: float,
        pose: ArrayLike | None = None,
        joints: ArrayLike | None = None,
        keep_s: float = 0.0,
        time_s: float = 0.0,
        base_track: Track | None = None,
    ) -> Frame:
        """Validate the parts of a frame; the arguments are the attributes.

        Args:
            points: (n, 3), or (rows, columns, 3); no points are allowed.
            pose: Camera to `base_link`: a (4, 4) matrix, or six numbers, x, y, z [m] and roll, pitch, yaw about fixed
                axes [deg]; None if the points are in `base_link`.

        Raises:
            InputError: Points, pose or joints are invalid; for example the pose is not a rigid transform.
            OptionError: `radius` is not positive, or a time is invalid.
        """
        rotation, position = rigid(pose)
        return cls(
            points=_check_points(points),
            radius=number("radius", radius, f"a number of metres > 0 and <= {FARTHEST_M:g}", _is_size),
            rotation=rotation,
            position=position,
            joints=None if joints is None else numbers("joints", joints, (robot.dof,), most=FARTHEST_JOINT),
            keep_s=number("keep_s", keep_s, "a number of seconds >= 0", lambda value: value >= 0.0),
            time_s=number("time_s", time_s, "a number of seconds"),
            base_track=base_track,
        )

    def list_points(self, points: FloatArray) -> FloatArray:
        """(n, 3) listed positions of points in the base frame [m]."""
        if self.base_track is None:
            return points
        rotation, shift = self.base_track.pose_at(self.time_s)
        found: FloatArray = points @ rotation.T + shift
        return found

    def to_base(self, points: FloatArray) -> FloatArray:
        """(n, 3) base-frame positions of listed points [m]."""
        if self.base_track is None:
            return points
        rotation, shift = self.base_track.pose_at(self.time_s)
        found: FloatArray = np.ascontiguousarray((points - shift) @ rotation)
        return found


@dataclass(frozen=True, eq=False)
class SeenPoints(Record):
    """Points seen in earlier frames.

    Attributes:
        points: (n, 3) listed positions in `base_link` [m].
        seen_s: (n,) time of each point's last sighting [s].
        growth_m: Growth of their balls: the maximum over their frames [m].
        time_s: Time of the last frame [s].
        radius: Radius of the last frame's balls, without growth [m].
        kept_m: The minimum `FilteredFrame.kept_m` of their frames [m].
    """

    points: FloatArray = field(default_factory=lambda: readonly(np.zeros((0, 3))))
    seen_s: FloatArray = field(default_factory=lambda: readonly(np.zeros(0)))
    growth_m: float = 0.0
    time_s: float = -math.inf
    radius: float = 0.0
    kept_m: float = math.inf

    def growth_with(self, radius: float) -> float:
        """Growth for balls of another radius that preserves these points' balls [m]."""
        return self.growth_m + max(0.0, self.radius - radius)


@dataclass(frozen=True, eq=False)
class FilteredFrame(Record):
    """Remaining points of a frame and of the frames before it.

    Attributes:
        points: (n, 3) centres of the balls, listed positions in `base_link` [m].
        report: Numbers of points by outcome.
        seen: Input for the next frame.
        kept_m: All balls are present that the arm can come this near to [m].
    """

    points: FloatArray
    report: FrameReport
    seen: SeenPoints
    kept_m: float


def filter_frame(
    robot: Robot,
    frame: Frame,
    options: CloudOptions,
    *,
    ignored: Sequence[Solid] = (),
    clearance_m: float = 0.0,
    before: SeenPoints | None = None,
    scratch: Scratch | None = None,
) -> FilteredFrame:
    """Reduce a frame to the balls of its obstacles.

    Args:
        ignored: Solids whose points are left out.
        clearance_m: Required clearance of the arm; it extends the range of relevant points [m].
        before: Points seen in earlier frames; None for the first frame.
        scratch: Buffers shared with earlier frames; None to allocate new ones.

    Raises:
        OptionError: The voxels are far too small.
    """
    instance("options", options, CloudOptions)
    before = SeenPoints() if before is None else before
    reach, swept = _relevant_balls(robot, frame, options, clearance_m)
    placement = _placement(frame, options, reach)
    arm = Bodies(*solid_rows([] if frame.joints is None else arm_solids(robot, frame.joints), options.arm_padding_m))
    left_out = Bodies(*solid_rows(ignored, options.ignore_padding_m))
    scratch = Scratch() if scratch is None else scratch
    voxels, staying, in_voxel, tally = scratch.put_into_voxels(frame.points, placement, arm, left_out)
    isolated = np.zeros(len(voxels), dtype=np.bool_)
    if options.least_points > 1:
        mark_isolated(voxels, placement, options.least_points, options.neighbour_m, isolated)
    points, growth_m = middles(staying, in_voxel, voxels, isolated)
    if swept is not None:
        # The ball around the swept volume is larger than the volume; a point is within this distance of its voxel's
        # point.
        near = swept.comes_near(frame.list_points(points), growth_m)
        tally[OUT_OF_REACH] += int(voxels[~isolated, COUNT_COLUMN][~near].sum())
        points = points[near]
    kept = len(points)
    old, forgotten = SeenPoints(), 0
    if frame.keep_s > 0.0 and len(before.points):
        old, forgotten = _still_hidden(frame, before, (arm, left_out), options)
        growth_m = max(growth_m, old.growth_m)
        points = np.concatenate([points, old.points])
    points = frozen(frame.list_points(points))
    seen_s = np.concatenate([np.full(kept, frame.time_s), old.seen_s])
    report = FrameReport(
        given=len(frame.points),
        not_finite=int(tally[NOT_FINITE]),
        no_return=int(tally[NO_RETURN]),
        out_of_reach=int(tally[OUT_OF_REACH]),
        of_arm=int(tally[OF_ARM]),
        ignored=int(tally[IGNORED]),
        isolated=int(voxels[isolated, COUNT_COLUMN].sum()),
        kept=kept,
        remembered=len(old.points),
        forgotten=forgotten,
        growth_m=growth_m,
        radius_m=frame.radius + growth_m,
        far=int(tally[FAR]),
    )
    kept_m = clearance_m + options.reach_margin_m
    if frame.keep_s == 0.0:
        return FilteredFrame(points, report, SeenPoints(), kept_m)
    kept_m = min(kept_m, before.kept_m)
    seen = SeenPoints(points, frozen(seen_s), growth_m, frame.time_s, frame.radius, kept_m)
    return FilteredFrame(points, report, seen, kept_m)


def _still_hidden(
    frame: Frame, before: SeenPoints, bodies: tuple[Bodies, Bodies], options: CloudOptions
) -> tuple[SeenPoints, int]:
    """Points seen before and hidden now, and the number of dropped points.

    A point that the arm's padding hides remains, unless the arm is in its ball: then it is gone.
    """
    arm, ignored = bodies
    young = frame.time_s - before.seen_s <= frame.keep_s
    points, seen_s = frame.to_base(np.compress(young, before.points, axis=0)), before.seen_s[young]
    growth_m = before.growth_with(frame.radius)
    stands_in = frame.radius + growth_m - options.arm_padding_m
    from_arm = distances_from_bodies(points, arm.rows, arm.data, max(stands_in, 0.0))
    unseen = hidden(points, frame.points, (frame.rotation, frame.position)) | (from_arm <= 0.0)
    unseen &= from_arm > stands_in
    unseen &= distances_from_bodies(points, ignored.rows, ignored.data, 0.0) > 0.0
    points, seen_s = np.compress(unseen, points, axis=0), seen_s[unseen]
    forgotten = max(0, len(points) - options.most_remembered)
    if forgotten:
        latest = np.sort(np.argsort(-seen_s, kind="stable")[: options.most_remembered])
        points, seen_s = points[latest], seen_s[latest]
    return SeenPoints(points, seen_s, growth_m, before.time_s), forgotten


def _relevant_balls(
    robot: Robot, frame: Frame, options: CloudOptions, clearance_m: float
) -> tuple[FloatArray, SweptReach | None]:
    """Ball of relevant points in the base frame, and the swept ball.

    (4,) centre and radius [m]; the swept ball is None for a fixed base.
    """
    reach = tight_reach_ball(robot).copy()
    reach[3] += frame.radius + options.growth_m + options.reach_margin_m + clearance_m
    if frame.base_track is None:
        return reach, None
    swept = SweptReach.sweep(reach, frame.base_track)
    return swept.ball_seen_from(*frame.base_track.pose_at(frame.time_s)), swept


def _placement(frame: Frame, options: CloudOptions, reach: FloatArray) -> Placement:
    # Half the diagonal of a voxel with this edge is the allowed growth.
    edge = np.array([2.0 * options.growth_m / math.sqrt(3.0)])
    if not reach[3] < (MIDDLE - 2) * edge[0]:
        least = 0.5 * math.sqrt(3.0) * float(reach[3]) / (MIDDLE - 2)
        raise OptionError("growth_m", options.growth_m, f"more than {least:.3g} m for a reach of {reach[3]:.3g} m")
    return Placement(frame.rotation, frame.position, reach, edge)


def _is_size(value: float) -> bool:
    return 0.0 < value <= FARTHEST_M


def _check_points(points: ArrayLike) -> Any:
    """(n, 3) float32 or float64 points, contiguous and read-only."""
    expected = "(n, 3) or (rows, columns, 3) numbers"
    try:
        array = as_array(points)
    except ValueError as error:
        raise InputError(f"points: expected {expected}, got rows of different lengths", option="points") from error
    if array.size == 0 and array.ndim <= 1:
        array = np.zeros((0, 3))
    if array.dtype.kind not in "fiu":
        raise InputError(f"points: expected {expected}, got {array.dtype}", option="points")
    if array.ndim not in (2, 3) or array.shape[-1] != 3:
        raise InputError(f"points has shape {array.shape}, expected {expected}", option="points")
    # Maximum number of points in a frame.
    most_frame_points = 20_000_000
    if array.size > 3 * most_frame_points:
        raise InputError(f"points: {array.size // 3:,} exceed the maximum of {most_frame_points:,}", option="points")
    kind = array.dtype if array.dtype in (np.float32, np.float64) else np.float64
    with np.errstate(over="ignore"):  # Longer floats may overflow.
        found = np.ascontiguousarray(array.reshape(-1, 3), dtype=kind).view()
    found.setflags(write=False)  # Kernels are compiled for one array type.
    return found


def rigid(pose: ArrayLike | None) -> tuple[FloatArray, FloatArray]:
    """Rotation and position of a pose.

    Raises:
        InputError: `pose` is not a rigid transform.
    """
    if pose is None:
        return readonly(np.eye(3)), readonly(np.zeros(3))
    try:
        listed = as_array(pose).shape == (6,)
    except ValueError:
        listed = False
    if listed:
        x, y, z, *angles = numbers("pose", pose, (6,)).tolist()
        return readonly(rpy_rotation(*map(math.radians, angles))), readonly([x, y, z])
    matrix = numbers("pose", pose, (4, 4))
    rotation = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # Products of huge numbers are inf or NaN.
        off, volume = float(np.abs(rotation @ rotation.T - np.eye(3)).max()), float(np.linalg.det(rotation))
    # Tolerance of a rotation matrix.
    most = 1e-5
    if not (off <= most and volume > 0.0) or np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max() > most:
        raise InputError(
            "pose is not a rigid transform: expected a rotation and a translation, [[R, p], [0, 0, 0, 1]], or x, y, z, "
            f"roll, pitch, yaw; R R^T differs from the identity by {off:.3g}, det R is {volume:.3g}",
            option="pose",
        )
    return readonly(rotation), readonly(matrix[:3, 3])
