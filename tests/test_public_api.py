"""What `import hplan` offers, and the library in ten lines as the README shows it."""

from __future__ import annotations

import importlib
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import hplan
from hplan.scene.obstacles import PointCloud

README = Path(__file__).parents[1] / "README.md"


def test_readme_example_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The README's Python blocks, word for word, one after the other."""
    blocks = re.findall(r"^```python\n(.*?)^```$", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len([line for line in blocks[0].splitlines() if line.strip()]) <= 10
    monkeypatch.chdir(tmp_path)
    space: dict[str, object] = {}
    exec(compile(blocks[0], str(README), "exec"), space)
    result = space["result"]
    assert isinstance(result, hplan.PlanResult)
    assert result.certificate.verified
    assert hplan.read_csv(tmp_path / "motion.csv").samples == result.trajectory.samples
    assert capsys.readouterr().out != ""
    for block in blocks[1:]:
        exec(compile(block, str(README), "exec"), space)
    planner = space["planner"]
    assert isinstance(planner, hplan.Planner)
    assert planner.last.certificate.verified


def test_readme_scene_is_a_scene(tmp_path: Path) -> None:
    """The README's one YAML block loads and can be planned, given the files that it names."""
    (block,) = re.findall(r"^```yaml\n(.*?)^```$", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (tmp_path / "scene.yaml").write_text(block, encoding="utf-8")
    corners = np.array([-0.8, 0.0, 0.2]) + list(itertools.product((-0.1, 0.1), repeat=3))
    trimesh.Trimesh(corners).convex_hull.export(tmp_path / "crate.stl")
    PointCloud.of("canopy", corners + np.array([0.0, 0.0, 1.0]), 0.01).write(tmp_path / "canopy.ply")
    scene = hplan.load_scene(tmp_path / "scene.yaml")
    assert {obstacle.kind for obstacle in scene.obstacles} == {"sphere", "capsule", "box", "cylinder", "mesh", "points"}
    result = hplan.plan(hplan.load_robot(), scene)
    assert result.certificate.verified
    assert [phase.name for phase in result.phases] == ["transit", "approach", "retreat"]


def test_readme_names_files_that_exist() -> None:
    root = README.parent
    named = re.findall(r"`((?:hplan|scripts|tests|urdf)/[\w./-]*)`", README.read_text(encoding="utf-8"))
    assert named
    assert [name for name in named if not (root / name).exists()] == []


@pytest.mark.parametrize("name", hplan.__all__)
def test_public_names_load(name: str) -> None:
    value = getattr(hplan, name)
    home = importlib.import_module(value.__module__)
    assert home.__name__.startswith("hplan.")
    assert getattr(home, name) is value
    assert value.__doc__


def test_public_names_are_listed() -> None:
    assert dir(hplan) == sorted(hplan.__all__)


def test_unknown_name() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'plann'"):
        hplan.plann  # noqa: B018


def test_all_errors_have_one_root() -> None:
    errors = importlib.import_module("hplan.errors")
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, Exception)]
    assert len(kinds) > 8
    assert all(issubclass(kind, hplan.HplanError) for kind in kinds)
    assert {kind.exit_status for kind in kinds} == {1, 2, 3, 4, 5, 6}
