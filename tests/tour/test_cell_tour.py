"""Arms that pick together, judged by Pinocchio and coal alone."""

from __future__ import annotations

import json

import coal
import numpy as np
import pinocchio as pin
import pytest
from studies.outside import between_arms

from hplan import load_robot
from hplan.apps.cli.main import main
from hplan.apps.ros import write_mcap
from hplan.apps.view.playback import playable
from hplan.apps.view.scene_stage import build_stage
from hplan.apps.view.scenery import picks
from hplan.certificate.certificate import certify
from hplan.errors import ConfigurationInCollisionError, TourError
from hplan.planning.options import PlanOptions
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.file import load_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Start
from hplan.tour.cell_tour import CellTour, plan_cell_tour
from hplan.workcell.cell import Cell

QUICK = PlanOptions(effort="quick")

#: Where fruit is let go.
DROP = Goal(joints_deg=(0.0, 100.0, 100.0, 60.0))


@pytest.fixture(scope="module")
def orchard() -> tuple[Cell, CellScene]:
    """Two orchard arms in front of a row, and their scene."""
    scene = load_scene("orchard-arm-row")
    robot = load_robot(scene.robot)
    arms = (
        CellRobot(name="left", position=(0.0, 0.4, 0.0), start=scene.start),
        CellRobot(name="right", position=(0.0, -0.4, 0.0), start=scene.start),
    )
    everything = CellScene(name="two", obstacles=scene.obstacles, fruits=scene.fruits[:9], robots=arms)
    return Cell.from_robots(everything, {"left": robot, "right": robot}), everything


@pytest.fixture(scope="module")
def result(orchard) -> CellTour:
    return plan_cell_tour(orchard[0])


def assert_arms_apart(cell, motion, carried=()):
    model, geometry = cell.robot.model, between_arms(cell, carried)
    data, seen = model.createData(), geometry.createData()
    for q in motion.positions(np.arange(0.0, motion.duration, 4e-3)):
        assert not pin.computeCollisions(model, data, geometry, seen, q, True)


def test_picked_fruit_goes_with_the_tool_of_its_arm_on_the_page_and_in_messages(result, tmp_path):
    robot, scene, playback = playable(result)
    found = picks(scene, playback)
    assert {pick.fruit.name for pick in found} == set(result.picked)
    assert {pick.tool for pick in found} == {"left_tool0", "right_tool0"}
    (animation,) = [command for command in build_stage(robot, scene, playback) if command["type"] == "set_animation"]
    clips = {clip["path"]: clip["clip"]["tracks"] for clip in animation["animations"]}
    for pick in found:
        (track,) = [t for t in clips[f"/hplan/picked/fruit {pick.fruit.name}"] if t["name"] == ".position"]
        times, places = np.array(track["times"]), np.array(track["values"]).reshape(-1, 3)
        held = (times > pick.since) & (times < pick.until)
        assert held.any()
        at = [*times[held], pick.since]
        tool = robot.forward_kinematics(result.trajectory.positions(at), pick.tool)[:, :3, 3]
        moved = tool[:-1] - tool[-1]
        np.testing.assert_allclose(places[held] - pick.fruit.center, moved, atol=2e-3)
        assert np.linalg.norm(moved, axis=1).max() > 0.02
    assert write_mcap(result, tmp_path / "two.mcap", rate_hz=5.0).stat().st_size > 10_000


def test_two_arms_pick_simultaneously(orchard, result):
    cell, scene = orchard
    assert result.verified
    assert set(result.picked) | {item.fruit for item in result.unreached} == {fruit.name for fruit in scene.fruits}
    assert len(result.picked) >= 7
    assert result.trajectory.duration < 0.8 * sum(t.duration for own in result.tours.values() for t in own)
    assert_arms_apart(cell, result.trajectory)
    where = {fruit.name: np.array(fruit.center) for fruit in scene.fruits}
    for name, tours in result.tours.items():
        picked = {fruit: t for fruit, t in result.picked.items() if any(fruit in tour.order for tour in tours)}
        tools = cell.robot.forward_kinematics(result.trajectory.positions(list(picked.values())), f"{name}_tool0")
        for fruit, tool in zip(picked, tools[:, :3, 3], strict=True):
            assert np.linalg.norm(tool - where[fruit]) < 2e-3
        # The phases of an arm's tours cover its motion completely; it stops no more often than alone.
        planned = [(tour.trajectory, own.start_s, own.end_s) for tour in tours for own in tour.phases]
        for phase in result.phases[name]:
            lasts = phase.end_s - phase.start_s
            clock = np.linspace(0.0, lasts, 20)
            q = result.trajectories[name].positions(phase.start_s + clock)
            same = [(motion, begin) for motion, begin, end in planned if abs(end - begin - lasts) < 1e-6]
            assert any(np.allclose(q, motion.positions(begin + clock), atol=1e-6) for motion, begin in same)
        for tour in tours:
            assert (np.abs(tour.trajectory.velocity).max(axis=1) < 1e-9).sum() <= len(tour.order) + 3


def test_arms_that_are_in_each_others_way_wait(orchard):
    """So close to each other that simultaneous motions would collide."""
    cell, scene = orchard
    near = scene.model_copy(
        update={
            "robots": tuple(a.model_copy(update={"position": (0.0, 0.5 * a.position[1], 0.0)}) for a in scene.robots)
        }
    )
    robot = cell.arm("left").robot
    result = plan_cell_tour(Cell.from_robots(near, {"left": robot, "right": robot}), QUICK)
    assert result.verified
    assert result.picked
    alone = result.cell.task(result.trajectory.position[-1], obstacles=False)
    assert certify(result.cell.robot, alone, result.trajectory).verified


def test_arms_one_above_the_other(orchard):
    cell, scene = orchard
    arms = (
        CellRobot(name="left", start=Start(joints_deg=(0.0, 65.0, -140.0, -100.0))),
        CellRobot(name="right", position=(0.0, 0.0, 1.2), start=Start(joints_deg=(0.0, 90.0, 90.0, 90.0))),
    )
    fruits = load_scene("orchard-arm-row").fruits[9:18]
    robot = cell.arm("left").robot
    stacked = Cell.from_robots(
        scene.model_copy(update={"robots": arms, "fruits": fruits}), {"left": robot, "right": robot}
    )
    result = plan_cell_tour(stacked, QUICK)
    assert result.verified
    assert len(result.picked) >= 6
    assert_arms_apart(stacked, result.trajectory)
    np.testing.assert_allclose(result.trajectory.position[-1], result.trajectory.position[0], atol=1e-9)


def test_fruit_goes_to_the_drop_offs_and_is_in_nobodys_way(orchard):
    cell, scene = orchard
    arms = tuple(arm.model_copy(update={"drop_off": DROP, "every": 2}) for arm in scene.robots)
    robot = cell.arm("left").robot
    carrying = scene.model_copy(update={"robots": arms, "fruits": scene.fruits[:6]})
    result = plan_cell_tour(Cell.from_robots(carrying, {"left": robot, "right": robot}), QUICK)
    assert result.verified
    assert len(result.picked) >= 4
    assert result.dropped.keys() == result.picked.keys()
    for fruit, time in result.dropped.items():
        assert time > result.picked[fruit]
        (own,) = (name for name, tours in result.tours.items() if any(fruit in tour.order for tour in tours))
        at = result.trajectories[own].positions([time])[0]
        np.testing.assert_allclose(at, np.radians(DROP.joints_deg), atol=1e-9)
    assert playable(result)[2].dropped == result.dropped
    model, balls = cell.robot.model, []
    for name in ("left", "right"):
        number = model.getFrameId(f"{name}_tool0")
        at = model.frames[number]
        ball = coal.Sphere(max(fruit.radius for fruit in carrying.fruits))
        balls.append(pin.GeometryObject(f"{name}_fruit", at.parentJoint, number, at.placement, ball))
    assert_arms_apart(cell, result.trajectory, balls)


def test_carried_fruit_keeps_clear_of_other_arm(robot):
    """Hands side by side, with less than a fruit between them; nothing is carried without a drop-off."""
    start = Start(joints_deg=(0.0, 60.0, 60.0, 60.0))
    apple = Fruit(name="apple", center=(9.0, 0.0, 1.0), radius=0.29)
    for drop_off, error, told in ((None, TourError, "apple"), (DROP, ConfigurationInCollisionError, "start")):
        arms = (
            CellRobot(name="a", start=start, drop_off=drop_off),
            CellRobot(name="b", position=(0.0, 0.32, 0.0), start=start),
        )
        with pytest.raises(error, match=told):
            plan_cell_tour(
                Cell.from_robots(CellScene(name="s", robots=arms, fruits=(apple,)), {"a": robot, "b": robot})
            )


def test_arms_that_touch_at_the_start_are_refused(robot):
    start = Start(joints_deg=(0.0, 60.0, 60.0, 60.0))
    arms = (CellRobot(name="a", start=start), CellRobot(name="b", position=(0.0, 0.0, 0.1), start=start))
    with pytest.raises(ConfigurationInCollisionError, match="start"):
        plan_cell_tour(Cell.from_robots(CellScene(name="s", robots=arms), {"a": robot, "b": robot}))


def test_nothing_to_pick(robot):
    far = Fruit(name="far", center=(9.0, 0.0, 1.0), radius=0.04)
    arm = CellRobot(name="one", start=Start(joints_deg=(0.0, 60.0, 60.0, 60.0)))
    with pytest.raises(TourError, match="far"):
        plan_cell_tour(Cell.from_robots(CellScene(name="s", robots=(arm,), fruits=(far,)), {"one": robot}))


CELL = """\
format: hplan-scene/1
name: two
robots:
- {name: left, start: {joints_deg: [0, 60, 60, 60]}}
- {name: right, position: [0, -4, 0], start: {joints_deg: [0, 60, 60, 60]}}
fruits:
- {name: a, center: [1.2, 0.2, 1.6], radius: 0.04}
- {name: b, center: [1.2, -3.9, 1.6], radius: 0.04}
"""


def test_command(write, tmp_path):
    assert main(["tour", str(write("cell.yaml", CELL)), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    report = json.loads((tmp_path / "out" / "tour.json").read_text())
    assert report["picked"] == 2
    assert report["speed_up_over_one_arm"] > 1.5
    assert {file.name for file in (tmp_path / "out").iterdir()} == {
        "scene.html", "tour.csv", "tour-left.csv", "tour-right.csv", "tour.json",
    }  # fmt: skip
