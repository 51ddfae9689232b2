"""Splices a new motion into a running one in the near future.

The running motion stays unchanged up to the seam, and is certified again among the current obstacles. The new motion
continues from the state at the seam (`hplan.planning.start_in_motion`): position, velocity and acceleration are
continuous there, because both motions contain that very sample.

Times in arguments are on the controller's clock, and so are the tracks of the scene; internally all times count from
the start of the running motion. The new motion is planned in the scene with times since the seam. The returned motion
is certified in the scene with times since its own start (`Scene.starting_at`), which it reports on the controller's
clock.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import number
from hplan.base.arrays import numbers
from hplan.certificate.certificate import (
    Certificate,
    all_of,
    certificate_of_part,
    rest_violations,
    with_violations,
)
from hplan.certificate.digests import Digests
from hplan.certificate.goal_contact import FruitContact
from hplan.certificate.moving_obstacles import checker_in_time
from hplan.certificate.retimed_certificate import CertifiedMotion, certified_from, map_to_retimed
from hplan.certificate.task_check import TASK_TOLERANCE
from hplan.collision.coal_scene import CoalScene
from hplan.collision.held_objects import holding
from hplan.errors import (
    HplanError,
    InputError,
    NotOnMotionError,
    PlanCancelledError,
    RunningMotionBlockedError,
    UnavoidableContactError,
)
from hplan.planning.in_time import without_moving
from hplan.planning.motion import require_certificate
from hplan.planning.options import PlanOptions
from hplan.planning.plan import solve_scene
from hplan.planning.problem import NO_MEMORY, Problem, SearchMemory
from hplan.planning.result import PlanResult
from hplan.planning.world import World
from hplan.scene.model import Scene, Start
from hplan.trajectory.trajectory import SAME_TIME, Phase, Retimed, Trajectory, join_trajectories, stop_motion


@dataclass(frozen=True, eq=False)
class SplicedResult(PlanResult):
    """A plan whose motion starts while the previous motion runs.

    Attributes:
        seam_s: Start of the new motion, from the start of the trajectory [s]; the trajectory's end if the motion is
            kept.
        is_kept: True if there is no new motion: the previous motion continues.
        is_improved: True if a faster motion near the one that runs was searched.
    """

    seam_s: float = 0.0
    is_kept: bool = False
    is_improved: bool = False


def _state_at(trajectory: Trajectory, row: int) -> Start:
    """The state at a sample as the start of a scene."""
    return Start(
        joints_rad=tuple(trajectory.position[row].tolist()),
        velocity_rad_s=tuple(trajectory.velocity[row].tolist()),
        acceleration_rad_s2=tuple(trajectory.acceleration[row].tolist()),
    )


def _shift_certificate(certificate: Certificate, time_s: float) -> Certificate:
    """Return the certificate with all times counted from a time [s].

    Contacts that end before that time are dropped.
    """
    nearest_s, clear_until_s = (
        None if when is None else when - time_s for when in (certificate.nearest_s, certificate.clear_until_s)
    )
    contacts = tuple(contact.starting_at(time_s) for contact in certificate.contacts if contact.end_s >= time_s)
    return replace(certificate, nearest_s=nearest_s, clear_until_s=clear_until_s, contacts=contacts)


class RunningMotion:
    """A running motion among the current obstacles.

    Attributes:
        row: Index of the last sample at or before now.
        begins_s: Time of that sample since the start of the motion [s].
    """

    def __init__(
        self,
        plan: PlanResult,
        scene: Scene,
        options: PlanOptions,
        now: float | None,
        measured: ArrayLike | None,
        memory: SearchMemory = NO_MEMORY,
    ) -> None:
        """Take over a running motion now.

        Args:
            plan: Plan of the running motion.
            scene: Current obstacles and task; its tracks are on the controller's clock.
            options: Planning options.
            now: Time on the controller's clock [s]; None for the start of the motion.
            measured: (dof,) current configuration of the arm; None to assume that it is on the motion.
            memory: What earlier searches found, as for `Problem`.

        Raises:
            InputError: The start time of the motion is unknown, or `measured` is not a configuration.
            NotOnMotionError: The arm is not on the motion.
            OptionError: `now` is before or after the motion.
        """
        if math.isnan(plan.begins_s):
            raise InputError(
                "the start time of the running motion is unknown: give plan(begins_s=), or call set_start_time(at_s) "
                "afterwards"
            )
        time, scene = plan.trajectory.time, scene.starting_at(plan.begins_s)
        self.plan, self._scene, self._options, self._memory = plan, scene, options, memory
        self._robot = holding(plan.robot, scene.attached)
        # Clocks of controllers are sums of small steps, and may be large numbers.
        self._same_s = SAME_TIME + 4.0 * math.ulp(plan.begins_s)
        self._now = 0.0 if now is None else self._since_begin("now", now, 0.0)
        if measured is not None:
            self._check_measured(measured)
        self.row = max(int(np.searchsorted(time, self._now + self._same_s, side="right")) - 1, 0)
        self.begins_s = float(time[self.row])
        # Contact is allowed with the fruits that existed at planning time, not with different ones of the same names.
        self._contacts = tuple(each for each in plan.certificate.contacts if each.is_with(scene.fruits))

    @cached_property
    def _world(self) -> World:
        """The arm among the obstacles that do not move."""
        scene = self._scene
        still = without_moving(scene.starting_at(self.begins_s)) if scene.moves else scene
        return World.of_scene(self._robot, still, self._options)

    @cached_property
    def _checker(self) -> CoalScene:
        """Collision checker of the arm among all obstacles."""
        scene, options = self._scene, self._options
        return checker_in_time(self._robot, scene, options.sigmas) if scene.moves else self._world.checker

    def _since_begin(self, option: str, value: float, low: float) -> float:
        """Convert a controller time to one since the motion's start.

        Raises:
            OptionError: The result is before `low` or after the end of the motion [s].
        """
        began_s, end = self.plan.begins_s, self.plan.trajectory.duration
        expected = (
            f"a time from {began_s + low:.10g} s to {began_s + end:.10g} s on the controller's clock, on which the "
            f"running motion began at {began_s:.10g} s"
        )
        within = low - self._same_s, end + self._same_s
        number(option, value, expected, lambda time: within[0] <= time - began_s <= within[1])
        return min(max(value - began_s, 0.0), end)

    def _check_measured(self, measured: ArrayLike) -> None:
        """Refuse an arm that is off the motion.

        The tolerance is the tracking error that certificates cover.
        """
        robot = self._robot
        q, velocity, _ = self.plan.trajectory.state_at(self._now)
        found = np.asarray(robot.turned_near(numbers("measured", measured, (robot.dof,)), q), dtype=np.float64)
        off, covered = np.abs(found - q), self._options.certified_tracking.deviations(velocity)
        joint = int((off - covered).argmax())
        if off[joint] > covered[joint] + TASK_TOLERANCE:
            at_s = self.plan.begins_s + self._now
            unit = robot.units[joint].position
            raise NotOnMotionError(robot.joint_names[joint], float(off[joint]), float(covered[joint]), at_s, unit)

    def splice(self, at: float) -> SplicedResult:
        """Splice a new motion into the running one, or keep it.

        The new motion starts at the first sample at or after `at`, on the controller's clock [s].

        Raises:
            OptionError: `at` is before now or after the end of the motion.
            RunningMotionBlockedError: The running motion is not collision-free until then, or cannot be left without
                contact.
            HplanError: Any error of `hplan.plan`.
        """
        time = self.plan.trajectory.time
        seam = int(np.searchsorted(time, self._since_begin("at", at, self._now) - self._same_s))
        self._world.check_base()
        kept: SplicedResult | None = None
        if self._may_stay():
            certificate = self._certificate_until(self.plan.trajectory.samples - 1, rest=True, measured=False)
            if certificate.verified:
                kept = self._keep(certificate)
                if not self._may_be_faster:
                    return kept
        until = self._certificate_until(seam)
        if not until.verified:
            raise self._takeover_error(until.violations)
        scene = self._scene.starting_at(float(time[seam])).copy_unchecked(
            {"start": _state_at(self.plan.trajectory, seam)}
        )

        def stop() -> Trajectory:
            if kept is not None:
                return self.plan.trajectory.cut_before(seam)
            return stop_motion(self.plan.trajectory, float(time[seam]), self._robot).trajectory.cut_before(seam)

        problem = replace(Problem.from_scene(self._robot, scene, self._options), memory=self._memory)
        try:
            new = solve_scene(problem, stop=stop, at_once=None if kept is None else False)
        except HplanError as error:
            if kept is not None and not isinstance(error, PlanCancelledError):
                return kept
            if isinstance(error, UnavoidableContactError):
                raise self._takeover_error(error.reasons) from error
            raise
        if kept is None:
            return self._join(seam, until, new)
        least_gain_s = 1.0 / self._options.rate_hz
        is_faster = time[seam] + new.trajectory.duration < time[-1] - least_gain_s
        return replace(self._join(seam, until, new) if is_faster else kept, is_improved=True)

    def stop_at(self, t: float) -> CertifiedMotion:
        """Return the fastest stop on the motion's path, certified from now on.

        It starts at the first sample at or after `t`, on the controller's clock [s].
        """
        return self._stop_at(self._since_begin("t", t, self._now))

    def _stop_at(self, t: float) -> CertifiedMotion:
        """Return the stop that starts a time after the motion's start."""
        if self._is_certified:
            return self.plan.stop_at(t)  # on the same path, among the same obstacles
        retimed = stop_motion(self.plan.trajectory, t, self._robot)
        motion = retimed.trajectory
        certificate = self._certificate(retimed, min(self.row, motion.samples - 1), rest=True)
        certificate = replace(certificate, digests=Digests(self._robot, self._scene, motion))
        parts_s = float(motion.time[retimed.row])
        robot, begins_s = self._robot, self.plan.begins_s
        return CertifiedMotion(
            motion, certificate, parts_s, retimed.off_path_m, robot, self._scene, retimed.clock, begins_s
        )

    @property
    def _is_certified(self) -> bool:
        """True if the running motion was certified among the current obstacles, which do not move."""
        plan, scene = self.plan, self._scene
        before, now = plan.motion.problem.options, self._options
        return (
            plan.certificate.verified
            and not scene.moves
            and (before.certified_tracking, before.sigmas) == (now.certified_tracking, now.sigmas)
            and plan.scene.surroundings == scene.surroundings
        )

    @property
    def _may_be_faster(self) -> bool:
        """True if the search for the running motion ended with the first one, and none has been searched near it.

        To joints among obstacles that do not move.
        """
        plan, scene = self.plan, self._scene
        is_improved = isinstance(plan, SplicedResult) and plan.is_improved
        return plan.problem.options.at_once and scene.goal.has_joints and not scene.moves and not is_improved

    def _may_stay(self) -> bool:
        """True if the motion solves the current task."""
        before, now = self.plan.scene, self._scene
        same = before.goal == now.goal and before.locked_joints == now.locked_joints
        same = same and before.attached == now.attached
        if before.goal_fruit is None or now.goal_fruit is None:
            return same and before.goal_fruit == now.goal_fruit
        return same and FruitContact(before.goal_fruit, 0.0, 0.0).is_with([now.goal_fruit])

    def _certificate_until(self, row: int, *, rest: bool = False, measured: bool = True) -> Certificate:
        """Certificate of the running motion from now on up to a sample, as of `_certificate`.

        Among obstacles that have not changed, it follows from the certificate of the whole.
        """
        cut, plan = Retimed.cut(self.plan.trajectory, row), self.plan
        span_s = self.begins_s, float(plan.trajectory.time[row])
        part = certificate_of_part(plan.certificate, *span_s) if self._is_certified else None
        if part is None:
            return self._certificate(cut, self.row, rest=rest, measured=measured)
        return self._complete(part, cut, rest=rest)

    def _certificate(self, retimed: Retimed, row: int, *, rest: bool = False, measured: bool = True) -> Certificate:
        """Certify a motion on the running path among the current obstacles.

        Samples from `row` on are certified; with `rest`, the motion must also end at rest. With `measured`, the minimum
        distance of a motion that fails is searched.
        """
        robot, among, tracking = self._robot, (self._scene, self._checker), self._options.certified_tracking
        found = certified_from(robot, among, self._contacts, retimed, row, tracking=tracking, measured=measured)
        return self._complete(found, retimed, rest=rest)

    def _complete(self, certificate: Certificate, retimed: Retimed, *, rest: bool) -> Certificate:
        """Certificate with the contacts of a motion on the running path and, with `rest`, a check of its end."""
        faults = rest_violations(self._robot, retimed.trajectory, {"ends": -1}) if rest else ()
        goal_contact = self.plan.certificate.goal_contact if self._contacts else None
        contacts = map_to_retimed(retimed, self._contacts)
        return replace(with_violations(certificate, faults), goal_contact=goal_contact, contacts=contacts)

    def _takeover_error(self, reasons: Sequence[str]) -> HplanError:
        """Return the error for a running motion that cannot be taken over.

        It carries the stop from now on if that is certified.
        """
        found, begins_s = self._stop_at(self.begins_s), self.plan.begins_s + self.begins_s
        certificate = _shift_certificate(found.certificate, self.begins_s)
        stop = found.trajectory.cut_before(self.row) if certificate.verified else None
        return RunningMotionBlockedError(reasons, stop, certificate, begins_s)

    def _keep(self, certificate: Certificate) -> SplicedResult:
        """Return the running motion from now on."""
        begins_s = self.begins_s
        phases = [
            Phase(phase.name, max(phase.start_s - begins_s, 0.0), max(phase.end_s - begins_s, 0.0))
            for phase in self.plan.phases
        ]
        left = self.plan.trajectory.cut_before(self.row)
        certificate = _shift_certificate(certificate, begins_s)
        return self._result(self.plan, phases, left, certificate, left.duration, is_kept=True)

    def _join(self, seam: int, until: Certificate, new: PlanResult) -> SplicedResult:
        """Return the running motion until the seam joined with the new one."""
        before = self.plan.trajectory.cut_after(seam).cut_before(self.row)
        seam_s = before.duration
        whole = join_trajectories([before, new.trajectory]) if before.samples > 1 else new.trajectory
        parts = _shift_certificate(until, self.begins_s), _shift_certificate(new.certificate, -seam_s)
        contacts = tuple(contact for part in parts for contact in part.contacts if contact.end_s > contact.begin_s)
        certificate = replace(all_of(parts), goal_contact=new.certificate.goal_contact, contacts=contacts)
        require_certificate(replace(new.motion.problem, options=self._options), certificate)
        phases = [phase.delay(seam_s) for phase in new.phases]
        phases[0] = replace(phases[0], start_s=0.0)
        return self._result(new, phases, whole, certificate, seam_s, is_kept=False)

    def _result(
        self,
        made: PlanResult,
        phases: Sequence[Phase],
        trajectory: Trajectory,
        certificate: Certificate,
        seam_s: float,
        *,
        is_kept: bool,
    ) -> SplicedResult:
        """Return a plan with another trajectory from the current state."""
        begins_s = self.begins_s
        state = _state_at(self.plan.trajectory, self.row)
        scene = self._scene.starting_at(begins_s).copy_unchecked({"start": state})
        trajectory = trajectory.copy_unchecked(trajectory.rows, takes_over_s=0.0)
        certificate = replace(certificate, digests=Digests(self._robot, scene, trajectory))
        transit = made.motion
        problem = replace(transit.problem, scene=scene, options=self._options)
        first = trajectory.cut_after(int(np.searchsorted(trajectory.time, phases[0].end_s - SAME_TIME)))
        motion = replace(transit, problem=problem, trajectory=first, certificate=certificate)
        values = {name: getattr(made, name) for name in PlanResult.__dataclass_fields__}
        values["is_improved"] = is_kept and isinstance(made, SplicedResult) and made.is_improved
        values |= {
            "trajectory": trajectory,
            "certificate": certificate,
            "phases": tuple(phases),
            "motion": motion,
            "bound": None,
            "begins_s": self.plan.begins_s + begins_s,
        }
        return SplicedResult(**values, seam_s=seam_s, is_kept=is_kept)
