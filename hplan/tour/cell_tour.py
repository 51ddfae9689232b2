"""Arms that pick together: the fruits shared out, each arm's own tour, and who waits for whom.

Who reaches a fruit alone picks it; the others are shared out so that all arms are done soonest (`hplan.tour.sharing`).
Each arm's tour is planned by itself, past others where they begin, with all fruits hanging that are not its own; fruit
to which it finds no motion goes to another that can pick it. What is found of motions makes the next shares better
known. Tours are run as they are or the other way round, each arm waiting where it rests, as all are done soonest so.

Where waits are not enough, each part of a tour, from rest to rest, begins as soon as what the other arms are already to
do leaves room, and nobody moves before that holds for ever after. Where nobody can go on so, one goes around the others
where they stand, through its other fruits as is then best: there is no deadlock, at worst a fruit that stays. In the
end all arms against one another are certified as one motion.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from hplan.base.arguments import instance
from hplan.base.arrays import FloatArray, Record
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
from hplan.tour.sharing import Share, exchanged, first_share, nearness
from hplan.tour.tour import TourOptions, TourPlanner
from hplan.trajectory.trajectory import Phase, Trajectory

#: An arm that moves no faster rests [rad/s, m/s]; times so near are the same [s].
_AT_REST: Final = 1e-9
_SAME_S: Final = 1e-6

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
    mine = {arm.name: [fruit for fruit in able if arm.name in able[fruit]] for arm in apart.arms}
    pickers = {arm.name: _Picker(arm, options, mine[arm.name]) for arm in apart.arms if mine[arm.name]}
    if not pickers:
        raise TourError(list(reasons.items()))
    for spare in SPARES[1:]:
        found = _soonest(cell, options, spare, pickers, able, reasons, progress).result()
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


class _Picker:
    """Tours of an arm, what one finds of motions kept for the others."""

    def __init__(self, arm: CellArm, options: PlanOptions, able: Sequence[str]) -> None:
        """Begin without any.

        Args:
            able: The fruits that it may pick.
        """
        self._arm, self._options, self._able = arm, options, able
        self._tours: dict[frozenset[str], TourResult | TourError] = {}

    @cached_property
    def _planner(self) -> TourPlanner:
        return _planner(self._arm, self._options, self._able)

    def share(self, tour: TourResult | None = None) -> Share:
        """What it can pick, and what it does in a tour."""
        share = Share(*self._planner.costs(self._able))
        if tour is None:
            return share
        share = replace(share, order=tuple(fruit for fruit in tour.order if fruit in share.grasps))
        return replace(share, more_s=tour.duration - share.seconds)

    def turned(self, tour: TourResult) -> TourResult | None:
        """A tour the other way round; None where that is not known to be one."""
        return self._planner.turned(tour)

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


def _soonest(
    cell: Cell, options: PlanOptions, spare: float, pickers: Mapping[str, _Picker], able: Mapping[str, Sequence[str]],
    reasons: Mapping[str, HplanError], progress: Progress,
) -> _Schedule:  # fmt: skip
    """The schedule that ends soonest, of shares that promise to be done sooner by what is known of motions by then.

    Raises:
        TourError: No arm can pick anything.
    """
    every = {name: picker.share() for name, picker in pickers.items()}
    known = {fruit: [name for name in names if fruit in every[name].grasps] for fruit, names in able.items()}
    late = {name: [f for f, names in able.items() if names[:1] == [name] and not known[f]] for name in every}
    near, names, soonest, planned = nearness(cell, every), list(pickers), list[_Schedule](), list[_Shared]()
    tried, most = list[dict[str, set[str]]](), 8  # shares that are planned from each first one
    for lowest in ((),) if options.effort == "quick" else ((), names, names[::-1]):
        weight, kept, first = 1.0, dict[str, TourResult](), first_share(cell, known, lowest)
        shares = exchanged({name: every[name].over(first[name]) for name in names}, near, weight)
        for _ in range(most):
            fruits = {name: set(share.order) for name, share in shares.items()}
            waits = fruits in tried
            if not waits:
                tried.append(fruits)
                without = dict(reasons)
                given = {name: [*share.order, *late[name]] for name, share in shares.items()}
                tours = _tours(pickers, able, given, without, progress)
                if not tours:
                    break
                planned.append((tours, without))
                progress("together")
                found = _together(cell, options, spare, pickers, planned[-1], soonest)
                kept = tours if found or not kept else kept
                soonest = found or soonest
                waits = not found or found[0].ends[1] > 1.01 * _at_best(planned[-1])[1]
            # Where arms wait less of the next shares is to be where another is.
            weight *= 1.5 if waits else 0.7
            shares = exchanged({name: picker.share(kept.get(name)) for name, picker in pickers.items()}, near, weight)
    if not planned:
        raise TourError(list(reasons.items()))
    if not soonest:
        ways: _Ways = {}
        likely = sorted(planned, key=_at_best)[:3]
        orders = itertools.product(likely, (names, names[::-1]))
        filled = (_Schedule(cell, options, spare, order, ways).filled(*each) for each, order in orders)
        soonest = sorted(filled, key=lambda schedule: schedule.ends)
    return soonest[0]


def _together(
    cell: Cell, options: PlanOptions, spare: float, pickers: Mapping[str, _Picker], shared: _Shared,
    sooner: Sequence[_Schedule],
) -> list[_Schedule]:  # fmt: skip
    """The schedule of tours, some the other way round, that ends soonest; none where another ends as soon."""
    found, (tours, reasons), distances = list(sooner), shared, dict[tuple[str, str], FloatArray]()
    both = [(None, pickers[name].turned(tour)) for name, tour in tours.items()]
    # With more than two arms not every way round is tried.
    for turns in itertools.islice(itertools.product(*both), 4):
        turned = {name: tour for name, tour in zip(tours, turns, strict=True) if tour is not None}
        if not found or _at_best(shared) < found[0].ends:
            schedule = _Schedule(cell, options, spare, list(pickers), {})
            if schedule.together(tours | turned, reasons, found, distances, list(turned)):
                found = [schedule]
    return [] if found == list(sooner) else found


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

    def __init__(self, cell: Cell, options: PlanOptions, spare: float, order: Sequence[str], ways: _Ways) -> None:
        """Begin with nothing.

        Args:
            spare: Distance between arms at samples, as for `Timetable` [m].
            order: Names of the arms; who comes first goes first where several could.
            ways: Ways around others that are known, with this spare.
        """
        self.unreached: dict[str, HplanError] = {}
        self._order, self._ways = order, ways
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

    def together(
        self, tours: Mapping[str, TourResult], reasons: Mapping[str, HplanError], others: Sequence[_Schedule],
        distances: dict[tuple[str, str], FloatArray], turned: Collection[str],
    ) -> bool:  # fmt: skip
        """True where the tours, each arm waiting where it rests, can be done sooner than others; they are set out then.

        Further arguments are those of `Timetable.run_together`.
        """
        parts, self.unreached = {name: _parts(tour) for name, tour in tours.items()}, dict(reasons)
        sooner = min((other.ends[1] for other in others if other.ends[0] <= len(reasons)), default=math.inf)
        motions = {name: [part.motion for part in own] for name, own in parts.items()}
        if not self._table.run_together(motions, sooner, distances, turned):
            return False
        for name, own in parts.items():
            for part, (begin, _) in zip(own, self._table.legs[name], strict=True):
                self._note(name, part, begin)
        return True

    def filled(self, tours: Mapping[str, TourResult], reasons: Mapping[str, HplanError]) -> _Schedule:
        """The tours with all their parts set out; fruit to which an arm never can go is left out."""
        left = {name: _parts(tour) for name, tour in tours.items()}
        self.unreached = dict(reasons)
        waiting: set[str] = set()
        while any(left.values()):
            able = [name for name in left if left[name] and name not in waiting]
            name = min(able or (name for name in left if left[name]), key=self._turn)
            if able and self._table.set_out(name, left[name][0].motion):
                self._note(name, left[name].pop(0), self._table.legs[name][-1][0])
                waiting.clear()
                continue
            if able:
                waiting.add(name)
                continue
            fruits = sorted({fruit for part in left[name] for fruit in part.tour.order if fruit not in self._picked})
            around = self._around(name, fruits)
            self._gone.add(self._state(name))
            left[name] = list(around.parts)
            self.unreached |= around.missed
            waiting.clear()
        return self

    def _turn(self, name: str) -> tuple[int, int]:
        """When an arm's turn is: who is done soonest goes on."""
        return len(self._table.places[name]), self._order.index(name)

    def _note(self, name: str, part: _Part, begin: float) -> None:
        """Keep what is done in a part of an arm's tour that begins at a time [s]."""
        tour, end = part.tour, part.begin_s + part.motion.duration
        if tour not in self._tours[name]:
            self._tours[name].append(tour)
        later = begin - part.begin_s
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
