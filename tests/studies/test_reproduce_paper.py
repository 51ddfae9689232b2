"""Reproduction of the paper: numbers, open choices, output files."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import pytest
from script_loader import load_script
from studies.paper import measure
from studies.paper.measure import PAPER_DENSE, PAPER_TWO_LEVEL

from hplan.apps.view import figures

script = load_script("reproduce_paper")


@pytest.fixture(scope="module")
def measured() -> Any:
    return measure.measure(repetitions=1)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, measured: Any) -> None:
    monkeypatch.setattr(measure, "measure", lambda *_, **__: measured)
    monkeypatch.setattr(figures, "png_bytes", functools.partial(figures.png_bytes, dpi=20))


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
    } == {"capsule": (128_891, 45, 90, 107), "paper": (127_973, 45, 90, 107), "rectangle": (127_342, 40, 90, 107)}
    assert rows["paper"]["cost_deg"] == pytest.approx(145.2149523784, abs=1e-9)
    assert rows["rectangle"]["cost_deg"] == pytest.approx(143.558098, abs=1e-6)


@pytest.mark.usefixtures("quick")
def test_command_line_writes_everything(tmp_path: Path, measured: Any, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "paper"
    assert script.main(["--out", str(out)]) == 0
    drawn = {path.name for path in out.iterdir()} - {"overview.png", "reproduction.json", "reproduction.md"}
    assert sorted(int(name.split("-")[1]) for name in drawn) == list(range(2, 17))  # by the paper's numbers
    numbers = json.loads((out / "reproduction.json").read_text())
    assert numbers["runs"]["dense"]["second"] == measured[0].runs["dense"].second
    text = (out / "reproduction.md").read_text()
    assert text.strip() in capsys.readouterr().out
    needed = ("6,605", "145.800739", "23,500", "9.2", "5,414", "6,169", "169.521325", "127,342")
    assert [number for number in needed if number not in text] == []
