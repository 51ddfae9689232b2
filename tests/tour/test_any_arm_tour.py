"""Picking tours of general (non-planar) arms."""

from __future__ import annotations

import json
from pathlib import Path

import coal
import numpy as np
import pytest
from any_arms import FRUITS, TRUNK

import hplan.errors as errors
from hplan.apps.cli.main import main
from hplan.certificate.certificate import certify
from hplan.collision.collision_bodies import body_shapes, collision_bodies
from hplan.collision.held_objects import holding
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.file import save_scene
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Capsule
from hplan.tour.motions import CARRIED, carried_fruit
from hplan.tour.tour import TourOptions, TourResult, plan_tour

QUICK = PlanOptions(effort="quick")
START = (0.0, 0.2, 1.2, -0.8, 0.0, 0.0)
SCENE = Scene(
    name="three", start=Start(joints_rad=START), goal=Goal(fruit="apple 0"), obstacles=(TRUNK,), fruits=FRUITS
)
#: Before the arm, the tool straight down.
BIN = Goal(position=(0.25, -0.45, 0.25), quaternion_xyzw=(1.0, 0.0, 0.0, 0.0))


def assert_sound(robot: Robot, tour: TourResult) -> None:
    """Each leg is at its fruit when it says so, moves on from the one before, and is certified."""
    assert tour.certificate.verified
    centers = {fruit.name: np.array(fruit.center) for fruit in tour.scene.fruits}
    for name, at_s in tour.picked.items():
        tool = robot.tool_positions(tour.trajectory.positions(np.array([at_s])))[0]
        assert np.linalg.norm(tool - centers[name]) < 1e-4
    ends = [leg.trajectory.position[-1] for leg in tour.legs[:-1]]
    for end, leg in zip(ends, tour.legs[1:], strict=True):
        assert leg.trajectory.position[0] == pytest.approx(end, abs=1e-9)
    assert all(leg.certificate.verified for leg in tour.legs)


def test_all_fruits_are_picked_and_the_arm_comes_back(picker: Robot) -> None:
    tour = plan_tour(picker, SCENE, QUICK, tour=TourOptions(back=True))
    assert sorted(tour.order) == [fruit.name for fruit in FRUITS]
    assert_sound(picker, tour)
    assert tour.trajectory.position[-1] == pytest.approx(START, abs=1e-9)
    first = tour.legs[0]
    assert first.fruit is not None
    scene = SCENE.model_copy(update={"goal": Goal(fruit=first.fruit)})
    assert not [line for line in certify(picker, scene, first.trajectory).violations if "apple" in line]


@pytest.mark.parametrize("drop", [BIN, Goal(joints_rad=START), Goal(position=(0.25, -0.45, 0.25), approach_deg=-90.0)])
def test_fruit_is_carried_to_a_pose_to_joints_or_to_a_place(picker: Robot, drop: Goal) -> None:
    fruits = SCENE.fruits[:2]
    tour = plan_tour(
        picker, SCENE.model_copy(update={"fruits": fruits}), QUICK, tour=TourOptions(drop_off=drop, every=1)
    )
    assert sorted(tour.order) == sorted(tour.dropped)
    assert_sound(picker, tour)
    for at_s in tour.dropped.values():
        q = tour.trajectory.positions(np.array([at_s]))[0]
        if drop.pose is not None:
            assert picker.forward_kinematics(q) == pytest.approx(drop.pose, abs=1e-5)
        elif drop.position is not None:
            assert picker.tool_positions(q) == pytest.approx(drop.position, abs=1e-5)
        else:
            assert q == pytest.approx(START, abs=1e-9)


def test_carried_fruit_is_a_ball_at_the_tool_that_keeps_clear(picker: Robot) -> None:
    loaded = holding(picker, [carried_fruit(0.05)])
    ball = collision_bodies(loaded)[-1]
    assert ball.name == CARRIED
    assert (ball.kind, ball.rounding, ball.joint) == ("sphere", 0.05, picker.dof - 1)
    assert isinstance(loaded.collision_model.geometryObjects[-1].geometry, coal.Sphere)
    assert collision_bodies(loaded)[:-1] == collision_bodies(picker)
    assert [shape.name for shape in body_shapes(loaded)[:-1]] == [shape.name for shape in body_shapes(picker)]
    assert body_shapes(loaded)[-1].placement == picker.model.frames[picker.frame_number("tool0")].placement
    # The empty arm may come there; with the ball it would touch the rim.
    rim = Capsule.model_validate(
        {"name": "rim", "kind": "capsule", "from": (0.285, -0.55, 0.25), "to": (0.285, -0.35, 0.25), "radius": 0.005}
    )
    scene = SCENE.model_copy(update={"fruits": FRUITS[:1], "obstacles": (TRUNK, rim), "goal": BIN})
    assert plan(picker, scene, QUICK).certificate.verified
    with pytest.raises(errors.BlockedError, match="rim"):
        plan_tour(picker, scene, QUICK, tour=TourOptions(drop_off=BIN))


def test_command_plans_a_tour_with_a_pose_to_drop_at(
    picker: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = save_scene(SCENE.model_copy(update={"fruits": FRUITS[:2]}), tmp_path / "scene.yaml")
    out = tmp_path / "out"
    arguments = ["tour", str(scene), "--robot", str(picker.urdf_path), "--out", str(out), "--quiet"]
    pose = [str(value) for value in (*(BIN.position or ()), *(BIN.quaternion_xyzw or ()))]
    assert main([*arguments, "--drop-off-pose", *pose]) == 0
    report = json.loads((out / "tour.json").read_text())
    assert report["certificate"]["verified"]
    assert sorted(report["order"]) == ["apple 0", "apple 1"]
    assert (out / "tour.csv").stat().st_size > 1000
    assert (out / "scene.html").stat().st_size > 100_000
    assert main([*arguments, "--drop-off-pose", "0", "0", "1", "0", "0", "0", "5"]) == 2
    assert main([*arguments, "--drop-off", "0", "0", "1", "--drop-off-pose", *pose]) == 2
    assert "no value with --drop-off" in capsys.readouterr().err
