"""Approach angles of planar arms are those of all arms, ahead of the base and behind it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from arm_variants import VARIANTS, load_variant

from hplan.certificate.task_check import task_violations
from hplan.errors import UnreachableError
from hplan.kinematics.tool_at_point import approach_angles
from hplan.planar.family_reader import family_of
from hplan.planar.goal_sampler import configurations_at_point
from hplan.planar.inverse_kinematics import reach
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start

UPRIGHT = [name for name, (_, _, _, axes) in VARIANTS.items() if len(axes) == 3 and "plane" not in name]


def in_plane(robot: Robot, q: np.ndarray) -> np.ndarray:
    angles: np.ndarray = (
        family_of(robot).arm.signs * q[..., family_of(robot).arm_slice] + family_of(robot).arm.offsets
    ).sum(axis=-1)
    return angles


@pytest.mark.parametrize("name", UPRIGHT)
def test_windows_hold_for_points_ahead_and_behind(name: str, tmp_path: Path) -> None:
    robot, rng = load_variant(name, tmp_path), np.random.default_rng(0)
    behind = 0
    for q in rng.uniform(robot.lower, robot.upper, (30, robot.dof)):
        place = robot.tool_positions(q)
        angle = float(approach_angles(robot, q[None])[0])
        found = configurations_at_point(robot, place, approach_deg=math.degrees(angle), count=8, start=q)
        assert np.abs(found - q).max(axis=1).min() < 1e-6
        assert np.abs(np.sin(0.5 * (approach_angles(robot, found) - angle))).max() < 1e-6
        behind += int(abs(math.sin(0.5 * (float(in_plane(robot, q)) - angle))) > 1e-6)
    assert behind > 0 or not family_of(robot).has_yaw


def test_without_a_window_all_configurations_of_the_closed_form(tmp_path: Path) -> None:
    robot = load_variant("upright on a yaw", tmp_path)
    place = robot.tool_positions(0.5 * (robot.lower + robot.upper))
    found, every = configurations_at_point(robot, place, count=16), reach(robot, place, count=16)
    np.testing.assert_array_equal(found, every.configurations)


def test_a_window_that_no_configuration_has_is_refused(tmp_path: Path) -> None:
    robot = load_variant("upright on a yaw", tmp_path)
    place = robot.tool_positions(0.5 * (robot.lower + robot.upper))
    every = np.degrees(approach_angles(robot, configurations_at_point(robot, place, count=64)))
    free = max(np.arange(-180.0, 180.0, 10.0), key=lambda angle: np.abs((every - angle + 180.0) % 360.0 - 180.0).min())
    with pytest.raises(UnreachableError, match="approach angle"):
        configurations_at_point(robot, place, approach_deg=float(free), count=16)


def test_the_certificate_measures_the_same_angle(tmp_path: Path) -> None:
    robot = load_variant("upright on a yaw", tmp_path)
    rows = np.random.default_rng(1).uniform(robot.lower, robot.upper, (10, robot.dof))
    for q in rows:
        place = robot.tool_positions(q)
        angle = math.degrees(float(approach_angles(robot, q[None])[0]))
        for off, refused in ((0.0, False), (5.0, True)):
            goal = Goal(position=tuple(place.tolist()), approach_deg=angle + off)
            scene = Scene(name="angle", start=Start(joints_rad=tuple(q.tolist())), goal=goal)
            assert any("required" in line for line in task_violations(robot, scene, np.tile(q, (1, 4, 1)))) is refused
