"""The whole pipeline with a turning base, to fruits and points, judged by coal.

Every motion is checked at and between its samples.
"""

from __future__ import annotations

import gc
import math
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from fitted_arms import Bodies
from planned import (
    assert_clear,
    assert_sound,
    at,
    between_rows,
    frame_about_upper_arm,
    fruit,
    part,
    post,
    random_scene,
    task,
)

from hplan.collision.coal_scene import CoalScene
from hplan.errors import ConfigurationInCollisionError, NoPathError, UnreachableError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.family import ORCHARD_HARVESTER, write_robot
from hplan.robot.model import Robot, load_robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Sphere

START, GOAL = (0.0, 30.0, 20.0, 20.0), (60.0, 30.0, 20.0, 20.0)
FOLDED = (0.0, 80.0, 80.0, 80.0)
APPLE = fruit("apple", 40.0, 1.3, 1.6)
COARSE = PlanOptions(step_deg=2.0)


def planner_of(result: Any) -> tuple[str, str]:
    return result.report["planner"]["method"], result.report["planner"]["fallback"]


# From joints to joints


def test_straight_motion_without_search(robot: Robot) -> None:
    for obstacles in ([], [post("low", 30.0, 1.2, 0.0, 0.9)]):
        scene = task(START, GOAL, obstacles)
        stages: list[str] = []
        result = plan(robot, scene, progress=stages.append)
        assert planner_of(result) == ("direct", "none")
        assert result.search is None
        assert result.occupancy is None
        assert "cspace" not in stages
        assert "search" not in stages
        np.testing.assert_allclose(result.grid_path, np.radians([START, GOAL]))
        assert_sound(robot, scene, result)
        share = result.trajectory.position[:, 0] / math.radians(60.0)
        np.testing.assert_allclose(
            result.trajectory.position, np.radians(START) + share[:, None] * [math.radians(60), 0, 0, 0]
        )


def around_the_bar() -> Scene:
    """A bar in the arm plane above start and below goal: the only path is around it."""
    bar = Sphere(name="ball", center=(1.3, 0.0, 1.6), radius=0.15)
    return task((0.0, 10.0, 10.0, 10.0), (0.0, 70.0, 10.0, 10.0), [bar])


def test_base_moves_where_the_plane_is_closed(robot: Robot) -> None:
    """Start and goal at one yaw: the base leaves it and comes back. Locked, there is no path."""
    scene = around_the_bar()
    free = plan(robot, scene)
    assert np.ptp(free.trajectory.position[:, 0]) > math.radians(2.0)
    assert free.trajectory.duration < 1.5 * free.motion.problem.least_duration
    with pytest.raises(NoPathError):
        plan(robot, Scene(**{**vars(scene), "locked_joints": ("base_yaw",)}))


@pytest.mark.parametrize("turned_deg", [0.0, 8.0])
def test_base_moves_whenever_that_is_better(robot: Robot, turned_deg: float) -> None:
    """The ball of the reference scene: folding in the plane, or turning the base."""
    ball = Sphere(name="ball", center=at(0.5 * turned_deg, 1.0, 1.9), radius=0.15)
    scene = task((0.0, 0.0, 0.0, 0.0), (turned_deg, 45.0, 60.0, 70.0), [ball])
    free = plan(robot, scene)
    assert_sound(robot, scene, free)
    assert free.trajectory.duration < 1.3


@pytest.mark.parametrize(("enclosed", "step_deg"), [("start", 1.0), ("start", 3.0), ("goal", 3.0)])
def test_no_path_at_any_yaw(robot: Robot, enclosed: str, step_deg: float) -> None:
    """A frame of four bars around the upper arm: it is enclosed, and quickly proved."""
    inside, outside = (60.0, 20.0, 20.0, 20.0), (0.0, 70.0, 20.0, 20.0)
    ends = (inside, outside) if enclosed == "start" else (outside, inside)
    scene = task(*ends, frame_about_upper_arm(60.0, 20.0))
    with pytest.raises(NoPathError, match=f"no path exists on the grid: the {enclosed} is connected to") as caught:
        plan(robot, scene, PlanOptions(step_deg=step_deg))
    error = caught.value
    assert error.reached_cells > 0
    # The obstacles that block the arm above and below: walls are searched in the plane.
    assert {wall["obstacle"] for wall in error.blockers} == {"bar 0", "bar 2"}
    assert error.blockers[0]["link"] == "upper_arm"
    assert error.exit_status == 3
    assert "'bar" in error.message


def bytes_of(step_deg: float) -> float:
    """Of the C-space of a harvester that may turn all around, one bit a node and whole words."""
    planar, yaws = 90.0 / step_deg + 1.0, 360.0 / step_deg + 1.0
    return planar**3 * 8.0 * math.ceil(yaws / 64.0)


def test_nothing_is_left_behind(robot: Robot) -> None:
    """A plan with several grids frees them at once: garbage collection may be disabled."""
    enclosed = task((0.0, 70.0, 20.0, 20.0), (60.0, 20.0, 20.0, 20.0), frame_about_upper_arm(60.0, 20.0))
    for _ in range(2):  # kernels are loaded the first time
        gc.collect()
        gc.disable()
        tracemalloc.start()
        with pytest.raises(NoPathError):
            plan(robot, enclosed, COARSE)
        plan(robot, around_the_bar(), COARSE)
        left = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        gc.enable()
    assert left < bytes_of(2.0)


def test_yaw_does_not_pass_its_limits(robot: Robot) -> None:
    """The short way is closed: it leads past half a turn."""
    scene = task((170.0, 30.0, 20.0, 20.0), (-170.0, 30.0, 20.0, 20.0))
    result = plan(robot, scene)
    assert_sound(robot, scene, result)
    assert np.ptp(result.trajectory.position[:, 0]) == pytest.approx(math.radians(340.0))


def test_tracking_error_and_clearance(robot: Robot) -> None:
    scene = task(START, GOAL, [post("post", 30.0, 1.2, 0.0, 2.0)], clearance=0.02)
    error = 0.002
    result = plan(robot, scene, PlanOptions(step_deg=2.0, tracking_error=error))
    assert_sound(robot, scene, result)
    rng = np.random.default_rng(0)
    q = between_rows(result.trajectory, np.arange(result.trajectory.samples), 1)
    for _ in range(8):
        off = np.clip(q + rng.choice([-error, error], q.shape), robot.lower, robot.upper)
        assert_clear(robot, scene, off)


# Uncertain places


@pytest.mark.parametrize("sigmas", [0.0, 1.0, 3.0])
def test_uncertain_obstacles_are_passed_farther_away(robot: Robot, sigmas: float) -> None:
    """By a multiple of their standard deviation, and not much more."""
    sure, vague = post("sure", 20.0, 1.3, 0.0, 1.9), post("vague", 40.0, 1.3, 0.0, 1.9, sigma=0.02)
    scene = task(START, GOAL, [sure, vague])
    result = plan(robot, scene, PlanOptions(step_deg=2.0, sigmas=sigmas))
    assert_sound(robot, scene, result, sigmas=sigmas)
    checker = CoalScene(robot, scene.solids)
    nearest = np.min([checker.distances(q) for q in result.trajectory.position], axis=(0, 1))
    assert nearest[0] > 0.0
    assert sigmas * 0.02 < nearest[1] < sigmas * 0.02 + 0.06


def test_uncertainty_takes_the_place_of_start_and_goal(robot: Robot) -> None:
    """Without sigmas the obstacle has its own size; with three the goal is too close."""
    tip = robot.tool_positions(np.radians(GOAL))
    ball = Sphere(name="ball", center=tuple(np.add(tip, (0.0, 0.0, 0.15)).tolist()), radius=0.1, sigma=0.01)
    scene = task(START, GOAL, [ball])
    assert_sound(robot, scene, plan(robot, scene, PlanOptions(sigmas=1.0)), sigmas=1.0)
    assert_sound(robot, scene, plan(robot, scene, PlanOptions(sigmas=0.0)), sigmas=0.0)
    with pytest.raises(ConfigurationInCollisionError, match=r"goal is in collision: .*'ball'"):
        plan(robot, scene, PlanOptions(sigmas=3.0))


def test_target_fruit_is_uncertain(robot: Robot) -> None:
    """It is kept clear of on the way, and touched at the end."""
    for sigma in (0.0, 0.01):
        target = fruit("apple", 40.0, 1.3, 1.6, sigma=sigma)
        scene = task(FOLDED, Goal(fruit="apple"), fruits=(target,))
        assert_sound(robot, scene, plan(robot, scene, COARSE))


# Fruits and points

CROWN = [
    post("trunk", 48.0, 1.55, 0.0, 2.5),
    Box(name="ground", center=(0.0, 0.0, -0.05), size=(6.0, 6.0, 0.1)),
    Sphere(name="leaf", center=at(43.0, 1.2, 1.85), radius=0.06),
]
OTHERS = (fruit("b", 36.0, 1.3, 1.7), fruit("c", 45.0, 1.25, 1.5))


def test_pick(robot: Robot) -> None:
    scene = task(FOLDED, Goal(fruit="apple"), CROWN, fruits=(APPLE, *OTHERS))
    result = plan(robot, scene)
    assert_sound(robot, scene, result)
    assert [phase.name for phase in result.phases] == ["transit", "approach", "retreat"]
    assert result.grasp is not None
    assert result.grasp.distance in (pytest.approx(0.1), pytest.approx(0.072))
    report = result.report
    assert report["grasp"]["fruit"] == "apple"
    assert report["grasp"]["standoff_m"] == result.grasp.distance
    assert report["phases"][1] == vars(result.phases[1])
    # Nothing touches it before the approach, and the hand has it in its middle at the end of that.
    checker = CoalScene(robot, [solid for solid in scene.solids_with_goal if solid.name == "apple"])
    approach = result.phases[1]
    before = part(result.trajectory, 0.0, approach.start_s)
    assert min(checker.distances(q).min() for q in result.trajectory.position[before]) > 0.0
    there = result.trajectory.position[part(result.trajectory, approach.end_s, approach.end_s)]
    np.testing.assert_allclose(robot.tool_positions(there), [APPLE.center], atol=1e-9)
    assert checker.distances(there[0])[-1, 0] == pytest.approx(-0.04 - 0.03, abs=1e-6)
    assert checker.distances(there[0])[:-1].min() > 0.0


def test_retreat_is_the_approach_backwards(robot: Robot) -> None:
    scene = task(FOLDED, Goal(fruit="apple"), CROWN, fruits=(APPLE, *OTHERS))
    result = plan(robot, scene, replace(COARSE, effort="quick"))  # with a stop at the stand-off on both
    _, there, back = (part(result.trajectory, phase.start_s, phase.end_s) for phase in result.phases)
    np.testing.assert_allclose(result.trajectory.position[back], result.trajectory.position[there][::-1], atol=1e-12)
    np.testing.assert_allclose(result.trajectory.velocity[back], -result.trajectory.velocity[there][::-1], atol=1e-12)


@pytest.mark.parametrize("approach", [118.0, (112.0, 118.0), (-360.0, 360.0)])
def test_approach_angle_is_kept(robot: Robot, approach: Any) -> None:
    scene = task(FOLDED, Goal(fruit="apple", approach_deg=approach), CROWN, fruits=(APPLE, *OTHERS))
    assert_sound(robot, scene, plan(robot, scene, COARSE))


def test_to_a_point(robot: Robot) -> None:
    scene = task(FOLDED, Goal(position=at(40.0, 1.3, 1.6)), CROWN, fruits=OTHERS)
    result = plan(robot, scene, COARSE)
    assert_sound(robot, scene, result)
    assert result.report["grasp"]["fruit"] is None
    np.testing.assert_allclose(robot.tool_positions(result.trajectory.position[-1]), at(40.0, 1.3, 1.6), atol=1e-9)
    short = plan(robot, scene, PlanOptions(step_deg=2.0, standoff=0.0))
    assert_sound(robot, scene, short)
    assert [phase.name for phase in short.phases] == ["transit"]


@pytest.mark.parametrize(
    ("goal", "locked"),
    [("fruit", ("base_yaw",)), ("fruit", ("elbow",)), ("position", ("wrist",)), ("fruit", ("base_yaw", "shoulder"))],
)
def test_locked_joints(robot: Robot, goal: str, locked: tuple[str, ...]) -> None:
    there = np.array([40.0, 60.0, 45.0, 20.0])
    start = tuple(float(there[k]) if name in locked else FOLDED[k] for k, name in enumerate(robot.joint_names))
    point = tuple(robot.tool_positions(np.radians(there)).tolist())
    aim = Goal(fruit="apple") if goal == "fruit" else Goal(position=point)
    fruits = ({"name": "apple", "center": point, "radius": 0.04},) if goal == "fruit" else ()
    scene = task(start, aim, [post("trunk", 55.0, 1.4, 0.0, 2.5)], fruits=fruits, locked_joints=locked)
    result = plan(robot, scene, COARSE)
    assert_sound(robot, scene, result)
    assert result.grasp is not None
    assert (result.grasp.distance > 0.0) == (locked == ("base_yaw",))


@pytest.mark.parametrize(
    ("start", "locked"),
    [
        ((40.0, 0.0, 20.0, 90.0), ("base_yaw",)),
        ((0.0, 90.0, 45.0, 90.0), ()),
        ((40.0, 90.0, 45.0, 90.0), ("base_yaw",)),
    ],
)
def test_no_straight_approach(robot: Robot, start: tuple[float, ...], locked: tuple[str, ...]) -> None:
    """The shoulder is at its limit wherever the tool is at the fruit: the hand comes to it from elsewhere."""
    target = fruit("apple", 40.0, 1.2, 1.5)
    scene = task(start, Goal(fruit="apple"), fruits=(target,), locked_joints=locked)
    result = plan(robot, scene, COARSE)
    assert_sound(robot, scene, result)
    assert result.grasp is not None
    assert result.grasp.distance == 0.0
    assert result.report["grasp"]["standoff_m"] == 0.0


# Unreachable fruit


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        (fruit("apple", 40.0, 3.2, 1.5), "too_far"),
        (fruit("apple", 40.0, 1.4, 0.2), "joint_limit"),
        (fruit("apple", 40.0, 0.1, 0.9), "joint_limit"),
    ],
)
def test_unreachable(robot: Robot, target: Any, reason: str) -> None:
    with pytest.raises(UnreachableError) as caught:
        plan(robot, task(FOLDED, Goal(fruit="apple"), CROWN, fruits=(target,)))
    assert caught.value.reason == reason
    assert caught.value.exit_status == 3


def test_start_at_the_fruit(robot: Robot) -> None:
    """The start touches the fruit to pick: refused like any other collision."""
    start = (40.0, 60.0, 45.0, 20.0)
    point = tuple(robot.tool_positions(np.radians(start)).tolist())
    scene = task(start, Goal(fruit="apple"), fruits=({"name": "apple", "center": point, "radius": 0.04},))
    with pytest.raises(ConfigurationInCollisionError, match=r"start is in collision: .*'apple'"):
        plan(robot, scene)


# Many scenes


#: Scenes of random obstacles without a motion, by their seeds: fruits and paths that are not to be had, and no others.
NONE = dict.fromkeys((3, 6, 9), UnreachableError)


@pytest.mark.parametrize("seed", range(30))
def test_random_scenes(robot: Robot, seed: int) -> None:
    scene = random_scene(seed, robot)
    if seed in NONE:
        with pytest.raises(NONE[seed]):
            plan(robot, scene, COARSE)
        return
    assert_sound(robot, scene, plan(robot, scene, COARSE))


FRUIT = (0.5, 1.3, 1.2)

#: A trunk and two branches before the fruit, and a wire over the way.
BRANCHES = tuple(
    Capsule.model_validate({"name": name, "from": start, "to": end, "radius": radius})
    for name, start, end, radius in (
        ("trunk", (0.9, 1.4, 0.0), (0.9, 1.4, 2.0), 0.05),
        ("left", (0.9, 1.4, 0.9), (0.2, 1.1, 1.0), 0.02),
        ("right", (0.9, 1.4, 1.5), (0.3, 1.2, 1.6), 0.02),
        ("wire", (1.5, 0.4, 1.4), (-1.0, 0.9, 1.7), 0.005),
    )
)


@pytest.fixture(scope="module")
def aside(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    spec = replace(
        ORCHARD_HARVESTER, name="aside", yaw_axis=(0.3, -0.2), shoulder_offset=0.15, link_offsets=(0.06, -0.03, 0.0)
    )
    return load_robot(write_robot(spec, Path(tmp_path_factory.mktemp("arm")) / "aside.urdf")[0])


def scene_to(fruit: tuple[float, float, float]) -> Scene:
    return Scene(
        name="aside",
        start=Start(joints_deg=(-40.0, 70.0, -60.0, 0.0)),
        goal=Goal(fruit="apple"),
        clearance=0.003,
        obstacles=BRANCHES,
        fruits=(Fruit(name="apple", center=fruit, radius=0.035),),
    )


def test_fruit_is_picked_and_nothing_touched(aside: Robot) -> None:
    """By Pinocchio and coal, with the whole URDF, at every other sample."""
    result = plan(aside, scene_to(FRUIT))
    assert result.certificate.verified
    rows, model, data = result.trajectory.position, aside.model, aside.model.createData()
    tool, bodies = model.getFrameId(aside.tool_frame), Bodies(aside)
    away = []
    for q in rows:
        pin.framesForwardKinematics(model, data, q)
        away.append(np.linalg.norm(data.oMf[tool].translation - FRUIT))
    assert min(away) < 1e-6
    branches = []
    for branch in BRANCHES:
        start, end = np.array(branch.start), np.array(branch.end)
        length = np.linalg.norm(end - start)
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (end - start) / length).matrix()
        branches.append((coal.Capsule(branch.radius, length), coal.Transform3s(turn, 0.5 * (start + end))))
    nearest = min(bodies.from_obstacles(q, branches) for q in rows[::2])
    assert 0.003 < nearest < 0.2
    assert nearest >= result.certificate.min_clearance_m
    assert min(bodies.distances(q).min(initial=np.inf) for q in rows[::2]) > 0.0


def test_fruit_at_the_yaw_axis_is_out_of_reach(aside: Robot) -> None:
    with pytest.raises(
        UnreachableError, match=r"closer to the yaw axis than the arm plane, whose distance from the axis is 0\.15 m"
    ):
        plan(aside, scene_to((0.3, -0.15, 1.9)))
