from __future__ import annotations

import io
import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paper_run import FIGURES, measured_paper
from PIL import Image
from rich.console import Console
from script_loader import load_script
from studies.paper import measure, random_scenes, tables
from studies.paper.demonstration import DEMO_CENTRE
from studies.paper.plain import carried_back
from studies.paper.results import PAPER

from hplan.search import dense_search
from hplan.search.grid import Grid, Occupancy

script = load_script("reproduce_paper")


@pytest.fixture(scope="module")
def compared() -> random_scenes.SearchComparison:
    return random_scenes.compare(12, seed=script.SEED)


@pytest.fixture(scope="module")
def measured() -> Any:
    return measured_paper()


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, measured: Any) -> None:
    monkeypatch.setattr(measure, "measure", lambda *_, **__: measured[:2])


def test_dense_is_the_papers(measured: Any) -> None:
    r = measured[0]
    assert r.nodes == 753_571
    assert r.dense.cost == pytest.approx(145.2149523784, abs=1e-9)
    assert r.dense.points == 107
    assert 153_900 <= r.dense.path_expansions <= 154_700


def test_two_levels_to_the_letter(measured: Any) -> None:
    r, e, _ = measured
    assert r.plain.cost <= 145.215
    assert r.plain.points <= 107
    assert 5_000 < r.plain.path_expansions < 6_605
    assert 146_000 <= r.plain.layer_expansions <= 147_000
    assert r.plain.flooded == 0
    assert r.plain.total_expansions == r.plain.layer_expansions + r.plain.path_expansions
    assert sorted(e.plain.paths) == list(range(45, 71))
    assert sorted(e.plain.heads) == list(range(45))


def test_hplan_finds_the_same_cost_with_less(measured: Any) -> None:
    r = measured[0]
    for run in (r.straight, r.hplan):
        assert run.cost <= 145.215
        assert run.points <= 107
        assert run.total_expansions < r.plain.total_expansions


def test_what_is_taken_from_open_lists_is_told_apart(measured: Any) -> None:
    r = measured[0]
    assert 0 < r.hplan.settled < r.hplan.path_expansions
    assert {run.settled for run in (r.dense, r.plain, r.straight)} == {0}
    # Flooding leaves the slices with a path; in those the straight-line searches are the same.
    assert r.straight.layer_expansions == r.plain.layer_expansions - r.gap.expansions_without
    rows = {row[0].strip(): row[1:] for row in tables.comparison_rows(r)[1]}
    assert rows["second level: nodes"][-1] == f"{r.hplan.path_expansions - r.hplan.settled:,}"
    assert rows["second level: rows"][-1] == f"{r.hplan.settled:,}"
    assert rows["layers: jump points"] == ("-", "-", "-", f"{r.hplan.layer_expansions:,}")
    assert rows["layers: nodes"][-1] == "-"


def test_link_models(measured: Any) -> None:
    rows = {row.link_model: row for row in measured[0].models}
    assert {name: row.occupied for name, row in rows.items()} == {
        "capsule": 128_891,
        "paper": 127_973,
        "rectangle": 127_342,
    }
    assert {name: (row.first_feasible_deg, row.last_feasible_deg) for name, row in rows.items()} == {
        "capsule": (45, 90),
        "paper": (45, 90),
        "rectangle": (40, 90),
    }
    assert rows["paper"].dense_cost_deg == pytest.approx(145.2149523784, abs=1e-9)
    assert rows["rectangle"].dense_cost_deg == pytest.approx(143.558098, abs=1e-6)
    assert {row.dense_points for row in rows.values()} == {107}


def test_gap(measured: Any) -> None:
    gap = measured[0].gap
    assert (gap.last_without_deg, gap.first_with_deg) == (44, 45)
    assert gap.reached_without < gap.reached_with
    assert (gap.layers_searched, gap.layers_without) == (71, 45)
    assert 93_000 <= gap.expansions_without <= 94_000


def test_ties_bracket_the_papers_two_level_result(measured: Any) -> None:
    ties, paper = measured[0].ties, PAPER
    assert ties.lowest_cost_deg <= paper.two_level_cost_deg <= ties.highest_cost_deg
    assert ties.fewest_points <= paper.two_level_points <= ties.most_points
    assert ties.lowest_cost_deg >= paper.dense_cost_deg - 1e-6


@pytest.mark.parametrize(
    ("link_model", "last_deg", "restoration", "layers", "second", "sparse"),
    [
        ("capsule", 70, "path", 146_296, 5_412, 6_291),
        ("capsule", 90, "path", 182_991, 6_166, 8_297),
        ("paper", 70, "path", 146_818, 5_414, 6_425),
        ("paper", 90, "path", 183_757, 6_169, 8_415),
        ("capsule", 70, "first waypoint", 146_296, 2_227, 3_005),
        ("capsule", 90, "first waypoint", 182_991, 3_806, 5_011),
        ("paper", 70, "first waypoint", 146_818, 2_229, 3_005),
        ("paper", 90, "first waypoint", 183_757, 3_818, 4_995),
    ],
)
def test_what_the_text_leaves_open_is_run_each_way(
    measured: Any, link_model: Any, last_deg: int, restoration: Any, layers: int, second: int, sparse: int
) -> None:
    r = measured[0]
    assert len(r.variants) == 8
    variant = r.variant(last_deg, restoration, link_model)
    assert (variant.layer_expansions, variant.path_expansions, variant.sparse_nodes) == (layers, second, sparse)
    cost, points = (145.214952, 107) if restoration == "path" else (169.521325, 148)
    assert variant.cost_deg == pytest.approx(cost, abs=1e-6)
    assert variant.points == points
    assert variant.ties.choices == 4
    assert variant.ties.most_expansions < PAPER.two_level_expansions


def test_the_plain_run_is_the_first_variant(measured: Any) -> None:
    r = measured[0]
    variant = r.variant(70)
    assert (variant.cost_deg, variant.points) == (r.plain.cost, r.plain.points)
    assert (variant.layer_expansions, variant.path_expansions) == (r.plain.layer_expansions, r.plain.path_expansions)
    assert variant.sparse_nodes == r.sparse_nodes


def test_the_first_waypoint_alone_can_never_give_the_papers_cost(measured: Any) -> None:
    """Below the first slice with a path only the wrist turns; from the last such node, nothing beats the dense A*."""
    r, e, _ = measured
    turned = r.gap.last_without_deg
    rest = dense_search(e.occupancy, np.array([0, 0, turned]), e.goal)
    assert turned + math.degrees(rest.cost) == pytest.approx(169.521325, abs=1e-6)
    for variant in r.variants:
        if variant.restoration == "first waypoint":
            assert variant.ties.lowest_cost_deg >= turned + math.degrees(rest.cost) - 1e-9 > PAPER.two_level_cost_deg


def test_the_first_waypoint_alone_is_a_column_cut_before_contact() -> None:
    grid = Grid.over((0.0, 0.0, 0.0), (3.0, 3.0, 5.0), 1.0)
    occupied = np.zeros(grid.shape, dtype=np.bool_)
    occupied[1, 1, 3] = occupied[0, 0, 1] = True
    occupancy = Occupancy.from_mask(grid, occupied)
    paths = {4: np.array([[0, 0, 4], [1, 1, 4], [2, 2, 4]])}
    assert {k: len(v) for k, v in carried_back(occupancy, paths, 0).items()} == {3: 1, 2: 1, 1: 0, 0: 0}
    paths[4][0] = 0, 1, 4
    assert {k: len(v) for k, v in carried_back(occupancy, paths, 2).items()} == {3: 1, 2: 1}
    occupied[1, 1, 3] = False
    occupancy = Occupancy.from_mask(grid, occupied)
    assert {k: len(v) for k, v in carried_back(occupancy, paths, 0).items()} == dict.fromkeys(range(4), 3)
    alone = carried_back(occupancy, paths, 0, "first waypoint")
    assert {k: v.tolist() for k, v in alone.items()} == {k: [[0, 1, k]] for k in range(4)}


def test_progress_is_reported_step_by_step(measured: Any) -> None:
    assert len(measured[2]) == measure.STEPS


def test_arctan_as_printed_is_not_the_papers_example(measured: Any) -> None:
    link, plane = measured[0].slip_link_frame, measured[0].slip_arm_plane
    assert not link.goal_is_free
    assert link.feasible_slices == 0
    assert link.cost_deg is None
    assert plane.feasible_slices == 91
    assert plane.cost_deg == pytest.approx(136.801416, abs=1e-6)


def test_workspace_demonstration(measured: Any) -> None:
    r, e, _ = measured
    assert r.demo_layers == 21
    # 50 steps in x, 40 of them with y, 20 of those with z: no path is shorter, and the sphere need not cost anything.
    assert r.demo_dense.cost == pytest.approx(20 * math.sqrt(3) + 20 * math.sqrt(2) + 10)
    assert r.demo_dense.cost <= r.demo_two_level.cost < 1.05 * r.demo_dense.cost
    path = e.demo.grid.coordinates(e.demo_result.path)
    np.testing.assert_array_equal(path[[0, -1]], [[5, 10, 5], [55, 50, 25]])
    assert (np.linalg.norm(path - DEMO_CENTRE, axis=1) > 7.5).all()
    assert (np.abs(np.diff(path, axis=0)).max(axis=1) == 1).all()


def test_restored_heads_are_free_and_nested(measured: Any) -> None:
    e = measured[1]
    previous = e.plain.paths[45][:, :2]
    for number in range(44, -1, -1):
        head = e.plain.heads[number]
        assert not e.occupancy.occupied[tuple(head.T)].any()
        np.testing.assert_array_equal(head[:, :2], previous[: len(head)])
        previous = head[:, :2]


def test_report_names_what_is_left_out(measured: Any) -> None:
    r = measured[0]
    text = tables.markdown(r)
    numbers = (
        "6,605",
        "145.800739",
        "2,560",
        "23,500",
        "| 9.2 |",
        "5,414",
        "6,169",
        "169.521325",
        "128,891",
        "127,973",
        "127,342",
        "143.558098",
        f"{r.plain.layer_expansions:,}",
        f"{r.gap.expansions_without:,}",
    )
    for needed in (*numbers, "arctan(x/y)", "Slices.", "Ties.", "Flooding.", "Jump points.", "Bound.", "Restoration."):
        assert needed in text, needed
    for line in text.splitlines():
        if line.startswith("|"):
            assert line.endswith("|")


def test_times_are_compared_as_ratios(measured: Any) -> None:
    r = replace(
        measured[0],
        dense=replace(measured[0].dense, total_ms=50.0),
        plain=replace(measured[0].plain, total_ms=20.0),
        straight=replace(measured[0].straight, total_ms=10.0),
        hplan=replace(measured[0].hplan, total_ms=0.5),
    )
    rows = {row[0].strip(): row[1:] for row in tables.comparison_rows(r)[1]}
    assert rows["dense A*: time [ms]"] == ("23,500", "50.0", "", "")
    assert rows["time, dense / two-level"] == ("9.2", "2.5", "5.0", "100.0")


def test_table_of_what_the_text_leaves_open(measured: Any) -> None:
    header, rows = tables.variant_rows(measured[0])
    assert [len(row) for row in rows] == [len(header)] * 9
    assert [row[0] for row in rows[::2]] == ["0..70, path"] * 2 + ["0..70, first"] * 2 + ["published"]
    assert rows[3][:6] == ("0..90, path", "paper", "145.214952", "107", "183,757", "6,169")
    assert rows[-1] == ("published", "-", "145.800739", "108", "-", "6,605", "-")


def test_report_fits_a_terminal_of_80_columns(measured: Any, compared: random_scenes.SearchComparison) -> None:
    printed = io.StringIO()
    tables.show(measured[0], Console(file=printed, width=80), compared)
    assert "Slices." in printed.getvalue()
    assert "…" not in printed.getvalue()


@pytest.mark.usefixtures("quick")
def test_command_line_writes_everything(tmp_path: Path, measured: Any, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "paper"
    assert script.main(["--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        *FIGURES,
        "overview.png",
        "reproduction.json",
        "reproduction.md",
    ]
    for path in out.glob("*.png"):
        assert path.stat().st_size < 300_000
        with Image.open(path) as image:
            assert image.info["dpi"] == pytest.approx((160, 160), abs=0.1)
            assert image.width >= 1100
    numbers = json.loads((out / "reproduction.json").read_text())
    assert numbers["format"] == "hplan-reproduction/1"
    assert numbers["dense"]["path_expansions"] == measured[0].dense.path_expansions
    assert numbers["paper"]["two_level_time_s"] == 2.56
    assert numbers["paper"]["dense_time_s"] == 23.5
    assert numbers["ties"] == numbers["variants"][0]["ties"]
    printed = capsys.readouterr().out
    assert "What the paper leaves out" in printed
    assert "145.214952" in printed


@pytest.mark.usefixtures("quick")
def test_markdown_goes_to_standard_output(tmp_path: Path, measured: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert script.main(["--out", str(tmp_path), "--no-figures", "--markdown"]) == 0
    assert capsys.readouterr().out == tables.markdown(measured[0])
    assert {path.name for path in tmp_path.iterdir()} == {"reproduction.json", "reproduction.md"}


def test_unwritable_output_is_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(measure, "measure", lambda *_, **__: pytest.fail("measured"))
    blocked = tmp_path / "file"
    blocked.write_text("kept")
    for out in (blocked, blocked / "below"):
        assert script.main(["--out", str(out)]) == 2
        message = capsys.readouterr().err
        assert f"cannot write {out}" in message.replace("\n", "")
    assert blocked.read_text() == "kept"
    assert list(tmp_path.iterdir()) == [blocked]


@pytest.mark.usefixtures("quick")
def test_a_failure_while_writing_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Path, content: bytes) -> int:
        with self.open("wb") as file:
            file.write(content)
        if content.startswith(b"{"):
            raise OSError(28, "No space left on device")
        return len(content)

    monkeypatch.setattr(Path, "write_bytes", full)
    assert script.main(["--out", str(tmp_path), "--no-figures"]) == 2
    assert list(tmp_path.iterdir()) == []


def test_without_matplotlib_nothing_is_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    out = tmp_path / "paper"
    assert script.main(["--out", str(out)]) == 2
    assert "figures need the extra: pip install 'hplan[figures]'" in capsys.readouterr().err
    assert not out.exists()


def test_random_scenes_add_up(compared: random_scenes.SearchComparison) -> None:
    assert (compared.scenes, compared.disagree) == (12, 0)
    assert 0 < compared.with_path < 12
    assert {name for name, count in compared.fallbacks.items() if count} <= {"none", "all_slices", "dense"}
    assert sum(compared.fallbacks.values()) == compared.with_path
    assert compared.ratio_median is not None
    assert compared.ratio_high is not None
    assert compared.ratio_worst is not None
    assert 1.0 - 1e-9 <= compared.ratio_median <= compared.ratio_high <= compared.ratio_worst


def test_random_scenes_without_any_path_have_no_ratio() -> None:
    none = random_scenes.compare(0, seed=0)
    assert (none.with_path, none.ratio_median, none.ratio_worst) == (0, None, None)
    rows = {row[0].strip(): row[1:] for row in tables.scene_rows(none)[1]}
    assert rows["worst"] == ("-", "")
    assert rows["all slices are needed"] == ("0", "-")


@pytest.mark.usefixtures("quick")
def test_random_scenes_are_reported_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert script.main(["--out", str(tmp_path), "--no-figures", "--scenes", "3"]) == 0
    assert "Two-level and dense search on random scenes" in capsys.readouterr().out
    assert "| the searches disagree on feasibility | 0 | 0.0 % |" in (tmp_path / "reproduction.md").read_text()
    record = json.loads((tmp_path / "reproduction.json").read_text())["random_scenes"]
    assert (record["scenes"], record["seed"], record["disagree"]) == (3, script.SEED, 0)


@pytest.mark.usefixtures("quick")
def test_disagreement_has_an_exit_status_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compared: random_scenes.SearchComparison
) -> None:
    monkeypatch.setattr(random_scenes, "compare", lambda *_: replace(compared, disagree=1))
    assert script.main(["--out", str(tmp_path), "--no-figures", "--scenes", "12"]) == 5
    assert json.loads((tmp_path / "reproduction.json").read_text())["random_scenes"]["disagree"] == 1


def test_a_negative_number_of_scenes_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "paper"
    assert script.main(["--out", str(out), "--scenes", "-1"]) == 2
    assert "--scenes" in capsys.readouterr().err
    assert not out.exists()


def test_help_loads_nothing_heavy() -> None:
    code = f"import runpy, sys; sys.argv = ['x', '--help']; runpy.run_path({script.__file__!r}, run_name='__main__')"
    watched = f"""
try:
    {code}
except SystemExit:
    loaded = [name for name in ('numpy', 'numba', 'pinocchio', 'matplotlib', 'rich') if name in sys.modules]
    sys.exit(' '.join(loaded) or 0)
"""
    subprocess.run([sys.executable, "-c", watched], check=True, stdout=subprocess.DEVNULL)
