"""The study of random scenes for any arm, on an arm of the tests: the scenes, what is told of them, and grazing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from script_loader import load_script
from studies.benchmark.arm_grazing import Grazed, grazed
from studies.benchmark.arm_grazing import table as table_of_grazing
from studies.benchmark.arm_motions import Attempt, attempts, table
from studies.benchmark.arm_scenes import FREE_M, KINDS, random_scene
from studies.benchmark.ompl_paths import seed_ompl
from studies.benchmark.outside_check import OutsideCheck, of_scene
from toy_urdf import SIX_AXIS_LIMITS, six_axis_arm

from hplan.collision.coal_scene import base_contacts
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot, load_robot


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("arm") / "six.urdf"
    path.write_text(six_axis_arm())
    path.with_suffix(".limits.yaml").write_text(SIX_AXIS_LIMITS)
    return load_robot(path)


@pytest.mark.parametrize("number", range(len(KINDS)))
def test_scenes_are_those_of_their_seeds_and_their_ends_are_free(arm: Robot, number: int) -> None:
    scene = random_scene(arm, 7, number)
    assert scene == random_scene(arm, 7, number)
    assert scene != random_scene(arm, 8, number)
    kinds = [obstacle.kind for obstacle in scene.obstacles]
    counts = tuple(kinds.count(kind) for kind in ("box", "sphere", "capsule", "points"))
    assert counts == (KINDS[number][0] + 1, *KINDS[number][1:])
    check = OutsideCheck(arm, *of_scene(scene.obstacles))
    ends = np.array([scene.start.configuration, scene.goal.configuration])
    assert not np.any(check.touched(ends))
    assert min(check.distance(end) for end in ends) > FREE_M
    assert not base_contacts(arm, scene.solids)


def test_a_scene_is_solved_by_both(arm: Robot) -> None:
    pytest.importorskip("ompl")
    seed_ompl(1)
    number = 3
    (row,) = attempts(arm, [number], PlanOptions(effort="quick"), 7)
    assert row.number == number
    assert row.verified
    assert row.contacts == (0, 0)
    assert row.peer_solved


def test_what_is_told_of_scenes() -> None:
    rows = [
        Attempt(0, True, 2, True, 0.1, "direct", 0.05, 1.0, True),
        Attempt(1, False, 4, True, 0.3, "NotFoundError", 2.0),
        Attempt(2, False, 4, False, 0.3, "trees", 1.0, 2.0, True, (3, 0)),
        Attempt(3, False, 0, False, 5.0, "NotFoundError", 3.0),
    ]
    lines = table(rows)
    assert lines[0].endswith("clear in 1")
    assert "3 paths, 2 of them touch nothing; median 200 ms" in lines[1]
    assert "2 motions, 2 certified" in lines[2]
    assert lines[2].endswith("1 [1]")
    assert lines[4] == "motions in contact: 1 with an obstacle, 0 with the robot itself"
    assert lines[5:7] == ["by hplan alone: [2]", "by nobody: [3]"]


def test_grazing_motions_of_an_arm_are_not_verified(arm: Robot) -> None:
    rows = list(grazed(arm, 2, 1))
    deep, passed = ([row for row in rows if (row.spare_m < 0.0) == grazing] for grazing in (True, False))
    assert len(deep) == len(passed) == 2
    assert all(-6e-3 <= row.spare_m <= -8e-5 for row in deep)
    assert all(row.named and not row.verified for row in deep)
    assert all(row.verified == (not row.named) for row in passed)


def test_what_is_told_of_grazing() -> None:
    rows = [Grazed("box", -1e-3, False, True), Grazed("sphere", 3e-4, True, False)]
    first, second = table_of_grazing(rows)
    assert first.endswith("1 (0 sphere, 0 capsule, 1 box); verified: 0; refused with the obstacle's name: 1")
    assert "verified: 1" in second


def test_the_command_needs_an_arm_that_it_can_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert load_script("study_random_scenes").main(["--robot", str(tmp_path / "none.urdf"), "--scenes", "1"]) == 2
    assert "none.urdf" in capsys.readouterr().err
