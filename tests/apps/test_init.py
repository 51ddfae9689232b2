"""`hplan init`: a folder to start from, for arms that hplan has never seen."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
from toy_urdf import six_axis_arm

import hplan
from hplan.apps.cli.main import main


def test_folder_for_an_arm_without_limits_and_tool(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A velocity of 0 and no accelerations: guesses are written; the script plans with them."""
    text = six_axis_arm().replace('velocity="3"', 'velocity="0"', 1)
    (tmp_path / "own.urdf").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert main(["init", "first", "--robot", "own.urdf", "--tool-tube", "0.15", "--quiet"]) == 0
    folder = Path("first")
    assert {path.name for path in folder.iterdir()} == {"scene.yaml", "limits.yaml", "README.md", "pick.py"}
    assert "shoulder_pan: 1  # guess" in (folder / "limits.yaml").read_text()
    robot = hplan.load_robot(hplan.load_scene(folder / "scene.yaml").robot)
    assert robot.tool_frame == "tool_tube_end"
    assert robot.assumptions == ()
    runpy.run_path(str(folder / "pick.py"))
    assert hplan.read_csv(folder / "motion.csv").duration > 0.0


def test_files_of_the_user_stay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine = tmp_path / "pick.py"
    mine.write_text("print('mine')\n")
    assert main(["init", str(tmp_path), "--quiet"]) == 2
    assert "hplan did not write it" in capsys.readouterr().err.replace("\n", " ")
    assert [path.name for path in tmp_path.iterdir()] == ["pick.py"]
    assert mine.read_text() == "print('mine')\n"
    assert main(["init", str(tmp_path), "--quiet", "--force"]) == 0
    assert hplan.load_scene(tmp_path / "scene.yaml").robot is None


def test_failed_start_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm without tool frame: the error is that of loading."""
    monkeypatch.chdir(tmp_path)
    Path("own.urdf").write_text(six_axis_arm().replace("base_link", "root"), encoding="utf-8")
    assert main(["init", "new", "--robot", "own.urdf", "--tool-frame", "tool", "--quiet"]) == 2
    assert list(Path("new").iterdir()) == []
