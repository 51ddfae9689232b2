"""The places that a tour picks from, and what it costs to go from one to another.

Until a motion is planned its cost is what no motion can undercut: the slowest joint on its own. A tour that is the best
by such bounds has its motions planned, their durations put in place of the bounds, and is sought anew, until nothing in
it is a bound. Motions are planned quickly then (`hplan.tour.moves`); those of the tour that last much longer than their
bounds are sought thoroughly, and if any becomes quicker the tour is sought anew. Most motions are never planned, and
few thoroughly.

All fruits stay obstacles all along, also those that would have been picked by then: what is shown holds in any order.
From a hub (the start, or the drop-off where there is one) a motion to every fruit is shown; where no direct motion is
found between two places, the arm moves by others.

Once the tour is found, motions are blended: where that is quicker, the arm does not stop at stand-offs. The order is
found by durations with stops.

What is carried to a drop-off is in the arm's way from the stand-off before a fruit to the drop-off, with the thickness
of the thickest fruit (`hplan.tour.carried`). The motions of the empty arm are planned as it is.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, readonly
from hplan.planning.certified_motion import Part
from hplan.planning.find_motion import find_motion
from hplan.planning.grasp_motion import Flow, Pick, approach_and_retreat, flowing, motion_to_grasp
from hplan.planning.grasps import Grasp, Target, grasps
from hplan.planning.pose_goal import configurations_at
from hplan.planning.task import PlanningContext, PlanningTask
from hplan.robot.limits import rest_to_rest
from hplan.scene.model import Fruit, Goal
from hplan.tour.moves import NO_MOTION, NONE, Move, Moves, Stop, quick_or_any_motion
from hplan.tour.ordering import Costs, Visits, along

#: Finds a tour, given costs, the order of the fruits in the tour it found before, and whether to look far, as nothing
#: else moves any more.
Solver: TypeAlias = Callable[[Costs, IntArray | None, bool], Visits]

#: The fruit and how it is taken, neither for the leg back, and the motions.
LegParts: TypeAlias = tuple[str | None, Grasp | None, list[Part]]

#: Other grasps are tried so many times, as long as the tour becomes shorter by this fraction.
WIDENINGS, LEAST_GAIN = 8, 5e-3


@dataclass(frozen=True, eq=False)
class DropOff:
    """The configuration in which the arm lets go of what it carries.

    Attributes:
        configuration: (dof,).
        transit: The motion there from the start.
    """

    configuration: FloatArray
    transit: Part


@dataclass(eq=False)
class _Motion:
    """A motion of a tour in the making.

    Attributes:
        part: The motion.
        step: The place that it approaches or retreats from, or the stops that it is between and whether it is loaded.
    """

    part: Part
    step: tuple[int, ...]

    def place_of(self, name: str) -> int | None:
        """The place of an approach or a retreat; None for another motion."""
        return self.step[0] if self.part.name == name else None


class Motions:
    """Places to pick from, and the motions between them.

    Attributes:
        fruits: The fruits, in the order in which they were added.
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
        self.fruits = list[str]()
        self._context = empty if loaded is None else loaded
        self._moves = Moves(empty, loaded)
        self._every, self._back, self._carries = every, back, loaded is not None
        self._here, self._home = self._moves.stop(here), self._moves.stop(home)
        self._hub = self._home if drop is None else self._moves.stop(Stop(drop.configuration))
        self._moves.drop_at(self._hub)
        self._begin = [0]
        self._first = len(self._moves.stops)  # stop of the first place
        self._grasps: list[Grasp] = []
        self._targets: list[Target] = []
        self._active: list[list[int]] = []
        self._picks: dict[int, Move] = {}
        self._non_stops: dict[int, Pick] = {}
        self._blended: dict[tuple[int | None, ...], Flow | None] = {}
        self._sought = 0
        if drop is not None and self._home != self._hub:
            self._moves.keep(self._home, self._hub, False, [drop.transit])

    @property
    def planned(self) -> int:
        """How many motions between stops were planned, those among them that were not found."""
        return self._sought + self._moves.planned

    def add(self, fruit: Fruit, keep: int) -> None:
        """Find grasps of a fruit: one that the hub is shown to lead to, and others by their bounds alone.

        Args:
            fruit: The fruit.
            keep: Among how many grasps the best is sought at a time.

        Raises:
            UnreachableError: No configuration has the tool there.
            HplanError: One of `NO_MOTION`: it is blocked, or no certified motion leads there.
        """
        context, hub = self._context, self._moves.stops[self._hub].configuration
        target = Target.of_fruit(context.world, fruit, context.scene.goal.approach_deg)
        found = grasps(target, hub, standoff=context.options.standoff_m, locked=context.scene.locked_joints)
        self._sought += 1
        shown, motion, pick = motion_to_grasp(
            target,
            found,
            hub,
            lambda grasp: context.among(target.transit_world(grasp)).task(hub, grasp.standoff),
            lambda grasp: self._planned_pick(target, grasp),
            quick_or_any_motion,
        )
        begin = self._begin[-1]
        for grasp in found:
            self._grasps.append(grasp)
            self._moves.add(Stop(grasp.standoff, fruit.name if grasp.distance == 0.0 else None))
        place = begin + next(number for number, grasp in enumerate(found) if grasp is shown)
        self._picks[place] = pick
        self._moves.keep(self._hub, self._first + place, self._carries, [motion.transit])
        spread = begin + np.linspace(0, len(found) - 1, max(0, keep - 1)).astype(int)
        self._active.append(sorted({place, *spread.tolist()}))
        self._begin.append(len(self._grasps))
        self.fruits.append(fruit.name)
        self._targets.append(target)

    def settle(self, solve: Solver) -> Visits:
        """The tour that a solver finds by true durations."""
        visits: Visits | None = None
        widened, cost, last = 0, math.inf, False
        while True:
            before, visits = visits, self._solved(solve, visits, last)
            missing = [step for leg in self._steps(visits) for _, step in leg if not self._known(step)]
            for step in dict.fromkeys(missing):
                if len(step) == 1:
                    self._pick(step[0])
                else:
                    self._moves.look(step[0], step[1], bool(step[2]))
            same = not missing and before is not None and np.array_equal(before.places, visits.places)
            if not same or not last:
                last = same
                continue
            last = False
            steps = [step for leg in self._steps(visits) for _, step in leg if len(step) == 3]
            if [step for step in steps if self._moves.made_quicker(step[0], step[1], bool(step[2]))]:
                continue
            if widened == WIDENINGS or visits.cost > (1.0 - LEAST_GAIN) * cost or not self._widened(visits):
                return visits
            widened, cost = widened + 1, visits.cost

    def _solved(self, solve: Solver, before: Visits | None, last: bool) -> Visits:
        """The tour over active places that a solver finds."""
        places = np.array([place for active in self._active for place in active])
        found = solve(self._costs(places), None if before is None else self.fruits_at(before.places), last)
        return replace(found, places=places[found.places])

    def _widened(self, visits: Visits) -> bool:
        """True if other grasps promise a quicker tour in the same order: they become active, in place of others."""
        order = self.fruits_at(visits.places)
        promised = along(self._costs(np.arange(len(self._grasps))), order).places
        wider = False
        for fruit, place, other in zip(order.tolist(), visits.places.tolist(), promised.tolist(), strict=True):
            active = self._active[fruit]
            kept = list(dict.fromkeys([place, other, *active]))[: len(active)]
            wider |= other in kept and other not in active
            self._active[fruit] = sorted(kept)
        return wider

    def fruits_at(self, places: IntArray) -> IntArray:
        """The numbers of the fruits at places."""
        return np.searchsorted(self._begin, places, side="right") - 1

    def legs(self, visits: Visits, *, back: bool, stops: bool) -> list[LegParts]:
        """The legs of a tour: the fruit's name, how it is taken, the motions there and, if it is, to the drop-off.

        Args:
            visits: The tour.
            back: True if a leg back follows, without a fruit.
            stops: True if the arm stops between legs.
        """
        places = visits.places.tolist()
        names: list[tuple[str | None, Grasp | None]] = [
            (self.fruits[bisect(self._begin, place) - 1], self._grasps[place]) for place in places
        ]
        steps = [[(name, step) for name, step in leg if name != "return"] for leg in self._steps(visits)]
        if back:
            names.append((None, None))
            steps.append([("return", (self._end(visits), self._home, 0))])
        legs = [[motion for name, step in leg for motion in self._motions_of(name, step)] for leg in steps]
        for group in legs if stops else [[motion for leg in legs for motion in leg]]:
            self._blend(group)
        return [(*name, [motion.part for motion in leg]) for name, leg in zip(names, legs, strict=True)]

    def _motions_of(self, name: str, step: tuple[int, ...]) -> list[_Motion]:
        """The motions of a step, planned if need be."""
        parts = self._take(step).named(name)
        if len(step) == 1:
            return [_Motion(part, step) for part in parts]
        path = self._moves.path(step[0], step[1], bool(step[2])) or []
        return [_Motion(part, (*ends, step[2])) for part, ends in zip(parts, pairwise(path), strict=True)]

    def _blend(self, motions: Sequence[_Motion]) -> None:
        """Take motions without stops at stand-offs in place of those with stops, where they are quicker."""
        for number, motion in enumerate(motions):
            if len(motion.step) == 1:
                continue
            before = motions[number - 1] if number else None
            after = motions[number + 1] if number + 1 < len(motions) else None
            leaving = None if before is None else before.place_of("retreat")
            coming = None if after is None else after.place_of("approach")
            key = *motion.step, leaving, coming
            if key not in self._blended:
                self._blended[key] = self._blend_at(motion, leaving, coming)
            blended = self._blended[key]
            if blended is None:
                continue
            motion.part = blended.transit._replace(name=motion.part.name)
            if before is not None and blended.retreat is not None:
                before.part = blended.retreat
            if after is not None and blended.approach is not None:
                after.part = blended.approach

    def _blend_at(self, motion: _Motion, leaving: int | None, coming: int | None) -> Flow | None:
        """A motion blended with the retreat from a place, or with the approach to one; None for stops."""
        if leaving is None and coming is None:
            return None
        with suppress(*NO_MOTION):
            a, b, loaded = motion.step
            task = self._moves.task(a, b, bool(loaded))
            return flowing(
                task, motion.part, *(None if place is None else self._non_stop(place) for place in (leaving, coming))
            )
        return None

    def _non_stop(self, place: int) -> Pick:
        """The approach to a place, as it may be in motion at the stand-off."""
        if place not in self._non_stops:
            target = self._targets[bisect(self._begin, place) - 1]
            self._non_stops[place] = Pick(self._context, target, self._grasps[place], self._pick(place).parts[0])
        return self._non_stops[place]

    def end(self, visits: Visits) -> Stop:
        """The end of a tour's last leg."""
        return self._moves.stops[self._end(visits)]

    def _end(self, visits: Visits) -> int:
        """The stop at which a tour's last leg ends."""
        return self._hub if self._carries else self._first + int(visits.places[-1])

    def _planned_pick(self, target: Target, grasp: Grasp) -> Move:
        """Approach and retreat."""
        return Move.of(approach_and_retreat(self._context, target, grasp))

    def _pick(self, place: int) -> Move:
        """Approach and retreat at a place; planned if they are not there yet."""
        if place not in self._picks:
            try:
                self._picks[place] = self._planned_pick(
                    self._targets[bisect(self._begin, place) - 1], self._grasps[place]
                )
            except NO_MOTION:
                self._picks[place] = NONE
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
        return step[0] in self._picks if len(step) == 1 else self._moves.is_known(step[0], step[1], bool(step[2]))

    def _take(self, step: tuple[int, ...]) -> Move:
        """The motions of a step, planned if need be."""
        return self._pick(step[0]) if len(step) == 1 else self._moves.take(step[0], step[1], bool(step[2]))

    def _costs(self, places: IntArray) -> Costs:
        """Costs of going to some places: true durations where they are known, else bounds.

        They are on a raster, so that equal sums of them are equal.
        """
        ends = np.concatenate([[self._here, self._hub, self._home], self._first + places])
        empty = self._moves.seconds(ends, False)
        loaded = self._moves.seconds(ends, True) if self._carries else empty
        turns = np.array([np.abs(self._grasps[place].goal - self._grasps[place].standoff) for place in places])
        pick = 2.0 * rest_to_rest(turns, *self._moves.limits).max(axis=1)
        for number, place in enumerate(places.tolist()):
            if place in self._picks:
                pick[number] = self._picks[place].seconds
        drop = loaded[3:, 1] if self._carries else np.full(len(pick), np.inf)
        if self._carries:
            last = drop + (empty[1, 2] if self._back else 0.0)
        else:
            last = empty[3:, 2] if self._back else np.zeros(len(pick))
        return Costs(
            begin=readonly(np.searchsorted(places, self._begin), np.int64),
            first=readonly(ties.on_raster(empty[0, 3:] + pick)),
            onward=readonly(ties.on_raster(loaded[3:, 3:] + pick)),
            drop=readonly(ties.on_raster(drop)),
            away=readonly(ties.on_raster(empty[1, 3:] + pick)),
            last=readonly(ties.on_raster(last)),
            capacity=self._every if self._carries else 0,
        )


def drop_off(goal: Goal, empty: PlanningContext, loaded: PlanningContext, start: FloatArray) -> DropOff:
    """The drop-off: clear also as the arm carries, and reached from the start.

    Args:
        goal: Joints, a position or a pose.
        empty: The arm as it is.
        loaded: The arm as it carries.
        start: (dof,) configuration from which it comes.

    Raises:
        UnreachableError: No configuration has the tool there.
        HplanError: One of `NO_MOTION`: it is blocked, or no certified motion from the start leads there.
        InputError: Joints that are no configuration, or in collision.
    """
    world = loaded.world
    joints = world.robot.joints_of(goal, "drop_off")
    if joints is not None:
        q = world.robot.check_configuration(world.robot.turned_near(joints, start), "drop_off")
        world.check_clear(q, "drop_off")
        _, motion = find_motion([empty.task(start, q)])
        return DropOff(q, motion.transit)
    if goal.pose is not None:
        ends = configurations_at(world, goal, start, empty.scene.locked_joints)
        number, motion = find_motion([empty.task(start, q) for q in ends])
        return DropOff(ends[number], motion.transit)
    target = Target("the drop-off", np.array(goal.position), world, world, goal.approach_deg)
    found = grasps(target, start, standoff=0.0, locked=empty.scene.locked_joints)

    def task_to(grasp: Grasp) -> PlanningTask:
        world.check_clear(grasp.goal, "goal")
        return empty.task(start, grasp.goal)

    grasp, motion, _ = motion_to_grasp(target, found, start, task_to, lambda _: None)
    return DropOff(grasp.goal, motion.transit)
