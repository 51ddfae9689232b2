"""Plans of general (non-planar) arms, from joints to joints, among obstacles that move too."""

from __future__ import annotations

import re

import coal
import numpy as np
import pytest
from any_arms import LIFT, loaded_arm
from fitted_arms import Bodies

from hplan.certificate.certificate import certify
from hplan.errors import ConfigurationInCollisionError, InputError, NotFoundError, OptionError, RobotFileError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.limits import Limits
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Obstacle, Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.retime import time_path
from hplan.trajectory.spline import SplinePath

QUICK = PlanOptions(effort="quick")
START, GOAL = (0.3, 0.8, 0.6, -0.4, 0.5, 0.2), (1.5, 0.9, 0.5, -0.2, -0.4, 0.6)
POST = Box(name="post", center=(0.35, 0.55, 0.6), size=(0.06, 0.06, 1.2))


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm("toy", tmp_path_factory)


def scene_of(*obstacles: Obstacle, locked: tuple[str, ...] = ()) -> Scene:
    keys = {"start": {"joints_rad": START}, "goal": {"joints_rad": GOAL}, "locked_joints": locked}
    return Scene.model_validate({"format": "hplan-scene/1", "name": "toy", "obstacles": obstacles, **keys})


def test_motion_is_straight_without_blocking_obstacle(arm: Robot) -> None:
    found = plan(arm, scene_of(), QUICK)
    assert found.motion.origin == "direct"
    assert found.certificate.verified
    assert found.trajectory.position[[0, -1]] == pytest.approx(np.array([START, GOAL]), abs=1e-9)


@pytest.mark.parametrize("options", [QUICK, PlanOptions(effort="quick", tracking_error=0.005)])
def test_around_a_post_and_certified_from_outside(arm: Robot, options: PlanOptions) -> None:
    scene = scene_of(POST)
    found = plan(arm, scene, options)
    assert found.motion.origin != "direct"
    assert found.certificate.verified
    again = certify(arm, scene, found.trajectory, tracking_error=options.tracking_error)
    assert again.verified
    assert plan(arm, scene, options).trajectory.position == pytest.approx(found.trajectory.position, abs=0.0)


def test_goal_behind_wall_is_refused_after_budget(arm: Robot) -> None:
    wall = Box(name="wall", center=(0.0, 0.6, 0.5), size=(0.04, 0.7, 1.5))
    scene = scene_of(wall, locked=arm.joint_names[1:])
    with pytest.raises(NotFoundError) as refused:
        plan(arm, scene.model_copy(update={"goal": Goal(joints_rad=(2.4, *START[1:]))}), QUICK)
    (evaluations,) = (int(number) for number in re.findall(r"\d+", " ".join(refused.value.tried)))
    assert 10_000 < evaluations < 100_000


def test_locked_joints_stay(arm: Robot) -> None:
    goal = (*GOAL[:5], START[5])
    scene = scene_of(POST, locked=("wrist_3",)).model_copy(update={"goal": scene_of().goal})
    scene = Scene.model_validate({**{k: getattr(scene, k) for k in Scene.model_fields}, "goal": {"joints_rad": goal}})
    found = plan(arm, scene, QUICK)
    assert found.certificate.verified
    assert np.ptp(found.trajectory.position[:, 5]) == 0.0


def test_start_in_an_obstacle_is_refused(arm: Robot) -> None:
    with pytest.raises(ConfigurationInCollisionError):
        plan(arm, scene_of(Sphere(name="ball", center=(0.0, 0.1, 0.3), radius=0.1)), QUICK)


def test_dense_search_is_refused_without_grid(arm: Robot) -> None:
    with pytest.raises(OptionError, match="method = 'dense': expected 'two-level' for 'six_axes', which has no grid"):
        plan(arm, scene_of(), PlanOptions(method="dense"))


def test_table_that_penetrates_the_foot_is_refused(arm: Robot) -> None:
    """A common first scene: the error names obstacle, link and depth."""
    table = Box(name="table", center=(0.0, 0.0, -0.1), size=(1.0, 1.0, 0.1))
    with pytest.raises(
        InputError, match=r"'table' is .* deep in the robot's 'base_link', which does not move: move the"
    ):
        plan(arm, scene_of(table), QUICK)


def test_robot_without_shapes_is_neither_planned_for_nor_certified() -> None:
    """Else every motion of it would be certified, for it touches nothing."""
    bare = load_robot(re.sub(r"<collision>.*?</collision>", "", LIFT))
    ends = {"start": {"joints_rad": bare.lower + 0.1}, "goal": {"joints_rad": bare.lower + 0.2}}
    scene = Scene.model_validate({"format": "hplan-scene/1", "name": "bare", **ends}, strict=False)
    for options in (QUICK, PlanOptions(effort="quick", certify=False)):
        with pytest.raises(RobotFileError, match="no moving link has a <collision>: the robot could touch nothing"):
            plan(bare, scene, options)
    limits = Limits(bare.velocity_limit, bare.acceleration_limit, None, None)
    path = SplinePath.from_control_points(np.linspace(bare.lower + 0.1, bare.lower + 0.2, 5))
    with pytest.raises(RobotFileError, match="no moving link has a <collision>: the robot could touch nothing"):
        certify(bare, scene, time_path(path, bare.dynamics, limits, rate_hz=100.0))


@pytest.mark.parametrize("leaves_s", [0.6, 2.0])
def test_it_waits_for_a_ball_that_leaves_its_path(arm: Robot, leaves_s: float) -> None:
    """The ball follows its track, at the distance that the certificate states."""
    start, goal = np.array([-1.3, -0.6, 1.0, 0.2, 0.3, 0.0]), np.array([1.3, -0.6, 1.0, 0.2, 0.3, 0.0])
    middle, rise = arm.tool_positions(0.5 * (start + goal)), np.array([0.0, 0.0, 0.8])
    away = Track(times_s=(0.0, leaves_s), shifts_m=((0.0, 0.0, 0.0), tuple(rise.tolist())))
    ball = Sphere(name="ball", center=tuple(middle.tolist()), radius=0.06, track=away)
    ends = {"start": Start(joints_rad=tuple(start.tolist())), "goal": Goal(joints_rad=tuple(goal.tolist()))}
    result = plan(arm, Scene(name="s", obstacles=(ball,), clearance=0.005, **ends), QUICK)
    assert result.certificate.verified
    bodies, shape, clock = Bodies(arm, samples=0), coal.Sphere(0.06), np.arange(0.0, result.trajectory.duration, 5e-3)
    places = (coal.Transform3s(np.eye(3), middle + min(1.0, at / leaves_s) * rise) for at in clock)
    least = min(map(bodies.from_obstacles, result.trajectory.positions(clock), ([(shape, at)] for at in places)))
    assert least >= result.certificate.min_clearance_m - 1e-6 > 0.005 - 1e-6
