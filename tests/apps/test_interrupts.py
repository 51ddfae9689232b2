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
from small_tree import TREE

from hplan.apps.cli.main import main
from hplan.base.interrupts import SignalError, defer_signals, handling_signals

#: Ends an hplan command by a signal when a function is called, in a process of its own.
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
sys.argv = ["hplan", *{words!r}]
sys.exit(main())
"""
#: Two arms, far from each other.
CELL = """\
format: hplan-scene/1
name: two
robots:
- name: left
  start: {joints_deg: [-40, 60, 60, 60]}
  goal: {joints_deg: [40, 60, 60, 60]}
- name: right
  position: [3, 0, 0]
  start: {joints_deg: [0, 90, 90, 90]}
  goal: {joints_deg: [20, 80, 90, 90]}
"""

#: Functions at whose call a plan is interrupted.
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


def end_command(words: list[str], module: str, name: str, number: signal.Signals) -> None:
    """Run a command that a signal ends, and check its exit."""
    code = WHEN.format(module=module, name=name, number=int(number), words=words)
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    message = "interrupted\n" if number == signal.SIGINT else "ended by SIGTERM\n"
    assert (ended.returncode, ended.stderr) == (128 + number, message)


#: Both signals, in turn.
ENDS = [(*stage, (signal.SIGINT, signal.SIGTERM)[number % 2]) for number, stage in enumerate(STAGES)]


@pytest.mark.parametrize(("module", "name", "number"), ENDS, ids=lambda value: str(value))
def test_interrupted_plan_leaves_its_report(module: str, name: str, number: signal.Signals, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    end_command(["plan", "--quiet", "--effort", "quick", "--out", str(out)], module, name, number)
    report = json.loads((out / "report.json").read_text())
    assert (report["status"], report["signal"]) == ("interrupted", number.name)
    assert {path.name for path in out.iterdir()} == {"notes.txt", "report.json"}


@pytest.mark.parametrize(
    ("words", "module", "name", "report"),
    [
        ("tour --csv each", "hplan.apps.cli.job_folder", "digests_of", "tour.json"),
        ("plan cell.yaml --effort quick", "hplan.apps.cli.job_folder", "digests_of", "report.json"),
        (
            "time harvester way.csv --scene table-1 --effort quick",
            "hplan.apps.cli.job_folder",
            "digests_of",
            "report.json",
        ),
        ("row row.yaml --distance 1.2 --step 1.1 --effort quick", "hplan.tour.row", "plan_row", "row.json"),
        ("study study.yaml", "hplan.study.run", "run_study", "study.json"),
    ],
)
def test_interrupted_command_leaves_its_report(words: str, module: str, name: str, report: str, inputs: Path) -> None:
    """The folder has the report and the files of others, and no part of a file."""
    end_command([*words.split(), "--quiet", "--out", "out"], module, name, signal.SIGTERM)
    assert json.loads((inputs / "out" / report).read_text())["status"] == "interrupted"
    assert {path.name for path in (inputs / "out").iterdir()} == {"notes.txt", report}


@pytest.fixture
def inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the inputs of all commands, and a file of the user."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    (tmp_path / "way.csv").write_text("base_yaw,shoulder,elbow,wrist\n0,0.3,0.3,0.3\n0,0.4,0.3,0.5\n")
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "tree.csv").write_text(TREE)
    (tmp_path / "study.yaml").write_text("name: one\narms: [orchard_harvester]\ntrees: [tree.csv]\ndistances: [1.2]\n")
    words = "orchard --import tree.csv --distance 1.2 --robot orchard_harvester --yield 0.02 --out row.yaml --quiet"
    assert main(words.split()) == 0
    return tmp_path


def test_earlier_job_that_is_an_input_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_signal_waits_for_the_end_of_uninterrupted_block() -> None:
    done = []

    def work() -> None:
        with defer_signals():
            os.kill(os.getpid(), signal.SIGTERM)
            spin(0.05)
            done.append("whole")
        spin()
        done.append("late")

    with handling_signals(), pytest.raises(SignalError):
        work()
    assert done == ["whole"]


@pytest.mark.parametrize("module", ["numba.core.dispatcher", "llvmlite.binding.ffi", "hplan.base.kernels", "importlib"])
def test_signal_waits_for_compiler_and_imports(module: str) -> None:
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


def test_signal_waits_for_destructor() -> None:
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
