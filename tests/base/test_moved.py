"""Import paths of earlier versions."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

from hplan.base.moved import MOVED, present_name


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
