"""Arms that pick together: the fruits shared out, each arm's own tour, its legs set out when the others leave room.

Who reaches a fruit alone picks it; of the others each arm takes those that are near, as many as its neighbours. Each
arm's tour is planned by itself, with all fruits hanging that are not its own. Its legs keep their motions; each begins
as soon as what the other arms are already to do leaves room, and nobody moves before that holds for ever after: there
is no deadlock, at worst a fruit that stays. In the end all arms against one another are certified as one motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hplan.base.arguments import instance
from hplan.base.arrays import Record
from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.base.lazy_import import InNotebook
from hplan.certificate.certificate import Certificate
from hplan.errors import CertificationError, HplanError, TourError
from hplan.planning.cell import Cell, CellArm, certify_between
from hplan.planning.options import PlanOptions
from hplan.planning.reachable import reachable
from hplan.planning.task import Progress, no_progress
from hplan.planning.timetable import SPARES, Timetable
from hplan.planning.world import World
from hplan.tour.result import Leg, TourResult
from hplan.tour.tour import TourOptions, plan_tour
from hplan.trajectory.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class CellTour(Record, InNotebook):
    """Arms that pick together.

    Attributes:
        cell: The arms.
        trajectory: All joints on one clock.
        between: What was shown of the arms against one another.
        tours: Each arm's own, by name, certified among obstacles and fruits: the legs that it runs, on a clock
            of the arm's own.
        begins_s: When each leg of each arm begins [s].
        picked: For each fruit that is picked when a tool is at it [s].
        unreached: The fruits that are not picked, and why.
    """

    cell: Cell
    trajectory: Trajectory
    between: Certificate
    tours: Mapping[str, tuple[TourResult, ...]]
    begins_s: Mapping[str, tuple[float, ...]]
    picked: Mapping[str, float]
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
        legs = {name: [leg for tour in own for leg in tour.legs] for name, own in self.tours.items()}
        busy = {name: sum(leg.trajectory.duration for leg in own) for name, own in legs.items()}
        return {
            "picked": len(self.picked),
            "unreached": dict(self.unreached),
            "makespan_s": makespan,
            "s_per_fruit": makespan / max(1, len(self.picked)),
            "busy_s": busy,
            "idle_s": {name: makespan - seconds for name, seconds in busy.items()},
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
    World.of(cell.robot, (), clearance=cell.scene.clearance).check_clear(cell.configuration({}), "start")
    progress("who reaches what")
    shares, reasons = _shared(cell, options)
    tours: dict[str, TourResult] = {}
    for arm in cell.arms:
        if shares[arm.name]:
            progress(f"tour of {arm.name}")
            try:
                tours[arm.name] = _tour(arm, options, shares[arm.name])
            except TourError as error:
                reasons |= dict(error.reasons)
    if not tours:
        raise TourError(list(reasons.items()))
    for spare in SPARES[1:]:
        progress("together")
        found = _Schedule(cell, options, spare).filled(tours, reasons)
        if found.between.verified:
            return found
    raise CertificationError("the tours of all arms together cannot be certified: " + found.between.violations[0])


def _shared(cell: Cell, options: PlanOptions) -> tuple[dict[str, list[str]], dict[str, HplanError]]:
    """The fruits of each arm, and why others are nobody's."""
    reach = {arm.name: reachable(arm.robot, arm.scene, options) for arm in cell.arms}
    bases = {arm.name: np.array(arm.position) for arm in cell.scene.robots}
    shares: dict[str, list[str]] = {arm.name: [] for arm in cell.arms}
    reasons: dict[str, HplanError] = {}
    shared = []
    for fruit in cell.scene.fruits:
        able = [name for name in shares if reach[name][fruit.name].can_be_picked]
        if not able:
            details = (reach[name][fruit.name].detail for name in shares)
            reasons[fruit.name] = HplanError("; ".join(dict.fromkeys(details)))
        elif len(able) == 1:
            shares[able[0]].append(fruit.name)
        else:
            away = sorted(
                (round(float(np.linalg.norm(np.array(fruit.center) - bases[name])), 6), name) for name in able
            )
            shared.append((round(away[0][0] - away[1][0], 6), fruit.name, [name for _, name in away]))
    most = math.ceil((len(shared) + sum(map(len, shares.values()))) / len(shares))
    for _, fruit_name, able in sorted(shared):  # who is far nearer than the others chooses first
        with_room = [name for name in able if len(shares[name]) < most]
        shares[(with_room or able)[0]].append(fruit_name)
    return shares, reasons


def _tour(arm: CellArm, options: PlanOptions, fruits: Sequence[str]) -> TourResult:
    """An arm's tour through fruits and back, with a stop after each."""
    return plan_tour(arm.robot, arm.scene, options, fruits=fruits, tour=TourOptions(stops=True, back=True))


class _Schedule:
    """When each leg begins."""

    def __init__(self, cell: Cell, options: PlanOptions, spare: float) -> None:
        self._cell, self._options = cell, options
        self._table = Timetable(cell, options, spare)
        self._legs: dict[str, list[Leg]] = {arm.name: [] for arm in cell.arms}
        self._tours: dict[str, list[TourResult]] = {arm.name: [] for arm in cell.arms}

    def filled(self, tours: Mapping[str, TourResult], reasons: Mapping[str, HplanError]) -> CellTour:
        """The tours with all legs set out; a leg that never can is left out, with its fruit."""
        left = {name: list(tour.legs) for name, tour in tours.items()}
        places, unreached = self._table.places, dict(reasons)
        for name, tour in tours.items():
            self._tours[name].append(tour)
            unreached |= {each.fruit: each.error for each in tour.unreached}
        waiting: set[str] = set()
        while any(left.values()):
            able = [name for name in left if left[name] and name not in waiting]
            if not able:  # nobody can go on: the one who is done soonest gives a fruit up
                name = min((name for name in left if left[name]), key=lambda each: (len(places[each]), each))
                left[name] = self._without_next(name, left[name], unreached)
                waiting.clear()
                continue
            name = min(able, key=lambda each: (len(places[each]), each))
            if self._table.set_out(name, left[name][0].trajectory):
                self._legs[name].append(left[name].pop(0))
                waiting.clear()
            else:
                waiting.add(name)
        return self._result(unreached)

    def _without_next(self, name: str, legs: Sequence[Leg], unreached: dict[str, HplanError]) -> list[Leg]:
        """The legs of an arm that gives its next fruit up, from where it is."""
        arm, fruits = self._cell.arm(name), [leg.fruit for leg in legs if leg.fruit is not None]
        done = self._tours[name][-1]
        self._tours[name][-1] = replace(done, legs=done.legs[: len(done.legs) - len(legs)])
        if fruits:
            unreached[fruits[0]] = HplanError("another arm is in the way for good")
        if len(fruits) < 2:
            return []  # it stays where it is
        try:
            rest = _tour(arm.starting(self._table.places[name][-1]), self._options, fruits[1:])
        except HplanError as error:
            unreached |= dict.fromkeys(fruits[1:], error)
            return []
        self._tours[name].append(rest)
        unreached |= {each.fruit: each.error for each in rest.unreached}
        return list(rest.legs)

    def _result(self, unreached: Mapping[str, HplanError]) -> CellTour:
        cell, picked = self._cell, dict[str, float]()
        begins = {name: tuple(begin for begin, _ in legs) for name, legs in self._table.legs.items()}
        for name, legs in self._legs.items():
            for begin, leg in zip(begins[name], legs, strict=True):
                if leg.fruit is not None:
                    reached = max(phase.end_s for phase in leg.phases if phase.name in ("transit", "approach"))
                    picked[leg.fruit] = begin + reached - leg.begin_s
        whole = cell.together(self._table.motions)
        return CellTour(
            cell,
            whole,
            certify_between(cell, whole, self._options),
            {name: tuple(tours) for name, tours in self._tours.items() if tours},
            begins,
            picked,
            {fruit: str(error) for fruit, error in unreached.items()},
        )
