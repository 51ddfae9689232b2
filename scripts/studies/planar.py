"""Random planar scenes with a locked base, and the two-level search compared with the dense one in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from studies.harness import Row, Study, StudyConfig
from studies.measure import planned, ratio, timed
from studies.peers import peer_row
from studies.planar_cspace import arm_sections, joint_grid

from hplan.base.arrays import FloatArray, IntArray
from hplan.errors import InputError
from hplan.planar.grid import dense_search, two_level_search
from hplan.planar.grid.grid import Occupancy
from hplan.planar.grid.occupancy import occupancy
from hplan.planning.options import PlanOptions
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere

#: Spacing of the joint grid, and minimum distance of start and goal in joint space [deg].
STEP_DEG, APART_DEG = 1.0, 30.0

#: Pairs of nodes drawn before a scene's discs are drawn anew.
_PAIRS = 200


@dataclass(frozen=True, eq=False)
class PlanarScene:
    """A scene and its C-space.

    Attributes:
        scene: Obstacles, start and goal.
        space: Its C-space.
        start: (d,) node index.
        goal: (d,) node index.
    """

    scene: Scene
    space: Occupancy
    start: IntArray
    goal: IntArray

    @property
    def has_path(self) -> bool:
        """True if start and goal are connected on the grid."""
        return two_level_search(self.space, self.start, self.goal).path is not None


def random_scene(robot: Robot, seed: int, number: int) -> PlanarScene:
    """A random scene of 1 to 12 discs within reach.

    Start and goal are random free nodes. Discs that overlap pedestal or turret are drawn anew, since planning refuses
    them.
    """
    random = np.random.default_rng([seed, number])
    grid = joint_grid(robot.arm, np.radians(STEP_DEG))
    reach = float(robot.arm.lengths.sum())
    while True:
        count = int(random.integers(1, 13))
        distance = random.uniform(0.11 * reach, reach, count)
        bearing = np.radians(random.uniform(-20.0, 200.0, count))
        radius = random.uniform(0.02, 0.25 if count < 5 else 0.12, count)
        centres = np.column_stack([distance * np.cos(bearing), distance * np.sin(bearing)])
        discs = discs_in_plane(robot, np.column_stack([centres, radius]))
        space = occupancy(robot.arm, arm_sections(robot, discs), grid)
        free = np.flatnonzero(~space.occupied.ravel())
        if len(free) < 2:
            continue
        for _ in range(_PAIRS):
            pair = np.stack(np.unravel_index(free[random.integers(len(free), size=2)], grid.shape), axis=1)
            ends = grid.coordinates(pair)
            if np.linalg.norm(ends[1] - ends[0]) >= np.radians(APART_DEG):
                break
        else:
            continue
        # The base is checked last, so that scenes with a free base have the same random numbers as without the check.
        scene = planar_scene(robot, f"clutter-{number}", discs, ends[0], ends[1])
        world = World.of_scene(robot, scene, PlanOptions())
        try:
            world.check_base(robot.yaw_of(scene.start.configuration))
        except InputError:
            continue
        return PlanarScene(scene, space, pair[0].astype(np.int64), pair[1].astype(np.int64))


def discs_in_plane(robot: Robot, discs: FloatArray) -> list[Sphere]:
    """Balls from (k, 3) discs: centre in the arm plane at yaw 0, and radius [m]."""
    centres = robot.plane_origin + discs[:, :2] @ robot.plane_axes
    return [
        Sphere(name=f"disc {i}", center=(float(x), float(y), float(z)), radius=float(radius))
        for i, ((x, y, z), radius) in enumerate(zip(centres, discs[:, 2], strict=True))
    ]


def planar_scene(robot: Robot, name: str, discs: list[Sphere], start: FloatArray, goal: FloatArray) -> Scene:
    """The scene with the given planar joint angles at yaw 0."""
    yaw = (0.0,) if robot.has_yaw else ()
    return Scene(
        name=name,
        start=Start(joints_rad=(*yaw, *(float(q) for q in start))),
        goal=Goal(joints_rad=(*yaw, *(float(q) for q in goal))),
        locked_joints=robot.joint_names[:1] if robot.has_yaw else (),
        obstacles=tuple(discs),
    )


def _clutter(config: StudyConfig, number: int) -> Row:
    """Results of both searches, the motion, and a peer."""
    robot = config.arm()
    drawn = random_scene(robot, config.seed, number)
    runs = [timed(lambda: two_level_search(drawn.space, drawn.start, drawn.goal)) for _ in range(3)]
    fast, fast_ms = runs[0][0], float(np.median([ms for _, ms in runs]))
    dense, dense_ms = timed(lambda: dense_search(drawn.space, drawn.start, drawn.goal))
    has_path = dense.path is not None
    _, row = planned(robot, drawn.scene, PlanOptions(effort=config.effort))
    row |= {
        "name": drawn.scene.name,
        "path": has_path,
        "search_ratio": dense_ms / fast_ms,
        "cost_ratio": ratio(fast.cost, dense.cost) if has_path else None,
        "two_level_ms": fast_ms,
        "fallback": fast.fallback,
        "disagree": (fast.path is not None) != has_path,
    }
    return row | peer_row(config, robot, drawn.scene, row.get("duration_s"), seconds=1.0)


CLUTTER = Study(
    "clutter",
    "random planar scenes: the two-level search compared with the dense one, and motions",
    _clutter,
    (
        *("certified", "ms", "two_level_ms", "search_ratio", "cost_ratio", "fallback", "disagree"),
        *("peer_solved", "peer_ms", "to_peer", "to_spline", "spline_touches"),
    ),
    by="path",
    count=(200, 10),
    warm=2,
)
