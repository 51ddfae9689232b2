"""Arms that pick together: the fruits shared out, each arm's own tour, and who waits for whom.

Who reaches a fruit alone picks it; the others are shared out so that all arms are done soonest (`hplan.tour.sharing`).
Each arm's tour is planned by itself, past others where they begin, with all fruits hanging that are not its own; fruit
to which it finds no motion goes to another that can pick it. What is found of motions makes the next shares better
known. Tours are run as they are or reversed, each arm waiting where it rests, as all are done soonest so.

There is no deadlock: at worst one goes after the other, past those that stand where they begin and end. In the end all
arms against one another are certified as one motion.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
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
from hplan.planning.cell import Cell, CellArm, certify_between, check_options, may_touch_report, standing
from hplan.planning.options import PlanOptions
from hplan.planning.reachable import reachable
from hplan.planning.stages import Progress, no_progress
from hplan.planning.timetable import SPARES, Timetable
from hplan.planning.world import World
from hplan.tour.carried import carrying
from hplan.tour.result import TourResult
from hplan.tour.sharing import Share, exchanged, first_share, nearness
from hplan.tour.tour import TourOptions, TourPlanner
from hplan.trajectory.trajectory import Phase, Trajectory

#: An arm that moves no faster rests [rad/s, m/s]; times so near are the same [s].
_AT_REST: Final = 1e-9
_SAME_S: Final = 1e-6

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
    check_options(options, "tours of several arms")
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
    apart = replace(cell, arms=tuple(_among_others(cell, arm) for arm in cell.arms))
    progress("who reaches what")
    able, reasons = _able(apart, options)
    mine = {arm.name: [fruit for fruit in able if arm.name in able[fruit]] for arm in apart.arms}
    pickers = {arm.name: _Picker(arm, options, mine[arm.name]) for arm in apart.arms if mine[arm.name]}
    if not pickers:
        raise TourError(list(reasons.items()))
    why = "one after the other they come too near to each other"
    for spare in SPARES[1:]:
        schedule = _soonest(cell, options, spare, pickers, able, reasons, progress)
        if schedule is None:
            break
        found = schedule.result(cell, options)
        if found.between.verified:
            return found
        why = found.between.violations[0]
    raise CertificationError(f"the tours of all arms together cannot be certified: {why}")


def _at_best(shared: _Shared) -> tuple[int, float]:
    """What `_Schedule.ends` is at best, where nobody waits."""
    tours, reasons = shared
    return len(reasons), round(max(tour.duration for tour in tours.values()), 6)


def _among_others(cell: Cell, arm: CellArm) -> CellArm:
    """An arm to which the others are obstacles where they begin, thicker than samples of a timetable have to keep."""
    others = standing(cell, arm.name, SPARES[1] + 5e-4)
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
        arm = self._arm
        tour = TourOptions(back=True, drop_off=arm.drop_off, every=None if arm.drop_off is None else arm.every)
        return TourPlanner(arm.robot, arm.scene, self._options, tour, self._able)

    def share(self, tour: TourResult | None = None) -> Share:
        """What it can pick, and what it does in a tour."""
        share = Share(*self._planner.costs(self._able))
        if tour is None:
            return share
        share = replace(share, order=tuple(fruit for fruit in tour.order if fruit in share.grasps))
        return replace(share, more_s=tour.duration - share.seconds)

    def reversed(self, tour: TourResult) -> TourResult | None:
        """The reversed tour; None where that is not known to be one."""
        return self._planner.reversed(tour)

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
) -> _Schedule | None:  # fmt: skip
    """The schedule that ends soonest, of shares that promise to be done sooner by what is known of motions by then.

    None where arms that go one after the other would be too near to one another.

    Raises:
        TourError: No arm can pick anything.
    """
    every = {name: picker.share() for name, picker in pickers.items()}
    known = {fruit: [name for name in names if fruit in every[name].grasps] for fruit, names in able.items()}
    late = {name: [f for f, names in able.items() if names[:1] == [name] and not known[f]] for name in every}
    near, names, soonest = nearness(cell, every), list(pickers), None
    tried, most = list[dict[str, set[str]]](), 8  # shares that are planned from each first one
    for lowest in ((),) if options.effort == "quick" else ((), names, names[::-1]):
        weight, kept, first = 1.0, dict[str, TourResult](), first_share(cell, known, lowest)
        shares = exchanged({name: every[name].over(first[name]) for name in names}, near, weight)
        for _ in range(most):
            fruits = {name: set(share.order) for name, share in shares.items()}
            waits = fruits in tried  # once more the same would be of no use
            if not waits:
                tried.append(fruits)
                without = dict(reasons)
                given = {name: [*share.order, *late[name]] for name, share in shares.items()}
                tours = _tours(pickers, able, given, without, progress)
                if not tours:
                    raise TourError(list(without.items()))
                progress("together")
                found = _together(cell, options, spare, pickers, (tours, without), soonest)
                kept, soonest = tours if found or not kept else kept, found or soonest
                waits = found is None or found.ends[1] > 1.01 * _at_best((tours, without))[1]
            # Where arms wait less of the next shares is to be where another is.
            weight *= 1.5 if waits else 0.7
            if kept:
                shares = {name: picker.share(kept.get(name)) for name, picker in pickers.items()}
            shares = exchanged(shares, near, weight)
    return soonest


def _together(
    cell: Cell, options: PlanOptions, spare: float, pickers: Mapping[str, _Picker], shared: _Shared,
    sooner: _Schedule | None,
) -> _Schedule | None:  # fmt: skip
    """The schedule of tours, some of them reversed, that ends soonest; None where another one ends as soon."""
    found, (tours, reasons), distances = None, shared, dict[tuple[str, str], FloatArray]()
    if sooner is not None and _at_best(shared) >= sooner.ends:
        return None
    both = [(None, pickers[name].reversed(tour)) for name, tour in tours.items()]
    # With more than two arms not all that may be reversed are tried.
    for choice in itertools.islice(itertools.product(*both), 4):
        backward = {name: tour for name, tour in zip(tours, choice, strict=True) if tour is not None}
        missed, before_s = (math.inf, math.inf) if sooner is None else sooner.ends
        if _at_best(shared) < (missed, before_s):
            chosen, table = {**tours, **backward}, Timetable(cell, options, spare)
            motions = {name: [part.motion for part in _parts(tour)] for name, tour in chosen.items()}
            limit_s = math.inf if len(reasons) < missed else before_s
            if table.run_together(motions, limit_s, distances, list(backward)):
                found = sooner = _Schedule(table, chosen, reasons)
    return found


class _Part(NamedTuple):
    """A part of a tour from rest to rest, as from fruit to fruit: when it begins in the tour [s], and its motion."""

    begin_s: float
    motion: Trajectory


def _parts(tour: TourResult) -> list[_Part]:
    """A tour, cut wherever the arm rests."""
    rows = tour.trajectory.rows
    rests = [row for row in range(len(rows.time)) if not np.abs(rows.velocity[row]).max() > _AT_REST]
    spans = itertools.pairwise(rests)
    return [_Part(float(rows.time[a]), tour.trajectory.until(b).since(a)) for a, b in spans]


class _Schedule(NamedTuple):
    """Tours whose parts are set out, and why fruits are in none of them."""

    table: Timetable
    tours: Mapping[str, TourResult]
    unreached: Mapping[str, HplanError]

    @property
    def ends(self) -> tuple[int, float]:
        """How many fruits are not picked, and when the last arm is done [s], rounded."""
        return len(self.unreached), round(self.table.duration, 6)

    def result(self, cell: Cell, options: PlanOptions) -> CellTour:
        """The tours on one clock, the arms certified against one another."""
        phases, picked, dropped = dict[str, list[Phase]](), dict[str, float](), dict[str, float]()
        for name, tour in self.tours.items():
            for part, (begin, motion) in zip(_parts(tour), self.table.legs[name], strict=True):
                later, end = begin - part.begin_s, part.begin_s + motion.duration
                for found, times in ((picked, tour.picked), (dropped, tour.dropped)):
                    found |= {fruit: t + later for fruit, t in times.items() if part.begin_s < t - _SAME_S < end}
                inside = (each for each in tour.phases if part.begin_s < 0.5 * (each.start_s + each.end_s) < end)
                phases.setdefault(name, []).extend(phase.later(later) for phase in inside)
        whole = cell.together(self.table.motions)
        return CellTour(
            cell,
            whole,
            certify_between(cell, cell.apart(whole), options),
            {name: (tour,) for name, tour in self.tours.items()},
            {name: tuple(own) for name, own in phases.items()},
            picked,
            dropped,
            {fruit: str(error) for fruit, error in self.unreached.items()},
        )
