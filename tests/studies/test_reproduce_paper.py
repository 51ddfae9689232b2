"""The paper, reproduced: its numbers, what its text leaves open, the files that are written."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paper_run import FIGURES, measured_paper
from script_loader import load_script
from studies.paper import measure, random_scenes
from studies.paper.measure import PAPER_DENSE, PAPER_TWO_LEVEL
from studies.paper.plain import carried_back

from hplan.grid import dense_search
from hplan.grid.grid import Grid, Occupancy

script = load_script("reproduce_paper")


@pytest.fixture(scope="module")
def measured() -> Any:
    return measured_paper()


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, measured: Any) -> None:
    monkeypatch.setattr(measure, "measure", lambda *_, **__: measured)


def test_searches_give_the_papers_cost(measured: Any) -> None:
    r, e = measured
    assert r.nodes == 753_571
    assert r.runs["dense"].cost == pytest.approx(145.2149523784, abs=1e-9)
    assert r.runs["dense"].points == PAPER_DENSE.points
    assert 153_900 <= r.runs["dense"].second <= 154_700
    for run in (r.runs["plain"], r.runs["straight"], r.runs["hplan"]):
        assert run.cost <= 145.215 < PAPER_TWO_LEVEL.cost
        assert run.points <= 107
    assert r.runs["plain"].flooded == 0
    assert r.runs["hplan"].total < r.runs["straight"].total < r.runs["plain"].total
    assert (sorted(e.plain.paths), sorted(e.plain.heads)) == (list(range(45, 71)), list(range(45)))
    # Flooding leaves the slices with a path; in those the straight-line searches are the same.
    assert r.without[0] == 45
    assert r.runs["straight"].layers == r.runs["plain"].layers - r.without[1]


def test_link_models(measured: Any) -> None:
    rows = {row["model"]: row for row in measured[0].models}
    assert {
        name: (row["occupied"], row["first_deg"], row["last_deg"], row["points"]) for name, row in rows.items()
    } == {
        "capsule": (128_891, 45, 90, 107),
        "paper": (127_973, 45, 90, 107),
        "rectangle": (127_342, 40, 90, 107),
    }
    assert rows["paper"]["cost_deg"] == pytest.approx(145.2149523784, abs=1e-9)
    assert rows["rectangle"]["cost_deg"] == pytest.approx(143.558098, abs=1e-6)


def test_what_the_text_leaves_open_is_run_each_way(measured: Any) -> None:
    keys = ("model", "slices", "carried", "layers", "second", "sparse_nodes")
    assert [tuple(row[key] for key in keys) for row in measured[0].variants] == [
        ("capsule", "0..70", "path", 146_296, 5_412, 6_291),
        ("capsule", "0..90", "path", 182_991, 6_166, 8_297),
        ("paper", "0..70", "path", 146_818, 5_414, 6_425),
        ("paper", "0..90", "path", 183_757, 6_169, 8_415),
        ("capsule", "0..70", "first waypoint", 146_296, 2_227, 3_005),
        ("capsule", "0..90", "first waypoint", 182_991, 3_806, 5_011),
        ("paper", "0..70", "first waypoint", 146_818, 2_229, 3_005),
        ("paper", "0..90", "first waypoint", 183_757, 3_818, 4_995),
    ]
    for row in measured[0].variants:
        cost, points = (145.214952, 107) if row["carried"] == "path" else (169.521325, 148)
        assert (row["cost_deg"], row["points"]) == (pytest.approx(cost, abs=1e-6), points)


def test_the_first_waypoint_alone_can_never_give_the_papers_cost(measured: Any) -> None:
    """Below the first slice with a path only the wrist turns; from the last such node, nothing beats the dense A*."""
    e = measured[1]
    rest = dense_search(e.occupancy, np.array([0, 0, 44]), e.goal)
    assert 44 + math.degrees(rest.cost) == pytest.approx(169.521325, abs=1e-6)


def test_the_first_waypoint_alone_is_a_column_cut_before_contact() -> None:
    grid = Grid.over((0.0, 0.0, 0.0), (3.0, 3.0, 5.0), 1.0)
    occupied = np.zeros(grid.shape, dtype=np.bool_)
    occupied[1, 1, 3] = occupied[0, 0, 1] = True
    paths = {4: np.array([[0, 0, 4], [1, 1, 4], [2, 2, 4]])}
    kept = carried_back(Occupancy.from_mask(grid, occupied), paths, 0)
    assert {k: len(v) for k, v in kept.items()} == {3: 1, 2: 1, 1: 0, 0: 0}
    alone = carried_back(Occupancy.from_mask(grid, np.zeros_like(occupied)), paths, 0, "first waypoint")
    assert {k: v.tolist() for k, v in alone.items()} == {k: [[0, 0, k]] for k in range(4)}


def test_workspace_demonstration(measured: Any) -> None:
    r, e = measured
    # 50 steps in x, 40 of them with y, 20 of those with z: no path is shorter, and the sphere need not cost anything.
    assert r.demo["dense"].cost == pytest.approx(20 * math.sqrt(3) + 20 * math.sqrt(2) + 10)
    assert r.demo["dense"].cost <= r.demo["two-level"].cost < 1.05 * r.demo["dense"].cost
    path = e.demo.grid.coordinates(e.demo_result.path)
    assert (np.linalg.norm(path - measure.DEMO_CENTRE, axis=1) > 7.5).all()


@pytest.mark.usefixtures("quick")
def test_command_line_writes_everything(tmp_path: Path, measured: Any, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "paper"
    assert script.main(["--out", str(out), "--scenes", "3"]) == 0
    assert sorted(path.name for path in out.iterdir()) == sorted(
        [*FIGURES, "overview.png", "reproduction.json", "reproduction.md"]
    )
    numbers = json.loads((out / "reproduction.json").read_text())
    assert numbers["runs"]["dense"]["second"] == measured[0].runs["dense"].second
    assert numbers["random_scenes"]["disagree"] == 0
    text = (out / "reproduction.md").read_text()
    assert text.strip() in capsys.readouterr().out
    for needed in (
        "6,605",
        "145.800739",
        "23,500",
        "9.2",
        "5,414",
        "6,169",
        "169.521325",
        "127,342",
        "3 random scenes",
    ):
        assert needed in text


@pytest.mark.usefixtures("quick")
def test_exit_statuses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    compared = random_scenes.compare(12, seed=script.SEED)
    assert (compared.disagree, 0 < compared.with_path < 12) == (0, True)
    monkeypatch.setattr(random_scenes, "compare", lambda *_: replace(compared, disagree=1))
    assert script.main(["--out", str(tmp_path), "--no-figures", "--scenes", "12"]) == 5
    (tmp_path / "file").write_text("kept")
    for options in (["--out", str(tmp_path / "file")], ["--scenes", "-1", "--out", str(tmp_path / "new")]):
        assert script.main(options) == 2
    assert not (tmp_path / "new").exists()
    assert "--scenes" in capsys.readouterr().err
