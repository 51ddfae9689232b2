"""Distances by coal, of all kinds of obstacles and clouds, and their accuracy."""

from __future__ import annotations

import dataclasses
import re
import shutil
import struct
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from arm_variants import coal_distances, from_obstacles, random_obstacles
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.base.data_files import urdf_dir
from hplan.certificate.certificate import certify
from hplan.collision.coal_accuracy import CURVED, ITERATION, PARALLEL, SIZE, distance_errors, extents
from hplan.collision.coal_arm import base_radius
from hplan.collision.coal_cloud import BareShape, PointBlocks, distance_from, likely_block, next_block
from hplan.collision.coal_scene import CoalScene, base_contacts
from hplan.collision.coal_shapes import solid_shape
from hplan.geometry.cloud import Cloud
from hplan.geometry.coal_hull import convex_hull_shape
from hplan.geometry.hull import CUBE_CORNERS, hull_of
from hplan.geometry.shape_outline import coal_distance
from hplan.planar.family_reader import family_of
from hplan.robot.family import HARVESTER, write_robot
from hplan.robot.model import load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Cylinder, Sphere
from hplan.trajectory.trajectory import Trajectory

FLAT = np.zeros(4)

#: No pairs of parts of the arm, as `distance_errors` takes their extents.
NO_PAIRS = np.zeros((0, 2, 3))


def ball(x, y, z, radius=0.1, name="ball"):
    return Sphere(name=name, center=(x, y, z), radius=radius)


# Distances


def test_distances_to_all_kinds(robot):
    rng = np.random.default_rng(2)
    for _ in range(10):
        obstacles = random_obstacles(rng, 9)
        checker = CoalScene(robot, obstacles)
        for q in rng.uniform(robot.lower, robot.upper, (5, 4)):
            found, expected = from_obstacles(checker, q), coal_distances(robot, q, obstacles)
            np.testing.assert_allclose(np.where(expected > 0, found, 0), np.maximum(expected, 0), atol=1e-6)
            assert ((found <= 1e-6) == (expected <= 1e-6)).all()


# Hulls and clouds


def test_hull_of_corners_is_the_box(robot):
    rng = np.random.default_rng(5)
    for index in range(6):
        box = random_obstacles(rng, 3)[2]
        hull = hull_of(box.core, "hull")
        grown = dataclasses.replace(hull, rounding=0.05)
        checker = CoalScene(robot, [box, hull, grown])
        for q in rng.uniform(robot.lower, robot.upper, (8, 4)):
            found = from_obstacles(checker, q)
            apart = found[:, 0] > 1e-6
            np.testing.assert_allclose(found[apart, 1], found[apart, 0], atol=1e-6)
            np.testing.assert_allclose(found[apart, 2], found[apart, 0] - 0.05, atol=1e-6)
            assert (found[~apart] <= 1e-6).all()
        assert checker.obstacle_names[: checker.own_first] == (box.name, "hull", "hull")
        assert index < 6


@pytest.mark.parametrize("shape", ["room", "wall", "wire", "one", "twins"])
def test_cloud_is_its_balls(robot, shape):
    """The tree against its balls one by one."""
    rng = np.random.default_rng(6)
    points = rng.uniform([0.4, -0.6, 0.5], [1.8, 0.6, 1.7], (60, 3))
    points = {
        "room": points,
        "wall": points * [0, 1, 1] + [1.4, 0, 0],
        "wire": points * [1, 0, 0] + [0, 0.2, 1.3],
        "one": points[:1],
        "twins": np.repeat(points[:2], 9, axis=0),
    }[shape]
    cloud = Cloud.from_points("cloud", points, 0.03)
    balls = [Sphere(name=f"b{i}", center=tuple(point), radius=0.03) for i, point in enumerate(cloud.core.tolist())]
    checker, by_balls = (CoalScene(robot, solids) for solids in ([cloud], balls))
    configurations = rng.uniform(robot.lower, robot.upper, (40, 4)) * [0.3, 1, 1, 1]
    least = []
    for q in configurations:
        found, expected = from_obstacles(checker, q)[:, 0], from_obstacles(by_balls, q).min(axis=1)
        reached = expected <= -0.03 + 1e-6  # the links reach the points themselves
        np.testing.assert_allclose(found[~reached], expected[~reached], atol=3e-6)
        assert (found[reached] <= -0.03 + 2e-6).all()
        least.append(expected.min())
    for margin in (0.0, 0.1, -0.01):
        sure = np.abs(np.array(least) - margin) > 1e-5
        touching = checker.in_collision(configurations, margin=margin)
        assert (touching == (np.array(least) <= margin))[sure].all()
    checker.place(configurations[0])
    table = checker.distances_of(np.arange(len(checker.pairs)))
    assert min(table) == pytest.approx(checker.distances(configurations[0]).min())


# Grown obstacles, and touchable obstacles


def test_growth_of_each_obstacle(robot):
    rng = np.random.default_rng(7)
    cloud = Cloud.from_points("cloud", rng.uniform([0.4, -0.6, 0.5], [1.8, 0.6, 1.7], (30, 3)), 0.02)
    obstacles = [*random_obstacles(rng, 6), cloud]
    growth = rng.uniform(0.0, 0.1, len(obstacles))
    plain = CoalScene(robot, obstacles)
    for asked in (growth, 0.05):
        grown, by = CoalScene(robot, obstacles, growth=asked), np.broadcast_to(asked, len(obstacles))
        configurations = rng.uniform(robot.lower, robot.upper, (60, 4))
        least = []
        for q in configurations:
            np.testing.assert_allclose(from_obstacles(grown, q), from_obstacles(plain, q) - by, atol=1e-5)
            least.append(float(grown.distances(q).min()))
            grown.place(q)
            one_by_one = grown.distances_of(np.arange(len(grown.pairs)))
            np.testing.assert_allclose(grown.pair_distances(q), one_by_one, atol=1e-5)  # coal starts from another guess
            assert grown.nearest_contact(q).distance_m == pytest.approx(least[-1], abs=1e-5)
        sure = np.abs(least) > 1e-4
        np.testing.assert_array_equal(grown.in_collision(configurations)[sure], (np.array(least) <= 0.0)[sure])


def test_last_link_may_touch(robot):
    fruit, other = ball(2.1, 0, 0.6, radius=0.05, name="fruit"), ball(2.0, 0.3, 0.7, name="other")
    checker = CoalScene(robot, [fruit, other], growth=[0.01, 0.0])
    free = checker.allow_touch("fruit")
    full, table = from_obstacles(checker, FLAT), from_obstacles(free, FLAT)
    assert full[2, 0] < 0.0
    assert table[2, 0] == np.inf
    np.testing.assert_array_equal(table[:2], full[:2])
    np.testing.assert_array_equal(table[:, 1], full[:, 1])
    assert checker.in_collision([FLAT]).tolist() == [True]
    assert free.in_collision([FLAT]).tolist() == [False]
    assert checker.nearest_contact(FLAT).obstacle == "fruit"
    nearest = free.distances(FLAT)[:, : free.own_first].min()
    assert nearest == free.distances(FLAT)[:, 1].min()
    pairs = free.pair_distances(FLAT)
    assert np.isinf(pairs).sum() == sum(checker.obstacle_names[o] == "fruit" and k == 2 for k, o in checker.pairs)
    free.place(FLAT)
    assert free.distances_of(np.flatnonzero(np.isinf(pairs))[:1]) == np.inf
    # Of others, and of links before the last, it is still an obstacle.
    assert free.in_collision([[0.0, 0.0, 0.0, 0.0], [0.15, 0.05, 0.0, 0.0]]).tolist() == [False, True]
    onto = checker.allow_touch("other").allow_touch("fruit")
    assert np.isinf(from_obstacles(onto, FLAT)[2]).all()
    assert (from_obstacles(checker.allow_touch("nobody"), FLAT) == full).all()
    inside = CoalScene(robot, [ball(1.4, 0, 0.6, name="fruit")]).allow_touch("fruit")
    assert inside.in_collision([FLAT]).tolist() == [True]
    assert inside.nearest_contact(FLAT).link == "forearm"


# Shapes of the links


def test_meshes_are_filled(tmp_path):
    """A bead wholly inside a link's mesh touches no face of it."""
    corners = 0.5 * np.array([(x, y, z) for x in (0, 1) for y in (-0.2, 0.2) for z in (-0.2, 0.2)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [corners[[a, b, c]] for q in quads for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]
    triangles = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(face), 0) for face in faces)
    (tmp_path / "bar.stl").write_bytes(bytes(80) + struct.pack("<I", len(faces)) + triangles)
    text = (urdf_dir() / "harvester.urdf").read_text()
    mesh = '<collision><geometry><mesh filename="bar.stl"/></geometry></collision>'
    text = re.sub(r'<collision name="hand.*</collision>', mesh, text, flags=re.DOTALL)
    (tmp_path / "harvester.urdf").write_text(text)
    shutil.copy(urdf_dir() / "harvester.limits.yaml", tmp_path)
    robot = load_robot(tmp_path / "harvester.urdf")
    inside, beside = ball(2.1, 0, 0.6, radius=0.01), ball(2.1, 0.3, 0.6, radius=0.01, name="beside")
    checker = CoalScene(robot, [inside, beside])
    assert checker.distances(FLAT)[2, 0] < 0
    assert checker.distances(FLAT)[2, 1] == pytest.approx(0.19, abs=1e-5)
    assert checker.in_collision([FLAT]).tolist() == [True]


def test_flat_and_needle_like_hulls_do_not_end_the_process(robot):
    """coal's own convex hull of these does."""
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    assert convex_hull_shape(flat).num_points == 8
    assert convex_hull_shape(np.array([[0.0, 0, 0], [0, 0, 1]])).num_points >= 4
    rng = np.random.default_rng(0)
    needle = hull_of(rng.uniform(-1.0, 1.0, (12, 3)) * [1.4e-5, 1e-5, 3e-2] + [2.1, 0.0, 1.6], "needle")
    checker = CoalScene(robot, [needle])
    assert checker.distances(FLAT)[2, 0] == pytest.approx(needle.core[:, 2].min() - 0.6 - 0.03, abs=1e-4)


# Yes or no for many configurations


@pytest.mark.parametrize("margin", [0.0, 0.05, -0.02])
def test_in_collision_agrees_with_distances(robot, margin):
    rng = np.random.default_rng(5)
    seen = np.zeros(2, dtype=int)
    for _ in range(3):
        checker = CoalScene(robot, random_obstacles(rng, 12))
        q = rng.uniform(robot.lower, robot.upper, (120, 4))
        least = np.array([checker.distances(row).min() for row in q])
        decided = np.abs(least - margin) > 1e-4
        found = checker.in_collision(q, margin=margin)
        np.testing.assert_array_equal(found[decided], least[decided] <= margin)
        seen += np.bincount(found, minlength=2)
    assert seen.min() > 10


# Static bodies


def test_base_contacts(robot):
    foot = Box(name="foot", center=(0, 0, 0.05), size=(0.02, 0.02, 0.02))
    far = ball(1.5, 0.5, 0.5, name="far")
    found = base_contacts(robot, [far, foot])
    assert {contact.obstacle for contact in found} == {"foot"}
    assert {contact.link for contact in found} <= {"base_link", "turret"}
    assert all(contact.distance_m <= 0.0 for contact in found)
    assert base_contacts(robot, [far]) == ()
    assert base_contacts(robot, []) == ()
    near = base_contacts(robot, [far], margin=2.0)
    assert {contact.obstacle for contact in near} == {"far"}
    assert all(0.0 < contact.distance_m <= 2.0 for contact in near)


@pytest.mark.parametrize(("offsets", "least"), [({}, 0.6), ({"yaw_axis": (0.5, -0.4)}, 0.8)])
def test_ball_about_the_base(offsets, least, tmp_path):
    """It encloses pedestal and turret, and is not far too large."""
    robot = load_robot(write_robot(replace(HARVESTER, **offsets), tmp_path / "arm.urdf")[0])
    radius = base_radius(robot)
    assert least < radius < least + 0.25
    rng = np.random.default_rng(8)
    for direction in rng.normal(size=(40, 3)):
        place = (radius + 0.0201) * direction / np.linalg.norm(direction)
        assert base_contacts(robot, [ball(*place, radius=0.02)]) == ()


def test_deep_collisions_are_not_missed(robot):
    # Axes of links in the faces of boxes, and boxes amid beams: coal 3.0 misses some contacts in queries without
    # distances.
    boxes = [
        Box(name=f"box {i}", center=(x, y, 0.6 + z), size=(0.2, 0.1, 0.04))
        for i, (x, y, z) in enumerate((x, y, z) for x in (0.5, 1.0, 1.1, 2.1) for y in (0.0, 0.05) for z in (0.0, 0.02))
    ]
    missed = []
    for box in boxes:
        checker = CoalScene(robot, (box,))
        assert checker.distances(np.zeros(4)).min() < -0.01
        if not checker.in_collision(np.zeros((1, 4)))[0]:
            missed.append(box.center)
    assert missed == []


def swept_block() -> coal.Convex:
    """A block with a radius about it, as bodies of meshes have."""
    points = CUBE_CORNERS * np.array([0.15, 0.05, 0.25])
    shape = convex_hull_shape(points)
    shape.setSweptSphereRadius(0.03)
    return shape


SHAPES = {
    "capsule": coal.Capsule(0.04, 0.7),
    "box": coal.Box(0.3, 0.1, 0.5),
    "cylinder": coal.Cylinder(0.1, 0.4),
    "sphere": coal.Sphere(0.2),
    "swept": swept_block(),
}


def placed(rng: np.random.Generator) -> pin.SE3:
    turn = pin.Quaternion(*(lambda q: q / np.linalg.norm(q))(rng.normal(size=4)))
    return pin.SE3(turn.toRotationMatrix(), rng.uniform(-1.0, 1.0, 3))


def brute_force(points: np.ndarray, shape: coal.CollisionGeometry, place: pin.SE3) -> float:
    bead = coal.Sphere(1e-3)
    return min(coal_distance(bead, pin.SE3(np.eye(3), point), shape, place) + 1e-3 for point in points)


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.sampled_from(sorted(SHAPES)), st.sampled_from([1, 40, 700]))
def test_blocks_are_their_points(seed, kind, count):
    rng = np.random.default_rng(seed)
    cloud = Cloud.from_points("cloud", rng.uniform(-1.0, 1.0, (count, 3)) * [1.0, 1.0, rng.choice([0.0, 1.0])], 0.02)
    shape, place = SHAPES[kind], placed(rng)
    found, expected = (
        PointBlocks.from_cloud(cloud).distance(BareShape.strip(shape), place),
        brute_force(cloud.core, shape, place),
    )
    if expected > 1e-5:
        assert found == pytest.approx(expected, abs=3e-6)
        assert distance_from(cloud)(shape, place) == pytest.approx(expected - 0.02, abs=3e-6)
        for most in (expected - 0.03, expected - 0.01):
            asked = distance_from(cloud, most)(shape, place)
            assert asked == pytest.approx(expected - 0.02, abs=3e-6) or (asked == np.inf and most < expected - 0.02)
    else:
        assert found <= 2e-5


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.sampled_from(sorted(SHAPES)))
def test_blocks_that_are_passed_over_are_beyond_the_limit(seed, kind):
    rng = np.random.default_rng(seed)
    cloud, place = Cloud.from_points("cloud", rng.uniform(-1.0, 1.0, (1000, 3)), 0.02), placed(rng)
    shape, limit, towards = BareShape.strip(SHAPES[kind]), rng.choice([0.1, 0.5]), rng.normal(size=3)
    poses, body, tree = (place.rotation, place.translation), (shape.core, shape.corners), (cloud.tree, cloud.core)
    bound, seen = likely_block(poses, body, tree)
    found, block = {seen}, -1
    while (block := next_block(poses, body, tree, (block + 1, seen), towards, limit)) >= 0:
        assert block not in found
        found.add(block)
    leaves = np.flatnonzero(cloud.tree[:, 2] == np.arange(len(cloud.tree)) + 1).tolist()
    assert found <= set(leaves)
    for leaf in leaves:
        away = brute_force(cloud.core[slice(*cloud.tree[leaf, :2].astype(int))], shape.geometry, place)
        assert away >= bound - shape.rounding - 3e-6 or away <= 0.0
        assert leaf in found or away >= limit - shape.rounding - 3e-6


def turned(z, rng):
    """(3, 3) rotation with a given last axis."""
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def segments_apart(a, b, c, d):
    """Distance of two segments that are apart in their common plane, or nearly, in long doubles."""
    a, b, c, d = (np.asarray(point, dtype=np.longdouble) for point in (a, b, c, d))

    def from_segment(point, begin, end):
        along = end - begin
        share = np.clip(((point - begin) @ along) / (along @ along), 0.0, 1.0)
        return np.sqrt(((point - begin - share * along) ** 2).sum())

    return min(from_segment(a, c, d), from_segment(b, c, d), from_segment(c, a, b), from_segment(d, a, b))


def capsule_object(radius, length):
    return pin.GeometryObject("capsule", 0, 0, pin.SE3.Identity(), coal.Capsule(radius, length))


@pytest.mark.parametrize(("first", "second"), [(1.0, 1.0), (1.0, 0.05), (0.05, 0.05), (0.005, 1.0), (0.005, 0.005)])
def test_nearly_parallel_capsules(first, second):
    rng, worst, radius = np.random.default_rng(3), 0.0, 0.01
    obstacle = Capsule(name="c", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, second), radius=radius)
    allowed = distance_errors(extents([capsule_object(radius, first)]), [obstacle], NO_PAIRS)[0]
    for _ in range(1500):
        angle = 10.0 ** rng.uniform(-8.5, -6.5) / (first * second) * rng.choice([-1.0, 1.0])
        along, aside = np.eye(3)[:2]
        other = along * np.cos(angle) + aside * np.sin(angle)
        center = aside * rng.uniform(0.03, 0.1) + along * rng.uniform(-0.5, 0.5) * (first + second)
        ends = [0.5 * first * along, 0.5 * second * other]
        true = segments_apart(-ends[0], ends[0], center - ends[1], center + ends[1]) - 2 * np.longdouble(radius)
        found = coal.distance(
            coal.Capsule(radius, first), coal.Transform3s(turned(along, rng), np.zeros(3)),
            coal.Capsule(radius, second), coal.Transform3s(turned(other, rng), center),
            coal.DistanceRequest(), coal.DistanceResult(),
        )  # fmt: skip
        worst = max(worst, float(found - true))
    assert worst <= allowed
    # The allowed error really occurs.
    assert worst > 0.8 * PARALLEL / max(first, second)


@pytest.mark.parametrize("size", [1.0, 1e2, 1e4])
def test_capsules_above_large_boxes(size):
    rng = np.random.default_rng(4)
    box = Box(name="b", center=(0.0, 0.0, -0.5 * size), size=(size,) * 3)
    allowed = distance_errors(extents([capsule_object(0.05, 1.0)]), [box], NO_PAIRS)[0]
    assert allowed >= SIZE * size
    placed = solid_shape(box)
    for _ in range(500):
        along = rng.normal(size=3)
        along /= np.linalg.norm(along)
        gap = 10.0 ** rng.uniform(-5.0, 0.0)
        center = np.array([*rng.uniform(-0.3, 0.3, 2) * size, gap + 0.05 + 0.5 * abs(along[2])])
        if size < 10.0:
            center[:2] = 0.0
        found = coal.distance(
            coal.Capsule(0.05, 1.0), coal.Transform3s(turned(along, rng), center),
            placed.geometry, coal.Transform3s(placed.placement.rotation, placed.placement.translation),
            coal.DistanceRequest(), coal.DistanceResult(),
        )  # fmt: skip
        if size >= 10.0 or abs(along[2]) > 0.9:
            assert found - gap <= allowed


def from_cylinder(points, cylinder):
    """Distances of (k, 3) points from a cylinder on z at the origin."""
    beyond = np.abs(points[:, 2]) - 0.5 * cylinder.length
    outside = np.hypot(points[:, 0], points[:, 1]) - cylinder.radius
    return np.hypot(np.maximum(beyond, 0.0), np.maximum(outside, 0.0))


def least_along(start, end, cylinder):
    """Distance of a segment from the cylinder, by successively finer grids.

    The distance is a convex function along the segment.
    """
    low, high = 0.0, 1.0
    for _ in range(12):
        share = np.linspace(low, high, 33)
        apart = from_cylinder(start + share[:, None] * (end - start), cylinder)
        at = int(apart.argmin())
        low, high = share[max(at - 1, 0)], share[min(at + 1, 32)]
    return apart.min()


@pytest.mark.parametrize("farthest", [0.05, 10.0])
@pytest.mark.parametrize("sizes", [(0.003, 0.5), (1.0, 100.0)])
def test_capsules_about_cylinders(sizes, farthest):
    rng, over = np.random.default_rng(6), []
    for _ in range(300):
        length, radius = np.exp(rng.uniform(*np.log(sizes), 2))
        can = Cylinder(name="c", center=(0.0, 0.0, 0.0), length=length, radius=radius)
        placed, reach = solid_shape(can).geometry, rng.uniform(0.05, 1.5)
        allowed = distance_errors(extents([capsule_object(0.05, reach)]), [can], NO_PAIRS)[0]
        along, away = rng.normal(size=(2, 3)) * [1.0, 1.0, rng.choice([0.0, 1.0])]
        along, away = (ray / np.linalg.norm(ray) for ray in (along, away))
        shares = rng.permutation([1.0, rng.random(), 1.0])[:2]  # on the side, an end, or the rim between them
        aside = shares[0] * radius * away[:2] / np.linalg.norm(away[:2])
        start = np.append(aside, np.copysign(shares[1] * 0.5 * length, away[2])) + away * (
            0.05 + farthest * rng.random()
        )
        end = start + along * reach
        expected = least_along(start, end, can) - 0.05
        found = coal.distance(
            coal.Capsule(0.05, reach), coal.Transform3s(turned(along, rng), 0.5 * (start + end)),
            placed, coal.Transform3s(np.eye(3), np.zeros(3)), coal.DistanceRequest(), coal.DistanceResult(),
        )  # fmt: skip
        if expected > 0.0:
            assert found - expected <= allowed
            over.append(found - expected)
        else:
            assert found <= 1e-6
    assert len(over) > 100
    # The allowance is needed, far away.
    assert max(over) > (0.0 if farthest < 1.0 else 0.3 * CURVED)


def test_one_for_each_pair(robot):
    obstacles = [
        Sphere(name="s", center=(3.0, 0.0, 0.0), radius=0.5),
        Capsule(name="c", start=(3.0, 0.0, 0.0), end=(3.0, 0.0, 0.01), radius=0.1),
        Box(name="b", center=(3.0, 0.0, 0.0), size=(30.0, 40.0, 0.1)),
    ]
    checker = CoalScene(robot, obstacles)
    errors = checker.distance_errors
    assert errors.shape == (len(checker.pairs),)
    table = errors[: 3 * len(checker.link_names)].reshape(-1, 3)
    lengths = family_of(robot).arm.lengths
    np.testing.assert_allclose(table[:, 1] - table[:, 0], PARALLEL / lengths, atol=2e-9)
    np.testing.assert_allclose(table[:, 2], ITERATION + 50.0 * SIZE, rtol=1e-4)
    np.testing.assert_array_equal(checker.allow_touch("s").distance_errors, errors)


def test_proof_takes_them_off(robot, monkeypatch):
    """At rest, half of the slack is certified: of the distance less the error."""
    zero = np.zeros((1, 4))
    still = Trajectory(
        robot.joint_names, np.zeros(1), zero, zero, zero, robot.dynamics.torques(zero, zero, zero), robot.slides
    )
    ball = Sphere(name="s", center=(1.0, 0.0, 1.0), radius=0.2)
    rest = (0.0,) * 4
    scene = Scene(name="s", start=Start(joints_rad=rest), goal=Goal(joints_rad=rest), obstacles=(ball,))
    found = certify(robot, scene, still)
    errors = CoalScene(robot, scene.solids).distance_errors
    assert found.verified
    assert found.min_clearance_m == pytest.approx(0.5 * (found.nearest.distance_m - errors[0]), rel=1e-9)
    wide = CoalScene(robot, scene.solids)
    wide.distance_errors = errors + found.nearest.distance_m
    assert not certify(robot, scene, still, checker=wide).verified
