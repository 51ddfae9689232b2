"""Grids: how many nodes they have, which steps they give way to, and what is said where they are closed."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planned import frame_about_upper_arm, task
from test_grid_route import posed

import hplan.planning.task
from hplan.errors import NoPathError
from hplan.planning.effort import GridAttempt
from hplan.planning.options import PlanOptions
from hplan.planning.task import PlanningTask
from hplan.planning.transits import one_transit
from hplan.robot.model import Robot


def turned_by(robot: Robot, yaw_deg: float, step_deg: float = 1.0) -> PlanningTask:
    scene = task((0.0, 30.0, 20.0, 20.0), (yaw_deg, 30.0, 20.0, 20.0))
    return posed(robot, scene, PlanOptions(step_deg=step_deg))


def test_a_grid_that_is_too_large_gets_a_larger_step(robot: Robot) -> None:
    one = turned_by(robot, 60.0)
    widest = GridAttempt(1.0, 360.0)
    nodes = one.cells(widest)
    assert one.fitting(widest, 1.01 * nodes) == widest
    coarser = one.fitting(widest, 0.5 * nodes)
    assert coarser == replace(widest, step_factor=1.5)
    assert one.cells(coarser) <= 0.5 * nodes
    assert one.fitting(widest, 10.0) is None


@pytest.mark.parametrize("attempt", [GridAttempt(2.0, 4.0), GridAttempt(4.0, 45.0), GridAttempt(4.0, 360.0)])
def test_cells_are_those_of_the_grid(robot: Robot, attempt: GridAttempt) -> None:
    one = turned_by(robot, 60.0)
    assert one.cells(attempt) == pytest.approx(one.occupancy(attempt).grid.size, rel=0.15)


def test_closed_on_the_finest_grid_that_fits_names_its_step(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = task((60.0, 20.0, 20.0, 20.0), (0.0, 70.0, 20.0, 20.0), frame_about_upper_arm(60.0, 20.0))
    locked = scene.model_copy(update={"locked_joints": ("base_yaw",), "goal": scene.goal})
    locked = locked.model_copy(update={"goal": type(scene.goal)(joints_deg=(60.0, 70.0, 20.0, 20.0))})
    for one in (posed(robot, scene, PlanOptions(step_deg=3.0)), posed(robot, locked)):
        widest = GridAttempt(1.0, 360.0)
        monkeypatch.setattr(hplan.planning.task, "MOST_CELLS", 0.5 * one.cells(widest))
        with pytest.raises(NoPathError, match=r"the grid's step is (4|1)\.5 deg") as caught:
            one_transit([one])
        assert caught.value.data["step_deg"] == 1.5 * one.options.step_deg
        assert caught.value.blockers
