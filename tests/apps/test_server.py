"""The live view's server: reached from this machine alone, never in the way, gone with whoever started it."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

import hplan
from hplan.apps.view import page
from hplan.apps.view.page import LiveView, serve
from hplan.apps.view.playback import Playback
from hplan.errors import HplanError
from hplan.trajectory.trajectory import Trajectory

SERVE = """
import signal, sys, numpy as np
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which it is not where the tests run under nohup
from hplan.robot.model import load_robot
from hplan.scene.file import load_scene
from hplan.trajectory.trajectory import Trajectory
from hplan.apps.view.page import serve
from hplan.apps.view.playback import Playback
row = np.zeros((1, 4))
robot = load_robot()
view = serve(robot, load_scene(), Playback(Trajectory(robot.joint_names, np.zeros(1), row, row, row, row)))
print(view.url, view._process.pid, flush=True)
view.wait()
"""


@pytest.fixture
def view() -> Iterator[LiveView]:
    robot, scene = hplan.load_robot(), hplan.load_scene()
    row = scene.start.configuration[None]
    with serve(robot, scene, Playback(Trajectory(robot.joint_names, [0.0], row, 0 * row, 0 * row, 0 * row))) as view:
        yield view


def accepts(host: str, port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection((host, port), timeout=5):
        return True
    return False


def gone(pid: int, patience_s: float = 20.0) -> bool:
    """Whether a process ends; a zombie has."""
    until = time.monotonic() + patience_s
    while time.monotonic() < until:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except FileNotFoundError:
            return True
        time.sleep(0.05)
    return False


def test_listens_on_this_machines_own_address_alone(view: LiveView) -> None:
    """A server that listens on all interfaces answers at 127.0.0.2 too."""
    address = urlsplit(view.url)
    assert address.hostname == "127.0.0.1"
    assert address.port is not None
    assert accepts("127.0.0.1", address.port)
    assert not accepts("127.0.0.2", address.port)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM], ids=lambda number: number.name)
def test_ends_with_its_parent(how: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "threading.py").write_text("raise SystemExit('a module of the working directory was run')")
    parent = subprocess.Popen([sys.executable, "-P", "-c", SERVE], stdout=subprocess.PIPE, cwd=tmp_path, text=True)
    try:
        assert parent.stdout is not None
        url, pid = parent.stdout.readline().split()
        with urllib.request.urlopen(url, timeout=10) as answer:
            assert answer.status == 200
        parent.send_signal(how)
        parent.wait(20)
        assert gone(int(pid))
    finally:
        parent.kill()
        parent.communicate()


def test_an_interrupt_at_the_terminal_is_not_the_servers(view: LiveView) -> None:
    os.kill(view._process.pid, signal.SIGINT)
    with urllib.request.urlopen(view.url, timeout=10) as answer:
        assert answer.status == 200


@pytest.mark.parametrize(
    ("command", "said"),
    [(page.python_module("hplan.nothing"), "No module named hplan.nothing"), (["sleep", "600"], "it says nothing")],
    ids=["ends", "hangs"],
)
def test_a_server_that_does_not_start(command: list[str], said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "python_module", lambda _: command)
    monkeypatch.setattr(page, "START_S", 60.0 if "-m" in command else 0.5)
    robot, row = hplan.load_robot(), [[0.0] * 4]
    with pytest.raises(HplanError, match=f"the page's server does not start: .*{said}"):
        serve(robot, hplan.load_scene(), Playback(Trajectory(robot.joint_names, [0.0], row, row, row, row)))
