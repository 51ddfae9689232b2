"""The motions that picking tours are made of, planned and certified once they are asked for.

A motion between two places takes as long in either direction, so each is planned once. Until then its cost is what no
motion can undercut: the slowest joint on its own. A tour that is the best by such bounds has its motions planned, their
true durations put in place of the bounds, and is sought anew, until nothing in it is a bound: then it is the best by
true durations too, though most motions were never planned.

All fruits stay obstacles all along, also those that would have been picked by then: what is shown holds in any order.
From a hub (the start, or the drop-off where there is one) a motion to every fruit is shown; where no direct motion is
found between two places, the arm moves by the hub.

What is carried to a drop-off is as if within the last link, made as thick as the thickest fruit; the arm is as thick
from the stand-off before a fruit to the drop-off. The motions of the empty arm are planned as it is.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, readonly
from hplan.errors import BlockedError, CertificationError, ConfigurationInCollisionError, NoPathError, TimingError
from hplan.planning.certified_motion import Part
from hplan.planning.find_motion import find_motion
from hplan.planning.grasp_motion import approach_and_retreat, motion_to_grasp
from hplan.planning.grasps import Grasp, Target, grasps
from hplan.planning.task import PlanningContext, PlanningTask
from hplan.robot.limits import Limits, rest_to_rest
from hplan.robot.model import Robot
from hplan.scene.model import Fruit, Goal
from hplan.tour.ordering import Costs, Visits

#: What says that there is no motion, or none was found; anything else is a fault of what was asked.
NO_MOTION = (BlockedError, NoPathError, CertificationError, TimingError, ConfigurationInCollisionError)


def carrying(robot: Robot, radius: float) -> Robot:
    """The arm with its last link as thick as a fruit that it carries at the tool."""
    widths = np.array(robot.arm.half_widths)
    widths[-1] = max(widths[-1], radius + abs(robot.arm.lateral[-1]))
    return replace(robot, arm=replace(robot.arm, half_widths=readonly(widths)))


@dataclass(frozen=True, eq=False)
class Stop:
    """A configuration in which motions begin and end: at rest.

    Attributes:
        configuration: (dof,).
        fruit: The fruit that the last link is at; None elsewhere.
    """

    configuration: FloatArray
    fruit: str | None = None


@dataclass(frozen=True, eq=False)
class _Move:
    """Motions between two stops, or back and forth between a stand-off and its fruit.

    Attributes:
        seconds: Its duration; infinite where there is none [s].
        parts: Its motions.
    """

    seconds: float
    parts: tuple[Part, ...]

    @classmethod
    def of(cls, parts: Sequence[Part]) -> _Move:
        """Motions one after the other."""
        return cls(sum(part.trajectory.duration for part in parts), tuple(parts))

    @property
    def reversed(self) -> _Move:
        """The same backwards: the same distances, and the same torques."""
        return replace(
            self, parts=tuple(part._replace(trajectory=part.trajectory.reversed) for part in self.parts[::-1])
        )

    def named(self, name: str) -> list[Part]:
        """Its parts under another name, if it is one."""
        return [part._replace(name=name or part.name) for part in self.parts]


_NONE = _Move(math.inf, ())


@dataclass(frozen=True, eq=False)
class DropOff:
    """The configuration in which the arm lets go of what it carries.

    Attributes:
        configuration: (dof,).
        transit: The motion there from the start.
    """

    configuration: FloatArray
    transit: Part


class Motions:
    """Places to pick from, and the motions between them.

    Attributes:
        fruits: The fruits, in the order in which they were added.
        planned: How many motions between stops were planned, those among them that were not found.
    """

    def __init__(
        self, empty: PlanningContext, loaded: PlanningContext | None, *, here: Stop, home: Stop,
        drop: DropOff | None, every: int, back: bool,
    ) -> None:  # fmt: skip
        """Begin without fruits.

        Args:
            empty: The arm as it is, among the obstacles and all fruits that hang among them.
            loaded: The arm as it carries; None where nothing is carried.
            here: Where the tour begins.
            home: Where it ends if it goes back.
            drop: The drop-off, and how to get there from `home`; None where nothing is carried.
            every: How many fruits are carried at most.
            back: True if the tour goes back.
        """
        self.fruits, self.planned = list[str](), 0
        self._contexts = (empty, empty if loaded is None else loaded)
        self._every, self._back, self._carries = every, back, loaded is not None
        self._stops: list[Stop] = []
        self._here, self._home = self._stop(here), self._stop(home)
        self._hub = self._home if drop is None else self._stop(Stop(drop.configuration))
        self._begin = [0]
        self._first = len(self._stops)  # stop of the first place
        self._grasps: list[Grasp] = []
        self._targets: list[Target] = []
        self._moves: dict[tuple[int, int, bool], _Move] = {}
        self._picks: dict[int, _Move] = {}
        if drop is not None and self._home != self._hub:
            move, a, b = _Move.of([drop.transit]), self._home, self._hub
            self._moves[min(a, b), max(a, b), False] = move if a < b else move.reversed
        limits = Limits(empty.robot.velocity_limit, empty.robot.acceleration_limit).scaled(empty.options.speed)
        self._limits = limits.velocity, limits.acceleration

    def add(self, fruit: Fruit, keep: int) -> None:
        """Find grasps of a fruit: one that the hub is shown to lead to, and others by their bounds alone.

        Args:
            fruit: The fruit.
            keep: How many grasps are kept at most.

        Raises:
            UnreachableError: No configuration has the tool there.
            HplanError: One of `NO_MOTION`: it is blocked, or no certified motion leads there.
        """
        context, hub = self._contexts[1], self._stops[self._hub].configuration
        target = Target.of_fruit(context.world, fruit, context.scene.goal.approach_deg)
        found = grasps(target, hub, standoff=context.options.standoff, locked=context.scene.locked_joints)
        self.planned += 1
        shown, motion, pick = motion_to_grasp(
            target,
            found,
            hub,
            lambda grasp: context.among(target.transit_world(grasp)).task(hub, grasp.standoff),
            lambda grasp: self._planned_pick(target, grasp),
        )
        spread = [found[i] for i in np.unique(np.linspace(0, len(found) - 1, max(0, keep - 1)).astype(int))]
        place = len(self._grasps)
        self._picks[place] = pick
        self._moves[self._hub, self._first + place, self._carries] = _Move.of([motion.transit])
        for grasp in [shown, *(other for other in spread if other is not shown)]:
            self._grasps.append(grasp)
            self._stops.append(Stop(grasp.standoff, fruit.name if grasp.distance == 0.0 else None))
        self._begin.append(len(self._grasps))
        self.fruits.append(fruit.name)
        self._targets.append(target)

    def settle(self, solve: Callable[[Costs, Visits | None], Visits]) -> Visits:
        """The tour that a solver finds by true durations.

        Args:
            solve: Finds a tour, given costs and the tour it found before.
        """
        visits: Visits | None = None
        while True:
            before, visits = visits, solve(self._costs(), visits)
            missing = [step for leg in self._steps(visits) for _, step in leg if not self._known(step)]
            for step in dict.fromkeys(missing):
                self._take(step)
            if not missing and before is not None and np.array_equal(before.places, visits.places):
                return visits

    def fruits_at(self, places: IntArray) -> IntArray:
        """The numbers of the fruits at places."""
        return np.searchsorted(self._begin, places, side="right") - 1

    def legs(self, visits: Visits) -> list[tuple[str, Grasp, list[Part]]]:
        """For each fruit of a tour its name, how it is taken, and the motions there and, if it is, to the drop-off."""
        found = []
        for place, leg in zip(visits.places.tolist(), self._steps(visits), strict=True):
            parts = [part for name, step in leg if name != "return" for part in self._take(step).named(name)]
            found.append((self.fruits[bisect(self._begin, place) - 1], self._grasps[place], parts))
        return found

    def return_parts(self, visits: Visits) -> list[Part]:
        """The motions from the end of a tour's last leg to where it goes back to."""
        return self._move(self._end(visits), self._home, False).named("return")

    def end(self, visits: Visits) -> Stop:
        """The end of a tour's last leg."""
        return self._stops[self._end(visits)]

    def _end(self, visits: Visits) -> int:
        """The stop at which a tour's last leg ends."""
        return self._hub if self._carries else self._first + int(visits.places[-1])

    def _stop(self, stop: Stop) -> int:
        """The number of a stop, a new one unless there is the same already."""
        for number, other in enumerate(self._stops):
            if other.fruit == stop.fruit and np.array_equal(other.configuration, stop.configuration):
                return number
        self._stops.append(stop)
        return len(self._stops) - 1

    def _planned_pick(self, target: Target, grasp: Grasp) -> _Move:
        """Approach and retreat."""
        return _Move.of(approach_and_retreat(self._contexts[1], target, grasp))

    def _move(self, a: int, b: int, loaded: bool) -> _Move:
        """The motions from stop to stop; planned if they are not there yet."""
        if a == b:
            return _Move(0.0, ())
        if a > b:
            return self._move(b, a, loaded).reversed
        key = a, b, loaded
        if key not in self._moves:
            self._moves[key] = self._direct(*key) or self._over_hub(*key)
        return self._moves[key]

    def _direct(self, a: int, b: int, loaded: bool) -> _Move | None:
        """The direct motion; None where none is found."""
        ends, context = (self._stops[a], self._stops[b]), self._contexts[loaded]
        self.planned += 1
        try:
            for name in {end.fruit: None for end in ends if end.fruit is not None}:
                context = context.among(context.world.touching(name))  # at a fruit the last link may touch it
            _, motion = find_motion([context.task(*(end.configuration for end in ends))])
        except NO_MOTION:
            return None
        return _Move.of([motion.transit])

    def _over_hub(self, a: int, b: int, loaded: bool) -> _Move:
        """The motions by the hub; to the hub itself the empty arm may move as if it carried."""
        if loaded:
            return _NONE  # the drop-off is the hub: what is carried would be dropped there
        if self._hub in (a, b):
            return self._move(a, b, True) if self._carries else _NONE
        there, on = self._move(a, self._hub, False), self._move(self._hub, b, False)
        seconds = there.seconds + on.seconds
        return _Move(seconds, (*there.parts, *on.parts)) if math.isfinite(seconds) else _NONE

    def _pick(self, place: int) -> _Move:
        """Approach and retreat at a place; planned if they are not there yet."""
        if place not in self._picks:
            try:
                self._picks[place] = self._planned_pick(
                    self._targets[bisect(self._begin, place) - 1], self._grasps[place]
                )
            except NO_MOTION:
                self._picks[place] = _NONE
        return self._picks[place]

    def _steps(self, visits: Visits) -> list[list[tuple[str, tuple[int, ...]]]]:
        """For each fruit of a tour the names of its phases and what they are: (place) or (stop, stop, loaded)."""
        found = []
        here = self._here
        last = len(visits.places) - 1
        for number, place in enumerate(visits.places.tolist()):
            stop = self._first + place
            full = self._carries and here not in (self._here, self._hub)
            leg: list[tuple[str, tuple[int, ...]]] = [("transit", (here, stop, int(full))), ("", (place,))]
            here = stop
            if self._carries and (visits.dropped[number] or number == last):
                leg.append(("drop", (stop, self._hub, 1)))
                here = self._hub
            found.append(leg)
        if self._back and found:
            found[-1].append(("return", (here, self._home, 0)))
        return found

    def _known(self, step: tuple[int, ...]) -> bool:
        if len(step) == 1:
            return step[0] in self._picks
        a, b, loaded = step
        return a == b or (min(a, b), max(a, b), bool(loaded)) in self._moves

    def _take(self, step: tuple[int, ...]) -> _Move:
        """The motions of a step, planned if need be."""
        return self._pick(step[0]) if len(step) == 1 else self._move(step[0], step[1], bool(step[2]))

    def _costs(self) -> Costs:
        """True durations where they are known, bounds elsewhere; on a raster, so that equal sums of them are equal."""
        stops = np.array([stop.configuration for stop in self._stops])
        least = rest_to_rest(np.abs(stops[:, None] - stops), *self._limits).max(axis=2)
        seconds = np.stack([least, least])
        for (a, b, loaded), move in self._moves.items():
            seconds[int(loaded), a, b] = seconds[int(loaded), b, a] = move.seconds
        turns = np.array([np.abs(grasp.goal - grasp.standoff) for grasp in self._grasps])
        pick = 2.0 * rest_to_rest(turns, *self._limits).max(axis=1)
        for place, move in self._picks.items():
            pick[place] = move.seconds
        places, hub, home = slice(self._first, None), self._hub, self._home
        drop = seconds[1, places, hub] if self._carries else np.full(len(pick), np.inf)
        if self._carries:
            last = drop + (seconds[0, hub, home] if self._back else 0.0)
        else:
            last = seconds[0, places, home] if self._back else np.zeros(len(pick))
        return Costs(
            begin=readonly(self._begin, np.int64),
            first=readonly(ties.on_raster(seconds[0, self._here, places] + pick)),
            onward=readonly(ties.on_raster(seconds[int(self._carries), places, places] + pick)),
            drop=readonly(ties.on_raster(drop)),
            away=readonly(ties.on_raster(seconds[0, hub, places] + pick)),
            last=readonly(ties.on_raster(last)),
            capacity=self._every if self._carries else 0,
        )


def drop_off(goal: Goal, empty: PlanningContext, loaded: PlanningContext, start: FloatArray) -> DropOff:
    """The drop-off: clear also as the arm carries, and reached from the start.

    Args:
        goal: Joints or a position.
        empty: The arm as it is.
        loaded: The arm as it carries.
        start: (dof,) configuration from which it comes.

    Raises:
        UnreachableError: No configuration has the tool there.
        HplanError: One of `NO_MOTION`: it is blocked, or no certified motion from the start leads there.
        InputError: Joints that are no configuration, or in collision.
    """
    world, joints = loaded.world, goal.joints()
    if joints is not None:
        q = world.robot.check_configuration(world.robot.turned_near(joints, start), "drop_off")
        world.check_clear(q, "drop_off")
        _, motion = find_motion([empty.task(start, q)])
        return DropOff(q, motion.transit)
    target = Target("the drop-off", np.array(goal.position), world, world, goal.approach_deg)
    found = grasps(target, start, standoff=0.0, locked=empty.scene.locked_joints)

    def task_to(grasp: Grasp) -> PlanningTask:
        world.check_clear(grasp.goal, "goal")
        return empty.task(start, grasp.goal)

    grasp, motion, _ = motion_to_grasp(target, found, start, task_to, lambda _: None)
    return DropOff(grasp.goal, motion.transit)
