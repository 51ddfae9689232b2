"""Messages as a ROS 2 controller reads them: curve, start time, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from controller_model import Controller
from scipy.interpolate import BPoly

import hplan
from hplan.apps.ros import from_joint_trajectory, to_joint_trajectory, write_joint_trajectory, write_mcap
from hplan.certificate.digests import trajectory_digest
from hplan.errors import InputError, OptionError
from hplan.planar.family_reader import family_of
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.trajectory.trajectory import Trajectory, join_trajectories, read_csv, write_csv

A, B = (0.0, 0.9, 0.6, 0.3), (1.2, 0.9, 0.6, 0.3)


@pytest.fixture(scope="module")
def swing(robot: Robot) -> PlanResult:
    """A motion that starts at 100 s on the controller's clock."""
    return planner_of(robot).plan(begins_s=100.0)


def planner_of(robot: Robot) -> hplan.Planner:
    return hplan.Planner(robot, Scene(name="x", start=Start(joints_rad=A), goal=Goal(joints_rad=B)))


def sparse(robot: Robot, apart_s: float, fields: int) -> tuple[dict[str, Any], Trajectory]:
    """Foreign samples: with accelerations, the curve between them bends to one side."""
    points = []
    for k, push in enumerate((-0.75, 0.0, 0.75)):
        rows = np.array([A, np.zeros(4), np.zeros(4)])
        rows[:, 0] = 0.3 * apart_s * k, 0.45 if k == 1 else 0.0, push * robot.acceleration_limit[0]
        sec, nanosec = divmod(round(k * apart_s * 1e9), 10**9)
        keys = ("positions", "velocities", "accelerations")
        given = {key: rows[n].tolist() if n < fields else [] for n, key in enumerate(keys)}
        points.append({**given, "effort": [], "time_from_start": {"sec": sec, "nanosec": nanosec}})
    message = {"joint_names": list(robot.joint_names), "points": points}
    return message, from_joint_trajectory(message, robot=robot)


def test_messages_curve_is_that_of_its_fields(robot: Robot) -> None:
    for fields, curve in ((1, "linear"), (2, "cubic"), (3, "quintic")):
        message, motion = sparse(robot, 0.5, fields)
        assert motion.interpolation == curve
        again = to_joint_trajectory(motion)["points"]
        for point, given in zip(again, message["points"], strict=True):
            assert {key: point[key] for key in given} == given
    assert from_joint_trajectory(message, robot=robot, interpolation="cubic").interpolation == "cubic"
    with pytest.raises(OptionError, match="interpolation"):
        from_joint_trajectory(message, robot=robot, interpolation="septic")  # type: ignore[arg-type]


def test_points_with_different_fields_are_refused(robot: Robot) -> None:
    message, _ = sparse(robot, 0.5, 3)
    message["points"][1]["accelerations"] = []
    with pytest.raises(InputError, match=r"points\[1\].accelerations has 0 numbers"):
        from_joint_trajectory(message, robot=robot)
    for point in message["points"]:
        point["velocities"], point["accelerations"] = [], [0.0] * 4
    with pytest.raises(InputError, match="accelerations but no velocities"):
        from_joint_trajectory(message, robot=robot)


@pytest.mark.parametrize("apart_s", [1.0, 0.5])
def test_curve_that_the_controller_runs_is_judged(robot: Robot, apart_s: float) -> None:
    """The cubic is clear of a ball; the quintic through the same samples is not."""
    _, motion = sparse(robot, apart_s, 3)
    rows = np.stack([motion.position, motion.velocity, motion.acceleration], axis=1)
    true = BPoly.from_derivatives(motion.time, rows)(np.linspace(0.0, motion.duration, 400))
    farthest = true[[int(true[:, 0].argmin())]]
    tool = robot.tool_positions(farthest)[0]
    side = robot.tool_positions(farthest - [[0.02, 0.0, 0.0, 0.0]])[0] - tool
    away = float(family_of(robot).arm.half_widths[-1]) + 0.02 - 0.0008
    ball = Sphere(name="wood", center=tuple(tool + away * side / np.linalg.norm(side)), radius=0.02)
    scene = Scene(name="x", start=Start(joints_rad=A), goal=Goal(joints_rad=motion.position[-1]), obstacles=(ball,))
    assert hplan.check(robot, scene, true).distance_m.min() < 0.0
    assert hplan.certify(robot, scene, motion, interpolation="cubic").verified
    assert not hplan.certify(robot, scene, motion).verified
    assert hplan.certify(robot, scene.model_copy(update={"obstacles": ()}), motion).verified


def test_straight_lines_have_jumps_of_velocity(robot: Robot) -> None:
    _, motion = sparse(robot, 0.5, 1)
    scene = Scene(name="x", start=Start(joints_rad=A), goal=Goal(joints_rad=motion.position[-1]))
    found = hplan.certify(robot, scene, motion)
    assert not found.verified
    assert found.limit_use.acceleration == found.limit_use.torque == np.inf
    assert any("begins with joint" in each for each in found.violations)
    allowed = hplan.certify(robot, scene, motion, velocity_jumps=True)
    assert allowed.verified
    assert allowed.limit_use.velocity == pytest.approx(0.3 / robot.velocity_limit[0])
    fast = replace(motion, time=0.05 * motion.time)
    assert "velocity reaches" in " ".join(hplan.certify(robot, scene, fast, velocity_jumps=True).violations)
    with pytest.raises(OptionError, match="velocity_jumps"):
        hplan.certify(robot, scene, replace(motion, interpolation="cubic"), velocity_jumps=True)
    with pytest.raises(InputError, match="linear between its samples"):
        motion.stop_at(0.3, robot)
    with pytest.raises(InputError, match="they must be the same"):
        join_trajectories([motion, replace(motion.reversal, interpolation="cubic", velocity=0.0 * motion.velocity)])


def test_digests_differ_between_curves(robot: Robot, tmp_path: Path) -> None:
    _, motion = sparse(robot, 0.5, 3)
    others = [trajectory_digest(replace(motion, interpolation=curve)) for curve in ("cubic", "quintic", "linear")]  # type: ignore[arg-type]
    assert len(set(others)) == 3
    again = read_csv(write_csv(motion, tmp_path / "t.csv"), interpolation="quintic")
    assert trajectory_digest(again) == others[1]


def test_controller_runs_certified_curve(robot: Robot, swing: PlanResult) -> None:
    """hplan's own message: no effort, no accelerations, and the cubics of the certificate."""
    message = to_joint_trajectory(swing.trajectory)
    assert all(point["effort"] == [] == point["accelerations"] for point in message["points"])
    machine = Controller(robot.joint_names, np.array(A))
    machine.receive(message, 5 * 10**9)
    clock = np.arange(0.0, swing.trajectory.duration + 0.01, 1.7e-3)
    commands = [machine.update(5 * 10**9 + round(1e9 * at)) for at in clock.tolist()]
    states = [swing.trajectory.state_at(at) for at in clock.tolist()]
    for k, most in ((0, 1e-8), (1, 1e-6)):
        assert max(np.abs(command[k] - state[k]).max() for command, state in zip(commands, states, strict=True)) < most
    with pytest.raises(ValueError, match="efforts"):
        machine.receive(to_joint_trajectory(swing.trajectory, effort=True), 5 * 10**9)


def handed_out(robot: Robot, now: float) -> dict[str, tuple[Trajectory, float]]:
    """Motions that take over from a running one, with the times of their first samples."""
    planner = planner_of(robot)
    running = planner.plan(begins_s=100.0)
    since = now + 0.05 - 100.0
    planner.aim(goal=Goal(joints_rad=(1.0, 0.8, 0.6, 0.3)))
    found = {
        "stop": running.stop_at(since),
        "scaled": running.scale_speed([(0, 1), (since, 1), (since, 0.5)]),
        "planner stop": planner.stop_at(now + 0.05, now=now),
        "splice": planner.replan(at=now + 0.05, now=now),
    }
    return {name: (motion.trajectory, motion.begins_s) for name, motion in found.items()}


def assert_does_not_jump(
    robot: Robot, sent: tuple[Trajectory, float], found: tuple[Trajectory, float], arrival_s: float
) -> None:
    """Check the commands in the cycle in which a message arrives, and in all later ones."""
    cycle_ns, arrival_ns = 2_000_000, round(arrival_s * 1e9)
    controller = Controller(robot.joint_names, sent[0].position[0])
    controller.receive(to_joint_trajectory(sent[0], stamp_s=sent[1]), arrival_ns - cycle_ns)
    controller.update(arrival_ns - cycle_ns)
    position, velocity = controller.update(arrival_ns)
    controller.receive(to_joint_trajectory(found[0], stamp_s=found[1]), arrival_ns)
    now = controller.update(arrival_ns)
    np.testing.assert_allclose(now[0], position, rtol=0, atol=1e-6)
    assert (np.abs(now[1] - velocity) <= robot.acceleration_limit * 1e-9 * cycle_ns).all()
    for at in range(arrival_ns + cycle_ns, round(1e9 * (found[1] + found[0].duration)), cycle_ns):
        last, now = now, controller.update(at)
        off = np.abs(now[0] - last[0] - 0.5e-9 * cycle_ns * (now[1] + last[1]))
        assert (off <= 1e-6 + 1e-18 * cycle_ns**2 * robot.acceleration_limit).all()


@pytest.mark.parametrize("now", [100.0, 100.2, 100.4, 100.6])
def test_motion_that_takes_over_needs_stamp_and_does_not_jump(robot: Robot, now: float, swing: PlanResult) -> None:
    for motion, begins_s in handed_out(robot, now).values():
        for send in (to_joint_trajectory, lambda each: write_joint_trajectory(each, Path("never.yaml"))):
            with pytest.raises(OptionError, match="send the arm back"):
                send(motion)
        assert_does_not_jump(robot, (swing.trajectory, 100.0), (motion, begins_s), now + 0.02)


def test_motion_that_began_at_0_is_sent_from_a_later_row(swing: PlanResult) -> None:
    """ROS takes a stamp of 0 for the time of receipt, also where a simulated clock began at 0."""
    stop = swing.stop_at(0.4).trajectory
    with pytest.raises(OptionError, match=r"began at 0, send trajectory.cut_before\(row\) with"):
        to_joint_trajectory(stop, stamp_s=0.0)
    row = int(np.searchsorted(stop.time, 0.35))
    stamp_s = float(stop.time[row])
    message = to_joint_trajectory(stop.cut_before(row), stamp_s=stamp_s)
    assert message["header"]["stamp"] == {"sec": 0, "nanosec": round(1e9 * stamp_s)}
    here, _, _ = swing.trajectory.state_at(stamp_s)
    np.testing.assert_allclose(message["points"][0]["positions"], here, atol=1e-9)


def test_csv_of_a_stop_begins_where_the_arm_is(robot: Robot, tmp_path: Path) -> None:
    found = handed_out(robot, 100.4)
    for name in ("stop", "scaled", "planner stop"):
        motion = found[name][0]
        with pytest.raises(InputError, match="has no start time"):
            write_csv(motion, tmp_path / "t.csv")
        row = int(np.searchsorted(motion.time, 0.4, side="right")) - 1
        first = read_csv(write_csv(motion.cut_before(row), tmp_path / "t.csv"))
        np.testing.assert_array_equal(first.position[0], motion.position[row])
        assert read_csv(write_csv(motion, tmp_path / "t.csv", whole=True)).samples == motion.samples
    write_csv(found["splice"][0], tmp_path / "t.csv")


def test_recorded_stop_has_a_stamp(robot: Robot, swing: PlanResult, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    write_mcap(swing.stop_at(0.4), tmp_path / "stop.mcap")
    with pytest.raises(OptionError, match="stamp_s"):
        write_mcap(swing.stop_at(0.4), tmp_path / "stop.mcap", stamp_s=0.0)


def test_motion_that_begins_in_motion_needs_a_stamp(swing: PlanResult) -> None:
    later = replace(swing.trajectory.cut_before(50), takes_over_s=None)
    with pytest.raises(OptionError, match="stamp_s"):
        to_joint_trajectory(later)
    assert to_joint_trajectory(later, stamp_s=100.1)["header"]["stamp"]["sec"] == 100


def test_files_fit_the_documented_command(swing: PlanResult, tmp_path: Path) -> None:
    """The command reads the file from its standard input: as an argument Linux takes no more than 128 KiB."""
    path = write_joint_trajectory(swing.trajectory, tmp_path / "motion.yaml")
    assert yaml.safe_load(path.read_text()) == to_joint_trajectory(swing.trajectory)
    told = str(write_joint_trajectory.__doc__)
    assert "--stdin" in told
    assert "$(cat" not in told
