"""A row of trees picked from as few stops as can be: where the base stands, and a picking tour at each stop.

The row runs along y of the scene, which shows it as the base sees it at y = 0 on the first side: its line is `distance`
ahead. Candidate stops lie on a grid along it, on one side or both and at each height. What can be picked at each is
looked at, an integer program chooses among them, and a tour is planned at each, in the order of the drive. What a tour
leaves behind later stops try, and further passes along the row.
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

from pydantic import Field

from hplan.base.arguments import instance
from hplan.base.arrays import Record
from hplan.base.options import Options
from hplan.base.tasks import Pool, outcomes, pool_of
from hplan.collision.reach import reach_ball
from hplan.errors import HplanError, InputError, MovingObstacleError, OptionError, TourError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import check_task
from hplan.planning.stages import Progress, no_progress
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Capsule
from hplan.tour.pickable import pickable, within_reach
from hplan.tour.result import TourResult
from hplan.tour.set_cover import cover
from hplan.tour.tour import TourOptions, plan_tour

#: Most candidate stops, passes along the row, and stops that a worker looks at in one go.
_MOST: Final = 20_000
_WAYS: Final = 3
_LOT: Final = 6

#: How the parts of a tree are called in a row of several.
_TREE: Final = re.compile(r"tree \d+(?= )")

Objective = Literal["stops", "time"]

#: A speed or acceleration of the vehicle, and a time in which the arm waits [s].
_Rate: TypeAlias = Annotated[float, Field(ge=0.001, le=100.0)]
_Pause: TypeAlias = Annotated[float, Field(ge=0.0, le=3600.0)]


@dataclass(frozen=True)
class RowOptions(Options):
    """Where the base may stand, and how it gets there.

    Attributes:
        distance: Of the base's axis from the row's line, which the scene has at x = distance [m].
        both: True to stop on both sides of the row; the other side is seen turned by half a turn.
        step: Spacing of the candidate stops [m].
        heights: Heights of a lift or mast, above that of the scene [m].
        objective: `stops`: as few as can be; `time`: least time, by the least durations of the motions to each fruit.
        share: Share of the fruit that any stop can reach which has to be picked.
        speed: Of the vehicle [m/s].
        acceleration: Of the vehicle [m/s^2].
        lift_speed: Of the lift, which moves while the vehicle does [m/s].
        settling: From when the vehicle stands until the arm moves [s].
        detaching: What the tool takes to detach a fruit [s].
        carried: Names of obstacles that stand on the vehicle.
    """

    distance: Annotated[float, Field(ge=0.1, le=100.0)] = 1.4
    both: bool = True
    step: Annotated[float, Field(ge=0.01, le=100.0)] = 0.1
    heights: Annotated[tuple[Annotated[float, Field(ge=-10.0, le=10.0)], ...], Field(min_length=1)] = (0.0,)
    objective: Objective = "stops"
    share: Annotated[float, Field(ge=0.01, le=1.0)] = 1.0
    speed: _Rate = 0.5
    acceleration: _Rate = 0.5
    lift_speed: _Rate = 0.1
    settling: _Pause = 0.5
    detaching: _Pause = 1.0
    carried: tuple[str, ...] = ()

    def drive_s(self, way: float, lift: float = 0.0) -> float:
        """How long the vehicle takes from rest to rest, and the lift beside it [s].

        Args:
            way: [m].
            lift: Change of height [m].
        """
        way, top = abs(way), self.speed**2 / self.acceleration
        slow = 2.0 * math.sqrt(way / self.acceleration)
        return max(
            way / self.speed + self.speed / self.acceleration if way > top else slow, abs(lift) / self.lift_speed
        )

    @property
    def cost_of_stop(self) -> float:
        """What a stop costs beyond its motions [s]; infinite where it is the number of stops that counts."""
        return math.inf if self.objective == "stops" else self.settling + self.speed / self.acceleration


class Place(NamedTuple):
    """Where the base stands: on side 1 or 2 of the row, how far along it, and how high [m]."""

    side: int
    along: float
    height: float

    def seen(self, scene: Scene, options: RowOptions) -> Scene:
        """The scene as the base sees it from there."""
        stands = scene.copy_unchecked(
            {"obstacles": tuple(one for one in scene.obstacles if one.name not in options.carried)}
        )
        if self.side == 1:
            moved = stands.shifted((0.0, -self.along, -self.height))
        else:
            moved = stands.shifted((2.0 * options.distance, self.along, -self.height), 180.0)
        carried = tuple(one for one in scene.obstacles if one.name in options.carried)
        return moved.copy_unchecked({"obstacles": (*moved.obstacles, *carried)})


@dataclass(frozen=True, eq=False)
class RowStop(Record):
    """A stop, and the tour at it.

    Attributes:
        place: Where the base stands.
        way: Number of the pass along the row, from 1 on: odd ones go towards larger y, even ones back.
        arrival_s: Driving from the stop before, or from the row's end, and settling [s].
        tour: The tour; its scene is what is within reach, without what was picked before.
    """

    place: Place
    way: int
    arrival_s: float
    tour: TourResult


@dataclass(frozen=True, eq=False)
class RowResult(Record):
    """A row, picked.

    Attributes:
        stops: In the order of the drive.
        candidates: What can be picked from each candidate stop alone; a stop where something that does not give way is
            in the base, or in the way of the waiting arm, is none.
        picked: The fruits picked, in their order.
        reachable: Those that can be picked from any candidate, in the order of the scene.
        report: The numbers of `row.json`.
        robot: The arm.
        scene: As it was given.
        options: Where the base may stand.
    """

    stops: tuple[RowStop, ...]
    candidates: Mapping[Place, tuple[str, ...]]
    picked: tuple[str, ...]
    reachable: tuple[str, ...]
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
    """Choose stops along a row of trees and plan a picking tour at each, from the start and back to it.

    Args:
        robot: The arm.
        scene: The row, along y, as seen from the first side; of its goal only `approach_deg` counts.
        options: How to plan; rows have no deadline.
        row: Where the base may stand.
        tour: Options of the tours.
        executor: What looks at the candidates, as for `hplan.run_study`; tours are planned here.
        workers: How many at once.
        progress: Called with what is being done.

    Raises:
        InputError: The scene does not fit the robot, or moves.
        OptionError: Too many candidates, a deadline, an obstacle to be carried that is not there, no fruit.
        TourError: No fruit is picked from any stop.
        WorkersLostError: As of `hplan.run_study`.
    """
    check_task(robot, scene, options, progress)
    options = options or PlanOptions()
    row = RowOptions() if row is None else instance("row", row, RowOptions)
    tour = replace(TourOptions() if tour is None else instance("tour", tour, TourOptions), back=True)
    pool = pool_of(executor, workers)
    _check(scene, options, row)
    begin = time.process_time()
    places = _candidates(robot, scene, row)
    costs = _costs(robot, scene, options, row, places, pool, progress)
    looked_s = time.process_time() - begin
    names = {name for held in costs.values() for name in held}
    reachable = tuple(fruit.name for fruit in scene.fruits if fruit.name in names)
    first: dict[str, Any] = {}
    stops = list[RowStop]()
    gone: dict[str, None] = {}  # in the order in which they are picked
    failed: dict[Place, set[str]] = {place: set() for place in costs}
    for way in range(1, _WAYS + 1):
        left = {p: {f: c for f, c in held.items() if f not in gone and f not in failed[p]} for p, held in costs.items()}
        progress(f"pass {way}: choosing stops")
        least = math.ceil(row.share * len(reachable) - 1e-9) - len(gone)
        chosen, is_best = cover(list(left.values()), row.cost_of_stop, least)
        first = first or {"cover_stops": len(chosen), "cover_is_best": is_best}
        assigned = {list(left)[number]: names for number, names in chosen.items()}
        due = list[str]()  # what stops before were to pick and did not
        for place in sorted(assigned, key=lambda place: (place.side, place.along * (-1) ** (way + 1), place.height)):
            wanted = [*assigned[place], *(name for name in due if name in left[place])]
            progress(f"pass {way}, stop {len(stops) + 1}: a tour over {len(wanted)} fruits")
            found = _tour_at(place, (robot, scene, options, row, tour), gone, wanted)
            picked = () if found is None else found.order
            if found is not None:
                stops.append(RowStop(place, way, 0.0, found))
            gone |= dict.fromkeys(picked)
            failed[place] |= set(wanted) - set(picked)
            due = [name for name in dict.fromkeys([*due, *wanted]) if name not in gone]
    if not stops:
        why = HplanError(f"it cannot be picked from any of {len(places)} stops")
        raise TourError([(fruit.name, why) for fruit in scene.fruits])
    driven, driving_s = _driven(scene, row, stops)
    spent = {"candidates_cpu_s": looked_s, "tours_cpu_s": time.process_time() - begin - looked_s}
    report = _report(robot, scene, row, driven, driving_s, tuple(gone), reachable)
    report["planner"] = {"candidates": len(places), "usable": len(costs), **first, **spent}
    candidates = {place: tuple(held) for place, held in costs.items()}
    return RowResult(tuple(driven), candidates, tuple(gone), reachable, report, robot, scene, row)


def _check(scene: Scene, options: PlanOptions, row: RowOptions) -> None:
    """Refuse what rows cannot have."""
    if options.deadline_s is not None:
        raise OptionError("deadline_s", options.deadline_s, "None: rows have no deadline")
    if scene.moves:
        raise MovingObstacleError(scene.first_moving)
    if not scene.fruits:
        raise OptionError("scene", scene.name, "a scene with fruit")
    for name in row.carried:
        if name not in {one.name for one in scene.obstacles}:
            raise OptionError("carried", name, "the name of an obstacle")


def _candidates(robot: Robot, scene: Scene, row: RowOptions) -> list[Place]:
    """All places on the grid that are no farther along the row from some fruit than the arm reaches."""
    y, reach = [fruit.center[1] for fruit in scene.fruits], float(reach_ball(robot)[3])
    first, last = math.ceil((min(y) - reach) / row.step), math.floor((max(y) + reach) / row.step)
    sides = (1, 2) if row.both else (1,)
    if len(sides) * len(row.heights) * (last - first + 1) > _MOST:
        raise OptionError("step", row.step, f"a step that leaves at most {_MOST:,} candidate stops")
    grid = [number * row.step for number in range(first, last + 1)]
    return list(itertools.starmap(Place, itertools.product(sides, grid, row.heights)))


def _costs(
    robot: Robot,
    scene: Scene,
    options: PlanOptions,
    row: RowOptions,
    places: Sequence[Place],
    pool: tuple[Pool, int],
    progress: Progress,
) -> dict[Place, dict[str, float]]:
    """What can be picked from each place where the base can stand, and the least duration to each fruit [s]."""
    lots = [places[i : i + _LOT] for i in range(0, len(places), _LOT)]
    found: dict[Place, dict[str, float] | None] = {}
    for _, lot in outcomes(partial(_seen_from, robot, scene, options, row), lots, *pool):
        found |= lot
        progress(f"stops: {len(found)} of {len(places)} looked at")
    return {place: held for place in places if (held := found[place]) is not None}


def _seen_from(
    robot: Robot, scene: Scene, options: PlanOptions, row: RowOptions, places: Sequence[Place]
) -> dict[Place, dict[str, float] | None]:
    found: dict[Place, dict[str, float] | None] = {}
    for place in places:
        try:
            near = within_reach(robot, place.seen(scene, row))
            held = pickable(robot, near, options)
        except InputError:  # something stands in the base, or in the way of the waiting arm
            found[place] = None
        else:
            found[place] = {name: 0.0 if one.grasp is None else one.grasp.least_duration for name, one in held.items()}
    return found


def _tour_at(
    place: Place,
    given: tuple[Robot, Scene, PlanOptions, RowOptions, TourOptions],
    gone: Collection[str],
    wanted: Sequence[str],
) -> TourResult | None:
    """The tour over some fruits from a place, others being gone; None where none of them can be picked."""
    robot, scene, options, row, tour = given
    near = within_reach(robot, place.seen(scene, row))
    hanging = tuple(fruit for fruit in near.fruits if fruit.name not in gone)
    try:
        return plan_tour(robot, near.copy_unchecked({"fruits": hanging}), options, fruits=wanted, tour=tour)
    except TourError:
        return None


def _driven(scene: Scene, row: RowOptions, stops: Sequence[RowStop]) -> tuple[list[RowStop], float]:
    """The stops with their arrivals, and how long the vehicle drives and settles in all [s].

    Each pass goes along all the fruit from one end to the other; how the vehicle comes to the other side is not in it.
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
    """The numbers of `row.json`, but for the planner's own."""
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
            }
            for stop in stops
        ],
    }


def _trees(scene: Scene) -> dict[str, str]:
    """The tree of each fruit: that of its name, else the one whose trunk stands nearest along the row."""
    trunks: dict[str, float] = {}
    for one in scene.obstacles:
        if (match := _TREE.match(one.name)) and isinstance(one, Capsule):
            trunks.setdefault(match[0], one.start[1])
    found = {}
    for fruit in scene.fruits:
        own, y = _TREE.match(fruit.name), fruit.center[1]
        found[fruit.name] = own[0] if own else min(trunks, key=lambda name: abs(trunks[name] - y), default=scene.name)
    return found
