"""The picture of robots that are no planar arms: where it is taken from, joints that turn and that slide."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from any_arms import loaded_arm

from hplan.apps.view import scene_stage
from hplan.apps.view.page import render_page
from hplan.apps.view.playback import Playback
from hplan.collision.collision_bodies import collision_bodies
from hplan.robot.limits import Limits
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box
from hplan.trajectory.retime import time_path
from hplan.trajectory.spline import SplinePath


def moved(name: str, folders: pytest.TempPathFactory) -> tuple[Any, Scene, Playback]:
    """A robot that moves all its joints a little."""
    robot = loaded_arm(name, folders)
    middle = np.clip(np.zeros(robot.dof), robot.lower, robot.upper)
    start, goal = np.clip([middle - 0.1, middle + 0.1], robot.lower, robot.upper)
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, None, None)
    trajectory = time_path(SplinePath.through(np.linspace(start, goal, 5)), robot.dynamics, limits, rate_hz=100.0)
    wall = Box(name="wall", center=(1.0, 0.0, 0.5), size=(0.1, 1.0, 1.0))
    ends = Start(joints_rad=tuple(start.tolist())), Goal(joints_rad=tuple(goal.tolist()))
    return robot, Scene(name="any arm", start=ends[0], goal=ends[1], obstacles=(wall,)), Playback(trajectory)


@pytest.mark.parametrize("name", ["toy", "lift", "seven", "panda"])
def test_every_joint_moves_in_the_picture(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    robot, scene, playback = moved(name, tmp_path_factory)
    commands = scene_stage.stage(robot, scene, playback)
    (animation,) = [command for command in commands if command["type"] == "set_animation"]
    tracks = [clip["clip"]["tracks"][0]["name"] for clip in animation["animations"]]
    sliding = [joint.shortname().startswith("JointModelP") for joint in robot.model.joints.tolist()[1:]]
    assert tracks == [".position" if slides else ".quaternion" for slides in sliding]


def test_fine_meshes_do_not_make_the_page_large(tmp_path_factory: pytest.TempPathFactory) -> None:
    assert len(render_page(*moved("panda", tmp_path_factory))) < 4e6


def test_the_picture_stands_on_the_ground_of_tables_and_holds_the_hand(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """A table's legs go below the foot of the arm, down to where the ground is; a slab below the foot is the ground."""
    robot, scene, playback = moved("toy", tmp_path_factory)
    slab = Box(name="slab", center=(0.0, 0.0, -0.3), size=(3.0, 3.0, 0.2))
    table = Box(name="table", center=(0.7, 0.0, -0.1), size=(0.4, 0.8, 0.9))
    platform = Box(name="platform", center=(0.0, 0.0, -0.35), size=(0.5, 0.5, 0.55))
    for obstacles, height in (((slab,), 0.0), ((table, slab), -0.55), ((platform, slab), -0.625), ((), 0.0)):
        commands = scene_stage.stage(robot, scene.with_obstacles(obstacles), playback)
        (ground,) = [command for command in commands if command["path"].endswith("/ground")]
        matrices = [child["matrix"] for child in ground["object"]["object"]["children"] if child["name"] == "shadows"]
        assert [matrix[14] for matrix in matrices] == [pytest.approx(height, abs=1e-12)]
    # A platform that stands on that ground is in the picture, the ground is as wide as it likes.
    stands = [scene.with_obstacles((table, *others)) for others in ((), (slab,), (platform,))]
    alone, among, above = (scene_stage._visible_points(robot, [one], np.zeros((1, 3)), -0.55) for one in stands)
    assert len(alone) == len(among) < len(above)
    corners = scene_stage._corners(robot, playback.trajectory.position[:1])
    for body in collision_bodies(robot):
        if body.joint >= 0:
            place = robot.forward_kinematics(playback.trajectory.position[0], robot.joint_names[body.joint])
            held = body.core @ place[:3, :3].T + place[:3, 3]
            assert (held >= corners.min(axis=0) - 1e-9).all()
            assert (held <= corners.max(axis=0) + 1e-9).all()
