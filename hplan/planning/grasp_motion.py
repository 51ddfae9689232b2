"""A certified motion to one of several grasps: the promising ones first, all of them before any is refused.

And the approach to the grasp that is taken, and the retreat, from rest or out of the motion before and into the next.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.deadline import check_deadline
from hplan.certificate.certificate import Stretch, goal_contacts, stretches
from hplan.errors import CertificationError, ConfigurationInCollisionError, HplanError, TimingError
from hplan.optimization.minimize_time import Effort, minimize_time
from hplan.optimization.timed_spline import BoundaryState, TimedSpline
from hplan.planning.certified_motion import (
    Part,
    PlannedMotion,
    certificate_of,
    certified_trajectory,
    time_problem,
    timed,
)
from hplan.planning.effort import effort_of, optimization_of
from hplan.planning.find_motion import first_motion, without_path
from hplan.planning.grasps import SPARE, Grasp, Target, promising
from hplan.planning.refusals import Refusals
from hplan.planning.task import PlanningContext, PlanningTask
from hplan.planning.tool_paths import largest_standoff, tool_path
from hplan.robot.model import Robot
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.trajectory import Trajectory

_Last = TypeVar("_Last")

#: An approach that is in motion at the stand-off would begin at rest so much farther away, as a fraction of its length.
#: More lets it pass the stand-off faster, and gives the transit more to do. Where the transit comes to last longer by
#: more than this part of what approach and retreat save, less is tried next, else more.
LEADS, FIRST_LEAD, EATEN = (0.02, 0.05, 0.15, 0.3, 0.45), 2, 0.5

#: Beyond the stand-off obstacles are looked for at so many places.
LOOKS = 16

#: Where there is less room than this beyond the stand-off, the arm stops there [m].
LEAST_LEAD = 1e-3

#: So far the tool of an approach in motion may be off its straight line, looked at at so many times a row [m].
OFF_LINE, OFF_LOOKS = 1e-4, 4

#: A row at which the tool is as far from the grasp as the stand-off, but for this, is before it [m].
ROUNDING = 1e-9

#: By less than this no motion is quicker than another [s].
LEAST_GAIN_S = 1e-6

#: Finds a motion to one of several goals, or says why there is none to each.
FindMotion: TypeAlias = Callable[[Sequence[PlanningTask]], tuple[int, PlannedMotion] | Refusals]


def motion_to_grasp(
    target: Target,
    found: Sequence[Grasp],
    start: FloatArray,
    task_to: Callable[[Grasp], PlanningTask],
    last_of: Callable[[Grasp], _Last],
    find: FindMotion | None = None,
) -> tuple[Grasp, PlannedMotion, _Last]:
    """A grasp, the motion to where its approach begins, and what is made of the approach.

    The promising grasps are tried as if there were no others. Where none of them can be reached, one flood shows to
    which of the others no path exists, and those that are left are tried in their order. Grasps without an approach
    come after all those with one.

    Args:
        target: What is grasped.
        found: Its grasps, those that promise the shortest motions first.
        start: (dof,) configuration from which the arm comes.
        task_to: The motion to plan to a grasp; raises `ConfigurationInCollisionError` where it cannot be taken.
        last_of: What follows the motion to a grasp; raises `CertificationError` or `TimingError` where nothing can.
        find: Finds a motion to one of several grasps; `first_motion` where this is None.

    Raises:
        NoPathError: No path to any of the grasps exists on the grid.
        TimingError: No path can be timed.
        CertificationError: Not all grasps were shown to have no path, and no motion could be certified.
        ConfigurationInCollisionError: The start is in collision.
    """
    ordered: list[Grasp] = []
    refused: dict[int, HplanError] = {}
    for is_likely, batch in _batches(target, found, start):
        begin = len(ordered)
        ordered += batch
        tasks = _tasks(ordered, range(begin, len(ordered)), task_to, refused)
        if not is_likely and target.world.robot.planar is not None:  # of others there are no grids
            for number, error in zip(list(tasks), without_path(list(tasks.values())), strict=True):
                if error is not None:
                    refused[number] = error
                    del tasks[number]
        while tasks:
            numbers = list(tasks)
            result = (find or first_motion)(list(tasks.values()))
            if isinstance(result, Refusals):
                refused |= zip(numbers, result.errors, strict=True)
                break
            number, motion = numbers[result[0]], result[1]
            try:
                return ordered[number], motion, last_of(ordered[number])
            except (CertificationError, TimingError) as error:
                refused[number] = error.with_traceback(None)
                del tasks[number]
    raise _refusal(target, ordered, [refused[number] for number in range(len(ordered))])


def _refusal(target: Target, ordered: Sequence[Grasp], errors: Sequence[HplanError]) -> HplanError:
    """The one error for all grasps; where they have little room it says how little."""
    refusal = Refusals(tuple(errors)).error(f"grasps of {target.what}")
    room = max(grasp.room for grasp in ordered)
    if room < SPARE:
        remark = (
            f"spare clearance {1e3 * room:.2g} mm at the grasp; with {1e3 * SPARE:g} mm there would be room to move"
        )
        refusal.add(remark, spare_clearance_m=room, needed_clearance_m=SPARE)
    return refusal


def _batches(target: Target, found: Sequence[Grasp], start: FloatArray) -> Iterator[tuple[bool, list[Grasp]]]:
    """Grasps to try together, those with an approach before those without; and whether they are the promising ones."""
    for batch in ([grasp for grasp in found if grasp.distance > 0.0], [grasp for grasp in found if not grasp.distance]):
        likely = promising(batch, target, start)
        first = {id(grasp) for grasp in likely}
        yield True, likely
        yield False, [grasp for grasp in batch if id(grasp) not in first]


def _tasks(
    ordered: Sequence[Grasp], batch: range, task_to: Callable[[Grasp], PlanningTask], refused: dict[int, HplanError]
) -> dict[int, PlanningTask]:
    """The motions to plan, by the numbers of their grasps; grasps that cannot be taken are noted as refused."""
    tasks = {}
    for number in batch:
        try:
            tasks[number] = task_to(ordered[number])
        except ConfigurationInCollisionError as error:
            if error.which == "start":
                raise
            refused[number] = error.with_traceback(None)
    return tasks


def approach_and_retreat(context: PlanningContext, target: Target, grasp: Grasp) -> list[Part]:
    """The approach to a grasp and, from a fruit, the retreat, timed and certified; nothing without an approach.

    The last link may touch the fruit (`hplan.certificate.goal_contact`).

    Raises:
        TimingError: There is none within the limits.
        CertificationError: It is asked for, and something was not shown.
    """
    path = grasp.path(context.robot, context.scene.locked_joints)
    if path is None:
        return []
    there, shown = certified_trajectory(
        context.among(target.world_touching), path, lambda there: _contact_stretches(context, target, there)
    )
    approach = Part("approach", there, shown)
    return [approach] if target.fruit is None else [approach, retreat_of(approach)]


def retreat_of(approach: Part) -> Part:
    """An approach backwards: accelerations and torques stay as they are, and so do all the distances."""
    return approach.reversed._replace(name="retreat")


def _contact_stretches(context: PlanningContext, target: Target, approach: Trajectory) -> list[Stretch]:
    """What an approach is certified among: the last link may touch the fruit while it moves straight."""
    contacts = () if target.fruit is None else goal_contacts(context.robot, approach, target.fruit, "approach")
    return stretches(target.world.checker, approach.time, contacts)


@dataclass(frozen=True, eq=False)
class Pick:
    """A grasp with its approach from rest, and approaches to it that are in motion at the stand-off.

    Attributes:
        context: The arm among its obstacles, and options.
        target: What is grasped.
        grasp: How.
        approach: The approach that begins at rest.
    """

    context: PlanningContext
    target: Target
    grasp: Grasp
    approach: Part
    _known: dict[float, Trajectory | None] = field(init=False, default_factory=dict)
    _shown: dict[int, Part | None] = field(init=False, default_factory=dict)

    @cached_property
    def farthest(self) -> float:
        """From where the tool can come straight and clear, at most `LEADS` beyond the stand-off [m]."""
        grasp, context, locked = self.grasp, self.context, self.context.scene.locked_joints
        longest = (1.0 + LEADS[-1]) * grasp.distance
        possible = largest_standoff(context.robot, grasp.goal, longest, locked, grasp.keeps_turn)
        if possible <= grasp.distance:
            return grasp.distance
        check_deadline()
        path = tool_path(context.robot, grasp.goal, possible, locked, grasp.keeps_turn)
        away = np.linspace(grasp.distance, possible, LOOKS)
        field = self.target.transit_world(grasp).field
        touching = np.flatnonzero(field.along(path.evaluate((1.0 - away / possible) * path.end)).min(axis=1) < 0.0)
        return float(away[max(0, touching[0] - 1)]) if len(touching) else possible

    def passing(self, lead: float) -> Trajectory | None:
        """The approach that is in motion where it passes the stand-off; None where there is none.

        It is the last part of one that begins at rest farther away. So it passes the stand-off at a speed that the arm
        can reach on a straight line, and on this line all joints can keep their limits; the motion there need not.

        Args:
            lead: How much farther away, as a fraction of the approach.
        """
        longer = min(self.farthest, (1.0 + lead) * self.grasp.distance)
        if longer not in self._known:
            self._known[longer] = self._passing(longer)
        return self._known[longer]

    def certified(self, passing: Trajectory) -> Part | None:
        """An approach in motion with its certificate; None where it is not verified."""
        if id(passing) not in self._shown:
            context = self.context.among(self.target.world_touching)
            among = _contact_stretches(context, self.target, passing)
            shown = certificate_of(context, passing, among, rest_to_rest=False)
            self._shown[id(passing)] = Part("approach", passing, shown) if shown.verified else None
        return self._shown[id(passing)]

    def _passing(self, longer: float) -> Trajectory | None:
        """The approach of which the whole has a length [m]."""
        context, grasp = self.context.among(self.target.world_touching), self.grasp
        if longer < grasp.distance + LEAST_LEAD:
            return None
        path = tool_path(context.robot, grasp.goal, longer, context.scene.locked_joints, grasp.keeps_turn)
        try:
            whole = timed(context, path)
        except TimingError:
            return None
        check_deadline()
        tool = context.robot.tool_positions(whole.position)
        beyond = np.linalg.norm(tool - tool[-1], axis=1) >= grasp.distance - ROUNDING
        there = whole.since(int(np.flatnonzero(beyond)[-1]))
        return there if _off_line(context.robot, there, grasp) <= OFF_LINE else None


def _off_line(robot: Robot, approach: Trajectory, grasp: Grasp) -> float:
    """How far the tool leaves the straight line between stand-off and grasp, at rows and between them [m]."""
    clock = np.linspace(0.0, approach.duration, OFF_LOOKS * (approach.samples - 1) + 1)
    tip, standoff = robot.tool_positions(np.stack([grasp.goal, grasp.standoff]))
    line = standoff - tip
    away = robot.tool_positions(approach.positions(clock)) - tip
    away -= (away @ line / (line @ line))[:, None] * line
    return float(np.linalg.norm(away, axis=1).max())


class Flow(NamedTuple):
    """A transit that is in motion at a stand-off, and what is before and after it.

    Attributes:
        retreat: The retreat before it; None where the transit begins at rest.
        transit: The transit.
        path: Its curve.
        approach: The approach after it; None where the transit ends at rest.
    """

    retreat: Part | None
    transit: Part
    path: SplinePath
    approach: Part | None


def flowing(task: PlanningTask, transit: Part, before: Pick | None, after: Pick | None) -> Flow | None:
    """The quickest motion without a stop at the stand-offs; None where the one with stops is as quick.

    Args:
        task: What is asked of the transit.
        transit: The transit from rest to rest.
        before: From where the arm retreats before it; None where the transit begins at rest.
        after: What it approaches after it; None where the transit ends at rest.
    """
    if optimization_of(task) is None or transit.trajectory.samples == 1:
        return None
    picks = before, after
    stopping = [0.0 if pick is None else pick.approach.trajectory.duration for pick in picks]
    limit = transit.trajectory.duration + sum(stopping) - LEAST_GAIN_S
    found: list[tuple[float, _Draft]] = []
    number, direction = FIRST_LEAD, 0
    passing: list[Trajectory | None] = []
    effort = effort_of(task)
    for _ in range(effort.leads):
        check_deadline()
        known = passing
        passing = [None if pick is None else pick.passing(LEADS[number]) for pick in picks]
        if known and all(one is other for one, other in zip(known, passing, strict=True)):
            break  # there is no more room beyond the stand-offs
        draft = _draft(task, transit.trajectory, passing, effort.blended)
        if draft is not None:
            saved = sum(stop - part.duration for stop, part in zip(stopping, passing, strict=True) if part is not None)
            seconds = draft.spline.duration + sum(stopping) - saved
            if found and seconds > found[-1][0] - LEAST_GAIN_S:
                break
            found.append((seconds, draft))
            direction = direction or (1 if limit - seconds > EATEN * saved else -1)
            if direction > 0 and None in picks and task.options.effort != "best":
                break  # with one stand-off there is little more to gain
        number += direction or -1
        if number not in range(len(LEADS)):
            break
    for seconds, draft in reversed(found):  # the quickest first
        if seconds > limit:
            break
        flow = _certified(task, transit.name, draft, picks)
        if flow is not None:
            return flow
    return None


def _certified(task: PlanningTask, name: str, draft: _Draft, picks: Sequence[Pick | None]) -> Flow | None:
    """The motions of a draft with their certificates; None where one is not verified."""
    shown: list[Part | None] = []
    for pick, passing in zip(picks, draft.passing, strict=True):
        shown.append(None if pick is None or passing is None else pick.certified(passing))
        if shown[-1] is None and passing is not None:
            return None
    trajectory = draft.spline.trajectory(task.robot.dynamics, task.options.rate_hz)
    certificate = certificate_of(task, trajectory, rest_to_rest=False)
    if not certificate.verified:
        return None
    leaving, coming = shown
    retreat = None if leaving is None else retreat_of(leaving)
    return Flow(retreat, Part(name, trajectory, certificate), draft.spline.path, coming)


class _Draft(NamedTuple):
    """A transit that begins or ends in motion, and the approaches, that before it backwards, that it is between."""

    spline: TimedSpline
    passing: Sequence[Trajectory | None]


def _draft(
    task: PlanningTask, transit: Trajectory, passing: Sequence[Trajectory | None], effort: Effort
) -> _Draft | None:
    """The fastest motion near a transit between approaches in motion, at rest without one; None where none is found."""
    leaving, coming = passing
    if leaving is None and coming is None:
        return None
    first, last = (BoundaryState.at_rest(transit.position[end]) for end in (0, -1))
    if leaving is not None:
        first = BoundaryState.of_row(leaving.reversed, -1)
    if coming is not None:
        last = BoundaryState.of_row(coming, 0)
    with task.stage("timing"):
        spline = minimize_time(transit, time_problem(task, transit, (first, last)), effort)
    return None if spline is None else _Draft(spline, passing)
