"""Modules imported only when they are used, and by the names that they had in earlier versions."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from hplan.base.lazy_import import deferred
from hplan.base.moved import MOVED, present_name


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package that says when it is imported, and one that imports it."""
    heavy = tmp_path / "heavy_part"
    heavy.mkdir()
    (heavy / "__init__.py").write_text("from heavy_log import log\nlog.append('heavy_part')\nversion = 1\n")
    (heavy / "plots.py").write_text("from heavy_log import log\nlog.append('heavy_part.plots')\nanswer = 42\n")
    (tmp_path / "heavy_log.py").write_text("log = []\n")
    (tmp_path / "wants_heavy.py").write_text("import heavy_part.plots as plots\nimport heavy_part\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in ("heavy_part", "heavy_part.plots", "heavy_log", "wants_heavy"):
        sys.modules.pop(name, None)


def test_imported_when_used(package: Path) -> None:
    with deferred("heavy_part", "heavy_part.plots"):
        import wants_heavy
    from heavy_log import log

    assert log == []
    assert "heavy_part" not in sys.modules
    assert "heavy_part.plots" not in sys.modules
    assert wants_heavy.plots.answer == 42
    assert log == ["heavy_part", "heavy_part.plots"]
    assert wants_heavy.heavy_part.version == 1
    assert sys.modules["heavy_part.plots"].answer == 42
    with pytest.raises(AttributeError):
        _ = wants_heavy.plots.nothing


def test_what_is_there_stays(package: Path) -> None:
    import heavy_part.plots as plots

    with deferred("heavy_part", "heavy_part.plots"):
        import heavy_part.plots as again
    assert again is plots
    assert sys.modules["heavy_part.plots"] is plots


def test_timing_leaves_matplotlib_out() -> None:
    code = (
        "import sys; import hplan.trajectory.topp; print(sorted(m for m in sys.modules if m.startswith('matplotlib')))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
    code = "import hplan.trajectory.topp, toppra.parametrizer, matplotlib.pyplot as plt; "
    code += "print(toppra.parametrizer.plt.figure is plt.figure)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "True"


@pytest.mark.parametrize("name", sorted(MOVED))
def test_an_earlier_name_is_the_same_module(name: str) -> None:
    assert importlib.import_module(f"hplan.{name}") is importlib.import_module(f"hplan.{MOVED[name]}")


@pytest.mark.parametrize(
    ("before", "now"),
    [
        ("hplan.view.page", "hplan.apps.view.page"),
        ("hplan.timing.trajectory", "hplan.trajectory.trajectory"),
        ("hplan.smoothing.spline", "hplan.trajectory.spline"),
        ("hplan.smoothing.repair", "hplan.optimization.repair"),
    ],
)
def test_a_module_of_an_earlier_package_is_no_copy(before: str, now: str) -> None:
    assert present_name(before) == now
    assert importlib.import_module(before) is importlib.import_module(now)


def test_public_names_of_earlier_packages() -> None:
    names = {"orchard": "generate", "robot_family": "ArmSpec", "search": "dense_search", "waypoints": "time_waypoints"}
    assert all(callable(getattr(importlib.import_module(f"hplan.{room}"), name)) for room, name in names.items())


@pytest.mark.parametrize("name", ["hplan.timing.nothing", "hplan.nothing"])
def test_other_names_are_not_found(name: str) -> None:
    assert present_name("hplan.scene.model") is None
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module(name)


def test_a_module_that_was_moved_is_run_by_its_earlier_name() -> None:
    called = subprocess.run(
        [sys.executable, "-m", "hplan.cli", "--version"], capture_output=True, text=True, check=True
    )
    assert called.stdout.startswith("hplan ")
