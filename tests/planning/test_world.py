"""Clearances of the arm: growth, touchable fruit, base; scenes posed to robots."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_variants import from_obstacles, random_obstacles
from planned import post, problem_between

from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import CoalScene, base_contacts
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.distance_checker import FAR
from hplan.errors import ConfigurationInCollisionError, InputError
from hplan.planar.family_reader import family_of, with_planar_arm
from hplan.planar.grid.sections import sections_at
from hplan.planar.grids import prepare_world
from hplan.planning.options import PlanOptions
from hplan.planning.problem import Problem
from hplan.planning.world import BASE_DEPTH, World, without_inside
from hplan.robot.family.members import write_robot
from hplan.robot.family.spec import ArmSpec
from hplan.robot.model import Robot, load_robot
from hplan.scene import load_scene, with_limbs
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, PointCloud, Sphere

BALLS = (
    Sphere(name="sure", center=(1.0, 0.3, 1.0), radius=0.1),
    Sphere(name="vague", center=(0.6, -0.4, 1.2), radius=0.1, sigma=0.01),
    Sphere(name="vaguer", center=(1.6, 0.2, 0.9), radius=0.1, sigma=0.02),
)

#: The links of the harvester among its bodies: pedestal and turret come first, pairs last.
LINKS = slice(2, 5)


def test_each_obstacle_grows_by_its_own_uncertainty(robot: Robot) -> None:
    rng = np.random.default_rng(0)
    for sigmas in (0.0, 1.0, 3.0):
        world = World.build(robot, BALLS, clearance=0.02, sigmas=sigmas)
        np.testing.assert_allclose(world.linked.growth - world.clearance, sigmas * np.array([0.0, 0.01, 0.02]))
        assert world.clearance == 0.02
        plain = CoalScene(robot, BALLS)
        for q in rng.uniform(robot.lower, robot.upper, (20, 4)):
            grown = from_obstacles(plain, q) - sigmas * np.array([0.0, 0.01, 0.02])
            np.testing.assert_allclose(from_obstacles(world.checker, q), grown, atol=1e-9)
            found = world.field.link_clearances(q, 100.0)[LINKS]
            np.testing.assert_allclose(found, grown.min(axis=1) - 0.02, atol=1e-6)


def test_arm_keeps_the_clearance_from_itself_too(tmp_path: Path) -> None:
    """With and without obstacles, for any uncertainty."""
    spec = ArmSpec(
        name="bendy",
        has_yaw=False,
        link_lengths=(1.0, 0.8, 0.4),
        link_half_widths=(0.05, 0.04, 0.03),
        link_masses=(4.0, 3.0, 1.0),
        lower=(-2.6,) * 3,
        upper=(2.6,) * 3,
        velocity=(1.5,) * 3,
        effort=(300.0,) * 3,
        acceleration=(3.0,) * 3,
        jerk=(150.0,) * 3,
    )
    bendy = load_robot(write_robot(spec, tmp_path / "bendy.urdf")[0])
    rng = np.random.default_rng(3)
    far = Sphere(name="far", center=(0.0, 0.0, 9.0), radius=0.1, sigma=0.05)
    plain, seen = ClearanceField.build(bendy, []), 0
    for solids in ([], [far]):
        world = World.build(bendy, solids, clearance=0.03, tracking_error=0.001, sigmas=3.0)
        # From the pedestal a link keeps its own displacement bound; two links keep the bound of the outer relative to
        # the inner.
        keep = world.clearance + 0.001 * float(family_of(bendy).arm.lengths[1:] @ [1, 2])
        most = world.clearance + float(family_of(bendy).sway(0.001).max())
        # The first link is checked against the pedestal, too, which does not carry its joint: its displacement bound is
        # minimal.
        least = world.clearance + float(family_of(bendy).sway(0.001)[0])
        for q in rng.uniform(bendy.lower, bendy.upper, (60, bendy.dof)):
            before, after = plain.spare_clearance(q), world.field.spare_clearance(q)
            if before < 0.5:
                seen += 1
                assert after < before
                low, high = (
                    ClearanceField.build(bendy, [], own_clearance=own).spare_clearance(q) for own in (most, least)
                )
                assert low - 1e-12 <= after <= high + 1e-12
        assert prepare_world(world, 0.002).own_clearance == 0.032
        sections = sections_at(bendy, prepare_world(world, 0.002), 0.0)
        np.testing.assert_allclose(sections.own_radii, 0.05 + 0.03 + keep + 0.002)
    assert seen > 20


def test_each_link_sways_by_its_own(robot: Robot) -> None:
    """Sections equal a thicker arm's; the field and coal have distances less the displacement bound."""
    error, rng = 0.01, np.random.default_rng(4)
    arm = replace(family_of(robot).arm, half_widths=family_of(robot).arm.half_widths + family_of(robot).sway(error))
    thicker = with_planar_arm(robot, arm)
    world, plain = World.build(robot, BALLS, tracking_error=error), World.build(robot, BALLS)
    same = World.build(thicker, BALLS)
    for yaw in (0.0, 0.1):
        ours, theirs = (sections_at(one.robot, prepare_world(one), yaw) for one in (world, same))
        np.testing.assert_allclose(ours.radii, theirs.radii, rtol=1e-12)
        np.testing.assert_array_equal(ours.link_start, theirs.link_start)
    for q in rng.uniform(robot.lower, robot.upper, (20, 4)):
        left, whole = (one.field.link_clearances(q, 100.0)[LINKS] for one in (world, plain))
        # A yawing body's bound is up to 0.2 % above the link's own.
        np.testing.assert_allclose(
            left, whole - family_of(robot).sway(error), atol=2e-3 * family_of(robot).sway(error).max()
        )
        own = world.checker.pair_distances(q) - world.checker.pair_sways(np.full((1, 4), error))[:, 0]
        least = min(left.min(), own[-len(world.checker.parts.own) :].min())
        if least > 0.0:
            assert world.check_clear(q, "here") == pytest.approx(min(least, FAR), abs=1e-6)
        else:
            with pytest.raises(ConfigurationInCollisionError):
                world.check_clear(q, "here")


def test_bodies_of_the_sections_are_grown_by_clearance_and_uncertainty(robot: Robot) -> None:
    world = World.build(robot, BALLS, clearance=0.01, tracking_error=0.002, sigmas=2.0)
    bodies = prepare_world(world, 0.003)
    assert bodies.deviation == 0.002
    radii = np.array([0.1, 0.12, 0.14]) + world.clearance + 0.003
    np.testing.assert_allclose(bodies.balls.radii, radii)
    assert bodies.names == ("sure", "vague", "vaguer")


def test_refusal_of_a_configuration_names_the_largest_error(robot: Robot) -> None:
    """With a slightly smaller error the configuration is accepted, with a larger one refused."""
    rng, kinds = np.random.default_rng(6), {"free": 0, "margin": 0, "contact": 0}

    def check(q: FloatArray, error: float) -> None:
        World.build(robot, BALLS, clearance=0.01, tracking_error=error).check_clear(q, "start")

    for q in rng.uniform(robot.lower, robot.upper, (40, 4)):
        distances = World.build(robot, BALLS).checker.distances(q) - 0.01
        if (distances > family_of(robot).sway(0.1)[:, None]).all():
            kinds["free"] += 1
            check(q, 0.1)
            continue
        with pytest.raises(ConfigurationInCollisionError) as refused:
            check(q, 0.1)
        facts = refused.value.data
        if distances.min() <= 0.0:
            kinds["contact"] += 1
            assert "largest_tracking_error_deg" not in facts
            continue
        kinds["margin"] += 1
        assert facts["tracking_error_deg"] == pytest.approx(math.degrees(0.1))
        assert "would succeed with up to" in str(refused.value)
        largest = math.radians(facts["largest_tracking_error_deg"])
        check(q, 0.999 * largest)
        with pytest.raises(ConfigurationInCollisionError):
            check(q, 1.001 * largest)
    assert min(kinds.values()) >= 1


def test_last_link_alone_may_touch(robot: Robot) -> None:
    solids = [*BALLS, Sphere(name="fruit", center=(1.2, 0.0, 0.6), radius=0.04, sigma=0.01)]
    world = World.build(robot, solids, clearance=0.01, sigmas=3.0)
    near, without = world.allow_touch("fruit"), World.build(robot, BALLS, clearance=0.01, sigmas=3.0)
    rng = np.random.default_rng(1)
    for q in rng.uniform([-0.3, 0.0, 0.0, 0.0], [0.3, 0.5, 0.5, 0.5], (60, 4)):
        full, table = world.checker.distances(q), near.checker.distances(q)
        assert table[-1, 3] == np.inf
        np.testing.assert_array_equal(table[:, :3], full[:, :3])
        np.testing.assert_array_equal(table[:-1], full[:-1])
        expected = world.field.link_clearances(q)
        expected[-1] = without.field.link_clearances(q)[-1]
        np.testing.assert_allclose(near.field.link_clearances(q), expected, atol=1e-12)
    # The C-space knows the fruit for the other links.
    some, every = (sections_at(robot, prepare_world(one), 0.0, within_reach=False) for one in (near, world))
    for link in range(3):
        mine, all_ = (list(one.obstacle_of[one.link_start[link] : one.link_start[link + 1]]) for one in (some, every))
        assert 3 in all_
        assert mine == [number for number in all_ if number != 3 or link < 2]
    # The original is unchanged.
    assert prepare_world(world).links is None
    assert world.checker.distances(np.zeros(4))[-1, 3] < np.inf


# Obstacles in the base


def test_ground_may_touch_the_pedestal(robot: Robot) -> None:
    ground = Box(name="ground", center=(0.0, 0.0, -0.05), size=(6.0, 6.0, 0.1))
    World.build(robot, [ground], clearance=0.05, sigmas=3.0).check_base()
    deeper = Box(name="ground", center=(0.0, 0.0, -0.05 + 2.0 * BASE_DEPTH), size=(6.0, 6.0, 0.1))
    with pytest.raises(InputError, match="'ground' is 2 mm deep in the robot's 'base_link'"):
        World.build(robot, [deeper]).check_base()


@pytest.mark.parametrize(
    ("obstacle", "link"),
    [
        (Sphere(name="rock", center=(0.1, 0.0, 0.2), radius=0.1), "base_link"),
        (post("pole", 40.0, 0.05, 0.0, 3.0), "base_link"),
        (Box(name="lid", center=(0.0, 0.0, 0.5), size=(0.05, 0.05, 0.05)), "turret"),
        (PointCloud.from_points("dust", [[0.0, 0.0, 0.48], [2.0, 0.0, 1.0]], 0.01), "turret"),
    ],
    ids=["ball", "capsule", "box", "cloud"],
)
def test_obstacle_in_base_is_named(robot: Robot, obstacle, link: str) -> None:
    world = World.build(robot, [*BALLS, *obstacle.solids])
    with pytest.raises(InputError) as caught:
        world.check_base()
    assert caught.value.data["obstacle"] == obstacle.name
    assert caught.value.data["link"] == link
    assert caught.value.data["depth_m"] > BASE_DEPTH
    assert repr(obstacle.name) in caught.value.message


def test_no_obstacle_is_missed(robot: Robot) -> None:
    """Only obstacles near the base are checked; the result holds for all."""
    rng, refused = np.random.default_rng(2), 0
    for _ in range(60):
        solids = random_obstacles(rng, 6)
        world = World.build(robot, solids, clearance=0.1)
        if base_contacts(robot, solids, margin=-BASE_DEPTH):
            refused += 1
            with pytest.raises(InputError, match="deep in the robot's"):
                world.check_base()
        else:
            world.check_base()
    assert refused > 3


def test_obstacle_in_pedestal_is_left_out(robot: Robot) -> None:
    scene = Scene(
        name="row",
        start=Start(joints_deg=(0.0, 90.0, 90.0, 90.0)),
        goal=Goal(fruit="goal"),
        obstacles=(
            Capsule(name="through", start=(-1.0, 0.0, 0.2), end=(1.0, 0.0, 0.2), radius=0.02),
            Capsule(name="beyond", start=(1.5, 0.0, 0.2), end=(1.5, 1.0, 0.2), radius=0.02),
            Box(name="ground", center=(0.0, 0.0, -0.05), size=(6.0, 6.0, 0.1)),
        ),
        fruits=(
            Fruit(name="goal", center=(0.0, 0.0, 0.3), radius=0.04),
            Fruit(name="in", center=(0.0, 0.0, 0.1), radius=0.04),
            Fruit(name="out", center=(1.0, 0.0, 1.9), radius=0.04),
        ),
    )
    smaller, left_out = without_inside(robot, scene)
    assert left_out == ("through", "goal", "in")
    assert [obstacle.name for obstacle in smaller.obstacles] == ["beyond", "ground"]
    assert [fruit.name for fruit in smaller.fruits] == ["out"]
    assert smaller.goal == Goal(fruit="out")
    assert smaller.start == scene.start
    assert without_inside(robot, smaller) == (smaller, ())


def pose(robot: Robot, scene: Scene, **changes: Any) -> Problem:
    changed = Scene.model_validate({**vars(scene), **changes})
    world = World.build(robot, changed.solids, clearance=changed.clearance)
    ends = changed.start.configuration, changed.goal.configuration
    return problem_between(world, *ends, locked_joints=changed.locked_joints)


def test_spare_clearance_is_the_lesser_of_both_ends(robot: Robot, scene: Scene) -> None:
    checker = CoalScene(robot, scene.solids)
    problem = pose(robot, scene)
    ends = [checker.distances(q).min() for q in (problem.start, problem.goal)]
    assert problem.spare_clearances[0] == FAR < min(ends)  # more is of no use
    assert pose(robot, scene, clearance=0.1).spare_clearances[0] == pytest.approx(min(ends) - 0.1)


def test_locked_joints_keep_their_start_value(robot: Robot, scene: Scene) -> None:
    problem = pose(robot, scene, start={"joints_deg": (0.0, 0.0, 60.0, 0.0)}, locked_joints=("base_yaw", "elbow"))
    assert problem.movable.tolist() == [1, 3]
    assert problem.lower[0, 2] == problem.upper[0, 2] == problem.start[2] == problem.goal[2]


def test_uncertainty_and_tracking_error_take_from_the_spare_clearance(robot: Robot, scene: Scene) -> None:
    ends = scene.start.configuration, scene.goal.configuration
    blurred = [solid.model_copy(update={"sigma": 0.01}) for solid in scene.solids]
    world = World.build(robot, blurred, clearance=0.005, tracking_error=1e-2, sigmas=2.0)
    checker = CoalScene(robot, scene.solids)
    sways = family_of(robot).sway(1e-2)[:, None]  # each link its own
    tables = [from_obstacles(checker, robot.check_configuration(q, "")) for q in ends]
    plain, expected = (min((table - less).min() for table in tables) - 0.005 - 0.02 for less in (0.0, sways))
    assert plain - sways.max() < expected < plain
    assert problem_between(world, *ends).spare_clearances[0] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"locked_joints": ("knee",)}, "locked_joints names 'knee'; the robot has base_yaw, shoulder, elbow, wrist"),
        ({"locked_joints": ("wrist",)}, "joint 'wrist' is locked at 0 rad, but the goal has it at 1.22173 rad"),
        ({"goal": {"joints_deg": (1.0, 45.0, 60.0, 70.0)}}, "joint 'base_yaw' is locked at 0 rad"),
        ({"goal": {"joints_deg": (0.0, 45.0)}}, "goal: expected 4 joint values"),
    ],
)
def test_refusals(robot: Robot, scene: Scene, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        pose(robot, scene, **changes)
    assert error.value.message.startswith(message)
    assert error.value.data


@pytest.mark.parametrize(
    ("which", "center", "link"), [("start", (2.0, 0.0, 0.6), "hand"), ("goal", (0.3, 0.0, 0.9), "upper_arm")]
)
def test_in_collision(robot: Robot, scene: Scene, which: str, center: Any, link: str) -> None:
    ball = {"kind": "sphere", "name": "ball", "center": center, "radius": 0.1}
    with pytest.raises(ConfigurationInCollisionError) as error:
        pose(robot, scene, obstacles=(ball,))
    assert (error.value.which, error.value.link, error.value.obstacle) == (which, link, "ball")
    assert error.value.depth_m > 0.1


def test_scenes_with_the_same_solids_share_a_world(robot: Robot) -> None:
    scene, options = load_scene("dense-canopy"), PlanOptions()
    world = World.of_scene(robot, scene, options)
    other = Goal(fruit=next(fruit.name for fruit in scene.fruits if fruit.name != scene.goal.fruit))
    assert World.of_scene(robot, scene.with_values(name="again", goal=other), options) is world
    assert World.of_scene(robot, scene, options.with_values(tracking_error=1e-3)) is not world
    for changed in (scene.with_obstacles(scene.obstacles[1:]), scene.with_values(clearance=scene.clearance + 1e-3)):
        assert World.of_scene(robot, changed, options) is not world
    # Among limbs that bend, the goal fruit is another solid than the others.
    bending = with_limbs(scene)
    world = World.of_scene(robot, bending, options)
    assert World.of_scene(robot, bending.with_values(goal=other), options) is not world
    for problem in (bending, bending.with_values(goal=other)):
        assert World.of_scene(robot, problem, options).solids == problem.solids_with_goal
