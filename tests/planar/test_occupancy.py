from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_sections import RoundedPolygon, planar_sections
from studies.planar_cspace import arm_sections, joint_grid

from hplan.base.arrays import readonly
from hplan.errors import InputError
from hplan.planar.family_reader import family_of
from hplan.planar.grid.grid import Grid
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.grid.sections import LINK_MODELS
from hplan.planar.planar_family import PlanarArm

#: Cells this close to the boundary may be either [m].
BAND = 1e-9


# Plain NumPy geometry, independent of the kernels


def point_segment(points, a, b):
    """Distances of points (..., 2) from segments a-b, whose ends may be (..., 2) too."""
    axis = b - a
    square = np.sum(axis * axis, axis=-1)
    t = np.clip(np.sum((points - a) * axis, axis=-1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return np.linalg.norm(points - a - t[..., None] * axis, axis=-1)


def cross(u, v):
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def segments_cross(a, b, c, d):
    """Whether segments a-b (..., 2) properly cross the segment c-d."""
    one = cross(b - a, c - a) * cross(b - a, d - a) < 0.0
    other = cross(d - c, a - c) * cross(d - c, b - c) < 0.0
    return one & other


def segment_polygon(a, b, vertices):
    """Distances of segments a-b (..., 2) from a convex polygon (or a segment, or a point); 0 where they meet."""
    distance = np.full(a.shape[:-1], np.inf)
    inside = np.full(a.shape[:-1], len(vertices) >= 3)
    for c, d in zip(vertices, np.roll(vertices, -1, axis=0), strict=True):
        for candidate in (
            point_segment(a, c, d),
            point_segment(b, c, d),
            point_segment(c, a, b),
            np.where(segments_cross(a, b, c, d), 0.0, np.inf),
        ):
            distance = np.minimum(distance, candidate)
        inside &= cross(d - c, a - c) >= 0.0
    return np.where(inside, 0.0, distance)


def links(arm, grid):
    """For each link: start, end (..., 2) and absolute angle over the axes of the grid up to its own joint."""
    start, heading = np.zeros(2), np.zeros(())
    for k in range(arm.link_count):
        q = grid.axis(k)
        heading = np.asarray(heading)[..., None] + arm.signs[k] * q + arm.offsets[k]
        start = np.broadcast_to(np.asarray(start)[..., None, :], (*heading.shape, 2))
        end = start + arm.lengths[k] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        yield start, end, heading
        start = end


def spread(mask, shape):
    """A mask over the first axes of the grid, repeated over the rest."""
    return np.broadcast_to(mask.reshape(mask.shape + (1,) * (len(shape) - mask.ndim)), shape)


def capsule_margins(arm, grid, polygons):
    """Smallest of (distance of link from obstacle) - (radii) at each node, over all links and obstacles [m]."""
    margins = np.full(grid.shape, np.inf)
    for k, (start, end, _) in enumerate(links(arm, grid)):
        for polygon in polygons:
            margin = segment_polygon(start, end, polygon.vertices) - polygon.radius - arm.half_widths[k]
            margins = np.minimum(margins, spread(margin, grid.shape))
    return margins


def rectangle_margins(arm, grid, discs):
    margins = np.full(grid.shape, np.inf)
    for k, (start, _, heading) in enumerate(links(arm, grid)):
        for disc in discs:
            to_disc = disc.vertices[0] - start
            x = np.cos(heading) * to_disc[..., 0] + np.sin(heading) * to_disc[..., 1]
            y = np.cos(heading) * to_disc[..., 1] - np.sin(heading) * to_disc[..., 0]
            beyond_x = np.maximum(np.maximum(-x, x - arm.lengths[k]), 0.0)
            beyond_y = np.maximum(np.abs(y) - arm.half_widths[k], 0.0)
            margins = np.minimum(margins, spread(np.hypot(beyond_x, beyond_y) - disc.radius, grid.shape))
    return margins


def paper_margins(arm, grid, discs):
    """The paper's three cases to the letter: negative where a link's angle is forbidden [rad]."""
    margins = np.full(grid.shape, np.inf)
    for k, (start, _, heading) in enumerate(links(arm, grid)):
        length, width = arm.lengths[k], arm.half_widths[k]
        for disc in discs:
            r = disc.radius
            d = disc.vertices[0] - start
            rho = np.hypot(d[..., 0], d[..., 1])
            turn = heading - np.arctan2(d[..., 1], d[..., 0])
            turn = np.abs(np.arctan2(np.sin(turn), np.cos(turn)))
            with np.errstate(all="ignore"):
                case_1 = np.arcsin((r + width) / rho)
                case_2 = np.arccos((length**2 + rho**2 - (r + width) ** 2) / (2.0 * length * rho))
            half = np.where(rho**2 <= length**2 + (r + width) ** 2, case_1, case_2)
            margin = np.where(rho <= r + width, -np.inf, turn - half)
            margin = np.where(rho > math.sqrt(length**2 + width**2) + r, np.inf, margin)
            margins = np.minimum(margins, spread(margin, grid.shape))
    return margins


def assert_same(occupied, margins, context=""):
    """Occupied where the margin is below -BAND, free where above BAND."""
    collides_unseen = (margins < -BAND) & ~occupied
    free_refused = (margins > BAND) & occupied
    assert not collides_unseen.any(), f"{collides_unseen.sum()} colliding nodes free, worst {margins[~occupied].min()}"
    assert not free_refused.any(), (
        f"{free_refused.sum()} free nodes occupied, worst {margins[occupied].max()} {context}"
    )


# The reference scene


@pytest.fixture(scope="module")
def table_1(robot):
    return joint_grid(family_of(robot).arm, math.radians(1.0)), [RoundedPolygon(readonly([[1.0, 1.3]]), 0.15)]


MARGINS = {"capsule": capsule_margins, "paper": paper_margins, "rectangle": rectangle_margins}


@pytest.mark.parametrize("model", LINK_MODELS)
def test_reference_scene_cell_for_cell(robot, table_1, model):
    grid, discs = table_1
    result = occupancy(
        family_of(robot).arm, planar_sections(discs, family_of(robot).arm.half_widths, link_model=model), grid
    )
    assert grid.shape == (91, 91, 91)
    table_1_counts = {"capsule": 128_891, "paper": 127_973, "rectangle": 127_342}
    assert result.occupied_count == result.occupied_mask.sum() == table_1_counts[model]
    np.testing.assert_array_equal(result.occupied_mask, MARGINS[model](family_of(robot).arm, grid, discs) <= 0.0)


# Random arms and obstacles


def random_arm(rng, count, lengths=(0.2, 1.2), widths=(0.01, 0.15)):
    lower = rng.uniform(-7.0, 5.0, count)
    return PlanarArm(
        joint_names=tuple(f"joint_{i}" for i in range(count)),
        link_names=tuple(f"link_{i}" for i in range(count)),
        lengths=rng.uniform(*lengths, count),
        half_widths=rng.uniform(*widths, count),
        lateral=np.zeros(count),
        signs=rng.choice([-1.0, 1.0], count),
        offsets=rng.uniform(-4.0, 4.0, count),
        lower=lower,
        upper=lower + rng.uniform(0.1, 9.0, count),
    )


def random_grid(rng, arm):
    nodes = {1: 400, 2: 40, 3: 12, 4: 7}[arm.link_count]
    counts = rng.integers(max(2, nodes // 2), nodes + 1, arm.link_count)
    return Grid.from_limits(arm.lower, arm.upper, (arm.upper - arm.lower) / counts)


def random_place(rng, reach):
    """Anywhere in reach or a little beyond, often at the first joint."""
    distance = rng.choice([rng.uniform(0.0, 0.2), rng.uniform(0.0, 1.3 * reach)])
    angle = rng.uniform(-math.pi, math.pi)
    return distance * np.array([math.cos(angle), math.sin(angle)])


def random_disc(rng, reach):
    return RoundedPolygon(random_place(rng, reach)[None], rng.choice([rng.uniform(0.001, 0.05), rng.uniform(0.0, 0.5)]))


def random_polygon(rng, reach):
    """2 to 8 vertices on an ellipse (counter-clockwise), thin or stout, small or large."""
    count = rng.integers(2, 9)
    size = rng.choice([0.02, 0.3, 1.5]) * rng.uniform(0.2, 1.0)
    angles = np.sort(rng.uniform(-math.pi, math.pi, count))
    points = size * np.stack([np.cos(angles), rng.choice([1.0, 0.3, 0.001]) * np.sin(angles)], axis=1)
    turn = rng.uniform(-math.pi, math.pi)
    points = points @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    return RoundedPolygon(points + random_place(rng, reach), rng.choice([0.0, rng.uniform(0.0, 0.1)]))


def check_random_scene(seed, model, polygons):
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, int(rng.integers(1, 5)))
    grid = random_grid(rng, arm)
    make = random_polygon if polygons else random_disc
    obstacles = [make(rng, arm.lengths.sum()) for _ in range(rng.integers(1, 4))]
    occupied = occupancy(arm, planar_sections(obstacles, arm.half_widths, link_model=model), grid).occupied_mask
    assert_same(occupied, MARGINS[model](arm, grid, obstacles))
    return occupied.mean()


@settings(max_examples=100)
@given(st.integers(0, 2**32 - 1), st.sampled_from(LINK_MODELS), st.booleans())
def test_any_scene(seed, model, polygons):
    check_random_scene(seed, model, polygons and model == "capsule")


@pytest.mark.parametrize("model", LINK_MODELS)
@pytest.mark.parametrize(("length", "width"), [(0.1, 0.4), (0.3, 0.3), (1.0, 0.5), (1.0, 0.001)])
def test_stout_and_thin_links(model, length, width):
    """Links wider than long, and wider than the obstacle."""
    rng = np.random.default_rng(5)
    arm = random_arm(rng, 1, lengths=(length, length), widths=(width, width))
    grid = Grid.from_limits([-7.0], [7.0], 0.02)
    for _ in range(100):
        disc = RoundedPolygon(random_place(rng, length + width)[None], rng.uniform(0.001, 0.3))
        occupied = occupancy(arm, planar_sections([disc], arm.half_widths, link_model=model), grid).occupied_mask
        assert_same(occupied, MARGINS[model](arm, grid, [disc]))


# One link among rounded polygons made to be awkward


def one_link(length=1.0, half_width=0.02, sign=1.0, offset=0.0):
    return PlanarArm(
        ("joint",), ("link",), *(np.array([value]) for value in (length, half_width, 0.0, sign, offset, -8.0, 8.0))
    )


SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])

AWKWARD = {
    "behind the joint, across the cut of atan2": 0.1 * SQUARE + [-0.5, 0.0],
    "just above the cut": 0.1 * SQUARE + [-0.5, 0.1],
    "round the joint": 0.1 * SQUARE,
    "a wall in front": np.array([[0.9, -50.0], [0.9, 50.0]]),
    "a half-plane next to the joint": 50.0 * SQUARE + [50.03, 0.0],
    "reach ends in a straight side": 0.5 * SQUARE + [1.4, 0.0],
    "reach ends in two straight sides": np.array([[0.5, 0.0], [3.0, -0.3], [3.0, 0.3]]),
    "a needle that points at the joint": np.array([[0.3, 0.0], [3.0, -1e-6], [3.0, 1e-6]]),
    "a needle next to the joint": np.array([[-1.0, 0.03], [1.0, 0.03]]),
    "two points as one": np.array([[0.5, 0.2], [0.5, 0.2]]),
    "points an ulp apart": np.array([[0.5, 0.2], [0.5, np.nextafter(0.2, 1.0)], [np.nextafter(0.5, 0.0), 0.2]]),
    "clockwise": 0.1 * SQUARE[::-1] + [0.5, 0.0],
}


@pytest.mark.parametrize("radius", [0.0, 0.003, 0.2])
@pytest.mark.parametrize("name", AWKWARD)
def test_awkward_polygons(name, radius):
    vertices = AWKWARD[name]
    counter_clockwise = vertices[::-1] if "clockwise" in name else vertices
    for half_width in (1e-4, 0.02):
        for turn in np.linspace(-math.pi, math.pi, 13):
            rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
            arm = one_link(half_width=half_width, sign=-1.0, offset=0.4)
            grid = joint_grid(arm, 0.01)
            sections = planar_sections([RoundedPolygon(vertices @ rotation, radius)], arm.half_widths)
            margins = capsule_margins(arm, grid, [RoundedPolygon(counter_clockwise @ rotation, radius)])
            assert_same(occupancy(arm, sections, grid).occupied_mask, margins, f"at turn {turn}")


def test_vertices_that_coincide_seen_from_the_second_joint():
    """They differ by an ulp of 0.01; from a joint at 1 m they are one point and their edge has no length."""
    near, far = np.nextafter(0.01, 0.0), np.nextafter(0.01, 1.0)
    sliver = RoundedPolygon(np.array([[near, 0.3], [far, 0.3], [0.01, 0.2]]), 0.01)
    rng = np.random.default_rng(0)
    arm = replace(random_arm(rng, 2, widths=(0.01, 0.02)), lengths=np.array([1.0, 1.0]))
    grid = Grid.from_limits(arm.lower, arm.upper, (arm.upper - arm.lower) / 40)
    occupied = occupancy(arm, planar_sections([sliver], arm.half_widths), grid).occupied_mask
    assert 0.0 < occupied.mean() < 0.5
    assert_same(occupied, capsule_margins(arm, grid, [sliver]))


@pytest.mark.parametrize("turn", np.linspace(-math.pi, math.pi, 25))
def test_joint_on_the_side_of_a_polygon_collides_always(turn):
    """Bearings of points at the joint are rounding errors there."""
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    wall = (0.3 * SQUARE + [0.3, 0.07]) @ rotation
    arm = one_link(half_width=0.0)
    result = occupancy(arm, planar_sections([RoundedPolygon(wall, 0.0)], arm.half_widths), joint_grid(arm, 0.01))
    assert result.occupied_mask.all()


# Grids


@pytest.mark.parametrize(("first", "last"), list(combinations_with_replacement([0, 1, 62, 63, 64, 65, 127, 128], 2)))
def test_forbidden_interval_between_any_two_nodes(first, last):
    """A link of length 1 touches a thin disc at its tip within a known angle."""
    step = 0.01
    middle, half = 0.5 * step * (first + last), 0.5 * step * (last - first) + 0.1 * step
    arm = one_link(half_width=1e-6)
    disc = RoundedPolygon(2.0 * np.array([[math.cos(middle), math.sin(middle)]]), 0.0)
    reach = math.sqrt(1.0 + 4.0 - 4.0 * math.cos(half))  # equation (2) for the disc's radius
    grid = Grid(readonly([0.0]), readonly([step]), (129,))
    sections = planar_sections([RoundedPolygon(disc.vertices, reach - 1e-6)], arm.half_widths)
    assert np.flatnonzero(occupancy(arm, sections, grid).occupied_mask).tolist() == list(range(first, last + 1))


# Invalid arguments


def test_grid_of_another_arm_is_refused(robot, scene):
    with pytest.raises(InputError, match="the arm has 3 links, the grid has 2 axes, and the sections are for 3 links"):
        occupancy(family_of(robot).arm, arm_sections(robot, scene.solids), Grid.from_limits([0, 0], [1, 1], 0.1))
