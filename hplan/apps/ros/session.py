"""Motions for one controller, from an arm at rest to splices and stops, without ROS.

A session keeps the planner's belief about the running motion equal to the controller's: a command counts once the
controller has accepted it, and the one before it counts again if it was rejected.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from hplan.apps.ros.arm_state import ArmState
from hplan.base.arrays import FloatArray
from hplan.base.checked import NotNegative, Options, Positive
from hplan.certificate.certificate import Certificate
from hplan.certificate.retimed_certificate import CertifiedMotion
from hplan.errors import HplanError, InputError, NotOnMotionError
from hplan.online.frame import CloudOptions, FrameReport
from hplan.online.planner import Planner
from hplan.planning.options import EffortName, PlanOptions
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.attached import Attached
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Obstacle
from hplan.trajectory.trajectory import Trajectory

#: Name of the obstacle that the points of the camera form.
CLOUD = "points"


@dataclass(frozen=True)
class SessionOptions(Options):
    """Parameters of plans, splices and stops.

    Attributes:
        speed: Fraction of the velocity limits to use.
        effort: Effort preset of plans: `quick`, `default` or `best`.
        clearance_m: Required clearance [m]; the scene's, and the padding of MoveIt's links, count if they are larger.
        tracking_error: Tracking error of each joint at rest that certificates cover [rad; m for prismatic joints]; the
            arm must be this near to the running motion for a splice.
        tracking_delay_s: Additional tracking error per unit of the joint's velocity [s].
        deadline_s: Maximum time for a plan from rest [s].
        lead_s: Time from a plan to its start, for the way to the controller [s].
        ahead_s: Time from a frame to the start of a splice, in which the new motion is planned and sent [s].
        radius_m: Radius of the ball about each point of a cloud [m].
        growth_m: Maximum growth of a ball that merges several points [m]; fewer balls, faster plans.
        keep_s: Hidden points are remembered this long [s].
        max_frame_age_s: Maximum age of the last cloud for a plan [s]; 0 for no limit.
        max_state_age_s: Maximum age of a joint's position [s].
        arm_padding_m: Points this near to the arm are its own [m].
        allow_empty: Whether a cloud may have no point within the arm's range.
    """

    speed: Positive = 1.0
    effort: EffortName = "quick"
    clearance_m: NotNegative = 0.0
    tracking_error: NotNegative = 0.005
    tracking_delay_s: NotNegative = 0.005
    deadline_s: Positive = 5.0
    lead_s: NotNegative = 0.05
    ahead_s: Positive = 0.2
    radius_m: Positive = 0.01
    growth_m: Positive = 0.01
    keep_s: NotNegative = 0.0
    max_frame_age_s: NotNegative = 0.0
    max_state_age_s: Positive = 0.5
    arm_padding_m: NotNegative = 0.03
    allow_empty: bool = True


#: Kind of a command: a motion from rest, one that takes over from a running one, or a stop.
Kind = Literal["motion", "splice", "stop"]


class Command(NamedTuple):
    """A motion for the controller.

    Attributes:
        number: Number of the command, from 1.
        kind: `motion`, `splice` or `stop`.
        trajectory: The motion.
        begins_s: Time of its first sample on the session's clock [s].
        certificate: Its certificate.
        reason: Why the arm stops; empty otherwise.
    """

    number: int
    kind: Kind
    trajectory: Trajectory
    begins_s: float
    certificate: Certificate
    reason: str = ""

    @property
    def ends_s(self) -> float:
        """Time of its last sample on the session's clock [s]."""
        return self.begins_s + self.trajectory.duration


class _Belief(NamedTuple):
    """A command and the planner's last motion at that time."""

    command: Command | None
    last: PlanResult | None


class Session:
    """Plans, splices and stops for one controller.

    Attributes:
        planner: The planner; its clock is the session's.
        arm: The state of the arm.
        sent: The last command that the controller did not reject, while it runs; None at rest.
        is_pending: True while the controller has not answered the last command.
        fault: Why nothing may move, for example an unknown planning scene; empty if nothing forbids it.
    """

    def __init__(
        self, robot: Robot, scene: Scene, options: SessionOptions, clock: Callable[[], float], *, prefix: str = ""
    ) -> None:
        """Start at rest.

        Args:
            robot: The arm.
            scene: Obstacles that are always there, clearance, and a goal.
            options: Parameters.
            clock: Returns the time now [s]; it never runs backward.
            prefix: Prefix of the joints' names in messages.

        Raises:
            InputError: The scene locks a joint that the robot does not have, as a scene of another robot does.
        """
        robot.locked_mask(scene.locked_joints)
        self.options, self._clock = options, clock
        self._clearance_m = max(options.clearance_m, scene.clearance)
        plans = PlanOptions(
            speed=options.speed,
            effort=options.effort,
            tracking_error=options.tracking_error,
            tracking_delay_s=options.tracking_delay_s,
            deadline_s=options.deadline_s,
        )
        self.planner = Planner(robot, scene.with_values(clearance=self._clearance_m), plans)
        self.arm = ArmState(robot.joint_names, prefix=prefix, max_age_s=options.max_state_age_s)
        self.sent: Command | None = None
        self.is_pending = False
        self.fault = ""
        self._from_messages: dict[str, Obstacle] = {}
        self._attached = scene.attached
        self._before = _Belief(None, None)
        self._count = 0

    @property
    def is_moving(self) -> bool:
        """True while a command runs, as far as is known."""
        return self.sent is not None

    def set_obstacles(
        self, obstacles: Sequence[Obstacle], padding_m: float = 0.0, attached: Sequence[Attached] = ()
    ) -> None:
        """Replace the obstacles and held objects that came from messages.

        Args:
            obstacles: The obstacles; those that stay the same objects keep all that was prepared for them.
            padding_m: Clearance required by the message [m].
            attached: Objects that the arm holds in addition to those of the scene.

        Raises:
            HplanError: Two obstacles have the same name, or a held object does not fit the robot.
        """
        given = {item.name: item for item in obstacles}
        for name, known in self._from_messages.items():
            if given.get(name) is not known:
                self.planner.remove(name)
        held = (*self._attached, *attached)
        if self.planner.scene.attached != held:
            self.planner.hold(held)
        for name, item in given.items():
            if self._from_messages.get(name) is not item:
                self.planner.add(item)
        self._from_messages = given
        clearance_m = max(self._clearance_m, padding_m)
        if self.planner.scene.clearance != clearance_m:
            self.planner.scene = self.planner.scene.with_values(clearance=clearance_m)

    def see_cloud(self, points: FloatArray, pose: FloatArray | None, at_s: float) -> FrameReport:
        """Replace the cloud by a frame of a depth camera.

        Args:
            points: (n, 3) points in the camera's frame [m].
            pose: (4, 4) camera to the base of the robot; None if they coincide.
            at_s: Time of the frame [s].

        Raises:
            HplanError: The frame is refused, or the arm's state is unknown.
        """
        options = self.options
        joints = self.arm.configuration(self._clock())
        cloud = CloudOptions(
            growth_m=options.growth_m,
            arm_padding_m=options.arm_padding_m,
            allow_empty=options.allow_empty,
            max_lost=1.0 if options.allow_empty else 0.5,
            max_age_s=options.max_frame_age_s or None,
        )
        return self.planner.set_cloud(
            CLOUD, points, radius=options.radius_m, pose=pose, joints=joints, keep_s=options.keep_s, time_s=at_s,
            options=cloud,
        )  # fmt: skip

    def move(self, goal: Goal | None = None) -> Command:
        """Plan to a goal: from rest, or as a splice into the running motion.

        Args:
            goal: The goal; None for the last one.

        Raises:
            InputError: The arm is stopping, its state is unknown, or the controller has not answered the last motion.
            HplanError: Any error of `Planner.plan` and `Planner.replan`.
        """
        self._check_fault()
        now_s = self._clock()
        if self.is_pending:
            raise InputError("the controller has not answered the last motion yet")
        if self.sent is not None and self.sent.kind == "stop":
            raise InputError("the arm is stopping; plan again when it rests")
        before = self.planner.scene.goal
        if goal is not None:
            self.planner.aim(goal=goal)
        try:
            return self._from_rest(now_s) if self.sent is None else self._from_motion(self.sent, now_s)
        except HplanError:
            # The running motion still leads to the goal before.
            self.planner.aim(goal=before)
            raise

    def _from_motion(self, sent: Command, now_s: float) -> Command:
        if now_s + self.options.ahead_s >= sent.ends_s:
            raise InputError("the arm is about to end its motion; plan again when it rests")
        return self._splice(now_s) or sent

    def _from_rest(self, now_s: float) -> Command:
        here = self.arm.configuration(now_s)
        self.planner.aim(start=Start(joints_rad=tuple(here.tolist())))
        self.planner.options = self.planner.options.with_values(deadline_s=self.options.deadline_s)
        before = self.planner.last
        self.planner.plan(begins_s=now_s if self.planner.scene.moves else None)
        result = self.planner.set_start_time(self._clock() + self.options.lead_s)
        return self._send("motion", result, before)

    def react(self) -> Command | None:
        """Certify the running motion anew after a change; returns what replaces it.

        The motion is kept if it is still certified, and until the controller has answered it (None). Otherwise a new
        one takes over, or the arm stops.
        """
        now_s = self._clock()
        if self.sent is None or self.sent.kind == "stop" or self.is_pending:
            return None
        if self.fault:
            return self.stop(self.fault)
        try:
            return self._splice(now_s)
        except HplanError as error:
            return self.stop(error.message)

    def stop(self, reason: str = "requested") -> Command | None:
        """Stop on the path of the running motion; None if nothing runs."""
        sent, last = self.sent, self.planner.last
        if sent is None or sent.kind == "stop" or last is None:
            return None
        now_s = min(max(self._clock(), last.begins_s), last.begins_s + last.trajectory.duration)
        at_s = min(now_s + self.options.lead_s, last.begins_s + last.trajectory.duration)
        found: CertifiedMotion
        try:
            found = self.planner.stop_at(at_s, now=now_s, measured=self._measured(now_s))
        except NotOnMotionError:
            found = self.planner.stop_at(at_s, now=now_s)
        return self._send("stop", found, last, reason)

    def accept(self, number: int) -> None:
        """Note that the controller has accepted a command."""
        if self.sent is not None and self.sent.number == number:
            self._before, self.is_pending = _Belief(None, None), False

    def reject(self, number: int) -> Command | None:
        """Note that the controller has rejected a command; returns a stop if an older motion runs on.

        A rejected stop leaves the running motion: None, and `sent` is that motion.
        """
        if self.sent is None or self.sent.number != number:
            return None
        kind, self.sent, self.planner.last = self.sent.kind, self._before.command, self._before.last
        self._before, self.is_pending = _Belief(None, None), False
        return self.stop("the controller rejected the motion that should take over") if kind == "splice" else None

    def end(self, number: int) -> bool:
        """Note that a command has ended, well or not; False if another one has replaced it."""
        if self.sent is None or self.sent.number != number:
            return False
        self.sent, self.is_pending = None, False
        return True

    def _check_fault(self) -> None:
        if self.fault:
            raise InputError(self.fault)

    def _measured(self, now_s: float) -> FloatArray | None:
        """Configuration of the arm for a comparison with the running motion; None if it is unknown now."""
        try:
            return self.arm.configuration(now_s)
        except InputError:
            return None

    def _splice(self, now_s: float) -> Command | None:
        last = self.planner.last
        assert last is not None
        end_s = last.begins_s + last.trajectory.duration
        # Positions are as old as their message; the motion is compared with them at that time.
        seen_s = self.arm.seen_s()
        measured = self._measured(now_s) if last.begins_s <= seen_s <= end_s else None
        now_s = min(max(seen_s if measured is not None else now_s, last.begins_s), end_s)
        at_s = min(max(self._clock(), now_s) + self.options.ahead_s, end_s)
        # What is left of the time for sending.
        self.planner.options = self.planner.options.with_values(deadline_s=0.75 * self.options.ahead_s)
        found = self.planner.replan(at=at_s, now=now_s, measured=measured)
        if found.is_kept:
            return None
        if self._clock() >= found.begins_s + found.seam_s:
            self.planner.last = last
            raise InputError(
                f"the new motion was ready too late for its start at {found.begins_s + found.seam_s:.3f} s"
            )
        return self._send("splice", found, last)

    def _send(
        self, kind: Kind, found: PlanResult | CertifiedMotion, before: PlanResult | None, reason: str = ""
    ) -> Command:
        self._count += 1
        begins_s = 0.0 if math.isnan(found.begins_s) else found.begins_s
        command = Command(self._count, kind, found.trajectory, begins_s, found.certificate, reason)
        if not self.is_pending:
            self._before = _Belief(self.sent, before)
        self.sent, self.is_pending = command, True
        return command
