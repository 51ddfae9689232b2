"""Studies: rows independent of processes, continuation, files and faults, Pareto front."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from small_tree import TREE

from hplan.errors import HplanError, InputError, OutputError, StudyError
from hplan.robot.family import ORCHARD_HARVESTER
from hplan.study import run as study_run
from hplan.study.definition import Arm, Design, Study, Yields, load_study
from hplan.study.run import StudyResult, StudyRow, measure, run_study

FILE = """
format: hplan-study/1
name: small
arms:
  - orchard_harvester
  - {name: tall, vary: {shoulder_height: [0.6, 0.8]}, start_deg: [0, 90, 90, 90]}
trees: [tree*.csv]
distances: [1.2, 1.5]
turns_deg: [0, 180]
yields: [{wood: 0.02}]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "tree.csv").write_text(TREE)
    path = tmp_path / "study.yaml"
    path.write_text(FILE)
    return path


def as_made_by_anyone(result: StudyResult) -> list[StudyRow]:
    return [replace(row, cpu_s=0.0) for row in result.rows]


def invented(design: Design) -> StudyRow:
    """A row without computation."""
    return StudyRow(
        design.digest, design.arm, design.tree, design.distance, design.height, design.turn_deg, design.yields.wood,
        design.yields.below, design.yields.fruit, design.measure, 2.5, 4, len(design.arm) % 4, 1, None, None, 0.1,
        blocked=1, obstacles={"wire": 1, "post 2": 3},
    )  # fmt: skip


def test_designs_of_a_file(file: Path) -> None:
    designs = load_study(file).designs()
    assert len(designs) == 3 * 2 * 2 == len({design.digest for design in designs})
    assert [design.arm for design in designs[::4]] == [
        "orchard_harvester", "tall, shoulder_height 0.6", "tall, shoulder_height 0.8",
    ]  # fmt: skip
    assert designs[-1].robot.lower.tolist() == list(ORCHARD_HARVESTER.lower)
    assert designs[-1].trees == (file.parent / "tree.csv",)
    far, near = designs[2].scene.fruits[0], designs[0].scene.fruits[0]
    assert math.isclose(far.center[0] - near.center[0], 0.3, abs_tol=1e-9)


def test_digest_covers_relevant_inputs(file: Path) -> None:
    design = load_study(file).designs()[0]
    before = design.digest
    others = [replace(design, height=0.1), replace(design, yields=Yields(wood=0.01)), replace(design, measure="tour")]
    assert len({before, *(other.digest for other in others)}) == 4
    (file.parent / "tree.csv").write_text(TREE.replace("0.03", "0.04"))
    assert design.digest != before


def test_rows_stay_and_a_study_goes_on(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows, made = file.parent / "rows.csv", []

    def cut_off(design: Design) -> StudyRow:
        if len(made) == 5:
            raise KeyboardInterrupt
        made.append(design.digest)
        return invented(design)

    monkeypatch.setattr(study_run, "measure", cut_off)
    with pytest.raises(KeyboardInterrupt):
        run_study(file, rows, workers=1)
    with rows.open("a") as stream:
        stream.write("half a row, and the machine st")
    monkeypatch.setattr(study_run, "measure", invented)
    result = run_study(file, rows, workers=1)
    assert (len(made), result.measured, len(result.rows)) == (5, 7, 12)
    text = rows.read_text()
    again = run_study(file, rows, workers=1)
    assert (again.measured, again.rows, rows.read_text()) == (0, result.rows, text)
    assert text.count("\n") == 13


def test_row_of_a_real_tree_is_the_same_on_other_workers(file: Path) -> None:
    study = load_study(file)
    study = study.model_copy(update={"arms": study.arms[1:], "distances": (1.2,), "turns_deg": (0.0,)})
    here = run_study(study, workers=1)
    assert as_made_by_anyone(run_study(study, workers=2)) == as_made_by_anyone(here)
    assert [(row.fruits, row.error) for row in here.rows] == [(4, "")] * 2
    assert all(row.picked + row.blocked + row.no_approach + row.no_motion + 1 == 4 for row in here.rows)
    assert here.not_picked["out_of_reach"] == 2
    assert all(1 <= row.picked <= 3 for row in here.rows)  # the fourth hangs 9 m high


def killing(design: Design) -> StudyRow:
    """A row; the first design of a study kills its process, once."""
    mark = design.trees[0].with_name("killed")
    if design.turn_deg and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return invented(design)


def test_killed_worker_loses_nothing(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_run, "measure", killing)
    result = run_study(file, file.parent / "rows.csv", workers=2)
    assert (file.parent / "killed").exists()
    assert list(result.rows) == [invented(design) for design in load_study(file).designs()]


def test_on_dask(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    monkeypatch.setattr(study_run, "measure", killing)
    quiet = {"dashboard_address": None, "scheduler_port": 0}
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **quiet) as cluster,
        distributed.Client(cluster) as client,
    ):
        result = run_study(file, file.parent / "rows.csv", executor=client.get_executor(), workers=2)
    assert (file.parent / "killed").exists()
    assert list(result.rows) == [invented(design) for design in load_study(file).designs()]


def test_tour_has_seconds_for_each_fruit(file: Path) -> None:
    design = replace(load_study(file).designs()[0], measure="tour")
    row = measure(design)
    assert row.picked >= 1
    assert row.motion_s is not None
    assert row.motion_s / row.picked > 0.3
    (choice,) = StudyResult("one", (row,), 1, 0.0).choices
    assert choice.seconds_per_fruit == row.motion_s / row.picked


def test_row_has_stops_and_the_time_of_driving(file: Path) -> None:
    row = measure(replace(load_study(file).designs()[0], measure="row"))
    assert 1 <= row.stops <= row.picked <= 3
    assert row.motion_s is not None
    assert row.total_s is not None
    assert row.total_s > row.motion_s + row.picked


def test_study_says_why_fruit_is_not_picked(file: Path) -> None:
    design = load_study(file).designs()[0]
    rows = [measure(replace(design, measure=kind, distance=0.9, yields=Yields())) for kind in ("reach", "tour", "row")]
    for row in rows:
        assert row.picked + row.out_of_reach + row.blocked + row.no_approach + row.no_motion == row.fruits
        assert row.out_of_reach >= 1
        assert sum(row.obstacles.values()) >= row.blocked
    result = StudyResult("two", (invented(design), invented(design)), 2, 0.0)
    assert (result.not_picked["blocked"], result.obstacles) == (2, {"post 2": 6, "wire": 2})
    assert list(result.obstacles) == ["post 2", "wire"]
    (choice,) = result.choices
    assert (choice.not_picked["blocked"], choice.obstacles) == (0.25, result.obstacles)


def test_front_contains_undominated_designs(file: Path) -> None:
    rows = [replace(invented(design), cpu_s=1.0) for design in load_study(file).designs()[::4]]
    numbers = [(3, 2.5), (2, 2.4), (2, 2.6)]
    rows = [replace(row, picked=count, reach_m=reach) for row, (count, reach) in zip(rows, numbers, strict=True)]
    assert [choice.is_best for choice in StudyResult("three", tuple(rows), 3, 0.0).choices] == [True, True, False]


def test_two_studies_do_not_write_to_one_file(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = file.parent / "rows.csv"

    def meanwhile(design: Design) -> StudyRow:
        with pytest.raises(OutputError, match="another study"):
            run_study(file, rows, workers=1)
        return invented(design)

    monkeypatch.setattr(study_run, "measure", meanwhile)
    assert len(run_study(file, rows, workers=1).rows) == 12


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("orchard_harvester", "ur7", 5, "ur7"),
        ("shoulder_height: [0.6, 0.8]", "shoulder_height: [-1]", 6, "expected greater than 0"),
        ("shoulder_height:", "shoulder:", 6, "shoulder"),
        ("start_deg: [0, 90, 90, 90]", "start_deg: [0, 90]", 6, "start"),
        ("tree*.csv", "bush*.csv", 7, "there is no file"),
        ("distances: [1.2, 1.5]", "distances: []", 8, "at least 1"),
        ("wood:", "leaves:", 10, "unknown key"),
        ("{name: tall", "{robot: ur5, name: tall", 6, "varied"),
    ],
)
def test_fault_of_a_file_names_its_line(file: Path, old: str, new: str, line: int, said: str) -> None:
    file.write_text(FILE.replace(old, new, 1))
    with pytest.raises(StudyError, match=said) as caught:
        load_study(file)
    assert (caught.value.line, caught.value.path) == (line, file)
    assert str(caught.value).startswith(f"study file {file}, line {line}")


@pytest.mark.parametrize(
    "make",
    [
        lambda: Study(name="none", arms=(), trees=("a.csv",)),
        lambda: Study(name="two", arms=("harvester", "harvester"), trees=("a.csv",)),
        lambda: Arm(spec=replace(ORCHARD_HARVESTER, name="own"), vary={"link_lengths": ([1.0],)}),
        lambda: run_study(Study(name="gone", arms=("harvester",), trees=("missing.csv",)), workers=1),
        lambda: run_study(3),  # type: ignore[arg-type]
    ],
)
def test_wrong_studies(make: Callable[[], Any]) -> None:
    with pytest.raises(InputError):
        make()


def test_file_of_something_else_is_left_alone(file: Path) -> None:
    with pytest.raises(HplanError, match="not the table of a study"):
        run_study(file, file.parent / "tree.csv", workers=1)
    assert (file.parent / "tree.csv").read_text() == TREE
