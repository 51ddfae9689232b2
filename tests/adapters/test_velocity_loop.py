"""Loops of joint velocities with a certified stop at hand."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from planned import assert_clear, post, task

from hplan.adapters.velocity_loop import VelocityLoop
from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import certify
from hplan.errors import ConfigurationInCollisionError, InputError, MovingObstacleError, OptionError
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene
from hplan.trajectory.trajectory import Trajectory

START = (-40.0, 10.0, 60.0, 30.0)
PERIOD_S = 0.02


@pytest.fixture
def scene() -> Scene:
    return task(START, START, [post("post", 0.0, 1.1, 0.0, 2.5)])


def a_loop(robot: Robot, scene: Scene, **options: Any) -> VelocityLoop:
    return VelocityLoop(robot, scene, np.radians(START), period_s=PERIOD_S, **options)


def commands(loop: VelocityLoop, wanted: Iterator[FloatArray]) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """States of the commands, the first included."""
    yield loop.position, loop.velocity, loop.acceleration
    for velocity in wanted:
        loop.step(velocity)
        yield loop.position, loop.velocity, loop.acceleration


def run(robot: Robot, loop: VelocityLoop, wanted: Iterator[FloatArray]) -> Trajectory:
    """The motion of the commands, on cubics."""
    position, velocity, acceleration = (np.array(rows) for rows in zip(*commands(loop, wanted), strict=True))
    time = PERIOD_S * np.arange(len(position), dtype=np.float64)
    return Trajectory(robot.joint_names, time, position, velocity, acceleration, np.zeros_like(position))


def test_wanted_velocity_is_reached_and_kept(robot: Robot, scene: Scene) -> None:
    loop = a_loop(robot, scene)
    motion = run(robot, loop, (np.array([-0.2, 0.1, 0.0, 0.0]) for _ in range(30)))
    np.testing.assert_allclose(motion.velocity[-5:], np.tile([-0.2, 0.1, 0.0, 0.0], (5, 1)), atol=1e-9)
    assert not loop.is_stopping


def test_arm_stops_before_the_post(robot: Robot, scene: Scene) -> None:
    loop = a_loop(robot, scene)
    motion = run(robot, loop, (np.array([1.5, 0.0, 0.0, 0.0]) for _ in range(200)))
    assert np.abs(motion.velocity).max() > 0.3
    assert loop.is_stopping
    assert any("post" in words for words in loop.certificate.violations)
    assert_clear(robot, scene, motion.position)
    assert not loop.velocity.any()
    away = run(robot, loop, (np.array([-0.5, 0.0, 0.0, 0.0]) for _ in range(20)))
    assert not loop.is_stopping
    assert away.position[-1, 0] < motion.position[-1, 0] - 0.05


@pytest.mark.parametrize("seed", range(3))
def test_random_velocities_keep_clearance_and_limits(robot: Robot, scene: Scene, seed: int) -> None:
    """Whatever is wanted: the commands, and at any time the stop, keep clearance and limits."""
    random, loop = np.random.default_rng(seed), a_loop(robot, scene)
    wanted = np.repeat(random.normal(0.0, 1.0, (12, 4)), 12, axis=0)
    whole = run(robot, loop, iter(wanted))
    stop = loop.stop
    time = np.append(whole.time, whole.time[-1] + stop.time[1:])
    keys = "position", "velocity", "acceleration"
    rows = [np.vstack([getattr(whole, key), getattr(stop, key)[1:]]) for key in keys]
    motion = Trajectory(robot.joint_names, time, *rows, robot.dynamics.torques(*rows))
    there = scene.with_values(goal=Goal(joints_rad=tuple(motion.position[-1].tolist())))
    certificate = certify(robot, there, motion)
    assert certificate.verified, certificate.violations


def test_tracking_error_is_covered(robot: Robot, scene: Scene) -> None:
    exact, covered = a_loop(robot, scene), a_loop(robot, scene, options=PlanOptions(tracking_error=0.05))
    for loop in (exact, covered):
        run(robot, loop, (np.array([1.0, 0.0, 0.0, 0.0]) for _ in range(150)))
    assert covered.position[0] < exact.position[0] - 0.02


def test_wrong_input_is_refused(robot: Robot, scene: Scene) -> None:
    with pytest.raises(OptionError, match="period_s"):
        VelocityLoop(robot, scene, np.radians(START), period_s=0.0)
    with pytest.raises(ConfigurationInCollisionError):
        VelocityLoop(robot, scene, np.radians([0.0, *START[1:]]), period_s=PERIOD_S)
    with pytest.raises(InputError, match="desired"):
        a_loop(robot, scene).step([0.0, 0.0])
    track = {"times_s": [0.0, 1.0], "shifts_m": [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]}
    moving = scene.obstacles[0].with_values(track=track)
    with pytest.raises(MovingObstacleError):
        a_loop(robot, scene.with_values(obstacles=(moving,)))


def test_velocities_of_pink_are_followed(robot: Robot, scene: Scene) -> None:
    pink: Any = pytest.importorskip("pink", reason="pink is not installed: pip install pin-pink daqp")
    loop = a_loop(robot, scene)
    configuration = pink.Configuration(robot.model, robot.model.createData(), np.array(loop.position))
    tool = pink.tasks.FrameTask(robot.tool_frame, position_cost=1.0, orientation_cost=0.0, gain=0.03)
    target = robot.forward_kinematics(np.radians([-70.0, 20.0, 70.0, 30.0]))
    tool.set_target(pin.SE3(target))
    for _ in range(300):
        loop.step(pink.solve_ik(configuration, [tool], loop.period_s, solver="daqp", safety_break=False))
        configuration.update(np.array(loop.position))
    np.testing.assert_allclose(robot.tool_positions(loop.position[None])[0], target[:3, 3], atol=5e-3)
