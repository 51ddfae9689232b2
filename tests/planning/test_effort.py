"""More effort is never slower."""

from __future__ import annotations

import pytest

import hplan
from hplan.planning.find_motion import find_motion
from hplan.planning.task import PlanningCache
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Scene


def test_best_falls_back_on_what_the_default_finds(robot: Robot, scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    default = hplan.plan(robot, scene)
    efforts = hplan.planning.certified_motion.EFFORTS
    # With nothing spent on optimisation, `best` finds no more than `quick`.
    monkeypatch.setitem(efforts, "best", None)
    task = (
        PlanningCache(robot)
        .context(scene, PlanOptions(effort="best"))
        .task(scene.start.configuration, scene.goal.configuration)
    )
    _, motion = find_motion([task])
    assert motion.trajectory.duration == default.trajectory.duration
    assert motion.task is task
