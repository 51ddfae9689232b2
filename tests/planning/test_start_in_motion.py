"""Motions that begin in motion: the state they leave, limits, certificate, and what is refused."""

from __future__ import annotations

import pickle
from functools import cache

import numpy as np
import pytest
from planned import assert_clear, assert_within_limits, between_rows, fruit, post, task

from hplan.certificate.certificate import certify
from hplan.certificate.digests import scene_digest
from hplan.errors import HplanError, InputError, OptionError, SceneError, StartStateError, UnavoidableContactError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import load_robot
from hplan.scene.file import dump_scene, parse_scene
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.tour.tour import plan_tour
from hplan.trajectory.trajectory import Trajectory

POST = post("post", 0.0, 1.1, 0.0, 1.5)


@cache
def running() -> PlanResult:
    """A motion about a post."""
    return plan(load_robot(), task((-40.0, 45.0, 40.0, 30.0), (40.0, 45.0, 40.0, 30.0), [POST]))


def start_of(trajectory: Trajectory, row: int) -> Start:
    return Start(
        joints_rad=tuple(trajectory.position[row].tolist()),
        velocity_rad_s=tuple(trajectory.velocity[row].tolist()),
        acceleration_rad_s2=tuple(trajectory.acceleration[row].tolist()),
    )


def begun(row: int, **changes: object) -> Scene:
    """The scene of the running motion, which is at a row of it."""
    return running().motion.task.scene.model_copy(update={"start": start_of(running().trajectory, row), **changes})


def assert_goes_on(scene: Scene, result: PlanResult) -> None:
    """It leaves the start's state as it is, keeps limits and distances, comes to rest, and is certified as a whole."""
    robot, trajectory = load_robot(), result.trajectory
    start = scene.start
    np.testing.assert_allclose(trajectory.position[0], start.configuration, rtol=0, atol=1e-12)
    np.testing.assert_allclose(trajectory.velocity[0], start.velocity_rad_s, rtol=0, atol=1e-12)
    np.testing.assert_allclose(trajectory.acceleration[0], start.acceleration_rad_s2, rtol=0, atol=1e-12)
    assert not trajectory.velocity[-1].any()
    assert_within_limits(robot, trajectory)
    touched = scene.goal.fruit
    assert_clear(robot, scene, between_rows(trajectory, np.arange(trajectory.samples), 1), touched=touched)
    assert result.certificate.verified
    assert certify(robot, scene, trajectory).verified
    assert [result.phases[0].start_s, result.phases[-1].end_s] == [0.0, trajectory.duration]


@pytest.mark.parametrize(
    ("effort", "part"), [("default", 0.2), ("default", 0.5), ("default", 0.9), ("quick", 0.5), ("best", 0.2)]
)
def test_to_the_same_goal(robot, effort, part):
    row = int(part * running().trajectory.samples)
    scene = begun(row)
    result = plan(robot, scene, PlanOptions(effort=effort))
    assert_goes_on(scene, result)
    left = running().trajectory.duration - running().trajectory.time[row]
    assert result.trajectory.duration <= (1.1 if effort != "quick" else 4.0) * left + 0.2


@pytest.mark.parametrize("part", [0.2, 0.6])
def test_to_another_goal_and_back(robot, part):
    """Against the direction of the motion."""
    row = int(part * running().trajectory.samples)
    scene = begun(row, goal=Goal(joints_deg=(-30.0, 60.0, 40.0, 30.0)))
    assert_goes_on(scene, plan(robot, scene))


def test_with_tracking_errors_that_grow_with_speed(robot):
    """The arm stops first: motions are not optimised with their timing then."""
    options = PlanOptions(tracking_error=1e-4, tracking_delay_s=1e-3)
    scene = begun(60)
    result = plan(robot, scene, options)
    assert_goes_on(scene, result)


def test_to_a_fruit(robot):
    apple = fruit("apple", 20.0, 1.5, 1.4)
    scene = begun(60, goal=Goal(fruit="apple"), fruits=(apple,))
    result = plan(robot, scene)
    assert_goes_on(scene, result)
    assert [phase.name for phase in result.phases] == ["transit", "approach", "retreat"]


def test_a_start_in_motion_at_its_goal(robot):
    """Out and back."""
    scene = begun(80, goal=Goal(joints_rad=tuple(running().trajectory.position[80].tolist())))
    result = plan(robot, scene)
    assert_goes_on(scene, result)
    assert result.trajectory.duration > 0.1


def test_slower_than_the_start(robot):
    """A fraction of full speed at which the arm moves already."""
    row = int(np.abs(running().trajectory.velocity).max(axis=1).argmax())
    scene = begun(row)
    assert_goes_on(scene, plan(robot, scene, PlanOptions(speed=0.3)))


def test_a_state_that_cannot_be_left(robot):
    """A ball a few millimetres ahead of the tool."""
    trajectory = running().trajectory
    row = int(np.abs(trajectory.velocity[:, 0]).argmax())
    tools = robot.tool_positions(trajectory.position[[row, row + 1]])
    ahead = (tools[1] - tools[0]) / np.linalg.norm(tools[1] - tools[0])
    ball = Sphere(name="ball", center=tuple((tools[0] + 0.15 * ahead).tolist()), radius=0.1)
    scene = begun(row, obstacles=(POST, ball))
    with pytest.raises(UnavoidableContactError) as caught:
        plan(robot, scene)
    error = caught.value
    assert any("ball" in reason for reason in error.reasons)
    assert error.clearance_m <= 0.0
    np.testing.assert_array_equal(error.stop.velocity[0], scene.start.velocity_rad_s)
    assert not error.stop.velocity[-1].any()
    assert error.exit_status == 5
    assert pickle.loads(pickle.dumps(error)).tried == error.tried
    assert "stop" not in error.as_dict()


def test_what_cannot_be_the_start(robot):
    scene = running().motion.task.scene
    fast = (9.0, 0.0, 0.0, 0.0)
    joints = tuple(running().trajectory.position[0].tolist())
    for key, quantity in (("velocity_rad_s", "velocity"), ("acceleration_rad_s2", "acceleration")):
        moving = scene.model_copy(update={"start": Start(joints_rad=joints, **{key: fast})})
        with pytest.raises(StartStateError, match=rf"joint 'base_yaw' has the {quantity} 9 .* its limit is") as caught:
            plan(robot, moving)
        assert (caught.value.joint, caught.value.quantity, caught.value.value) == ("base_yaw", quantity, 9.0)
    locked = scene.model_copy(
        update={
            "start": Start(joints_rad=joints, velocity_rad_s=(0.1, 0.0, 0.0, 0.0)),
            "goal": Goal(joints_rad=joints),
            "locked_joints": ("base_yaw",),
        }
    )
    with pytest.raises(StartStateError, match="it is locked"):
        plan(robot, locked)
    with pytest.raises(OptionError, match="bound"):
        plan(robot, begun(60), PlanOptions(bound=True))
    short = scene.model_copy(update={"start": Start(joints_rad=joints[:3], velocity_rad_s=(0.1, 0.0, 0.0))})
    with pytest.raises(InputError):
        plan(robot, short)


def test_a_start_in_motion_in_a_scene_file():
    scene = begun(60)
    again = parse_scene(dump_scene(scene))
    assert again.start == scene.start
    assert scene_digest(again) == scene_digest(scene)
    resting = scene.model_copy(update={"start": Start(joints_rad=scene.start.joints_rad)})
    assert scene_digest(resting) != scene_digest(scene)
    still = Start(joints_rad=scene.start.joints_rad, velocity_rad_s=(0.0,) * 4)
    assert not still.is_moving
    assert scene_digest(scene.model_copy(update={"start": still})) == scene_digest(resting)


def test_the_certificate_looks_at_the_start(robot):
    """A motion from rest does not solve the task of a start in motion, nor one from another state."""
    scene = begun(60)
    rested = plan(robot, scene.model_copy(update={"start": Start(joints_rad=scene.start.joints_rad)}))
    found = certify(robot, scene, rested.trajectory)
    assert not found.verified
    assert any("velocity of joint" in violation for violation in found.violations)
    result = plan(robot, scene)
    moved = Start(
        joints_rad=scene.start.joints_rad, velocity_rad_s=scene.start.velocity_rad_s, acceleration_rad_s2=(0.0,) * 4
    )
    other = certify(robot, scene.model_copy(update={"start": moved}), result.trajectory)
    assert [violation for violation in other.violations if "acceleration of joint" in violation]
    at_rest = certify(robot, scene.model_copy(update={"start": Start(joints_rad=moved.joints_rad)}), result.trajectory)
    assert any("begins with joint" in violation for violation in at_rest.violations)


def test_contact_at_the_start_is_bad_input(robot):
    tool = robot.tool_positions(running().trajectory.position[[60]])[0]
    scene = begun(60, obstacles=(Sphere(name="ball", center=tuple(tool.tolist()), radius=0.1),))
    with pytest.raises(HplanError) as caught:
        plan(robot, scene)
    assert caught.value.exit_status == 2


def test_tours_begin_at_rest(robot):
    scene = begun(60, fruits=(fruit("apple", 20.0, 1.5, 1.4),))
    with pytest.raises(SceneError, match="tours begin at rest"):
        plan_tour(robot, scene)
