"""Motions of several arms on one clock.

`plan_cell` tries four ways. It returns the first result that is close to the minimum possible duration, otherwise the
fastest one:

1. each arm by itself, all at the same time;
2. the same motions, some with a delayed start, in the fastest order;
3. one arm after the other around the others at rest, where a blocking arm first moves aside; then each motion starts
   as soon as the others leave room;
4. all joints together, as of one robot: along that path or, without one, along any other.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final, TypeAlias

import numpy as np

from hplan.base.arguments import instance
from hplan.base.arrays import FloatArray
from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import (
    CertificationError,
    ConfigurationInCollisionError,
    HplanError,
    InputError,
    NotFoundError,
    NotInTimeError,
    PathInContactError,
    PlanCancelledError,
    TimingError,
)
from hplan.planning.finish import finish
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.planning.stages import Progress, no_progress
from hplan.planning.world import check_clear
from hplan.scene.model import Goal, Scene
from hplan.trajectory.trajectory import Trajectory, join_trajectories, stop_motion
from hplan.workcell.cell import Cell, CellResult, How, certify_cell, check_options, distances_between, iterate_standing
from hplan.workcell.timetable import SPARES, Timetable

#: Maximum number of orders to certify, fastest first.
_TRIED: Final = 3

#: The ways that come before a motion of all joints together, for messages.
_WAYS: Final = ("all at once", "one after the other", "around the others where they stand")

#: Between samples this far apart the path of a motion is taken as straight [s].
_ALONG_S: Final = 0.05

#: With more arms than this, each arm is tried once as the last instead of all orders, and all joints together are not
#: planned.
_ALL_ORDERS: Final = 4

#: Growth of arms at rest while others are planned around them [m]; none if start or goal would then be in contact.
_THICKER: Final = 1e-3

#: Maximum displacement of each joint for an arm that moves aside, tried in turn [rad, m], and the number of samples.
_ASIDE: Final = (0.3, 0.6, 1.2, 2.4)
_PLACES_ASIDE: Final = 128

#: Motions of arms, in an order in which they could be run one after the other.
Legs: TypeAlias = Sequence[tuple[str, Trajectory]]


def plan_cell(
    cell: Cell,
    options: PlanOptions | None = None,
    *,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> CellResult:
    """Plan the motions of all arms of a workcell.

    Args:
        cell: Arms, obstacles and tasks; arms without a goal stay at their starts.
        options: How to plan. The deadline holds for all arms together; without a motion by then planning fails.
        progress: Called with the name of each stage as it begins.
        cancel: As in `plan`.

    Raises:
        OptionError: An option has no meaning for several arms.
        HplanError: As in `plan`, for one arm or for all together; names the blocking obstacle or arm.
        NotFoundError: No motion of all arms was found; this does not prove that none exists.

    Examples:
        >>> from hplan import Cell, PlanOptions, load_robot, load_scene, plan_cell
        >>> from hplan.scene.cell import CellRobot, CellScene
        >>> robot, task = load_robot(), load_scene()
        >>> left = CellRobot(name="left", robot=robot.name, position=(0, 3, 0), start=task.start, goal=task.goal)
        >>> right = CellRobot(name="right", robot=robot.name, position=(0, -3, 0), start=task.start)
        >>> cell = Cell.from_robots(CellScene(name="pair", robots=(left, right)), {"left": robot, "right": robot})
        >>> result = plan_cell(cell, PlanOptions(effort="quick"))
        >>> result.how, result.certificate.verified
        ('at once', True)
    """
    instance("cell", cell, Cell, "load_cell")
    options = PlanOptions() if options is None else instance("options", options, PlanOptions)
    check_options(options, "motions of several arms")
    with time_limit(options.deadline_s, cancel) as limit:
        try:
            return _CellPlanner(cell, replace(options, deadline_s=None), progress).result()
        except TimeIsUpError:
            raise limit.error(["motions of all arms"]) from None


def replan_cell(
    result: CellResult,
    t: float,
    arm: str,
    goal: Goal | None = None,
    *,
    cancel: Cancel | None = None,
) -> CellResult:
    """Redirect one arm of a running motion; the others continue.

    The arm stops on its own path, is planned from there around the others at their final configurations, and starts as
    soon as they leave room. If this is not certified together with the motions of the others, all arms stop
    (`CellResult.stop_at`).

    Args:
        result: The running motion.
        t: The time of the change, on the clock of the motion [s].
        arm: Name of the arm.
        goal: Its new goal, in the workcell's frame; None to keep its goal, as after a delay.
        cancel: As in `hplan.plan`.

    Returns:
        The whole motion, unchanged up to `t`; if it is a stop, `stopped` names all arms.

    Raises:
        OptionError: `t` is before or after the motion.
        InputError: No arm has this name, or the goal is not valid for the arm.
        PlanCancelledError: Planning was cancelled.
        TimingError: No stop was found.
    """
    instance("result", result, CellResult, "plan_cell")
    cell = result.cell if goal is None else result.cell.with_goal(arm, instance("goal", goal, Goal))
    mover, options, running = cell.arm(arm), result.options, result.trajectories
    stop = stop_motion(running[arm], t, mover.robot)
    there = cell.start_at({name: motion.position[-1] for name, motion in (running | {arm: stop.trajectory}).items()})
    with time_limit(options.deadline_s, cancel) as limit:
        try:
            motion = _to_goal(there, arm, options)
            for spare in SPARES:
                table = Timetable(cell, options, spare)
                for name, own in running.items():
                    table.run(name, stop.trajectory if name == arm else own)
                if not table.set_out(arm, motion):
                    continue
                found = result.with_motion(cell, cell.join_motions(table.motions), {arm: stop}, check_ends=True)
                if found.certificate.verified:
                    return replace(found, later_s=result.later_s, stopped=())
        except HplanError as error:
            refused = isinstance(error, InputError) and not isinstance(error, ConfigurationInCollisionError)
            if refused or isinstance(error, PlanCancelledError):
                raise
        except TimeIsUpError:
            limit.check_cancelled()
    return result.stop_at(t)


class _CellPlanner:
    """One search for the motions of a workcell."""

    def __init__(self, cell: Cell, options: PlanOptions, progress: Progress) -> None:
        self._cell, self._options, self._progress = cell, options, progress
        self._alone: dict[str, PlanResult] = {}

    def result(self) -> CellResult:
        cell = self._cell
        _check_arms_apart(cell)
        for arm in cell.arms:
            if not arm.is_waiting:
                self._progress(f"arm {arm.name}")
                self._alone[arm.name] = plan(arm.robot, arm.scene, self._options)
        motions = {name: result.trajectory for name, result in self._alone.items()}
        if not motions:
            raise InputError("plan_cell: no arm of the cell has a goal")
        # Stop the search at a motion within 2 % of the longest motion alone.
        enough = 1.02 * max(motion.duration for motion in motions.values())
        self._progress("together")
        found = self._schedule(cell, _orders(motions))
        if found is None and len(cell.arms) > 1:
            self._progress("one after the other")
            legs = self._in_turn(motions)
            spares = () if legs is None else (*SPARES, math.inf)
            found = self._certify_first(
                cell, (_fill_timetable(cell, self._options, legs or (), spare) for spare in spares)
            )
        if found is not None and (found.trajectory.duration <= enough or len(motions) > _ALL_ORDERS):
            return found
        if found is None and len(motions) > _ALL_ORDERS:
            raise NotFoundError(_WAYS)
        self._progress("around each other")
        try:
            around = self._plan_together(found)
        except PlanCancelledError:
            raise
        except (HplanError, TimeIsUpError) as error:
            if found is None:
                raise (self._translate(error) if isinstance(error, HplanError) else error) from error
            around = None
        each = [result for result in (found, around) if result is not None]
        if not each:
            raise NotFoundError(_WAYS)
        return min(each, key=lambda result: round(result.trajectory.duration, 6))

    def _translate(self, error: HplanError) -> HplanError:
        """Translate an error of the joined robot for the workcell."""
        if isinstance(error, NotFoundError) and not isinstance(error, NotInTimeError):
            return NotFoundError([*_WAYS, *error.tried])
        # Other grasps might work; goals given as joints leave no alternative.
        chosen = any(result.grasp for result in self._alone.values())
        if chosen and isinstance(error, ConfigurationInCollisionError) and error.which == "goal":
            grasps = f"the grasps of each arm alone, with which {error.link!r} is in {error.obstacle!r}"
            return NotFoundError([*_WAYS, grasps])
        return error

    def _check(self, motion: Trajectory, how: How, later_s: Mapping[str, float]) -> CellResult:
        contact = {name: result.certificate.goal_contact or "approach" for name, result in self._alone.items()}
        certificate = certify_cell(self._cell, motion, self._options, goal_contact=contact)
        return CellResult(self._cell, motion, certificate, how, self._alone, later_s, self._options)

    def _schedule(self, cell: Cell, orders: Iterable[Legs], before: Trajectory | None = None) -> CellResult | None:
        """The certified schedule that finishes first, or None.

        Args:
            cell: The arms at the start of these motions.
            orders: The motions, in each order in which they may be scheduled.
            before: A motion of all joints that precedes them; None for none.
        """
        soonest: dict[tuple[float, ...], tuple[Legs, Timetable]] = {}
        for legs in orders:
            table = _fill_timetable(cell, self._options, legs, SPARES[0])
            if table is not None:
                begins = tuple(table.begins_s[name] for name in sorted(table.begins_s))
                soonest.setdefault(begins, (legs, table))
                if not any(begins):  # no schedule ends sooner
                    break
        for begins in sorted(soonest, key=lambda begins: (round(soonest[begins][1].duration, 6), begins))[:_TRIED]:
            legs, table = soonest[begins]
            wider = (_fill_timetable(cell, self._options, legs, spare) for spare in SPARES[1:])
            found = self._certify_first(cell, itertools.chain([table], wider), before)
            if found is not None:
                return found
        return None

    def _certify_first(
        self, cell: Cell, tables: Iterable[Timetable | None], before: Trajectory | None = None
    ) -> CellResult | None:
        """The motion of the first timetable that is certified, or None."""
        own = {id(result.trajectory) for result in self._alone.values()}
        for table in filter(None, tables):
            motion, later = cell.join_motions(table.motions), table.begins_s
            how: How = "one later" if any(later.values()) else "at once"
            if before is not None:
                motion = join_trajectories([before, motion])
            if before is not None or not all(id(leg) in own for legs in table.legs.values() for _, leg in legs):
                how = "around each other"
            result = self._check(motion, how, later)
            if result.certificate.verified:
                return result
        return None

    def _plan_together(self, found: CellResult | None) -> CellResult | None:
        """A motion of all joints together; None if it is not certified.

        It leads to the goals, or to the stand-offs of the grasps; the approaches follow.

        Args:
            found: A motion whose path is retimed; None to plan a new path.
        """
        cell = self._cell
        ends = {name: result.trajectory.position[-1] for name, result in self._alone.items()}
        reached = {name: result.grasp for name, result in self._alone.items() if result.grasp is not None}
        for name, grasp in reached.items():
            ends[name] = grasp.standoff
        task = cell.task(cell.configuration(ends))
        if not reached:
            if found is None:
                transit = plan(cell.robot, task, self._options)
            else:
                clock = np.append(np.arange(0.0, found.trajectory.duration, _ALONG_S), found.trajectory.duration)
                try:
                    transit = finish(cell.robot, task, found.trajectory.positions(clock), self._options)
                except (PathInContactError, CertificationError, TimingError):
                    return None  # segments between the samples are not clear
            result = self._check(transit.trajectory, "around each other", {})
            return result if result.certificate.verified else None
        transit, there = plan(cell.robot, task, self._options), cell.start_at(ends)
        approaches = ((name, there.arm(name)) for name in reached)
        motions = {name: plan(arm.robot, arm.scene, self._options).trajectory for name, arm in approaches}
        return self._schedule(there, _orders(motions), transit.trajectory)

    def _in_turn(self, alone: Mapping[str, Trajectory]) -> list[tuple[str, Trajectory]] | None:
        """Motions of one arm after another, among arms at rest, or None.

        An arm whose goal is blocked by another arm goes after it. If that arm cannot go first, or is already there, it
        moves aside and goes to its goal later.
        """
        legs: list[tuple[str, Trajectory]] = []
        waiting, put_behind, put_off = _likely_order(self._cell, alone), set[tuple[str, str]](), 0
        while waiting:
            name = waiting.pop(0)
            there = self._cell.start_at({done: motion.position[-1] for done, motion in legs})
            try:
                own = self._own(there, name, alone) if name not in dict(legs) else None
                motion = _to_goal(there, name, self._options) if own is None else own
            except PlanCancelledError:
                raise
            except HplanError as error:
                met = error.obstacle if isinstance(error, ConfigurationInCollisionError) else None
                owner = self._cell.arm_behind(met)
                blocking = owner if owner in alone else None
            else:
                legs.append((name, motion))
                put_off = 0
                continue
            if blocking in waiting and (name, blocking) not in put_behind:
                put_behind.add((name, blocking))
                waiting.insert(waiting.index(blocking) + 1, name)
            elif blocking is not None and len(legs) < 3 * len(alone):  # limits how often arms move aside
                pairs = [(blocking, name), *([(name, blocking)] if blocking in waiting else [])]
                for mover, other in pairs:
                    aside = self._move_aside(there, mover, other, alone[other].position[-1])
                    if aside is not None:
                        legs.append((mover, aside))
                        waiting = [other, *(each for each in waiting if each not in (mover, other)), mover]
                        break
                else:
                    return None
            elif put_off < len(waiting):
                put_off += 1
                waiting.append(name)
            else:
                return None
        return legs

    def _own(self, there: Cell, name: str, alone: Mapping[str, Trajectory]) -> Trajectory | None:
        """An arm's own motion; None if an arm at rest blocks it."""
        table = Timetable(there, self._options, SPARES[0])
        return alone[name] if table.set_out(name, alone[name]) else None

    def _move_aside(self, there: Cell, name: str, other: str, goal: FloatArray) -> Trajectory | None:
        """Move an arm to the nearest configuration that clears the others.

        It keeps clear of `other` at its goal, too. None if no such motion is found.
        """
        arm, chance = there.arm(name), np.random.default_rng(0)
        task = there.task(there.configuration({}))
        field = ClearanceField.build(there.robot, task.listed_solids, clearance=task.clearance)
        q = there.configuration({})
        enough = np.minimum(2.0 * _THICKER, 0.5 * field.clearance_along(q[None]))  # closer pairs may stay as close
        for far in _ASIDE:
            places = q[arm.joints] + far * chance.uniform(-1.0, 1.0, (_PLACES_ASIDE, arm.robot.dof))
            places = np.clip(places, arm.robot.lower, arm.robot.upper)
            whole = np.tile(q, (2 * _PLACES_ASIDE, 1))
            whole[:, arm.joints] = np.tile(places, (2, 1))
            whole[_PLACES_ASIDE:, there.arm(other).joints] = goal
            clear = (field.clearance_along(whole) > enough).all(axis=1).reshape(2, -1).all(axis=0)
            away = np.round(np.abs(places - q[arm.joints]).sum(axis=1), 6)
            for place in sorted(np.flatnonzero(clear).tolist(), key=lambda each: (away[each], each))[:_TRIED]:
                try:
                    return _to_goal(there, name, self._options, Goal(joints_rad=tuple(places[place].tolist())))
                except PlanCancelledError:
                    raise
                except HplanError:
                    continue
        return None


def _check_arms_apart(cell: Cell) -> None:
    """Refuse arms that are too close to each other at the start.

    Raises:
        ConfigurationInCollisionError: Two bodies of different arms touch, or are closer than the clearance; names both
            bodies with their arms, and the depth or distance.
    """
    checker = CoalScene(cell.robot, (), clearance=cell.scene.clearance)
    check_clear(checker, cell.configuration({}), "start")


def _to_goal(there: Cell, name: str, options: PlanOptions, goal: Goal | None = None) -> Trajectory:
    """An arm's motion to a goal, among the others at rest.

    Raises:
        HplanError: As in `plan`.
    """
    arm = there.arm(name)
    scene = arm.scene if goal is None else arm.scene.copy_unchecked({"goal": goal})
    options = replace(options, effort="quick", deadline_s=None)

    def scene_among(thicker: float) -> Scene:
        return scene.copy_unchecked({"obstacles": (*scene.obstacles, *iterate_standing(there, name, thicker))})

    try:
        return plan(arm.robot, scene_among(_THICKER), options).trajectory
    except ConfigurationInCollisionError:
        return plan(arm.robot, scene_among(0.0), options).trajectory


def _orders(motions: Mapping[str, Trajectory]) -> Iterator[Legs]:
    """The motions of all arms, in each order to be tried."""
    names = list(motions)
    orders: Iterable[Sequence[str]] = itertools.permutations(names) if len(names) <= _ALL_ORDERS else (
        [*(name for name in names if name != last), last] for last in names
    )  # fmt: skip
    return ([(name, motions[name]) for name in order] for order in orders)


def _fill_timetable(cell: Cell, options: PlanOptions, legs: Legs, spare: float) -> Timetable | None:
    """The timetable of motions in an order; None if infeasible."""
    table = Timetable(cell, options, spare)
    return table if all(table.set_out(name, motion) for name, motion in legs) else None


def _likely_order(cell: Cell, motions: Mapping[str, Trajectory]) -> list[str]:
    """The order in which the arms block each other least.

    The arms are compared at their starts and goals, and along their motions.
    """
    paths = {name: motion.positions(np.arange(0.0, motion.duration, _ALONG_S)) for name, motion in motions.items()}
    begins = {name: motion.position[:1] for name, motion in motions.items()}
    ends = {name: motion.position[-1:] for name, motion in motions.items()}

    def meet(first: str, path: FloatArray, second: str, place: FloatArray) -> int:
        q = cell.configuration({first: path, second: place})
        return int((distances_between(cell, q, first, (second,)) <= cell.scene.clearance + _THICKER).any())

    #: Cost of running the first of two arms before the second: contacts at its goal weigh more than contacts of a path.
    cost = {
        (a, b): len(motions) * meet(a, ends[a], b, begins[b])
        + meet(a, paths[a], b, begins[b])
        + meet(b, paths[b], a, ends[a])
        for a, b in itertools.permutations(motions, 2)
    }
    order: list[str] = []
    while left := [name for name in motions if name not in order]:
        order.append(min(left, key=lambda name: (sum(cost[name, o] - cost[o, name] for o in left if o != name), name)))
    return order
