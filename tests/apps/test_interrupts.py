"""Signals at chosen and random instants of commands: reports stay, no files are lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from studies.interrupts import COMMANDS, interrupt

from hplan.apps.cli.main import main
from hplan.base.interrupts import SignalError, handling_signals, uninterrupted

#: Ends `hplan plan` by a signal when a function is called, in a process of its own.
WHEN = """
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGTERM, signal.SIG_DFL)
from importlib import import_module
from hplan.apps.cli.main import main
module, name = import_module({module!r}), {name!r}
def ended(*given, **named):
    os.kill(os.getpid(), {number})
    time.sleep(0.05)
    return was(*given, **named)
def patch():
    global was
    was = getattr(module, name)
    setattr(module, name, ended)
patch()
sys.argv = ["hplan", "plan", "--quiet", "--effort", "quick", "--out", {out!r}]
sys.exit(main())
"""
STAGES = [
    ("hplan.apps.cli.plan", "plan_options"),
    ("hplan.scene.file", "load_scene"),
    ("hplan.planning.plan", "plan"),
    ("hplan.planning.solver", "quickest"),
    ("hplan.trajectory.trajectory", "write_csv"),
    ("hplan.apps.view.page", "render_page"),
    ("hplan.planning.report", "write_report"),
    ("hplan.apps.cli.job_folder", "digests_of"),
]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("module", "name"), STAGES, ids=lambda value: value)
def test_an_interrupted_plan_leaves_its_report(module: str, name: str, number: signal.Signals, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    code = WHEN.format(module=module, name=name, number=int(number), out=str(out))
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    said = "interrupted\n" if number == signal.SIGINT else "ended by SIGTERM\n"
    assert (ended.returncode, ended.stderr) == (128 + number, said)
    report = json.loads((out / "report.json").read_text())
    assert (report["status"], report["signal"]) == ("interrupted", number.name)
    assert {path.name for path in out.iterdir()} == {"notes.txt", "report.json"}


@pytest.mark.parametrize("number", range(len(COMMANDS)))
def test_a_signal_at_a_random_instant(number: int) -> None:
    """One for each command; `scripts/benchmark.py interrupts` sends 200."""
    row = interrupt(list(COMMANDS)[number], 77_000 + number)
    assert not row["fault"], row


def test_an_earlier_job_that_is_read_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command's input is in its output folder."""
    words = ["plan", "--effort", "quick", "--quiet", "--out", str(tmp_path)]
    assert main(words) == 0
    before = (tmp_path / "trajectory.csv").read_bytes()

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hplan.scene.file.load_scene", interrupted)
    way = str(tmp_path / "trajectory.csv")
    assert main(["time", "harvester", way, "--scene", "table-1", "--out", str(tmp_path), "--quiet"]) == 130
    assert (tmp_path / "trajectory.csv").read_bytes() == before
    assert main(words) == 130
    assert not (tmp_path / "trajectory.csv").exists()
    assert json.loads((tmp_path / "report.json").read_text())["status"] == "interrupted"


# Places of the signal


@pytest.fixture(autouse=True)
def usual_handlers() -> object:
    """The signal handlers of a foreground program."""
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


def spin(seconds: float = 5.0) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass


def test_a_signal_waits_for_the_end_of_what_must_not_be_cut() -> None:
    done = []

    def work() -> None:
        with uninterrupted():
            os.kill(os.getpid(), signal.SIGTERM)
            spin(0.05)
            done.append("whole")
        spin()
        done.append("late")

    with handling_signals(), pytest.raises(SignalError):
        work()
    assert done == ["whole"]


@pytest.mark.parametrize("module", ["numba.core.dispatcher", "llvmlite.binding.ffi", "hplan.base.kernels", "importlib"])
def test_a_signal_waits_for_a_compiler_and_for_imports(module: str) -> None:
    done: list[str] = []
    code = "def compiled():\n    kill()\n    spin(0.05)\n    done.append('whole')\n"
    place = {"__name__": module, "kill": lambda: os.kill(os.getpid(), signal.SIGINT), "spin": spin, "done": done}
    exec(code + "def work():\n    compiled()\n", place)

    def work() -> None:
        place["work"]()  # type: ignore[operator]
        spin()
        done.append("late")

    with handling_signals(), pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["whole"]


def test_a_signal_waits_for_a_destructor() -> None:
    done = []

    class Dying:
        def __del__(self) -> None:
            os.kill(os.getpid(), signal.SIGINT)
            spin(0.05)
            done.append("whole")

    def work() -> None:
        Dying()
        spin()

    with handling_signals(), pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["whole"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
