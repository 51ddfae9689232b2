"""Plans base stops along a tree row, and their picking tours.

The row runs along y of the scene. The scene shows it as seen from the base at y = 0 on the first side: the row's line
is `distance` ahead. Candidate stops lie on a grid along it, on one side or both and at each height. The pickable fruits
of each are computed, an integer program selects the best stops (`RowOptions.objective`), and a tour is planned at each,
in driving order. Fruits that a tour leaves are tried again at later stops, and in further passes along the row.
"""

from __future__ import annotations

import itertools
import math
import re
import time
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
from pydantic import Field
from scipy.optimize import LinearConstraint, milp
from scipy.sparse import coo_array

from hplan.base.arguments import instance
from hplan.base.arrays import Record
from hplan.base.checked import Options
from hplan.base.tasks import Pool, outcomes, pool_of
from hplan.collision.motion_coefficients import workspace_ball
from hplan.errors import HplanError, InputError, MovingObstacleError, OptionError, TourError
from hplan.planning.failures import REASON_WORDS, REASONS, Reason, tally_reasons
from hplan.planning.options import PlanOptions
from hplan.planning.plan import check_task
from hplan.planning.reachable import FruitReach, reachable
from hplan.planning.stages import Progress, no_progress
from hplan.planning.world import without_inside
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene
from hplan.scene.obstacles import Capsule
from hplan.tour.tour import TourOptions, TourResult, Unreached, plan_tour


def within_reach(robot: Robot, scene: Scene) -> Scene:
    """Crop a scene to the robot's workspace.

    Fruits and compliant obstacles inside the base are removed. The returned scene has no fruit as its goal.

    Raises:
        InputError: A rigid obstacle is inside the base.
    """
    scene = scene.copy_unchecked({"goal": Goal(position=(0.0, 0.0, 0.0), approach_deg=scene.goal.approach_deg)})
    ball = workspace_ball(robot)
    cropped = scene.crop(float(ball[3]) + scene.clearance, ball[:3])
    near, inside = without_inside(robot, cropped)
    rigid = next((one.name for one in cropped.obstacles if one.name in inside and not one.yields), None)
    if rigid is not None:
        raise InputError(f"obstacle {rigid!r} is inside the robot's pedestal or turret", obstacle=rigid)
    return near


def reach_in_turn(robot: Robot, scene: Scene, options: PlanOptions | None = None) -> dict[str, FruitReach]:
    """Whether each fruit can be picked; pickable ones first, in a feasible order.

    Fruits blocked by others are checked again once those are picked.

    Args:
        robot: The arm.
        scene: Scene cropped to the workspace (`within_reach`).
        options: Planning options; None for the defaults.

    Raises:
        HplanError: An error of `hplan.reachable`.
    """
    found: dict[str, FruitReach] = {}
    while scene.fruits:
        now = reachable(robot, scene, options)
        picked = {name: one for name, one in now.items() if one.can_be_picked}
        if not picked:
            return found | dict(now)
        found |= picked
        scene = scene.copy_unchecked({"fruits": tuple(fruit for fruit in scene.fruits if fruit.name not in picked)})
    return found


@dataclass(frozen=True)
class Unpicked:
    """A fruit that is not picked.

    Attributes:
        reason: Why not, as in `FruitReach.reason`; from several stops, that of the nearest attempt, in the order
            `out_of_reach`, `blocked`, `no_approach`, `no_motion`. None for a fruit that was left out although it can be
            picked: by `RowOptions.share` or `TourOptions.max_detour_s`.
        obstacle: The obstacle that prevents it at most of those stops; None if unknown.
    """

    reason: Reason | None
    obstacle: str | None = None

    @classmethod
    def of_attempts(cls, attempts: Sequence[Unpicked]) -> Unpicked:
        """Summarize attempts from several stops; without any, the fruit is out of reach."""
        if any(one.reason is None for one in attempts):
            return cls(None)
        rank = {reason: number for number, reason in enumerate(REASONS)}
        reasons = (one.reason for one in attempts if one.reason is not None)
        reason = max(reasons, key=rank.__getitem__, default=REASONS[0])
        named = Counter(one.obstacle for one in attempts if one.reason == reason and one.obstacle is not None)
        return cls(reason, next((name for name, _ in named.most_common(1)), None))


def cover(
    costs: Sequence[Mapping[str, float]], each: float, least: int | None = None
) -> tuple[dict[int, list[str]], bool]:
    """Minimum-cost selection of sets that covers the elements.

    One integer program: set i is selected (y_i), element f is covered by set i (x_fi <= y_i), every element once.

    Args:
        costs: For each set, the cost of covering each of its elements.
        each: Cost of a set; infinite to minimize their number first, and the costs of their elements second.
        least: Minimum number of elements to cover, at most all; None for all.

    Returns:
        Indices of the selected sets and the elements that each covers, in the order of the set; and whether this is
        proved optimal.

    Examples:
        >>> cover([{"a": 1.0, "b": 1.0}, {"b": 0.5}], math.inf)
        ({0: ['a', 'b']}, True)
    """
    pairs = [(i, name, cost) for i, held in enumerate(costs) for name, cost in held.items()]
    names = list(dict.fromkeys(name for _, name, _ in pairs))
    if not names or (least is not None and least <= 0):
        return {}, True
    sets, count = len(costs), len(pairs)
    number = {name: n for n, name in enumerate(names)}
    element = np.array([number[name] for _, name, _ in pairs])
    owner = np.array([i for i, _, _ in pairs])
    weights = np.array([cost for _, _, cost in pairs])
    if math.isinf(each):  # scaled so that the sum of all weights is worth less than one set
        each, weights = 1.0, weights * (0.5 / max(1e-9, len(names) * weights.max()))
    column, one = sets + np.arange(count), np.ones(count)
    taken = coo_array((one, (element, column)), (len(names), sets + count))
    rows = np.tile(np.arange(count), 2)
    within = coo_array((np.r_[one, -one], (rows, np.r_[column, owner])), (count, sets + count))
    enough = coo_array((one, (np.zeros(count, dtype=int), column)), (1, sets + count))
    least = len(names) if least is None else min(least, len(names))
    found = milp(
        np.r_[np.full(sets, each), weights],
        integrality=np.r_[np.ones(sets), np.zeros(count)],
        bounds=(0.0, 1.0),
        constraints=[
            LinearConstraint(taken.tocsr(), 0.0 if least < len(names) else 1.0, 1.0),
            LinearConstraint(within.tocsr(), -np.inf, 0.0),
            LinearConstraint(enough.tocsr(), float(least), np.inf),
        ],
        # Time limit of the solver [s].
        options={"time_limit": 60.0},
    )
    if found.x is None:  # the solver found no cover in time: assign each element to its cheapest set
        best: dict[str, tuple[float, int]] = {}
        for i, name, cost in pairs:
            best[name] = min(best.get(name, (math.inf, 0)), (cost, i))
        return _by_set({name: i for name, (_, i) in best.items()}, costs), False
    most: dict[str, tuple[float, int]] = {}
    for (i, name, _), part in zip(pairs, found.x[sets:].tolist(), strict=True):
        if part > max(1e-6, most.get(name, (0.0, 0))[0]):
            most[name] = part, i
    return _by_set({name: i for name, (_, i) in most.items()}, costs), found.status == 0


def _by_set(owner: Mapping[str, int], costs: Sequence[Mapping[str, float]]) -> dict[int, list[str]]:
    chosen = {i: [name for name in held if owner.get(name) == i] for i, held in enumerate(costs)}
    return {i: names for i, names in chosen.items() if names}


#: Maximum number of candidate stops, of passes along the row, and of stops in one task of a worker.
_MOST_CANDIDATES: Final = 20_000
_PASSES: Final = 3
_LOT: Final = 6

#: Prefix of the parts of a tree in a scene with several trees.
_TREE: Final = re.compile(r"tree \d+(?= )")

RowObjective = Literal["stops", "time"]

#: Speed or acceleration of the vehicle, and a time during which the arm waits [s].
_Rate: TypeAlias = Annotated[float, Field(ge=0.001, le=100.0)]
_Pause: TypeAlias = Annotated[float, Field(ge=0.0, le=3600.0)]


@dataclass(frozen=True)
class RowOptions(Options):
    """Permitted base stops, and the vehicle's motion between them.

    Attributes:
        distance: Distance of the base's axis from the row's line, which is at x = distance in the scene [m].
        both: True to stop on both sides of the row; the other side is the scene rotated by half a turn.
        step: Spacing of the candidate stops [m].
        heights: Heights of a lift or mast, relative to the scene's [m].
        objective: `stops`: minimum number of stops; `time`: minimum time, by lower bounds on the motions to each fruit.
        share: Required fraction of the fruits that are reachable from any stop.
        speed: Maximum speed of the vehicle [m/s].
        acceleration: Maximum acceleration of the vehicle [m/s^2].
        lift_speed: Speed of the lift, which moves together with the vehicle [m/s].
        settling: Time from the vehicle's stop to the arm's start [s].
        detaching: Time for the tool to detach a fruit [s].
        carried: Names of obstacles that are mounted on the vehicle.

    Examples:
        >>> RowOptions(speed=0.5, acceleration=0.5).drive_s(2.0)
        5.0
    """

    distance: Annotated[float, Field(ge=0.1, le=100.0)] = 1.4
    both: bool = True
    step: Annotated[float, Field(ge=0.01, le=100.0)] = 0.1
    heights: Annotated[tuple[Annotated[float, Field(ge=-10.0, le=10.0)], ...], Field(min_length=1)] = (0.0,)
    objective: RowObjective = "stops"
    share: Annotated[float, Field(ge=0.01, le=1.0)] = 1.0
    speed: _Rate = 0.5
    acceleration: _Rate = 0.5
    lift_speed: _Rate = 0.1
    settling: _Pause = 0.5
    detaching: _Pause = 1.0
    carried: tuple[str, ...] = ()

    def drive_s(self, way: float, lift: float = 0.0) -> float:
        """Driving time from rest to rest, the lift included [s].

        Args:
            way: Distance along the row [m].
            lift: Change of height [m].
        """
        way, top = abs(way), self.speed**2 / self.acceleration
        slow = 2.0 * math.sqrt(way / self.acceleration)
        return max(
            way / self.speed + self.speed / self.acceleration if way > top else slow, abs(lift) / self.lift_speed
        )

    @property
    def cost_of_stop(self) -> float:
        """Cost of a stop without its motions [s].

        Infinite if the objective is the number of stops.
        """
        return math.inf if self.objective == "stops" else self.settling + self.speed / self.acceleration


class BaseStop(NamedTuple):
    """Base stop.

    Attributes:
        side: Side 1 or 2 of the row.
        along: Position along the row [m].
        height: Height relative to the scene's [m].
    """

    side: int
    along: float
    height: float

    def see_scene(self, scene: Scene, options: RowOptions) -> Scene:
        """The scene as seen from the base there."""
        stands = scene.copy_unchecked(
            {"obstacles": tuple(one for one in scene.obstacles if one.name not in options.carried)}
        )
        if self.side == 1:
            moved = stands.shift((0.0, -self.along, -self.height))
        else:
            moved = stands.shift((2.0 * options.distance, self.along, -self.height), 180.0)
        carried = tuple(one for one in scene.obstacles if one.name in options.carried)
        return moved.copy_unchecked({"obstacles": (*moved.obstacles, *carried)})


@dataclass(frozen=True, eq=False)
class RowStop(Record):
    """Stop of the base, with its picking tour.

    Attributes:
        place: Position of the base.
        way: Number of the pass along the row, from 1 on: odd passes go towards larger y, even ones back.
        arrival_s: Driving time from the previous stop, or from the row's end, plus settling [s].
        tour: The tour; its scene is cropped to the workspace, without previously picked fruits.
    """

    place: BaseStop
    way: int
    arrival_s: float
    tour: TourResult


@dataclass(frozen=True, eq=False)
class RowResult(Record):
    """Result of picking a tree row.

    Attributes:
        stops: Stops in driving order.
        candidates: Pickable fruits of each candidate stop on its own. Stops with a rigid obstacle in the base, or in
            collision with the waiting arm, are left out.
        picked: Names of the picked fruits, in order.
        reachable: Names of the fruits that can be picked from any candidate, in the order of the scene.
        unpicked: Reason for each fruit that is not picked, by name, in the order of the scene.
        report: Contents of `row.json`.
        robot: The arm.
        scene: The given scene.
        options: The given row options.
    """

    stops: tuple[RowStop, ...]
    candidates: Mapping[BaseStop, tuple[str, ...]]
    picked: tuple[str, ...]
    reachable: tuple[str, ...]
    unpicked: Mapping[str, Unpicked]
    report: dict[str, Any]
    robot: Robot
    scene: Scene
    options: RowOptions


def plan_row(
    robot: Robot,
    scene: Scene,
    options: PlanOptions | None = None,
    *,
    row: RowOptions | None = None,
    tour: TourOptions | None = None,
    executor: Pool | None = None,
    workers: int = 1,
    progress: Progress = no_progress,
) -> RowResult:
    """Choose stops along a tree row and plan their picking tours.

    Each tour starts at the scene's start and returns to it.

    Args:
        robot: The arm.
        scene: The row, along y, as seen from the first side; of its goal only `approach_deg` is used.
        options: Planning options; rows do not support a deadline. None for the defaults.
        row: Permitted base stops; None for the defaults.
        tour: Options of the tours; None for the defaults.
        executor: Pool that evaluates the candidates, as for `hplan.run_study`; tours are planned in this process.
        workers: Number of parallel workers.
        progress: Called with the name of each step.

    Raises:
        InputError: The scene does not fit the robot.
        MovingObstacleError: The scene has moving obstacles.
        OptionError: There are too many candidates, a deadline is given, a carried obstacle does not exist, or the scene
            has no fruit.
        TourError: No fruit is picked from any stop.
        WorkersLostError: A worker of the pool was lost, as in `hplan.run_study`.
    """
    check_task(robot, scene, options, progress)
    options = options or PlanOptions()
    row = RowOptions() if row is None else instance("row", row, RowOptions)
    tour = replace(TourOptions() if tour is None else instance("tour", tour, TourOptions), back=True)
    pool = pool_of(executor, workers)
    _check(scene, options, row)
    begin = time.process_time()
    places = _candidates(robot, scene, row)
    seen = _look_from_stops(robot, scene, options, row, places, pool, progress)
    costs = {p: {f: c for f, c in held.items() if not isinstance(c, Unpicked)} for p, held in seen.items()}
    looked_s = time.process_time() - begin
    names = {name for held in costs.values() for name in held}
    reachable = tuple(fruit.name for fruit in scene.fruits if fruit.name in names)
    first: dict[str, Any] = {}
    stops = list[RowStop]()
    gone: dict[str, None] = {}  # in picking order
    failed: dict[BaseStop, set[str]] = {place: set() for place in costs}
    attempts = {fruit.name: list[Unpicked]() for fruit in scene.fruits}
    for held in seen.values():
        for name, one in held.items():
            attempts[name] += [one] if isinstance(one, Unpicked) else []
    for way in range(1, _PASSES + 1):
        left = {p: {f: c for f, c in held.items() if f not in gone and f not in failed[p]} for p, held in costs.items()}
        progress(f"pass {way}: choosing stops")
        least = math.ceil(row.share * len(reachable) - 1e-9) - len(gone)
        chosen, is_best = cover(list(left.values()), row.cost_of_stop, least)
        first = first or {"cover_stops": len(chosen), "cover_is_best": is_best}
        assigned = {list(left)[number]: names for number, names in chosen.items()}
        due = list[str]()  # fruits that earlier stops failed to pick
        for place in sorted(assigned, key=lambda place: (place.side, place.along * (-1) ** (way + 1), place.height)):
            wanted = [*assigned[place], *(name for name in due if name in left[place])]
            progress(f"pass {way}, stop {len(stops) + 1}: a tour over {len(wanted)} fruits")
            found = _tour_at(place, (robot, scene, options, row, tour), gone, wanted)
            picked = () if isinstance(found, TourError) else found.order
            if not isinstance(found, TourError):
                stops.append(RowStop(place, way, 0.0, found))
            for each in _unreached(found):
                attempts[each.fruit].append(Unpicked(each.reason, each.obstacle))
            gone |= dict.fromkeys(picked)
            failed[place] |= set(wanted) - set(picked)
            due = [name for name in dict.fromkeys([*due, *wanted]) if name not in gone]
    if not stops:
        raise TourError([(name, _why_never(tried, len(places))) for name, tried in attempts.items()])
    driven, driving_s = _add_driving(scene, row, stops)
    spent = {"candidates_cpu_s": looked_s, "tours_cpu_s": time.process_time() - begin - looked_s}
    unpicked = {
        fruit.name: Unpicked.of_attempts(attempts[fruit.name])
        if fruit.name not in names or any(fruit.name in tried for tried in failed.values())
        else Unpicked(None)
        for fruit in scene.fruits
        if fruit.name not in gone
    }
    report = _report(robot, scene, row, driven, driving_s, tuple(gone), reachable)
    reasons, obstacles = tally_reasons((one.reason, one.obstacle) for one in unpicked.values() if one.reason)
    report |= {
        "not_picked": reasons | {"left_out": len(unpicked) - sum(reasons.values())},
        "obstacles": obstacles,
        "unpicked": {name: asdict(one) for name, one in unpicked.items()},
    }
    report["planner"] = {"candidates": len(places), "usable": len(costs), **first, **spent}
    candidates = {place: tuple(held) for place, held in costs.items()}
    return RowResult(tuple(driven), candidates, tuple(gone), reachable, unpicked, report, robot, scene, row)


def _check(scene: Scene, options: PlanOptions, row: RowOptions) -> None:
    """Check the scene and the options for tree rows."""
    if options.deadline_s is not None:
        raise OptionError("deadline_s", options.deadline_s, "None: rows have no deadline")
    if scene.moves:
        raise MovingObstacleError(scene.first_moving)
    if not scene.fruits:
        raise OptionError("scene", scene.name, "a scene with fruit")
    for name in row.carried:
        if name not in {one.name for one in scene.obstacles}:
            raise OptionError("carried", name, "the name of an obstacle")


def _candidates(robot: Robot, scene: Scene, row: RowOptions) -> list[BaseStop]:
    """Grid stops along the row within the arm's reach of a fruit."""
    y, reach = [fruit.center[1] for fruit in scene.fruits], float(workspace_ball(robot)[3])
    first, last = math.ceil((min(y) - reach) / row.step), math.floor((max(y) + reach) / row.step)
    sides = (1, 2) if row.both else (1,)
    if len(sides) * len(row.heights) * (last - first + 1) > _MOST_CANDIDATES:
        raise OptionError("step", row.step, f"a step that leaves at most {_MOST_CANDIDATES:,} candidate stops")
    grid = [number * row.step for number in range(first, last + 1)]
    return list(itertools.starmap(BaseStop, itertools.product(sides, grid, row.heights)))


def _look_from_stops(
    robot: Robot,
    scene: Scene,
    options: PlanOptions,
    row: RowOptions,
    places: Sequence[BaseStop],
    pool: tuple[Pool, int],
    progress: Progress,
) -> dict[BaseStop, dict[str, float | Unpicked]]:
    """Fruits near each valid stop: lower bounds [s], or why they cannot be picked.

    The bounds are on the durations of the motions to the fruits.
    """
    lots = [places[i : i + _LOT] for i in range(0, len(places), _LOT)]
    found: dict[BaseStop, dict[str, float | Unpicked] | None] = {}
    for _, lot in outcomes(partial(_seen_from_stop, robot, scene, options, row), lots, *pool):
        found |= lot
        progress(f"stops: {len(found)} of {len(places)} evaluated")
    return {place: held for place in places if (held := found[place]) is not None}


def _seen_from_stop(
    robot: Robot, scene: Scene, options: PlanOptions, row: RowOptions, places: Sequence[BaseStop]
) -> dict[BaseStop, dict[str, float | Unpicked] | None]:
    found: dict[BaseStop, dict[str, float | Unpicked] | None] = {}
    for place in places:
        try:
            near = within_reach(robot, place.see_scene(scene, row))
            held = reach_in_turn(robot, near, options)
        except InputError:  # a rigid obstacle is inside the base, or the waiting arm is in collision
            found[place] = None
        else:
            found[place] = {
                name: Unpicked(one.reason, one.obstacle)
                if one.reason is not None
                else 0.0 if one.grasp is None else one.grasp.least_duration
                for name, one in held.items()
            }  # fmt: skip
    return found


def _unreached(tour: TourResult | TourError) -> Sequence[Unreached]:
    """Fruits that a tour does not pick."""
    return [Unreached(*pair) for pair in tour.reasons] if isinstance(tour, TourError) else tour.unreached


def _why_never(attempts: Sequence[Unpicked], stops: int) -> HplanError:
    """Error of a fruit that is picked from none of some stops."""
    why = Unpicked.of_attempts(attempts)
    words = "too long a detour" if why.reason is None else REASON_WORDS[why.reason]
    words += f", most often by {why.obstacle!r}" if why.obstacle else ""
    facts = {"reason": why.reason, "obstacle": why.obstacle}
    return HplanError(f"it cannot be picked from any of {stops} stops: {words}", **facts)


def _tour_at(
    place: BaseStop,
    given: tuple[Robot, Scene, PlanOptions, RowOptions, TourOptions],
    gone: Collection[str],
    wanted: Sequence[str],
) -> TourResult | TourError:
    """Plan the tour at a stop; return the error if no fruit is picked.

    Args:
        place: The stop.
        given: Robot, scene, and options of planning, row and tours.
        gone: Names of the fruits already picked.
        wanted: Names of the fruits to pick.
    """
    robot, scene, options, row, tour = given
    near = within_reach(robot, place.see_scene(scene, row))
    hanging = tuple(fruit for fruit in near.fruits if fruit.name not in gone)
    try:
        return plan_tour(robot, near.copy_unchecked({"fruits": hanging}), options, fruits=wanted, tour=tour)
    except TourError as error:
        return error.with_traceback(None)


def _add_driving(scene: Scene, row: RowOptions, stops: Sequence[RowStop]) -> tuple[list[RowStop], float]:
    """The stops with their driving times, and the total one [s].

    Settling times are included.

    Each pass covers all the fruit from one end to the other; the drive to the other side is not included.
    """
    y = [fruit.center[1] for fruit in scene.fruits]
    ends = min(y), max(y)
    driven, total, height = list[RowStop](), 0.0, row.heights[0]
    for (way, _), group in itertools.groupby(stops, key=lambda stop: (stop.way, stop.place.side)):
        here, end = ends if way % 2 else ends[::-1]
        for stop in group:
            drive = row.drive_s(stop.place.along - here, stop.place.height - height) + row.settling
            driven.append(replace(stop, arrival_s=drive))
            here, height, total = stop.place.along, stop.place.height, total + drive
        total += row.drive_s(end - here)
    return driven, total


def _report(
    robot: Robot,
    scene: Scene,
    row: RowOptions,
    stops: Sequence[RowStop],
    driving_s: float,
    picked: Collection[str],
    reachable: Collection[str],
) -> dict[str, Any]:
    """Contents of `row.json`, except for the planner's own numbers."""
    motion_s, detaching_s = sum(stop.tour.duration for stop in stops), row.detaching * len(picked)
    total_s = motion_s + driving_s + detaching_s
    tree = _trees(scene)
    count = {key: Counter(map(tree.__getitem__, names)) for key, names in
             (("fruits", tree), ("reachable", reachable), ("picked", picked))}  # fmt: skip
    return {
        "status": "ok",
        "scene": scene.name,
        "robot": robot.name,
        "row": asdict(row),
        "fruits": len(scene.fruits),
        "reachable": len(reachable),
        "picked": len(picked),
        "share_picked": len(picked) / len(scene.fruits),
        "share_of_reachable": len(picked) / len(reachable),
        "motion_s": motion_s,
        "driving_s": driving_s,
        "detaching_s": detaching_s,
        "total_s": total_s,
        "motion_s_per_fruit": motion_s / len(picked),
        "total_s_per_fruit": total_s / len(picked),
        "fruit_per_hour": 3600.0 * len(picked) / total_s,
        "trees": {name: {key: counts[name] for key, counts in count.items()} for name in count["fruits"]},
        "stops": [
            {
                **stop.place._asdict(),
                "pass": stop.way,
                "arrival_s": stop.arrival_s,
                "motion_s": stop.tour.duration,
                "detaching_s": row.detaching * len(stop.tour.order),
                "picked": list(stop.tour.order),
                "not_picked": [item.fruit for item in stop.tour.unreached],
                "verified": stop.tour.certificate.verified,
                "min_clearance_m": stop.tour.certificate.min_clearance_m,
                **({} if scene.wood is None else _largest_loads([stop])),
            }
            for stop in stops
        ],
        **({} if scene.wood is None else _largest_loads(stops)),
    }


def _largest_loads(stops: Sequence[RowStop]) -> dict[str, float]:
    """Largest bounds of force [N] and stress [MPa] on limbs and fruit in the tours of some stops."""
    pushes = [push for stop in stops for push in stop.tour.certificate.pushes or ()]
    return {
        "max_force_n": max((push.force_n or 0.0 for push in pushes), default=0.0),
        "max_stress_mpa": max((push.stress_mpa or 0.0 for push in pushes), default=0.0),
    }


def _trees(scene: Scene) -> dict[str, str]:
    """Tree of each fruit: by name, otherwise the nearest trunk."""
    trunks: dict[str, float] = {}
    for one in scene.obstacles:
        if (match := _TREE.match(one.name)) and isinstance(one, Capsule):
            trunks.setdefault(match[0], one.start[1])
    found = {}
    for fruit in scene.fruits:
        own, y = _TREE.match(fruit.name), fruit.center[1]
        found[fruit.name] = own[0] if own else min(trunks, key=lambda name: abs(trunks[name] - y), default=scene.name)
    return found
