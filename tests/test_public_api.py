"""The names of `import hplan`, and shipped data: robots, scenes, types, command."""

from __future__ import annotations

import importlib
import inspect
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import hplan
from hplan.base.data_files import scenes_dir, urdf_dir
from hplan.robot.files import NAMED_ROBOTS
from hplan.robot.model import load_robot
from hplan.scene.file import load_scene

ROOT = Path(__file__).parents[1]


def _documented() -> Iterator[tuple[str, Callable[..., Any]]]:
    for name in hplan.__all__:
        public = getattr(hplan, name)
        if inspect.isfunction(public):
            yield name, public
        elif inspect.isclass(public):
            methods = ((each, getattr(method, "__func__", method)) for each, method in vars(public).items())
            yield from ((f"{name}.{each}", method) for each, method in methods if each[0] != "_" or each == "__init__")


@pytest.mark.parametrize(
    ("name", "function"), [(name, each) for name, each in _documented() if inspect.isfunction(each)]
)
def test_docstrings_that_list_arguments_list_them_all(name: str, function: Callable[..., Any]) -> None:
    text = inspect.getdoc(function) or ""
    asked = [each for each in inspect.signature(function).parameters if each not in ("self", "cls")]
    assert "Args:" not in text or [each for each in asked if f"    {each}: " not in text] == []


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_robot_ships_in_the_wheel(project: dict[str, Any]) -> None:
    assert project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"] == {"urdf": "hplan/urdf"}
    assert {path.name for path in (ROOT / "urdf").iterdir()} == {
        *(f"{name}{suffix}" for name in ("harvester", "orchard_harvester") for suffix in (".urdf", ".limits.yaml")),
        *(f"{name}.limits.yaml" for name in NAMED_ROBOTS),
    }


def test_wheel_contains_only_the_package(project: dict[str, Any], tmp_path: Path) -> None:
    pytest.importorskip("hatchling")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", tmp_path]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
        (points,) = [archive.read(name).decode() for name in archive.namelist() if name.endswith("/entry_points.txt")]
    package = ROOT / "hplan"
    assets = package.glob("apps/view/assets/*.*")
    files = [*package.rglob("*.py"), *package.glob("scenes/*.yaml"), *assets, package / "py.typed"]
    robots = {f"hplan/urdf/{path.name}" for path in (ROOT / "urdf").iterdir()}
    assert held == {path.relative_to(ROOT).as_posix() for path in files} | robots
    assert not any(part in ("scripts", "studies", "tests") for name in held for part in Path(name).parts)
    assert f"hplan = {project['project']['scripts']['hplan']}" in points.splitlines()


def test_installed_urdf_goes_before_the_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hplan.base.data_files._PACKAGE", tmp_path / "hplan")
    (tmp_path / "hplan").mkdir()
    assert urdf_dir() == tmp_path / "urdf"
    (tmp_path / "hplan" / "urdf").mkdir()
    assert urdf_dir() == tmp_path / "hplan" / "urdf"


@pytest.mark.parametrize("path", sorted(scenes_dir().glob("*.yaml")), ids=lambda path: path.stem)
def test_every_scene_that_ships_loads(path: Path) -> None:
    scene = load_scene(path)
    assert scene.name == path.stem


@pytest.mark.parametrize("path", sorted(urdf_dir().glob("*.urdf")), ids=lambda path: path.stem)
def test_every_robot_that_ships_loads(path: Path) -> None:
    assert load_robot(path).name == path.stem


def test_version(project: dict[str, Any]) -> None:
    assert project["project"]["version"] == hplan.__version__


def test_command_is_there(project: dict[str, Any]) -> None:
    module, function = project["project"]["scripts"]["hplan"].split(":")
    assert callable(getattr(importlib.import_module(module), function))


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
    both = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, Exception)]
    kinds = [kind for kind in both if not issubclass(kind, Warning)]
    assert len(kinds) > 8
    assert all(issubclass(kind, hplan.HplanError) for kind in kinds)
    assert all(issubclass(kind, errors.HplanWarning) for kind in both if kind not in kinds)
    assert {kind.exit_status for kind in kinds} == {1, 2, 3, 4, 5, 6}
