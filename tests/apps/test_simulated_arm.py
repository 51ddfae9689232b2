"""The simulated arm, one control period at a time: tracking, contacts, rays."""

from __future__ import annotations

import numpy as np
import pytest
from planned import fruit, task

from hplan.apps.execution.simulated_arm import CONTROL_PERIOD, SimulatedArm
from hplan.errors import InputError
from hplan.planar.family_reader import family_of
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.obstacles import Sphere

pytest.importorskip("mujoco", reason="the extra `execution` is not installed")

STRETCHED = (0.0, 30.0, 20.0, 20.0)


def test_follows_a_planned_motion_and_touches_nothing(robot: Robot) -> None:
    scene = task(STRETCHED, (40.0, 40.0, 20.0, 20.0), [Sphere(name="ball", center=(0.9, -0.8, 1.2), radius=0.1)])
    trajectory = plan(robot, scene).trajectory
    arm = SimulatedArm(robot, scene)
    arm.place(trajectory.position[0])
    clock = CONTROL_PERIOD * np.arange(round(trajectory.duration / CONTROL_PERIOD) + 1)
    row = np.searchsorted(trajectory.time, clock, side="right") - 1
    for instant, q in zip(row, trajectory.positions(clock), strict=True):
        arm.follow(q, trajectory.velocity[instant], trajectory.acceleration[instant])
    assert np.abs(arm.position - trajectory.position[-1]).max() < 0.01
    assert arm.contacts == ()
    assert arm.time_s == pytest.approx(len(clock) * CONTROL_PERIOD)


def test_contact_is_noted_unless_it_is_let_through(robot: Robot) -> None:
    q = np.radians(STRETCHED)
    tip = robot.tool_positions(q)
    scene = task((0.0, 60.0, 20.0, 20.0), STRETCHED, [Sphere(name="ball", center=tuple(tip.tolist()), radius=0.05)])
    for names, touched in (((), {"ball"}), (("ball",), set())):
        arm = SimulatedArm(robot, scene)
        arm.pass_through(names)
        arm.place(q)
        assert {touch.obstacle for touch in arm.contacts} == touched
    with pytest.raises(InputError, match="no obstacle 'bale'"):
        arm.pass_through(["bale"])


def test_rays_meet_obstacles_fruit_and_the_arm_itself(robot: Robot) -> None:
    scene = task(
        (0.0, 90.0, 90.0, 90.0), STRETCHED, [Sphere(name="ball", center=(3.0, 0.0, 1.0), radius=0.5)],
        fruits=(fruit("apple", 90.0, 3.0, 1.0, 0.25),),
    )  # fmt: skip
    arm = SimulatedArm(robot, scene)
    arm.place(np.radians(STRETCHED))
    rays = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 0.0]])
    origin = (1.5, 0.0, 1.0)
    distance, is_obstacle = arm.cast_rays(origin, rays[:1])
    assert distance == pytest.approx(1.0)
    assert is_obstacle.tolist() == [1]
    distance, _ = arm.cast_rays((0.0, 1.0, 1.0), rays[1:3])
    assert distance[0] == pytest.approx(1.75)
    shoulder = family_of(robot).plane_origin
    distance, is_obstacle = arm.cast_rays(shoulder - [0.0, 3.0, 0.0], np.array([[0.0, 1.0, 0.0]]))
    assert distance[0] < 3.0
    assert is_obstacle.tolist() == [0]
    with pytest.raises(InputError, match="directions"):
        arm.cast_rays(origin, np.zeros((2, 2)))
    with pytest.raises(InputError, match="origin"):
        arm.cast_rays((np.nan, 0.0, 0.0), rays)


def test_removed_obstacle_is_neither_touched_nor_seen(robot: Robot) -> None:
    q = np.radians(STRETCHED)
    tip = robot.tool_positions(q)
    scene = task((0.0, 60.0, 20.0, 20.0), STRETCHED, [Sphere(name="ball", center=tuple(tip.tolist()), radius=0.05)])
    arm = SimulatedArm(robot, scene)
    above, ray = np.add(tip, (0.0, 0.0, 0.5)), np.array([[0.0, 0.0, -1.0]])
    arm.place(np.radians((0.0, 90.0, 90.0, 90.0)))
    assert arm.cast_rays(above, ray)[0] == pytest.approx(0.45)
    arm.take_away(["ball"])
    assert arm.cast_rays(above, ray)[0] > 0.45
    arm.place(q)
    assert arm.contacts == ()
