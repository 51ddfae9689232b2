"""Random planar scenes: discs in the arm plane, start and goal on the joint grid, each scene from its own number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from studies.planar_cspace import arm_sections, joint_grid

from hplan.base.arrays import FloatArray, IntArray
from hplan.cspace.occupancy import occupancy
from hplan.errors import InputError
from hplan.planning.task import PlanningCache
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.search import two_level_search
from hplan.search.grid import Occupancy

#: Spacing of the joint grid [deg].
STEP_DEG = 1.0

#: Start and goal are at least this far apart in joint space [deg].
APART_DEG = 30.0

#: Pairs of nodes drawn before a scene's discs are drawn anew.
_PAIRS = 200


@dataclass(frozen=True, eq=False)
class PlanarScene:
    """A scene and its C-space.

    Attributes:
        number: The scene is made from the seed and this number alone.
        scene: Obstacles, start and goal.
        space: Its C-space.
        start: (d,) node index.
        goal: (d,) node index.
        spare_clearance_m: Smaller clearance of start and goal [m].
    """

    number: int
    scene: Scene
    space: Occupancy
    start: IntArray
    goal: IntArray
    spare_clearance_m: float

    @property
    def has_path(self) -> bool:
        """True if start and goal are connected on the grid."""
        return two_level_search(self.space, self.start, self.goal).path is not None


def random_scene(robot: Robot, seed: int, number: int) -> PlanarScene:
    """A scene of 1 to 12 discs within reach, with start and goal drawn from the free nodes.

    Discs in which pedestal or turret stand are no problem of planning, which refuses them: they are drawn anew.
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
        # The base is looked at last: so the numbers drawn for scenes in which it is free are the same as without.
        scene = task(robot, f"clutter-{number}", discs, ends[0], ends[1])
        world = PlanningCache(robot).world(scene, PlanOptions())
        try:
            world.check_base(robot.yaw_of(scene.start.configuration))
        except InputError:
            continue
        spare = min(float(world.checker.distances(end.configuration).min()) for end in (scene.start, scene.goal))
        return PlanarScene(number, scene, space, pair[0].astype(np.int64), pair[1].astype(np.int64), spare)


def discs_in_plane(robot: Robot, discs: FloatArray) -> list[Sphere]:
    """Balls from (k, 3) rows: centre in the arm plane at yaw 0, and radius [m]."""
    centres = robot.plane_origin + discs[:, :2] @ robot.plane_axes
    return [
        Sphere(name=f"disc {i}", center=(float(x), float(y), float(z)), radius=float(radius))
        for i, ((x, y, z), radius) in enumerate(zip(centres, discs[:, 2], strict=True))
    ]


def task(robot: Robot, name: str, discs: list[Sphere], start: FloatArray, goal: FloatArray) -> Scene:
    """The scene with the given planar joint angles at yaw 0."""
    yaw = (0.0,) if robot.has_yaw else ()
    return Scene(
        name=name,
        start=Start(joints_rad=(*yaw, *(float(q) for q in start))),
        goal=Goal(joints_rad=(*yaw, *(float(q) for q in goal))),
        locked_joints=robot.joint_names[:1] if robot.has_yaw else (),
        obstacles=tuple(discs),
    )
