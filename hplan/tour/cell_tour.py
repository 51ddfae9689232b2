"""Arms that pick together: the fruits shared out, each arm's own tour, its parts set out when the others leave room.

Who reaches a fruit alone picks it; of the others each arm takes those that are near, as many as its neighbours, or,
where all ends sooner for it, one the low and another the high ones. Each arm's tour is planned by itself, past others
where they begin, with all fruits hanging that are not its own; fruit to which it finds no motion goes to another that
can pick it. It is as it would be alone, at rest at the fruits: from rest to rest each part begins as soon as what the
other arms are already to do leaves room, and nobody moves before that holds for ever after. Who cannot go on waits or,
where all ends sooner for it, goes around the others where they stand, through its other fruits as is then best; where
nobody can, one has to: there is no deadlock, at worst a fruit that stays. In the end all arms against one another are
certified as one motion.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from hplan.base.arguments import instance
from hplan.base.arrays import Record
from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.base.lazy_import import InNotebook
from hplan.certificate.certificate import Certificate
from hplan.errors import CertificationError, HplanError, TourError
from hplan.planning.cell import Cell, CellArm, certify_between, standing
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.reachable import reachable
from hplan.planning.task import Progress, no_progress
from hplan.planning.timetable import SPARES, Timetable
from hplan.planning.world import World
from hplan.scene.model import Fruit, Goal
from hplan.tour.carried import carrying
from hplan.tour.result import Leg, TourResult
from hplan.tour.tour import TourOptions, TourPlanner
from hplan.trajectory.trajectory import Phase, Trajectory

#: An arm that moves no faster rests [rad/s, m/s]; times so near are the same [s].
_AT_REST: Final = 1e-9
_SAME_S: Final = 1e-6

#: So many fruits change hands for tours that end together, while these differ by more than this much of a fruit's time.
_BALANCINGS: Final = 2
_UNEVEN: Final = 0.5

#: Around others an arm goes at once, rather than wait, where it takes no more longer than this many fruits do.
_DETOUR: Final = 1.0

#: By how much arms that stand are thicker to others that pass them [m]: more than samples have to keep, by `_BEYOND`.
_BEYOND: Final = 5e-4
_THICKER: Final = SPARES[1] + _BEYOND


#: The tour of each arm, and why fruits are not in any.
_Shared: TypeAlias = tuple[dict[str, TourResult], dict[str, HplanError]]


@dataclass(frozen=True, eq=False)
class CellTour(Record, InNotebook):
    """Arms that pick together.

    Attributes:
        cell: The arms.
        trajectory: All joints on one clock.
        between: What was shown of the arms against one another.
        tours: Each arm's own, by name, certified among obstacles and fruits, on a clock of its own: from rest to rest
            it is run as it is, at rests the arm may wait.
        phases: The parts of each arm's motion that are run, by name; in between it waits.
        picked: For each fruit that is picked when a tool is at it [s].
        dropped: For each fruit that is let go at a drop-off when [s].
        unreached: The fruits that are not picked, and why.
    """

    cell: Cell
    trajectory: Trajectory
    between: Certificate
    tours: Mapping[str, tuple[TourResult, ...]]
    phases: Mapping[str, tuple[Phase, ...]]
    picked: Mapping[str, float]
    dropped: Mapping[str, float]
    unreached: Mapping[str, str]

    @property
    def parts(self) -> tuple[Certificate, ...]:
        """All certificates: of the arms against one another, and of each tour."""
        return (self.between, *(tour.certificate for own in self.tours.values() for tour in own))

    @property
    def verified(self) -> bool:
        """True if everything was shown: every arm among the obstacles, and all against one another."""
        return all(part.verified for part in self.parts)

    @property
    def trajectories(self) -> dict[str, Trajectory]:
        """The motion of each arm in its own joints, by name, all on one clock."""
        return self.cell.apart(self.trajectory)

    @property
    def report(self) -> dict[str, Any]:
        """The numbers of `tour.json`."""
        makespan, apart = self.trajectory.duration, 1e3 * self.between.min_clearance_m
        busy = {name: sum(phase.end_s - phase.start_s for phase in own) for name, own in self.phases.items()}
        return {
            "picked": len(self.picked),
            "unreached": dict(self.unreached),
            "makespan_s": makespan,
            "s_per_fruit": makespan / max(1, len(self.picked)),
            "busy_s": busy,
            "idle_s": {name: max(0.0, makespan - seconds) for name, seconds in busy.items()},
            "parallel_ratio": sum(busy.values()) / (len(busy) * makespan) if makespan > 0.0 else None,
            "speed_up_over_one_arm": sum(busy.values()) / makespan if makespan > 0.0 else None,
            "verified": self.verified,
            "between_arms_mm": apart if math.isfinite(apart) else None,
        }  # fmt: skip


def plan_cell_tour(
    cell: Cell,
    options: PlanOptions | None = None,
    *,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> CellTour:
    """Plan picking tours of all arms of a cell from their starts, where they end.

    Args:
        cell: Arms, obstacles and fruits; goals do not matter.
        options: How to plan.
        progress: Called with what is being done.
        cancel: As for `hplan.plan`.

    Raises:
        HplanError: As `plan_tour`.
        ConfigurationInCollisionError: The arms touch where they start.
        TourError: No arm can pick anything.
        CertificationError: The motions of all arms together could not be certified.
    """
    instance("cell", cell, Cell, "load_cell")
    options = PlanOptions() if options is None else instance("options", options, PlanOptions)
    options.check_for(None)
    with time_limit(options.deadline_s, cancel) as limit:
        try:
            return _planned(cell, replace(options, deadline_s=None), progress)
        except TimeIsUpError:
            raise limit.error(["tours of all arms"]) from None


def _planned(cell: Cell, options: PlanOptions, progress: Progress) -> CellTour:
    carry = [arm.tool_frame for arm in cell.arms if arm.drop_off is not None]
    thickest = max((fruit.radius for fruit in cell.scene.fruits), default=0.0)
    # Whoever ever carries has the room that it then takes all along.
    cell = replace(cell, robot=carrying(cell.robot, thickest, carry)) if carry and thickest else cell
    World.of(cell.robot, (), clearance=cell.scene.clearance).check_clear(cell.configuration({}), "start")
    apart = replace(cell, arms=tuple(_among_others(cell, arm, _THICKER) for arm in cell.arms))
    progress("who reaches what")
    able, reasons = _able(apart, options)
    names, shared = [arm.name for arm in cell.arms], list[_Shared]()
    pickers = {
        arm.name: _Picker(arm, options, [fruit for fruit in able if arm.name in able[fruit]]) for arm in apart.arms
    }
    lowest = ((),) if options.effort == "quick" else ((), names, names[::-1])
    every = [_shares(apart, able, each) for each in lowest]
    for shares in [each for number, each in enumerate(every) if each not in every[:number]]:
        without = dict(reasons)
        tours = _tours(pickers, able, shares, without, progress)
        if tours:
            shared += [(each, without) for each in _balanced(apart, pickers, able, tours, progress)]
    if not shared:
        raise TourError(list(without.items()))
    for spare in SPARES[1:]:
        progress("together")
        ways: _Ways = {}
        best = list[_Schedule]()
        for each in sorted(shared, key=_at_best):
            for order, detour in itertools.product((names, names[::-1]), (0.0, _DETOUR)):
                if not best or _at_best(each) < best[0].ends:
                    schedule = _Schedule(cell, options, spare, order, detour, ways).filled(*each)
                    best = sorted([*best, schedule], key=lambda schedule: schedule.ends)[:1]
        found = best[0].result()
        if found.between.verified:
            return found
    raise CertificationError("the tours of all arms together cannot be certified: " + found.between.violations[0])


def _at_best(shared: _Shared) -> tuple[int, float]:
    """What `_Schedule.ends` is at best, where nobody waits."""
    tours, reasons = shared
    return len(reasons), round(max(tour.duration for tour in tours.values()), 6)


def _among_others(there: Cell, arm: CellArm, thicker: float) -> CellArm:
    """An arm to which the others are obstacles, where they stand and as much thicker [m]."""
    others = standing(there, arm.name, thicker)
    return replace(arm, scene=arm.scene.with_obstacles([*arm.scene.obstacles, *others]))


def _able(cell: Cell, options: PlanOptions) -> tuple[dict[str, list[str]], dict[str, HplanError]]:
    """Who can pick each fruit, the nearest first, and why others are nobody's."""
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


def _shares(cell: Cell, able: Mapping[str, Sequence[str]], lowest: Sequence[str] = ()) -> dict[str, list[str]]:
    """The fruits of each arm, about as many of each: those near it or, with names, the lowest for the first of them."""
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
    for _, fruit_name, names in sorted(shared):  # who is far nearer than the others chooses first
        with_room = [name for name in names if len(shares[name]) < most]
        shares[(with_room or names)[0]].append(fruit_name)
    return shares


class _Picker:
    """Tours of an arm, what one finds of motions kept for the others."""

    def __init__(self, arm: CellArm, options: PlanOptions, able: Sequence[str]) -> None:
        """Begin without any; of an arm that never goes to its drop-off it is not asked how it would."""
        self._arm, self._options, self._able = arm, options, able
        self._tours: dict[frozenset[str], TourResult | TourError] = {}

    @cached_property
    def _planner(self) -> TourPlanner:
        return _planner(self._arm, self._options, self._able)

    def tour(self, fruits: Sequence[str]) -> TourResult:
        """The tour through fruits and home.

        Raises:
            TourError: It can pick none of them.
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
    """The tour of each arm; fruit to which one finds no motion goes to the next that can pick it."""
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


def _balanced(
    cell: Cell,
    pickers: Mapping[str, _Picker],
    able: Mapping[str, Sequence[str]],
    tours: dict[str, TourResult],
    progress: Progress,
) -> Iterator[dict[str, TourResult]]:
    """The tours, then with fruit of the longest given to the arm that is done soonest, as long as all end sooner."""
    yield tours
    bases = {arm.name: np.array(arm.position) for arm in cell.scene.robots}
    centers = {fruit.name: np.array(fruit.center) for fruit in cell.scene.fruits}
    for _ in range(_BALANCINGS):
        ends = {name: tours[name].duration if name in tours else 0.0 for name in bases}
        giver, taker = (choose(ends, key=lambda name: (round(ends[name], 6), name)) for choose in (max, min))
        order = tours[giver].order
        given = sorted(
            (round(float(np.linalg.norm(centers[f] - bases[taker]) - np.linalg.norm(centers[f] - bases[giver])), 6), f)
            for f in order
            if taker in able[f]
        )
        if len(order) < 2 or not given or ends[giver] - ends[taker] < _UNEVEN * ends[giver] / len(order):
            break
        progress(f"a fruit of {giver} for {taker}")
        fruit, has = given[0][1], tours[taker].order if taker in tours else ()
        shares = {giver: [each for each in order if each != fruit], taker: [*has, fruit]}
        try:
            found = tours | {name: pickers[name].tour(share) for name, share in shares.items()}
        except TourError:
            break
        less = sum(len(tour.order) for tour in found.values()) < sum(len(tour.order) for tour in tours.values())
        if less or max(tour.duration for tour in found.values()) > ends[giver] - _SAME_S:
            break
        tours = found
        yield tours


def _planner(arm: CellArm, options: PlanOptions, fruits: Sequence[str], *, back: bool = True) -> TourPlanner:
    """What plans an arm's tours through some of the fruits and, if asked for, back."""
    every = None if arm.drop_off is None else arm.every
    tour = TourOptions(back=back, drop_off=arm.drop_off, every=every)
    return TourPlanner(arm.robot, arm.scene, options, tour, fruits)


def _way(arm: CellArm, goal: Goal, options: PlanOptions, carried: Sequence[Fruit] = ()) -> TourResult:
    """A tour that picks nothing: to the drop-off with what is carried, or home."""
    robot, name = arm.robot, "return"
    if carried:
        robot, name = carrying(robot, max(fruit.radius for fruit in carried)), "drop"
    found = plan(robot, arm.scene.model_copy(update={"goal": goal}), options)
    motion, phases = found.trajectory, (Phase(name, 0.0, found.trajectory.duration),)
    legs = (Leg(None, None, 0.0, phases, motion, found.certificate),)
    dropped = dict.fromkeys((fruit.name for fruit in carried), motion.duration)
    return TourResult((), legs, motion, found.certificate, {}, dropped, (), found.report, robot, arm.scene)


class _Part(NamedTuple):
    """A part of a tour from rest to rest, as from fruit to fruit: when it begins in the tour [s], and its motion."""

    tour: TourResult
    begin_s: float
    motion: Trajectory


class _Around(NamedTuple):
    """What an arm does around others where they stand: through fruits and home; and which of them stay, and why."""

    parts: list[_Part]
    missed: dict[str, HplanError]

    def takes(self, fruits: Collection[str]) -> float:
        """How long they take [s]; inf where a fruit stays, or there is no way."""
        if not self.parts or self.missed.keys() & fruits:
            return math.inf
        return _seconds(self.parts)


#: Ways around others, by who goes, through which fruits, what it holds, what hangs, and where all stand.
_Ways: TypeAlias = dict[tuple[Any, ...], _Around]


def _seconds(parts: Sequence[_Part]) -> float:
    return sum(part.motion.duration for part in parts)


def _parts(tour: TourResult) -> list[_Part]:
    """A tour, cut wherever the arm rests."""
    rows = tour.trajectory.rows
    rests = [row for row in range(len(rows.time)) if not np.abs(rows.velocity[row]).max() > _AT_REST]
    spans = itertools.pairwise(rests)
    return [_Part(tour, float(rows.time[a]), tour.trajectory.until(b).since(a)) for a, b in spans]


class _Schedule:
    """When each part of each arm's tours begins.

    Attributes:
        unreached: The fruits that are not picked, and why.
    """

    def __init__(
        self, cell: Cell, options: PlanOptions, spare: float, order: Sequence[str], detour: float, ways: _Ways
    ) -> None:
        """Begin with nothing.

        Args:
            spare: Distance between arms at samples, as for `Timetable` [m].
            order: Names of the arms; who comes first goes first where several could.
            detour: An arm goes around others instead of waiting where it then takes no more longer than this many
                fruits do; with 0.0 it waits as long as another can go on.
            ways: Ways around others that are known, with this spare.
        """
        self.unreached: dict[str, HplanError] = {}
        self._order, self._detour, self._ways = order, detour, ways
        self._cell, self._options, self._thicker = cell, options, spare + _BEYOND
        self._table = Timetable(cell, options, spare)
        self._tours: dict[str, list[TourResult]] = {arm.name: [] for arm in cell.arms}
        self._picked, self._dropped = dict[str, float](), dict[str, float]()
        self._phases: dict[str, list[Phase]] = {arm.name: [] for arm in cell.arms}
        self._gone: set[tuple[str, tuple[int, ...]]] = set()

    @property
    def ends(self) -> tuple[int, float]:
        """How many fruits are not picked, and when the last arm is done [s], rounded."""
        return len(self.unreached), round(self._table.duration, 6)

    def filled(self, tours: Mapping[str, TourResult], reasons: Mapping[str, HplanError]) -> _Schedule:
        """The tours with all their parts set out; fruit to which an arm never can go is left out."""
        left = {name: _parts(tour) for name, tour in tours.items()}
        self.unreached = dict(reasons)
        waiting: set[str] = set()
        while any(left.values()):
            able = [name for name in left if left[name] and name not in waiting]
            name = min(able or (name for name in left if left[name]), key=self._turn)
            if able and self._table.set_out(name, left[name][0].motion):
                self._note(name, left[name].pop(0))
                waiting.clear()
                continue
            fruits = sorted({fruit for part in left[name] for fruit in part.tour.order if fruit not in self._picked})
            longest = (1.0 + self._detour / (1 + len(fruits))) * _seconds(left[name])
            around = self._around(name, fruits) if self._detour or not able else None
            if around is None or (able and around.takes(fruits) > longest):
                waiting.add(name)
                continue
            self._gone.add(self._state(name))
            left[name] = list(around.parts)
            self.unreached |= around.missed
            waiting.clear()
        return self

    def _turn(self, name: str) -> tuple[int, int]:
        """When an arm's turn is: who is done soonest goes on."""
        return len(self._table.places[name]), self._order.index(name)

    def _note(self, name: str, part: _Part) -> None:
        """Keep what is done in a part of an arm's tour that was set out."""
        tour, end = part.tour, part.begin_s + part.motion.duration
        if tour not in self._tours[name]:
            self._tours[name].append(tour)
        later = self._table.legs[name][-1][0] - part.begin_s
        for found, times in ((self._picked, tour.picked), (self._dropped, tour.dropped)):
            found |= {fruit: t + later for fruit, t in times.items() if part.begin_s < t - _SAME_S < end}
        inside = (phase for phase in tour.phases if part.begin_s < 0.5 * (phase.start_s + phase.end_s) < end)
        self._phases[name] += [phase.later(later) for phase in inside]

    def _state(self, name: str) -> tuple[str, tuple[int, ...]]:
        """Who asks for a way, and how far all are."""
        return name, tuple(map(len, self._table.places.values()))

    def _around(self, name: str, fruits: Sequence[str]) -> _Around:
        """What an arm still does, from where it is and around the others where they stand, through fruits and home."""
        if self._state(name) in self._gone:  # it stays where it is
            return _Around([], dict.fromkeys(fruits, HplanError("another arm is in the way for good")))
        now = self._table.free_from(name)
        gone = {fruit for fruit, time in self._picked.items() if time <= now + _SAME_S}
        own = {fruit for tour in self._tours[name] for fruit in tour.order} & self._picked.keys() - self._dropped.keys()
        rests = {each: places[-1] for each, places in self._table.places.items()}
        key = (name, *fruits, frozenset(gone), frozenset(own), *(q.tobytes() for q in rests.values()))
        if key not in self._ways:
            self._ways[key] = self._found(self._cell.starting(rests), name, fruits, gone, own)
        return self._ways[key]

    def _found(self, there: Cell, name: str, fruits: Sequence[str], gone: set[str], own: set[str]) -> _Around:
        """As `_around`, all arms being where they are, without fruits that are gone, with its own that it carries."""
        arm, missed = there.arm(name), dict[str, HplanError]()
        hanging = tuple(fruit for fruit in arm.scene.fruits if fruit.name not in gone)
        arm = _among_others(there, replace(arm, scene=arm.scene.model_copy(update={"fruits": hanging})), self._thicker)
        tours = list[TourResult]()
        try:
            if arm.drop_off is not None and own:
                carried = [fruit for fruit in self._cell.scene.fruits if fruit.name in own]
                tours.append(_way(arm, arm.drop_off, self._options, carried))
                arm = arm.starting(tours[-1].trajectory.position[-1])
            if fruits:
                tours.append(_planner(arm, self._options, fruits, back=False).run(fruits))
                missed = {each.fruit: each.error for each in tours[-1].unreached}
                arm = arm.starting(tours[-1].trajectory.position[-1])
        except HplanError as error:
            missed = dict.fromkeys(fruits, error)
        if arm.drop_off is None or not own or tours:  # what it still carries it could touch something with
            home = self._cell.configuration({})[arm.joints]
            with suppress(HplanError):
                tours.append(_way(arm, Goal(joints_rad=tuple(home.tolist())), self._options))
        return _Around([part for tour in tours for part in _parts(tour)], missed)

    def result(self) -> CellTour:
        """The tours on one clock, the arms certified against one another."""
        cell = self._cell
        whole = cell.together(self._table.motions)
        return CellTour(
            cell,
            whole,
            certify_between(cell, whole, self._options),
            {name: tuple(tours) for name, tours in self._tours.items() if tours},
            {name: tuple(phases) for name, phases in self._phases.items() if phases},
            self._picked,
            self._dropped,
            {fruit: str(error) for fruit, error in self.unreached.items()},
        )
