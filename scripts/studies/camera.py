"""Certified motions among trees from frames of a depth camera.

Rays are cast into a scene's true solids. A pinhole camera looks along its z axis, x to the right and y down. Every
pixel has one ray, through its center; a frame is an organized cloud, row by row, with NaN for pixels without a return
in range. Depths have noise with a standard deviation proportional to their square, and a fraction of all returns are
outliers. The arm is in the picture as the capsules of its links and the hulls of turret and pedestal.

The planner knows the floor and the arm's state; wood and fruit it knows from frames alone. It plans a motion to each of
a few stand-offs of fruits with `ROOM_M`, first with the first frame, and again with every new frame: the same picture
with other noise. The clock starts with the array and ends with the certified motion, or with a failure within
`DEADLINE_S`. Balls are as large as the gaps between pixels, and outliers are searched within three of these; but no
smaller than `RADIUS_M` and `NEAR_M`.

With `--values around=COUNT` that number of points is drawn on wood and fruit from all sides, as by several cameras.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from studies.harness import Asked, Row, Study
from studies.measure import or_error, timed
from studies.trees import DISTANCES, Orchard, crop_of, measured_orchard, shipped_orchards

from hplan.base.arrays import FloatArray
from hplan.collision.clearance_field import ClearanceField
from hplan.errors import HplanError
from hplan.geometry.hull import Hull
from hplan.online.arm_shape import arm_solids
from hplan.online.frame import CloudOptions
from hplan.online.planner import Planner
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Solid, Sphere

#: Returns of a frame, about; frames of each motion, the first one among them, and motions in each orchard.
SIZES, FRAMES, GOALS = (10_000, 100_000, 300_000, 1_000_000), 4, 4

#: Minimum radius of the ball around each point, and minimum distance within which a point needs neighbours [m].
RADIUS_M, NEAR_M = 5e-3, 8e-3

#: A point with fewer about it, itself counted, is an outlier.
LEAST_POINTS = 3

#: Clearance of a goal from true wood and fruit [m], and how long a plan may take [s].
ROOM_M, DEADLINE_S = 0.03, 1.0

#: Number of random configurations for timing distance queries.
_LOOKS = 300

#: Position of the camera and a point on its axis [m], its horizontal angle of view [deg], range of depths [m], the
#: standard deviation of a depth of 1 m [m], the fraction of outliers, and the assumed distance of the trees [m].
POSITION, TARGET, VIEW_DEG, RANGE_M = (-0.35, 0.5, 1.7), (1.4, 0.0, 0.9), 87.0, (0.1, 6.0)
SIGMA_M, OUTLIERS, TREES_M = 2e-3, 0.02, 1.5

#: Standard deviation of a coordinate of a point that is drawn on wood [m].
AROUND_SIGMA_M = 5e-3


class DepthCamera:
    """A static pinhole depth camera next to the arm, above the shoulder."""

    def __init__(self, pixels: int, solids: Sequence[Solid]) -> None:
        """Cast its rays: about `pixels`, three wide to two high."""
        self.width = round(math.sqrt(1.5 * pixels))
        height = round(pixels / self.width)
        along = np.subtract(TARGET, POSITION) / np.linalg.norm(np.subtract(TARGET, POSITION))
        right = np.cross(along, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        self.pose = np.eye(4)
        self.pose[:3, :3], self.pose[:3, 3] = np.column_stack([right, np.cross(along, right), along]), POSITION
        focal = 0.5 * self.width / math.tan(math.radians(0.5 * VIEW_DEG))
        x, y = ((np.arange(count) + 0.5 - 0.5 * count) / focal for count in (self.width, height))
        self._rays = np.stack([*np.meshgrid(x, y), np.ones((height, self.width))], axis=-1).reshape(-1, 3)
        self._depth = depths(self._rays, self.pose, solids)
        self._depth[self._depth > RANGE_M[1]] = np.inf

    @property
    def spacing_m(self) -> float:
        """Distance between neighbouring pixels' rays at the assumed distance of the trees [m]."""
        return 2.0 * TREES_M * math.tan(math.radians(0.5 * VIEW_DEG)) / self.width

    @property
    def seen(self) -> float:
        """Fraction of the pixels that have something within range."""
        return float(np.isfinite(self._depth).mean())

    def frame(self, random: np.random.Generator) -> NDArray[np.float32]:
        """(pixels, 3) points in the camera's frame [m]; NaN out of range."""
        depth = np.where(np.isfinite(self._depth), self._depth, np.nan)
        depth += random.normal(size=depth.shape) * SIGMA_M * depth**2
        strays = np.isfinite(depth) & (random.random(depth.shape) < OUTLIERS)
        depth[strays] = random.uniform(*RANGE_M, int(strays.sum()))
        return (self._rays * depth[:, None]).astype(np.float32)


class PointsAround:
    """Noisy points on balls and capsules without caps, as a camera.

    Attributes:
        pose: None: the points are in `base_link`.
        spacing_m: Mean distance of neighbours [m].
    """

    pose = None

    def __init__(self, count: int, solids: Sequence[Solid]) -> None:
        """Prepare frames with `count` points."""
        round_ones = [solid for solid in solids if isinstance(solid, Sphere | Capsule)]
        self._ends = np.array([solid.core[[0, -1]] for solid in round_ones])
        self._radii = np.array([solid.rounding for solid in round_ones])
        lengths = np.linalg.norm(np.diff(self._ends, axis=1), axis=2)[:, 0]
        areas = 2.0 * np.pi * self._radii * (lengths + 2.0 * self._radii)
        self._count, self._shares = count, areas / areas.sum()
        self.spacing_m = math.sqrt(areas.sum() / count)

    def frame(self, random: np.random.Generator) -> NDArray[np.float32]:
        """(count, 3) points, solid by solid [m]."""
        which = np.sort(random.choice(len(self._radii), self._count, p=self._shares))
        start, along = self._ends[which, 0], self._ends[which, 1] - self._ends[which, 0]
        out = random.normal(size=start.shape)
        square = np.maximum((along**2).sum(axis=1), 1e-12)
        out -= ((out * along).sum(axis=1) / square)[:, None] * along
        out *= (self._radii[which] / np.linalg.norm(out, axis=1))[:, None]
        noise = random.normal(0.0, AROUND_SIGMA_M, start.shape)
        points: NDArray[np.float32] = (start + random.random((self._count, 1)) * along + out + noise).astype(np.float32)
        return points


def ground(size_m: float = 12.0) -> Box:
    """A floor."""
    return Box(name="ground", center=(0.0, 0.0, -0.05), size=(size_m, size_m, 0.1))


def depths(rays: FloatArray, pose: FloatArray, solids: Sequence[Solid]) -> FloatArray:
    """(n,) depths of the first intersections of (n, 3) rays with solids.

    The solids are balls, capsules, boxes and hulls; inf without an intersection.
    """
    rotation, position = pose[:3, :3], pose[:3, 3]
    best = np.full(len(rays), np.inf)
    for solid in solids:
        core = (solid.core - position) @ rotation
        middle = 0.5 * (core.min(axis=0) + core.max(axis=0))
        radius = float(np.linalg.norm(core - middle, axis=1).max()) + getattr(solid, "rounding", 0.0)
        # Only check rays that pass through a bounding ball.
        along = rays @ middle
        square = (rays**2).sum(axis=1)
        near = np.flatnonzero((middle @ middle - radius**2) * square <= np.maximum(along, radius) ** 2)
        if not len(near):
            continue
        if isinstance(solid, Sphere | Capsule):
            depth = _capsule_depths(rays[near], core[0], core[-1], solid.rounding)
        else:
            planes = _planes(solid)
            planes = np.column_stack([planes[:, :3] @ rotation, planes[:, 3] - planes[:, :3] @ position])
            depth = _hull_depths(rays[near], planes)
        best[near] = np.fmin(best[near], np.where(depth > RANGE_M[0], depth, np.inf))
    return best


def _planes(solid: Solid) -> FloatArray:
    """(k, 4) outward normals of the faces of a box or hull and their offsets."""
    if isinstance(solid, Hull):
        return solid.planes
    if not isinstance(solid, Box):
        raise TypeError(f"a camera sees no {type(solid).__name__}")
    normals = np.concatenate([solid.rotation.T, -solid.rotation.T])
    return np.column_stack([normals, normals @ np.array(solid.center) + 0.5 * np.tile(solid.size, 2)])


def _capsule_depths(rays: FloatArray, start: FloatArray, end: FloatArray, radius: float) -> FloatArray:
    """(n,) depths of the first hits of a capsule."""
    axis, square = end - start, (rays**2).sum(axis=1)
    best = np.full(len(rays), np.inf)
    with np.errstate(invalid="ignore", divide="ignore"):
        for place in (start, end):
            along = rays @ place
            depth = (along - np.sqrt(along**2 - square * (place @ place - radius**2))) / square
            best = np.fmin(best, np.where(depth > 0.0, depth, np.inf))
        uu, turned = axis @ axis, rays @ axis
        if uu > 0.0:
            a = uu * square - turned**2
            b, c = turned * (start @ axis) - uu * (rays @ start), uu * (start @ start - radius**2) - (start @ axis) ** 2
            depth = (-b - np.sqrt(b * b - a * c)) / a
            share = depth * turned - start @ axis
            best = np.fmin(best, np.where((share >= 0.0) & (share <= uu) & (depth > 0.0), depth, np.inf))
    return best


def _hull_depths(rays: FloatArray, planes: FloatArray) -> FloatArray:
    """(n,) entry depths of rays into a hull; inf for none."""
    enter, leave = np.full(len(rays), -np.inf), np.full(len(rays), np.inf)
    for *normal, offset in planes:
        slope = rays @ np.array(normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = offset / slope
        enter = np.where(slope < 0.0, np.maximum(enter, at), enter)
        leave = np.where(slope > 0.0, np.minimum(leave, at), leave)
        leave = np.where((slope == 0.0) & (offset < 0.0), -np.inf, leave)
    return np.where((enter > 0.0) & (enter <= leave), enter, np.inf)


def _problems(asked: Asked) -> Iterable[tuple[Orchard, int, bool]]:
    robot = asked.arm()
    orchards = shipped_orchards(robot)
    if asked.trees is not None:
        orchards += [measured_orchard(robot, file, DISTANCES[0]) for file in sorted(asked.trees.glob("*.csv"))]
    around = asked.values.get("around", ())
    sizes = [(int(size), False) for size in asked.values.get("sizes", () if around else SIZES)]
    sizes += [(int(size), True) for size in around]
    return [(orchard, *size) for size in sizes for orchard in orchards][: asked.count]


def _frames(asked: Asked, problem: tuple[Orchard, int, bool]) -> list[Row]:
    """All frames of one size before one orchard, or of points around its wood."""
    (orchard, size, around), robot = problem, asked.arm()
    q, truth = orchard.scene.start.configuration, orchard.scene.solids_with_goal
    in_view = [*truth, ground(), *arm_solids(robot, q)]
    field, random = ClearanceField.of(robot, truth), np.random.default_rng([asked.seed, size])
    room_m = ROOM_M - 1e-6  # many are as far from their fruit, but for rounding
    goals = [goal for goal in crop_of(robot, orchard)[0].values() if field.clearance(goal) > room_m][:GOALS]
    camera: DepthCamera | PointsAround
    if around:
        camera = PointsAround(size, truth)
    else:
        camera = DepthCamera(math.ceil(size / DepthCamera(10_000, in_view).seen), in_view)
    rows = list[Row]()
    for number, goal in enumerate(goals):
        watch = _Watch(robot, orchard.scene.start, goal, camera)
        for frame in range(FRAMES):
            row = watch.take(camera.frame(random))
            found = watch.planner.last if row["certified"] else None
            least = None if found is None else 1e3 * float(field.along(found.trajectory.position).min())
            name = f"{orchard.name}, {size}{' around' * around}, goal {number}, frame {frame}"
            first = row["ms"] if not frame and found else None
            told = {"name": name, "size": f"{size:,}{' around' * around}", "first_ms": first}
            later = row["ms"] if frame and found else None
            rows.append(
                row
                | told
                | {"later_ms": later, "true_clearance_mm": least, "touches": None if least is None else least < 0.0}
            )
            rows[-1]["query_us"] = _query_us(robot, watch.planner.scene, random)
    return rows


class _Watch:
    """A planner that goes to one goal and takes frames of one camera."""

    def __init__(self, robot: Robot, start: Start, goal: FloatArray, camera: DepthCamera | PointsAround) -> None:
        there = Goal(joints_rad=tuple(goal.tolist()))
        scene = Scene(name="camera", start=start, goal=there, obstacles=(ground(),))
        self.planner = Planner(robot, scene, PlanOptions(effort="quick", deadline_s=DEADLINE_S))
        self._camera, self._q = camera, start.configuration
        gap = camera.spacing_m
        self._radius = max(RADIUS_M, gap / math.sqrt(2.0))
        self._options = CloudOptions(least_points=LEAST_POINTS, neighbour_m=max(NEAR_M, 3.0 * gap))

    def take(self, points: Any) -> Row:
        """Numbers of one frame."""
        pose, q = self._camera.pose, self._q
        set_cloud = partial(self.planner.set_cloud, "seen", points, pose=pose, joints=q, ignore=("ground",))
        report, filter_ms = timed(lambda: set_cloud(radius=self._radius, options=self._options))
        _, structure_ms = timed(lambda: self.planner.scene.solids)
        found, plan_ms = timed(lambda: or_error(self.planner.replan))
        certified = not isinstance(found, HplanError)
        return {
            "certified": certified,
            "returns": report.given - report.not_finite,
            "balls": report.kept,
            "filter_ms": filter_ms,
            "structure_ms": structure_ms,
            "plan_ms": plan_ms,
            "ms": filter_ms + structure_ms + plan_ms,
        }


def _query_us(robot: Robot, scene: Scene, random: np.random.Generator) -> float:
    """Time of the distances of all links at one configuration, among the balls alone [us]."""
    field = ClearanceField.of(robot, [solid for solid in scene.solids if solid.name == "seen"])
    looks = random.uniform(robot.lower, robot.upper, (_LOOKS, robot.dof))
    field.along(looks[:10])
    return 1e3 * timed(lambda: field.along(looks))[1] / _LOOKS


CAMERA = Study(
    "camera",
    "frames of a depth camera to certified motions; touches: true wood, of which the camera sees one side",
    _frames,
    (
        *("certified", "returns", "balls", "later_ms", "first_ms", "filter_ms", "structure_ms", "plan_ms"),
        *("touches", "query_us"),
    ),
    problems=_problems,
    by="size",
    count=(None, 1),
)
