"""The harness of all studies: rows, executors, summaries, comparisons."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
from studies import harness
from studies.harness import Row, Study, StudyConfig, compare, run, summarize, summary

SOLVED: list[int] = []


def _row(config: StudyConfig, number: int) -> Row | list[Row] | None:
    SOLVED.append(number)
    if number == 1:
        return None
    row = {
        "name": f"{number}",
        "kind": "ab"[number % 2],
        "ms": float(number),
        "good": number != 4,
        "fault": number == 4,
    }
    return [row, row | {"name": f"{number} again"}] if number == 2 else row


STUDY = Study("toy", "numbers", _row, ("ms", "good"), by="kind", warm=2)


@pytest.fixture(autouse=True)
def forgotten() -> None:
    SOLVED.clear()
    harness._WARM.clear()


def test_rows_come_in_order_on_any_executor() -> None:
    reports: list[tuple[int, int]] = []
    rows = list(run(STUDY, StudyConfig(count=5), report=lambda *now: reports.append(now)))
    assert [row["name"] for row in rows] == ["0", "2", "2 again", "3", "4"]
    assert reports == [(done, 5) for done in range(6)]
    assert SOLVED == [0, 3, 0, 1, 2, 3, 4]  # two of them, evenly chosen, as warm-up
    with ThreadPoolExecutor(2) as pool:
        assert list(run(STUDY, StudyConfig(count=5), executor=pool)) == rows
    assert [row["name"] for row in run(STUDY, StudyConfig(count=2, first=3))] == ["3", "4"]


def test_summary_has_groups_and_faults() -> None:
    lines = summary(STUDY, list(run(STUDY, StudyConfig(count=5))))
    assert lines[2:7] == [
        "| kind | rows | ms | good |",
        "|---|---:|---:|---:|",
        "| a | 4 | 2 / 3.7 / 4 | 3 of 4 |",
        "| b | 1 | 3 | 1 of 1 |",
        "| all | 5 | 2 / 3.8 / 4 | 4 of 5 |",
    ]
    assert lines[-2].endswith("At fault: 4.")
    assert summarize(["x", None, "y", "x"]) == "2 x, 1 y"


def test_runs_are_compared_problem_by_problem() -> None:
    before: list[Row] = [{"name": f"{i}", "ms": 1.0 + i, "good": True} for i in range(4)]
    after = [row | {"ms": 2.0 * row["ms"], "good": row["name"] != "2"} for row in before[:3]] + [{"name": "new"}]
    lines = compare(before, after, ("ms", "good"))
    assert lines[0] == "4 rows before, 4 after, 3 of the same problems"
    assert lines[4:] == ["| ms | 3 | 2 | 2 / 2 / 2 | 3 more, 0 less |", "| good | 3 | 1: True -> False |  |  |"]
