"""Convex parts of closed surfaces: they contain the solid, and exceed it by no more than stated."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import ball, blocks, crate, distances, surface_points, torus, turned, uncovered

from hplan.geometry.convex_decomposition import PIECES, convex_pieces, winding_numbers


def inner_points(vertices: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    points = np.random.default_rng(1).uniform(vertices.min(axis=0), vertices.max(axis=0), (count, 3))
    return points[winding_numbers(points, vertices[faces]) > 0.5]


SHAPES = {
    "crate": crate(),
    "crate, turned": (turned(crate()[0]), crate()[1]),
    "ring": torus(n=20),
    "ring, turned": (turned(torus(n=16)[0]), torus(n=16)[1]),
    "thin ring": torus(0.4, 0.004, 16),
    "ball": ball(),
}


@pytest.mark.parametrize("name", SHAPES)
def test_pieces_cover_the_solid_within_tolerance(name):
    vertices, faces = SHAPES[name]
    pieces = convex_pieces(vertices, faces)
    assert 1 <= len(pieces.hulls) <= PIECES
    inside = inner_points(vertices, faces, 400)
    assert uncovered(pieces.hulls, np.vstack([vertices[::3], surface_points(vertices, faces, 150), inside])) <= 2e-6
    # Points of the pieces, and how far these are from the solid.
    rng = np.random.default_rng(2)
    for hull in pieces.hulls:
        mixed = rng.dirichlet(np.full(len(hull.core), 0.2), 20) @ hull.core
        outside = mixed[winding_numbers(mixed, vertices[faces]) < 0.5]
        near = surface_points(vertices, faces, 4000)
        for point in outside:
            gap = np.linalg.norm(near - point, axis=1).min()
            assert gap + hull.rounding <= pieces.excess + 0.02  # `near` is not everywhere


def test_right_angles_are_met_exactly():
    pieces = convex_pieces(*crate())
    assert pieces.excess == 0.0
    assert len(pieces.hulls) == 5
    # The room inside stays free.
    room = np.random.default_rng(0).uniform([-0.22, -0.17, 0.03], [0.22, 0.17, 0.3], (200, 3))
    assert min(distances(hull, room).min() for hull in pieces.hulls) > 0.0
    corner = np.ones((2, 2, 1), dtype=bool)
    corner[1, 1] = False
    pieces = convex_pieces(*blocks(corner, *(np.array([0.0, 0.1, 1.0]),) * 2, np.array([0, 0.1])))
    assert (len(pieces.hulls), pieces.excess) == (2, 0.0)


def test_convex_mesh_is_one_piece():
    pieces = convex_pieces(*blocks(np.ones((2, 3, 1), dtype=bool), np.arange(3.0), np.arange(4.0), np.arange(2.0)))
    assert (len(pieces.hulls), pieces.excess) == (1, 0.0)
    assert sorted(map(tuple, pieces.hulls[0].core)) == [(x, y, z) for x in (0, 2) for y in (0, 3) for z in (0, 1)]
    pieces = convex_pieces(*ball())
    assert len(pieces.hulls) == 1
    assert pieces.excess == pieces.hulls[0].rounding < 0.01


@settings(max_examples=5)
@given(st.integers(0, 10_000))
def test_random_heaps_of_blocks(seed):
    """Solids with tunnels and hollows, blocks that touch at an edge or a corner only, and parts that are apart."""
    rng = np.random.default_rng(seed)
    filled = rng.random((3, 3, 3)) < rng.choice([0.3, 0.7])
    filled[0, 0, 0] = True
    planes = [np.cumsum(rng.uniform(0.02, 0.2, 4)) for _ in range(3)]
    vertices, faces = blocks(filled, *planes)
    pieces = convex_pieces(*(np.ascontiguousarray(part) for part in (vertices, faces)))
    cells = np.argwhere(filled)[rng.integers(filled.sum(), size=60)]
    low = np.column_stack([planes[axis][cells[:, axis]] for axis in range(3)])
    high = np.column_stack([planes[axis][cells[:, axis] + 1] for axis in range(3)])
    share = rng.choice([0.0, 1.0, 0.3, 0.8], (len(cells), 3))  # many are corners
    assert uncovered(pieces.hulls, low + share * (high - low)) <= 2e-6


def test_winding_numbers():
    vertices, faces = crate()
    points = np.array([[0, 0, 0.01], [0, 0, 0.1], [0.24, 0, 0.2], [0, 0, 5.0]])
    np.testing.assert_allclose(winding_numbers(points, vertices[faces]), [1, 0, 1, 0], atol=1e-9)
    assert 0.01 < winding_numbers(vertices[:1], vertices[faces])[0] < 0.99
