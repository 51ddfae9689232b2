"""The whole pipeline: results of `plan`, reports, seeds, refusals."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import planned
import pytest
from planar_sections import sampled_occupancy
from planned import assert_sound
from scipy.stats import chi

import hplan
from hplan.collision.coal_scene import CoalScene
from hplan.errors import CertificationError, JointLimitError, NoPathError
from hplan.planar.grid.grid import Grid
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.report import beyond_sigmas, failure_report, uncertainty_report, write_report
from hplan.robot.family import ArmSpec, write_robot
from hplan.robot.model import Robot
from hplan.scene.file import load_scene
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Sphere

START, GOAL = (0.0, 0.0, 0.0, 0.0), (0.0, 45.0, 60.0, 70.0)
SHOULDER = np.array([0.0, 0.0, 0.6])


def task(obstacles=(), start=START, goal=GOAL, **more: Any) -> Scene:
    """A planar task: the base is locked."""
    more["locked_joints"] = ("base_yaw", *more.pop("locked_joints", ()))
    return planned.task(start, goal, obstacles, **more)


def disc(name: str, radius: float, angle_deg: float, distance: float) -> Sphere:
    """A ball in the arm plane, placed by polar coordinates about the shoulder."""
    angle = math.radians(angle_deg)
    x, _, z = SHOULDER + distance * np.array([math.cos(angle), 0.0, math.sin(angle)])
    return Sphere(name=name, center=(x, 0.0, z), radius=radius)


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


def test_start_and_goal_off_the_grid(robot: Robot, scene: Scene) -> None:
    beside = task(scene.obstacles, (0.0, 0.31, 0.47, 0.5), (0.0, 44.713, 60.29, 69.51))
    result = plan(robot, beside)
    assert_sound(robot, beside, result)
    np.testing.assert_allclose(result.grid_path[[0, -1]], [result.problem.start, result.problem.goal], atol=0)


def test_locked_base_stays_at_its_start_value(robot: Robot) -> None:
    """With the plane turned by 30 degrees the task has the answer that it had."""
    x, y = math.cos(math.radians(30)), math.sin(math.radians(30))
    turned = task([Sphere(name="ball", center=(x, y, 1.9), radius=0.15)], (30.0, *START[1:]), (30.0, *GOAL[1:]))
    result = plan(robot, turned)
    assert_sound(robot, turned, result)
    assert math.degrees(result.search.cost) == pytest.approx(145.2149523784, abs=1e-9)
    np.testing.assert_allclose(result.trajectory.position[:, 0], math.radians(30), rtol=0, atol=1e-12)


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
    """True if start and goal are connected on the grid, by brute force with coal."""
    ndimage = pytest.importorskip("scipy.ndimage")
    grid = Grid.from_limits(robot.lower[1:], robot.upper[1:], math.radians(step_deg))
    checker = CoalScene(robot, scene.solids)
    occupied = sampled_occupancy(checker, grid)
    labels, _ = ndimage.label(~occupied, structure=np.ones((3, 3, 3)))
    start, goal = (labels[tuple(grid.nearest_node(target.listed_joints()[1:]))] for target in (scene.start, scene.goal))
    assert start != 0
    assert goal != 0
    return bool(start == goal)


BLOCKED = {
    "wall of discs": [disc(f"disc {i}", 0.08, 22.5, distance) for i, distance in enumerate([0.45, 0.65, 0.85, 1.05])],
    "box between": [Box(name="box", center=(0.8, 0.0, 0.9), size=(0.2, 0.3, 0.1), rpy_deg=(0.0, -25.0, 0.0))],
    "wire": [Capsule(name="wire", start=(0.8, -1.0, 0.95), end=(0.8, 1.0, 0.95), radius=0.01)],
}


@pytest.mark.parametrize("kind", BLOCKED)
def test_no_path_error_names_obstacle(robot: Robot, kind: str) -> None:
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


def test_brute_force_agrees_on_existence_of_path(robot: Robot, scene: Scene) -> None:
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


def test_coarse_grids_that_are_too_large_are_left_out(tmp_path: Path) -> None:
    """A chain of six links that turn all around has no grid that fits."""
    six = (1.0,) * 6
    spec = ArmSpec(
        name="chain", link_lengths=(0.4,) * 6, link_half_widths=(0.01,) * 6, link_masses=six,
        lower=(-math.pi,) * 6, upper=(math.pi,) * 6, velocity=six, effort=(500.0,) * 6, acceleration=six, jerk=None,
        shoulder_height=3.0, has_yaw=False, base_mass=40.0, turret_mass=12.0,
    )  # fmt: skip
    write_robot(spec, tmp_path / "chain.urdf")
    robot = hplan.load_robot(tmp_path / "chain.urdf")
    scene = Scene(
        name="ball",
        start=Start(joints_rad=(0.5, 0.1, 0.1, 0.1, 0.1, 0.1)),
        goal=Goal(joints_rad=(-0.5, 0.1, 0.1, 0.1, 0.1, 0.1)),
        obstacles=(Sphere(name="ball", center=(2.2, 0.0, 2.6), radius=0.1),),
    )
    assert hplan.plan(robot, scene).motion.origin == "trees"


def test_another_seed_may_lead_to_another_motion_and_each_is_the_same_every_time(robot: Robot) -> None:
    ball = Sphere(name="ball", center=[1.6, 0.0, 1.6], radius=0.25)
    ends = {"start": Start(joints_rad=[0.0, 1.2, 0.3, 0.3]), "goal": Goal(joints_rad=[0.0, 0.1, 0.3, 0.3])}
    scene = Scene(name="ball", clearance=0.005, obstacles=[ball], **ends)
    found = [hplan.plan(robot, scene, PlanOptions(effort="quick", seed=seed)) for seed in (0, 1, 1)]
    assert all(result.certificate.verified for result in found)
    first, other, again = (result.certificate.digests for result in found)
    assert first != other == again


def test_results_are_a_line(robot: Robot, scene: Scene) -> None:
    result = plan(robot, scene, PlanOptions(effort="quick"))
    assert re.fullmatch(r"<Trajectory: \S+ s, \d+ samples, joints base_yaw, .*>", repr(result.trajectory))
    assert len(repr(result)) < 1500
    assert len(repr(result.motion)) < 1500


def test_values_that_are_not_finite_become_null(tmp_path: Path) -> None:
    path = write_report({"a": math.inf, "b": [-math.inf, {"c": (math.nan, 1.5)}], "d": None}, tmp_path / "r.json")
    expected = {"format": "hplan-report/1", "a": None, "b": [None, {"c": [None, 1.5]}], "d": None}
    assert json.loads(path.read_text()) == expected


def test_failure_report_carries_the_facts(tmp_path: Path) -> None:
    error = JointLimitError("start", "elbow", -0.5, 0.0, math.pi / 2)
    report = failure_report(error, scene="s", robot=None)
    assert (report["status"], report["scene"], report["robot"]) == ("failed", "s", None)
    assert report["error"] == {
        "kind": "JointLimitError",
        "message": "start: joint 'elbow' is at -0.5 rad, outside its limits [0, 1.5708] rad",
        "which": "start",
        "joint": "elbow",
        "value_rad": -0.5,
        "lower_rad": 0.0,
        "upper_rad": math.pi / 2,
    }
    written = json.loads(write_report(report, tmp_path / "r.json").read_text())
    assert written == {"format": "hplan-report/1", **report}


@pytest.mark.parametrize("sigmas", [0.0, 1.0, 3.0, 4.5])
def test_free_space_of_sigmas_agrees_with_distances(sigmas: float) -> None:
    assert beyond_sigmas(sigmas) == pytest.approx(chi(3).sf(sigmas), rel=1e-9)
    balls = tuple(Sphere(name=f"{k}", center=(2, k, 1), radius=0.1, sigma=0.01 * (k > 0)) for k in range(4))
    scene = load_scene().model_copy(update={"obstacles": balls})
    told = uncertainty_report(scene, sigmas)["uncertain"]
    assert (told["obstacles"], told["one_beyond"]) == (3, beyond_sigmas(sigmas))
    assert told["any_beyond_at_most"] == min(1.0, 3.0 * beyond_sigmas(sigmas))
    assert uncertainty_report(load_scene(), sigmas) == {}
