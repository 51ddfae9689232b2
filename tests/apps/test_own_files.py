"""Foreign or changed files are not replaced without `--force`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import hplan
from hplan.apps.cli.main import main
from hplan.apps.cli.own_files import is_own

PLAN = ["plan", "--effort", "quick", "--quiet"]
WAY = "base_yaw,shoulder,elbow,wrist\n0,0.3,0.3,0.3\n0,0.4,0.3,0.5\n"


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished plan's folder."""
    path = tmp_path_factory.mktemp("own") / "out"
    assert main([*PLAN, "--out", str(path)]) == 0
    return path


@pytest.fixture
def out(done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "way.csv").write_text(WAY)
    return shutil.copytree(done, tmp_path / "out")


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_job_replaces_its_own_files(out: Path) -> None:
    assert all(map(is_own, out.iterdir()))
    assert main([*PLAN, "--out", "out"]) == 0
    assert main(["view", "out", "--no-serve", "--quiet"]) == 0
    assert main([*PLAN, "--out", "out"]) == 0


@pytest.mark.parametrize("name", ["report.json", "trajectory.csv", "scene.html"])
@pytest.mark.parametrize("how", ["by hand", "changed", "alone"])
def test_job_replaces_nothing_of_others(name: str, how: str, out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (out / name).read_text()
    if how == "alone":
        for other in out.iterdir():
            other.unlink()
    by_hand = '{"status": "ok", "by": "hand"}' if name == "report.json" else "time_s,a_pos_rad\n0,0\n"
    changed = text.replace('"hplan-report/1"', '"mine/1"') if name == "report.json" else text.replace("0", "1", 1)
    (out / name).write_text(changed if how == "changed" else by_hand)
    before = contents(out)
    assert main([*PLAN, "--out", "out"]) == 2
    assert f"{name}: hplan did not write it" in capsys.readouterr().err.replace("\n", " ")
    assert contents(out) == before
    assert main([*PLAN, "--out", "out", "--force"]) == 0
    assert json.loads((out / "report.json").read_text())["status"] == "ok"
    assert all(map(is_own, out.iterdir()))


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["orchard", "--trees", "1", "--fruits", "3"], "row.yaml"),
        (["time", "harvester", "way.csv"], "timed.csv"),
        (["certify", "out", "--report"], "certificate.json"),
        (["view", "out", "--no-serve"], "page.html"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else value,
)
def test_single_files(words: list[str], name: str, out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [*words, *(["--out"] if words[-1] != "--report" else []), name, "--quiet"]
    for _ in range(2):
        assert main(words) == 0
        assert is_own(Path(name))
    text = Path(name).read_text()
    digit = next(digit for digit in "123456789" if digit in text)
    others = ["# by hand\n", "", text.replace('"format"', '"shape"').replace('"hplan":', '"other":')]
    if name != "certificate.json":
        others[-1] = text.replace(digit, "0" + digit, 1)
    for other in others:
        Path(name).write_text(other)
        assert main(words) == 2
        assert f"{name}: hplan did not write it" in capsys.readouterr().err.replace("\n", " ")
        assert Path(name).read_text() == other
    assert main([*words, "--force"]) == 0
    assert is_own(Path(name))
    del out


def test_optional_file_of_others_is_found_before_it_is_replaced(out: Path) -> None:
    (out / "cspace.html").write_text("mine")
    assert main([*PLAN, "--out", "out"]) == 0  # it is not written
    assert main([*PLAN, "--out", "out", "--cspace"]) == 2
    assert (out / "cspace.html").read_text() == "mine"
    assert not (out / "trajectory.csv").exists()


def test_tour_leaves_legs_of_others(tmp_path: Path) -> None:
    words = ["tour", "--fruits", "fruit 01", "--csv", "each", "--out", str(tmp_path), "--quiet"]
    assert main(words) == 0
    (tmp_path / "tour-99-mine.csv").write_text("mine")
    assert main(words) == 0
    assert (tmp_path / "tour-99-mine.csv").read_text() == "mine"
    (leg,) = tmp_path.glob("tour-01-*.csv")
    leg.write_text("mine")
    assert main(words) == 2
    assert leg.read_text() == "mine"


def test_changed_file_of_one_arm_is_not_replaced(tmp_path: Path) -> None:
    """The changed file has the bytes that hplan would write; only the report shows that they are not its own."""
    arms = "".join(
        f"- {{name: {name}, robot: orchard_harvester, position: [0, {y}, 0], start: {{joints_deg: [0, 60, 20, 20]}}, "
        "goal: {joints_deg: [10, 60, 20, 20]}}\n"
        for name, y in (("left", 0), ("right", -4))
    )
    scene = tmp_path / "cell.yaml"
    scene.write_text(f"format: hplan-scene/1\nname: c\nrobots:\n{arms}")
    words = ["plan", str(scene), "--effort", "quick", "--out", str(tmp_path / "out"), "--quiet"]
    assert main(words) == 0
    assert main(words) == 0
    path = tmp_path / "out" / "trajectory-left.csv"
    motion = hplan.read_csv(path)
    mine = hplan.write_csv(motion.cut_after(motion.samples - 2), path).read_bytes()
    assert main(words) == 2
    assert path.read_bytes() == mine
    assert main([*words, "--force"]) == 0
    assert path.read_bytes() != mine


def test_rows_of_others_are_not_cut(tmp_path: Path) -> None:
    """Not even the last line, which has no end."""
    from hplan.study.run import run_study

    (tmp_path / "tree.csv").write_text("kind,x1,y1,z1,x2,y2,z2,radius\ntrunk,0,0,0,0,0,2,0.04\n")
    (tmp_path / "study.yaml").write_text("name: one\narms: [harvester]\ntrees: [tree.csv]\n")
    (tmp_path / "rows.csv").write_text("a,b\n1,2\n3,4")
    with pytest.raises(hplan.HplanError, match="not the table of a study"):
        run_study(tmp_path / "study.yaml", tmp_path / "rows.csv", workers=1)
    assert (tmp_path / "rows.csv").read_text() == "a,b\n1,2\n3,4"
