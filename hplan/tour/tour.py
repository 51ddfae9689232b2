"""Picking tours: pick many fruits from one start in the quickest order.

The order is optimized by the durations of certified motions (`hplan.tour.motions`, `hplan.tour.ordering`). Fruits that
cannot be reached among all the others are tried again after those have been picked, and come last. The arm is at rest
while the tool grips or releases; the times count the motions only, not gripping and releasing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field

from hplan.base import ties
from hplan.base.arguments import instance
from hplan.base.arrays import FloatArray, Record
from hplan.base.checked import Options, Positive
from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.base.lazy_import import InNotebook
from hplan.certificate.certificate import Certificate, all_of
from hplan.certificate.digests import Digests
from hplan.errors import (
    CertificationError,
    DetourError,
    HplanError,
    OptionError,
    SceneError,
    TourError,
    UnreachableError,
)
from hplan.planning.failures import NO_MOTION, Reason, obstacle_of, reason_of
from hplan.planning.grasps import Grasp
from hplan.planning.motion import Motion, certificate_of, in_sequence, require_certificate, seconds
from hplan.planning.options import PlanOptions
from hplan.planning.plan import check_task
from hplan.planning.problem import Problem
from hplan.planning.reachable import fruit_names
from hplan.planning.report import assumptions_report, far_report, motion_report
from hplan.planning.stages import Progress, no_progress
from hplan.robot.model import Robot
from hplan.scene.attached import Attached
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene
from hplan.tour.motions import LegMotions, Motions, carried_fruit, drop_off
from hplan.tour.moves import Stop
from hplan.tour.ordering import Costs, Visits, best, nearest_tour, order_grasps
from hplan.trajectory.retime import rest_at
from hplan.trajectory.trajectory import Phase, Trajectory, join_trajectories


@dataclass(frozen=True, eq=False)
class Leg(Record):
    """Leg of a tour, to a fruit or back to the start.

    A leg to a fruit may continue to the drop-off. It is at rest at both ends, unless the retreat from a fruit is
    blended with the next leg.

    Attributes:
        fruit: Name of the fruit; None for the leg back.
        grasp: Grasp of the fruit; None for the leg back.
        begin_s: Start time in the tour [s].
        phases: Its phases, at their times in the tour: `transit`, `approach`, `retreat`, `drop`, `return`.
        trajectory: Its motion, starting at time 0.
        certificate: Certificate of the motion.
    """

    fruit: str | None
    grasp: Grasp | None
    begin_s: float
    phases: tuple[Phase, ...]
    trajectory: Trajectory
    certificate: Certificate

    @property
    def name(self) -> str:
        """Name of the fruit, or `return`."""
        return "return" if self.fruit is None else self.fruit


@dataclass(frozen=True, eq=False)
class Unreached:
    """Fruit that is not picked, with the error."""

    fruit: str
    error: HplanError

    @property
    def reason(self) -> Reason | None:
        """Why it is not picked, as in `FruitReach.reason`; None for a fruit that is left out (`DetourError`)."""
        return None if isinstance(self.error, DetourError) else reason_of(self.error)

    @property
    def obstacle(self) -> str | None:
        """The obstacle that most often prevents its motions; None if unknown."""
        return obstacle_of(self.error)

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of `tour.json`."""
        return {"fruit": self.fruit, "reason": self.reason, "obstacle": self.obstacle, "error": self.error.as_dict()}


@dataclass(frozen=True, eq=False)
class TourResult(Record, InNotebook):
    """Picking tour of one arm.

    Attributes:
        order: Names of the picked fruits, in order.
        legs: One leg for each of them, and the leg back if there is one.
        trajectory: The whole motion; the arm rests at the fruits, and wherever a stop is faster.
        certificate: Certificate of the whole motion.
        picked: Picking time of each fruit [s].
        dropped: Release time of each fruit at the drop-off [s]; empty without a drop-off.
        unreached: Fruits that are not picked.
        report: Contents of `tour.json`.
        robot: The arm.
        scene: The given obstacles and fruits.
    """

    order: tuple[str, ...]
    legs: tuple[Leg, ...]
    trajectory: Trajectory
    certificate: Certificate
    picked: Mapping[str, float]
    dropped: Mapping[str, float]
    unreached: tuple[Unreached, ...]
    report: dict[str, Any]
    robot: Robot
    scene: Scene

    @property
    def phases(self) -> tuple[Phase, ...]:
        """Phases of all legs."""
        return tuple(phase for leg in self.legs for phase in leg.phases)

    @property
    def duration(self) -> float:
        """Duration of the whole tour [s]."""
        return self.trajectory.duration


Order = Literal["best", "nearest", "given"]
_ORDERS: tuple[Order, ...] = get_args(Order)


@dataclass(frozen=True)
class TourOptions(Options):
    """Options of a tour.

    Attributes:
        drop_off: Place where fruit is released, by joints or by a tool position; None if the arm takes the fruit in
            itself (into a tube or a bin of its own) and carries nothing.
        every: Maximum number of fruits carried to the drop-off at a time; None for one.
        back: True if the arm returns to the start at the end.
        order: `best`; `nearest`: the next fruit is always the quickest to reach; `given`: in the order of the list.
        stops: True if the arm stops between legs, so that each leg can be run by itself.
        compare: True if the report gives the durations of all three orders.
        grasps: Number of grasps considered for each fruit at a time; with more than one, unused grasps are replaced by
            others as long as the tour becomes shorter.
        max_detour_s: Fruits that lengthen the tour by more are left out [s]: one far from all others, or one that wood
            is slowly pushed aside for. Of fruits in a row, and of all, the mean counts as well. Motions are compared
            with stops at stand-offs. None to pick all.
    """

    drop_off: Goal | None = None
    every: Annotated[int, Field(ge=1)] | None = None
    back: bool = False
    order: Order = "best"
    stops: bool = False
    compare: bool = False
    grasps: Annotated[int, Field(ge=1)] = 4
    max_detour_s: Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.drop_off is not None and self.drop_off.fruit is not None:
            raise OptionError("drop_off", self.drop_off.fruit, "joints or a position, not a fruit")
        if self.every is not None and self.drop_off is None:
            raise OptionError("every", self.every, "None without a drop-off")


def plan_tour(
    robot: Robot,
    scene: Scene,
    options: PlanOptions | None = None,
    *,
    fruits: Sequence[str] | None = None,
    tour: TourOptions | None = None,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> TourResult:
    """Plan a picking tour from the scene's start.

    Args:
        robot: The arm.
        scene: Obstacles and fruits; fruits are obstacles until they are picked. Of the goal only `approach_deg` is
            used, for all fruits.
        options: How to plan.
        fruits: Names of the fruits to pick; None for all.
        tour: Options of the tour.
        progress: Called with the name of each step.
        cancel: As for `hplan.plan`.

    Raises:
        InputError: The scene does not fit the robot, or the start is invalid or in collision.
        OptionError: `fruits` names an unknown fruit, names one twice, or is empty.
        TourError: No fruit can be picked; the message says why.
        UnreachableError: No configuration puts the tool at the drop-off.
        BlockedError: Obstacles block every configuration at the drop-off; names them.
        NoPathError: No path from the start to the drop-off exists on the grid; names the blocking obstacles.
        CertificationError: No motion to the drop-off could be certified.
        NotInTimeError: The deadline passed before the tour was complete; partial tours are not returned.
        PlanCancelledError: Planning was cancelled.
    """
    check_task(robot, scene, options, progress)
    if tour is not None:
        instance("tour", tour, TourOptions)
    names = fruit_names(scene, fruits)
    options = options or PlanOptions()
    with time_limit(options.deadline_s, cancel) as limit:
        try:
            # The deadline applies to the whole tour; single motions are planned without one.
            whole = replace(options, deadline_s=None)
            return TourPlanner(robot, scene, whole, tour or TourOptions(), names, progress).run(names)
        except TimeIsUpError:
            raise limit.error([f"a tour over {len(names)} fruits"]) from None


@dataclass(frozen=True, eq=False)
class _Stage:
    """A tour among one set of obstacles: motions, order, unreached fruits."""

    motions: Motions
    visits: Visits
    totals: dict[str, float]
    unreached: list[Unreached]


class TourPlanner:
    """Plans tours for one arm; tours share cached motions.

    Motions found with all fruits present are reused for tours over subsets of the fruits.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        options: PlanOptions,
        tour: TourOptions,
        names: Sequence[str],
        progress: Progress = no_progress,
    ) -> None:
        """Set up; arguments and errors as in `plan_tour`.

        `names` are the fruits that may be picked.
        """
        self._begin = time.perf_counter()
        self.robot, self.scene, self.options, self.tour, self.progress = robot, scene, options, tour, progress
        self._carried: Attached | None = None
        self._drop: Motion | None = None
        if scene.start.is_moving:
            raise SceneError("tours begin at rest, but the start has a velocity or an acceleration", where="start")
        if scene.start.contact_depth is not None:
            raise SceneError(
                "plan a motion away from the obstacles first: tours begin clear", where="start.contact_depth"
            )
        scene = scene.without_goal_fruit
        self.problem = Problem.from_scene(robot, scene, options)
        self.start = self.problem.start
        self.problem.world.check_base()
        self.problem.from_configurations(self.start, self.start)
        if tour.drop_off is not None:
            progress("drop-off")
            thickest = max(fruit.radius for fruit in scene.fruits if fruit.name in names)
            self._carried = carried_fruit(thickest)
            loaded = Problem.from_scene(robot, self._loaded(scene, self._carried), options)
            self._drop = drop_off(tour.drop_off, self.problem, loaded, self.start)
        self._whole = self._motions(scene, Stop(self.start))

    @staticmethod
    def _loaded(scene: Scene, carried: Attached) -> Scene:
        """Return the scene in which the arm holds a fruit, too."""
        return scene.copy_unchecked({"attached": (*scene.attached, carried)})

    def _motions(self, scene: Scene, here: Stop) -> Motions:
        """Return the motions among a scene's solids, from the arm's stop."""
        loaded = None if self._carried is None else self._loaded(scene, self._carried)
        return Motions(
            Problem.from_scene(self.robot, scene.without_goal_fruit, self.options),
            None if loaded is None else Problem.from_scene(self.robot, loaded.without_goal_fruit, self.options),
            here=here, home=Stop(self.start), drop=self._drop, every=self.tour.every or 1, back=self.tour.back,
        )  # fmt: skip

    def run(self, names: Sequence[str]) -> TourResult:
        """Plan the tour over the named fruits.

        Limbs that bend count as rigid first: motions that touch nothing need not be slowed down for impacts. Fruits
        that are blocked are tried again among limbs that bend, and without the fruits picked before.
        """
        motions, scene, stages = self._whole, self.scene, list[_Stage]()
        left, unreached, is_firm = names, list[Unreached](), scene.wood is not None
        if scene.wood is not None:
            motions = self._motions(scene.copy_unchecked({"wood": scene.wood.as_rigid}), Stop(self.start))
        while left:
            fruits = {fruit.name: fruit for fruit in scene.fruits}
            stage = self._stage(motions, [fruits[name] for name in left])
            unreached = [item for item in unreached if item.fruit not in left] + stage.unreached
            is_found = math.isfinite(stage.visits.cost) and len(motions.fruits) > 0
            if not (is_found or is_firm):
                break
            is_final = UnreachableError, DetourError
            left = [item.fruit for item in stage.unreached if not isinstance(item.error, is_final)]
            if is_found:
                stages.append(stage)
                gone = set(motions.fruits)
                scene = scene.copy_unchecked({"fruits": tuple(f for f in scene.fruits if f.name not in gone)})
            if left:
                motions = self._motions(scene, motions.end(stage.visits)) if is_found else self._whole
            is_firm = False
        while stages:
            try:
                return self._result(stages, unreached)
            except CertificationError as error:
                # What earlier legs push may displace the fruit of later ones, which are left then.
                unreached += [Unreached(name, error.with_traceback(None)) for name in stages.pop().motions.fruits]
        raise TourError([(item.fruit, item.error) for item in unreached])

    def costs(self, names: Collection[str]) -> tuple[dict[str, FloatArray], Costs]:
        """Return `Motions.costs` for the named fruits that are reachable among all others."""
        for fruit in self.scene.fruits:
            if fruit.name in names:
                with suppress(UnreachableError, *NO_MOTION):
                    self._whole.add(fruit, self.tour.grasps)
        self._whole.choose(names)
        return self._whole.costs()

    def reverse(self, tour: TourResult) -> TourResult | None:
        """Return the reversed tour; None if its motions are not all known, or not certified in this order."""
        visits = self._whole.tour_through([leg.grasp for leg in reversed(tour.legs) if leg.grasp is not None])
        if visits is not None:
            with suppress(CertificationError):
                return self._result([_Stage(self._whole, visits, {}, [])], tour.unreached)
        return None

    def _leave_out(self, motions: Motions, given: list[str]) -> list[Unreached]:
        """Leave out the fruits that lengthen the tour by more than allowed, those with the longest detour first.

        Args:
            motions: The chosen fruits and their motions; those left out are no longer chosen.
            given: Names of the chosen fruits in the given order; those left out are removed.
        """
        left, allowed = list[Unreached](), self.tour.max_detour_s
        if not given or allowed is None:
            return left
        visits, worth = _visits(motions, self.tour.order, given), set[tuple[str, ...]]()
        while given and math.isfinite(visits.cost):
            saved = motions.savings(visits, keep_order=self.tour.order == "given")
            detours = {names: seconds / len(names) for names, seconds in saved.items()}
            too_long = [names for names, detour in detours.items() if detour > allowed and names not in worth]
            if not too_long:
                break
            names = too_long[ties.argmax([detours[names] for names in too_long])]
            rest = [name for name in given if name not in names]
            motions.choose(rest)
            shorter = _visits(motions, self.tour.order, rest) if rest else motions.without_fruits()
            adds_s = (visits.cost - shorter.cost) / len(names)
            if adds_s > allowed:
                left += [Unreached(name, DetourError(adds_s, allowed)) for name in given if name in names]
                given[:], visits, worth = rest, shorter, set()
            else:  # it was an estimate
                motions.choose(given)
                worth.add(names)
        return left

    def _stage(self, motions: Motions, fruits: Sequence[Fruit]) -> _Stage:
        """Plan the tour over the given fruits that are reachable."""
        unreached, given = list[Unreached](), list[str]()
        for number, fruit in enumerate(fruits):
            self.progress(f"fruit {number + 1} of {len(fruits)}")
            try:
                motions.add(fruit, self.tour.grasps)
            except (UnreachableError, *NO_MOTION) as error:
                unreached.append(Unreached(fruit.name, error.with_traceback(None)))
            else:
                given.append(fruit.name)
        motions.choose(given)
        self.progress("order")
        unreached += self._leave_out(motions, given)
        found: dict[str, Visits] = {}
        if motions.fruits:
            orders = sorted(_ORDERS, key=lambda order: order != self.tour.order)
            found = {order: _visits(motions, order, given) for order in (orders if self.tour.compare else orders[:1])}
        totals = {order: self._duration(motions, visits) for order, visits in found.items()}
        if self.tour.order == "best" and found:
            # Compared with stops at each leg; another order may be quicker with blended legs.
            quickest = list(totals)[ties.argmin(list(totals.values()))]
            found["best"], totals["best"] = found[quickest], totals[quickest]
        visits = found.get(self.tour.order, Visits(math.inf, np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)))
        if motions.fruits and not math.isfinite(visits.cost):
            cut_off = CertificationError("no certified motion connects its grasps to other fruits or to the start")
            unreached += [Unreached(name, cut_off) for name in motions.fruits]
        return _Stage(motions, visits, {order: totals[order] for order in _ORDERS if order in totals}, unreached)

    def _result(self, stages: Sequence[_Stage], unreached: Sequence[Unreached]) -> TourResult:
        """Assemble the tour and its report.

        Raises:
            CertificationError: The options require a certificate, and that of the whole tour is not verified.
        """
        drafts = list[LegMotions]()
        for stage in stages:
            drafts += self._legs(stage.motions, stage.visits, back=self.tour.back and stage is stages[-1])
        here, begin, legs = self.start, 0.0, list[Leg]()
        for fruit, grasp, parts in drafts:
            if not parts:  # the arm stays at rest
                rest = rest_at(self.robot.model, here)
                certificate = require_certificate(self.problem, certificate_of(self.problem, rest))
                parts = [Motion("return", rest, certificate, self.problem)]
            legs.append(Leg(fruit, grasp, begin, *in_sequence(parts, begin)))
            begin = legs[-1].phases[-1].end_s
            here = legs[-1].trajectory.position[-1]
        picked, dropped = _times(legs)
        trajectory = join_trajectories([leg.trajectory for leg in legs])
        digests = Digests(self.robot, self.scene, trajectory)
        whole = replace(all_of([leg.certificate for leg in legs]), digests=digests)
        certificate = require_certificate(self.problem, whole)
        return TourResult(
            order=tuple(picked),
            legs=tuple(legs),
            trajectory=trajectory,
            certificate=certificate,
            picked=MappingProxyType(picked),
            dropped=MappingProxyType(dropped),
            unreached=tuple(unreached),
            report=self._report(stages, legs, picked, unreached)
            | far_report(self.robot, self.scene)
            | motion_report(trajectory, certificate, self.options, self.scene),
            robot=self.robot,
            scene=self.scene,
        )

    def _legs(self, motions: Motions, visits: Visits, *, back: bool) -> list[LegMotions]:
        """Return the legs of a tour among one set of obstacles."""
        return motions.legs(visits, back=back, stops=self.tour.stops)

    def _duration(self, motions: Motions, visits: Visits) -> float:
        """Duration of a tour as executed; infinite for an infeasible tour [s]."""
        if not math.isfinite(visits.cost):
            return math.inf
        legs = self._legs(motions, visits, back=self.tour.back)
        return sum(seconds(motions) for _, _, motions in legs)

    def _report(
        self, stages: Sequence[_Stage], legs: Sequence[Leg], picked: Mapping[str, float], unreached: Sequence[Unreached]
    ) -> dict[str, Any]:
        """Return the tour-specific part of the report, in the format of `tour.json`."""
        caught = [leg.grasp.caught for leg in legs if leg.grasp is not None and leg.grasp.caught is not None]
        return {
            "status": "ok",
            "scene": self.scene.name,
            "robot": self.robot.name,
            **assumptions_report(self.robot),
            "tour": {
                "order": self.tour.order,
                "every": None if self.tour.drop_off is None else self.tour.every or 1,
                "back": self.tour.back,
            },
            "order": list(picked),
            "legs": [
                {
                    "fruit": leg.fruit,
                    "begin_s": leg.begin_s,
                    "picked_s": None if leg.fruit is None else picked[leg.fruit],
                    "duration_s": leg.trajectory.duration,
                    "phases": [vars(phase) for phase in leg.phases],
                    "joints_rad": None if leg.grasp is None else leg.grasp.goal.tolist(),
                    **({"caught": leg.grasp.caught} if leg.grasp and leg.grasp.caught is not None else {}),
                    "verified": leg.certificate.verified,
                    "min_clearance_m": leg.certificate.min_clearance_m,
                }
                for leg in legs
            ],
            "unreached": [item.as_dict() for item in unreached],
            **({"expected_fruit": sum(caught)} if caught else {}),
            # For the fruits reachable among all the others; durations of the planned motions.
            "totals_s": {"fruits": len(stages[0].motions.fruits), **stages[0].totals},
            "planner": {
                "time_ms": round(1e3 * (time.perf_counter() - self._begin), 4),
                "motions_planned": sum(stage.motions.planned_count for stage in stages),
                "stages": len(stages),
            },
        }


def _visits(motions: Motions, order: Order, given: Sequence[str]) -> Visits:
    """Return the tour in a kind of order, with optimized grasps."""
    if order == "best":
        return motions.settle(best)
    fixed = np.array([motions.fruits.index(name) for name in given])
    if order == "nearest":
        fixed = motions.fruits_at(motions.settle(lambda costs, *_: nearest_tour(costs)).places)
    return motions.settle(lambda costs, *_: order_grasps(costs, fixed))


def _times(legs: Sequence[Leg]) -> tuple[dict[str, float], dict[str, float]]:
    """Pick times of the fruits, and their drop-off times [s]."""
    picked: dict[str, float] = {}
    dropped: dict[str, float] = {}
    for leg in legs:
        ends = {phase.name: phase.end_s for phase in leg.phases}
        if leg.fruit is not None:
            picked[leg.fruit] = ends.get("approach", ends.get("transit", leg.begin_s))
        if "drop" in ends:
            dropped |= {name: ends["drop"] for name in picked if name not in dropped}
    return picked, dropped
