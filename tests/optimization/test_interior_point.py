"""The interior-point method against HiGHS, on programs drawn at random."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from hplan.base.deadline import NEVER
from hplan.optimization.interior_point import ProgramRows, solve

ACCURACY = 1e-8


def drawn(seed: int, count: int, band: int, one_sided: int) -> tuple[ProgramRows, np.ndarray, np.ndarray]:
    """A program with a solution, its rows as a dense matrix with the time scale last, and the right-hand sides."""
    rng = np.random.default_rng(seed)
    both = 3 * count
    first = np.minimum(np.tile(np.arange(count), 4)[: both + one_sided], max(0, count - band - 1))
    width = min(band + 1, count)
    entries = rng.normal(size=(both + one_sided, width))
    entries[rng.random(entries.shape) < 0.3] = 0.0
    time_scale = np.concatenate([-rng.integers(1, 4, both).astype(float), np.zeros(one_sided)])
    upper = rng.uniform(-0.5, 0.5, both + one_sided)
    upper[both:] = rng.uniform(0.05, 0.5, one_sided)
    lower = rng.uniform(-0.5, 0.5, both)
    # Changes are bounded, as by the largest step.
    columns = first[:, None] + np.arange(width)
    rows = ProgramRows(
        np.concatenate([np.arange(both + 1) * width, both * width + np.arange(1, count + 1),
                        both * width + count + np.arange(1, one_sided + 1) * width]).astype(np.int32),
        np.concatenate([columns[:both].ravel(), np.arange(count), columns[both:].ravel()]).astype(np.int32),
        np.concatenate([entries[:both].ravel(), np.full(count, 1.0), entries[both:].ravel()]),
        np.concatenate([time_scale[:both], np.zeros(count), time_scale[both:]]),
        np.concatenate([upper[:both], np.ones(count), upper[both:]]),
        np.concatenate([lower, np.ones(count)]),
    )  # fmt: skip
    dense = np.zeros((len(rows.upper), count + 1))
    for row, (start, end) in enumerate(zip(rows.starts[:-1], rows.starts[1:], strict=True)):
        np.add.at(dense[row], rows.columns[start:end], rows.entries[start:end])
    dense[:, -1] = rows.time_scale
    opposite = -dense[: len(rows.lower)]
    opposite[:, -1] *= -1.0
    return rows, np.vstack([dense, opposite]), np.concatenate([rows.upper, rows.lower])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 25), st.integers(0, 11), st.integers(0, 30))
def test_the_time_scale_is_the_least_that_highs_finds(seed, count, band, one_sided):
    rows, matrix, right = drawn(seed, count, band, min(one_sided, count))
    found, x = solve(rows, count, band, ACCURACY, NEVER)
    cost = np.append(np.zeros(count), 1.0)
    best = linprog(cost, A_ub=matrix, b_ub=right, bounds=(None, None))
    assert best.status == 0
    assert found
    assert (matrix @ x - right).max() < 1e-6
    # The squares of the changes, which are at most 1, count a little.
    assert best.fun - 1e-6 <= x[-1] <= best.fun + 0.5e-4 * count + 1e-6


def test_of_equal_paces_the_smallest_change_is_taken():
    # One of two unknowns is free to move.
    rows = ProgramRows(
        np.array([0, 1, 2], dtype=np.int32), np.array([0, 1], dtype=np.int32), np.array([1.0, 1.0]),
        np.array([-1.0, 0.0]), np.array([-0.5, 1.0]), np.array([-0.5, 1.0]),
    )  # fmt: skip
    found, x = solve(rows, 2, 0, ACCURACY, NEVER)
    assert found
    assert x == pytest.approx([0.0, 0.0, 0.5], abs=1e-6)


def test_a_program_without_solution_is_not_solved():
    rows = ProgramRows(
        np.array([0, 1, 2], dtype=np.int32), np.array([0, 0], dtype=np.int32), np.array([1.0, -1.0]),
        np.array([0.0, 0.0]), np.array([-1.0, -1.0]), np.array([1.0]),
    )  # fmt: skip
    assert not solve(rows, 1, 0, ACCURACY, NEVER)[0]
