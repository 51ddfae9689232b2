"""Narrow places: openings and pinches are as wide as they say, and what is told of them adds up."""

from __future__ import annotations

from typing import Any

import pytest
from studies.benchmark.narrow import measure as narrow
from studies.benchmark.narrow.scenes import GAPS, KINDS, LEAST, ROOMS, NarrowProblem, narrow_problems
from studies.benchmark.planners import Ompl
from studies.benchmark.tables import narrow as narrow_tables

from hplan.collision.coal_scene import CoalScene
from hplan.planning.plan import plan
from hplan.scene.obstacles import Sphere

COUNT = 15


@pytest.fixture(scope="module")
def problems() -> list[NarrowProblem]:
    return narrow_problems(3, COUNT)


def test_kinds_arms_and_gaps_come_in_turn(problems: list[NarrowProblem]) -> None:
    assert [problem.kind for problem in problems[:4]] == list(KINDS)
    assert [problem.arm for problem in problems[:12:4]] == ["harvester", "orchard_harvester", "drawn"]
    assert {problem.gap_m for problem in problems[:12]} == {GAPS[0]}
    assert problems[12].gap_m == GAPS[1]
    assert [problem.kind for problem in problems[COUNT:]] == ["pinch"] * 3
    assert len({problem.number for problem in problems}) == len(problems)


def test_the_same_seed_draws_the_same(problems: list[NarrowProblem]) -> None:
    again = narrow_problems(3, COUNT)
    assert [problem.scene for problem in again] == [problem.scene for problem in problems]
    assert [problem.scene for problem in narrow_problems(4, 2)[:2]] != [problem.scene for problem in problems[:2]]


def test_start_and_goal_have_room_and_a_link_is_in_the_opening(problems: list[NarrowProblem]) -> None:
    """The goal is no nearer to the walls than asked for, and no farther than the opening lets it be."""
    for problem in problems[:COUNT]:
        checker = CoalScene(problem.robot, problem.scene.solids)
        ends = problem.scene.start.configuration, problem.scene.goal.configuration
        clearances = [float(checker.distances(q)[:, : len(problem.scene.obstacles)].min()) for q in ends]
        assert min(clearances) >= LEAST
        assert clearances[1] <= 0.5 * problem.gap_m + 1e-6
        if problem.kind.endswith("locked"):
            assert ends[0][0] == ends[1][0]
            assert problem.scene.locked_joints == ("base_yaw",)


@pytest.mark.parametrize("number", range(3))
def test_a_pinch_leaves_its_room_along_some_motion(problems: list[NarrowProblem], number: int) -> None:
    """However little: a certified motion is found."""
    problem = problems[COUNT + number]
    assert problem.gap_m == ROOMS[0]
    found = plan(problem.robot, problem.scene)
    assert found.certificate.verified
    assert all(isinstance(ball, Sphere) for ball in problem.scene.obstacles)


def outcome(error: str | None, solved: bool, **more: Any) -> dict[str, Any]:
    """A row of the study."""
    peer = {"solved": solved, "ms": 5.0, "processed_s": 2.0 if solved else None}
    row = {"number": 0, "kind": "trap", "gap_m": 0.01, "arm": "drawn", "ms": 7.0, "error": error, "peer": peer}
    return row | ({"certified": True, "duration_s": 1.0} if error is None else {"message": "none"}) | more


def test_numbers_add_up(monkeypatch: pytest.MonkeyPatch, problems: list[NarrowProblem]) -> None:
    rows = iter(
        [
            outcome(None, solved=True),
            outcome(None, solved=False, kind="window"),
            outcome("NoPathError", solved=False, no_path=True),
            outcome("NotFoundError", solved=True, not_found=True, number=8),
        ]
    )
    monkeypatch.setattr(narrow, "narrow_problems", lambda *_: problems[:4])
    monkeypatch.setattr(narrow, "_planned", lambda _: None)
    monkeypatch.setattr(narrow, "_solve", lambda *_: next(rows))
    found = narrow.measure(seed=0, problems=4, ompl=None, progress=lambda *_: None)
    n = found["groups"]["all"]
    assert (n["problems"], n["solved"], n["certified"], n["no_path"], n["not_found"]) == (4, 2, 2, 1, 1)
    assert (n["peer"], n["missed"], n["to_processed"]["max"]) == (2, 1, 0.5)
    assert found["missed"] == ["8: trap, 10 mm, drawn"]
    assert found["groups"]["window"]["problems"] == 1
    shown, listed = narrow_tables.tables(found)
    assert [row[0] for row in shown.rows] == list(found["groups"])
    assert all(len(row) == len(shown.columns) for row in shown.rows)
    assert [row[1] for row in listed.rows] == ["missed", ""]


def test_beside_rrt_connect(monkeypatch: pytest.MonkeyPatch, problems: list[NarrowProblem]) -> None:
    ompl = Ompl.if_installed(1)
    if ompl is None:
        pytest.skip("OMPL is not installed")
    monkeypatch.setattr(narrow, "WARM", 1)
    monkeypatch.setattr(narrow, "narrow_problems", lambda *_: problems[COUNT + 2 :])
    found = narrow.measure(seed=3, problems=1, ompl=ompl, progress=lambda *_: None, seconds=2.0)
    (row,) = found["rows"]
    assert row["error"] is None
    assert row["peer"]["ms"] > 0.0
    assert found["patience_s"] == 2.0
