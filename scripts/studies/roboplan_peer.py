"""roboplan as a peer: RRT-Connect, shortcuts and TOPP-RA among a scene's obstacles.

It gets the robot's URDF, its limits of velocity and acceleration, the pairs of links that hplan looks at, and the
obstacles as primitives. It limits neither torque nor jerk.
"""

from __future__ import annotations

import tempfile
from itertools import combinations
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from studies.outside import TimedMotion

from hplan.base.arrays import FloatArray
from hplan.base.lazy_import import extra
from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import solid_shape
from hplan.errors import InputError
from hplan.robot.files import named_robot
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere

with extra("bench", "a peer needs roboplan"):
    from roboplan import core, rrt, toppra

#: Parent frame of the obstacles, and their colour.
_WORLD, _COLOR = "universe", np.ones(4)

#: Group of all joints; maximum number of nodes of a tree, and its time [s]; sampling period of a trajectory [s].
_GROUP, _NODES, _PATIENCE_S, _STEP_S = "arm", 20_000, 10.0, 0.005


class RoboplanArm:
    """A robot among a scene's obstacles, as roboplan has them."""

    def __init__(self, robot: Robot, scene: Scene, seed: int) -> None:
        """Read the robot, and place the obstacles.

        Raises:
            InputError: The scene has an obstacle that is no primitive.
        """
        self.robot, self._joints, self._seed = robot, list(robot.joint_names), seed
        with tempfile.TemporaryDirectory() as folder:
            urdf, limits = Path(folder, "robot.urdf"), Path(folder, "limits.yaml")
            urdf.write_text(robot.urdf_text or robot.urdf_path.read_text(), encoding="utf-8")
            accelerations = zip(self._joints, robot.acceleration_limit.tolist(), strict=True)
            rows = (f"  {joint}: {{max_acceleration: [{most}]}}\n" for joint, most in accelerations)
            limits.write_text("joint_limits:\n" + "".join(rows), encoding="utf-8")
            packages = named_robot("panda").package_dirs
            self._scene = core.Scene(robot.name, core.loadUrdfSceneDescription(urdf, packages))
            self._scene.importJointLimitsFromConfig(core.loadJointLimitsConfig(limits))
        self._scene.addGroup(_GROUP, self._joints)
        checker = CoalScene(robot, ())
        wanted = {frozenset((checker.mover_names[a], checker.obstacle_names[b])) for a, b in checker.pairs}
        links = [frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY]
        links = [link for link in links if self._scene.getCollisionGeometryIDs(link)]
        placed = [name for obstacle in scene.obstacles for name in self._place(obstacle)]
        still = [*placed, *(link for link in links if link not in checker.mover_names)]
        pairs = [*combinations(links, 2), *combinations(still, 2)]
        self._scene.setCollisions([pair for pair in pairs if frozenset(pair) not in wanted], False)

    def _place(self, obstacle: Obstacle) -> list[str]:
        """Add an obstacle; names of its parts."""
        if not isinstance(obstacle, Sphere | Box | Cylinder | Capsule):
            raise InputError(f"{obstacle.name}: roboplan is given primitives alone")
        name, placed = obstacle.name, solid_shape(obstacle)
        where, solid = (placed.placement.homogeneous, _COLOR), placed.geometry
        if isinstance(solid, coal.Sphere):
            self._scene.addSphereGeometry(name, _WORLD, core.Sphere(solid.radius), *where)
        elif isinstance(solid, coal.Box):
            self._scene.addBoxGeometry(name, _WORLD, core.Box(*(2.0 * solid.halfSide)), *where)
        else:
            can = core.Cylinder(solid.radius, 2.0 * solid.halfLength)
            self._scene.addCylinderGeometry(name, _WORLD, can, *where)
        if not isinstance(obstacle, Capsule):
            return [name]
        ends = enumerate((obstacle.start, obstacle.end))
        balls = [Sphere(name=f"{name} {number}", center=end, radius=obstacle.radius) for number, end in ends]
        return [name, *(part for ball in balls for part in self._place(ball))]

    def motion(self, start: FloatArray, goal: FloatArray) -> TimedMotion | None:
        """RRT-Connect, shortcuts and TOPP-RA between two (dof,) configurations, or None."""
        try:
            shortcutter = core.PathShortcutter(self._scene, core.PathShortcuttingOptions(_GROUP, seed=self._seed))
            return self._timed(shortcutter.shortcut(self._path(start, goal)))
        except RuntimeError:
            return None

    def _path(self, start: FloatArray, goal: FloatArray) -> Any:
        options = rrt.RRTOptions(_GROUP, max_nodes=_NODES, rrt_connect=True, max_planning_time=_PATIENCE_S)
        planner = rrt.RRT(self._scene, options)
        planner.setRngSeed(self._seed)
        begin, end = (core.JointConfiguration(self._joints, q) for q in (start, goal))
        return planner.plan(begin, end, [])

    def _timed(self, path: Any) -> TimedMotion:
        options = toppra.TOPPRAOptions(dt=_STEP_S, mode=toppra.SplineFittingMode.Adaptive)
        return _motion(toppra.PathParameterizerTOPPRA(self._scene, _GROUP).generate(path, options))


def _motion(trajectory: Any) -> TimedMotion:
    """Its samples with cubics between them."""
    from scipy.interpolate import CubicHermiteSpline

    spline = CubicHermiteSpline(trajectory.times, trajectory.positions, trajectory.velocities)
    return TimedMotion(float(trajectory.times[-1]), lambda t: np.asarray(spline(t)))
