"""Whatever takes still scenes refuses one in which something moves, and says what does."""

from __future__ import annotations

import pytest
from planned import task

import hplan
from hplan.apps.execution.simulation import execute
from hplan.errors import MovingObstacleError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.task import PlanningCache
from hplan.planning.world import without_inside
from hplan.scene.model import Fruit
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track

AWAY = Track(times_s=(0.0, 1.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
SCENE = task(
    (0.0, 0.0, 0.0, 0.0),
    (0.0, 45.0, 60.0, 70.0),
    [Sphere(name="bird", center=(1.0, 1.0, 1.0), radius=0.1, track=AWAY)],
    fruits=(Fruit(name="apple", center=(1.2, 0.4, 1.9), radius=0.04),),
    locked_joints=("base_yaw",),
)


def refused(ask) -> None:
    with pytest.raises(MovingObstacleError) as caught:
        ask()
    assert caught.value.obstacle == "bird"
    assert caught.value.exit_status == 2


def test_tours_bounds_worlds_and_execution(robot):
    refused(lambda: hplan.plan_tour(robot, SCENE))
    refused(lambda: plan(robot, SCENE, PlanOptions(bound=True)))
    refused(lambda: PlanningCache(robot).world(SCENE, PlanOptions()))
    refused(lambda: without_inside(robot, SCENE))
    result = plan(robot, SCENE)
    assert result.certificate.verified
    refused(lambda: execute(robot, SCENE, result.trajectory))


def test_a_planner_plans_among_what_moves_until_it_stands_still(robot):
    planner = hplan.Planner(robot, SCENE)
    assert planner.plan().certificate.verified
    assert planner.replan().certificate.nearest_s is not None
    planner.move("bird", track=None)
    assert not planner.scene.moves
    assert planner.plan().certificate.nearest_s is None
    planner.move("bird", track=AWAY)
    assert planner.plan().certificate.nearest_s is not None
