"""vamp-planner as a peer: vectorized RRT-Connect and simplification, with arms as balls.

Its arms are its own, by name (`panda`, `ur5`, `fetch`), with the joints of the same robots in hplan. Obstacles are
balls, boxes and capsules; as in its own evaluation of MotionBenchMaker, a cylinder is a capsule, and a box where a
capsule would close the way. The package comes as source code alone, so no extra installs it: `pip install
vamp-planner`.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.errors import InputError
from hplan.scene.obstacles import Box, Cylinder, Obstacle, Sphere

try:
    import vamp
except ImportError as error:
    raise InputError("a peer needs vamp-planner: pip install vamp-planner, which compiles it") from error


class VampArm:
    """An arm of vamp-planner among obstacles."""

    def __init__(self, name: str, obstacles: Iterable[Obstacle], *, boxes: bool = False) -> None:
        """Place the obstacles.

        Args:
            name: The arm's name.
            obstacles: Balls, boxes and cylinders in the root frame of the arm's URDF.
            boxes: Whether boxes stand for cylinders, not capsules.

        Raises:
            InputError: There is another kind of obstacle.
        """
        self._arm, self._planner, self._settings, self._simplifier = vamp.configure_robot_and_planner_with_kwargs(
            name, "rrtc"
        )
        self._among = vamp.Environment()
        for obstacle in obstacles:
            self._place(obstacle, boxes)

    def _place(self, obstacle: Obstacle, boxes: bool) -> None:
        from scipy.spatial.transform import Rotation

        if isinstance(obstacle, Sphere):
            self._among.add_sphere(vamp.Sphere(obstacle.center, obstacle.radius))
            return
        if not isinstance(obstacle, Box | Cylinder):
            raise InputError(f"{obstacle.name}: vamp-planner is given balls, boxes and cylinders alone")
        place = list(obstacle.center), Rotation.from_matrix(obstacle.rotation).as_euler("XYZ").tolist()
        if isinstance(obstacle, Cylinder) and not boxes:
            self._among.add_capsule(vamp.Cylinder(*place, obstacle.radius, obstacle.length))
            return
        size = obstacle.size if isinstance(obstacle, Box) else (*(2.0 * obstacle.radius,) * 2, obstacle.length)
        self._among.add_cuboid(vamp.Cuboid(*place, [0.5 * side for side in size]))

    def path(self, start: FloatArray, goal: FloatArray) -> FloatArray | None:
        """(m, dof) waypoints from a start to a goal after simplification, or None."""
        sampler = self._arm.halton()
        found = self._planner(start, [goal], self._among, self._settings, sampler)
        if not found.solved:
            return None
        simple = self._arm.simplify(found.path, self._among, self._simplifier, sampler)
        path = np.array(simple.path.numpy(), dtype=np.float64)
        path[0], path[-1] = start, goal  # it computes in single precision
        return path
