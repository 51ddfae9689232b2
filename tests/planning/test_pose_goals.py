"""A goal given as a pose of a frame: scenes, plans of any robot, and the certificate."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from any_arms import loaded_arm

import hplan.errors as errors
from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import certify
from hplan.certificate.digests import scene_digest
from hplan.geometry.rotation import quaternion_rotation
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.planning import pose_goal
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan, plan_if_free
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Obstacle, Sphere

QUICK = PlanOptions(effort="quick")
START, END = (0.3, 0.8, 0.6, -0.4, 0.5, 0.2), (1.5, 0.9, 0.5, -0.2, -0.4, 0.6)
POST = Box(name="post", center=(0.35, 0.55, 0.6), size=(0.06, 0.06, 1.2))
HALF = math.sqrt(0.5)


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm("toy", tmp_path_factory)


def pose_at(arm: Robot, q: Any, frame: str | None = None) -> dict[str, Any]:
    """The goal that a configuration reaches."""
    pose = arm.forward_kinematics(np.array(q), frame)
    turn = tuple(pin.Quaternion(pose[:3, :3]).coeffs().tolist())
    return {"position": tuple(pose[:3, 3].tolist()), "quaternion_xyzw": turn} | ({"frame": frame} if frame else {})


def scene_of(goal: dict[str, Any], *obstacles: Obstacle, start: tuple[float, ...] = START) -> Scene:
    return Scene.model_validate(
        {"format": "hplan-scene/1", "name": "x", "start": {"joints_rad": start}, "goal": goal, "obstacles": obstacles}
    )


def reached(arm: Robot, scene: Scene, q: FloatArray) -> bool:
    asked, there = scene.goal.pose, arm.forward_kinematics(q, scene.goal.frame)
    return asked is not None and bool(np.abs(there - asked).max() < 1e-6)


@pytest.mark.parametrize("frame", [None, "wrist_2_link"])
@pytest.mark.parametrize("obstacles", [(), (POST,)])
def test_plan_ends_at_the_pose(arm: Robot, frame: str | None, obstacles: tuple[Obstacle, ...]) -> None:
    scene = scene_of(pose_at(arm, END, frame), *obstacles)
    found = plan(arm, scene, QUICK)
    assert found.certificate.verified
    assert reached(arm, scene, found.trajectory.position[-1])
    assert certify(arm, scene, found.trajectory).verified
    assert (plan(arm, scene, QUICK).trajectory.position == found.trajectory.position).all()


def test_certificate_refuses_another_pose(arm: Robot) -> None:
    goal = pose_at(arm, END)
    found = plan(arm, scene_of(goal), QUICK).trajectory
    x, y, z = goal["position"]
    beside = scene_of(goal | {"position": (x + 2e-3, y, z)})
    turned = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, 2e-3) @ quaternion_rotation(goal["quaternion_xyzw"]))
    for other in (beside, scene_of(goal | {"quaternion_xyzw": tuple(turned.coeffs().tolist())})):
        refused = certify(arm, other, found)
        assert not refused.verified
        assert any("pose of the goal" in text for text in refused.violations)


def test_pose_in_obstacle_is_blocked_and_names_it(arm: Robot) -> None:
    goal = pose_at(arm, END)
    with pytest.raises(errors.BlockedError) as refused:
        plan(arm, scene_of(goal, Sphere(name="ball", center=goal["position"], radius=0.05)), QUICK)
    assert refused.value.obstacles[0]["obstacle"] == "ball"


def test_pose_out_of_reach(arm: Robot) -> None:
    with pytest.raises(errors.UnreachableError):
        plan(arm, scene_of({"position": (9.0, 0.0, 0.0), "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0)}), QUICK)


@pytest.mark.parametrize("name", ["seven", "panda", "ur5"])
def test_other_arms(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    robot = loaded_arm(name, tmp_path_factory)
    middle = 0.5 * (robot.lower + robot.upper)
    bent = middle + 0.25 * np.minimum(robot.upper - middle, 2.0) * np.array([1, -1, 1, -1, 1, -1, 1][: robot.dof])
    start = middle + 0.4 * (bent - middle)
    scene = scene_of(pose_at(robot, bent), start=tuple(start.tolist()))
    found = plan(robot, scene, QUICK)
    assert found.certificate.verified
    assert reached(robot, scene, found.trajectory.position[-1])


def test_digests_differ_between_poses() -> None:
    goal = {"position": (0.5, 0.1, 0.4), "quaternion_xyzw": (0.0, HALF, 0.0, HALF)}
    goals = [
        goal,
        goal | {"quaternion_xyzw": (HALF, 0.0, 0.0, HALF)},
        goal | {"frame": "a"},
        {"position": (0.5, 0.1, 0.4)},
    ]
    assert len({scene_digest(scene_of(each)) for each in goals}) == len(goals)


def test_quaternion_is_a_rotation() -> None:
    assert quaternion_rotation([0.0, 0.0, HALF, HALF]) == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]))
    drawn = np.random.default_rng(1).normal(size=(20, 4))
    for q in drawn / np.linalg.norm(drawn, axis=1)[:, None]:
        assert quaternion_rotation(q) == pytest.approx(pin.Quaternion(*q[[3, 0, 1, 2]]).toRotationMatrix())


def test_more_starts_find_a_clear_configuration(arm: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    goal = pose_at(arm, END)
    elbow = tuple(arm.forward_kinematics(np.array(END), "elbow_link")[:3, 3].tolist())
    scene, tried = scene_of(goal, Sphere(name="ball", center=elbow, radius=0.03)), list[int]()

    def few_at_first(*arguments: Any, seeds: int, **options: Any) -> FloatArray:
        tried.append(seeds)
        found = inverse_kinematics(*arguments, seeds=seeds, **options)
        return found if len(tried) > 1 else found[np.abs(found - END).max(axis=1) < 1e-3]

    monkeypatch.setattr(pose_goal, "inverse_kinematics", few_at_first)
    found = plan(arm, scene, QUICK)
    assert found.certificate.verified
    assert reached(arm, scene, found.trajectory.position[-1])
    assert len(tried) == 2
    assert tried[1] > tried[0]
    tried.clear()
    with pytest.raises(errors.BlockedError):
        plan_if_free(arm, scene, QUICK)
    assert len(tried) == 1
