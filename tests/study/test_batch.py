"""Plans for many scene files."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from hplan import PlanOptions, load_scene, plan, read_csv, run_batch, save_scene
from hplan.apps.cli.main import main
from hplan.errors import InputError, OptionError, SceneError
from hplan.robot.model import load_robot
from hplan.scene import Sphere
from hplan.study import batch

QUICK = PlanOptions(effort="quick")


@pytest.fixture
def scenes(tmp_path: Path) -> list[Path]:
    """A scene with a motion, one whose start is blocked, and one that is malformed."""
    free, blocked, malformed = (tmp_path / f"{name}.yaml" for name in ("free", "blocked", "malformed"))
    scene = load_scene("trellis")
    save_scene(scene, free)
    tool = load_robot().forward_kinematics(scene.start.configuration)[:3, 3]
    ball = Sphere(name="ball", center=tuple(tool.tolist()), radius=0.05)
    save_scene(scene.with_values(obstacles=(*scene.obstacles, ball)), blocked)
    malformed.write_text("name: [")
    return [free, blocked, malformed]


def test_batch_reports_each_scene_and_its_error(scenes: list[Path], tmp_path: Path) -> None:
    table, motions = tmp_path / "batch.csv", tmp_path / "motions"
    rows = run_batch(scenes, QUICK, rows=table, trajectories=motions, workers=1)
    assert [row.scene for row in rows] == list(map(str, scenes))
    assert [row.status for row in rows] == ["ok", "ConfigurationInCollisionError", "SceneError"]
    assert [row.exit_status for row in rows] == [0, 2, 2]
    free, blocked, _ = rows
    expected = plan(load_robot(), load_scene(scenes[0]), QUICK)
    assert free.duration_s == expected.trajectory.duration
    assert free.verified
    assert free.min_clearance_m == expected.certificate.min_clearance_m
    assert read_csv(motions / free.trajectory).duration == pytest.approx(free.duration_s)
    assert blocked.duration_s is None
    assert "ball" in blocked.error
    with table.open(newline="") as file:
        assert [row["status"] for row in csv.DictReader(file)] == [row.status for row in rows]


def test_batch_resumes_from_its_table(scenes: list[Path], tmp_path: Path) -> None:
    table, done = tmp_path / "batch.csv", []
    first = run_batch(scenes[:1], QUICK, rows=table, workers=1)
    rows = run_batch(scenes, QUICK, rows=table, workers=1, progress=lambda *numbers: done.append(numbers))
    assert done == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert rows[0] == first[0]
    assert len(table.read_text().splitlines()) == 4


def test_batch_loads_each_scene_once(scenes: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[Path | str] = []
    monkeypatch.setattr(batch, "load_scene", lambda path: (loaded.append(path), load_scene(path))[1])
    run_batch(scenes, QUICK, workers=1)
    assert loaded == scenes


def test_batch_plans_again_after_a_change_of_scene_or_options(scenes: list[Path], tmp_path: Path) -> None:
    table, free = tmp_path / "batch.csv", scenes[0]
    (first,) = run_batch([free], QUICK, rows=table, workers=1)
    save_scene(load_scene(free).with_values(clearance=0.004), free)
    (second,) = run_batch([free], QUICK, rows=table, workers=1)
    (third,) = run_batch([free], QUICK.with_values(speed=0.5), rows=table, workers=1)
    assert len({first.digest, second.digest, third.digest}) == 3
    assert third.duration_s > second.duration_s


def test_batch_writes_a_missing_trajectory_again(scenes: list[Path], tmp_path: Path) -> None:
    table, motions = tmp_path / "batch.csv", tmp_path / "motions"
    (first,) = run_batch(scenes[:1], QUICK, rows=table, trajectories=motions, workers=1)
    (motions / first.trajectory).unlink()
    (second,) = run_batch(scenes[:1], QUICK, rows=table, trajectories=motions, workers=1)
    assert (motions / second.trajectory).is_file()


def test_batch_refuses_no_scenes_and_a_scene_given_twice(scenes: list[Path]) -> None:
    for given in ([], [scenes[0], scenes[0]], scenes[0]):
        with pytest.raises(OptionError):
            run_batch(given, QUICK, workers=1)
    with pytest.raises(SceneError, match=r"missing\.yaml"):
        run_batch([scenes[0], "missing.yaml"], QUICK, workers=1)


def test_batch_leaves_the_table_of_another_program_unchanged(scenes: list[Path], tmp_path: Path) -> None:
    table = tmp_path / "other.csv"
    table.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="not the table of a batch"):
        run_batch(scenes[:1], QUICK, rows=table, workers=1)
    assert table.read_text() == "a,b\n1,2\n"


def test_batch_command_prints_a_table_and_exits_with_6_if_a_scene_fails(
    scenes: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "batch.csv"
    status = main(["batch", *map(str, scenes[:2]), "--effort", "quick", "--jobs", "1", "--out", str(table)])
    assert status == 6
    printed = capsys.readouterr().out
    assert "1 of 2 scenes have a certified motion" in printed
    assert "ball" in printed
