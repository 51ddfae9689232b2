from __future__ import annotations

import math

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_cspace import point_segment, segment_polygon

from hplan.cspace import joint_grid, occupancy
from hplan.errors import OptionError
from hplan.scene import Box, Capsule, Sphere
from hplan.section import (
    DIRECTIONS,
    SECTION_ERROR,
    RoundedPolygon,
    arm_sections,
    planar_sections,
    plane_section,
)

BOX_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def beyond(section, points):
    """Distances of plane points (k, 2) from a section; 0 inside."""
    return np.maximum(segment_polygon(points, points, section.vertices) - section.radius, 0.0)


def box_distance(points, centre, rotation, size):
    local = (points - centre) @ rotation
    return np.linalg.norm(np.maximum(np.abs(local) - 0.5 * np.asarray(size), 0.0), axis=1)


def in_space(points):
    return np.column_stack([points, np.zeros(len(points))])


def around(core, radius, rng, count=2000):
    """Plane points in and around the shadow of a body."""
    low, high = core[:, :2].min(axis=0) - 1.3 * radius, core[:, :2].max(axis=0) + 1.3 * radius
    return rng.uniform(low, high, (count, 2))


# The section itself


def random_capsule(rng):
    """Ends beside, across or nearly in the plane."""
    core = rng.uniform(-1.0, 1.0, (2, 3)) * rng.choice([1.0, 0.2, 0.01], (2, 3))
    return core, rng.choice([0.01, 0.05, 0.3])


def random_box(rng):
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    size = rng.choice([0.02, 0.3, 1.0], 3) * rng.uniform(0.5, 1.0, 3)
    centre = np.array([0.3, 0.2, rng.uniform(-0.5, 0.5) * rng.choice([0.0, 0.1, 1.0])])
    return centre, rotation, size, rng.choice([0.001, 0.03, 0.2])


def check(core, radius, distances_of, rng):
    """Nothing of the body outside the section, nothing of the section SECTION_ERROR outside the body."""
    section = plane_section(core, radius)
    points = around(core, radius, rng)
    distances = distances_of(in_space(points))
    touching = distances <= radius
    if section is None:
        assert not touching.any()
        return 0
    assert beyond(section, points[touching]).max(initial=0.0) == 0.0
    if len(section.vertices) >= 3:
        # Of two convex sets, one in the other, the largest distance is the largest difference of supports. It shows
        # at the corners.
        along = np.roll(section.vertices, -1, axis=0) - section.vertices
        normals = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
        directions = normals + np.roll(normals, 1, axis=0)
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        stands_out = np.max(section.vertices @ directions.T, axis=0) - supports(core, radius, directions)
        assert stands_out.max() <= SECTION_ERROR
        assert stands_out.min() >= 0.0
    return len(section.vertices)


def supports(core, radius, directions):
    """Support of the section by convex duality, where the code goes by projection: golden section on the dual."""
    reach, heights = core[:, :2] @ directions.T, core[:, 2:]

    def bound(tilts):
        return np.max(reach + tilts * heights, axis=0) + radius * np.hypot(1.0, tilts)

    low, high = np.full(len(directions), -1e4), np.full(len(directions), 1e4)
    for _ in range(100):
        a, b = low + 0.382 * (high - low), low + 0.618 * (high - low)
        left = bound(a) < bound(b)
        low, high = np.where(left, low, a), np.where(left, b, high)
    return bound(0.5 * (low + high))


def test_capsules():
    rng = np.random.default_rng(1)
    sides = []
    for _ in range(200):
        core, radius = random_capsule(rng)
        sides.append(check(core, radius, lambda p, c=core: point_segment(p, c[0], c[1]), rng))
    assert np.mean(np.array(sides) > 0) > 0.5


def test_boxes():
    rng = np.random.default_rng(2)
    sides = []
    for _ in range(200):
        centre, rotation, size, radius = random_box(rng)
        core = centre + (BOX_CORNERS * size) @ rotation.T
        sides.append(check(core, radius, lambda p, b=(centre, rotation, size): box_distance(p, *b), rng))
    assert np.mean(np.array(sides) > 0) > 0.5


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_any_capsule(seed):
    rng = np.random.default_rng(seed)
    core, radius = random_capsule(rng)
    check(core, radius, lambda p: point_segment(p, core[0], core[1]), rng)


def test_no_point_of_the_section_is_far_outside():
    """The bound in the plane itself, against a fine raster, for a long branch a little out of the plane."""
    core, radius = np.array([[-0.3, -0.1, -0.02], [0.4, 0.2, 0.03]]), 0.05
    section = plane_section(core, radius)
    step = 5e-4
    raster = np.meshgrid(np.arange(-0.4, 0.5, step), np.arange(-0.2, 0.3, step))
    points = np.stack(raster, axis=-1).reshape(-1, 2)
    distances = point_segment(in_space(points), core[0], core[1])
    rim = points[(distances <= radius) & (distances > radius - 2 * step)]
    outside = points[(distances > radius) & (distances < radius + 4 * SECTION_ERROR)]
    assert beyond(section, rim).max() == 0.0
    too_much = outside[beyond(section, outside) == 0.0]
    assert len(too_much) > 10
    worst = max(np.linalg.norm(rim - point, axis=1).min() for point in too_much)
    assert worst <= SECTION_ERROR + step


@pytest.mark.parametrize("height", [0.0, 0.1, 0.2, -0.2499])
def test_sphere_is_exact(height):
    section = plane_section(np.array([[1.0, 2.0, height]]), 0.25)
    assert section.vertices.tolist() == [[1.0, 2.0]]
    assert section.radius == pytest.approx(math.sqrt(0.25**2 - height**2), abs=1e-15)


def test_core_in_the_plane_is_exact():
    section = plane_section(np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.0]]), 0.1)
    assert section.vertices.tolist() == [[0.0, 0.0], [1.0, 0.5]]
    assert section.radius == 0.1


def test_flat_box_in_the_plane_keeps_its_corners_counter_clockwise():
    corners = np.array([(x, y, 0.0) for x in (0.0, 2.0) for y in (0.0, 1.0)])
    section = plane_section(corners, 0.1)
    assert section.vertices.tolist() == [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]
    assert section.radius == 0.1


def test_upright_cylinder_is_a_disc():
    """Across the plane a capsule shows a circle: the tangents stand 1 / cos(pi / DIRECTIONS) outside at most."""
    section = plane_section(np.array([[0.2, 0.3, -1.0], [0.2, 0.3, 1.0]]), 0.04)
    distance = np.linalg.norm(section.vertices - [0.2, 0.3], axis=1)
    assert distance.min() > 0.04
    assert distance.max() < 0.04 / math.cos(math.pi / DIRECTIONS) + 1e-9


def test_square_post_keeps_its_corners():
    corners = BOX_CORNERS * [0.1, 0.2, 2.0]
    section = plane_section(corners, 1e-6)
    low, high = section.vertices.min(axis=0), section.vertices.max(axis=0)
    np.testing.assert_allclose([low, high], [[-0.05, -0.1], [0.05, 0.1]], atol=2e-6)
    assert beyond(section, np.array([[0.05, 0.1]])) == 0.0
    assert beyond(section, np.array([[0.051, 0.1]])) > 0.9e-3


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("core", [[[0, 0, 1], [1, 0, 2]], [[0, 0, 1]], [[0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 3]]])
def test_plane_that_just_touches(core, side):
    core = np.array(core, dtype=float) * [1.0, 1.0, side]
    assert plane_section(core, math.nextafter(1.0, 0.0)) is None
    touched = plane_section(core, 1.0)
    lowest = core[np.abs(core[:, 2]) == 1.0][:, :2]
    assert beyond(touched, lowest).max() == 0.0
    spread = max(np.ptp(lowest, axis=0))
    assert np.ptp(touched.vertices, axis=0).max() <= spread + 2e-3
    near = plane_section(core, 1.0 + 1e-9)
    assert np.ptp(near.vertices, axis=0).max() <= spread + 2e-3


def test_capsule_of_no_length_is_a_ball():
    section = plane_section(np.array([[0.1, 0.2, 0.03]] * 2), 0.05)
    points = np.array([[0.1 + 0.04 * math.cos(a), 0.2 + 0.04 * math.sin(a)] for a in np.linspace(0, 7, 50)])
    assert beyond(section, points * (1 - 1e-12)).max() < 1e-9
    assert beyond(section, np.array([[0.1 + 0.041, 0.2]])) > 0.0


def test_larger_than_any_scene_still_ends():
    section = plane_section(np.array([[-1e6, 0.3, -1e6], [1e6, 1e5, 1e6]]), 10.0)
    assert np.isfinite(section.vertices).all()


# Sections for an arm


KINDS = ("sphere", "capsule", "box")


def random_solid(kind, rng, yaw=0.0):
    """An obstacle near the arm plane at the given yaw."""
    turned = pin.utils.rotate("z", yaw)
    place = rng.uniform([0.2, -0.3, 0.2], [1.7, 0.3, 2.3])
    center = tuple(turned @ place)
    if kind == "sphere":
        return Sphere(name="ball", center=center, radius=rng.uniform(0.02, 0.3))
    if kind == "capsule":
        end = tuple(turned @ (place + rng.normal(0.0, 0.5, 3) * rng.choice([0.02, 1.0], 3)))
        return Capsule(name="branch", start=center, end=end, radius=rng.uniform(0.005, 0.1))
    size, rpy = tuple(rng.uniform(0.02, 0.6, 3)), tuple(rng.uniform(-180.0, 180.0, 3))
    return Box(name="crate", center=center, size=size, rpy_deg=rpy)


def coal_model(robot, obstacle):
    """The robot's arm links and one obstacle, in coal."""
    geometry = robot.collision_model.copy()
    if isinstance(obstacle, Sphere):
        shape, rotation, centre = coal.Sphere(obstacle.radius), np.eye(3), obstacle.center
    elif isinstance(obstacle, Box):
        shape, rotation, centre = coal.Box(*obstacle.size), obstacle.rotation, obstacle.center
    else:
        axis = np.subtract(obstacle.end, obstacle.start)
        shape = coal.Capsule(obstacle.radius, float(np.linalg.norm(axis)))
        rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix()
        centre = 0.5 * np.add(obstacle.start, obstacle.end)
    placement = pin.SE3(rotation, np.array(centre))
    index = geometry.addGeometryObject(pin.GeometryObject(obstacle.name, 0, placement, shape))
    for other, shape in enumerate(geometry.geometryObjects):
        if shape.parentJoint > (1 if robot.has_yaw else 0):
            geometry.addCollisionPair(pin.CollisionPair(other, index))
    return geometry


def coal_occupied(robot, obstacle, yaw, grid):
    geometry = coal_model(robot, obstacle)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), axis=-1).reshape(-1, 3)
    q = np.column_stack([np.full(len(index), yaw), grid.coordinates(index)])
    pool = pin.GeometryPool(robot.model, geometry, 1)
    return np.array(pin.computeCollisionsInParallel(1, pool, q.T, True, False), dtype=bool).reshape(grid.shape)


@pytest.mark.parametrize("kind", KINDS)
def test_coal_finds_no_collision_in_a_free_node(robot, kind):
    rng = np.random.default_rng(7)
    grid = joint_grid(robot.arm, math.radians(6.0))
    collisions = refused = free = 0
    for _ in range(60):
        yaw = rng.uniform(-math.pi, math.pi)
        obstacle = random_solid(kind, rng, yaw)
        ours = occupancy(robot.arm, arm_sections(robot, [obstacle], yaw=yaw), grid).occupied
        theirs = coal_occupied(robot, obstacle, yaw, grid)
        assert not (theirs & ~ours).any(), obstacle
        collisions += theirs.sum()
        refused += (ours & ~theirs).sum()
        free += (~theirs).sum()
    assert collisions > 10_000
    # Balls agree node for node; polygons stand out by up to SECTION_ERROR and so refuse a few free nodes.
    assert refused <= (0 if kind == "sphere" else 2e-3 * free)


def test_clearance_grows_the_obstacle(robot):
    ball = Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.15)
    grown = Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.17)
    grid = joint_grid(robot.arm, 0.1)
    with_clearance = occupancy(robot.arm, arm_sections(robot, [ball], clearance=0.02), grid)
    np.testing.assert_array_equal(
        with_clearance.free_words,
        occupancy(robot.arm, arm_sections(robot, [grown]), grid).free_words,
    )


def test_links_meet_their_own_sections(robot):
    """A ball that only the thickest link can reach across the plane; names and indices follow."""
    near = Sphere(name="near", center=(1.0, 0.0, 1.0), radius=0.1)
    aside = Sphere(name="aside", center=(1.0, 0.145, 1.0), radius=0.1)
    sections = arm_sections(robot, [near, aside])
    assert sections.obstacle_names == ("near", "aside")
    assert sections.link_start.tolist() == [0, 2, 3, 4]
    assert sections.obstacle_of.tolist() == [0, 1, 0, 0]
    assert sections.radii == pytest.approx([0.15, math.sqrt(0.15**2 - 0.145**2), 0.14, 0.13])


def test_bounds_hold_the_sections(robot):
    rng = np.random.default_rng(4)
    for _ in range(20):
        sections = arm_sections(robot, [random_solid(kind, rng) for kind in KINDS])
        for s, (x, y, radius) in enumerate(sections.bounds):
            vertices = sections.vertices[sections.vertex_start[s] : sections.vertex_start[s + 1]]
            assert np.linalg.norm(vertices - [x, y], axis=1).max() + sections.radii[s] <= radius + 1e-12


def test_rectangle_takes_a_ball_beside_its_flank_as_nearer(robot):
    """Half-width 0.05 across the plane: of a ball 0.15 aside only what reaches the flank counts."""
    ball = Sphere(name="ball", center=(1.0, 0.15, 1.0), radius=0.125)
    sections = arm_sections(robot, [ball], link_model="rectangle")
    assert sections.link_start.tolist() == [0, 1, 2, 3]
    assert sections.radii[0] == pytest.approx(0.075)
    assert arm_sections(robot, [ball.model_copy(update={"radius": 0.09})], link_model="rectangle").radii.size == 0


# What cannot be asked


def test_unknown_link_model(robot):
    with pytest.raises(OptionError, match="link_model = 'stick': expected one of capsule, paper, rectangle"):
        arm_sections(robot, [], link_model="stick")
    with pytest.raises(OptionError, match="link_model"):
        planar_sections([], np.array([0.1]), link_model="stick")


@pytest.mark.parametrize("clearance", [-0.1, math.nan, math.inf])
def test_bad_clearance(robot, clearance):
    with pytest.raises(OptionError, match="clearance"):
        arm_sections(robot, [], clearance=clearance)


def test_rectangle_takes_only_balls(robot):
    box = Box(name="crate", center=(1, 0, 1), size=(0.1, 0.1, 0.1))
    with pytest.raises(OptionError, match="'crate' is none"):
        arm_sections(robot, [box], link_model="rectangle")
    with pytest.raises(OptionError, match="'section 0' is none"):
        planar_sections([RoundedPolygon(np.eye(2), 0.1)], np.array([0.1]), link_model="rectangle")
