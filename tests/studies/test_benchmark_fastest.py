"""The fastest known motions: the file holds the problems that it says, and is improved by what is faster alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from studies.benchmark.fastest import measure as fastest
from studies.benchmark.fastest.draw import DISCS, PINCHES, TREES, is_blocked
from studies.benchmark.fastest.peers import PEERS, Found
from studies.benchmark.fastest.problems import FastestProblem, digest_of, problem_of, problems_of
from studies.benchmark.fastest.records import BEST_KNOWN, Record, TreeSource, read_records, write_records
from studies.benchmark.measure import evenly_chosen
from studies.benchmark.tables import fastest as fastest_tables

from hplan.errors import InputError
from hplan.robot.limits import least_duration
from hplan.scene.obstacles import Sphere

MEASURED = Path(__file__).parents[3] / "shared" / "data" / "measured_trees"
HANDFUL = 4


@pytest.fixture(scope="module")
def records() -> list[Record]:
    return read_records()


@pytest.fixture(scope="module")
def handful(records: list[Record]) -> list[FastestProblem]:
    """Discs for both arms, and a pinch."""
    planar = [record for record in records if record.group == "planar"]
    return problems_of(evenly_chosen(planar, HANDFUL), None)


def test_the_file_has_the_problems_that_were_drawn(records: list[Record]) -> None:
    assert len({record.name for record in records}) == len(records) == 200
    assert sum(record.group == "planar" for record in records) == sum(DISCS.values()) + PINCHES == 100
    arms = [record.source.arm for record in records if isinstance(record.source, TreeSource)]
    assert {arm: arms.count(arm) for arm in arms} == TREES
    assert len({record.source.tree for record in records if isinstance(record.source, TreeSource)}) == 9


def test_the_file_is_written_as_it_is_read(records: list[Record], tmp_path: Path) -> None:
    again = write_records(records, tmp_path / "again.json")
    assert again.read_text(encoding="utf-8") == BEST_KNOWN.read_text(encoding="utf-8")
    assert read_records(again) == records


def test_problems_are_blocked_and_no_motion_is_too_fast_to_be_true(handful: list[FastestProblem]) -> None:
    """`problems_of` has compared the digests; the bound is that of each joint alone."""
    assert len(handful) == HANDFUL
    for problem in handful:
        robot, scene = problem.robot, problem.scene
        assert is_blocked(robot, scene)
        ends = scene.start.configuration, scene.goal.configuration
        limits = robot.velocity_limit, robot.acceleration_limit
        assert problem.record.duration_s > least_duration(*ends, *limits)


def test_another_problem_of_the_same_name_is_noticed(handful: list[FastestProblem]) -> None:
    problem = handful[0]
    ball = problem.scene.obstacles[0]
    assert isinstance(ball, Sphere)
    moved = ball.model_copy(update={"radius": ball.radius + 1e-6})
    other = problem.scene.with_obstacles([moved, *problem.scene.obstacles[1:]])
    assert digest_of(problem.robot, other) != problem.record.digest
    slower = replace(problem.robot, velocity_limit=0.9 * problem.robot.velocity_limit)
    assert digest_of(slower, problem.scene) != problem.record.digest
    assert digest_of(problem.robot, problem.scene) == problem.record.digest
    with pytest.raises(InputError, match="not the problem whose best duration is known") as raised:
        problem_of(replace(problem.record, digest="0" * 16), None)
    assert raised.value.data["expected"] == "0" * 16


@pytest.mark.skipif(not MEASURED.is_dir(), reason="the measured trees are not beside the project")
def test_problems_among_trees_are_those_of_the_file(records: list[Record]) -> None:
    among = [record for record in records if record.group == "trees"]
    for problem in problems_of(evenly_chosen(among, 2), MEASURED):
        assert is_blocked(problem.robot, problem.scene)


def test_trees_are_asked_for(records: list[Record]) -> None:
    with pytest.raises(InputError, match="the folder of measured trees is not given"):
        problem_of(records[-1], None)


def test_only_what_is_faster_is_kept(records: list[Record], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One problem's best is made longer than hplan's by hand, another's shorter than anybody's."""
    planar = [record for record in records if record.group == "planar"]
    first, second = evenly_chosen(planar, 2)
    told = [replace(first, duration_s=99.0), replace(second, duration_s=0.5)]
    path = write_records(told, tmp_path / "known.json")

    def run(improve: tuple[str, ...] | None) -> dict[str, object]:
        return fastest.measure(trees=None, most=None, improve=improve, progress=lambda *_: None, path=path)

    looked = run(None)
    assert looked["improved"] == [first.name]
    assert read_records(path) == told
    kept = run(())
    assert kept["improved"] == [first.name]
    efforts = {effort: row["duration_s"] for effort, row in kept["rows"][0]["efforts"].items()}  # type: ignore[index]
    found = read_records(path)
    assert (found[0].duration_s, found[1]) == (pytest.approx(min(efforts.values()), abs=1e-9), told[1])
    assert efforts[found[0].by] == min(efforts.values())
    monkeypatch.setitem(PEERS, "nobody", lambda problem: [Found(0.4, "nobody")])
    assert run(("nobody",))["improved"] == [first.name, second.name]
    assert [(record.duration_s, record.by) for record in read_records(path)] == [(0.4, "nobody")] * 2
    for results in (looked, kept):
        tables = fastest_tables.tables(results)
        assert [len(table.rows) for table in tables[:2]] == [6, 2]
        assert tables[2].title.endswith("(1)")


def test_numbers_of_a_group() -> None:
    def row(name: str, default: float, *, certified: bool = True) -> dict[str, object]:
        of = {"duration_s": default, "certified": certified, "ms": 10.0}
        quick = {**of, "duration_s": 3.0}
        return {"name": name, "best_s": 2.0, "by": "ipopt", "efforts": {"quick": quick, "default": of, "best": of}}

    n = fastest.numbers([row("a", 2.0), row("b", 2.2), row("c", 1.0, certified=False)])
    assert n["efforts"]["default"]["certified"] == 2
    assert n["efforts"]["default"]["to_best"]["max"] == pytest.approx(1.1)
    assert n["efforts"]["default"]["slower"] == 1
    assert n["efforts"]["quick"]["to_best"]["median"] == pytest.approx(1.5)
    assert n["by"] == {"ipopt": 3}
