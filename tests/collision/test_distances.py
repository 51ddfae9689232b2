"""Compiled distances of bodies, pairs and convex shapes, and their bounds, against coal."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from any_arms import loaded_arm
from arm_variants import random_obstacles
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

import hplan.collision.geometry_pairs as module
from hplan.base.arrays import FloatArray
from hplan.collision import arm_pairs, box_bounds, flat_bodies
from hplan.collision.body_kernels import off_body, off_row
from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import capsule_shapes, solid_shape
from hplan.collision.convex_distance import NEAREST, ON_FIRST, WORK, Wanted, core_distance
from hplan.collision.distances import off_box, off_segment
from hplan.collision.flat_bodies import joints_alone
from hplan.collision.obstacle_rows import AXES, BOUND, BOX, CENTRE, KIND, SHAPE
from hplan.collision.penetration import penetration
from hplan.collision.placed_bodies import ALONG, PLACED, START
from hplan.errors import RobotFileError
from hplan.robot.family.members import write_robot
from hplan.robot.family.spec import ArmSpec
from hplan.robot.model import load_robot
from hplan.scene.corner_table import corner_table
from hplan.scene.obstacles import Capsule, Cylinder, Mesh, PointCloud
from hplan.scene.solids import CUBE_CORNERS, Cloud, rpy_rotation

lattice = st.integers(-4, 4).map(lambda i: 0.5 * i)
number = st.one_of(lattice, st.floats(-2.0, 2.0, width=32).map(lambda x: 0.0 if abs(x) < 1e-4 else x))
vector = st.tuples(number, number, number)


def point_to_segment(point, start, along):
    square = along @ along
    t = 0.0 if square == 0.0 else np.clip((point - start) @ along / square, 0.0, 1.0)
    return np.linalg.norm(point - start - t * along)


def segment_to_segment(a, u, b, v):
    """Minimum distance over the ends of both segments and over their interiors.

    The interiors count if the lines' nearest points are there.
    """
    ends = [
        point_to_segment(a, b, v),
        point_to_segment(a + u, b, v),
        point_to_segment(b, a, u),
        point_to_segment(b + v, a, u),
    ]
    (s, t), _, rank, _ = np.linalg.lstsq(np.stack([u, -v], axis=1), b - a, rcond=1e-12)
    if rank == 2 and 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
        ends.append(np.linalg.norm(a + s * u - b - t * v))
    return min(ends)


def segment_to_box(a, u, half):
    """Ternary search: the distance of a point from a convex body is convex along the segment."""

    def distance(t):
        return np.linalg.norm(np.maximum(np.abs(a + t * u) - half, 0.0))

    low, high = 0.0, 1.0
    for _ in range(150):
        third = (high - low) / 3.0
        if distance(low + third) <= distance(high - third):
            high -= third
        else:
            low += third
    return min(distance(t) for t in (0.0, low, high, 1.0))


@settings(max_examples=300)
@given(vector, vector, vector, vector)
@example((0, 0, 0), (0, 0, 0), (1, 0, 0), (0, 0, 0))
@example((0, 0, 0), (0, 0, 0), (1, 1, 0), (0, -2, 0))
@example((0, 0, 0), (1, 0, 0), (2, 1, 0), (0, 0, 0))
@example((0, 0, 0), (1, 0, 0), (3, 0, 0), (-1, 0, 0))
@example((0, 0, 0), (1, 0, 0), (-2, 1, 0), (1.5, 0, 0))
@example((0, 0, 0), (1, 0, 0), (0.5, 1, 0), (2, 0, 0))
@example((0, 0, 0), (1, 0, 0), (0.5, -1, 0), (0, 2, 0))
def test_segment_to_segment(a, u, b, v):
    expected = segment_to_segment(*(np.array(x, dtype=float) for x in (a, u, b, v)))
    *off, _ = off_segment(*(tuple(map(float, x)) for x in (a, u, b, v)))
    assert np.linalg.norm(off) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-3])
def test_nearly_parallel_segments(angle):
    """Each crosses the other's plane somewhere; the error stays far below the links' tolerances."""
    rng = np.random.default_rng(6)
    for _ in range(50):
        u = rng.normal(size=3)
        turn = np.cross(u, rng.normal(size=3))
        v = rng.uniform(-2, 2) * (u + angle * turn)
        a, b = np.zeros(3), rng.uniform(-1, 2) * u + rng.choice([0.0, 0.3]) * np.cross(u, turn) / (turn @ turn) ** 0.5
        expected = segment_to_segment(a, u, b, v)
        *off, _ = off_segment(*(tuple(x.tolist()) for x in (a, u, b, v)))
        assert np.linalg.norm(off) == pytest.approx(expected, abs=2e-5 if angle else 1e-9)


@settings(max_examples=300)
@given(vector, vector, st.tuples(*[st.floats(0.01, 2.0)] * 3))
@example((-2, 0.5, 0), (4, 0, 0), (1, 0.5, 1))
@example((-2, 1.5, 0), (4, 0, 0), (1, 1, 1))
@example((-2, 2, 0), (4, -1, 0), (1, 1, 1))
@example((0, 0, 0), (0.1, 0, 0), (1, 1, 1))
@example((2, 2, 2), (0, 0, 0), (1, 1, 1))
def test_segment_to_box(a, u, half):
    expected = segment_to_box(*(np.array(x, dtype=float) for x in (a, u, half)))
    *off, _ = off_box(*(tuple(map(float, x)) for x in (a, u, half)))
    assert np.linalg.norm(off) == pytest.approx(expected, abs=1e-7)


@settings(max_examples=300)
@given(vector, vector, vector, vector, st.sampled_from([1.0, 1e-3, 1e-6, 1e-7, 1e-9]))
@example((0, 0, 1.015625), (0, 0, 1.5), (0, 0, 0), (2, 0, 1.0096783638000488), 1.0)
def test_what_vectors_between_segments_show_is_no_more_than_their_distance(a, u, b, turn, angle):
    """For nearly parallel segments the vector may miss the nearest points."""
    a, u, b, v = (np.array(x, dtype=float) for x in (a, u, b, np.array(u) + angle * np.array(turn)))
    placed = np.zeros((2, PLACED))
    placed[:, START:ALONG], placed[:, ALONG:PLACED] = [a, b], [u, v]
    *off, t, shown = off_body(placed, 0, 1)
    nearest = min(
        np.linalg.norm(a + s * u - b - r * v)
        for s, r in [(t, np.clip((a + t * u - b) @ v / max(v @ v, 1e-300), 0.0, 1.0)), *settled(a, u, b, v)]
    )
    assert shown <= nearest + 1e-12
    assert np.linalg.norm(off) >= nearest - 1e-9
    if angle == 1.0 and nearest > 1e-6:
        assert shown == pytest.approx(nearest, abs=1e-7)


def settled(a, u, b, v):
    """Places on two segments, each nearest to the other's, from several on."""
    for s in (0.0, 0.5, 1.0):
        for _ in range(100):
            r = np.clip((a + s * u - b) @ v / max(v @ v, 1e-300), 0.0, 1.0)
            s = np.clip((b + r * v - a) @ u / max(u @ u, 1e-300), 0.0, 1.0)
        yield s, r


@settings(max_examples=300)
@given(vector, vector, st.tuples(*[st.floats(0.01, 2.0)] * 3), st.integers(0, 2**32 - 1))
def test_what_vectors_from_boxes_show_is_their_distance(a, u, half, seed):
    a, u, half = (np.array(x, dtype=float) for x in (a, u, half))
    rng = np.random.default_rng(seed)
    turn = rpy_rotation(*rng.uniform(-3.0, 3.0, 3))
    solid, placed = np.zeros((1, 21)), np.zeros((1, PLACED))
    solid[0, KIND], solid[0, SHAPE : SHAPE + 3], solid[0, AXES : AXES + 9] = BOX, half, turn.ravel()
    solid[0, CENTRE:BOUND] = centre = rng.uniform(-1.0, 1.0, 3)
    placed[0, START:ALONG], placed[0, ALONG:PLACED] = centre + a @ turn, u @ turn  # rows of `turn`: axes of the box
    *off, _, shown = off_row(placed, 0, solid, 0)
    expected = segment_to_box(a, u, half)
    assert np.linalg.norm(off) == pytest.approx(expected, abs=1e-7)
    assert shown <= expected + 1e-12
    assert expected < 1e-6 or shown == pytest.approx(expected, abs=1e-7)


def many(rng, copies=40):
    """Obstacles of most kinds, a cloud among them."""
    found = [o.model_copy(update={"name": f"{k}{o.name}"}) for k in range(copies) for o in random_obstacles(rng)]
    return [*found, PointCloud.of("leaves", rng.uniform(-2.0, 2.0, (50, 3)), 0.02).solids[0]]


def others(rng, copies=40):
    """Cylinders and a hull.

    The depth that coal finds in a cylinder depends on its previous queries.
    """
    found = []
    for number in range(copies):
        center, rpy = rng.uniform(-1.8, 1.8, 3), rng.uniform(-180.0, 180.0, 3)
        length, radius = rng.uniform(0.02, 0.6, 2)
        placed = {"name": f"can {number}", "center": tuple(center), "rpy_deg": tuple(rpy)}
        found.append(Cylinder(**placed, length=length, radius=radius))
    corners = [(0.5, 0.5, 0.5), (1.0, 0.5, 0.6), (0.6, 1.0, 0.5), (0.5, 0.6, 1.0)]
    return [*found, *Mesh.of("wedge", corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).solids]


@pytest.mark.parametrize("kind", ["capsule", "urdf", "bodies"])
def test_no_bound_is_above_the_distance_and_most_are_near_it(robot, kind, tmp_path_factory):
    arm = loaded_arm("lift", tmp_path_factory) if kind == "bodies" else robot
    rng = np.random.default_rng(2)
    solids, links = [*many(rng), *others(rng)], "urdf" if kind == "urdf" else "capsule"
    checker = CoalScene(arm, solids, links=links, growth=0.01, clearance=0.02)
    pairs = np.arange(len(checker.pairs))
    errors, close = checker.distance_errors, 0
    for q in rng.uniform(arm.lower, arm.upper, (20, arm.dof)):
        distances = checker.pair_distances(q)
        bounds = checker.lower_bounds(q, pairs)
        assert (bounds <= distances + errors + 1e-6 * np.abs(distances)).all()
        close += int((bounds > 0.5 * distances).sum())
    assert close > 0.8 * 20 * len(pairs)


@pytest.mark.parametrize("name", ["toy", "lift"])
def test_no_bounds_are_given_of_a_robot_whose_joints_stand_elsewhere_than_pinocchio_says(
    name, tmp_path_factory, monkeypatch
):
    arm = loaded_arm(name, tmp_path_factory)
    assert (box_bounds.joints_as_pinocchio(arm) == joints_alone(arm)).all()
    for at in (flat_bodies.HEAD + 10, flat_bodies.HEAD + flat_bodies.PLACE):  # a turn's cosine, a place
        wrong = joints_alone(arm).copy()
        wrong[at] += 1e-6
        monkeypatch.setattr(box_bounds, "joints_alone", lambda _, wrong=wrong: wrong)
        with pytest.raises(RobotFileError, match=arm.joint_names[0]):
            box_bounds.joints_as_pinocchio.__wrapped__(arm)


def test_the_nearest_pair_is_that_of_all_distances(robot):
    rng = np.random.default_rng(3)
    checker = CoalScene(robot, many(rng))
    for q in rng.uniform(robot.lower, robot.upper, (40, robot.dof)):
        kept = rng.uniform(0.0, 0.05, len(checker.pairs))
        pair, distance = checker.nearest_pair(q, kept)
        beyond = checker.pair_distances(q) - kept
        assert distance - kept[pair] == pytest.approx(beyond.min(), abs=1e-9)
        assert beyond[pair] == pytest.approx(beyond.min(), abs=1e-9)


def test_capsules_placed_together_are_those_placed_alone():
    rng = np.random.default_rng(5)
    ends = rng.normal(size=(60, 2, 3))
    ends[:6, 1] = ends[:6, 0] + [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 0, 0), (1e-9, 0, -1), (0, -1e-200, 0)]
    capsules = [
        Capsule(name=f"c{k}", start=tuple(a), end=tuple(b), radius=0.1 + 0.01 * k)
        for k, (a, b) in enumerate(ends.tolist())
    ]
    for found, capsule in zip(capsule_shapes(capsules), capsules, strict=True):
        alone = solid_shape(capsule)
        assert found.name == alone.name
        assert found.placement.isApprox(alone.placement, 1e-12)
        assert found.geometry.radius == alone.geometry.radius
        assert found.geometry.halfLength == pytest.approx(alone.geometry.halfLength, rel=1e-15, abs=0.0)
    assert capsule_shapes([]) == []


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """An arm that can touch itself and its base."""
    spec = ArmSpec(
        name="wide",
        has_yaw=True,
        link_lengths=(1.0, 0.8, 0.4),
        link_half_widths=(0.05, 0.04, 0.03),
        link_masses=(4.0, 3.0, 1.0),
        lower=(-3.0, -2.6, -2.6, -2.6),
        upper=(3.0, 2.6, 2.6, 2.6),
        velocity=(1.5,) * 4,
        effort=(300.0,) * 4,
        acceleration=(3.0,) * 4,
        jerk=(150.0,) * 4,
        shoulder_height=0.6,
    )
    return load_robot(write_robot(spec, tmp_path_factory.mktemp("arm") / "wide.urdf")[0])


@pytest.mark.parametrize("links", ["capsule", "urdf"])
@pytest.mark.parametrize("count", [0, 7, 13])
def test_models_of_few_obstacles_answer_as_one_of_all(wide, links, count, monkeypatch):
    rng = np.random.default_rng(count)
    obstacles = random_obstacles(rng, count)
    if count > 6:
        obstacles[4] = Cloud.of("cloud", rng.uniform([0.4, -0.6, 0.5], [1.8, 0.6, 1.7], (30, 3)), 0.02)
    growth = rng.uniform(0.0, 0.05, count)
    whole = CoalScene(wide, obstacles, links=links, growth=growth)
    monkeypatch.setattr(module, "_CHUNK", 3)
    parts = CoalScene(wide, obstacles, links=links, growth=growth)
    assert parts.pairs == whole.pairs
    assert len(parts.parts.own) > 0
    configurations = rng.uniform(wide.lower, wide.upper, (80, wide.dof))
    if count:
        name = obstacles[-1].name
        whole, parts = whole.touching(name), parts.touching(name)
    for q in configurations[:20]:
        np.testing.assert_array_equal(parts.pair_distances(q), whole.pair_distances(q))
        asked = rng.permutation(len(whole.pairs))[:11]
        for checker in (whole, parts):
            checker.place(q[::-1].clip(wide.lower, wide.upper))
        np.testing.assert_array_equal(parts.distances_of(asked), whole.distances_of(asked))
        np.testing.assert_array_equal(parts.distances(q), whole.distances(q))
    for margin in (-0.01, 0.0, 0.1):
        np.testing.assert_array_equal(
            parts.in_collision(configurations, margin=margin), whole.in_collision(configurations, margin=margin)
        )


def test_scenes_that_share_a_model_of_the_arms_own_pairs_answer_each_for_itself(wide, monkeypatch):
    rng = np.random.default_rng(9)
    obstacles = random_obstacles(rng, 4)
    alone = CoalScene(wide, obstacles)
    monkeypatch.setattr(arm_pairs, "_MANY", 1)
    monkeypatch.delitem(vars(alone.parts), "shape_pairs")
    first, second = CoalScene(wide, obstacles), CoalScene(wide, [])
    assert isinstance(first.parts.shape_pairs, module.ArmPairs)
    monkeypatch.delitem(vars(alone.parts), "shape_pairs")
    pairs = np.arange(len(alone.pairs))
    of_arm = pairs[-len(alone.parts.own) :]
    for q, other in rng.uniform(wide.lower, wide.upper, (20, 2, wide.dof)):
        for checker, at in ((alone, q), (first, q), (second, other)):
            checker.place(at)
        distances = alone.distances_of(pairs)
        np.testing.assert_allclose(first.distances_of(pairs), distances, rtol=1e-12, atol=1e-12)
        bounds = first.lower_bounds(q, pairs)
        assert (bounds <= distances + alone.distance_errors).all()
        np.testing.assert_array_equal(alone.lower_bounds(q, pairs), bounds)
        elsewhere = alone.pair_distances(other)[of_arm]
        np.testing.assert_allclose(second.distances_of(of_arm - of_arm[0]), elsewhere, rtol=1e-12, atol=1e-12)
    assert (bounds[of_arm] > 0.0).any()


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


def test_the_gradient_is_that_of_the_nearest_points() -> None:
    for seed in range(30):
        first, rotation, shift, second = random_hulls(seed)
        found, work = measured(first, rotation, shift, second)
        direction = work[NEAREST : NEAREST + 3] / found if found > 0.0 else work[NEAREST : NEAREST + 3] / -found
        ahead = [measured(first, rotation, shift + 1e-7 * axis, second)[0] for axis in np.eye(3)]
        behind = [measured(first, rotation, shift - 1e-7 * axis, second)[0] for axis in np.eye(3)]
        slope = (np.array(ahead) - np.array(behind)) / 2e-7
        assert slope == pytest.approx(direction if found > 0.0 else -direction, abs=1e-5)
