from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from hplan.base.data_files import scenes_dir
from hplan.collision.coal_scene import CoalScene, base_contacts
from hplan.robot.model import load_robot
from hplan.scene.file import dump_scene, load_scene
from hplan.scene.obstacles import Capsule, Sphere
from hplan.scene.orchard import (
    SHIPPED,
    TUCKED_DEG,
    FruitZone,
    OrchardOptions,
    generate,
)
from hplan.scene.orchard.fruits import Canopy

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
    """From the trunk's foot every piece is reached through pieces that begin where another one is."""
    _, scene = grown
    tree = [capsule for capsule in wood_of(scene) if capsule.name.startswith("tree 1 ")]
    canopy = Canopy(tree, 0.04, FruitZone())
    for index, capsule in enumerate(tree):
        nearest = np.delete(canopy.wood_distances(np.array(capsule.start)), index).min()
        assert nearest < 0.0 or capsule.start[2] == 0.0


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
    """Whether the tool can be at a point: a sweep of the hand's angle, the other two joints in closed form."""
    lengths = robot.arm.lengths
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
    start = scene.start.joints()
    assert scene.start.joints_deg == TUCKED_DEG
    # At any yaw the arm is behind its axis or beside it.
    obstacles = [o for o in (*scene.obstacles, *balls(scene)) if o.name not in ("vehicle", "ground")]
    assert CoalScene(robot, obstacles).distances(start).min() > 0.3
    if options.vehicle:
        vehicle = [o for o in scene.obstacles if o.name == "vehicle"]
        checker = CoalScene(robot, vehicle)
        assert min(checker.distances([yaw, *start[1:]]).min() for yaw in np.linspace(-math.pi, math.pi, 73)) > 0.1
    assert base_contacts(robot, [o for o in scene.obstacles if o.name in ("vehicle", "ground")]) == ()


# Scenes that ship


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scene_is_what_its_options_give(name):
    path = scenes_dir() / f"{name}.yaml"
    assert load_scene(path) == generate(SHIPPED[name])
    assert path.stat().st_size < 100_000


@pytest.mark.parametrize("name", SHIPPED)
def test_a_hand_can_be_at_the_goal(name):
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
