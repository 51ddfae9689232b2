"""Certified motions among trees from frames of a simulated depth camera.

A pinhole camera looks along its z axis, x to the right and y down. MuJoCo casts one ray through the center of each
pixel; a pixel without a return in range is NaN. Depths have noise with a standard deviation proportional to their
square, and a fraction of the returns are outliers. The arm is in the picture.

The planner knows the floor and the state of the arm; wood and fruit are in the frames only. It plans to some stand-offs
of fruits with `CLEAR_M`, with the first frame and again with every new one: the same picture with other noise. The
clock runs from the array to the certified motion, or to a failure within `DEADLINE_S`. Balls are as large as the gaps
between pixels, and the outlier filter searches within three of these, but at least `RADIUS_M` and `NEAR_M`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from studies.harness import Row, Study, StudyConfig
from studies.measure import or_error, timed
from studies.trees import DISTANCES, Orchard, crop_of, measured_orchard, shipped_orchards

from hplan.apps.execution.simulated_arm import SimulatedArm
from hplan.base.arrays import FloatArray
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import HplanError
from hplan.online.frame import CloudOptions
from hplan.online.planner import Planner
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene
from hplan.scene.obstacles import Box

#: Approximate returns of a frame; frames of each motion, and motions in each orchard.
SIZES, FRAMES, GOALS = (10_000, 100_000, 300_000, 1_000_000), 4, 4

#: Minimum radius of the ball around each point, minimum search distance of the outlier filter [m], and the minimum
#: number of points within it, the point included.
RADIUS_M, NEAR_M, LEAST_POINTS = 5e-3, 8e-3, 3

#: Clearance of a goal from true wood and fruit [m], and the time limit of a plan [s].
CLEAR_M, DEADLINE_S = 0.03, 1.0

#: Number of random configurations at which distance queries are timed.
_QUERIES = 300

#: Position of the camera and a point on its axis [m], its horizontal angle of view [deg], range of depths [m], the
#: standard deviation of a depth of 1 m [m], the fraction of outliers, and the assumed distance of the trees [m].
POSITION, TARGET, VIEW_DEG, RANGE_M = (-0.35, 0.5, 1.7), (1.4, 0.0, 0.9), 87.0, (0.1, 6.0)
SIGMA_M, OUTLIERS, TREES_M = 2e-3, 0.02, 1.5

#: The floor.
GROUND = Box(name="ground", center=(0.0, 0.0, -0.05), size=(12.0, 12.0, 0.1))


class DepthCamera:
    """A static pinhole depth camera next to the arm, above the shoulder."""

    def __init__(self, pixels: int, simulation: SimulatedArm) -> None:
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
        distance, _ = simulation.cast_rays(POSITION, self._rays @ self.pose[:3, :3].T)
        self._depth = distance / np.linalg.norm(self._rays, axis=1)
        self._depth[(self._depth < RANGE_M[0]) | (self._depth > RANGE_M[1])] = np.nan

    @property
    def spacing_m(self) -> float:
        """Distance between neighbouring pixels' rays at the assumed distance of the trees [m]."""
        return 2.0 * TREES_M * math.tan(math.radians(0.5 * VIEW_DEG)) / self.width

    @property
    def seen(self) -> float:
        """Fraction of the pixels with a return."""
        return float(np.isfinite(self._depth).mean())

    def frame(self, random: np.random.Generator) -> NDArray[np.float32]:
        """(pixels, 3) points in the camera's frame [m]; NaN without a return."""
        depth = self._depth + random.normal(size=self._depth.shape) * SIGMA_M * self._depth**2
        strays = np.isfinite(depth) & (random.random(depth.shape) < OUTLIERS)
        depth[strays] = random.uniform(*RANGE_M, int(strays.sum()))
        points: NDArray[np.float32] = (self._rays * depth[:, None]).astype(np.float32)
        return points


def _problems(config: StudyConfig) -> Iterable[tuple[Orchard, int]]:
    robot = config.arm()
    orchards = shipped_orchards(robot)
    if config.trees is not None:
        orchards += [measured_orchard(robot, file, DISTANCES[0]) for file in sorted(config.trees.glob("*.csv"))]
    sizes = map(int, config.values.get("sizes", SIZES))
    return [(orchard, size) for size in sizes for orchard in orchards][: config.count]


def _frames(config: StudyConfig, problem: tuple[Orchard, int]) -> list[Row]:
    """All frames of one size in front of one orchard."""
    (orchard, size), robot = problem, config.arm()
    home, truth = orchard.scene.start.configuration, orchard.scene.solids_with_goal
    # The goal of the simulated scene must not be a fruit, which the simulation would leave out.
    stay = Goal(joints_rad=tuple(home.tolist()))
    simulation = SimulatedArm(robot, orchard.scene.with_values(goal=stay, obstacles=(*orchard.scene.obstacles, GROUND)))
    simulation.place(home)
    camera = DepthCamera(math.ceil(size / DepthCamera(10_000, simulation).seen), simulation)
    field, random = ClearanceField.build(robot, truth), np.random.default_rng([config.seed, size])
    least_m = CLEAR_M - 1e-6  # many goals have exactly this clearance, up to rounding
    goals = [goal for goal in crop_of(robot, orchard)[0].values() if field.spare_clearance(goal) > least_m][:GOALS]
    rows = list[Row]()
    for number, goal in enumerate(goals):
        scene = Scene(name="camera", start=orchard.scene.start, goal=Goal(joints_rad=tuple(goal.tolist())),
                      obstacles=(GROUND,))  # fmt: skip
        planner = Planner(robot, scene, PlanOptions(effort="quick", deadline_s=DEADLINE_S))
        for frame in range(FRAMES):
            row = _plan(planner, camera, camera.frame(random), home)
            found = planner.last if row["certified"] else None
            true_m = None if found is None else float(field.spare_clearances(found.trajectory.position).min())
            rows.append(row | {
                "name": f"{orchard.name}, {size}, goal {number}, frame {frame}",
                "size": f"{size:,}",
                "first_ms": row["ms"] if found and not frame else None,
                "later_ms": row["ms"] if found and frame else None,
                "true_clearance_mm": None if true_m is None else 1e3 * true_m,
                "touches": None if true_m is None else true_m < 0.0,
                "query_us": _query_us(robot, planner.scene, random),
            })  # fmt: skip
    return rows


def _plan(planner: Planner, camera: DepthCamera, points: Any, q: FloatArray) -> Row:
    """Pass a frame to the planner and plan; the measurements."""
    gap = camera.spacing_m
    options = CloudOptions(least_points=LEAST_POINTS, neighbour_m=max(NEAR_M, 3.0 * gap))
    set_cloud = partial(planner.set_cloud, "seen", points, pose=camera.pose, joints=q, ignore=("ground",))
    report, filter_ms = timed(lambda: set_cloud(radius=max(RADIUS_M, gap / math.sqrt(2.0)), options=options))
    _, structure_ms = timed(lambda: planner.scene.solids)
    found, plan_ms = timed(lambda: or_error(planner.replan))
    return {
        "certified": not isinstance(found, HplanError),
        "returns": report.given - report.not_finite,
        "balls": report.kept,
        "filter_ms": filter_ms,
        "structure_ms": structure_ms,
        "plan_ms": plan_ms,
        "ms": filter_ms + structure_ms + plan_ms,
    }


def _query_us(robot: Robot, scene: Scene, random: np.random.Generator) -> float:
    """CPU time of the distances of all links from the balls at one configuration [us]."""
    field = ClearanceField.build(robot, [solid for solid in scene.solids if solid.name == "seen"])
    q = random.uniform(robot.lower, robot.upper, (_QUERIES, robot.dof))
    field.clearance_along(q[:10])
    return 1e3 * timed(lambda: field.clearance_along(q))[1] / _QUERIES


CAMERA = Study(
    "camera",
    "frames of a depth camera to certified motions; touches: contacts with true wood, seen from one side only",
    _frames,
    (
        *("certified", "returns", "balls", "later_ms", "first_ms", "filter_ms", "structure_ms", "plan_ms"),
        *("touches", "query_us"),
    ),
    problems=_problems,
    by="size",
    count=(None, 1),
)
