"""Grasps: tool position, straight approach along the last link, error messages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from planned import at, last_link, post

from hplan.collision.coal_scene import CoalScene
from hplan.errors import BlockedError
from hplan.kinematics.straight_line import ToolLine
from hplan.planar.family_reader import family_of
from hplan.planar.inverse_kinematics import reach
from hplan.planning.grasps import SEARCHED, SPARE, Grasp, Target, grasps, select_promising
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene.obstacles import Box, Sphere

START = np.radians([10.0, 80.0, 80.0, 80.0])
FRUIT = Sphere(name="fruit", center=at(40.0, 1.3, 1.6), radius=0.04)


def found(
    robot: Robot, obstacles: Any = (), point: Any = FRUIT.center, fruit: bool = True, *, standoff: float = 0.1,
    locked: tuple[str, ...] = (), **more: Any,
) -> tuple[Grasp, ...]:  # fmt: skip
    """Grasps of the fruit, or of a point, among obstacles."""
    solids = [*obstacles, *([FRUIT] if fruit else [])]
    world = World.build(robot, solids)
    near = world.allow_touch("fruit") if fruit else world
    target = Target("fruit 'fruit'", point, world, near, **{"least_standoff": 0.075 if fruit else 0.0, **more})
    return grasps(target, START, standoff=standoff, locked=locked)


def assert_grasps(robot: Robot, ways: tuple[Grasp, ...], world: World, near: World, point: Any) -> None:
    assert ways
    for grasp in ways:
        np.testing.assert_allclose(robot.tool_positions(grasp.goal), point, atol=1e-6)
        heading = last_link(robot, grasp.goal)
        _, axes = family_of(robot).plane_at(grasp.goal[0])
        assert math.atan2(heading @ axes[1], heading @ axes[0]) == pytest.approx(grasp.approach, abs=1e-6)
        path = grasp.path(robot)
        if grasp.distance == 0.0:
            assert path is None
            np.testing.assert_array_equal(grasp.standoff, grasp.goal)
        else:
            assert isinstance(path, ToolLine)
            away = robot.tool_positions(grasp.standoff) - point
            np.testing.assert_allclose(away, -grasp.distance * heading, atol=1e-6)
            np.testing.assert_allclose(path.evaluate(0.0), grasp.standoff, atol=1e-9)
            np.testing.assert_allclose(path.evaluate(path.end), grasp.goal, atol=1e-12)
            distances = world.checker.distances(grasp.standoff)
            assert distances.size == 0 or distances.min() > 0.9 * SPARE
            tools = robot.tool_positions(path.evaluate(np.linspace(0.0, path.end, 30)))
            beside = (tools - point) - np.outer((tools - point) @ heading, heading)
            assert np.linalg.norm(beside, axis=1).max() < 1e-4
        distances = near.checker.distances(grasp.goal)
        assert distances.size == 0 or distances.min() > 0.9 * SPARE
    least = [grasp.least_duration for grasp in ways]
    assert least == sorted(least)


@pytest.mark.parametrize("seed", range(4))
def test_grasps_among_obstacles(robot: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    point = at(float(rng.uniform(-170, 170)), 1.3, 1.6)
    fruit = Sphere(name="fruit", center=point, radius=0.04)
    obstacles = [
        Sphere(name=f"o{i}", center=tuple((np.array(point) + rng.uniform(-0.5, 0.5, 3)).tolist()), radius=0.05)
        for i in range(8)
    ]
    obstacles = [ball for ball in obstacles if math.dist(ball.center, point) > 0.12]
    world = World.build(robot, [*obstacles, fruit], clearance=0.005)
    near = world.allow_touch("fruit")
    ways = grasps(Target("it", point, world, near, least_standoff=0.08), START, standoff=0.12)
    without_clearance = World.build(robot, [*obstacles, fruit])
    assert_grasps(robot, ways, without_clearance, without_clearance.allow_touch("fruit"), point)
    assert {grasp.distance for grasp in ways} <= {0.12, 0.08, 0.0}
    # The distance is the maximum possible: one for all, or shorter ones if an obstacle blocks the longer.
    with_approach = [grasp for grasp in ways if grasp.distance > 0.0]
    assert not with_approach or len(with_approach) == len(ways)


@pytest.mark.parametrize("approach", [118.0, 125.0, (90.0, 120.0), (115.0, 470.0), (-360.0, 0.0)])
def test_approach_angle_holds(robot: Robot, approach: Any) -> None:
    ways = found(robot, approach_deg=approach)
    low, high = approach if isinstance(approach, tuple) else (approach, approach)
    for grasp in ways:
        assert (math.degrees(grasp.approach) - low + 1e-7) % 360.0 <= high - low + 2e-7


def test_standoff_is_shortened_if_long_one_collides(robot: Robot) -> None:
    """A plate behind the hand at one approach angle leaves half of the stand-off, then a fifth, then none."""
    free = found(robot, fruit=False, least_standoff=0.0, standoff=0.1)
    grasp = free[len(free) // 2]
    angle = math.degrees(grasp.approach)
    heading = last_link(robot, grasp.goal)
    wrist = np.array(FRUIT.center) - 0.4 * heading
    lengths = {}
    for gap in (0.3, 0.085, 0.045, 0.015):
        # Next to the forearm's end, on the side of the retreat.
        place = wrist - (0.04 + gap + 0.01) * heading
        bead = Sphere(name="bead", center=tuple(place.tolist()), radius=0.01)
        try:
            ways = found(robot, [bead], fruit=False, least_standoff=0.0, standoff=0.1, approach_deg=angle)
        except BlockedError:
            lengths[gap] = -1.0
            continue
        lengths[gap] = max(way.distance for way in ways)
        world = World.build(robot, [bead])
        assert_grasps(robot, ways, world, world, FRUIT.center)
    values = [lengths[gap] for gap in sorted(lengths, reverse=True)]
    assert values == sorted(values, reverse=True)
    assert values[0] == 0.1
    assert len(set(values)) >= 3, values


def test_obstacles_on_the_way_in_are_seen(robot: Robot) -> None:
    """Beads that a link sweeps over between the stand-off and the goal, clear of it at both."""
    free = found(robot, fruit=False, standoff=0.4, point=at(40.0, 1.0, 1.7))
    rng, seen = np.random.default_rng(0), 0
    for grasp in [way for way in free if way.distance == 0.4][::4]:
        path = grasp.path(robot)
        assert path is not None
        middle = path.evaluate(0.4 * path.end)
        points = (
            family_of(robot).plane_origin + family_of(robot).arm.joint_points(middle[1:]) @ family_of(robot).plane_axes
        )
        cos, sin = math.cos(middle[0]), math.sin(middle[0])
        points = points @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        share = float(rng.uniform(0.1, 0.9))
        place = (1.0 - share) * points[1] + share * points[2]
        bead = Sphere(name="bead", center=tuple(place.tolist()), radius=0.005)
        checker = CoalScene(robot, [bead])
        if min(checker.distances(q).min() for q in (grasp.standoff, grasp.goal)) < 2.0 * SPARE:
            continue
        seen += 1
        angle = math.degrees(grasp.approach)
        ways = found(robot, [bead], fruit=False, standoff=0.4, point=at(40.0, 1.0, 1.7), approach_deg=angle)
        same = [way for way in ways if np.abs(way.goal - grasp.goal).max() < 1e-9]
        assert [way.distance < 0.4 for way in same] == [True]
    assert seen >= 3


# Targets without a grasp


def test_blocked_error_names_obstacle(robot: Robot) -> None:
    trunk = post("trunk", 40.0, 1.3, 0.0, 3.0, 0.1)
    with pytest.raises(BlockedError, match="fruit 'fruit' is blocked: all") as caught:
        found(robot, [trunk])
    error = caught.value
    assert {item["obstacle"] for item in error.obstacles} == {"trunk"}
    total = len(reach(robot, FRUIT.center, count=64, start=START).configurations)
    assert error.data["tried"] == total == sum(item["configurations"] for item in error.obstacles)
    assert all(item["link"] in family_of(robot).arm.link_names for item in error.obstacles)
    assert error.exit_status == 3


@pytest.mark.parametrize("behind", [0, 1, 9, 20])
@pytest.mark.parametrize("beside", [0, 3])
def test_promising_are_the_first_straight_one_and_some_of_those_before(robot: Robot, behind: int, beside: int) -> None:
    """Some stand-offs behind a wall, then some on this side of it."""
    world = World.build(robot, [Box(name="wall", center=(1.0, 0.58, 1.0), size=(1.6, 0.02, 2.4), rpy_deg=(0, 0, 30))])

    def grasp_at(yaw_deg: float) -> Grasp:
        q = np.radians([yaw_deg, 20.0, 20.0, 20.0])
        return Grasp(goal=q, standoff=q, distance=0.1, approach=0.0, least_duration=1.0)

    ways = [*(grasp_at(70.0 + i) for i in range(behind)), *(grasp_at(-30.0 - i) for i in range(beside))]
    start = np.radians([-10.0, 20.0, 20.0, 20.0])
    straight = [world.field.is_clear(np.stack([start, grasp.standoff]), SPARE) for grasp in ways]
    assert straight == [False] * behind + [True] * beside
    likely = select_promising(ways, Target("it", FRUIT.center, world, world), start)
    assert 0 < len(likely) <= SEARCHED + 1 or not ways
    assert not ways or likely[0] is ways[0]
    assert not beside or likely[-1] is ways[behind]
