"""roboplan as a peer: RRT-Connect, shortcuts and TOPP-RA among a scene's obstacles, and along tool poses.

It gets the robot's URDF, its limits of velocity and acceleration, the pairs of links that hplan looks at, and the
obstacles as primitives. It limits neither torque nor jerk.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
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
from hplan.errors import HplanError, InputError
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.robot.files import named_robot
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere

with extra("bench", "a peer needs roboplan"):
    from roboplan import cartesian_planning, core, rrt, toppra

#: What obstacles are part of, and their colour.
_WORLD, _COLOR = "universe", np.ones(4)

#: Group of all joints; most nodes of a tree, and seconds for it; steps between rows of a trajectory [s].
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
        """RRT-Connect, shortcuts and TOPP-RA between two (dof,) configurations; None where it finds none."""
        try:
            shortcutter = core.PathShortcutter(self._scene, core.PathShortcuttingOptions(_GROUP, seed=self._seed))
            return self._timed(shortcutter.shortcut(self._path(start, goal)))
        except RuntimeError:
            return None

    def pose_motions(
        self, start: FloatArray, poses: FloatArray, straight: Sequence[bool], tilt_rad: float
    ) -> list[TimedMotion] | None:
        """A motion to each pose, the tool upright; None where it finds none to one of them.

        Straight ones come of its Cartesian planner; free ones of RRT-Connect under a constraint of the tool's pose, to
        the first of the configurations there that it gets to. Its shortcuts know of no constraint, and are left out.

        Args:
            start: (dof,) configuration.
            poses: (n, 4, 4) of the tool.
            straight: Which motions are along straight lines.
            tilt_rad: Of the tool from the vertical, at most, about each of two axes.
        """
        upright, found = self._upright(start, tilt_rad), []
        for pose, is_straight in zip(poses, straight, strict=True):
            motion = self._straight(start, pose) if is_straight else self._free(start, pose, upright)
            if motion is None:
                return None
            found.append(motion)
            start = motion.positions(np.array([motion.duration]))[0]
        return found

    def _straight(self, start: FloatArray, pose: FloatArray) -> TimedMotion | None:
        mode = cartesian_planning.CartesianSpeedMode.TimeOptimal
        options = cartesian_planning.CartesianPlannerOptions(_GROUP, dt=_STEP_S, speed_mode=mode)
        line = [[self.robot.forward_kinematics(start), pose]]
        path = core.CartesianPath([_WORLD], [self.robot.tool_frame], line)
        try:
            planner = cartesian_planning.CartesianPathPlanner(self._scene, options)
            return _motion(planner.plan(path, core.JointConfiguration(self._joints, start)))
        except RuntimeError:
            return None

    def _free(self, start: FloatArray, pose: FloatArray, upright: Any) -> TimedMotion | None:
        try:
            ends = inverse_kinematics(self.robot, pose)
        except HplanError:
            return None
        for goal in sorted(ends, key=lambda q: float(np.abs(q - start).max())):
            try:
                return self._timed(self._path(start, goal, upright))
            except (RuntimeError, MemoryError):  # some paths of 2,000 waypoints are too much for its splines
                continue
        return None

    def _upright(self, start: FloatArray, tilt_rad: float) -> Any:
        """The constraint that roll and pitch stay as they are at the start, with the tool downwards or level."""
        region, angles = np.eye(4), np.array([0.5 * np.pi, 0.0])
        if self.robot.forward_kinematics(start)[2, 2] < -0.5:
            region[:3, :3], angles = pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0), np.zeros(2)
        least, most = np.full(6, -1e3), np.full(6, 1e3)
        least[3:5], most[3:5] = angles - tilt_rad, angles + tilt_rad
        return rrt.PoseConstraint(self._scene, _GROUP, self.robot.tool_frame, least, most, region)

    def _path(self, start: FloatArray, goal: FloatArray, *constraints: Any) -> Any:
        options = rrt.RRTOptions(_GROUP, max_nodes=_NODES, rrt_connect=True, max_planning_time=_PATIENCE_S)
        planner = rrt.RRT(self._scene, options)
        planner.setRngSeed(self._seed)
        begin, end = (core.JointConfiguration(self._joints, q) for q in (start, goal))
        return planner.plan(begin, end, list(constraints))

    def _timed(self, path: Any) -> TimedMotion:
        options = toppra.TOPPRAOptions(dt=_STEP_S, mode=toppra.SplineFittingMode.Adaptive)
        return _motion(toppra.PathParameterizerTOPPRA(self._scene, _GROUP).generate(path, options))


def _motion(trajectory: Any) -> TimedMotion:
    """Its rows with cubics between them."""
    from scipy.interpolate import CubicHermiteSpline

    spline = CubicHermiteSpline(trajectory.times, trajectory.positions, trajectory.velocities)
    return TimedMotion(float(trajectory.times[-1]), lambda t: np.asarray(spline(t)))
