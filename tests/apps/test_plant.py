"""Motions run by machines that are others than their controller believes."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest
from any_arms import GANTRY
from planned import between_twigs, post, task
from script_loader import load_script

from hplan.apps.execution.plant import Plant
from hplan.apps.execution.simulation import execute
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.file import load_scene, save_scene
from hplan.scene.model import Goal, Scene, Start
from hplan.trajectory.trajectory import read_csv, write_csv

needs_mujoco = pytest.mark.skipif(
    importlib.util.find_spec("mujoco") is None, reason="MuJoCo is not installed: pip install 'hplan[execution]'"
)

#: Bandwidth of a stiff position loop [rad/s].
STIFF = 200.0

MODEL = TrackingModel(math.radians(0.02), 3e-3)


@pytest.fixture(scope="module")
def around_a_post(robot: Robot) -> PlanResult:
    """Past an obstacle, with room for the tracking error."""
    scene = task((0.0, 30.0, 20.0, 20.0), (60.0, 30.0, 20.0, 20.0), [post("post", 30.0, 1.3, 0.0, 2.6, 0.05)])
    return plan(robot, scene, PlanOptions(tracking_error=MODEL.still_rad, tracking_delay_s=MODEL.delay_s))


@needs_mujoco
def test_a_late_command_is_a_lag_of_as_long(robot: Robot, around_a_post: PlanResult) -> None:
    """Every joint is behind by its velocity times the delay, and so within a model of that delay alone."""
    delay = 5e-3
    late = execute(
        robot,
        around_a_post.motion.task.scene,
        around_a_post.trajectory,
        Plant(command_delay_s=delay, bandwidth=STIFF, decoupled=True),
    )
    moving = np.abs(late.reference_velocity) > 0.5
    lag = (late.reference - late.position)[moving] / late.reference_velocity[moving]
    assert np.median(lag) == pytest.approx(delay, rel=0.1)
    assert late.is_within(TrackingModel(MODEL.still_rad, 1.5 * delay))
    assert not late.is_within(TrackingModel(MODEL.still_rad, 0.5 * delay))


@needs_mujoco
@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_other_masses_sag_and_a_stiffer_controller_sags_less(
    robot: Robot, around_a_post: PlanResult, factor: float
) -> None:
    scene, motion = around_a_post.motion.task.scene, around_a_post.trajectory
    plants = Plant(factor, 1e-3), Plant(factor, 1e-3, STIFF, decoupled=True)
    soft, stiff = (execute(robot, scene, motion, plant) for plant in plants)
    sag = (soft.position - soft.reference)[-1, 1:]  # at rest, where gravity alone acts
    assert np.abs(sag).max() > 5e-4
    assert (np.sign(sag[0]) < 0.0) == (factor > 1.0)
    assert np.abs((stiff.position - stiff.reference)[-1]).max() < 0.1 * np.abs(sag).max()
    assert not soft.is_within(MODEL)
    assert stiff.is_within(MODEL)
    assert not stiff.contacts


@needs_mujoco
@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_nothing_is_touched_within_the_model(robot: Robot, factor: float) -> None:
    """Between two twigs to a fruit: planned with the model, run late by a machine of other masses."""
    scene = between_twigs()
    options = PlanOptions(tracking_error=MODEL.still_rad, tracking_delay_s=MODEL.delay_s)
    result = execute(robot, scene, plan(robot, scene, options).trajectory, Plant(factor, 1e-3, STIFF, decoupled=True))
    assert result.is_within(MODEL)
    assert not result.contacts


@needs_mujoco
def test_execute_says_whether_the_tracking_error_was_kept(
    robot: Robot, around_a_post: PlanResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_csv(around_a_post.trajectory, tmp_path / "trajectory.csv")
    command = [str(path), "--mass-factor", "1.2", "--command-delay", "1", "--tracking-delay", "3"]
    for more, said in ((("--tracking-error", "0.02"), "some joint was"), (("--tracking-error", "1"), "no joint was")):
        load_script("execute").main([*command, *more])
        assert said in capsys.readouterr().out
    assert load_script("execute").main([*command, "--mass-factor", "-1"]) == 2


@needs_mujoco
def test_what_slides_is_off_by_millimetres(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm, asked = tmp_path / "gantry.urdf", tmp_path / "scene.yaml"
    arm.write_text(GANTRY)
    gantry = load_robot(arm)
    save_scene(Scene(name="rail", start=Start(joints_rad=(0.2, 0.3)), goal=Goal(joints_rad=(0.7, 0.5))), asked)
    path = write_csv(plan(gantry, load_scene(asked)).trajectory, tmp_path / "trajectory.csv")
    assert load_script("execute").main([str(path), str(asked), "--robot", str(arm)]) == 0
    rail, boom = (line.split() for line in capsys.readouterr().out.splitlines() if line.startswith(("rail ", "boom ")))
    assert rail[2::2][:2] == ["mm", "mm"]
    assert rail[5:7] == ["10.0", "N"]  # twice its mass by its acceleration of 5 m/s^2
    assert boom[2::2][:2] == ["deg", "deg"]
    moved = load_scene(asked).model_copy(update={"start": Start(joints_rad=(0.203, 0.3))})
    assert execute(gantry, moved, read_csv(path)).start_error_rad == pytest.approx((0.003, 0.0))
