"""Two arms on one clock: motions that graze each other, motions that pass, and stops at random instants.

Two harvesters move at the same time, each between random configurations. The second is shifted towards the first until
the two just touch, by Pinocchio and coal alone; farther by `DEPTHS` they graze, `GAP` back they pass. Of the motions
that `plan_cell` makes for another such pair one arm, or all, stop at random instants.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from studies.harness import Asked, Row, Study
from studies.measure import timed
from studies.outside import between_arms

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError
from hplan.planning.cell import Cell, certify_cell
from hplan.planning.cell_planner import plan_cell
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import load_robot
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.model import Goal, Start
from hplan.trajectory.trajectory import Trajectory

#: By how much grazing motions overlap, along the shift; by how much passing ones are apart [m].
DEPTHS, GAP = (1e-4, 5e-3), 1e-3

#: Times between the configurations that are looked at [s]; stops of a pair.
LOOK_S, STOPS = 1e-3, 12


class Bodies:
    """Distances of two arms of a cell by coal, the second shifted."""

    def __init__(self, cell: Cell, motion: Trajectory) -> None:
        model, self._geometry = cell.robot.model, between_arms(cell)
        frames, second = model.frames, cell.arms[1].name
        of_second = [cell.owner(frames[body.parentFrame].name) == second for body in self._geometry.geometryObjects]
        self._data, data = self._geometry.createData(), model.createData()
        self._second, self._places = np.flatnonzero(of_second).tolist(), []
        for q in motion.positions(np.arange(0.0, motion.duration + LOOK_S, LOOK_S)):
            pin.updateGeometryPlacements(model, data, self._geometry, self._data, q)
            self._places.append([place.copy() for place in self._data.oMg])

    def touch(self, shift: FloatArray, coarse: int = 1) -> bool:
        """True if they touch at any instant."""
        for places in self._places[::coarse]:
            for number, place in enumerate(places):
                moved = place.translation + shift if number in self._second else place.translation
                self._data.oMg[number] = pin.SE3(place.rotation, moved)
            if pin.computeCollisions(self._geometry, self._data, True):
                return True
        return False


def drawn(rng: np.random.Generator, distance: float, aside: float = 0.0) -> Cell:
    """Two harvesters that look at each other, between random configurations."""
    robot = load_robot()
    low, high = np.array([-70.0, 0.0, 0.0, 0.0]), np.array([70.0, 90.0, 90.0, 90.0])
    arms = tuple(
        CellRobot(
            name=name, position=place, rpy_deg=(0.0, 0.0, turn),
            start=Start(joints_deg=tuple(rng.uniform(low, high).tolist())),
            goal=Goal(joints_deg=tuple(rng.uniform(low, high).tolist())),
        )
        for name, place, turn in (("a", (0.0, 0.0, 0.0), 0.0), ("b", (distance, aside, 0.0), 180.0))
    )  # fmt: skip
    return Cell.of(CellScene(name="pair", robots=arms), {"a": robot, "b": robot})


def _row(asked: Asked, number: int) -> Row:
    row: Row = {"name": str(number)}
    for part in (_grazing, _stops):
        try:
            row |= part(asked, number)
        except HplanError as error:
            row[f"{part.__name__[1:]}_without"] = error.kind
    return row | {"fault": any(row.get(key) for key in ("grazing_verified", "passing_refused", "stops_uncertified"))}


def _grazing(asked: Asked, number: int) -> dict[str, Any]:
    rng = np.random.default_rng([asked.seed, number])
    far = 4.0
    cell = drawn(rng, far)
    motions = {arm.name: plan(arm.robot, arm.scene, PlanOptions(effort="quick")).trajectory for arm in cell.arms}
    bodies, aside = Bodies(cell, cell.together(motions)), float(rng.uniform(-0.3, 0.3))

    def shift(x: float) -> FloatArray:
        return np.array([x, aside, 0.0])

    near = next((x for x in np.arange(-1.0, -3.4, -0.1) if bodies.touch(shift(x), 8)), None)
    if near is None:
        return {}
    apart = near + 0.1
    while abs(apart - near) > 2e-6:
        middle = 0.5 * (near + apart)
        near, apart = (middle, apart) if bodies.touch(shift(middle)) else (near, middle)
    depth = math.exp(rng.uniform(*np.log(DEPTHS)))
    found = {}
    for key, x in (("grazing_verified", near - depth), ("passing_verified", apart + GAP)):
        moved = drawn(np.random.default_rng([asked.seed, number]), far + x, aside)
        found[key] = certify_cell(moved, motions).between.verified
    return {"grazing_verified": found["grazing_verified"], "passing_refused": not found["passing_verified"]}


def _stops(asked: Asked, number: int) -> dict[str, Any]:
    rng = np.random.default_rng([asked.seed, number, 1])
    result = plan_cell(drawn(rng, float(rng.uniform(0.8, 1.2))), PlanOptions(effort="quick"))
    uncertified, went_on, times = 0, 0, []
    for count, t in enumerate(rng.uniform(0.0, result.trajectory.duration, STOPS).tolist()):
        arm = (None, "a", "b")[count % 3]
        stop, milliseconds = timed(partial(result.stop_at, t, arm))
        uncertified += not stop.certificate.verified
        went_on += stop.stopped == (arm,)
        times.append(milliseconds)
    median = float(np.median(times))
    return {
        "stops": STOPS,
        "stops_uncertified": uncertified,
        "others_go_on": went_on,
        "stop_ms": median,
        "how": result.how,
    }


PAIRS = Study(
    "cell_pairs",
    "two arms whose motions graze each other or pass; stops of either",
    _row,
    (
        "grazing_verified",
        "passing_refused",
        "stops",
        "stops_uncertified",
        "others_go_on",
        "stop_ms",
        "how",
        "grazing_without",
        "stops_without",
    ),
    count=(300, 3),
)
