"""Paths past what moves, and the quickest motion along one of them that is certified in space and time.

Paths are planned as if nothing moved that does (or, on a base that moves, among everything as it stands at first), and
around what is in the way when such a motion would meet it: around all that it sweeps meanwhile, and around where it is
then, at first and in the end. A motion along each of them is run as it is where that is certified, else in the earliest
timing through its cells of path and time (`hplan.planning.moving.schedule`): it waits at a clear place, slows down, or
goes at once, before the obstacle comes. The quickest that is certified is taken.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Generic, Protocol, TypeVar

import numpy as np

from hplan.base.arrays import Record
from hplan.base.deadline import TimeIsUpError
from hplan.certificate.certificate import Certificate, certify
from hplan.errors import (
    HplanError,
    MovingObstacleError,
    NotInTimeError,
    ObstacleInTimeError,
    PlanCancelledError,
    TimingError,
)
from hplan.planning.moving.obstacles_at import among_poses, without_moving
from hplan.planning.moving.path_in_time import MovingField, PathInTime
from hplan.planning.moving.schedule import STEP_S, Schedule, earliest_schedule, room_to_change
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.trajectory.trajectory import Phase, Retimed, Trajectory, scaled

#: So much earlier or later than scheduled the arm may be anywhere [s], tried in turn until a motion is certified.
SPARE_S: Final = (0.02, 0.06, 0.15)

#: A path around what moves is looked for within so much of the time at which it is in the way [s].
MEANWHILE_S: Final = 0.35

#: Longest motion of the scene that is planned around as one [s].
LONGEST_SWEPT_S: Final = 30.0

#: A motion that takes no more than so many times as long as one to which nothing is in the way needs no rival.
CLOSE: Final = 1.02


class StillPlan(Protocol):
    """A plan among obstacles of which none moves."""

    @property
    def trajectory(self) -> Trajectory:
        """The timed motion."""

    @property
    def phases(self) -> Sequence[Phase]:
        """Its parts."""


_Plan = TypeVar("_Plan", bound=StillPlan)


@dataclass(frozen=True, eq=False)
class InTime(Record, Generic[_Plan]):
    """A certified motion past what moves.

    Attributes:
        path: What its path avoids, in words.
        still: The plan as if nothing moved.
        retimed: The motion, on the path of the other; None where it is the same.
        schedule: How it is run; None where it is the same.
        certificate: What is shown of it.
    """

    path: str
    still: _Plan
    retimed: Retimed | None
    schedule: Schedule | None
    certificate: Certificate

    @property
    def trajectory(self) -> Trajectory:
        """The timed motion."""
        return self.still.trajectory if self.retimed is None else self.retimed.trajectory

    @property
    def phases(self) -> tuple[Phase, ...]:
        """Its parts."""
        return tuple(_later(phase, self.retimed) for phase in self.still.phases)

    @property
    def report(self) -> dict[str, Any]:
        """What was done about what moves, for the report of a plan."""
        until = self.certificate.clear_until_s
        return {
            "path": self.path,
            "waits_s": 0.0 if self.schedule is None else self.schedule.waiting_s,
            "slows_down": self.schedule is not None and self.schedule.slows_down,
            "at_full_speed_s": self.still.trajectory.duration,
            "clear_until_s": until,
        }


def quickest_in_time(
    robot: Robot, scene: Scene, options: PlanOptions, plan_still: Callable[[Scene], _Plan]
) -> InTime[_Plan]:
    """The quickest certified motion among obstacles of which some move.

    Args:
        robot: The arm.
        scene: The scene, and the task.
        options: How to plan.
        plan_still: Plans a scene in which nothing moves.

    Raises:
        MovingObstacleError: The fruit that is the goal moves, or a bound is asked for.
        ObstacleInTimeError: No motion was certified; names an obstacle and the time at which it is in the way.
        HplanError: As `plan_still`, of the scene without what moves.
    """
    if options.bound:
        raise MovingObstacleError(scene.first_moving, "bounds of durations take scenes in which nothing moves")
    for fruit in scene.fruits:
        if fruit.name == scene.goal.fruit and (fruit.track is not None or scene.base_track is not None):
            moving = None if fruit.track is None else fruit.name
            raise MovingObstacleError(moving, "a fruit to pick must not move, as seen from the base")
    search = _Search(robot, scene, options, plan_still)
    try:
        for path, among in search.paths():
            search.look_along(path, among)
    except (NotInTimeError, PlanCancelledError, TimeIsUpError):
        if search.best is None:
            raise  # else the best so far is the answer
    if search.best is None:
        raise ObstacleInTimeError(*search.in_the_way, search.tried)
    return search.best


class _Search(Generic[_Plan]):
    """Candidates so far.

    Attributes:
        best: The quickest that is certified; None for none.
        tried: What was tried, in words.
        in_the_way: What is in the way of the first path, and when.
    """

    def __init__(self, robot: Robot, scene: Scene, options: PlanOptions, plan_still: Callable[[Scene], _Plan]) -> None:
        self._robot, self._scene, self._options, self._plan_still = robot, scene, options, plan_still
        self._field = MovingField(robot, scene, sigmas=options.sigmas, tracking_error=options.tracking.still_rad)
        self.best: InTime[_Plan] | None = None
        self.tried: list[str] = []
        self.in_the_way: tuple[str | None, float | None] = None, None
        self._first: tuple[_Plan, Certificate] | None = None

    def paths(self) -> Iterator[tuple[str, Scene]]:
        """Scenes in which nothing moves whose motions are looked at, and what they are, in words."""
        scene = self._scene
        yield "the path without what moves", without_moving(scene)
        if self._first is None:
            return
        still, certificate = self._first
        if self.best is not None and self.best.trajectory.duration <= CLOSE * still.trajectory.duration:
            return
        duration = still.trajectory.duration
        when = min(certificate.nearest_s or 0.0, duration)
        end_s = min(duration + 0.5, LONGEST_SWEPT_S)
        yield "a path around all that it sweeps meanwhile", among_poses(scene, 0.0, end_s)
        yield (
            "a path around where it is when it is in the way",
            among_poses(scene, max(0.0, when - MEANWHILE_S), when + MEANWHILE_S),
        )
        yield "a path around where it is at first", among_poses(scene, 0.0, min(when, MEANWHILE_S))
        yield "a path around where it is in the end", among_poses(scene, scene.at_rest_s, scene.at_rest_s)

    def look_along(self, path: str, among: Scene) -> None:
        """Take the quickest motion along a path, if it is quicker than the best."""
        try:
            still = self._plan_still(among)
        except (NotInTimeError, PlanCancelledError):
            raise
        except HplanError as error:
            if self._first is None:
                raise
            self.tried.append(f"{path}: {error.message}")
            return
        certificate = self._certified(still, None)
        if self._first is None:
            self._first = still, certificate
            self.in_the_way = (
                (None if certificate.nearest is None else certificate.nearest.obstacle),
                certificate.nearest_s,
            )
        if certificate.verified:
            self._take(InTime(path, still, None, None, certificate))
            return
        for spare_s in SPARE_S:
            found = self._timed(path, still, spare_s)
            if found is None:
                self.tried.append(f"{path}: no timing that keeps {1e3 * spare_s:g} ms from what moves")
                return
            if found.certificate.verified:
                self._take(found)
                return
            self.tried.append(f"{path}: {found.certificate.violations[0]}")

    def _take(self, candidate: InTime[_Plan]) -> None:
        if self.best is None or candidate.trajectory.duration < self.best.trajectory.duration - 1e-9:
            self.best = candidate

    def _timed(self, path: str, still: _Plan, spare_s: float) -> InTime[_Plan] | None:
        """The earliest motion along a path with some time to spare; None where there is none."""
        motion = still.trajectory
        cells = PathInTime(motion, self._field, self._robot, step_s=STEP_S, spare_s=spare_s)
        room = room_to_change(motion, self._robot, len(cells.configurations))
        quicker_than_s = math.inf if self.best is None else self.best.trajectory.duration
        schedule = earliest_schedule(
            cells,
            motion.duration,
            room,
            at_rest_s=self._field.at_rest_s,
            at_rest=not self._scene.start.is_moving,
            quicker_than_s=quicker_than_s,
        )
        if schedule is None:
            return None
        try:
            retimed = scaled(motion, schedule.profile, self._robot)
        except TimingError:
            return None
        return InTime(path, still, retimed, schedule, self._certified(still, retimed))

    def _certified(self, still: _Plan, retimed: Retimed | None) -> Certificate:
        motion = still.trajectory if retimed is None else retimed.trajectory
        return certified_in_time(self._robot, self._scene, self._options, motion, direct=len(still.phases) == 1)


def certified_in_time(
    robot: Robot, scene: Scene, options: PlanOptions, motion: Trajectory, *,
    direct: bool = False, check_ends: bool = True,
) -> Certificate:  # fmt: skip
    """What is shown of a motion among what moves.

    Args:
        robot: The arm.
        scene: The scene, whose clock is the motion's.
        options: How to plan.
        motion: The motion.
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


def _later(phase: Phase, retimed: Retimed | None) -> Phase:
    """A phase of a motion that is run by another clock: it begins as late, and ends as early, as can be told."""
    if retimed is None:
        return phase
    clock, time = retimed.clock, retimed.trajectory.time
    begin = max(0, int(np.searchsorted(clock, phase.start_s + 1e-9, side="right")) - 1)
    end = int(np.searchsorted(clock, phase.end_s - 1e-9, side="left")) if phase.end_s < clock[-1] - 1e-9 else -1
    return Phase(phase.name, float(time[begin]) if phase.start_s > 0.0 else 0.0, float(time[end]))
