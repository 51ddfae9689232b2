"""Modules imported only when they are used."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import hplan
from hplan.base.lazy_import import defer_imports


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
    with defer_imports("heavy_part", "heavy_part.plots"):
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


def test_existing_names_are_kept(package: Path) -> None:
    import heavy_part.plots as plots

    with defer_imports("heavy_part", "heavy_part.plots"):
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


@pytest.mark.parametrize("package", ["hplan", "hplan.scene", "hplan.planar.grid", "hplan.trajectory", "hplan.apps.ros"])
def test_public_names_load_from_the_modules_that_type_checkers_see(package: str) -> None:
    module = importlib.import_module(package)
    blocks = [node for node in ast.parse(Path(str(module.__file__)).read_text()).body if isinstance(node, ast.If)]
    imports = [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
    homes = {alias.name: str(node.module) for node in imports for alias in node.names}
    assert sorted(homes) == sorted(module.__all__)
    for name, home in homes.items():
        assert module.__getattr__(name) is getattr(importlib.import_module(home), name)
    with pytest.raises(AttributeError, match="nothing"):
        _ = module.nothing


def test_viewers_are_registered() -> None:
    assert set(hplan.base.lazy_import.VIEWERS) == {"notebook_html", "draw_trajectory"}
