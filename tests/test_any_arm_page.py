"""The page on any arm: its code runs as it stands there, one piece after the other."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest

import hplan
from hplan.errors import InputError
from hplan.robot.files import read_limits, robot_files

PAGE = Path(__file__).parents[1] / "docs" / "any_arm.md"


def blocks(language: str) -> list[str]:
    pattern = rf"^```{language}\n(.*?)^```$"
    return re.findall(pattern, PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_the_code_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    try:
        robot_files("ur5")
    except InputError:
        pytest.skip("example-robot-data is not installed (extra `robots`)")
    monkeypatch.chdir(tmp_path)
    space: dict[str, Any] = {}
    has_ompl = importlib.util.find_spec("ompl") is not None
    for block in blocks("python"):
        if has_ompl or "ompl" not in block:
            exec(compile(block, str(PAGE), "exec"), space)
    assert [phase.name for phase in space["result"].phases] == ["transit", "approach", "retreat"]
    assert {path.name for path in tmp_path.iterdir()} == {"motion.csv", "motion.html", "scene.yaml"}
    assert hplan.load_scene("scene.yaml") == space["result"].scene
    if has_ompl:
        assert hplan.check(space["robot"], space["scene"], space["path"]).valid.all()
        assert len(space["path"]) >= 2


def test_the_limits_file_is_one(tmp_path: Path) -> None:
    (block,) = blocks("yaml")
    (tmp_path / "my.limits.yaml").write_text(block, encoding="utf-8")
    names = tuple(re.findall(r"(\w+_joint): 5.0", block))
    acceleration, jerk = read_limits(tmp_path / "my.limits.yaml", names, [False] * len(names))
    assert (len(acceleration), jerk) == (6, None)
