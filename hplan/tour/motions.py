"""Picking configurations of a tour, and the costs of motions between them.

The cost of an unplanned motion is a lower bound: the duration of the slowest joint on its own. If a tour is optimal for
these bounds, its motions are planned, their durations replace the bounds, and the tour is optimized again until it
contains no bound. These motions are planned quickly (`hplan.tour.moves`); those much slower than their bounds are then
planned thoroughly, and if any becomes faster the tour is optimized again. Most motions are never planned, and few
thoroughly.

All fruits remain obstacles throughout, including those already picked: the certificate then holds for any order. A
motion from a hub (the start, or the drop-off if there is one) to every fruit is certified; if no direct motion between
two places is found, the arm moves through other stops.

Once the tour is found, motions are blended: the arm does not stop at stand-offs if that is faster. The order is
optimized with durations that include the stops.

Carried fruit is a held object (`carried_fruit`) from the stand-off before a fruit to the drop-off, with the size of the
largest fruit. The motions of the empty arm are planned without it.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import NamedTuple, TypeAlias

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, readonly
from hplan.errors import HplanError, UnreachableError
from hplan.planning.approach import Approach, blend, retreat_of
from hplan.planning.failures import NO_MOTION
from hplan.planning.grasps import Grasp, Target, grasps
from hplan.planning.motion import Motion, best_of, seconds
from hplan.planning.plans import plans_to_grasps
from hplan.planning.pose_goal import configurations_at
from hplan.planning.problem import Problem, merge_problems
from hplan.planning.solver import best_motion
from hplan.robot.limits import rest_to_rest
from hplan.scene.attached import Attached
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal
from hplan.scene.obstacles import Sphere
from hplan.tour.moves import Moves, Stop
from hplan.tour.ordering import SEGMENT, Costs, Visits, best, order_grasps

#: Name of the carried fruit among the held objects.
CARRIED = "carried fruit"


def carried_fruit(radius: float, frame: str | None = None) -> Attached:
    """Fruit that the arm holds: a ball at the tool frame.

    Args:
        radius: Radius of the fruit [m].
        frame: Tool frame of one arm of a composite robot; None for the robot's own.
    """
    name = CARRIED if frame is None else f"{CARRIED} {frame}"
    return Attached(object=Sphere(name=name, center=(0.0, 0.0, 0.0), radius=radius), frame=frame)


#: Optimizes a tour from the costs, the fruit order of the previous tour, and whether to search globally because the
#: tour no longer changes.
Solver: TypeAlias = Callable[[Costs, IntArray | None, bool], Visits]

#: Fruit and grasp, both None for the leg back, and the motions.
LegMotions: TypeAlias = tuple[str | None, Grasp | None, list[Motion]]

#: Retreat, transit without a stop after it, and the approach after that; None for a motion that it is not blended with.
_Blended: TypeAlias = tuple[Motion | None, Motion, Motion | None]


class _TourStep(NamedTuple):
    """Step of a tour: at a place, or from stop to stop.

    Attributes:
        name: Name of its phase; the motions' own names if empty.
        place: Place of the approach and the retreat; None for a step from stop to stop.
        stops: First and last stop.
        loaded: Whether the arm carries fruit.
    """

    name: str = ""
    place: int | None = None
    stops: tuple[int, int] = (0, 0)
    loaded: bool = False


class Motions:
    """Places to pick from and the motions between them, shared between tours.

    Tours over other sets of fruits reuse the motions.

    Attributes:
        fruits: Fruits of the tour, in the order in which they were first added.
    """

    def __init__(
        self, empty: Problem, loaded: Problem | None, *, here: Stop, home: Stop,
        drop: Motion | None, every: int, back: bool,
    ) -> None:  # fmt: skip
        """Start without fruits.

        Args:
            empty: The arm without load, among the obstacles and all fruits.
            loaded: The arm with its load; None if nothing is carried.
            here: Stop at the start of the tour.
            home: Last stop of a tour that goes back.
            drop: Motion from `home` to the drop-off; None if nothing is carried.
            every: Maximum number of fruits carried to the drop-off.
            back: True if the tour goes back.
        """
        self.fruits = list[str]()
        problem = empty if loaded is None else loaded
        # Maximum number of nodes of the grids that prove infeasibility: finer ones take hundreds of megabytes.
        nodes = min(problem.effort.proof_nodes, 2e7)
        self._problem = replace(problem, effort=replace(problem.effort, proof_nodes=nodes))
        self._moves = Moves(empty, loaded)
        self._every, self._back, self._carries = every, back, loaded is not None
        self._here, self._home = self._moves.stop(here), self._moves.stop(home)
        self._hub = self._home if drop is None else self._moves.stop(Stop(drop.problem.goal))
        self._moves.drop_at(self._hub)
        self._begin, self._names, self._numbers = [0], list[str](), np.zeros(0, dtype=np.int64)
        self._failed: dict[str, HplanError] = {}
        self._first = len(self._moves.stops)  # first stop that belongs to a place
        self._places: list[Approach] = []
        self._pick_s: list[float] = []  # per place, duration of approach and retreat or a lower bound [s]
        self._active: list[list[int]] = []
        self._picks: dict[int, tuple[Motion, ...] | None] = {}
        self._blended: dict[tuple[_TourStep, int | None, int | None], _Blended | None] = {}
        self._sought = 0
        if drop is not None and self._home != self._hub:
            self._moves.keep(self._home, self._hub, False, drop)

    @property
    def planned_count(self) -> int:
        """Number of planned motions between stops, failed ones included."""
        return self._sought + self._moves.planned

    def add(self, fruit: Fruit, keep: int) -> None:
        """Find the grasps of a fruit and certify a motion to one.

        The motion starts at the hub; the other grasps have lower bounds only. Results are cached.

        Args:
            fruit: The fruit.
            keep: Number of grasps compared at a time.

        Raises:
            UnreachableError: Inverse kinematics has no solution at the fruit.
            HplanError: One of `NO_MOTION`: the fruit is blocked, or no certified motion to it was found.
        """
        if fruit.name in self._failed:
            raise self._failed[fruit.name]
        if fruit.name not in self._names:
            try:
                self._add(fruit, keep)
            except (UnreachableError, *NO_MOTION) as error:
                error.__context__ = None  # the context keeps grids in memory, as the traceback does
                self._failed[fruit.name] = error
                raise

    def choose(self, fruits: Collection[str]) -> None:
        """Select the fruits of the tour among those added."""
        self.fruits = [name for name in self._names if name in fruits]
        self._numbers = np.flatnonzero([name in fruits for name in self._names])

    def costs(self) -> tuple[dict[str, FloatArray], Costs]:
        """(k, dof) candidate configurations at each fruit, and the costs between them."""
        goals = {
            self._names[fruit]: np.array([self._places[place].grasp.goal for place in self._active[fruit]])
            for fruit in self._numbers.tolist()
        }
        return goals, self._costs(self._active_places)

    def tour_through(self, grasps: Sequence[Grasp]) -> Visits | None:
        """The tour through some grasps, in the given order.

        None if a grasp is not a place of this tour, the arm carries fruit, or a motion between two grasps was not
        found.
        """
        numbers = {id(place.grasp): number for number, place in enumerate(self._places)}
        places = [numbers[id(grasp)] for grasp in grasps if id(grasp) in numbers]
        if len(places) < len(grasps) or self._carries:
            return None
        visits = Visits(0.0, np.array(places), np.zeros(len(places), dtype=np.bool_))
        steps = (step.stops for leg in self._steps(visits) for step in leg if step.place is None)
        return visits if all(self._moves.take(*stops, False) is not None for stops in steps) else None

    def _add(self, fruit: Fruit, keep: int) -> None:
        hub = self._moves.stops[self._hub].configuration
        problem = replace(self._problem, start=hub)
        target = Target.of_fruit(problem.world, fruit, problem.scene, problem.options)
        found = grasps(target, hub, standoff=problem.options.standoff_m, locked=problem.scene.locked_joints)
        self._sought += 1
        approach, plan = next(plans_to_grasps(problem, target, found))
        begin = self._begin[-1]
        for grasp in found:
            self._places.append(approach if grasp is approach.grasp else Approach(problem, target, grasp))
            self._moves.add(Stop(grasp.standoff, fruit if grasp.distance == 0.0 else None))
        turns = np.array([np.abs(grasp.goal - grasp.standoff) for grasp in found])
        self._pick_s += (2.0 * rest_to_rest(turns, *self._moves.limits).max(axis=1)).tolist()
        place = begin + next(number for number, grasp in enumerate(found) if grasp is approach.grasp)
        self._keep_pick(place, plan.others)
        self._moves.keep(self._hub, self._first + place, self._carries, plan.transit)
        spread = begin + np.linspace(0, len(found) - 1, max(0, keep - 1)).astype(int)
        self._active.append(sorted({place, *spread.tolist()}))
        self._begin.append(len(self._places))
        self._names.append(fruit.name)

    def settle(self, solve: Solver) -> Visits:
        """Optimize the tour until all its durations are actual ones."""
        visits: Visits | None = None
        widened, cost, last = 0, math.inf, False
        # Maximum number of rounds with other grasps, and the minimum relative gain of a round to continue.
        widenings, least_gain = 8, 5e-3
        while True:
            before, visits = visits, self._solve(solve, visits, last)
            missing = [step for leg in self._steps(visits) for step in leg if not self._is_known(step)]
            for step in dict.fromkeys(step._replace(name="") for step in missing):
                if step.place is not None:
                    self._pick(step.place)
                else:
                    self._moves.look(*step.stops, step.loaded)
            same = not missing and before is not None and np.array_equal(before.places, visits.places)
            if not same or not last:
                last = same
                continue
            last = False
            steps = [step for leg in self._steps(visits) for step in leg if step.place is None]
            if [step for step in steps if self._moves.made_quicker(*step.stops, step.loaded)]:
                continue
            if widened == widenings or visits.cost > (1.0 - least_gain) * cost or not self._widen(visits):
                return visits
            widened, cost = widened + 1, visits.cost

    def _solve(self, solve: Solver, before: Visits | None, last: bool) -> Visits:
        """Optimize the tour over the active places."""
        places = self._active_places
        found = solve(self._costs(places), None if before is None else self.fruits_at(before.places), last)
        return replace(found, places=places[found.places])

    @property
    def _active_places(self) -> IntArray:
        return np.array([place for fruit in self._numbers.tolist() for place in self._active[fruit]], dtype=np.int64)

    def _widen(self, visits: Visits) -> bool:
        """True if other grasps may shorten the tour in the same order.

        These grasps become active and replace others.
        """
        order = self.fruits_at(visits.places)
        likely = self._likely(visits)
        promised = likely[order_grasps(self._costs(likely), order).places].tolist()
        wider = False
        for fruit, place, other in zip(self._numbers[order].tolist(), visits.places.tolist(), promised, strict=True):
            active = self._active[fruit]
            kept = list(dict.fromkeys([place, other, *active]))[: len(active)]
            wider |= other in kept and other not in active
            self._active[fruit] = sorted(kept)
        return wider

    def _likely(self, visits: Visits) -> IntArray:
        """Active places, and further ones with low bounds to their tour neighbours."""
        numbers = self._numbers
        found, around = {place for fruit in numbers.tolist() for place in self._active[fruit]}, [self._here]
        for place, dropped in zip(visits.places.tolist(), visits.dropped.tolist(), strict=True):
            around += [self._first + place, self._hub] if dropped else [self._first + place]
        fruits = numbers[self.fruits_at(visits.places)].tolist()
        for fruit, place in zip(fruits, visits.places.tolist(), strict=True):
            number = around.index(self._first + place)
            beside = [around[number - 1], *around[number + 1 : number + 2]]
            whole = np.arange(self._begin[fruit], self._begin[fruit + 1])
            bounds = self._moves.minimum_durations(np.concatenate([beside, self._first + whole]))[
                : len(beside), len(beside) :
            ]
            # Approximate maximum number of additional grasps of all fruits.
            found |= set(whole[ties.argsort(bounds.sum(axis=0))[: 1200 // len(fruits)]].tolist())
        return np.array(sorted(found))

    def fruits_at(self, places: IntArray) -> IntArray:
        """Indices, within the tour, of the fruits at places."""
        return np.searchsorted(self._numbers, np.searchsorted(self._begin, places, side="right") - 1)

    def legs(self, visits: Visits, *, back: bool, stops: bool) -> list[LegMotions]:
        """Legs of a tour: fruit, grasp and motions, drop-off included.

        Args:
            visits: The tour.
            back: True if a leg back follows, without a fruit.
            stops: True if the arm stops between legs.
        """
        places = visits.places.tolist()
        names: list[tuple[str | None, Grasp | None]] = [
            (self._names[bisect(self._begin, place) - 1], self._places[place].grasp) for place in places
        ]
        legs = [[step for step in leg if step.name != "return"] for leg in self._steps(visits)]
        if back:
            names.append((None, None))
            legs.append([_TourStep("return", stops=(self._end(visits), self._home))])
        driven = [[each for step in leg for each in self._motions_of(step)] for leg in legs]
        if stops:
            motions = [self._without_stops(leg) for leg in driven]
        else:
            whole = iter(self._without_stops([each for leg in driven for each in leg]))
            motions = [list(islice(whole, len(leg))) for leg in driven]
        return [(*name, leg) for name, leg in zip(names, motions, strict=True)]

    def _motions_of(self, step: _TourStep) -> list[tuple[_TourStep, Motion]]:
        """Motions of a step, planned if necessary, each with its step."""
        if step.place is not None:
            return [(step, motion) for motion in self._pick(step.place) or ()]
        taken = self._moves.take(*step.stops, step.loaded) or ()
        return [(step._replace(stops=stops), replace(motion, name=step.name)) for stops, motion in taken]

    def _without_stops(self, driven: Sequence[tuple[_TourStep, Motion]]) -> list[Motion]:
        """Remove stops at stand-offs if that is faster."""
        found = [motion for _, motion in driven]
        places = {(number, motion.name): step.place for number, (step, motion) in enumerate(driven)}
        for number, (step, motion) in enumerate(driven):
            if step.place is not None:
                continue
            leaving, coming = places.get((number - 1, "retreat")), places.get((number + 1, "approach"))
            key = step._replace(name=""), leaving, coming
            if key not in self._blended:
                back = self._blended.get((key[0]._replace(stops=step.stops[::-1]), coming, leaving))
                self._blended[key] = self._blend(motion, *key) if back is None else _reverse_blended(back)
            blended = self._blended[key]
            if blended is not None:
                retreat, transit, approach = blended
                found[number] = replace(transit, name=motion.name)
                if retreat is not None:
                    found[number - 1] = retreat
                if approach is not None:
                    found[number + 1] = approach
        return found

    def _blend(self, motion: Motion, step: _TourStep, leaving: int | None, coming: int | None) -> _Blended | None:
        """Blend a transit with the adjacent retreat and approach; None for stops.

        Args:
            motion: The transit.
            step: Its step.
            leaving: Place of the retreat; None for no retreat.
            coming: Place of the approach; None for no approach.
        """
        if leaving is None and coming is None:
            return None
        with suppress(*NO_MOTION):
            before, after = (None if place is None else self._places[place] for place in (leaving, coming))
            return blend(self._moves.problem(*step.stops, step.loaded), motion, before, after)
        return None

    def savings(self, visits: Visits, *, keep_order: bool) -> dict[tuple[str, ...], float]:
        """Times by which a tour would be shorter without some of its fruits, up to `SEGMENT` in a row or all [s].

        They are estimates: the other fruits keep their grasps, and motions that are not planned yet count with lower
        bounds.

        Args:
            visits: The tour.
            keep_order: True if the other fruits keep their order.
        """
        costs, order = self._costs(np.sort(visits.places)), self.fruits_at(visits.places)
        count, found = len(order), dict[tuple[str, ...], float]()
        for size in range(1, min(SEGMENT, count - 1) + 1):
            for first in range(count - size + 1):
                rest = np.delete(order, np.arange(first, first + size))
                shorter = (
                    order_grasps(costs, rest)
                    if keep_order
                    else best(costs.select(rest.tolist()), np.arange(len(rest)), False)
                )
                found[self._names_at(order[first : first + size])] = visits.cost - shorter.cost
        return found | {self._names_at(order): visits.cost - self.without_fruits().cost}

    def _names_at(self, order: IntArray) -> tuple[str, ...]:
        """Names of some fruits of the tour."""
        return tuple(self.fruits[number] for number in order.tolist())

    def without_fruits(self) -> Visits:
        """The tour that picks nothing: its cost is that of the motion back, if it goes back."""
        stops = self._here, self._home
        cost = 0.0
        if self._back and stops[0] != stops[1]:
            while not self._moves.is_known(*stops, False):
                self._moves.look(*stops, False)
            cost = float(self._moves.seconds(np.array(stops), False)[0, 1])
        return Visits(cost, np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_))

    def end(self, visits: Visits) -> Stop:
        """Stop at the end of a tour's last leg."""
        return self._moves.stops[self._end(visits)]

    def _end(self, visits: Visits) -> int:
        """Index of the stop at the end of a tour's last leg."""
        return self._hub if self._carries else self._first + int(visits.places[-1])

    def _pick(self, place: int) -> tuple[Motion, ...] | None:
        """Approach and retreat at a place, planned once; None if not found."""
        if place not in self._picks:
            self._keep_pick(place, None)
            with suppress(*NO_MOTION):
                self._keep_pick(place, self._places[place].motions)
        return self._picks[place]

    def _keep_pick(self, place: int, motions: tuple[Motion, ...] | None) -> None:
        """Store approach and retreat at a place; None if not found."""
        self._picks[place] = motions
        self._pick_s[place] = math.inf if motions is None else seconds(motions)

    def _steps(self, visits: Visits) -> list[list[_TourStep]]:
        """Steps of each leg: to the fruit, to the drop-off, and back."""
        found = []
        here = self._here
        end = len(visits.places) - 1
        for number, place in enumerate(visits.places.tolist()):
            stop = self._first + place
            full = self._carries and here not in (self._here, self._hub)
            leg = [_TourStep("transit", stops=(here, stop), loaded=full), _TourStep(place=place)]
            here = stop
            if self._carries and (visits.dropped[number] or number == end):
                leg.append(_TourStep("drop", stops=(stop, self._hub), loaded=True))
                here = self._hub
            found.append(leg)
        if self._back and found:
            found[-1].append(_TourStep("return", stops=(here, self._home)))
        return found

    def _is_known(self, step: _TourStep) -> bool:
        return self._moves.is_known(*step.stops, step.loaded) if step.place is None else step.place in self._picks

    def _costs(self, places: IntArray) -> Costs:
        """Costs between some places: actual durations if known, otherwise lower bounds.

        They are rounded to a raster, so that equal sums of them are equal.
        """
        ends = np.concatenate([[self._here, self._hub, self._home], self._first + places])
        empty = self._moves.seconds(ends, False)
        loaded = self._moves.seconds(ends, True) if self._carries else empty
        pick = np.array([self._pick_s[place] for place in places.tolist()])
        drop = loaded[3:, 1] if self._carries else np.full(len(pick), np.inf)
        if self._carries:
            last = drop + (empty[1, 2] if self._back else 0.0)
        else:
            last = empty[3:, 2] if self._back else np.zeros(len(pick))
        return Costs(
            begin=readonly(np.searchsorted(self.fruits_at(places), np.arange(len(self.fruits) + 1)), np.int64),
            first=readonly(ties.on_raster(empty[0, 3:] + pick)),
            onward=readonly(ties.on_raster(loaded[3:, 3:] + pick)),
            drop=readonly(ties.on_raster(drop)),
            away=readonly(ties.on_raster(empty[1, 3:] + pick)),
            last=readonly(ties.on_raster(last)),
            capacity=self._every if self._carries else 0,
        )


def _reverse_blended(found: _Blended) -> _Blended:
    """Reverse a blended motion."""
    leaving, motion, coming = found
    before = None if coming is None else retreat_of(coming)
    return before, motion.reversal, None if leaving is None else replace(leaving.reversal, name="approach")


def drop_off(goal: Goal, empty: Problem, loaded: Problem, start: FloatArray) -> Motion:
    """Motion from the start to the drop-off, collision-free with load, too.

    Args:
        goal: Joint values, a position or a pose.
        empty: The arm without load.
        loaded: The arm with its load.
        start: (dof,) start configuration.

    Raises:
        UnreachableError: Inverse kinematics has no solution at the drop-off.
        HplanError: One of `NO_MOTION`: the drop-off is blocked, or no certified motion from the start to it was found.
        InputError: The joint values of `goal` are not a valid configuration, or in collision.
    """
    world = loaded.world
    joints = world.robot.joints_of(goal, "drop_off")
    if joints is not None:
        q = world.robot.check_configuration(world.robot.turned_near(joints, start), "drop_off")
        world.check_clear(q, "drop_off")
        return best_motion(empty.from_configurations(start, q))[1]
    if goal.pose is not None:
        ends = configurations_at(world, goal, start, empty.scene.locked_joints)
        return best_motion(merge_problems([empty.from_configurations(start, q) for q in ends]))[1]
    target = Target("the drop-off", np.array(goal.position), world, world, goal.approach_deg)
    found = grasps(target, start, standoff=0.0, locked=empty.scene.locked_joints)

    def problem_to(grasp: Grasp) -> Problem:
        world.check_clear(grasp.goal, "goal")
        return empty.from_configurations(start, grasp.goal)

    _, plan = best_of(plans_to_grasps(empty, target, found, problem_to))
    return plan.transit
