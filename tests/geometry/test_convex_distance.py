"""Distances and penetration depths of convex hulls, against coal, Qhull and their defining inequalities."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from hplan.base.arrays import FloatArray
from hplan.geometry.convex_distance import NEAREST, ON_FIRST, WORK, Wanted, core_distance, corner_table
from hplan.geometry.hull import CUBE_CORNERS
from hplan.geometry.penetration import penetration
from hplan.geometry.rotation import rpy_rotation

EXACT = Wanted(np.inf, 0.0, 1e-12, 0.0)

#: Whole numbers: most draws are flat, doubled, touching or symmetric in some way.
SHAPES = st.lists(st.tuples(*[st.integers(-2, 2)] * 3), min_size=1, max_size=10).map(
    lambda rows: np.array(rows, dtype=np.float64)
)
QUARTERS = st.tuples(*[st.integers(0, 3)] * 3).map(lambda turns: rpy_rotation(*(0.5 * np.pi * np.array(turns))))
SHIFTS = st.tuples(*[st.integers(-4, 4)] * 3).map(lambda shift: np.array(shift, dtype=np.float64))
SEEDS = st.integers(0, 2**32 - 1)


def with_table(points: FloatArray) -> tuple[FloatArray, int]:
    """Coordinates followed by the table of the corners, and its offset."""
    table = corner_table(points, 0, points.size)
    return np.concatenate([points.ravel(), table]), points.size if len(table) else 0


def measured(
    first: FloatArray, rotation: FloatArray, shift: FloatArray, second: FloatArray, wanted: Wanted = EXACT
) -> tuple[float, FloatArray]:
    """Distance, negative by the depth in contact, and the kernels' scratch."""
    work = np.zeros(WORK)
    pose = (*rotation.ravel().tolist(), *shift.tolist())
    shape, table = with_table(first)
    other, other_table = with_table(second)
    hulls = shape, (0, first.size, table), pose, other, (0, second.size, other_table)
    distance = core_distance(*hulls, wanted, work)
    return (distance, work) if distance > 0.0 else (-penetration(hulls, work), work)


def differences(first: FloatArray, rotation: FloatArray, shift: FloatArray, second: FloatArray) -> FloatArray:
    corners: FloatArray = ((first @ rotation.T + shift)[:, None] - second).reshape(-1, 3)
    return corners


def off_hull(point: FloatArray, corners: FloatArray) -> float:
    """How far a point is from a hull, by weights that come close to it."""
    rows = np.vstack([corners.T, np.full(len(corners), 1e3)])
    weights, _ = nnls(rows, np.append(point, 1e3))
    return float(np.linalg.norm(weights @ corners / weights.sum() - point))


def random_hulls(seed: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    generator = np.random.default_rng(seed)
    first, second = (generator.normal(size=(int(n), 3)) for n in generator.integers(4, 40, 2))
    shift = generator.normal(size=3) * generator.uniform(0.0, 6.0)
    return first, rpy_rotation(*generator.uniform(-np.pi, np.pi, 3)), shift, 0.3 * second


def coal_convex(points: FloatArray) -> coal.CollisionGeometry:
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(points), 1)
    for corners in ConvexHull(points).simplices:
        mesh.addTriangle(*points[corners])
    mesh.endModel()
    mesh.buildConvexHull(True, "Qt")
    return mesh.convex


@given(SHAPES, QUARTERS, SHIFTS, SHAPES)
@settings(max_examples=400)
def test_nothing_is_nearer_and_the_nearest_point_is_one_of_both(
    first: FloatArray, rotation: FloatArray, shift: FloatArray, second: FloatArray
) -> None:
    found, work = measured(first, rotation, shift, second)
    corners = differences(first, rotation, shift, second)
    nearest = work[NEAREST : NEAREST + 3]
    if found > 0.0:
        assert np.linalg.norm(nearest) == pytest.approx(found, rel=1e-9)
        assert (corners @ nearest).min() >= found * found * (1.0 - 1e-9)
        assert off_hull(nearest, corners) < 1e-9
        assert off_hull(work[ON_FIRST : ON_FIRST + 3], first @ rotation.T + shift) < 1e-9
    else:
        assert off_hull(np.zeros(3), corners) < 1e-9
        assert np.linalg.norm(nearest) == pytest.approx(-found, abs=1e-12)
        # Shifted apart by the depth they do no more than touch.
        assert (corners @ nearest).max() <= found * found + 1e-9


@given(SEEDS)
@settings(max_examples=150)
def test_distances_and_depths_of_solids(seed: int) -> None:
    first, rotation, shift, second = random_hulls(seed)
    found, _ = measured(first, rotation, shift, second)
    if found > 0.0:
        request = coal.DistanceRequest()
        request.gjk_tolerance = 1e-10
        place = coal.Transform3s(rotation, shift)
        bodies = coal_convex(first), place, coal_convex(second), coal.Transform3s()
        assert coal.distance(*bodies, request, coal.DistanceResult()) == pytest.approx(found, rel=1e-8, abs=1e-12)
    else:
        planes = ConvexHull(differences(first, rotation, shift, second)).equations
        assert planes[:, 3].max() == pytest.approx(found, abs=1e-12)


@given(SEEDS, st.floats(1e-9, 1e-2))
@settings(max_examples=100)
def test_small_gaps_are_exact(seed: int, gap: float) -> None:
    first, rotation, _, second = random_hulls(seed)
    normal = rotation @ np.array([0.6, 0.0, 0.8])
    turned = first @ rotation.T
    # A corner of the first above the middle of a wide plate.
    plate = second + np.array([0.0, 0.0, 0.0])
    plate = np.vstack([plate - np.outer(plate @ normal, normal), -30.0 * normal])
    lowest = turned[(turned @ normal).argmin()]
    centre = plate[:-1].mean(axis=0)
    found, _ = measured(first, rotation, centre - lowest + gap * normal, plate)
    assert found == pytest.approx(gap, rel=1e-9, abs=1e-14)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_boxes_by_face_edge_and_corner(scale: float) -> None:
    box = scale * CUBE_CORNERS
    turned = rpy_rotation(0.0, 0.0, 0.25 * np.pi)
    for rotation, shift, expected in (
        (np.eye(3), (2.5, 0.3, -0.2), 0.5),
        (np.eye(3), (2.3, 2.4, 0.1), 0.5),
        (np.eye(3), (2.6, 2.3, 4.2), np.sqrt(0.36 + 0.09 + 4.84)),
        (turned, (1.0 + np.sqrt(2.0) + 0.25, 0.0, 0.0), 0.25),
        (np.eye(3), (1.5, 0.2, 0.1), -0.5),
        (np.eye(3), (0.0, 0.0, 0.0), -2.0),
        (turned, (1.0 + np.sqrt(2.0) - 0.25, 0.0, 0.0), -0.25),
    ):
        found, _ = measured(box, rotation, scale * np.array(shift), box)
        assert found == pytest.approx(scale * expected, rel=1e-9)


@given(SEEDS, st.floats(0.0, 3.0))
@settings(max_examples=100)
def test_what_is_enough_is_shown_and_fractions_are_kept(seed: int, enough: float) -> None:
    hulls = random_hulls(seed)
    exact, _ = measured(*hulls)
    shown, _ = measured(*hulls, wanted=Wanted(enough, 0.0, 1e-3, 0.0))
    if exact > 0.0 and enough > 0.0:
        assert shown <= exact * (1.0 + 1e-9)
        assert shown >= min(enough, exact * (1.0 - 1e-3))


def test_gradient_is_that_of_the_nearest_points() -> None:
    for seed in range(30):
        first, rotation, shift, second = random_hulls(seed)
        found, work = measured(first, rotation, shift, second)
        direction = work[NEAREST : NEAREST + 3] / found if found > 0.0 else work[NEAREST : NEAREST + 3] / -found
        ahead = [measured(first, rotation, shift + 1e-7 * axis, second)[0] for axis in np.eye(3)]
        behind = [measured(first, rotation, shift - 1e-7 * axis, second)[0] for axis in np.eye(3)]
        slope = (np.array(ahead) - np.array(behind)) / 2e-7
        assert slope == pytest.approx(direction if found > 0.0 else -direction, abs=1e-5)
