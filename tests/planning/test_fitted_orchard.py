"""Tree rows for arms that hplan has never seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from toy_urdf import six_axis_arm, urdf

import hplan
from hplan.apps.cli.main import main
from hplan.errors import InputError, OptionError
from hplan.planning.fitted_orchard import find_start, grow_fitted, measure_workspace
from hplan.robot.model import Robot
from hplan.scene import Scene
from hplan.study.definition import load_study

pytestmark = pytest.mark.filterwarnings("ignore::hplan.errors.RobotFileWarning")


def load(text: str) -> Robot:
    return hplan.load_robot(text, tool_tube_m=0.15)


def hang(text: str) -> str:
    """The arm upside down, below a portal."""
    ends = '<parent link="world"/><child link="base_link"/><origin rpy="3.14159265 0 0"/>'
    return text.replace("</robot>", f'<link name="world"/><joint name="portal" type="fixed">{ends}</joint></robot>')


def row(robot: Robot) -> Scene:
    return grow_fitted(measure_workspace(robot), {"seed": 3}, [0.0] * robot.dof)


def test_trees_are_where_the_tool_reaches() -> None:
    robot = load(six_axis_arm())
    space, scene = measure_workspace(robot), row(robot)
    farthest = np.linalg.norm(robot.tool_positions(np.zeros(6)))
    assert 0.2 < space.near < space.far < farthest + 0.1
    assert 0.0 < space.low < space.high < farthest + 0.1
    for fruit in scene.fruits:
        assert np.hypot(*fruit.center[:2]) <= space.far + 1e-3
        assert space.low - 1e-3 <= fruit.center[2] <= space.high + 1e-3
    start = find_start(robot, scene, space.far)
    clear = scene.with_values(clearance=0.005 * space.far)
    assert hplan.check(robot, clear, start.configuration).valid


def test_trees_of_a_hanging_arm_are_below_it() -> None:
    scene = row(load(hang(six_axis_arm())))
    assert max(fruit.center[2] for fruit in scene.fruits) < 0.0


def test_given_options_stay() -> None:
    space = measure_workspace(load(six_axis_arm()))
    scene = grow_fitted(space, {"seed": 1, "fruits": 2, "distance": 0.7, "trees": 1, "height": -0.3}, [0.0] * 6)
    assert len(scene.fruits) == 2
    trunk = next(obstacle for obstacle in scene.obstacles if obstacle.name == "tree 1 trunk 1")
    assert trunk.start == (0.7, 0.0, -0.3)
    with pytest.raises(OptionError, match="fruits = 900"):
        grow_fitted(space, {"fruits": 900}, [0.0] * 6)


def test_arms_without_a_workspace_are_refused() -> None:
    one = '<joint name="a" type="revolute"><limit lower="1.6" upper="3" velocity="2" effort="60"/>'
    text = urdf(one).replace('"l1"', '"tool0"').replace('<axis xyz="0 -1 0"/>', '<axis xyz="0 0 1"/>')
    with pytest.raises(InputError, match="does not reach to the front"):
        measure_workspace(hplan.load_robot(text, tool_tube_m=0.3))


def test_row_is_written_planned_and_toured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The written scene names the arm with its options, and later commands need none."""
    (tmp_path / "own.urdf").write_text(six_axis_arm(), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    orchard = [
        "orchard",
        *["--robot", "own.urdf", "--tool-tube", "0.15", "--seed", "3", "--fruits", "4", "--name", "own", "--quiet"],
    ]
    assert main(orchard) == 0
    assert main([*orchard, "--out", "again.yaml"]) == 0
    assert Path("orchard.yaml").read_text() == Path("again.yaml").read_text()
    for words in ("plan orchard.yaml --quiet", "certify out orchard.yaml", "tour orchard.yaml --quiet --out tour",
                  "batch orchard.yaml --jobs 1 --quiet"):  # fmt: skip
        assert main(words.split()) == 0


def test_study_takes_the_arm_and_the_written_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own.urdf").write_text(six_axis_arm(), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    words = "orchard --robot own.urdf --tool-tube 0.15 --seed 3 --fruits 4 --trees 1 --quiet"
    assert main(words.split()) == 0
    scene = hplan.load_scene("orchard.yaml")
    distance = next(one for one in scene.obstacles if one.name == "tree 1 trunk 1").start[0]
    Path("study.yaml").write_text(
        "{name: own, arms: [{robot: {urdf: own.urdf, tool_tube_m: 0.15}}], trees: [orchard.yaml], "
        f"distances: [{distance}]}}\n"
    )
    (design,) = load_study("study.yaml").designs()
    assert design.arm == "own"
    found = {fruit.name: fruit.center for fruit in design.scene.fruits}
    for fruit in scene.fruits:
        np.testing.assert_allclose(found[fruit.name], fruit.center, atol=1e-3)
    assert main(["study", "study.yaml", "--workers", "1", "--quiet"]) == 0
    assert ",own," in (tmp_path / "out" / "study.csv").read_text()
