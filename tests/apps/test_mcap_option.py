"""The option `--mcap` of the commands that plan."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from hplan.apps.cli.main import main

mcap_reader = pytest.importorskip("mcap.reader")
pytest.importorskip("rosbags")


def topics(path: Path) -> set[str]:
    with path.open("rb") as stream:
        summary = mcap_reader.make_reader(stream).get_summary()
    return {channel.topic for channel in summary.channels.values()}


def test_of_plans_and_of_tours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, files = str(tmp_path), ("trajectory.csv", "report.json", "scene.html")
    assert main(["plan", "--effort", "quick", "--mcap", "--out", folder]) == 0
    assert "motion.mcap" in capsys.readouterr().out
    assert {file.name for file in tmp_path.iterdir()} == {*files, "motion.mcap"}
    assert "/joint_trajectory" in topics(tmp_path / "motion.mcap")
    # An earlier job's file does not stand beside this one's report.
    assert main(["plan", "--effort", "quick", "--quiet", "--out", folder]) == 0
    assert {file.name for file in tmp_path.iterdir()} == set(files)
    assert main(["tour", "--fruits", "fruit 01", "--grasps", "1", "--mcap", "--quiet", "--out", folder]) == 0
    assert "/clearance" in topics(tmp_path / "motion.mcap")


@pytest.mark.parametrize("command", ["plan", "tour"])
def test_without_rosbags(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    assert main([command, "--mcap", "--quiet", "--out", str(tmp_path)]) == 2
    assert list(tmp_path.iterdir()) == []
    assert "pip install 'hplan[ros]'" in capsys.readouterr().err
