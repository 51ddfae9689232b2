"""Ever quicker plans past what moves, certified in space and time.

Paths are planned as if nothing moved that does (or, on a base that moves, among everything as it stands at first), and
around what is in the way when such a motion would meet it: around all that it sweeps meanwhile, and around where it is
then, at first and in the end. A motion along each of them is run as it is where that is certified, else in the earliest
timing through its cells of path and time (`hplan.planning.moving.schedule`): it waits at a clear place, slows down, or
goes at once, before the obstacle comes. A start in motion is brought to rest first where there is none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from hplan.certificate.certificate import Certificate, certify
from hplan.certificate.start_state import start_state
from hplan.errors import HplanError, MovingObstacleError, ObstacleInTimeError, TimingError
from hplan.planning.motion import Motion, Plan, best_of
from hplan.planning.moving.obstacles_at import among_poses, without_moving
from hplan.planning.moving.path_in_time import MovingField, PathInTime
from hplan.planning.moving.schedule import STEP_S, earliest_schedule, room_to_change
from hplan.planning.options import PlanOptions
from hplan.planning.start_in_motion import after_stop, stops
from hplan.robot.model import Robot
from hplan.scene.model import Scene, Start
from hplan.trajectory.trajectory import Phase, Retimed, Trajectory, joined, scaled

#: Ever quicker plans of a scene, whether anything moves in it or not.
PlansOf: TypeAlias = Callable[[Scene], Iterator[Plan]]


def plans_in_time(
    robot: Robot, scene: Scene, options: PlanOptions, plans_of: PlansOf, stop: Trajectory | None = None
) -> Iterator[Plan]:
    """Ever quicker certified plans among obstacles of which some move.

    Args:
        scene: The scene, and the task.
        stop: How a start in motion might be brought to rest, in addition to what is tried anyway; None for none.

    Raises:
        MovingObstacleError: The fruit that is the goal moves, or a bound is asked for.
        ObstacleInTimeError: No motion was certified; names an obstacle and the time at which it is in the way.
        HplanError: As `plans_of`, of the scene without what moves.
    """
    if options.bound:
        raise MovingObstacleError(scene.first_moving, "bounds of durations take scenes in which nothing moves")
    for fruit in scene.fruits:
        if fruit.name == scene.goal.fruit and (fruit.track is not None or scene.base_track is not None):
            moving = None if fruit.track is None else fruit.name
            raise MovingObstacleError(moving, "a fruit to pick must not move, as seen from the base")
    try:
        yield from _Search(robot, scene, options, plans_of).plans()
    except ObstacleInTimeError:
        state = start_state(robot, scene)
        if state is None:
            raise
        yield after_stop(
            stops(robot, state, 1.0 / options.rate_hz, stop),
            lambda motion: certified_in_time(robot, scene, options, motion, check_ends=False),
            lambda stopped: stopping_first(robot, scene, options, plans_of, stopped),
        )


def stopping_first(robot: Robot, scene: Scene, options: PlanOptions, plans_of: PlansOf, stop: Motion) -> Plan | None:
    """A stop and a plan from its end, where what moves is as it is then; None where it is not verified as a whole."""
    stop_s = stop.trajectory.duration
    rest = Start(joints_rad=tuple(stop.trajectory.position[-1].tolist()))
    plan = best_of(plans_of(scene.since(stop_s).copy_unchecked({"start": rest})))
    later, trajectory, _ = plan.whole
    first, *others = (phase.later(stop_s) for phase in later)
    phases = (replace(first, start_s=0.0), *others)
    trajectory = joined([stop.trajectory, trajectory])
    certificate = certified_in_time(robot, scene, options, trajectory, direct=len(phases) == 1)
    told = {**plan.told, "stops_until_s": stop_s}
    return _run(plan, scene, (phases, trajectory, certificate), told) if certificate.verified else None


def certified_in_time(
    robot: Robot, scene: Scene, options: PlanOptions, motion: Trajectory, *,
    direct: bool = False, check_ends: bool = True,
) -> Certificate:  # fmt: skip
    """What is shown of a motion among what moves.

    Args:
        scene: The scene, whose clock is the motion's.
        direct: Whether a fruit may be touched all the time: there is no approach.
        check_ends: Whether it is a whole motion, not a stop, which need not get to the goal.
    """
    return certify(
        robot,
        scene,
        motion,
        tracking_error=options.tracking_error,
        tracking_delay_s=options.tracking_delay_s,
        sigmas=options.sigmas,
        goal_contact="motion" if direct else "approach",
        check_ends=check_ends,
    )


class _Search:
    """What was looked at so far.

    Attributes:
        best_s: Duration of the quickest plan that is certified.
        tried: What was tried, in words.
        first: The first plan as if nothing moved, and what is shown of it among what moves.
    """

    def __init__(self, robot: Robot, scene: Scene, options: PlanOptions, plans_of: PlansOf) -> None:
        self._robot, self._scene, self._options, self._plans_of = robot, scene, options, plans_of
        self._field = MovingField(robot, scene, sigmas=options.sigmas, tracking_error=options.tracking.still_rad)
        self.best_s = math.inf
        self.tried: list[str] = []
        self.first: tuple[Plan, Certificate] | None = None

    def plans(self) -> Iterator[Plan]:
        """Certified plans, each quicker than the one before.

        Raises:
            ObstacleInTimeError: There is none.
        """
        for path, among in self._scenes():
            try:
                stills = self._plans_of(among)
                for still in stills if self._options.deadline_s is not None else [best_of(stills)]:
                    plan = self._past(path, still)
                    if plan is not None and plan.duration < self.best_s - 1e-9:
                        self.best_s = plan.duration
                        yield plan
            except HplanError as error:
                if self.first is None:
                    raise
                self.tried.append(f"{path}: {error.message}")
        if math.isinf(self.best_s) and self.first is not None:
            certificate = self.first[1]
            obstacle = None if certificate.nearest is None else certificate.nearest.obstacle
            raise ObstacleInTimeError(obstacle, certificate.nearest_s, self.tried)

    def _scenes(self) -> Iterator[tuple[str, Scene]]:
        """Scenes in which nothing moves whose motions are looked at, and what they are, in words."""
        scene = self._scene
        yield "the path without what moves", without_moving(scene)
        # One hardly longer than that to which nothing is in the way needs no alternative.
        if self.first is None or self.best_s <= 1.02 * self.first[0].duration:
            return
        duration = self.first[0].duration
        when = min(self.first[1].nearest_s or 0.0, duration)
        # Longest motion of the scene that is planned around as one [s].
        end_s = min(duration + 0.5, 30.0)
        yield "a path around all that it sweeps meanwhile", among_poses(scene, 0.0, end_s)
        # A path around what moves is looked for within so much of the time at which it is in the way [s].
        meanwhile_s = 0.35
        yield (
            "a path around where it is when it is in the way",
            among_poses(scene, max(0.0, when - meanwhile_s), when + meanwhile_s),
        )
        yield "a path around where it is at first", among_poses(scene, 0.0, min(when, meanwhile_s))
        yield "a path around where it is in the end", among_poses(scene, scene.at_rest_s, scene.at_rest_s)

    def _past(self, path: str, still: Plan) -> Plan | None:
        """The quickest certified motion along a path; None where there is none."""
        phases, motion, _ = still.whole
        certificate = self._certified(still, motion)
        if self.first is None:
            self.first = still, certificate
        report = {"path": path, "waits_s": 0.0, "slows_down": False, "at_full_speed_s": motion.duration}
        if certificate.verified:
            return _run(still, self._scene, (phases, motion, certificate), report)
        # So much earlier or later than scheduled the arm may be anywhere [s].
        for spare_s in (0.02, 0.06, 0.15):
            cells = PathInTime(motion, self._field, step_s=STEP_S, spare_s=spare_s)
            schedule = earliest_schedule(
                cells,
                motion.duration,
                room_to_change(motion, self._robot, len(cells.configurations)),
                at_rest_s=self._field.at_rest_s,
                at_rest=not self._scene.start.is_moving,
                quicker_than_s=self.best_s,
            )
            try:
                retimed = None if schedule is None else scaled(motion, schedule.profile, self._robot)
            except TimingError:
                retimed = None
            if schedule is None or retimed is None:
                self.tried.append(f"{path}: no timing that keeps {1e3 * spare_s:g} ms from what moves")
                return None
            certificate = self._certified(still, retimed.trajectory)
            if certificate.verified:
                report |= {"waits_s": schedule.waiting_s, "slows_down": schedule.slows_down}
                phases = tuple(_later(phase, retimed) for phase in phases)
                return _run(still, self._scene, (phases, retimed.trajectory, certificate), report)
            self.tried.append(f"{path}: {certificate.violations[0]}")
        return None

    def _certified(self, still: Plan, motion: Trajectory) -> Certificate:
        return certified_in_time(self._robot, self._scene, self._options, motion, direct=not still.others)


def _run(
    plan: Plan, scene: Scene, run: tuple[tuple[Phase, ...], Trajectory, Certificate], told: Mapping[str, Any]
) -> Plan:
    """A plan as it is run in a scene in which something moves."""
    transit = replace(plan.transit, problem=replace(plan.transit.problem, scene=scene))
    return replace(plan, transit=transit, run=run, told={**told, "clear_until_s": run[2].clear_until_s})


def _later(phase: Phase, retimed: Retimed) -> Phase:
    """A phase of a motion that is run by another clock: it begins as late, and ends as early, as can be told."""
    clock, time = retimed.clock, retimed.trajectory.time
    begin = max(0, int(np.searchsorted(clock, phase.start_s + 1e-9, side="right")) - 1)
    end = int(np.searchsorted(clock, phase.end_s - 1e-9, side="left")) if phase.end_s < clock[-1] - 1e-9 else -1
    return Phase(phase.name, float(time[begin]) if phase.start_s > 0.0 else 0.0, float(time[end]))
