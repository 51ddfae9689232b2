"""The whole way: what `plan` gives back, and when it refuses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from studies.planar_cspace import sampled_occupancy

from hplan.collision.coal_scene import CoalScene
from hplan.errors import CertificationError, ConfigurationInCollisionError, NoPathError
from hplan.grid.grid import Grid
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Cylinder, Sphere

START, GOAL = (0.0, 0.0, 0.0, 0.0), (0.0, 45.0, 60.0, 70.0)
SHOULDER = np.array([0.0, 0.0, 0.6])

Obstacles = Sequence[Sphere | Capsule | Cylinder | Box]


def task(obstacles: Obstacles = (), start: Sequence[float] = START, goal: Sequence[float] = GOAL, **more: Any) -> Scene:
    """A planar task, the base locked unless said otherwise."""
    more["locked_joints"] = ("base_yaw", *more.pop("locked_joints", ()))
    return Scene(
        name="test",
        start=Start(joints_deg=tuple(start)),
        goal=Goal(joints_deg=tuple(goal)),
        obstacles=tuple(obstacles),
        **more,
    )


def disc(name: str, radius: float, angle_deg: float, distance: float) -> Sphere:
    """A ball in the arm plane, placed by polar coordinates about the shoulder."""
    angle = math.radians(angle_deg)
    x, _, z = SHOULDER + distance * np.array([math.cos(angle), 0.0, math.sin(angle)])
    return Sphere(name=name, center=(x, 0.0, z), radius=radius)


def assert_sound(robot: Robot, scene: Scene, result: Any) -> None:
    """What every plan must keep, judged by coal at every row and by the certificate."""
    trajectory = result.trajectory
    assert result.certificate.verified
    assert result.report["certificate"]["verified"]
    checker = CoalScene(robot, scene.solids)
    if checker.obstacle_names:
        nearest = min(checker.distances(q).min() for q in trajectory.position)
        assert nearest >= result.certificate.min_clearance_m > scene.clearance
    assert (trajectory.position >= robot.lower - 1e-9).all()
    assert (trajectory.position <= robot.upper + 1e-9).all()
    np.testing.assert_allclose(trajectory.position[0], result.problem.start, rtol=0, atol=1e-12)
    np.testing.assert_allclose(trajectory.position[-1], result.problem.goal, rtol=0, atol=1e-12)
    np.testing.assert_allclose(trajectory.velocity[[0, -1]], 0.0, rtol=0, atol=1e-9)


def test_reference_scene(robot: Robot, scene: Scene) -> None:
    stages: list[str] = []
    result = plan(robot, scene, progress=stages.append)
    assert_sound(robot, scene, result)
    assert stages == ["cspace", "search", "trees", "postprocess", "timing", "certificate"]
    assert result.occupancy.occupied_count == 128_891
    assert math.degrees(result.search.cost) == pytest.approx(145.2149523784, abs=1e-9)
    assert result.grid_path.shape == (107, 4)
    assert result.report["trajectory"]["samples"] == result.trajectory.samples


# Scenes


def test_start_and_goal_beside_the_grid(robot: Robot, scene: Scene) -> None:
    beside = task(scene.obstacles, (0.0, 0.31, 0.47, 0.5), (0.0, 44.713, 60.29, 69.51))
    result = plan(robot, beside)
    assert_sound(robot, beside, result)
    np.testing.assert_allclose(result.grid_path[[0, -1]], [result.problem.start, result.problem.goal], atol=0)


def test_base_stands_at_its_start_value(robot: Robot) -> None:
    """The same task with the plane turned by 30 degrees has the same answer."""
    x, y = math.cos(math.radians(30)), math.sin(math.radians(30))
    turned = task([Sphere(name="ball", center=(x, y, 1.9), radius=0.15)], (30.0, *START[1:]), (30.0, *GOAL[1:]))
    result = plan(robot, turned)
    assert_sound(robot, turned, result)
    assert math.degrees(result.search.cost) == pytest.approx(145.2149523784, abs=1e-9)
    np.testing.assert_allclose(result.trajectory.position[:, 0], math.radians(30), rtol=0, atol=1e-12)


def test_locked_joint_does_not_move(robot: Robot) -> None:
    scene = task(
        [disc("ball", 0.1, 100.0, 1.0)], (0.0, 0.0, 30.0, 0.0), (0.0, 45.0, 30.0, 70.0), locked_joints=("elbow",)
    )
    result = plan(robot, scene)
    assert_sound(robot, scene, result)
    np.testing.assert_allclose(result.trajectory.position[:, 2], math.radians(30), rtol=0, atol=1e-12)


def test_start_equal_to_goal(robot: Robot, scene: Scene) -> None:
    stay = task(scene.obstacles, GOAL, GOAL)
    result = plan(robot, stay)
    assert result.trajectory.samples == 1
    assert result.search is None
    assert result.path is None
    assert result.report["planner"]["expansions"]["total"] == 0
    assert_sound(robot, stay, result)


# No path


def joined(robot: Robot, scene: Scene, step_deg: float) -> bool:
    """By brute force: whether start and goal are connected on the grid, every node judged by coal."""
    ndimage = pytest.importorskip("scipy.ndimage")
    grid = Grid.over(robot.lower[1:], robot.upper[1:], math.radians(step_deg))
    checker = CoalScene(robot, scene.solids)
    occupied = sampled_occupancy(checker, grid)
    labels, _ = ndimage.label(~occupied, structure=np.ones((3, 3, 3)))
    start, goal = (labels[tuple(grid.nearest(target.joints()[1:]))] for target in (scene.start, scene.goal))
    assert start != 0
    assert goal != 0
    return bool(start == goal)


BLOCKED = {
    "wall of discs": [disc(f"disc {i}", 0.08, 22.5, distance) for i, distance in enumerate([0.45, 0.65, 0.85, 1.05])],
    "box between": [Box(name="box", center=(0.8, 0.0, 0.9), size=(0.2, 0.3, 0.1), rpy_deg=(0.0, -25.0, 0.0))],
    "wire": [Capsule(name="wire", start=(0.8, -1.0, 0.95), end=(0.8, 1.0, 0.95), radius=0.01)],
}


@pytest.mark.parametrize("kind", BLOCKED)
def test_no_path_names_what_blocks(robot: Robot, kind: str) -> None:
    scene = task(BLOCKED[kind])
    assert not joined(robot, scene, 3.0)
    methods: tuple[Any, ...] = ("two-level", "dense")
    for method in methods:
        with pytest.raises(NoPathError) as error:
            plan(robot, scene, PlanOptions(step_deg=3.0, method=method))
        names = {obstacle.name for obstacle in scene.obstacles}
        first = error.value.blockers[0]
        assert 0 < error.value.reached_cells < 31**3
        assert {blocker["obstacle"] for blocker in error.value.blockers} <= names
        assert (first["link"], first["slices_deg"]) == ("upper_arm", [0.0, 90.0])
        for word in (repr(first["obstacle"]), "'upper_arm'", "wrist from 0 to 90 deg"):
            assert word in str(error.value)


def test_brute_force_agrees_where_there_is_a_path(robot: Robot, scene: Scene) -> None:
    assert joined(robot, scene, 3.0)


def clutter(seed: int, robot: Robot) -> Scene:
    """Discs in the arm plane that leave start and goal 1 cm of room."""
    random = np.random.default_rng(seed)
    wanted, discs = int(random.integers(1, 9)), []
    ends = np.radians([START, GOAL])
    while len(discs) < wanted:
        radius, angle, distance = random.uniform([0.03, 0.0, 0.3], [0.2, 180.0, 2.4])
        candidate = disc(f"disc {len(discs)}", radius, angle, distance)
        checker = CoalScene(robot, [candidate])
        if min(checker.distances(q).min() for q in ends) > 0.01:
            discs.append(candidate)
    return task(discs)


@pytest.mark.parametrize("seed", range(6))
def test_random_scene_gives_a_certified_motion_or_no_path(robot: Robot, seed: int) -> None:
    scene = clutter(seed, robot)
    options = PlanOptions(step_deg=2.5)  # start and goal are nodes
    try:
        result = plan(robot, scene, options)
    except NoPathError:
        assert not joined(robot, scene, 2.5)
    else:
        assert_sound(robot, scene, result)


# Refusals


@pytest.mark.parametrize("which", ["start", "goal"])
def test_end_with_no_free_node_near_is_not_certified(robot: Robot, which: str) -> None:
    """Start or goal free, but walled in between the nodes of a coarse grid."""
    pocket = [disc("above", 0.05, 28.0, 0.9), disc("below", 0.05, 12.0, 0.9)]
    inside, outside = (0.0, 20.0, 0.0, 0.0), (0.0, 60.0, 0.0, 0.0)
    ends = (inside, outside) if which == "start" else (outside, inside)
    with pytest.raises(CertificationError, match=f"no motion from the {which}") as error:
        plan(robot, task(pocket, *ends), PlanOptions(step_deg=45.0))
    assert error.value.data["which"] == which


def test_uncertified_result_says_so(robot: Robot, scene: Scene) -> None:
    options = PlanOptions(tracking_error=0.3, certify=False)
    result = plan(robot, scene, options)
    assert not result.certificate.verified
    assert result.report["certificate"]["verified"] is False
    assert result.report["certificate"]["violations"]
    with pytest.raises(ConfigurationInCollisionError, match="too close"):
        plan(robot, scene, PlanOptions(tracking_error=0.3))
