"""Grown orchards: their options, trees, fruit, and trees within clouds."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.base.data_files import scenes_dir
from hplan.collision.coal_scene import CoalScene, base_contacts
from hplan.errors import OptionError
from hplan.planar.family_reader import family_of
from hplan.robot.model import load_robot
from hplan.scene.file import dump_scene, load_scene
from hplan.scene.obstacles import Capsule, Sphere
from hplan.scene.orchard import SHIPPED, TUCKED_DEG, FruitZone, OrchardOptions, fruit_at_tips, generate
from hplan.scene.orchard.fruits import Canopy
from hplan.scene.orchard.wood import capsule

VARIANTS = {
    "default": OrchardOptions(),
    "trellis": OrchardOptions(form="trellis", wire_heights=(0.6, 1.1, 1.6), seed=5),
    "one tree": OrchardOptions(trees=1, fruits=6, posts=False, wire_heights=(), seed=2),
    "all": OrchardOptions(ground=True, vehicle=True, clearance=0.01, fruits=10, seed=3, branch_length=0.8),
}


@pytest.fixture(params=VARIANTS.values(), ids=VARIANTS.keys(), scope="module")
def grown(request):
    return request.param, generate(request.param)


def wood_of(scene) -> list[Capsule]:
    return [obstacle for obstacle in scene.obstacles if isinstance(obstacle, Capsule)]


def balls(scene) -> list[Sphere]:
    return [Sphere(name=f.name, center=f.center, radius=f.radius) for f in scene.fruits]


def kind_of(capsule: Capsule) -> str:
    return capsule.name.rsplit(" ", 1)[0].removeprefix("tree 1 ")


# Trees


def test_same_seed_same_scene(grown):
    options, scene = grown
    again = generate(dataclasses.replace(options))
    assert again == scene
    assert dump_scene(again) == dump_scene(scene)
    assert generate(dataclasses.replace(options, seed=options.seed + 1)) != scene


def test_all_wood_of_a_tree_hangs_together(grown):
    """Every piece is connected to the trunk's foot through other pieces."""
    _, scene = grown
    tree = [piece for piece in wood_of(scene) if piece.name.startswith("tree 1 ")]
    canopy = Canopy(tree, 0.04, FruitZone())
    for index, piece in enumerate(tree):
        nearest = np.delete(canopy.wood_distances(np.array(piece.start)), index).min()
        assert nearest < 0.0 or piece.start[2] == 0.0


def test_trunks_taper_upright_in_their_row(grown):
    options, scene = grown
    roots = []
    for tree in range(1, options.trees + 1):
        trunk = [c for c in wood_of(scene) if c.name.startswith(f"tree {tree} trunk ")]
        roots.append(trunk[0].start)
        radii = [piece.radius for piece in trunk]
        assert radii == sorted(radii, reverse=True)
        assert 0.2 * options.trunk_radius < radii[-1] < 0.5 * radii[0]
        assert trunk[-1].end[2] == pytest.approx(options.tree_height)
        assert all(math.dist(piece.end[:2], trunk[0].start[:2]) < 0.15 for piece in trunk)
        assert all(a.end == b.start for a, b in itertools.pairwise(trunk))
    assert {root[0] for root in roots} == {options.distance}
    ys = [root[1] for root in roots]
    assert sum(ys) == pytest.approx(0.0)
    assert all(b - a == pytest.approx(options.spacing) for a, b in itertools.pairwise(ys))


# Fruit


def test_fruit_hangs_clear_of_wood_and_of_each_other(grown):
    options, scene = grown
    canopy = Canopy(wood_of(scene), options.fruit_radius, FruitZone())
    for fruit in scene.fruits:
        gaps = canopy.wood_distances(np.array(fruit.center)) - fruit.radius
        assert gaps.min() >= -1e-9
        bearing = [g for g, c in zip(gaps, canopy.wood, strict=True) if kind_of(c).split()[-1] not in ("trunk", "wire")]
        assert min(bearing) <= options.stem + 2e-4
        assert options.fruit_zone.holds(*fruit.center)
    for a, b in itertools.combinations(scene.fruits, 2):
        assert math.dist(a.center, b.center) >= a.radius + b.radius


def test_picked_fruit_is_gone():
    every = generate(OrchardOptions())
    rest = generate(OrchardOptions(picked=(24, 1, 5)))
    kept = [fruit.center for n, fruit in enumerate(every.fruits, start=1) if n not in (1, 5, 24)]
    assert [fruit.center for fruit in rest.fruits] == kept
    assert [fruit.name for fruit in rest.fruits] == [f"fruit {n:02d}" for n in range(1, 22)]
    assert rest.obstacles == every.obstacles


# Arm


def within_reach(robot, point, *, clear_of=None) -> bool:
    """True if the tool can be at a point, by a sweep of the hand's angle.

    The other two joints are in closed form.
    """
    lengths = family_of(robot).arm.lengths
    yaw, z = math.atan2(point[1], point[0]), point[2] - 0.6
    for angle in np.radians(np.arange(0.0, 270.5, 1.0)):
        x, y = math.hypot(*point[:2]) - lengths[2] * math.cos(angle), z - lengths[2] * math.sin(angle)
        cosine = (x * x + y * y - lengths[0] ** 2 - lengths[1] ** 2) / (2.0 * lengths[0] * lengths[1])
        if abs(cosine) > 1.0:
            continue
        elbow = math.acos(cosine)
        inner = math.atan2(lengths[1] * math.sin(elbow), lengths[0] + lengths[1] * math.cos(elbow))
        shoulder = math.atan2(y, x) - inner
        q = np.array([yaw, shoulder, elbow, angle - shoulder - elbow])
        if (q < robot.lower).any() or (q > robot.upper).any():
            continue
        np.testing.assert_allclose(robot.tool_positions(q), point, atol=1e-9)
        if clear_of is None or clear_of.distances(q).min() > 0.005:
            return True
    return False


def test_start_is_tucked_away_from_trees_and_vehicle(grown, robot):
    options, scene = grown
    start = scene.start.listed_joints()
    assert scene.start.joints_deg == TUCKED_DEG
    # At any yaw the arm is behind its axis or to the side of it.
    obstacles = [o for o in (*scene.obstacles, *balls(scene)) if o.name not in ("vehicle", "ground")]
    assert CoalScene(robot, obstacles).distances(start).min() > 0.3
    if options.vehicle:
        vehicle = [o for o in scene.obstacles if o.name == "vehicle"]
        checker = CoalScene(robot, vehicle)
        assert min(checker.distances([yaw, *start[1:]]).min() for yaw in np.linspace(-math.pi, math.pi, 73)) > 0.1
    assert base_contacts(robot, [o for o in scene.obstacles if o.name in ("vehicle", "ground")]) == ()


# Scenes that ship


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scene_equals_generated_scene(name):
    path = scenes_dir() / f"{name}.yaml"
    assert load_scene(path) == generate(SHIPPED[name])
    assert path.stat().st_size < 100_000


@pytest.mark.parametrize("name", SHIPPED)
def test_hand_can_be_at_the_goal(name):
    scene = load_scene(scenes_dir() / f"{name}.yaml")
    robot = load_robot(scene.robot)
    (goal,) = [fruit for fruit in scene.fruits if fruit.name == scene.goal.fruit]
    assert within_reach(robot, goal.center, clear_of=CoalScene(robot, scene.solids))


def test_every_fruit_of_the_tour_can_be_picked(robot):
    scene = load_scene(scenes_dir() / "tour.yaml")
    assert len(scene.fruits) == 20
    for fruit in scene.fruits:
        others = [ball for ball in balls(scene) if ball.name != fruit.name]
        assert within_reach(robot, fruit.center, clear_of=CoalScene(robot, [*scene.obstacles, *others])), fruit


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wire_heights": (2.0, 1.0)}, "increasing heights"),
        ({"first_branch": 2.7}, "first_branch = 2.7: expected less than the tree's height, 2.7 m"),
        ({"form": "trellis", "wire_heights": ()}, "a wire below the tree's height"),
        ({"picked": (0,)}, r"picked\[0\] = 0: expected greater than or equal to 1"),
        ({"picked": (3, 3)}, "different numbers from 1 to 24"),
        ({"fruits": 2, "picked": (1, 2)}, "different numbers from 1 to 2, and not all"),
    ],
)
def test_options_that_make_no_orchard(changes, message):
    with pytest.raises(OptionError, match=message):
        OrchardOptions(**changes)


def test_zone():
    zone = FruitZone(1.0, 2.0, 1.5)
    assert zone.holds(0.9, -1.2, 1.0)
    assert zone.holds(0.0, 0.0, 2.0)
    assert not zone.holds(0.0, 0.0, 0.999)
    assert not zone.holds(0.0, 0.0, 2.001)
    assert not zone.holds(0.9, -1.21, 1.5)
    assert FruitZone().holds(-1000.0, 1000.0, -1000.0)


#: A trunk with four level branches, a rung of the ladder each.
TRUNK = capsule("trunk 1", (0.0, 0.0, 0.0), (0.0, 0.0, 2.0), 0.03)
BRANCHES = [
    capsule(f"branch {i}", (0.0, 0.0, 0.4 * i), (0.5 * (-1) ** i, 0.1 * i, 0.4 * i), 0.006) for i in range(1, 5)
]
TREE = [TRUNK, *BRANCHES]

#: Gap between a fruit and wood in contact: zero up to rounding to tenths of a millimetre.
TOUCHING = (-1e-9, 2e-4)


def gap(fruit, wood) -> float:
    """Distance of a fruit's surface from a capsule's, by brute force along the axis and a refinement."""
    start, end = wood.core
    low, high = 0.0, 1.0
    for _ in range(60):  # the distance to a point of a segment is convex
        a, b = low + (high - low) / 3, high - (high - low) / 3
        if math.dist(fruit.center, start + a * (end - start)) < math.dist(fruit.center, start + b * (end - start)):
            high = b
        else:
            low = a
    return math.dist(fruit.center, start + low * (end - start)) - wood.radius - fruit.radius


def apart(fruits) -> bool:
    pairs = itertools.combinations(fruits, 2)
    return all(math.dist(a.center, b.center) >= a.radius + b.radius for a, b in pairs)


def test_one_at_each_tip():
    fruits = fruit_at_tips(TREE, 4)
    assert [fruit.name for fruit in fruits] == ["fruit 01", "fruit 02", "fruit 03", "fruit 04"]
    for branch in BRANCHES:
        (fruit,) = [f for f in fruits if math.dist(f.center, branch.end) < 0.05]
        assert TOUCHING[0] <= gap(fruit, branch) <= TOUCHING[1]
        # Straight ahead of the branch.
        along = np.subtract(branch.end, branch.start)
        assert np.dot(np.subtract(fruit.center, branch.end), along) == pytest.approx(
            0.0461 * np.linalg.norm(along), abs=1e-4
        )
    assert apart(fruits)
    assert [math.hypot(*f.center[:2]) for f in fruits] == sorted(math.hypot(*f.center[:2]) for f in fruits)


def test_other_wood_is_avoided_where_that_can_be():
    wall = capsule("trunk 2", (0.56, -1.0, 0.8), (0.56, 1.0, 0.8), 0.02)
    branch = capsule("branch 1", (0.0, 0.0, 0.8), (0.5, 0.0, 0.8), 0.006)
    (fruit,) = fruit_at_tips([branch, wall], 1)
    assert TOUCHING[0] <= gap(fruit, branch) <= TOUCHING[1]
    assert gap(fruit, wall) >= 0.0
    # In a narrow pipe of wood there is no clear place: then as little deep as can be, and never in another fruit.
    walls = [
        capsule(f"trunk {i}", (-1.0, y, z), (1.0, y, z), 0.01)
        for i, (y, z) in enumerate([(0.03, 0.8), (-0.03, 0.8), (0.0, 0.83), (0.0, 0.77)])
    ]
    pair = fruit_at_tips([branch, *walls], 2)
    assert apart(pair)
    assert max(min(gap(f, wall) for wall in walls) for f in pair) < -0.001


def test_only_free_ends_of_branches_are_tips():
    pieces = [capsule("branch 1", (0, 0, 0), (0.3, 0, 0), 0.01), capsule("branch 2", (0.3, 0, 0), (0.32, 0, 0), 0.01)]
    wood = [
        *pieces,
        TRUNK,
        capsule("post 1", (5, 0, 0), (5, 0, 2), 0.04),
        capsule("wire 1", (5, 0, 1), (7, 0, 1), 0.001),
    ]
    (fruit,) = fruit_at_tips(wood, 1)
    assert fruit.center == pytest.approx((0.32 + 0.0501, 0.0, 0.0), abs=1e-4)
    with pytest.raises(OptionError, match="count = 2: expected at most 1, for which there was room") as caught:
        fruit_at_tips(wood, 2)
    assert caught.value.option == "count"


def test_fruit_zone_holds():
    zone = FruitZone(0.7, 1.3)
    assert all(zone.holds(*fruit.center) for fruit in fruit_at_tips(TREE, 4, zone=zone))
    with pytest.raises(OptionError, match="at most 0"):
        fruit_at_tips(TREE, 1, zone=FruitZone(5.0, 6.0))


points = st.tuples(*[st.floats(-1, 1)] * 3)


@settings(max_examples=40)
@given(
    st.lists(st.tuples(points, points, st.floats(0.002, 0.05)), min_size=1, max_size=8),
    st.integers(1, 12),
    st.integers(0, 5),
)
def test_random_wood(pieces, count, seed):
    wood = [capsule(f"branch {i}", *piece) for i, piece in enumerate(pieces)]
    try:
        fruits = fruit_at_tips(wood, count, seed=seed)
    except OptionError:
        return
    assert len(fruits) == count
    assert apart(fruits)
    assert all(min(gap(fruit, piece) for piece in wood) <= TOUCHING[1] for fruit in fruits)


@settings(max_examples=60)
@given(st.lists(st.tuples(points, points, st.floats(0.001, 0.05)), min_size=1, max_size=6), points)
def test_distances_from_wood(pieces, point):
    wood = [capsule(f"w {i}", *piece) for i, piece in enumerate(pieces)]

    class Ball:
        center, radius = point, 0.04

    expected = [gap(Ball, piece) + Ball.radius for piece in wood]
    np.testing.assert_allclose(Canopy(wood, 0.04, FruitZone()).wood_distances(np.array(point)), expected, atol=1e-6)
