"""The examples in `scripts/examples`, each run as a newcomer would run it."""

from __future__ import annotations

import ast
import html
import importlib.metadata
import json
import runpy
from pathlib import Path
from typing import Any

import pytest
from small_tree import TREE

import hplan

MEASURED = Path(__file__).resolve().parents[2] / "shared" / "data" / "measured_trees"
EXAMPLES = Path(__file__).resolve().parents[1] / "scripts" / "examples"


def run(name: str, *arguments: Any, **options: Any) -> Any:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"](*arguments, **options)


def test_plan_and_export(tmp_path: Path) -> None:
    result = run("plan_and_export", str(tmp_path / "new"))
    assert result.certificate.verified
    assert hplan.read_csv(tmp_path / "new" / "trajectory.csv").samples == result.trajectory.samples
    assert (tmp_path / "new" / "scene.html").stat().st_size > 100_000


def test_cloud_from_file(tmp_path: Path) -> None:
    made_up = run("cloud_from_file")
    assert made_up.certificate.verified
    file = tmp_path / "cloud.xyz"
    file.write_text("2.5 0 1.9\n2.5 0.1 1.9\n")
    assert run("cloud_from_file", str(file)).trajectory.duration <= made_up.trajectory.duration


def test_replan_moving_obstacle() -> None:
    assert all(result.certificate.verified for result in run("replan_moving_obstacle", 3))


def test_picking_tour() -> None:
    result = run("picking_tour")
    assert sorted(result.order) == ["fruit 01", "fruit 04", "fruit 09"]
    assert set(result.dropped) == set(result.order)
    assert result.certificate.verified


def needs_robot_data() -> None:
    try:
        importlib.metadata.version("example-robot-data")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed (extra `robots`)")


def test_time_ur5_path() -> None:
    needs_robot_data()
    trajectory = run("time_ur5_path")
    assert trajectory.joint_names[0] == "shoulder_pan_joint"
    assert 1.0 < trajectory.duration < 10.0


def test_control_loop() -> None:
    pytest.importorskip("mujoco", reason="the extra `execution` is not installed")
    log = run("control_loop", 4.2, deadline_s=None)
    assert log.picked[0] == "fruit 01"
    assert log.frames == 42
    assert log.stops >= 1
    assert log.contacts == ()
    assert log.farthest_off_rad < 0.0002  # the tracking error that the certificates cover


def test_control_loop_among_limbs_that_bend(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="the extra `execution` is not installed")
    (tmp_path / "tree.csv").write_text(TREE)
    example = runpy.run_path(str(EXAMPLES / "control_loop.py"))
    scene = example["tree_in_front"](tmp_path / "tree.csv", 1.2, "orchard_harvester")
    log = example["main"](3.2, scene=scene, deadline_s=None, bending=True)
    assert log.picked == ["fruit 2"]
    assert log.left == []
    assert log.trees.broken == log.trees.knocked_off == log.contacts == ()
    assert log.trees.limb_force_n <= log.trees.wood.contact_force
    assert log.trees.hung == {"fruit 2"}  # on the shoot that bends
    assert 0.0 < log.farthest_off_rad < 0.0003  # the tracking error that the certificates cover


def test_panda_shelf(capsys: pytest.CaptureFixture[str]) -> None:
    needs_robot_data()
    result = run("panda_shelf")
    assert result.certificate.verified
    assert result.trajectory.duration < 2.0
    assert "is 20.8 mm deep in obstacle 'upper board'" in capsys.readouterr().out


def test_ur5_picking(tmp_path: Path) -> None:
    needs_robot_data()
    measured = MEASURED / "p42.csv"
    tree = str(measured) if measured.is_file() else None
    result = run("ur5_picking", tree, str(tmp_path / "new"), 2)
    assert len(result.order) == 2
    assert set(result.dropped) == set(result.order)
    assert result.certificate.verified
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"tour.csv", "tour.json", "scene.html"}


def test_pick_row(tmp_path: Path) -> None:
    (tmp_path / "tree.csv").write_text(TREE)
    result = run("pick_row", str(tmp_path / "tree.csv"), 0.8)
    assert 0 < len(result.picked) <= 8


def test_arm_study(tmp_path: Path) -> None:
    (tmp_path / "tree.csv").write_text(TREE)
    result = run("arm_study", str(tmp_path / "tree.csv"), str(tmp_path / "rows.csv"), workers=1)
    assert len(result.rows) == 12
    assert 0.0 < max(choice.share for choice in result.choices) < 1.0


def test_first_motion_notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cells run in order; the value of each last line is displayed.

    Values are displayed as pages or pictures.
    """
    pytest.importorskip("matplotlib", reason="the extra `figures` is not installed")
    monkeypatch.chdir(tmp_path)
    cells = json.loads((EXAMPLES / "first_motion.ipynb").read_text(encoding="utf-8"))["cells"]
    space: dict[str, Any] = {}
    pages, pictures = [], []
    for cell in cells:
        tree = ast.parse("".join(cell["source"]) if cell["cell_type"] == "code" else "")
        last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, "cell", "exec"), space)
        value = eval(compile(ast.Expression(last.value), "cell", "eval"), space) if isinstance(last, ast.Expr) else None
        shown = {kind: getattr(value, f"_repr_{kind}_", lambda: None)() for kind in ("html", "png")}
        pages += [shown["html"]] if shown["html"] else []
        pictures += [shown["png"]] if shown["png"] else []
    assert [cell for cell in cells if cell.get("outputs")] == []
    assert len(pages) == 3
    assert all(html.unescape(page).count("<!DOCTYPE html>") == 1 for page in pages)
    assert [picture[:8] for picture in pictures] == [b"\x89PNG\r\n\x1a\n"]
    assert space["around"].certificate.verified
    assert hplan.read_csv(tmp_path / "motion.csv").samples == space["around"].trajectory.samples


def test_two_arms() -> None:
    assert run("two_arms").certificate.verified


def test_finish_a_path(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = run("finish_a_path")
    assert "190 mm deep in obstacle 'ball'" in capsys.readouterr().out
    hplan.write_csv(result.trajectory, tmp_path / "path.csv")
    assert run("finish_a_path", str(tmp_path / "path.csv")).certificate.verified


def test_design_an_arm(tmp_path: Path) -> None:
    result = run("design_an_arm", str(tmp_path / "new.urdf"))
    assert result.certificate.verified
    assert hplan.load_robot(tmp_path / "new.urdf").dof == 4


def test_every_example_is_run() -> None:
    names = {path.stem for path in EXAMPLES.glob("*.py")}
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert names <= tested
