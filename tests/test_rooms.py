"""The rooms of the package: allowed imports, and quick tests in each."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

PACKAGE = Path(__file__).resolve().parents[1] / "hplan"

#: From the ground up: a room imports only those before it, and itself.
ROOMS = (
    "errors",
    "base",
    "geometry",
    "scene",
    "robot",
    "collision",
    "kinematics",
    "trajectory",
    "optimization",
    "certificate",
    "planning",
    "workcell",
    "online",
    "tour",
    "study",
    "adapters",
    "apps",
    "planar",
)


def rooms() -> list[str]:
    return sorted(path.name for path in PACKAGE.iterdir() if (path / "__init__.py").is_file())


def imported(path: Path) -> Iterator[str]:
    """Rooms that a file imports from, wherever in the file, or names in a string (for `importlib`)."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.Constant) and re.match(r"hplan\.\w+[\w.{}]*$", str(node.value)):
            names = [str(node.value)]
        for name in names:
            parts = name.split(".")
            if parts[0] == "hplan" and len(parts) > 1 and parts[1] in ROOMS:
                yield parts[1]


def test_rooms_are_those_listed() -> None:
    assert set(rooms()) == set(ROOMS)
    assert {path.name for path in PACKAGE.glob("*.py")} == {"__init__.py"}


@pytest.mark.parametrize("room", rooms())
def test_room_imports_only_rooms_below(room: str) -> None:
    allowed = set(ROOMS[: ROOMS.index(room) + 1])
    files = sorted((PACKAGE / room).rglob("*.py"))
    upward = [(path.name, name) for path in files for name in imported(path) if name not in allowed]
    assert upward == []


@pytest.mark.parametrize("room", rooms())
def test_room_states_its_purpose(room: str) -> None:
    assert ast.get_docstring(ast.parse((PACKAGE / room / "__init__.py").read_text(encoding="utf-8")))


def test_no_modules_import_one_another() -> None:
    """Wherever in the file: an import within a function, or for types alone, is one too."""
    names = {path: ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts) for path in PACKAGE.rglob("*.py")}
    modules = {name.removesuffix(".__init__") for name in names.values()} - {"hplan"}
    graph: dict[str, set[str]] = {}
    for path, name in names.items():
        own, found = name.removesuffix(".__init__"), graph.setdefault(name.removesuffix(".__init__"), set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                found |= {n if (n := f"{node.module}.{a.name}") in modules else node.module for a in node.names}
            elif isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
        graph[own] = (found & modules) - {own}
    listed = sorted(graph.keys() - {"hplan"})
    matrix = np.array([[name in graph[other] for name in listed] for other in listed])
    _, label = connected_components(matrix, directed=True, connection="strong")
    circles = [name for name, number in zip(listed, label, strict=True) if np.count_nonzero(label == number) > 1]
    assert circles == []


def test_no_study_is_imported() -> None:
    assert [path.name for path in chain(PACKAGE.rglob("*.py")) if "studies" in path.read_text(encoding="utf-8")] == []


def test_files_of_tests_have_different_names() -> None:
    """Pytest imports them by name alone: the second of a name is an error, and its tests do not run."""
    names = [path.name for path in Path(__file__).parent.rglob("*.py") if path.name != "__init__.py"]
    assert sorted(names) == sorted(set(names))


def test_quick_tests_are_in_every_room() -> None:
    tests, slow = Path(__file__).parent, (Path(__file__).parent / "slow_tests.txt").read_text().split()
    for room in {*ROOMS, "studies"} - {"errors"}:
        functions = [
            f"{path.relative_to(tests.parent).as_posix()}::{name}"
            for path in (tests / room).glob("test_*.py")
            for name in re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
        ]
        assert len(set(functions) - set(slow)) > 0.3 * len(functions) > 0.0, room
