"""The study of MotionBenchMaker's problems, on an arm of the tests: scenes, and the check from outside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studies.benchmark.motionbenchmaker import Solved, contacts, scene_of, table
from toy_urdf import SIX_AXIS_LIMITS, six_axis_arm

from hplan.robot.model import Robot, load_robot

START, GOAL = (0.3, 0.8, 0.6, -0.4, 0.5, 0.2), (1.5, 0.9, 0.5, -0.2, -0.4, 0.6)


@pytest.fixture
def arm(tmp_path: Path) -> Robot:
    path = tmp_path / "six.urdf"
    path.write_text(six_axis_arm())
    path.with_suffix(".limits.yaml").write_text(SIX_AXIS_LIMITS)
    return load_robot(path)


def problem_of(arm: Robot, *obstacles: dict[str, Any]) -> dict[str, Any]:
    ends = {key: dict(zip(arm.joint_names, q, strict=True)) for key, q in (("start", START), ("goal", GOAL))}
    return {"number": 1, "obstacles": list(obstacles), **ends}


def test_problems_become_scenes(arm: Robot) -> None:
    turned = [0.0, 0.0, np.sin(0.25), np.cos(0.25)]
    can = {"name": "can", "kind": "cylinder", "length": 0.2, "radius": 0.05, "position": [0.5, 0.5, 0.1]}
    box = {"name": "can", "kind": "box", "size": [0.1, 0.2, 0.3], "position": [-0.5, 0.5, 0.1]}
    keys = {"quaternion_xyzw": turned}
    scene = scene_of(arm, problem_of(arm, {**can, **keys}, {**box, **keys}), "kitchen")
    assert [obstacle.name for obstacle in scene.obstacles] == ["can 0", "can 1"]
    assert scene.obstacles[1].rotation[:2, 0] == pytest.approx([np.cos(0.5), np.sin(0.5)])
    assert scene.start.configuration == pytest.approx(START)


def test_the_outside_check_sees_what_is_touched(arm: Robot) -> None:
    post = {"name": "post", "kind": "box", "size": [0.06, 0.06, 1.2], "position": [0.35, 0.55, 0.6]}
    problem = problem_of(arm, {**post, "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]})
    straight = np.linspace(START, GOAL, 100)
    touched, own = contacts(arm, problem, straight)
    assert touched > 0
    assert own == 0
    assert contacts(arm, problem, straight[[0, -1]]) == (0, 0)
    anywhere = np.random.default_rng(0).uniform(arm.lower, arm.upper, (200, arm.dof))
    assert 0 < contacts(arm, problem_of(arm), anywhere)[1] < 200


def test_a_table_of_what_is_solved() -> None:
    rows = [
        Solved("box", 1, "direct", 0.1, 1.5, True, (0, 0)),
        Solved("box", 2, "NotFoundError", 0.3, None, False, (0, 0)),
    ]
    assert table(rows)[2] == "| box | 1 of 2 | 200 | 290 | 300 | 1.50 | 0 | 0 |"
