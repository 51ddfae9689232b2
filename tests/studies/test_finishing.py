"""The study of paths that OMPL has planned: what is told of them."""

from __future__ import annotations

import pytest
from studies.benchmark.finishing import Finished, finished, table
from studies.benchmark.ompl_paths import seed_ompl

from hplan.problem.options import PlanOptions
from hplan.robot.model import load_robot
from hplan.scene.file import load_scene


def test_a_path_of_the_reference_scene() -> None:
    pytest.importorskip("ompl")
    seed_ompl(1)
    (row,) = finished(load_robot(), [("reference", load_scene())], PlanOptions(effort="quick"), 1e-3)
    assert row.waypoints >= 2
    assert row.outcome in ("certified", "PathInContactError")
    assert (row.finished_s is not None) == (row.outcome == "certified")
    assert not row.finished_touches


def test_a_table_of_what_became_of_paths() -> None:
    rows = [
        Finished("box", 5, 2.0, True, "certified", 1, 1.0, False, 1.5, 20.0),
        Finished("box", 7, 2.0, True, "PathInContactError", finish_ms=40.0),
        Finished("box", 0),
    ]
    assert table(rows)[2] == "| box | 3 | 2 | 2 | 1 | 0 | 1 | 1 | 0 | 2.00 | 1.00 | 0.50 | 0.75 | 30 |"
