"""Plans picking tours of several arms: fruit allocation, tours, schedule.

A fruit that only one arm can pick is assigned to it; the others are allocated to minimize the time until all arms are
done (`exchange_fruits`). Each arm's tour is planned on its own, with the other arms as obstacles at their starts,
and with all fruits of other arms as obstacles. A fruit without a motion is reassigned to another arm that can pick it.
The motions found improve the cost estimates of the next allocation. Tours run forward or reversed, with waits at rests,
so that all of them finish as early as possible.

There is no deadlock: in the worst case the arms run one after the other, past the starts of the others, where they also
end. Finally all arms are certified against one another as one motion.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from hplan.base.arguments import instance
from hplan.base.arrays import FloatArray, Record
from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.base.lazy_import import InNotebook
from hplan.certificate.certificate import Certificate
from hplan.collision.held_objects import holding
from hplan.errors import CertificationError, HplanError, TourError
from hplan.planning.options import PlanOptions
from hplan.planning.reachable import reachable
from hplan.planning.stages import Progress, no_progress
from hplan.planning.world import World
from hplan.tour.motions import carried_fruit
from hplan.tour.ordering import Costs, best, order_grasps
from hplan.tour.tour import TourOptions, TourPlanner, TourResult, Unreached
from hplan.trajectory.trajectory import Phase, Trajectory
from hplan.workcell.cell import (
    Cell,
    CellArm,
    certify_between,
    check_options,
    distances_between,
    iterate_standing,
    may_touch_report,
)
from hplan.workcell.timetable import SPARES, Timetable

#: Proximity of an arm at a fruit to another arm at another fruit: 0 if far, 1 for contact.
Nearness: TypeAlias = Mapping[tuple[str, str, str, str], float]


@dataclass(frozen=True, eq=False)
class Share:
    """Allocation of fruits to an arm, with its known motion costs.

    Attributes:
        grasps: (k, dof) configurations at each fruit that the arm can reach.
        costs: Costs between them, in this order.
        order: Names of the allocated fruits, in picking order.
        more_s: Excess of the actual duration over the costs [s].
    """

    grasps: Mapping[str, FloatArray]
    costs: Costs
    order: tuple[str, ...] = ()
    more_s: float = 0.0

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Index of each fruit in the costs."""
        return {fruit: number for number, fruit in enumerate(self.grasps)}

    @cached_property
    def seconds(self) -> float:
        """Duration of the tour [s]."""
        return self._seconds(self.order)

    @cached_property
    def gains_s(self) -> dict[str, float]:
        """Approximate time saved without each allocated fruit, or with another one [s].

        Adding a fruit saves a negative time.
        """
        order, gains = self.order, dict[str, float]()
        for fruit in self.grasps:
            if fruit in order:
                others = [tuple(each for each in order if each != fruit)]
            else:
                others = [(*order[:at], fruit, *order[at:]) for at in range(len(order) + 1)]
            gains[fruit] = self.seconds - min(map(self._seconds, others))
        return gains

    def select(self, fruits: Collection[str]) -> Share:
        """Allocation of other fruits, in their optimal order."""
        order = [fruit for fruit in dict.fromkeys((*self.order, *self.grasps)) if fruit in fruits]
        if order:
            costs = self.costs.select([self.numbers[fruit] for fruit in order])
            places = best(costs, np.arange(len(order)), kicked=False).places
            order = [order[number] for number in costs.fruit_of[places].tolist()]
        return replace(self, order=tuple(order))

    def _seconds(self, order: Sequence[str]) -> float:
        return self.more_s + order_grasps(self.costs, [self.numbers[fruit] for fruit in order]).cost


def nearness(cell: Cell, shares: Mapping[str, Share]) -> Nearness:
    """Proximity of the arms to each other at their reachable fruits."""
    found = dict[tuple[str, str, str, str], float]()
    # Distance below which arms are expected to block each other [m].
    far = 0.3
    for a, b in itertools.combinations(shares, 2):
        pairs = itertools.product(shares[a].grasps.items(), shares[b].grasps.items())
        for (f, ours), (g, theirs) in pairs:
            q = cell.configuration({a: np.repeat(ours, len(theirs), axis=0), b: np.tile(theirs, (len(ours), 1))})
            found[a, f, b, g] = float(np.clip(1.0 - distances_between(cell, q, a, [b]) / far, 0.0, 1.0).mean())
    return found


def first_share(cell: Cell, able: Mapping[str, Sequence[str]], lowest: Sequence[str] = ()) -> dict[str, list[str]]:
    """Initial allocation with about the same number of fruits per arm.

    Each arm gets the fruits near it or, if `lowest` is given, the first of these arms gets the lowest fruits.

    Args:
        cell: The workcell.
        able: Arms that can pick each fruit, nearest first.
        lowest: Names of the arms; empty to allocate by distance.
    """
    bases = {arm.name: np.array(arm.position) for arm in cell.scene.robots}
    shares: dict[str, list[str]] = {name: [] for name in bases}
    shared = []
    for fruit in cell.scene.fruits:
        names = sorted(able[fruit.name], key=lowest.index) if lowest else list(able[fruit.name])
        if len(names) == 1:
            shares[names[0]].append(fruit.name)
        elif names:
            near, far = (float(np.linalg.norm(fruit.center - bases[name])) for name in names[:2])
            shared.append((round(fruit.center[2] if lowest else near - far, 6), fruit.name, names))
    most = math.ceil((len(shared) + sum(map(len, shares.values()))) / len(shares))
    for _, fruit_name, names in sorted(shared):  # fruits with the clearest preference are allocated first
        with_room = [name for name in names if len(shares[name]) < most]
        shares[(with_room or names)[0]].append(fruit_name)
    return shares


def exchange_fruits(shares: Mapping[str, Share], near: Nearness, weight: float) -> dict[str, Share]:
    """Improve an allocation by moving or exchanging fruits between arms.

    Args:
        shares: Allocation of each arm, by name.
        near: Proximity of the arms to each other.
        weight: Fraction of the time that arms wait if they always block each other.
    """
    found = dict(shares)
    # Maximum number of changes evaluated, the most promising first.
    most = 32

    def ends(seconds: Mapping[str, float], fruits: Mapping[str, Collection[str]]) -> tuple[float, float]:
        in_the_way = 0.0
        for a, b in itertools.combinations(fruits, 2):
            met = sum(near[a, f, b, g] for f in fruits[a] for g in fruits[b])
            in_the_way += met / max(1, len(fruits[a]) * len(fruits[b]))
        return round(max(seconds.values()) * (1.0 + weight * in_the_way), 6), round(sum(seconds.values()), 6)

    def changes() -> list[tuple[tuple[float, float], dict[str, list[str]]]]:
        """Estimated finishing times after each change, with the changed allocations."""
        seconds = {n: share.seconds for n, share in found.items()}
        fruits = {n: share.order for n, share in found.items()}
        promised = []
        for a, b in itertools.permutations(found, 2):
            swaps = ([], *([g] for g in found[b].order if a < b and g in found[a].grasps))
            for f, swap in itertools.product((f for f in found[a].order if f in found[b].grasps), swaps):
                after = {
                    a: [*(each for each in fruits[a] if each != f), *swap],
                    b: [*(each for each in fruits[b] if each not in swap), f],
                }
                then = {n: seconds[n] - sum(found[n].gains_s[each] for each in (f, *swap)) for n in after}
                promised.append((ends(seconds | then, {**fruits, **after}), after))
        return sorted(promised, key=lambda change: change[0])[:most]

    def end(shares: Mapping[str, Share]) -> tuple[float, float]:
        return ends({n: share.seconds for n, share in shares.items()}, {n: share.order for n, share in shares.items()})

    def apply_change(change: Mapping[str, Collection[str]]) -> dict[str, Share]:
        return found | {name: found[name].select(fruits) for name, fruits in change.items()}

    while True:
        now = end(found)
        trials = [change for promised, change in changes() if promised < now]
        better = next((trial for trial in map(apply_change, trials) if end(trial) < now), None)
        if better is None:
            return found
        found = better


#: An arm is at rest below this speed [rad/s, m/s]; times closer than `_EQUAL_STATIONS_S` are equal [s].
_AT_REST: Final = 1e-9
_EQUAL_STATIONS_S: Final = 1e-6

#: Tour of each arm, and the reason for each fruit that is in no tour.
_Shared: TypeAlias = tuple[dict[str, TourResult], dict[str, HplanError]]


@dataclass(frozen=True, eq=False)
class CellTour(Record, InNotebook):
    """Picking tours of several arms on one clock.

    Attributes:
        cell: The workcell.
        trajectory: All joints on one clock.
        between: Certificate of the arms against one another.
        tours: Tours of each arm, by name, certified against obstacles and fruits, on a clock of its own. Segments from
            rest to rest are run unchanged; the arm may wait at rests.
        phases: Phases of each arm's motion, by name; between them it waits.
        picked: Picking time of each picked fruit [s].
        dropped: Release time of each fruit brought to a drop-off [s].
        unreached: Fruits that are not picked, with their errors.
    """

    cell: Cell
    trajectory: Trajectory
    between: Certificate
    tours: Mapping[str, tuple[TourResult, ...]]
    phases: Mapping[str, tuple[Phase, ...]]
    picked: Mapping[str, float]
    dropped: Mapping[str, float]
    unreached: tuple[Unreached, ...]

    @property
    def parts(self) -> tuple[Certificate, ...]:
        """All certificates: of the arms against one another, and of each tour."""
        return (self.between, *(tour.certificate for own in self.tours.values() for tour in own))

    @property
    def verified(self) -> bool:
        """True if all certificates hold: arms against obstacles, and against one another."""
        return all(part.verified for part in self.parts)

    @property
    def trajectories(self) -> dict[str, Trajectory]:
        """Trajectory of each arm, by name, on one clock."""
        return self.cell.split_motion(self.trajectory)

    @property
    def report(self) -> dict[str, Any]:
        """Contents of `tour.json`."""
        makespan, apart = self.trajectory.duration, 1e3 * self.between.min_clearance_m
        busy = {name: sum(phase.end_s - phase.start_s for phase in own) for name, own in self.phases.items()}
        return {
            "picked": len(self.picked),
            "unreached": [item.as_dict() for item in self.unreached],
            "makespan_s": makespan,
            "s_per_fruit": makespan / max(1, len(self.picked)),
            "busy_s": busy,
            "idle_s": {name: max(0.0, makespan - seconds) for name, seconds in busy.items()},
            "parallel_ratio": sum(busy.values()) / (len(busy) * makespan) if makespan > 0.0 else None,
            "speed_up_over_one_arm": sum(busy.values()) / makespan if makespan > 0.0 else None,
            "verified": self.verified,
            "between_arms_mm": apart if math.isfinite(apart) else None,
            "uncovered_links": list(self.between.uncovered_links),
            **may_touch_report(self.cell.scene.may_touch),
        }  # fmt: skip


def plan_cell_tour(
    cell: Cell,
    options: PlanOptions | None = None,
    *,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> CellTour:
    """Plan picking tours of all arms of a workcell.

    Each arm starts and ends at its own start configuration.

    Args:
        cell: Arms, obstacles and fruits; goals are ignored.
        options: Planning options; None for the defaults.
        progress: Called with the name of each step.
        cancel: Cancels the planning when set, as for `hplan.plan`; None for no cancellation.

    Raises:
        HplanError: An error of `plan_tour` for one of the arms.
        ConfigurationInCollisionError: The arms touch at their starts.
        TourError: No arm can pick any fruit.
        CertificationError: The motions of all arms together cannot be certified.
    """
    instance("cell", cell, Cell, "load_cell")
    options = PlanOptions() if options is None else instance("options", options, PlanOptions)
    check_options(options, "tours of several arms")
    with time_limit(options.deadline_s, cancel) as limit:
        try:
            return _plan_cell_tour(cell, replace(options, deadline_s=None), progress)
        except TimeIsUpError:
            raise limit.error(["tours of all arms"]) from None


def _plan_cell_tour(cell: Cell, options: PlanOptions, progress: Progress) -> CellTour:
    carry = [arm.tool_frame for arm in cell.arms if arm.drop_off is not None]
    thickest = max((fruit.radius for fruit in cell.scene.fruits), default=0.0)
    # An arm that carries fruit at any time keeps clearance for it at all times.
    if carry and thickest:
        held = [*cell.robot.attached, *(carried_fruit(thickest, frame) for frame in carry)]
        cell = replace(cell, robot=holding(cell.robot, held))
    World.build(cell.robot, (), clearance=cell.scene.clearance).check_clear(cell.configuration({}), "start")
    apart = replace(cell, arms=tuple(_among_others(cell, arm) for arm in cell.arms))
    progress("reachability of the fruits")
    able, reasons = _find_able_arms(apart, options)
    mine = {arm.name: [fruit for fruit in able if arm.name in able[fruit]] for arm in apart.arms}
    pickers = {arm.name: _Picker(arm, options, mine[arm.name]) for arm in apart.arms if mine[arm.name]}
    if not pickers:
        raise TourError(list(reasons.items()))
    why = "even one after the other, they come too close to each other"
    for spare in SPARES[1:]:
        schedule = _best_schedule(cell, options, spare, pickers, able, reasons, progress)
        if schedule is None:
            break
        found = schedule.result(cell, options)
        if found.between.verified:
            return found
        why = found.between.violations[0]
    raise CertificationError(f"the tours of all arms together cannot be certified: {why}")


def _at_best(shared: _Shared) -> tuple[int, float]:
    """Number of unpicked fruits, and lower bound on the finishing time [s].

    The bound assumes that no arm waits.
    """
    tours, reasons = shared
    return len(reasons), round(max(tour.duration for tour in tours.values()), 6)


def _among_others(cell: Cell, arm: CellArm) -> CellArm:
    """Add the other arms, at their starts, to an arm's obstacles.

    They are thicker than the clearance that samples of a timetable must keep.
    """
    others = iterate_standing(cell, arm.name, SPARES[1] + 5e-4)
    return replace(arm, scene=arm.scene.with_obstacles([*arm.scene.obstacles, *others]))


def _find_able_arms(cell: Cell, options: PlanOptions) -> tuple[dict[str, list[str]], dict[str, HplanError]]:
    """Arms that can pick each fruit, and reasons for the others.

    The nearest arm comes first.
    """
    reach = {arm.name: reachable(arm.robot, arm.scene, options) for arm in cell.arms}
    bases = {arm.name: np.array(arm.position) for arm in cell.scene.robots}
    able: dict[str, list[str]] = {}
    reasons: dict[str, HplanError] = {}
    for fruit in cell.scene.fruits:
        away = {name: round(float(np.linalg.norm(fruit.center - base)), 6) for name, base in bases.items()}
        found = [name for name in away if reach[name][fruit.name].can_be_picked]
        able[fruit.name] = sorted(found, key=lambda name: (away[name], name))
        if not found:
            details = (reach[name][fruit.name].detail for name in reach)
            reasons[fruit.name] = HplanError("; ".join(dict.fromkeys(details)))
    return able, reasons


class _Picker:
    """Plans tours of one arm; motions are cached and shared between tours."""

    def __init__(self, arm: CellArm, options: PlanOptions, able: Sequence[str]) -> None:
        """Start without tours.

        Args:
            arm: The arm.
            options: Planning options.
            able: Names of the fruits that it may pick.
        """
        self._arm, self._options, self._able = arm, options, able
        self._tours: dict[frozenset[str], TourResult | TourError] = {}

    @cached_property
    def _planner(self) -> TourPlanner:
        arm = self._arm
        tour = TourOptions(back=True, drop_off=arm.drop_off, every=None if arm.drop_off is None else arm.every)
        return TourPlanner(arm.robot, arm.scene, self._options, tour, self._able)

    def share(self, tour: TourResult | None = None) -> Share:
        """Allocation of the fruits of a tour, with the arm's costs.

        Args:
            tour: The tour; None for no fruits.
        """
        share = Share(*self._planner.costs(self._able))
        if tour is None:
            return share
        share = replace(share, order=tuple(fruit for fruit in tour.order if fruit in share.grasps))
        return replace(share, more_s=tour.duration - share.seconds)

    def reverse(self, tour: TourResult) -> TourResult | None:
        """The reversed tour; None if it is not known to be valid."""
        return self._planner.reverse(tour)

    def tour(self, fruits: Sequence[str]) -> TourResult:
        """Plan the tour through some fruits and back.

        The tour ends at the start; results are cached.

        Raises:
            TourError: The arm cannot pick any of them.
        """
        key = frozenset(fruits)
        if key not in self._tours:
            try:
                self._tours[key] = self._planner.run(fruits)
            except TourError as error:
                self._tours[key] = error
        found = self._tours[key]
        if isinstance(found, TourError):
            raise found
        return found


def _tours(
    pickers: Mapping[str, _Picker],
    able: Mapping[str, Sequence[str]],
    shares: dict[str, list[str]],
    reasons: dict[str, HplanError],
    progress: Progress,
) -> dict[str, TourResult]:
    """Plan each arm's tour.

    A fruit without a motion is reassigned to the next arm that can pick it.
    """
    tours, missed_by = dict[str, TourResult](), dict[str, set[str]]()
    changed = {name for name, share in shares.items() if share}
    while changed:
        handed = set[str]()
        for arm in [name for name in pickers if name in changed]:
            progress(f"tour of {arm}")
            try:
                tours[arm] = pickers[arm].tour(shares[arm])
                missed = {each.fruit: each.error for each in tours[arm].unreached}
            except TourError as error:
                tours.pop(arm, None)
                missed = dict(error.reasons)
            reasons |= missed
            for fruit in missed:
                shares[arm].remove(fruit)
                missed_by.setdefault(fruit, set()).add(arm)
                others = [name for name in able[fruit] if name not in missed_by[fruit]]
                for name in others[:1]:
                    shares[name].append(fruit)
                    handed.add(name)
        changed = handed
    picked = {fruit for tour in tours.values() for fruit in tour.order}
    for fruit in picked & set(reasons):
        del reasons[fruit]
    return tours


def _best_schedule(
    cell: Cell, options: PlanOptions, spare: float, pickers: Mapping[str, _Picker], able: Mapping[str, Sequence[str]],
    reasons: Mapping[str, HplanError], progress: Progress,
) -> _Schedule | None:  # fmt: skip
    """The schedule that ends first, over several fruit allocations.

    Each next allocation uses the costs of the motions known by then. None if arms that run one after the other would
    come too near to one another.
    """
    every = {name: picker.share() for name, picker in pickers.items()}
    known = {fruit: [name for name in names if fruit in every[name].grasps] for fruit, names in able.items()}
    late = {name: [f for f, names in able.items() if names[:1] == [name] and not known[f]] for name in every}
    near, names, soonest = nearness(cell, every), list(pickers), None
    tried, most = list[dict[str, set[str]]](), 8  # maximum number of allocations planned from each initial one
    for lowest in ((),) if options.effort == "quick" else ((), names, names[::-1]):
        weight, kept, first = 1.0, dict[str, TourResult](), first_share(cell, known, lowest)
        shares = exchange_fruits({name: every[name].select(first[name]) for name in names}, near, weight)
        for _ in range(most):
            fruits = {name: set(share.order) for name, share in shares.items()}
            waits = fruits in tried  # planning the same allocation again would give the same tours
            if not waits:
                tried.append(fruits)
                without = dict(reasons)
                given = {name: [*share.order, *late[name]] for name, share in shares.items()}
                tours = _tours(pickers, able, given, without, progress)
                if not tours:
                    raise TourError(list(without.items()))
                progress("together")
                found = _schedule_tours(cell, options, spare, pickers, (tours, without), soonest)
                kept, soonest = tours if found or not kept else kept, found or soonest
                waits = found is None or found.ends[1] > 1.01 * _at_best((tours, without))[1]
            # The less the arms wait, the less the next allocation avoids fruits close to another arm's.
            weight *= 1.5 if waits else 0.7
            if kept:
                shares = {name: picker.share(kept.get(name)) for name, picker in pickers.items()}
            shares = exchange_fruits(shares, near, weight)
    return soonest


def _schedule_tours(
    cell: Cell, options: PlanOptions, spare: float, pickers: Mapping[str, _Picker], shared: _Shared,
    sooner: _Schedule | None,
) -> _Schedule | None:  # fmt: skip
    """The fastest schedule of tours, some of them possibly reversed.

    None if it is not faster than `sooner`.
    """
    found, (tours, reasons), distances = None, shared, dict[tuple[str, str], FloatArray]()
    if sooner is not None and _at_best(shared) >= sooner.ends:
        return None
    both = [(None, pickers[name].reverse(tour)) for name, tour in tours.items()]
    # With more than two arms, only some of the combinations of reversed tours are tried.
    for choice in itertools.islice(itertools.product(*both), 4):
        backward = {name: tour for name, tour in zip(tours, choice, strict=True) if tour is not None}
        missed, before_s = (math.inf, math.inf) if sooner is None else sooner.ends
        if _at_best(shared) < (missed, before_s):
            chosen, table = {**tours, **backward}, Timetable(cell, options, spare)
            motions = {name: [part.motion for part in _split_at_rest(tour)] for name, tour in chosen.items()}
            limit_s = math.inf if len(reasons) < missed else before_s
            if table.run_together(motions, limit_s, distances, list(backward)):
                found = sooner = _Schedule(table, chosen, reasons)
    return found


class _TourPart(NamedTuple):
    """Tour segment from rest to rest: start time [s] and motion."""

    begin_s: float
    motion: Trajectory


def _split_at_rest(tour: TourResult) -> list[_TourPart]:
    """Split a tour wherever the arm is at rest."""
    rows = tour.trajectory.rows
    rests = [row for row in range(len(rows.time)) if not np.abs(rows.velocity[row]).max() > _AT_REST]
    spans = itertools.pairwise(rests)
    return [_TourPart(float(rows.time[a]), tour.trajectory.cut_after(b).cut_before(a)) for a, b in spans]


class _Schedule(NamedTuple):
    """Scheduled tours, and the reasons for unpicked fruits.

    Attributes:
        table: Start times of all segments.
        tours: Tour of each arm, by name.
        unreached: Error of each fruit in no tour.
    """

    table: Timetable
    tours: Mapping[str, TourResult]
    unreached: Mapping[str, HplanError]

    @property
    def ends(self) -> tuple[int, float]:
        """Number of unpicked fruits and finishing time of all arms [s], rounded."""
        return len(self.unreached), round(self.table.duration, 6)

    def result(self, cell: Cell, options: PlanOptions) -> CellTour:
        """Combine the tours on one clock; certify arms against each other."""
        phases, picked, dropped = dict[str, list[Phase]](), dict[str, float](), dict[str, float]()
        for name, tour in self.tours.items():
            for part, (begin, motion) in zip(_split_at_rest(tour), self.table.legs[name], strict=True):
                later, end = begin - part.begin_s, part.begin_s + motion.duration
                for found, times in ((picked, tour.picked), (dropped, tour.dropped)):
                    found |= {
                        fruit: t + later for fruit, t in times.items() if part.begin_s < t - _EQUAL_STATIONS_S < end
                    }
                inside = (each for each in tour.phases if part.begin_s < 0.5 * (each.start_s + each.end_s) < end)
                phases.setdefault(name, []).extend(phase.delay(later) for phase in inside)
        whole = cell.join_motions(self.table.motions)
        return CellTour(
            cell,
            whole,
            certify_between(cell, cell.split_motion(whole), options),
            {name: (tour,) for name, tour in self.tours.items()},
            {name: tuple(own) for name, own in phases.items()},
            picked,
            dropped,
            tuple(map(Unreached, self.unreached, self.unreached.values())),
        )
