"""mplib's planner, with hplan behind it.

The class has the constructor and the calls of `mplib.Planner` 0.1.1 that ManiSkill's solutions use, so that they run
with `from hplan.adapters import mplib` in place of `import mplib`. Poses are (7,) rows x, y, z [m], qw, qx, qy, qz; a
configuration holds all active joints, or those of the move group alone. Every motion that is returned is certified.
Source: https://github.com/haosulab/MPlib, `mplib/planner.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hplan.adapters.full_configuration import FullConfigurations, with_limits
from hplan.adapters.poses import pose_of_row
from hplan.adapters.sampling import states_every
from hplan.base.arrays import FloatArray, numbers
from hplan.errors import HplanError
from hplan.geometry.rotation import rpy_of
from hplan.planning.plan import plan
from hplan.planning.pose_goal import goal_at
from hplan.planning.pose_sequence import plan_poses
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.robot.urdf_xml import read_urdf_xml
from hplan.scene.attached import Attached
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Obstacle, PointCloud


class Planner:
    """Certified motions behind mplib's interface.

    Obstacles are those of `update_point_cloud`, in calls with `use_point_cloud`; attached boxes count in calls with
    `use_attach`. The answer of a call has `status`, "Success" or the reason; with it `time` (n,) [s], `position`,
    `velocity` and `acceleration` (n, k) of the move group at the time step, `duration` [s], and `certificate`.

    Attributes:
        user_link_names: Names of the links; a `link_id` counts along them.
        user_joint_names: Names of the active joints, in the order of a full configuration.

    Examples:
        >>> from scipy.spatial.transform import Rotation
        >>> from hplan import load_robot
        >>> from hplan.adapters import mplib
        >>> robot = load_robot()
        >>> planner, pose = mplib.Planner(str(robot.urdf_path), "tool0"), robot.forward_kinematics([0.5, 0.6, 0.7, 0.8])
        >>> row = [*pose[:3, 3], *np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1)]
        >>> found = planner.plan_qpos_to_pose(row, [0.0, 0.6, 0.7, 0.8], time_step=0.05)
        >>> found["status"], found["position"].shape[1]
        ('Success', 4)
    """

    def __init__(
        self, urdf: str, move_group: str, srdf: str = "", package_keyword_replacement: str = "",
        user_link_names: Sequence[str] = (), user_joint_names: Sequence[str] = (),
        joint_vel_limits: ArrayLike | None = None, joint_acc_limits: ArrayLike | None = None,
    ) -> None:  # fmt: skip
        """Load the robot from a URDF, and an SRDF if given; limits of None are those of the robot.

        Raises:
            RobotFileError: The URDF or the SRDF is missing or malformed.
            InputError: The limits do not fit the move group, or a joint of it has no name in `user_joint_names`.
        """
        folders = [package_keyword_replacement] if package_keyword_replacement else []

        def load(held: Mapping[str, float]) -> Robot:
            held = {name: value for name, value in held.items() if name not in mimic}
            robot = load_robot(urdf, tool_frame=move_group, srdf=srdf or None, package_dirs=folders, hold=held)
            return with_limits(robot, velocity_limit=joint_vel_limits, acceleration_limit=joint_acc_limits)

        root = read_urdf_xml(Path(urdf))
        moving = [each for each in root.findall("joint") if each.get("type") in ("revolute", "continuous", "prismatic")]
        mimic = {each.get("name") for each in moving if each.find("mimic") is not None}
        self.user_link_names = list(user_link_names) or [link.attrib["name"] for link in root.findall("link")]
        self.user_joint_names = list(user_joint_names) or [each.attrib["name"] for each in moving]
        self._full = FullConfigurations(load, self.user_joint_names)
        self._base: FloatArray = np.eye(4)
        self._cloud: tuple[FloatArray, float] | None = None
        self._attached: tuple[Attached, ...] = ()

    def set_base_pose(self, pose: ArrayLike) -> None:
        """Place the base in the world."""
        self._base = pose_of_row(pose)

    def update_point_cloud(self, pc: ArrayLike, radius: float = 1e-3) -> None:
        """Replace the obstacles by balls about (n, 3) points in the world [m]; none for n = 0."""
        points = numbers("pc", pc, (None, 3))
        self._cloud = (points, radius) if len(points) else None

    def update_attached_box(self, size: ArrayLike, pose: ArrayLike, link_id: int = -1) -> None:
        """Attach a box with edges `size` [m] at a pose in a link; -1 for the move group."""
        at, frame = pose_of_row(pose), None if link_id == -1 else self.user_link_names[link_id]
        center, edges = (tuple(numbers("size", values, (3,)).tolist()) for values in (at[:3, 3], size))
        box = Box(name="attached box", center=center, size=edges, rpy_deg=rpy_of(at[:3, :3]))
        self._attached = (Attached(object=box, frame=frame),)

    def plan_qpos_to_pose(
        self, goal_pose: ArrayLike, current_qpos: ArrayLike, mask: Sequence[bool] | None = None, time_step: float = 0.1,
        rrt_range: float = 0.1, planning_time: float = 1.0, fix_joint_limits: bool = True,
        use_point_cloud: bool = False, use_attach: bool = False, wrt_world: bool = True,
        planner_name: str = "RRTConnect", no_simplification: bool = False, verbose: bool = False,
    ) -> dict[str, Any]:  # fmt: skip
        """Plan to a pose of the move group; joints with True in `mask` keep their values.

        The settings of mplib's sampling planner, which follow `time_step` and `wrt_world`, change nothing.
        """
        del rrt_range, planning_time, fix_joint_limits, planner_name, no_simplification, verbose
        keeps = dict(zip(self.user_joint_names, mask or (), strict=False))
        locked = tuple(filter(keeps.get, self._full.robot.joint_names))
        task = {"goal": goal_at(self._in_base(goal_pose, wrt_world)), "locked_joints": locked}
        return self._answer(plan, task, current_qpos, time_step, use_point_cloud, use_attach)

    def plan_screw(
        self, target_pose: ArrayLike, qpos: ArrayLike, qpos_step: float = 0.1, time_step: float = 0.1,
        use_point_cloud: bool = False, use_attach: bool = False, wrt_world: bool = True, verbose: bool = False,
    ) -> dict[str, Any]:  # fmt: skip
        """Move to a pose on a straight line, with evenly changing orientation; steps are chosen by hplan."""
        del qpos_step, verbose
        solve = partial(plan_poses, poses=self._in_base(target_pose, wrt_world)[None])
        return self._answer(solve, {}, qpos, time_step, use_point_cloud, use_attach)

    def _in_base(self, pose: ArrayLike, wrt_world: bool) -> FloatArray:
        return np.linalg.inv(self._base) @ pose_of_row(pose) if wrt_world else pose_of_row(pose)

    def _answer(
        self, solve: Callable[[Robot, Scene], PlanResult], task: dict[str, Any], qpos: ArrayLike, time_step: float,
        use_point_cloud: bool, use_attach: bool,
    ) -> dict[str, Any]:  # fmt: skip
        obstacles: tuple[Obstacle, ...] = ()
        if self._cloud is not None and use_point_cloud:
            points = (self._cloud[0] - self._base[:3, 3]) @ self._base[:3, :3]
            obstacles = (PointCloud.from_points("point cloud", points, radius=self._cloud[1]),)
        try:
            start = self._full.arm_at(qpos)
            scene = Scene(
                name="mplib", start=Start(joints_rad=start), obstacles=obstacles,
                attached=self._attached if use_attach else (), **({"goal": Goal(joints_rad=start)} | task),
            )  # fmt: skip
            found = solve(self._full.robot, scene)
        except HplanError as error:
            return {"status": error.message}
        states = states_every(found.trajectory, time_step)
        named = dict(zip(("time", "position", "velocity", "acceleration"), states, strict=True))
        return {"status": "Success", **named, "duration": states[0][-1], "certificate": found.certificate}
