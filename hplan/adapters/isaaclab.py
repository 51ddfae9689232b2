"""Isaac Lab's motion planner interface, with hplan behind it.

`MotionPlanner` has the methods of `MotionPlannerBase` in `isaaclab_mimic.motion_planners`, Isaac Lab Mimic's interface
to planners. It needs neither Isaac Lab nor a GPU: it reads joint values from the articulation, and
takes the obstacles from a function of yours.

Source: https://github.com/isaac-sim/IsaacLab, `motion_planner_base.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hplan.adapters.full_configuration import FullConfigurations
from hplan.adapters.sampling import states_every
from hplan.base.arrays import FloatArray, numbers
from hplan.base.log import LOG
from hplan.errors import HplanError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.pose_goal import goal_at
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.attached import Attached
from hplan.scene.model import Scene, Start
from hplan.scene.obstacles import Obstacle


class MotionPlanner:
    """Certified motions behind Isaac Lab's planner interface.

    Attributes:
        env: The environment; its `step_dt` is the time between waypoints [s].
        robot: The articulation, with `joint_names` and `data.joint_pos`.
        env_id: Number of the environment.
        debug: True to log why a plan failed.
        last: The last plan; None before the first, and after a failure.
    """

    def __init__(
        self,
        env: Any,
        robot: Any,
        env_id: int = 0,
        debug: bool = False,
        *,
        load: Callable[[Mapping[str, float]], Robot],
        obstacles: Callable[[], Sequence[Obstacle]] = tuple,
        attached: Callable[[], Sequence[Attached]] = tuple,
        options: PlanOptions | None = None,
    ) -> None:
        """Load the arm.

        Args:
            env: The environment.
            robot: The articulation.
            env_id: Number of the environment.
            debug: True to log why a plan failed.
            load: Loads the arm with held joints at the given values, for example
                `lambda hold: load_robot("panda.urdf", tool_frame="panda_hand", hold=hold)`.
            obstacles: Returns the obstacles in the base frame of the arm, before each plan.
            attached: Returns the held objects, before each plan.
            options: How to plan; None for the defaults.

        Raises:
            HplanError: The arm cannot be loaded.
        """
        self.env, self.robot, self.env_id, self.debug = env, robot, env_id, debug
        self._full = FullConfigurations(load, robot.joint_names)
        self._obstacles, self._attached = obstacles, attached
        self._options = PlanOptions() if options is None else options
        self.last: PlanResult | None = None
        self._poses: list[FloatArray] = []
        self._next, self._like = 0, np.asarray

    def update_world_and_plan_motion(self, target_pose: ArrayLike, **settings: Any) -> bool:
        """Plan to a (4, 4) pose of the tool frame in the base frame, among the current obstacles.

        Args:
            target_pose: Matrix or tensor.
            settings: Settings of other planners; they change nothing.

        Returns:
            True if a certified motion was found.

        Raises:
            InputError: The pose is not a matrix of this shape, or not one of a pose.
        """
        del settings
        self.reset_plan()
        # Waypoints have the type and device of the target.
        self._like = getattr(target_pose, "new_tensor", np.asarray)
        goal = goal_at(numbers("target_pose", _to_numpy(target_pose), (4, 4)))
        try:
            start = Start(joints_rad=self._full.arm_at(_to_numpy(self.robot.data.joint_pos[self.env_id])))
            scene = Scene(
                name=f"environment {self.env_id}", start=start, goal=goal, obstacles=tuple(self._obstacles()),
                attached=tuple(self._attached()),
            )  # fmt: skip
            self.last = plan(self._full.robot, scene, self._options)
        except HplanError as error:
            if self.debug:
                LOG.warning("no motion in environment %d: %s", self.env_id, error.message)
            return False
        _, rows, *_ = states_every(self.last.trajectory, float(self.env.step_dt))
        self._poses = [self.last.robot.forward_kinematics(row) for row in rows[1:]]
        return True

    def has_next_waypoint(self) -> bool:
        """True if the plan has more waypoints."""
        return self._next < len(self._poses)

    def get_next_waypoint_ee_pose(self) -> Any:
        """Return the (4, 4) pose of the tool frame at the next waypoint, one time step after the one before.

        Raises:
            IndexError: There are no more waypoints.
        """
        self._next += 1
        return self._like(self._poses[self._next - 1])

    def get_planned_poses(self) -> list[Any]:
        """Return the poses of all waypoints; the next waypoint stays the same."""
        return [self._like(pose) for pose in self._poses]

    def reset_plan(self) -> None:
        """Forget the plan."""
        self.last, self._poses, self._next = None, [], 0

    def get_planner_info(self) -> dict[str, Any]:
        """Return the planner's name, environment and debug setting."""
        return {"name": "hplan", "env_id": self.env_id, "debug": self.debug}


def _to_numpy(values: Any) -> Any:
    """Return a tensor of any device as an array; others unchanged."""
    return values.detach().cpu().numpy() if hasattr(values, "detach") else values
