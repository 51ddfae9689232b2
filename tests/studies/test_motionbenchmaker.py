"""The study of MotionBenchMaker's problems, on an arm of the tests: scenes, and the check from outside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from any_arms import loaded_arm
from studies.benchmark.motionbenchmaker import Solved, outside_check, peer_table, scene_of, table
from studies.benchmark.ompl_paths import seed_ompl
from studies.benchmark.peer_motions import PeerMotion, peer_motion

from hplan.robot.model import Robot

START, GOAL = (0.3, 0.8, 0.6, -0.4, 0.5, 0.2), (1.5, 0.9, 0.5, -0.2, -0.4, 0.6)


@pytest.fixture
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm("toy", tmp_path_factory)


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


def problem_with_a_post(arm: Robot) -> dict[str, Any]:
    post = {"name": "post", "kind": "box", "size": [0.06, 0.06, 1.2], "position": [0.35, 0.55, 0.6]}
    return problem_of(arm, {**post, "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]})


def test_the_outside_check_has_the_obstacles_of_the_file(arm: Robot) -> None:
    check = outside_check(arm, problem_with_a_post(arm))
    touched, own = check.touched(np.linspace(START, GOAL, 100))
    assert 0 < touched.sum() < 100
    assert not own.any()
    assert not check.touched(np.array([START, GOAL]))[0].any()


def test_a_motion_of_a_peer(arm: Robot) -> None:
    pytest.importorskip("ompl")
    pytest.importorskip("toppra")
    seed_ompl(1)
    problem = problem_with_a_post(arm)
    found = peer_motion(arm, scene_of(arm, problem, "post"), outside_check(arm, problem))
    assert found.waypoints >= 3
    assert found.length_rad > np.linalg.norm(np.subtract(GOAL, START))
    assert found.duration_s is not None
    assert found.duration_s > (np.abs(np.subtract(GOAL, START)) / arm.velocity_limit).max()


def test_a_table_of_what_is_solved() -> None:
    rows = [
        Solved("box", 1, "direct", 0.1, 1.5, True, (0, 0)),
        Solved("box", 2, "NotFoundError", 0.3, None, False, (0, 0)),
    ]
    assert table(rows)[2] == "| box | 1 of 2 | 200 | 290 | 300 | 1.50 | 0 | 0 |"


def test_a_table_of_a_peers_motions() -> None:
    rows = [
        Solved("box", 1, "direct", 0.1, 1.5, True, (0, 0), PeerMotion(4, 0.1, 0.01, 3.0, 3.0, (7, 0))),
        Solved("box", 2, "trees", 0.1, 2.0, True, (0, 0), PeerMotion(4, 0.1, 0.01, 3.0, 2.0, (0, 0))),
        Solved("box", 3, "trees", 0.1, 2.0, True, (0, 0), PeerMotion(0, 5.0)),
    ]
    assert peer_table(rows)[2] == "| box | 3 | 2 | 110 | 4511 | 1 | 1 | 0 | 0.75 | 0.97 | 1.00 | 1.00 |"
    assert rows[0].row["peer"]["contacts"] == (7, 0)
