"""Schedules of arms on one clock, against all possible waiting times."""

from __future__ import annotations

import functools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.workcell.timetable import _fastest_progress


def least_steps(clear, first, then) -> int | None:
    @functools.cache
    def steps(i: int, j: int) -> int | None:
        if i < 0 or j < 0 or not clear[i, j]:
            return None
        if i == j == 0:
            return 0
        before = [steps(i - 1, j - 1), steps(i - 1, j) if then[j] else None, steps(i, j - 1) if first[i] else None]
        return min((each + 1 for each in before if each is not None), default=None)

    return steps(clear.shape[0] - 1, clear.shape[1] - 1)


@given(st.integers(1, 12), st.integers(1, 12), st.integers(0, 2**32 - 1))
@settings(max_examples=200, deadline=None)
def test_two_are_done_as_soon_as_any_waits_allow(n, m, seed):
    rng = np.random.default_rng(seed)
    clear, first, then = rng.random((n, m)) > 0.3, rng.random(n) > 0.5, rng.random(m) > 0.5
    first[-1] = then[-1] = True
    way, least = _fastest_progress(clear, first, then), least_steps(clear, first, then)
    if least is None:
        assert not len(way)
        return
    assert len(way) == least + 1
    assert way[0].tolist() == [0, 0]
    assert way[-1].tolist() == [n - 1, m - 1]
    assert clear[way[:, 0], way[:, 1]].all()
    for before, (i, j) in zip(way[:-1].tolist(), way[1:].tolist(), strict=True):
        assert (i - before[0], j - before[1]) in {(1, 1), (1, 0), (0, 1)}
        assert j > before[1] or then[j]
        assert i > before[0] or first[i]
