"""Blended approaches, and motions that begin in motion."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from planned import assert_clear, assert_within_limits, between_rows, fruit, post, task

from hplan.certificate.certificate import certify
from hplan.certificate.digests import scene_digest
from hplan.errors import HplanError, InputError, OptionError, SceneError, StartStateError, UnavoidableContactError
from hplan.planning import plans as planning
from hplan.planning.approach import LEADS, Approach, blend
from hplan.planning.motion import seconds
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import dump_scene, load_scene, parse_scene
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.tour.tour import plan_tour
from hplan.trajectory.trajectory import Trajectory, read_csv, write_csv

SCENES = ("trellis", "dense-canopy")


class Told:
    """The arguments and the result of the last call of `blended`."""

    asked: tuple[Any, Any]
    approach: Approach
    stopping: float
    blended: Any


@pytest.fixture(scope="module")
def plans(robot: Robot) -> dict[str, tuple[Scene, PlanResult, Told]]:
    """Plans of scenes, with the same plans with a stop."""
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        for name in SCENES:
            told = Told()

            def keep(task: Any, transit: Any, before: Any, after: Approach, told: Told = told) -> Any:
                told.asked, told.approach = (task, transit), after
                told.stopping = transit.trajectory.duration + 2.0 * after.from_rest.trajectory.duration
                told.blended = blend(task, transit, before, after)
                return told.blended

            patch.setattr(planning, "blend", keep)
            scene = load_scene(name)
            found[name] = scene, plan(robot, scene), told
    return found


def seam_of(result: PlanResult) -> int:
    """The sample where the approach begins."""
    approach = next(phase for phase in result.phases if phase.name == "approach")
    return int(np.argmin(np.abs(result.trajectory.time - approach.start_s)))


def offset_of(robot: Robot, result: PlanResult, motion: Trajectory) -> float:
    """Maximum offset of the tool from its straight line.

    From the stand-off to the grasp and back, between samples too.
    """
    assert result.grasp is not None
    tip, off = robot.tool_positions(result.grasp.goal), robot.tool_positions(result.grasp.standoff)
    line = (off - tip) / np.linalg.norm(off - tip)
    begin = motion.time[seam_of(result)]
    tool = robot.tool_positions(motion.positions(np.linspace(begin, motion.duration, 2001))) - tip
    along = tool @ line
    assert along[0] >= result.grasp.distance - 1e-6
    return float(np.linalg.norm(tool - along[:, None] * line, axis=1).max())


@pytest.mark.parametrize("name", SCENES)
def test_approach_begins_in_motion_and_is_straight_and_smooth(robot: Robot, plans: Any, name: str) -> None:
    _, result, told = plans[name]
    assert told.blended is not None
    assert [phase.name for phase in result.phases] == ["transit", "approach", "retreat"]
    assert np.abs(result.trajectory.velocity[seam_of(result)]).max() > 0.05
    assert offset_of(robot, result, result.trajectory) < 1e-4
    assert result.trajectory.duration < told.stopping - 1e-3
    # The seam is as smooth as the rest.
    motion, seam = result.trajectory, seam_of(result)
    transit, approach = (motion.trajectory for motion in told.blended[1:])
    for quantity in ("position", "velocity", "acceleration", "torque"):
        end, begin = getattr(transit, quantity)[-1], getattr(approach, quantity)[0]
        np.testing.assert_allclose(end, begin, rtol=0, atol=1e-9)
    near = slice(seam - 10, seam + 10)
    step = np.diff(motion.time)[0]
    jerk = np.diff(motion.acceleration[near], axis=0) / step
    assert (np.abs(jerk) <= robot.jerk_limit * 1.0005).all()
    # The samples' velocities and accelerations are the derivatives of their positions.
    mean = 0.5 * (motion.velocity[1:] + motion.velocity[:-1])[near]
    slip = np.diff(motion.position, axis=0)[near] / step - mean
    assert (np.abs(slip) <= robot.jerk_limit * step**2 / 12.0 + 1e-6).all()
    use = result.certificate.limit_use
    assert max(use.velocity, use.acceleration, use.torque) <= 1.0005


@pytest.mark.parametrize("name", SCENES)
def test_certify_accepts_samples_of_plan(robot: Robot, plans: Any, name: str, tmp_path: Path) -> None:
    scene, result, _ = plans[name]
    read = read_csv(write_csv(result.trajectory, tmp_path / "motion.csv"))
    certificate = certify(robot, scene, read)
    assert certificate.verified, certificate.violations
    assert certificate.contact_s is not None
    assert certificate.contact_s[0] <= result.phases[1].start_s


@pytest.mark.parametrize(("changes", "stops"), [({"effort": "quick"}, True), ({"tracking_delay_s": 1e-3}, False)])
def test_quick_motions_stop_those_that_make_room_for_a_delay_need_not(
    robot: Robot, changes: dict[str, Any], stops: bool
) -> None:
    result = plan(robot, load_scene("trellis"), replace(PlanOptions(), **changes))
    assert result.certificate.verified
    assert stops == (not result.trajectory.velocity[seam_of(result)].any())


def test_where_the_stop_is_as_quick_the_arm_stops(plans: Any) -> None:
    _, _, told = plans["dense-canopy"]
    assert told.blended is not None
    flown = seconds(told.blended[1:])
    task, transit = told.asked
    for sooner_s, is_blended in ((0.004, True), (0.0, False)):
        # As if the approach from rest were as quick as this.
        rest = told.approach.from_rest
        left = flown - transit.trajectory.duration + sooner_s
        time = rest.trajectory.time * (left / rest.trajectory.duration)
        approach = replace(told.approach)
        vars(approach)["from_rest"] = replace(rest, trajectory=replace(rest.trajectory, time=time))
        found = blend(task, transit, None, approach)
        assert (found is not None) is is_blended


def test_at_few_rows_a_second_approaches_in_motion_are_straight_too(robot: Robot, plans: Any) -> None:
    _, _, told = plans["dense-canopy"]
    pick = told.approach
    slow = replace(pick, problem=replace(pick.problem, options=PlanOptions(rate_hz=25.0)))
    found = [slow.non_stop(lead) for lead in LEADS]
    assert any(part is None for part in found)  # off their line by more, between samples
    for part in found:
        assert part is None or straightness(robot, pick, part) <= 1e-4


def straightness(robot: Robot, pick: Approach, motion: Trajectory) -> float:
    tip = robot.tool_positions(pick.grasp.goal)
    line = robot.tool_positions(pick.grasp.standoff) - tip
    line /= np.linalg.norm(line)
    tool = robot.tool_positions(motion.positions(np.linspace(0.0, motion.duration, 2001))) - tip
    return float(np.linalg.norm(tool - (tool @ line)[:, None] * line, axis=1).max())


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
    """The scene of the running motion at a sample of it."""
    return running().motion.problem.scene.model_copy(update={"start": start_of(running().trajectory, row), **changes})


def assert_goes_on(scene: Scene, result: PlanResult) -> None:
    """Check that the motion continues the start's state, within limits, to rest, certified."""
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


def test_start_in_motion_at_its_goal(robot):
    """Out and back."""
    scene = begun(80, goal=Goal(joints_rad=tuple(running().trajectory.position[80].tolist())))
    result = plan(robot, scene)
    assert_goes_on(scene, result)
    assert result.trajectory.duration > 0.1


def test_slower_than_the_start(robot):
    """At a fraction of full speed below the current speed."""
    row = int(np.abs(running().trajectory.velocity).max(axis=1).argmax())
    scene = begun(row)
    assert_goes_on(scene, plan(robot, scene, PlanOptions(speed=0.3)))


def test_state_that_cannot_be_left(robot):
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


def test_invalid_starts_are_refused(robot):
    scene = running().motion.problem.scene
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


def test_start_in_motion_in_a_scene_file():
    scene = begun(60)
    again = parse_scene(dump_scene(scene))
    assert again.start == scene.start
    assert scene_digest(again) == scene_digest(scene)
    resting = scene.model_copy(update={"start": Start(joints_rad=scene.start.joints_rad)})
    assert scene_digest(resting) != scene_digest(scene)
    still = Start(joints_rad=scene.start.joints_rad, velocity_rad_s=(0.0,) * 4)
    assert not still.is_moving
    assert scene_digest(scene.model_copy(update={"start": still})) == scene_digest(resting)


def test_certificate_checks_start(robot):
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
