from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hplan.base.arrays import readonly
from hplan.errors import OptionError
from hplan.grid.grid import MAX_NODES, Grid, Occupancy, words_for

# Nodes


@given(st.floats(-10, 10), st.floats(1e-3, 20), st.floats(0.01, 30))
def test_first_and_last_node_are_the_limits(lower, width, step):
    grid = Grid.over([lower], [lower + width], step)
    axis = grid.axis(0)
    assert axis[0] == lower
    assert axis[-1] == pytest.approx(lower + width, abs=1e-12)
    assert len(axis) == grid.shape[0] >= 2
    assert np.diff(axis).max() <= step * (1 + 1e-6)


def test_coordinates_and_places_are_inverse():
    grid = Grid.over([0.0, -3.0], [1.0, 4.0], [0.1, 0.7])
    index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), axis=-1)
    coordinates = grid.coordinates(index)
    assert coordinates.shape == (11, 11, 2)
    np.testing.assert_allclose(grid.position(coordinates), index, atol=1e-12)
    np.testing.assert_array_equal(grid.nearest(coordinates[3, 7] + [0.049, -0.34]), [3, 7])
    np.testing.assert_array_equal(grid.nearest([-5.0, 99.0]), [0, 10])


@pytest.mark.parametrize(
    ("lower", "upper"), [([0.0], [-1.0]), ([0.0], [math.inf]), ([math.nan], [1.0]), ([0.0, 0.0], [1.0]), (0.0, 1.0)]
)
def test_bad_limits(lower, upper):
    with pytest.raises(OptionError, match=r"limits = .*: expected finite lower limits"):
        Grid.over(lower, upper, 0.1)


def test_too_many_nodes():
    with pytest.raises(OptionError, match=f"at most {MAX_NODES} nodes"):
        Grid.over([0.0] * 3, [1.0] * 3, 1e-3 / 2)


# Occupancy


@pytest.mark.parametrize("last", [1, 2, 63, 64, 65, 128, 129])
@pytest.mark.parametrize("before", [(), (3,), (2, 4)])
def test_mask_round_trip(before, last):
    shape = (*before, last)
    grid = Grid(readonly(np.zeros(len(shape))), readonly(np.ones(len(shape))), shape)
    mask = np.random.default_rng(last).random(shape) < 0.4
    result = Occupancy.from_mask(grid, mask)
    np.testing.assert_array_equal(result.occupied, mask)
    assert result.occupied_count == mask.sum()
    assert result.free_words.shape == (math.prod(before), words_for(last))
    for index in np.ndindex(shape):
        row = int(np.ravel_multi_index(index[:-1], before)) if before else 0
        bit = (int(result.free_words[row, index[-1] // 64]) >> (index[-1] % 64)) & 1
        assert result.is_free(index) == bool(bit) == (not mask[index])
