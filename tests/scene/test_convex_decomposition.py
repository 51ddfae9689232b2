"""The pieces against points of the solid, and how far they stand out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import ball, blocks, crate, distances, torus, uncovered

from hplan import PlanOptions, certify, plan
from hplan.scene.convex_decomposition import PIECES, convex_pieces, winding_numbers
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Mesh

#: The arm is lifted, from 20 to 60 deg.
MOTION = Scene(name="lift", start=Start(joints_deg=(0.0, 20.0, 0.0, 0.0)), goal=Goal(joints_deg=(0.0, 60.0, 0.0, 0.0)))


def turned(vertices: np.ndarray) -> np.ndarray:
    """Out of the axes, so that no cut lies in a side."""
    c, s = np.cos(0.5), np.sin(0.5)
    about_z, about_x = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return vertices @ (about_z @ about_x).T


def surface_points(vertices: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    corners = vertices[faces]
    sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    some = rng.choice(len(faces), count, p=sizes / sizes.sum())
    weights = rng.dirichlet(np.ones(3), count)
    return np.einsum("ni,nij->nj", weights, corners[some])


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
def test_pieces_hold_the_solid_and_no_more_than_is_said(name):
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


def test_what_is_convex_is_one_piece():
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


def sheet(rng: np.random.Generator, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """A sheet with holes and notches: of no thickness as two faces back to back, flat or bent, any way up."""
    filled = rng.random((rng.integers(1, 4), rng.integers(1, 4), 1)) < 0.7
    filled[0, 0] = True
    x, y = (np.cumsum(rng.uniform(0.05, 0.3, size + 1)) for size in filled.shape[:2])
    vertices, faces = blocks(filled, x, y, np.array([0.0, 1.0]))
    bend = rng.choice([0.0, 0.2]) * (vertices[:, 0] ** 2 - vertices[:, 1])
    if thickness == 0.0:  # the lower faces, and the same from above
        low = faces[(vertices[faces][:, :, 2] == 0.0).all(axis=1)]
        faces = np.concatenate([low, low[:, ::-1]])
    vertices = np.column_stack([vertices[:, :2], thickness * vertices[:, 2] + bend])[:, rng.permutation(3)]
    return turned(vertices) if rng.random() < 0.4 else vertices, faces


@settings(max_examples=8)
@given(st.integers(0, 10_000))
def test_sheets_among_solids_are_held(seed):
    """All points of all triangles, of panels and leaves too, beside, through and on solids."""
    rng = np.random.default_rng(seed)
    filled = rng.random((2, 2, 2)) < 0.6
    filled[0, 0, 0] = True
    vertices, faces = blocks(filled, *(np.cumsum(rng.uniform(0.05, 0.3, 3)) for _ in range(3)))
    for _ in range(rng.integers(1, 4)):
        more, its_faces = sheet(rng, rng.choice([0.0, 5e-8, 3e-7, 2e-6, 1e-3]))
        shift = rng.uniform(-1.0, 1.0, 3)
        on = rng.integers(3)  # a sheet's corner in the plane of a side of a block
        shift[on] = rng.choice([shift[on], vertices[0, on] - more[0, on]])
        faces = np.concatenate([faces, its_faces + len(vertices)])
        vertices = np.concatenate([vertices, more + shift])
    mesh = Mesh.of("tree", vertices, faces)
    points, triangles = mesh.surface
    covered = np.vstack([points, surface_points(points, triangles, 200)])
    assert uncovered(mesh.solids, covered) <= 1e-6
    # No point of a piece is farther from the surface than is said.
    near = surface_points(points, triangles, 4000)
    mixed = np.vstack([rng.dirichlet(np.full(len(hull.core), 0.2), 10) @ hull.core for hull in mesh.solids])
    outside = mixed[np.abs(winding_numbers(mixed, points[triangles])) < 0.5]
    gaps = [np.linalg.norm(near - point, axis=1).min() for point in outside]
    assert max(gaps, default=0.0) <= mesh.excess + 0.05  # `near` is not everywhere


@pytest.mark.parametrize("thickness", [0.0, 5e-8, 9e-8, 2e-7, 1e-6])
def test_a_motion_through_a_sheet_is_not_certified(robot, thickness):
    """A trunk out of reach, and a panel across the arm, which was dropped once: the motion was verified."""
    trunk, its_faces = blocks(np.ones((1, 1, 1), dtype=bool), *(np.array([0.0, size]) for size in (0.1, 0.1, 1.0)))
    panel, faces = blocks(np.ones((1, 1, 1), dtype=bool), *(np.array([0.0, size]) for size in (1.0, 0.6, 0.6)))
    if thickness == 0.0:
        faces = faces[(panel[faces][:, :, 0] == 0.0).all(axis=1)]
        faces = np.concatenate([faces, faces[:, ::-1]])
    panel = panel * [thickness, 1.0, 1.0] + [1.2, -0.3, 1.3]
    vertices = np.concatenate([trunk + np.array([2.6, 0.0, 0.0]), panel])
    tree = Mesh.of("tree", vertices, np.concatenate([its_faces, faces + len(trunk)]))
    assert len(tree.solids) == 2
    assert 0.0 < tree.excess < 0.1
    motion = plan(robot, MOTION, PlanOptions(certify=False)).trajectory
    assert certify(robot, MOTION, motion).verified
    certificate = certify(robot, MOTION.with_obstacles([tree]), motion)
    assert not certificate.verified
    assert certificate.min_clearance_m < 0.0


def test_winding_numbers():
    vertices, faces = crate()
    points = np.array([[0, 0, 0.01], [0, 0, 0.1], [0.24, 0, 0.2], [0, 0, 5.0]])
    np.testing.assert_allclose(winding_numbers(points, vertices[faces]), [1, 0, 1, 0], atol=1e-9)
    assert 0.01 < winding_numbers(vertices[:1], vertices[faces])[0] < 0.99
