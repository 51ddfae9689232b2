"""Motions executed in MuJoCo, also by machines that differ from the controller's model."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from any_arms import GANTRY
from planned import between_twigs, post, straight, task
from script_loader import load_script
from shapes import torus

from hplan.apps.cli.main import main
from hplan.apps.execution import simulation
from hplan.apps.execution.simulated_arm import Plant
from hplan.apps.execution.simulation import HOLD, Execution, Pick, RecordedMotion, execute, read_motion
from hplan.collision.coal_scene import CoalScene
from hplan.errors import InputError
from hplan.planar.family_reader import family_of
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.file import load_scene, save_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Cylinder, Mesh, PointCloud, Sphere
from hplan.trajectory.trajectory import Trajectory, read_csv, write_csv

needs_mujoco = pytest.mark.skipif(
    importlib.util.find_spec("mujoco") is None, reason="MuJoCo is not installed: pip install 'hplan[execution]'"
)

script = load_script("execute")


@pytest.fixture(scope="module")
def planned(robot: Robot, scene: Scene) -> PlanResult:
    return plan(robot, scene)


@pytest.fixture(scope="module")
def csv_file(planned: PlanResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_csv(planned.trajectory, tmp_path_factory.mktemp("motion") / "trajectory.csv")


def between_ends(robot: Robot, scene: Scene, duration: float) -> Trajectory:
    return straight(robot, scene.start.configuration, scene.goal.configuration, duration, 100.0)


def faster(trajectory: Trajectory, factor: float) -> RecordedMotion:
    return RecordedMotion(
        trajectory.joint_names, trajectory.time / factor, trajectory.position, trajectory.velocity * factor
    )


def off_deg(result: Execution) -> float:
    return math.degrees(max(result.max_tracking_error_rad))


# Ours


@needs_mujoco
@pytest.mark.parametrize("yields", [0.0, 0.02])
def test_compliant_obstacle_is_deflected_without_contact(yields: float) -> None:
    """A ball in the path of the hand's tip, 12 mm deep; rigid to the upper arm."""
    robot = load_robot()
    start, goal = (0.0, 0.5, 0.4, 0.2), (0.6, 0.5, 0.4, 0.2)
    middle = np.array([0.3, 0.5, 0.4, 0.2])
    tip, width = robot.tool_positions(middle), float(family_of(robot).arm.half_widths[-1])
    center = (*tip[:2].tolist(), float(tip[2]) + width + 0.03 - 0.012)
    ball = Sphere(name="ball", center=center, radius=0.03, yields=yields)
    given = {"start": Start(joints_rad=start), "goal": Goal(joints_rad=goal), "obstacles": (ball,)}
    scene = Scene(name="ball", **given)
    result = execute(robot, scene, between_ends(robot, scene, 2.0))
    assert result.ok == (yields > 0.0)
    (touch,) = result.pushes if yields else result.contacts
    assert (touch.link, touch.obstacle, touch.is_push) == ("hand", "ball", yields > 0.0)
    assert 0.005 < touch.depth_m < 0.0125 or not yields
    assert off_deg(result) < 0.1 or not yields
    firm = execute(robot, scene.model_copy(update={"yield_links": ("forearm",)}), between_ends(robot, scene, 2.0))
    assert not firm.ok
    assert not firm.pushes


@needs_mujoco
def test_exported_reference_plan(robot: Robot, scene: Scene, planned: PlanResult, csv_file: Path) -> None:
    result = execute(robot, scene, read_motion(csv_file))
    assert result.ok
    assert result.contacts == ()
    assert result.ended_at_goal
    assert off_deg(result) < 0.5
    assert math.degrees(max(result.final_error_rad)) < 0.5
    assert max(result.start_error_rad) == 0.0
    assert result.torque_exceeded == ()
    assert result.saturated_s == 0.0
    assert result.duration_s == planned.trajectory.duration
    assert result.nearest is not None
    assert result.nearest.distance_m > 0.0
    np.testing.assert_allclose(result.needed_torque_nm, np.abs(planned.trajectory.torque).max(axis=0), rtol=1e-2)
    assert result.position.shape == (len(result.time), robot.dof)
    assert result.time[-1] == pytest.approx(result.duration_s + HOLD, abs=2e-3)
    assert not result.position.flags.writeable


@needs_mujoco
def test_tour_takes_fruit_off_the_tree(tmp_path: Path) -> None:
    """A certified tour touches nothing; the same motion without its picks strikes the fruit."""
    scene = load_scene("tour")
    save_scene(scene.with_values(fruits=scene.fruits[:4]), tmp_path / "four.yaml")
    files = [str(tmp_path / "out"), str(tmp_path / "four.yaml")]
    assert main(["tour", files[1], "--out", files[0], "--quiet"]) == 0
    assert main(["execute", *files, "--quiet"]) == 0
    assert main(["execute", str(tmp_path / "out" / "tour.csv"), files[1], "--quiet"]) == 5


@needs_mujoco
def test_picked_fruit_is_an_obstacle_before(robot: Robot) -> None:
    """The hand sweeps through a fruit: a contact only if that happens before it may be touched."""
    start, goal = (0.0, 0.5, 0.4, 0.2), (0.6, 0.5, 0.4, 0.2)
    center = robot.tool_positions(np.array([0.3, 0.5, 0.4, 0.2])).tolist()
    fruit = Fruit(name="apple", center=tuple(center), radius=0.04)
    scene = Scene(name="sweep", start=Start(joints_rad=start), goal=Goal(joints_rad=goal), fruits=(fruit,))
    motion = between_ends(robot, scene, 2.0)
    (touch,) = execute(robot, scene, motion).contacts
    assert execute(robot, scene, motion, picks=[Pick("apple", touch.time_s - 0.1, 1.0)]).contacts == ()
    late = execute(robot, scene, motion, picks=[Pick("apple", touch.time_s + 0.1, 1.0)])
    assert [contact.obstacle for contact in late.contacts] == ["apple"]
    with pytest.raises(InputError, match="no fruit 'pear' to pick"):
        execute(robot, scene, motion, picks=[Pick("pear", 0.5, 1.0)])


# Faults are detected


@needs_mujoco
def test_motion_that_only_grazes(robot: Robot) -> None:
    """The tip grazes a small ball by 2 mm, or misses it by 2 mm."""
    arm = family_of(robot).arm
    tip = robot.tool_positions(np.radians([0.0, 30.0, 0.0, 0.0]))
    outward = (tip - family_of(robot).plane_origin) / np.linalg.norm(tip - family_of(robot).plane_origin)
    for gap, touches in ((-0.002, True), (0.002, False)):
        centre = tip + (arm.half_widths[-1] + 0.02 + gap) * outward
        ball = Sphere(name="small", center=tuple(centre), radius=0.02)
        scene = Scene(
            name="graze", start=Start(joints_deg=(0,) * 4), goal=Goal(joints_deg=(0, 60, 0, 0)), obstacles=(ball,)
        )
        result = execute(robot, scene, between_ends(robot, scene, 2.5))
        assert [(touch.link, touch.obstacle) for touch in result.contacts] == ([("hand", "small")] if touches else [])


@needs_mujoco
def test_too_fast_for_the_motors(robot: Robot, scene: Scene, planned: PlanResult) -> None:
    free = scene.with_obstacles(())
    result = execute(robot, free, faster(planned.trajectory, 5.0))
    assert off_deg(result) > 5.0
    assert "shoulder" in result.torque_exceeded
    assert result.saturated_s > 0.05
    assert result.needed_torque_nm[1] > result.torque_limit_nm[1]
    assert not result.ended_at_goal
    assert result.contacts == ()


@needs_mujoco
@pytest.mark.parametrize(
    "obstacle",
    [
        Sphere(name="it", center=(1.9, 0.0, 0.6), radius=0.1),
        Capsule(name="it", start=(1.9, -0.5, 0.4), end=(1.9, 0.5, 0.7), radius=0.05),
        Capsule(name="it", start=(1.9, 0.0, 0.6), end=(1.9, 0.0, 0.6), radius=0.05),
        Box(name="it", center=(1.9, 0.0, 0.6), size=(0.1, 0.4, 0.02), rpy_deg=(20.0, 40.0, 70.0)),
        Cylinder(name="it", center=(1.9, 0.0, 0.6), length=0.3, radius=0.08, rpy_deg=(20.0, 40.0, 70.0)),
        Mesh.from_arrays("it", *torus(0.2, 0.03, 8), position=(1.9, 0.0, 0.6), rpy_deg=(90.0, 0.0, 20.0)),
        PointCloud.from_points(
            "it", np.random.default_rng(0).uniform(-0.1, 0.1, (40, 3)), 0.02, position=(1.9, 0.0, 0.6)
        ),
    ],
)
def test_contacts_of_mujoco_are_those_of_coal(robot: Robot, obstacle: Any) -> None:
    """One obstacle at one place for both: configurations near its surface."""
    scene = Scene(name="one", start=Start(joints_deg=(0,) * 4), goal=Goal(joints_deg=(0,) * 4), obstacles=(obstacle,))
    checker = CoalScene(robot, scene.solids)
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(400):
        q = rng.uniform([-0.3, 0.0, 0.0, 0.0], [0.3, 0.4, 0.4, 0.4])
        distances = checker.distances(q).min(axis=1)
        if np.abs(distances).min() < 1e-4 or (len(seen) == 2 and rng.random() > 0.1):
            continue
        still = RecordedMotion(robot.joint_names, np.zeros(1), q[None], np.zeros((1, 4)))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(simulation, "HOLD", 0.0)
            result = execute(robot, scene, still)
        touched = {touch.link for touch in result.contacts}
        assert touched == {name for name, d in zip(checker.link_names, distances, strict=True) if d < 0.0}
        seen.add(bool(touched))
    assert seen == {True, False}


# Motions and their files


def test_reference_is_the_hermite_cubic(robot: Robot) -> None:
    rng = np.random.default_rng(2)
    # Any cubic in time is its own Hermite interpolant.
    coefficients = rng.normal(size=(4, 4))
    time = np.array([3.0, 3.1, 3.7, 4.0])

    def cubic(t: np.ndarray, derivative: int) -> np.ndarray:
        return np.stack([np.polyval(np.polyder(row, derivative), t) for row in coefficients], axis=-1)

    reference = simulation._Reference.build(
        robot, RecordedMotion(robot.joint_names, time, cubic(time, 0), cubic(time, 1))
    )
    clock = np.linspace(0.0, 1.0, 77)
    for derivative, values in enumerate(reference.sample(clock)):
        np.testing.assert_allclose(values, cubic(clock + 3.0, derivative), atol=1e-11)
    q, v, a = reference.sample(np.array([1.2]))
    np.testing.assert_array_equal(q[0], cubic(time, 0)[-1])
    assert not v.any()
    assert not a.any()


def test_reading_positions_alone(tmp_path: Path) -> None:
    path = tmp_path / "plain.csv"
    path.write_text("effort, b_pos_rad,time_s, a_pos_rad,a_vel_rad_s\nx,1,5,2,9\nx,2,6,4,9\nx,4,7,8,9\n")
    motion = read_motion(path)
    assert motion.joint_names == ("b", "a")
    assert motion.time.tolist() == [5.0, 6.0, 7.0]
    assert motion.position.tolist() == [[1.0, 2.0], [2.0, 4.0], [4.0, 8.0]]
    assert motion.velocity.tolist() == [[0.0, 0.0], [1.5, 3.0], [0.0, 0.0]]  # only one joint has velocities


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: expected a header"),
        ("time_s,x\n0,1\n", "line 1: expected a header"),
        ("a_pos_rad\n0\n", "line 1: expected a header"),
        ("time_s,a_pos_rad,a_pos_rad\n0,1,1\n", "line 1: column 'a_pos_rad' occurs twice"),
        ("time_s,a_pos_rad\n", "line 1: no rows"),
        ("time_s,a_pos_rad\n0,1\n1\n", "line 3: 1 values, expected 2"),
        ("time_s,a_pos_rad\n0,1\n1,one\n", "line 3: a_pos_rad is 'one'"),
        ("time_s,a_pos_rad\n0,nan\n", "line 2: a_pos_rad is 'nan'"),
        ("time_s,a_pos_rad\n0,1\n0,1\n", "line 3: time_s is 0, not later"),
        ('time_s,a_pos_rad\n0,"1\n', "line 2"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_motion(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


# The command


@needs_mujoco
def test_command(robot: Robot, scene: Scene, csv_file: Path, tmp_path: Path, capsys: Any) -> None:
    assert script.main([str(csv_file)]) == 0
    text = capsys.readouterr().out
    assert "touched nothing, ended at the goal" in text
    assert all(joint in text for joint in robot.joint_names)

    motion = between_ends(robot, scene, 4.0)
    header = ",".join(["time_s", *(f"{name}_pos_rad" for name in robot.joint_names)])
    rows = [",".join(map(repr, row)) for row in np.column_stack([motion.time, motion.position]).tolist()]
    plain = tmp_path / "plain [1].csv"
    plain.write_text("\n".join([header, *rows]))
    assert script.main([str(plain)]) == 5
    text = capsys.readouterr().out
    assert "touched ball, did not end at the goal" in text
    assert "plain [1].csv" in text

    assert script.main([str(tmp_path / "none.csv")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "none.csv" in captured.err
    assert script.main([str(csv_file), str(tmp_path / "none.yaml")]) == 2


#: Bandwidth of a stiff position loop [rad/s].
STIFF = 200.0

MODEL = TrackingModel(math.radians(0.02), 3e-3)


@pytest.fixture(scope="module")
def around_a_post(robot: Robot) -> PlanResult:
    """Past an obstacle, with room for the tracking error."""
    scene = task((0.0, 30.0, 20.0, 20.0), (60.0, 30.0, 20.0, 20.0), [post("post", 30.0, 1.3, 0.0, 2.6, 0.05)])
    return plan(robot, scene, PlanOptions(tracking_error=MODEL.still_rad, tracking_delay_s=MODEL.delay_s))


@needs_mujoco
def test_late_command_is_a_lag_of_as_long(robot: Robot, around_a_post: PlanResult) -> None:
    """Every joint lags by its velocity times the delay, within that model."""
    delay = 5e-3
    late = execute(
        robot,
        around_a_post.motion.problem.scene,
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
    scene, motion = around_a_post.motion.problem.scene, around_a_post.trajectory
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
    """Between two twigs to a fruit: planned with the model, run late with other masses."""
    scene = between_twigs()
    options = PlanOptions(tracking_error=MODEL.still_rad, tracking_delay_s=MODEL.delay_s)
    result = execute(robot, scene, plan(robot, scene, options).trajectory, Plant(factor, 1e-3, STIFF, decoupled=True))
    assert result.is_within(MODEL)
    assert not result.contacts


@needs_mujoco
def test_execute_reports_tracking_error(
    robot: Robot, around_a_post: PlanResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_csv(around_a_post.trajectory, tmp_path / "trajectory.csv")
    command = [str(path), "--mass-factor", "1.2", "--command-delay", "1", "--tracking-delay", "3"]
    for more, said in ((("--tracking-error", "0.02"), "some joint was"), (("--tracking-error", "1"), "no joint was")):
        load_script("execute").main([*command, *more])
        assert said in capsys.readouterr().out
    assert load_script("execute").main([*command, "--mass-factor", "-1"]) == 2


@needs_mujoco
def test_deviation_of_prismatic_joint_is_in_millimetres(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
