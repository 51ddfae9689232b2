"""Files outside the package agree with it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

import hplan

ROOT = Path(__file__).resolve().parents[1]


def test_conda_recipe_requires_dependencies_of_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = yaml.safe_load((ROOT / "scripts" / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    asked = [re.split(r"(?=>=)", dependency) for dependency in project["dependencies"]]
    # Names on PyPI and on conda-forge that differ.
    conda_names = {"meshcat": "meshcat-python", "pin": "pinocchio"}
    wanted = {f"{conda_names.get(name, name)} {least}" for name, least in asked}
    assert set(recipe["requirements"]["run"]) == wanted | {f"python {project['requires-python']}"}
    assert recipe["context"]["version"] == project["version"] == hplan.__version__
    assert recipe["build"]["python"]["entry_points"] == [f"{k} = {v}" for k, v in project["scripts"].items()]


def test_templates_and_hooks_are_valid() -> None:
    for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"):
        form = yaml.safe_load(path.read_text(encoding="utf-8"))
        assert {"name", "description", "body"} <= set(form), path.name
    (local,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    checks = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for hook in local["hooks"][:3]:
        assert hook["entry"] in checks, hook["id"]


def test_tests_that_the_checks_name_are_there() -> None:
    (named,) = re.findall(r"tests/\{(.*)\}\.py", (ROOT / ".ci" / "run").read_text(encoding="utf-8"))
    assert [name for name in named.split(",") if not (ROOT / "tests" / f"{name}.py").is_file()] == []
