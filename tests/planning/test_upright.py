"""Plans that keep the tool upright, and goals with a rotation tolerance, judged by Pinocchio from outside."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from any_arms import loaded_arm

import hplan
from hplan.apps.view.page import certificate_words
from hplan.base.arrays import FloatArray
from hplan.certificate.digests import scene_digest
from hplan.errors import HplanError, InputError, SceneError, TiltedError
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.robot.upright import UprightTool
from hplan.scene import (
    Attached,
    Box,
    Goal,
    Scene,
    Start,
    Track,
    Upright,
    dump_scene,
    load_scene,
    parse_scene,
    save_scene,
)
from hplan.trajectory.trajectory import Trajectory

BEGIN = {"picker": (0.0, 0.3, 1.2, 0.1, -1.5, 0.0), "panda": (0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.8)}
TILT_DEG = 10.0


@pytest.fixture(params=list(BEGIN))
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm(request.param, tmp_path_factory)


def pose_goal(pose: FloatArray, **more: Any) -> Goal:
    quaternion = tuple(pin.Quaternion(pose[:3, :3]).coeffs().tolist())
    return Goal(position=tuple(pose[:3, 3].tolist()), quaternion_xyzw=quaternion, **more)


def scene_over_wall(robot: Robot, **more: Any) -> Scene:
    """The tool moves over a wall."""
    begin = BEGIN["panda" if robot.dof == 7 else "picker"]
    here = robot.forward_kinematics(np.array(begin))
    wall = Box(name="wall", center=here[:3, 3] + (0.0, 0.2, -0.15), size=(0.5, 0.04, 0.4))
    there = here.copy()
    there[:3, 3] += (0.0, 0.4, 0.0)
    more = {"goal": pose_goal(there), "upright": Upright(max_tilt_deg=TILT_DEG)} | more
    return Scene(name="wall", start=Start(joints_rad=begin), obstacles=(wall,), clearance=0.002, **more)


def largest_tilt_deg(robot: Robot, motion: Trajectory, axis: FloatArray) -> float:
    """Largest angle between the vertical and an axis of the tool, every half millisecond [deg]."""
    clock = np.append(np.arange(0.0, motion.duration, 5e-4), motion.duration)
    up = (robot.forward_kinematics(motion.positions(clock))[:, :3, :3] @ axis)[:, 2]
    return float(np.degrees(np.arccos(np.clip(up, -1.0, 1.0)).max()))


@pytest.mark.parametrize(("effort", "seed"), [("quick", 1), ("default", 6)])  # whose free motions all tilt the tool
def test_motion_keeps_the_tool_upright(arm: Robot, effort: Any, seed: int) -> None:
    scene, options = scene_over_wall(arm), PlanOptions(effort=effort, seed=seed)
    free, kept = (hplan.plan(arm, one, options) for one in (scene.with_values(upright=None), scene))
    axis = arm.forward_kinematics(np.array(scene.start.joints_rad))[2, :3]
    assert largest_tilt_deg(arm, free.trajectory, axis) > TILT_DEG
    assert free.certificate.max_tilt_rad is None
    bound = kept.report["certificate"]["upright"]["bound_deg"]
    assert 0.0 < largest_tilt_deg(arm, kept.trajectory, axis) <= bound <= TILT_DEG
    assert hplan.certify(arm, scene, kept.trajectory).verified
    other = hplan.certify(arm, scene, free.trajectory)
    assert not other.verified
    assert any("deg from upright; allowed: 10 deg" in words for words in other.violations)
    assert f"{math.ceil(1e2 * bound) / 1e2:.2f} deg" in certificate_words(kept.certificate)[1]


def test_held_tray_stays_level(arm: Robot) -> None:
    scene = scene_over_wall(arm)
    up = UprightTool.of_scene(arm, scene)
    assert up is not None
    tray = Box(name="tray", center=tuple(0.06 * np.array(up.axis)), size=(0.08, 0.08, 0.01))
    result = hplan.plan(arm, scene.with_values(attached=(Attached(object=tray, mass=0.3),)))
    assert result.certificate.verified
    assert largest_tilt_deg(arm, result.trajectory, np.array(up.axis)) <= TILT_DEG
    assert hplan.certify(arm, result.scene, result.trajectory).max_tilt_rad == result.certificate.max_tilt_rad


def test_tracking_errors_count(arm: Robot) -> None:
    scene, options = scene_over_wall(arm), PlanOptions(tracking_error=0.004, tracking_delay_s=1e-3)
    result = hplan.plan(arm, scene, options)
    axis = arm.forward_kinematics(np.array(scene.start.joints_rad))[2, :3]
    bound = np.degrees(result.certificate.max_tilt_rad)
    assert bound <= TILT_DEG
    assert largest_tilt_deg(arm, result.trajectory, axis) <= bound - arm.dof * np.degrees(0.004)


def test_retimed_motion_has_a_bound_of_its_own(arm: Robot) -> None:
    scene = scene_over_wall(arm)
    result = hplan.plan(arm, scene, PlanOptions(effort="quick"))
    stopped = result.stop_at(0.4 * result.trajectory.duration)
    assert stopped.certificate.verified
    assert stopped.certificate.max_tilt_rad is not None
    assert stopped.certificate.max_tilt_rad <= np.radians(TILT_DEG)


def test_motion_along_given_waypoints_is_kept_upright(arm: Robot) -> None:
    scene = scene_over_wall(arm)
    path = hplan.plan(arm, scene, PlanOptions(effort="quick")).trajectory.position[::20]
    result = hplan.finish(arm, scene, path)
    assert result.certificate.verified
    assert result.certificate.max_tilt_rad is not None


def test_ends_that_are_tilted_are_refused(arm: Robot) -> None:
    scene = scene_over_wall(arm)
    tool = UprightTool.of_scene(arm, scene)
    assert tool is not None
    sideways = tuple(np.cross(tool.axis, (0.6, 0.0, 0.8)).tolist())
    with pytest.raises(TiltedError, match="start does not hold the tool upright") as error:
        hplan.plan(arm, scene.with_values(upright=Upright(max_tilt_deg=TILT_DEG, axis=sideways)))
    assert error.value.tilt_rad > error.value.max_tilt_rad == pytest.approx(np.radians(TILT_DEG))
    pose = arm.forward_kinematics(np.array(scene.start.joints_rad))
    pose[:3, :3] = pin.rpy.rpyToMatrix(np.radians(15.0), 0.0, 0.0) @ pose[:3, :3]
    with pytest.raises(TiltedError, match=r"goal .* tilts by 15 deg"):
        hplan.plan(arm, scene.with_values(goal=pose_goal(pose)))
    tilted = inverse_kinematics(arm, pose, start=scene.start.joints_rad)[0]
    found = hplan.check(arm, scene, np.stack([scene.start.joints_rad, tilted]))
    assert found.limit_faults[0] is None
    assert "upright" in str(found.limit_faults[1])
    assert not found.valid[1]


def test_moving_obstacles_and_a_start_in_motion(arm: Robot) -> None:
    scene = scene_over_wall(arm)
    whole = hplan.plan(arm, scene, PlanOptions(effort="quick"))
    row = whole.trajectory.samples // 3
    state = {
        key: tuple(getattr(whole.trajectory, name)[row].tolist())
        for key, name in (
            ("joints_rad", "position"),
            ("velocity_rad_s", "velocity"),
            ("acceleration_rad_s2", "acceleration"),
        )
    }
    planner = hplan.Planner(arm, scene, PlanOptions(effort="quick"))
    first = planner.scene.upright
    planner.aim(start=Start(**state))
    assert planner.scene.upright == first  # the axis does not follow the start
    result = planner.plan()
    assert result.certificate.verified
    assert result.certificate.max_tilt_rad is not None


def test_planar_arm_keeps_the_pitch_of_its_tool() -> None:
    robot, scene = hplan.load_robot(), load_scene()
    goal = Goal(joints_deg=(20.0, 60.0, 20.0, 15.0))
    start = Start(joints_deg=(0.0, 20.0, 30.0, 40.0))
    free, kept = (
        scene.with_values(start=start, goal=goal, locked_joints=(), obstacles=(), upright=up)
        for up in (None, Upright(max_tilt_deg=8.0))
    )
    assert hplan.plan(robot, free).certificate.verified
    result = hplan.plan(robot, kept)
    pitch = result.trajectory.position[:, 1:].sum(axis=1)
    assert result.certificate.verified
    assert np.abs(np.degrees(pitch - pitch[0])).max() < 8.0
    locked = kept.with_values(goal=Goal(joints_deg=(0.0, 60.0, 20.0, 15.0)), locked_joints=("base_yaw",))
    assert hplan.plan(robot, locked).certificate.verified


def test_base_that_tilts_below_an_upright_tool_is_refused() -> None:
    scene = load_scene().with_values(upright=Upright(max_tilt_deg=8.0))
    still = {"times_s": (0.0, 1.0), "shifts_m": ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), "about": (0.0, 0.0, 0.0)}
    turning = scene.with_values(base_track=Track(**still, rpy_deg=((0.0, 0.0, 0.0), (0.0, 0.0, 90.0))))
    assert turning.upright is not None
    for angles in (((0.0, 0.0, 0.0), (0.0, 6.0, 0.0)), ((5.0, 0.0, 0.0), (5.0, 0.0, 0.0))):
        with pytest.raises(SceneError, match="the base tilts"):
            scene.with_values(base_track=Track(**still, rpy_deg=angles))


def test_axis_is_that_of_the_start_along_given_waypoints() -> None:
    robot, at_rest = hplan.load_robot(), (0.0, 20.0, 40.0, 30.0)
    scene = load_scene().with_values(
        start=Start(joints_deg=at_rest), obstacles=(), locked_joints=(), upright=Upright(max_tilt_deg=8.0)
    )
    for pitch, is_upright in ((0.0, True), (12.0, False)):
        path = np.radians([[0.0, 20.0 + pitch, 40.0, 30.0], [20.0, 20.0 + pitch, 40.0, 30.0]])
        if is_upright:
            assert hplan.finish(robot, scene, path).certificate.verified
            continue
        with pytest.raises(HplanError, match="tilts"):
            hplan.finish(robot, scene, path)


def test_files_and_digests(tmp_path: Path) -> None:
    scene = load_scene()
    kept = scene.with_values(upright=Upright(max_tilt_deg=12.0, axis=(0.0, 1.0, 0.0)))
    assert parse_scene(dump_scene(kept)) == kept
    digests = {scene_digest(one) for one in (scene, kept, scene.with_values(upright=Upright(max_tilt_deg=12.0)))}
    assert len(digests) == 3
    pose = Goal(position=(1.0, 0.0, 1.0), quaternion_xyzw=(0.0, 0.0, 0.0, 1.0))
    near = pose.with_values(rotation_tolerance_deg=(0.0, 0.0, 180.0))
    one, other = (scene.with_values(goal=goal) for goal in (pose, near))
    assert scene_digest(one) != scene_digest(other)
    assert parse_scene(dump_scene(other)) == other


@pytest.mark.parametrize(
    "values", [{"max_tilt_deg": 0.0}, {"max_tilt_deg": 200.0}, {"max_tilt_deg": 5.0, "axis": (0, 0, 0)}]
)
def test_wrong_values_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(SceneError):
        Upright(**values)
    with pytest.raises(SceneError, match="belongs to a pose"):
        Goal(position=(1.0, 0.0, 1.0), rotation_tolerance_deg=(1.0, 1.0, 1.0))
    with pytest.raises(InputError):
        inverse_kinematics(hplan.load_robot(), np.eye(4), rotation_tolerance_rad=(4.0, 0.0, 0.0))


def test_command_line_states_the_tilt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hplan.apps.cli.main import main

    robot, scene = hplan.load_robot(), load_scene()
    ends = {"start": Start(joints_deg=(0.0, 20.0, 30.0, 40.0)), "goal": Goal(joints_deg=(20.0, 60.0, 20.0, 15.0))}
    file = save_scene(scene.with_values(locked_joints=(), **ends), tmp_path / "scene.yaml")
    out = tmp_path / "out"
    assert main(["plan", str(file), "--upright", "8", "--out", str(out), "--effort", "quick"]) == 0
    assert "deg or less from upright, proved for all times; allowed: 8 deg" in capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    assert 0.0 < report["certificate"]["upright"]["bound_deg"] <= 8.0
    assert report["certificate"]["upright"]["axis"] is None
    assert main(["certify", str(out), str(file)]) == 0
    assert "from upright" in capsys.readouterr().out
    assert main(["certify", str(out), str(file), "--upright", "0.5"]) == 5
    assert main(["plan", str(file), "--upright-axis", "0", "0", "1", "--out", str(out)]) == 2
    assert robot.dof == 4


@pytest.mark.parametrize("tolerance", [(0.0, 0.0, 180.0), (25.0, 10.0, 40.0)])
def test_goals_with_a_rotation_tolerance(arm: Robot, tolerance: tuple[float, float, float]) -> None:
    scene = scene_over_wall(arm, upright=None)
    pose = scene.goal.pose
    assert pose is not None
    exact, near = (
        hplan.plan(arm, scene),
        hplan.plan(arm, scene.with_values(goal=pose_goal(pose, rotation_tolerance_deg=tolerance))),
    )
    assert near.trajectory.duration <= exact.trajectory.duration
    there = arm.forward_kinematics(near.trajectory.position[-1])
    vector = np.degrees(pin.log3(pose[:3, :3].T @ there[:3, :3]))
    assert there[:3, 3] == pytest.approx(pose[:3, 3], abs=1e-5)
    assert (np.abs(vector) <= np.add(tolerance, 0.06)).all()
    assert hplan.certify(arm, near.scene, near.trajectory).verified
    refused = hplan.certify(arm, scene, near.trajectory)
    assert any("from the pose of the goal" in words for words in refused.violations) == (np.abs(vector).max() > 0.06)


def test_goal_within_tolerance_and_upright(arm: Robot) -> None:
    """Half of the orientations that the goal allows are tilted too far."""
    scene = scene_over_wall(arm)
    pose = scene.goal.pose
    assert pose is not None
    goal = pose_goal(pose, rotation_tolerance_deg=(20.0, 20.0, 60.0))
    result = hplan.plan(arm, scene.with_values(goal=goal))
    assert result.certificate.verified
    assert result.certificate.max_tilt_rad is not None


def test_error_without_any_upright_motion(arm: Robot) -> None:
    """A goal straight through the wall without any room to tilt."""
    scene = scene_over_wall(arm)
    with pytest.raises(HplanError):
        hplan.plan(
            arm, scene.with_values(upright=Upright(max_tilt_deg=1e-3)), PlanOptions(effort="quick", tracking_error=0.01)
        )


def test_fruit_that_the_tilt_rules_out_is_told_so() -> None:
    """No configuration of the harvester picks this fruit with its tool within 1 deg of how it starts."""
    scene = load_scene("tour")
    fruit = scene.fruits[0].name
    upright = scene.with_values(goal=Goal(fruit=fruit), upright=Upright(max_tilt_deg=1.0))
    with pytest.raises(TiltedError, match=f"fruit '{fruit}' does not hold the tool upright"):
        hplan.plan(hplan.load_robot(), upright)
