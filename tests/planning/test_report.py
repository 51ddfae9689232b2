"""The report: times, versions and JSON that every reader takes."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from scipy.stats import chi

from hplan.errors import JointLimitError
from hplan.planning.report import beyond_sigmas, failure_report, uncertainty_report, write_report
from hplan.scene.file import load_scene
from hplan.scene.obstacles import Sphere


def test_what_is_not_finite_becomes_null(tmp_path: Path) -> None:
    path = write_report({"a": math.inf, "b": [-math.inf, {"c": (math.nan, 1.5)}], "d": None}, tmp_path / "r.json")
    assert json.loads(path.read_text()) == {"a": None, "b": [None, {"c": [None, 1.5]}], "d": None}


def test_failure_report_carries_the_facts(tmp_path: Path) -> None:
    error = JointLimitError("start", "elbow", -0.5, 0.0, math.pi / 2)
    report = failure_report(error, scene="s", robot=None)
    assert (report["status"], report["scene"], report["robot"]) == ("failed", "s", None)
    assert report["error"] == {
        "kind": "JointLimitError",
        "message": "start: joint 'elbow' is at -0.5 rad, outside its limits [0, 1.5708] rad",
        "which": "start",
        "joint": "elbow",
        "value_rad": -0.5,
        "lower_rad": 0.0,
        "upper_rad": math.pi / 2,
    }
    assert json.loads(write_report(report, tmp_path / "r.json").read_text()) == report


@pytest.mark.parametrize("sigmas", [0.0, 1.0, 3.0, 4.5])
def test_what_sigmas_leave_is_what_they_leave_in_space(sigmas: float) -> None:
    assert beyond_sigmas(sigmas) == pytest.approx(chi(3).sf(sigmas), rel=1e-9)
    balls = tuple(Sphere(name=f"{k}", center=(2, k, 1), radius=0.1, sigma=0.01 * (k > 0)) for k in range(4))
    scene = load_scene().model_copy(update={"obstacles": balls})
    told = uncertainty_report(scene, sigmas)["uncertain"]
    assert (told["obstacles"], told["one_beyond"]) == (3, beyond_sigmas(sigmas))
    assert told["any_beyond_at_most"] == min(1.0, 3.0 * beyond_sigmas(sigmas))
    assert uncertainty_report(load_scene(), sigmas) == {}
