"""Certificates of joints that slide: an error of theirs is in metres, and has no largest value as a turn has."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from any_arms import GANTRY

import hplan
from hplan.apps.cli.main import main
from hplan.apps.execution.recorded_motion import read_motion
from hplan.certificate.certificate import certify
from hplan.certificate.motion_bound import largest_deviations
from hplan.errors import InputError, JointLimitError, RobotFileError
from hplan.robot.model import load_robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track
from hplan.trajectory import read_waypoints
from hplan.trajectory.trajectory import Trajectory

ROBOT = load_robot(GANTRY)
BEGIN, END = np.array([0.2, 0.3]), np.array([0.7, 0.5])


def motion() -> Trajectory:
    u, pace = np.linspace(0.0, 1.0, 20)[:, None], 0.25
    q = BEGIN + (3.0 * u**2 - 2.0 * u**3) * (END - BEGIN)
    v, a = 6.0 * u * (1.0 - u) * pace * (END - BEGIN), (6.0 - 12.0 * u) * pace**2 * (END - BEGIN)
    return Trajectory(ROBOT.joint_names, u[:, 0] / pace, q, v, a, ROBOT.dynamics.torques(q, v, a), ROBOT.slides)


def scene(*obstacles: Sphere) -> Scene:
    ends = Start(joints_rad=tuple(BEGIN.tolist())), Goal(joints_rad=tuple(END.tolist()))
    return Scene(name="rail", start=ends[0], goal=ends[1], obstacles=obstacles)


@pytest.mark.parametrize(("far", "clear"), [(0.05, True), (6.0, True), (8.0, False), (1e3, False), (1e300, False)])
@pytest.mark.parametrize("kind", ["at rest", "of velocity"])
def test_a_trolley_may_be_off_as_far_as_the_tracking_error_says(kind: str, far: float, clear: bool) -> None:
    """Whatever it is: more than 2 pi is a whole turn of a joint that turns alone."""
    ball = Sphere(name="ball", center=(9.0, 0.0, 1.0), radius=0.1)
    # The fastest row is at 0.1875 m/s, and its cubic is bounded by a little more.
    options = {"tracking_error": far} if kind == "at rest" else {"tracking_delay_s": far / 0.19}
    assert certify(ROBOT, scene(ball), motion(), **options).verified == clear


def test_a_turn_that_is_off_by_more_than_a_whole_one_is_where_it_is() -> None:
    largest = largest_deviations(ROBOT, TrackingModel(1e9), np.zeros((1, 2)))
    assert largest[0].tolist() == pytest.approx([1e6, math.tau])
    assert (largest_deviations(ROBOT, TrackingModel(0.1, 2.0), np.full((1, 2), 0.5)) == 1.1).all()


def test_an_arm_at_rest_may_be_off_as_far_too() -> None:
    coming = Track(times_s=(0.0, 60.0), shifts_m=((0.0, 0.0, 0.0), (-5.0, 0.0, 0.0)))
    ball = Sphere(name="ball", center=(15.0, 0.0, 1.0), radius=0.1, track=coming)
    assert certify(ROBOT, scene(ball), motion(), tracking_error=6.0).clear_until_s == math.inf
    found = certify(ROBOT, scene(ball), motion(), tracking_error=10.0)
    assert found.verified
    assert 4.0 < found.clear_until_s < 60.0


def test_a_place_beyond_the_rail_is_told_in_metres() -> None:
    with pytest.raises(JointLimitError, match=r"'rail' is at 2.5 m, outside its limits \[-2, 2\] m"):
        ROBOT.check_configuration([2.5, 0.0], "start")
    with pytest.raises(JointLimitError, match=r"'boom' is at 2.5 rad, outside its limits \[-2, 2\] rad"):
        ROBOT.check_configuration([0.0, 2.5], "start")
    with pytest.raises(JointLimitError, match=r"hold: joint 'rail' is at 2.5 m"):
        load_robot(GANTRY, hold={"rail": 2.5})


def test_degrees_of_what_slides_are_refused() -> None:
    ends = Start(joints_rad=(0.2, 0.3)), Goal(joints_rad=(0.7, 0.5))
    degrees = {"start": Start(joints_deg=(0.2, 17.0))}, {"goal": Goal(joints_deg=(0.7, 28.0))}
    for given in degrees:
        asked = Scene(name="rail", **{"start": ends[0], "goal": ends[1], **given})
        which = next(iter(given))
        for call in (lambda asked=asked: hplan.plan(ROBOT, asked), lambda asked=asked: certify(ROBOT, asked, motion())):
            with pytest.raises(InputError, match=f"{which}: joints_deg, but joint 'rail' slides; give joints_rad"):
                call()


def test_columns_of_what_slides_are_in_metres(tmp_path: Path) -> None:
    found = hplan.plan(ROBOT, scene()).trajectory
    path = hplan.write_csv(found, tmp_path / "motion.csv")
    header = path.read_text().splitlines()[0]
    rail, boom = "rail_pos_m,rail_vel_m_s,rail_acc_m_s2,rail_force_n", "boom_pos_rad,boom_vel_rad_s,boom_acc_rad_s2"
    assert header == f"time_s,{rail},{boom},boom_torque_nm"
    again = hplan.read_csv(path)
    assert again.slides == found.slides == again.until(3).since(1).reversed.slides == (True, False)
    assert certify(ROBOT, scene(), again).digests == certify(ROBOT, scene(), found).digests
    np.testing.assert_array_equal(read_motion(path).position, found.position)
    np.testing.assert_array_equal(read_waypoints(path, ROBOT.joint_names, ROBOT.slides), found.position)


def test_radians_of_what_slides_are_refused(tmp_path: Path) -> None:
    path = hplan.write_csv(hplan.plan(ROBOT, scene()).trajectory, tmp_path / "motion.csv")
    as_before = tmp_path / "before.csv"
    as_before.write_text(
        path.read_text().replace("rail_pos_m,rail_vel_m_s,rail_acc_m_s2,rail_force_n",
                                 "rail_pos_rad,rail_vel_rad_s,rail_acc_rad_s2,rail_torque_nm")
    )  # fmt: skip
    with pytest.raises(InputError, match="'rail' slides, but the motion has it in radians; its columns are rail_pos_m"):
        certify(ROBOT, scene(), hplan.read_csv(as_before))
    with pytest.raises(InputError, match="joint 'rail' has no column; expected rail_pos_m or rail"):
        read_waypoints(as_before, ROBOT.joint_names, ROBOT.slides)


def test_limits_of_what_slides_are_in_metres(tmp_path: Path) -> None:
    path = tmp_path / "a.limits.yaml"
    for text, names in (
        ("acceleration_rad_s2: {boom: 4}\nacceleration_m_s2: {rail: 3}", None),
        ("acceleration_rad_s2: {rail: 3, boom: 4}", None),
        (
            "acceleration_rad_s2: {rail: 3, boom: 4}\nacceleration_m_s2: {rail: 3}",
            "'rail' is in acceleration_rad_s2 too",
        ),
        ("acceleration_rad_s2: {boom: 4}", r"joints missing \['rail'\]"),
        ("acceleration_m_s2: {rail: 3, boom: 4}", "acceleration_m_s2: joint 'boom' turns; .* acceleration_rad_s2"),
        ("jerk_m_s3: {rail: 3}", "acceleration_rad_s2 is missing"),
    ):
        path.write_text(f"format: hplan-limits/1\n{text}\n")
        if names is None:
            assert load_robot(GANTRY, limits=path).acceleration_limit.tolist() == [3.0, 4.0]
        else:
            with pytest.raises(RobotFileError, match=names):
                load_robot(GANTRY, limits=path)


def test_a_trajectory_that_does_not_say_what_is_in_metres_is_refused() -> None:
    with pytest.raises(InputError, match="'rail' slides: give Trajectory"):
        certify(ROBOT, scene(), replace(motion(), slides=()))


def test_a_trajectory_made_by_hand_is_written_in_the_robots_units(tmp_path: Path) -> None:
    by_hand = replace(motion(), slides=())
    path = hplan.write_csv(by_hand, tmp_path / "motion.csv", ROBOT)
    assert path.read_text().startswith("time_s,rail_pos_m,")
    assert by_hand.stop_at(1.0, ROBOT).slides == (True, False)
    with pytest.raises(InputError, match="'rail' slides, but the motion has it in radians"):
        hplan.write_csv(replace(motion(), slides=(False, False)), path, ROBOT)


def test_degrees_alone_are_no_tracking_error_of_what_slides(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    urdf, ends = tmp_path / "gantry.urdf", tmp_path / "scene.yaml"
    urdf.write_text(GANTRY)
    hplan.save_scene(scene(Sphere(name="ball", center=(9.0, 0.0, 1.0), radius=0.1)), ends)
    path = hplan.write_csv(motion(), tmp_path / "motion.csv", ROBOT)
    given = ["certify", str(path), str(ends), "--robot", str(urdf)]
    for options, says in (
        (["--tracking-error", "0.5"], "--tracking-error-m = None: expected a length in metres: joint 'rail' slides"),
        (["--tracking-error-m", "0.01"], "--tracking-error = None: expected an angle in degrees: joint 'boom' turns"),
    ):
        assert main([*given, *options]) == 2
        assert says in " ".join(capsys.readouterr().err.split())
    assert main([*given, "--tracking-error", "0.5", "--tracking-error-m", "0.01"]) == 0
    assert "tracking error 0.573 deg, 10 mm where a joint slides" in " ".join(capsys.readouterr().out.split())
