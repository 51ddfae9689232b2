"""The picture of robots that are no planar arms: where it is taken from, joints that turn and that slide."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from any_arms import loaded_arm

from hplan.apps.view import scene_stage
from hplan.apps.view.page import render_page
from hplan.apps.view.playback import Playback
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
