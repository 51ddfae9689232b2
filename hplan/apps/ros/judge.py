"""Verdicts on the motions of any planner, as they arrive in ROS messages.

The judge certifies a motion among the obstacles of a scene (`hplan.certify`), on the curve that the controller runs
between its points, and reports the first pair that comes too near with the time. It needs no ROS.
"""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from hplan.apps.ros.arm_state import ArmState
from hplan.apps.ros.fields import fields_of, is_message
from hplan.apps.ros.joint_messages import from_joint_trajectory, joint_trajectories
from hplan.apps.ros.scene_updates import SceneUpdates
from hplan.base.checked import NotNegative, Options, Positive
from hplan.base.deadline import TimeIsUpError, time_limit
from hplan.certificate.certificate import Certificate, certify, limit_violations
from hplan.errors import HplanError
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Obstacle
from hplan.trajectory.trajectory import Trajectory

#: A limit that a verdict may require.
Limit = Literal["position", "velocity", "acceleration", "torque"]

#: Two motions of one message follow each other without a jump [rad, m if prismatic].
_SAME = 1e-3


@dataclass(frozen=True)
class JudgeOptions(Options):
    """Requirements on a motion.

    Attributes:
        clearance_m: Required clearance [m]; the scene's, and the padding of MoveIt's links, count if they are larger.
        tracking_error: Tracking error of each joint at rest that the verdict covers [rad; m for prismatic joints].
        tracking_delay_s: Additional tracking error per unit of the joint's velocity [s].
        limits: Limits that must be kept; the verdict reports the others.
        velocity_jumps: Whether the velocity may jump, in motions that have positions only.
        moving_ends: Whether the motion may begin or end in motion.
        start_tolerance: Maximum distance of each joint from the motion's start [rad, m]; 0 for no check.
        joint_prefix: Prefix of the joints' names in messages.
        deadline_s: Maximum time of a verdict [s]; motions that are not decided by then are not verified.
    """

    clearance_m: NotNegative = 0.0
    tracking_error: NotNegative = 0.0
    tracking_delay_s: NotNegative = 0.0
    limits: tuple[Limit, ...] = ("position", "velocity", "acceleration", "torque")
    velocity_jumps: bool = False
    moving_ends: bool = False
    start_tolerance: NotNegative = 0.0
    joint_prefix: str = ""
    deadline_s: Positive = 5.0


@dataclass(frozen=True)
class Verdict:
    """Verdict on the motions of one message.

    Attributes:
        verified: True if everything that is required is proved, for all times.
        violations: One message for each requirement that is not verified.
        time_s: Time of the nearest pair found, from the start of the first motion [s]. None without a pair.
        link: Link of that pair.
        obstacle: Obstacle, or other link of the arm.
        distance_m: Minimum distance found, negative in contact [m].
        depth_m: Maximum depth found at the points of a motion whose clearance is not verified, or at up to 199 of its
            configurations if it has fewer [m]; 0 without contact.
        deepest_s: Time of the maximum depth [s]; None without contact.
        clearance_m: Certified clearance of a verified motion [m]; infinite without obstacles.
        limits: Maximum use of each limit, as a fraction.
        limit: Name of the required limit that is exceeded most; empty if none is.
        duration_s: Duration of the motions [s].
        points: Number of their points.
        judged_ms: Time that the judgement took [ms].
    """

    verified: bool
    violations: tuple[str, ...] = ()
    time_s: float | None = None
    link: str = ""
    obstacle: str = ""
    distance_m: float = math.inf
    depth_m: float = 0.0
    deepest_s: float | None = None
    clearance_m: float = math.inf
    limits: Mapping[str, float] = field(default_factory=dict)
    limit: str = ""
    duration_s: float = 0.0
    points: int = 0
    judged_ms: float = 0.0

    def to_json(self) -> str:
        """The verdict as JSON, with null for values that are infinite.

        Examples:
            >>> Verdict(False, ("velocity reaches 1.2000 of its limit",), limit="velocity").to_json()[:62]
            '{"verified": false, "violations": ["velocity reaches 1.2000 of'
        """
        content = {name: _finite(value) for name, value in vars(self).items()}
        return json.dumps(content, default=list)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _finite(each) for name, each in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


class Judge:
    """Judges motions among the obstacles of a scene and of planning-scene messages.

    Attributes:
        robot: The arm.
        scene: Obstacles that are always there, and the required clearance; its start and goal do not matter.
        options: Requirements on a motion.
        updates: Obstacles from planning scenes; None if there are none.
        arm: Positions of all joints, for joints that a motion does not move.

    Examples:
        >>> from hplan import load_robot, load_scene, plan
        >>> from hplan.apps.ros import to_joint_trajectory
        >>> robot, scene = load_robot(), load_scene("table-1")
        >>> message = to_joint_trajectory(plan(robot, scene).trajectory)
        >>> judge = Judge(robot, scene, JudgeOptions(limits=(), deadline_s=60.0))
        >>> judge.judge(message).verified
        True
        >>> into_ball = {**message, "points": [message["points"][0], message["points"][-1]]}
        >>> verdict = judge.judge(into_ball)
        >>> verdict.verified, verdict.obstacle
        (False, 'ball')
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        options: JudgeOptions | None = None,
        *,
        updates: SceneUpdates | None = None,
    ) -> None:
        self.robot, self.scene, self.updates = robot, scene, updates
        self.options = JudgeOptions() if options is None else options
        self.arm = ArmState(robot.joint_names, prefix=self.options.joint_prefix, max_age_s=math.inf)
        self._obstacles: tuple[Obstacle, ...] | None = None
        self._among = scene

    def judge(self, message: Any) -> Verdict:
        """Judge the motions of a message; faults of the message are violations too.

        Args:
            message: A `JointTrajectory`, `RobotTrajectory`, `DisplayTrajectory` or `FollowJointTrajectory` goal: an
                object of rclpy or rosbags, a dict, or a file.
        """
        began = time.perf_counter()
        try:
            with time_limit(self.options.deadline_s):
                found = self._judge(message)
        except TimeIsUpError:
            found = Verdict(False, (f"not decided within {self.options.deadline_s:g} s",))
        except HplanError as error:
            found = Verdict(False, (error.message,))
        return replace(found, judged_ms=round(1e3 * (time.perf_counter() - began), 3))

    def _judge(self, message: Any) -> Verdict:
        scene, rest = self._scene(), {**self.arm.positions, **self._start_of(message)}
        motions = [
            from_joint_trajectory(part, prefix=self.options.joint_prefix, robot=self.robot, rest=rest)
            for part in joint_trajectories(message)
        ]
        if not motions:
            return Verdict(False, ("the message has no motion",))
        begins_s = [0.0, *itertools.accumulate(motion.duration for motion in motions)]
        verdicts = [self._judge_motion(scene, *each) for each in zip(motions, begins_s, strict=False)]
        violations = (*self._jumps(motions), *(words for verdict in verdicts for words in verdict.violations))
        limits = {name: max(verdict.limits[name] for verdict in verdicts) for name in verdicts[0].limits}
        exceeded = {name: use for name, use in limits.items() if any(each.startswith(name) for each in violations)}
        return replace(
            min(verdicts, key=lambda verdict: verdict.distance_m),
            verified=not violations,
            violations=violations,
            limits=limits,
            limit=max(exceeded, key=lambda name: exceeded[name], default=""),
            duration_s=begins_s[-1],
            points=sum(motion.samples for motion in motions),
        )

    def _scene(self) -> Scene:
        """The scene with the obstacles of the planning scene.

        Raises:
            SceneError: The planning scene is unknown, or has an obstacle of the same name.
        """
        obstacles = () if self.updates is None else self.updates.obstacles
        padding_m = 0.0 if self.updates is None else self.updates.padding_m
        attached = (*self.scene.attached, *(() if self.updates is None else self.updates.attached))
        clearance_m = max(self.options.clearance_m, self.scene.clearance, padding_m)
        before = self._among.clearance, self._among.attached
        if obstacles is not self._obstacles or before != (clearance_m, attached):
            changed = self.scene.with_values(clearance=clearance_m, attached=attached)
            self._among = changed.with_obstacles((*changed.obstacles, *obstacles)) if obstacles else changed
            self._obstacles = obstacles
        return self._among

    def _start_of(self, message: Any) -> Mapping[str, float]:
        """Joint positions at the start of a `DisplayTrajectory`."""
        state = fields_of(message).get("trajectory_start") if is_message(message) else None
        joints = fields_of(state).get("joint_state") if state is not None and is_message(state) else None
        if joints is None or not is_message(joints):
            return {}
        start = ArmState((), prefix=self.options.joint_prefix)
        start.see(joints, 0.0)
        return start.positions

    def _jumps(self, motions: Sequence[Trajectory]) -> list[str]:
        """Violations at the start, and between two motions."""
        found, names = [], self.robot.joint_names
        if self.options.start_tolerance > 0.0:
            known = self.arm.positions
            for name, begin in zip(names, motions[0].position[0].tolist(), strict=True):
                if name not in known:
                    found.append(f"no joint state has had joint {name!r} yet, so the start cannot be compared")
                elif abs(known[name] - begin) > self.options.start_tolerance:
                    at = f"{begin:.6g}, the arm is at {known[name]:.6g}"
                    found.append(f"the motion begins with joint {name!r} at {at}")
        for number, (before, after) in enumerate(itertools.pairwise(motions), start=2):
            off = np.abs(after.position[0] - before.position[-1])
            if off.max() > _SAME:
                joint = int(off.argmax())
                found.append(f"motion {number} begins {off[joint]:.4g} from the end of motion {number - 1} in joint "
                    f"{names[joint]!r}")  # fmt: skip
        return found

    def _judge_motion(self, scene: Scene, motion: Trajectory, begin_s: float) -> Verdict:
        options = self.options
        certificate = certify(
            self.robot,
            scene,
            motion,
            tracking_error=options.tracking_error,
            tracking_delay_s=options.tracking_delay_s,
            check_ends=False,
            rest_to_rest=not options.moving_ends,
            begin_s=begin_s,
            velocity_jumps=options.velocity_jumps and motion.interpolation == "linear",
        )
        ignored = {
            words
            for words in limit_violations(certificate.limit_use)
            if words.split(maxsplit=1)[0] not in options.limits
        }
        violations = tuple(words for words in certificate.violations if words not in ignored)
        nearest, at_s = certificate.nearest, _nearest_time_s(certificate)
        distance_m = math.inf if nearest is None else nearest.distance_m
        time_s = None if at_s is None else begin_s + at_s
        return Verdict(
            verified=not violations,
            violations=violations,
            time_s=time_s,
            link="" if nearest is None else nearest.link,
            obstacle="" if nearest is None else nearest.obstacle,
            distance_m=distance_m,
            depth_m=max(0.0, -distance_m),
            deepest_s=time_s if distance_m < 0.0 else None,
            clearance_m=math.inf if violations else certificate.min_clearance_m,
            limits={name: float(use) for name, use in vars(certificate.limit_use).items()},
        )


def _nearest_time_s(certificate: Certificate) -> float | None:
    """Time of the nearest pair found, from the start of the motion [s]."""
    if certificate.subject is None or certificate.nearest is None:
        return None
    proofs = [
        (proof, motion.trajectory.time[part.start : part.stop + 1])
        for motion, _ in certificate.subject.motions
        for part, _, _, proof, _ in motion.stretches
        if proof.nearest is certificate.nearest
    ]
    if not proofs:
        return None
    proof, times = proofs[0]
    return float(np.interp(proof.nearest_at, np.arange(len(times)), times))
