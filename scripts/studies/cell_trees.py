"""Several arms pick one tree (--trees), compared with the fastest single arm.

Judged by Pinocchio and coal alone. Orchard arms are next to or above each other, `DISTANCE` from the trunk; thin wood
and fruit are compliant, and parts of the tree in a base are left out. Fruit hangs as in the files, or at tips of
branches; a tree that overlaps an arm's base or waiting pose is turned by a quarter.
"""

from __future__ import annotations

from pathlib import Path

from studies.harness import Row, Study, StudyConfig
from studies.measure import timed
from studies.outside import contacts

from hplan.errors import HplanError, InputError, TourError
from hplan.planning.options import PlanOptions
from hplan.planning.world import without_inside
from hplan.robot.model import Robot, load_robot
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.model import Scene, Start
from hplan.scene.orchard import MeasuredOptions, measured_orchard
from hplan.tour.cell_tour import CellTour, plan_cell_tour
from hplan.tour.tour import TourOptions, plan_tour
from hplan.workcell.cell import Cell

#: Distance of the trunk from the bases, compliance of thin parts [m], and the maximum number of fruits.
DISTANCE, YIELDS, FRUITS = 1.4, 0.02, 80

#: Waiting poses of the arms, below others and elsewhere [deg]; positions of their bases [m].
BELOW, ABOVE, HIGHER = (0.0, 65.0, -140.0, -100.0), (0.0, 90.0, 90.0, 90.0), 1.2
STANDS = {
    "side by side": [(0.0, -0.45, 0.0), (0.0, 0.45, 0.0)],
    "one above the other": [(0.0, 0.0, 0.0), (0.0, 0.0, HIGHER)],
    "three": [(0.0, -0.8, 0.0), (0.0, 0.0, 0.0), (0.0, 0.8, 0.0)],
    "four": [(0.0, y, z) for y in (-0.45, 0.45) for z in (0.0, HIGHER)],
}

#: The fruit is shared evenly if every arm has at least this fraction of an equal share.
EQUAL = 0.8


def _problems(config: StudyConfig) -> list[tuple[Path, str]]:
    chosen = [list(STANDS)[int(number)] for number in config.values.get("stands", (0, 1))]
    return [(file, stands) for stands in chosen for file in config.tree_files]


def cell_of(robot: Robot, tree: Scene, stands: str) -> Cell:
    """The arms before a tree."""
    places = STANDS[stands]
    waits = [BELOW if (*place[:2], HIGHER) in places and place[2] < HIGHER else ABOVE for place in places]
    arms = tuple(
        CellRobot(name=name, position=place, start=Start(joints_deg=wait))
        for name, place, wait in zip("abcd", places, waits, strict=False)
    )
    scene = CellScene(name=stands, robots=arms, obstacles=tree.obstacles, fruits=tree.fruits)
    return Cell.from_robots(scene, {arm.name: robot for arm in arms})


def _picked(config: StudyConfig, file: Path, stands: str, yaw_deg: float) -> tuple[CellTour, float]:
    """A picked tree, and the CPU time of planning [ms].

    Raises:
        InputError: An arm's base or waiting pose is in the tree.
        HplanError: As in `plan_cell_tour`.
    """
    robot, fruits = load_robot("orchard_harvester"), int(config.values.get("fruits", (FRUITS,))[0])
    options = MeasuredOptions(
        distance=DISTANCE, yaw_deg=yaw_deg, fruits=fruits, wood_yields=YIELDS, fruit_yields=YIELDS
    )
    tree = measured_orchard([file], options)
    inside = {name for arm in cell_of(robot, tree, stands).arms for name in without_inside(robot, arm.scene)[1]}
    kept = {
        key: tuple(item for item in getattr(tree, key) if item.name not in inside or not item.yields)
        for key in ("obstacles", "fruits")
    }
    cell = cell_of(robot, tree.with_values(**kept), stands)
    return timed(lambda: plan_cell_tour(cell, PlanOptions(effort=config.effort)))


def _alone(config: StudyConfig, cell: Cell, name: str) -> tuple[float, float]:
    """How many fruits a second an arm picks that is there alone, and which part of its time is the way out and home."""
    arm = cell.arm(name)
    try:
        tour = plan_tour(arm.robot, arm.scene, PlanOptions(effort=config.effort), tour=TourOptions(back=True))
    except TourError:
        return 0.0, 0.0
    out, home = tour.phases[0], tour.phases[-1]
    return len(tour.order) / tour.duration, (out.end_s - out.start_s + home.end_s - home.start_s) / tour.duration


def _row(config: StudyConfig, problem: tuple[Path, str]) -> Row:
    file, stands = problem
    row: Row = {"name": f"{file.stem} {stands}", "stands": stands, "solved": False}
    for yaw_deg in (0.0, 90.0):
        try:
            found, ms = _picked(config, file, stands, yaw_deg)
            break
        except HplanError as error:
            row |= {"how": error.kind, "message": error.message}
            if not isinstance(error, InputError):
                return row
    else:
        return row
    cell, report = found.cell, found.report
    own = {
        name: len({fruit for tour in tours for fruit in tour.order} & set(found.picked))
        for name, tours in found.tours.items()
    }
    busy = {name: max(seconds, 1e-3) for name, seconds in report["busy_s"].items()}
    quicker = max(own, key=lambda name: own[name] / busy[name])
    (alone, ways), shares = _alone(config, cell, quicker), list(own.values())
    rate, arms = len(found.picked) / found.trajectory.duration, len(cell.arms)
    equal = len(shares) == arms and min(shares) * arms >= EQUAL * sum(shares)
    rigid = tuple(item for item in cell.scene.obstacles if not item.yields)
    firm = cell.task(cell.configuration({})).with_values(obstacles=rigid, fruits=())
    with_wood, with_arms = contacts(cell.robot, firm, found.trajectory)
    return row | {
        "solved": found.verified, "how": "verified" if found.verified else "not verified", "turned_deg": yaw_deg,
        "picked": len(found.picked), "shares": "/".join(map(str, shares)), "equal": equal, "s": 1e-3 * ms,
        "a_fruit_s": 1.0 / rate, "alone_a_fruit_s": 1.0 / alone, "to_one_alone": rate / alone,
        "at_best": 1.0 / ((1.0 - ways) / arms + ways),  # its tour in as many parts, each arm out and home
        "to_one_where_equal": rate / alone if equal else None,
        "parallel": report["parallel_ratio"], "idle_s": max(report["idle_s"].values()),
        "contacts": with_arms, "with_wood": with_wood, "fault": with_arms + with_wood > 0,
    }  # fmt: skip


CELL_TREES = Study(
    "cell_trees",
    "orchard arms that pick one tree together, beside one alone (--trees)",
    _row,
    (
        *("solved", "how", "picked", "shares", "equal", "a_fruit_s", "alone_a_fruit_s", "to_one_alone", "at_best"),
        *("to_one_where_equal", "parallel", "idle_s", "contacts", "with_wood", "s"),
    ),
    _problems,
    by="stands",
    count=(None, 1),
    needs=("trees",),
    warm=0,
)
