from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from any_arms import loaded_arm
from hypothesis import settings
from toy_urdf import urdf

from hplan.apps.cli.compile_ahead import compile_from_postprocessing_on, is_first_run
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.scene.model import Scene
from hplan.trajectory.timing import read_kinematics

# The same examples in every run, and no limit on the time of one: the first compiles kernels.
settings.register_profile("hplan", derandomize=True, deadline=None)
settings.load_profile("hplan")

#: Functions of tests whose cases take longer than this in all, kernels being compiled [s of CPU]; a line names each.
SLOW_S, SLOW = 0.25, Path(__file__).with_name("slow_tests.txt")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--note-slow", action="store_true", help=f"write {SLOW.name} anew, of the tests that run (-n 0)")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--note-slow"):
        config.pluginmanager.register(NoteSlow())


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark all tests as quick, except the listed ones."""
    slow = set(SLOW.read_text(encoding="utf-8").split())
    for item in items:
        if item.nodeid.partition("[")[0] not in slow:
            item.add_marker("quick")


class NoteSlow:
    """Writes down which tests are slow."""

    def __init__(self) -> None:
        self.spent: Counter[str] = Counter()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        begin = time.process_time() + sum(os.times()[2:4])
        done = yield
        self.spent[item.nodeid.partition("[")[0]] += time.process_time() + sum(os.times()[2:4]) - begin
        return done

    def pytest_sessionfinish(self) -> None:
        before = set(SLOW.read_text(encoding="utf-8").split()) - set(self.spent)
        now = {name for name, seconds in self.spent.items() if seconds > SLOW_S}
        SLOW.write_text("".join(f"{name}\n" for name in sorted(before | now)), encoding="utf-8")


def pytest_sessionstart() -> None:
    """Compile kernels in two workers if none are cached.

    The second worker starts with the kernels that the first one needs last.
    """
    if os.environ.get("PYTEST_XDIST_WORKER") == "gw1" and is_first_run():
        compile_from_postprocessing_on()


@pytest.fixture(scope="session", autouse=True)
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Run each test in a folder of its own.

    Files without a folder's name are then not written into the clone.
    """
    before = Path.cwd()
    os.chdir(tmp_path_factory.mktemp("elsewhere"))
    yield
    os.chdir(before)


@pytest.fixture(scope="session")
def robot() -> Robot:
    """The harvester that ships with hplan."""
    return load_robot()


@pytest.fixture
def picker(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Six axes with a tool of some length."""
    return loaded_arm("picker", tmp_path_factory)


@pytest.fixture(scope="session")
def scene() -> Scene:
    """The reference scene, Table 1 of the paper."""
    return load_scene()


@pytest.fixture
def write(tmp_path):
    def write(name: str, text: str) -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


@pytest.fixture
def toy(write):
    return read_kinematics(write("toy.urdf", urdf()))[0]
