from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import pinocchio as pin
import pytest
from arm_variants import VARIANTS, load_variant, random_obstacles
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_sections import RoundedPolygon, planar_sections
from studies.planar_cspace import arm_sections, joint_grid
from test_occupancy import point_segment, segment_polygon

from hplan.collision.coal_scene import CoalScene
from hplan.errors import InputError, OptionError
from hplan.planar.family_reader import family_of
from hplan.planar.grid.cutting_arrays import ArmPlane, LinkExtents
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.grid.prepared_obstacles import prepare_obstacles
from hplan.planar.grid.section_kernels import cut_balls, cut_hulls
from hplan.planar.grid.sections import LINK_MODELS, SECTION_ERROR, sections_at
from hplan.scene.obstacles import Box, Capsule, Cylinder, Sphere

#: The plane of x and z at yaw 0, as a robot on a yaw has it: horizontal axis, upward axis, normal.
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Solid:
    """Data of an obstacle for its section."""

    core: np.ndarray
    rounding: float
    is_point_set: bool = False
    name: str = "solid"


def cut(obstacle, *, axes=UPRIGHT):
    """Sections of one obstacle with a plane, for a link of no width."""
    prepared, none = prepare_obstacles([obstacle]), np.zeros(1)
    plane = ArmPlane(np.zeros(3), axes)
    links = LinkExtents(none, none, np.array([math.inf]), none)
    sections = cut_balls(prepared.balls, plane, links)
    if len(prepared.hulls.owners):
        sections = cut_hulls(prepared.hulls, plane, links, SECTION_ERROR, sections)
    link_start, vertex_start, vertices, discs, _ = sections
    return [RoundedPolygon(vertices[slice(*vertex_start[s : s + 2])], discs[s, 3]) for s in range(link_start[1])]


def plane_section(core, radius):
    """Section with the plane where the third coordinate is 0, or None."""
    sections = cut(Solid(np.asarray(core, dtype=float), radius), axes=np.eye(3))
    return sections[0] if sections else None


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
    """Ends off, across or nearly in the plane."""
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
    directions = unit(np.linspace(0.0, 2.0 * math.pi, 721))
    if len(section.vertices) >= 3:
        # Of two convex sets, one in the other, the largest distance is the largest difference of supports. It shows
        # at the corners.
        along = np.roll(section.vertices, -1, axis=0) - section.vertices
        normals = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
        middle = normals + np.roll(normals, 1, axis=0)
        directions = np.vstack([directions, middle / np.linalg.norm(middle, axis=1)[:, None]])
        assert np.all(
            normals[:, 0] * np.roll(normals, -1, axis=0)[:, 1] > normals[:, 1] * np.roll(normals, -1, 0)[:, 0]
        )
    stands_out = support_of(section, directions) - supports(core, radius, directions)
    assert stands_out.max() <= SECTION_ERROR
    assert stands_out.min() >= -1e-13
    return len(section.vertices)


def unit(angles):
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def support_of(section, directions):
    return np.max(section.vertices @ directions.T, axis=0) + section.radius


def supports(core, radius, directions):
    """Support of the section by projection along the plane, where the code goes by convex duality.

    In this view the core's points are at `reach` (along the direction) and `heights`; the section ends where the last
    of the arcs about them, or of the sides that join two arcs, crosses height 0.
    """
    reach, heights = core[:, :2] @ directions.T, core[:, 2]
    near = np.abs(heights) <= radius
    ends = [reach[near] + np.sqrt(radius**2 - heights[near] ** 2)[:, None]]
    for i, j in zip(*np.triu_indices(len(core), k=1), strict=True):
        rise, run = heights[j] - heights[i], reach[j] - reach[i]
        if abs(rise) > 1e-12:
            outward = radius / np.hypot(rise, run)
            place = -(heights[i] - np.copysign(outward, rise) * run) / rise
            side = reach[i] + place * run + outward * abs(rise)
            ends.append(np.where((place >= 0.0) & (place <= 1.0), side, -np.inf)[None])
    return np.max(np.concatenate(ends), axis=0)


def test_boxes():
    rng = np.random.default_rng(2)
    sides = []
    for _ in range(200):
        centre, rotation, size, radius = random_box(rng)
        core = centre + (BOX_CORNERS * size) @ rotation.T
        sides.append(check(core, radius, lambda p, b=(centre, rotation, size): box_distance(p, *b), rng))
    assert np.mean(np.array(sides) > 0) > 0.5


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_any_capsule(seed):
    rng = np.random.default_rng(seed)
    core, radius = random_capsule(rng)
    check(core, radius, lambda p: point_segment(p, core[0], core[1]), rng)


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


# Sections for an arm


KINDS = ("sphere", "capsule", "cylinder", "box")


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
    if kind == "cylinder":
        length, radius, rpy = rng.uniform(0.02, 0.6), rng.uniform(0.01, 0.3), tuple(rng.uniform(-180.0, 180.0, 3))
        return Cylinder(name="can", center=center, length=length, radius=radius, rpy_deg=rpy)
    size, rpy = tuple(rng.uniform(0.02, 0.6, 3)), tuple(rng.uniform(-180.0, 180.0, 3))
    return Box(name="crate", center=center, size=size, rpy_deg=rpy)


def test_rectangle_counts_ball_at_its_flank_as_nearer(robot):
    """Half-width 0.05 across the plane: a ball 0.15 aside counts only as far as it reaches the flank."""
    ball = Sphere(name="ball", center=(1.0, 0.15, 1.0), radius=0.125)
    sections = arm_sections(robot, [ball], link_model="rectangle")
    assert sections.link_start.tolist() == [0, 1, 2, 3]
    assert sections.radii[0] == pytest.approx(0.075)
    assert arm_sections(robot, [ball.model_copy(update={"radius": 0.09})], link_model="rectangle").radii.size == 0


# Many obstacles, many yaws


@pytest.mark.parametrize("name", [name for name in VARIANTS if VARIANTS[name][0]])
def test_coal_finds_no_collision_outside_the_sections(name, tmp_path):
    robot = load_variant(name, tmp_path)
    rng = np.random.default_rng(13)
    collisions = clear = 0
    for _ in range(12):
        yaw, obstacles = rng.uniform(-2.5, 2.5), random_obstacles(rng)
        sections = sections_at(robot, prepare_obstacles(obstacles, clearance=0.01), yaw)
        q = rng.uniform(robot.lower, robot.upper, (300, robot.dof))
        q[:, 0] = yaw
        theirs = CoalScene(robot, obstacles).in_collision(q, margin=0.01 - 1e-9)
        ours = met(robot, sections, q)
        assert not (theirs & ~ours).any()
        collisions += theirs.sum()
        clear += (~ours).sum()
    assert collisions > 50
    assert clear > 100


def met(robot, sections, q):
    """Whether each configuration's link axes meet a section, straight from the polygons."""
    points = family_of(robot).arm.joint_points(q[:, family_of(robot).arm_slice])
    found = np.zeros(len(q), dtype=bool)
    for k in range(family_of(robot).arm.link_count):
        for s in range(sections.link_start[k], sections.link_start[k + 1]):
            vertices = sections.vertices[sections.vertex_start[s] : sections.vertex_start[s + 1]]
            found |= segment_polygon(points[:, k], points[:, k + 1], vertices) <= sections.radii[s]
    return found


def test_out_of_reach_changes_nothing_but_the_number_of_sections(robot):
    rng = np.random.default_rng(19)
    grid = joint_grid(family_of(robot).arm, math.radians(5.0))
    obstacles = [random_solid(kind, rng, yaw) for kind in KINDS for yaw in rng.uniform(-0.1, 0.1, 20)]
    obstacles += [Sphere(name="far", center=(9.0, 0.0, 1.0), radius=0.1)]
    for link_model in ("capsule", "paper", "rectangle"):
        chosen = [o for o in obstacles if isinstance(o, Sphere)] if link_model == "rectangle" else obstacles
        every = arm_sections(robot, chosen, link_model=link_model)
        near = sections_at(robot, prepare_obstacles(chosen), link_model=link_model)
        assert len(near.radii) < len(every.radii)
        assert len(chosen) - 1 in every.obstacle_of
        assert len(chosen) - 1 not in near.obstacle_of
        np.testing.assert_array_equal(
            occupancy(family_of(robot).arm, near, grid).free_words,
            occupancy(family_of(robot).arm, every, grid).free_words,
        )


def same(first, second, *but):
    for field in fields(first):
        if field.name not in but:
            np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name), field.name)


@pytest.mark.parametrize("link_model", LINK_MODELS)
def test_loose_points_are_balls(robot, link_model):
    rng = np.random.default_rng(23)
    points = rng.uniform([-2.0, -0.2, 0.0], [2.0, 0.2, 2.0], (500, 3))
    post = Solid(np.array([[1.0, 0.0, 1.0]]), 0.2)
    solids = [Solid(points, 0.02, is_point_set=True, name="cloud"), post]
    prepared = prepare_obstacles(solids, clearance=[0.01, 0.0])
    cloud = sections_at(robot, prepared, 0.1, link_model=link_model)
    balls = [Solid(point[None], 0.03) for point in points]
    one_by_one = sections_at(robot, prepare_obstacles([*balls, post]), 0.1, link_model=link_model)
    same(cloud, one_by_one, "obstacle_of", "obstacle_names")
    assert len(cloud.radii) > 30
    assert cloud.obstacle_of.tolist() == (one_by_one.obstacle_of == len(points)).astype(int).tolist()
    assert cloud.obstacle_names == ("cloud", "solid")


def test_each_obstacle_keeps_its_own_clearance(robot):
    rng = np.random.default_rng(29)
    obstacles = [random_solid(kind, rng) for kind in KINDS]
    margins = np.array([0.0, 0.03, 0.01, 0.02])
    together = arm_sections(robot, obstacles, clearance=margins)
    for index, margin in enumerate(margins):
        alone = arm_sections(robot, obstacles[index : index + 1], clearance=margin)
        mine = together.obstacle_of == index
        np.testing.assert_array_equal(together.radii[mine], alone.radii)
        np.testing.assert_array_equal(together.bounds[mine], alone.bounds)


# Invalid arguments


def test_rectangle_takes_only_balls(robot):
    box = Box(name="crate", center=(1, 0, 1), size=(0.1, 0.1, 0.1))
    with pytest.raises(OptionError, match="'crate' is not a sphere"):
        arm_sections(robot, [box], link_model="rectangle")
    with pytest.raises(OptionError, match="'section 0' is not a sphere"):
        planar_sections([RoundedPolygon(np.eye(2), 0.1)], np.array([0.1]), link_model="rectangle")


@pytest.mark.parametrize("solid", [
    Solid(np.zeros((0, 3)), 0.1), Solid(np.zeros((0, 3)), 0.1, is_point_set=True),
    Solid(np.full((2, 3), math.nan), 0.1),
    Solid(np.array([[0.0, math.inf, 0.0]]), 0.1), Solid(np.zeros((1, 3)), math.nan),
])  # fmt: skip
def test_obstacle_without_points_is_refused(robot, solid):
    ball = Solid(np.ones((1, 3)), 0.1, name="ball")
    with pytest.raises(InputError, match="obstacle 'solid': expected finite core points") as caught:
        arm_sections(robot, [ball, solid])
    assert caught.value.data["name"] == "solid"
