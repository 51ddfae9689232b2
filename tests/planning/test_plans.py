"""A motion to one of several grasps: all are tried before planning fails.

Grasps with little room are included.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_variants import load_variant
from planned import assert_sound, between_rows, frame_about_upper_arm, posed, task

from hplan.collision.coal_scene import CoalScene
from hplan.errors import BlockedError, CertificationError, NoPathError, NotFoundError, TimingError
from hplan.planar.family_reader import family_of
from hplan.planar.inverse_kinematics import reach
from hplan.planning.failures import FailuresError
from hplan.planning.grasps import COUNT, ROOMS, SPARE, Grasp, Target, grasps, select_promising
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.problem import merge_problems
from hplan.planning.solver import best_motion, prove_each_goal
from hplan.planning.specialist import goal_sampler_of
from hplan.planning.world import World
from hplan.robot.model import Robot, load_robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Capsule, Sphere
from hplan.tour.tour import plan_tour

COARSE = PlanOptions(step_deg=2.0)


def to_apple(start_rad: Any, center: Any, *obstacles: Any, locked: tuple[str, ...] = ()) -> Scene:
    return Scene(
        name="apple",
        start=Start(joints_rad=start_rad),
        goal=Goal(fruit="apple"),
        locked_joints=locked,
        obstacles=obstacles,
        fruits=(Fruit(name="apple", center=center, radius=0.03),),
    )


def bar(name: str, start: Any, end: Any, radius: float) -> Capsule:
    return Capsule(name=name, start=start, end=end, radius=radius)


#: One thin branch, and of 35 grasps a single one, not among the likely, is not cut off by it.
BRANCH = to_apple(
    (-0.622813, 1.570796, 1.570796, 1.570796),
    (0.435, -0.312, 2.259),
    bar("branch", (0.001, 0.069, 1.859), (0.242, -0.718, 2.732), 0.012),
)

#: The tool reaches the fruit only at angles between the evenly spaced configurations.
TIGHT = {
    "turning": to_apple(
        (0.0, 1.570796, 1.570796, 1.570796),
        (-0.7663, 0.0, 2.4537),
        bar("a", (-0.6244, 0.2383, 1.7301), (-1.4403, -0.4223, 2.3114), 0.0395),
        bar("b", (-0.7307, 0.1581, 1.8258), (-0.6508, -0.4493, 2.8576), 0.0481),
        bar("c", (0.0422, -0.3101, 2.24), (-0.747, 0.3807, 1.657), 0.047),
    ),
    "base locked": to_apple(
        (0.0, 0.782105, 0.265473, 1.483496),
        (0.373, 0.0, 2.594),
        Sphere(name="a", center=(0.65, -0.1, 2.344), radius=0.087),
        Sphere(name="b", center=(0.463, 0.061, 2.3), radius=0.089),
        locked=("base_yaw",),
    ),
}


def grasps_of(robot: Robot, scene: Scene) -> tuple[tuple[Grasp, ...], list[Grasp]]:
    """All grasps of the goal's fruit, and the likely ones."""
    world, start = World.of_scene(robot, scene, COARSE), scene.start.configuration
    fruit = next(fruit for fruit in scene.fruits if fruit.name == scene.goal.fruit)
    target = Target.of_fruit(world, fruit, scene, COARSE)
    found = grasps(target, start, standoff=0.1, locked=scene.locked_joints)
    return found, select_promising(found, target, start)


def test_all_grasps_are_tried(robot: Robot) -> None:
    ways, likely = grasps_of(robot, BRANCH)
    assert len(likely) < len(ways)
    result = plan(robot, BRANCH, COARSE)
    assert_sound(robot, BRANCH, result)
    assert result.grasp is not None
    assert not any(np.array_equal(result.grasp.goal, grasp.goal) for grasp in likely)


@pytest.mark.parametrize("name", TIGHT)
def test_finer_angles_before_blocked(robot: Robot, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = TIGHT[name]
    found = plan(robot, scene, COARSE)
    assert_sound(robot, scene, found)
    coarse = replace(goal_sampler_of(robot), more=COUNT)
    monkeypatch.setattr("hplan.planning.grasps.goal_sampler_of", lambda _: coarse)
    least = 0.0
    with suppress(BlockedError):
        least = min(grasp.room for grasp in grasps_of(robot, scene)[0])
    assert found.grasp is not None
    assert found.grasp.room > least


def test_blocked_error_reports_attempts_and_depth(robot: Robot) -> None:
    """No configuration has the reported best clearance, however fine the spacing."""
    scene = TIGHT["base locked"]
    tight = scene.with_obstacles(
        [
            ball.model_copy(update={"radius": ball.radius + 0.002})
            for ball in scene.obstacles
            if isinstance(ball, Sphere)
        ]
    )
    with pytest.raises(BlockedError) as caught:
        plan(robot, tight, COARSE)
    error = caught.value
    assert error.refined > 0
    assert f"so do {error.refined} at finer approach angles" in error.message
    near = World.of_scene(robot, tight, COARSE).allow_touch("apple")
    start = tight.start.configuration
    fine = reach(robot, tight.fruits[0].center, count=4000, start=start, locked=tight.locked_joints).configurations
    best = max(near.field.spare_clearance(q) for q in fine)
    assert error.best_clearance_m is not None
    assert best - 1e-3 <= error.best_clearance_m <= min(best + 1e-4, SPARE)


def test_no_path_error_covers_all_grasps(robot: Robot) -> None:
    fruit = {"name": "apple", "center": (-0.6, 0.6, 1.6), "radius": 0.04}
    scene = task((0.0, 70.0, 20.0, 20.0), Goal(fruit="apple"), frame_about_upper_arm(0.0, 70.0), fruits=(fruit,))
    ways, likely = grasps_of(robot, scene)
    assert len(ways) > len(likely) > 1
    with pytest.raises(NoPathError) as caught:
        plan(robot, scene, PlanOptions(step_deg=3.0))
    error = caught.value
    assert error.goals == len(ways) == error.data["goals"]
    assert f"to any of {len(ways)} grasps of fruit 'apple'" in error.message
    assert {wall["obstacle"] for wall in error.blockers} <= {f"bar {i}" for i in range(4)}
    assert error.blockers


def test_error_of_several_goals() -> None:
    none, doubt = NoPathError("no path exists on the grid: here", reached_cells=7), CertificationError("doubt")
    late = TimingError("late", joint="elbow", cause="torque")
    assert FailuresError((doubt,)).as_one() is doubt
    assert isinstance(FailuresError((none, none)).as_one(), NoPathError)
    for errors, kind in (
        ((none, doubt), CertificationError),
        ((doubt, none, none), CertificationError),
        ((late, doubt), CertificationError),
        ((none, late), TimingError),
    ):
        assert type(FailuresError(errors).as_one()) is kind
    assert "3 goals: 2 x no path exists on the grid; 1 x doubt" in str(FailuresError((doubt, none, none)).as_one())
    missed = NotFoundError(["trees"])
    left_open = FailuresError((none, missed, none)).as_one()
    assert type(left_open) is NotFoundError
    assert (left_open.tried, left_open.data["goals"]) == (["trees"], 3)
    assert type(FailuresError((doubt, missed)).as_one()) is CertificationError


# Goals decided together


def test_no_path_to_any_in_a_pocket(robot: Robot) -> None:
    bars = frame_about_upper_arm(60.0, 20.0)
    scenes = [task((0.0, 70.0, 20.0, 20.0), (60.0, 20.0, wrist, 20.0), bars) for wrist in (20.0, 30.0, 40.0, 50.0)]
    tasks = [posed(robot, scene, PlanOptions(step_deg=3.0)) for scene in scenes]
    errors = prove_each_goal(merge_problems(tasks))
    assert all(isinstance(error, NoPathError) for error in errors)
    with pytest.raises(NoPathError) as caught:
        best_motion(merge_problems(tasks))
    assert caught.value.goals == 4
    # The errors of the first fruit alone and among others agree; a fruit outside is reached in any case.
    with pytest.raises(NoPathError) as alone:
        best_motion(tasks[0])
    assert caught.value.reached_cells == alone.value.reached_cells > 0
    assert caught.value.blockers == alone.value.blockers != ()
    outside = posed(robot, task((0.0, 70.0, 20.0, 20.0), (20.0, 60.0, 30.0, 20.0), bars), PlanOptions(step_deg=3.0))
    assert prove_each_goal(merge_problems([*tasks, outside]))[4] is None
    number, motion = best_motion(merge_problems([*tasks, outside]))
    assert number == 4
    assert motion.certificate.verified


# Stand-off, approach and transit


@pytest.mark.parametrize("clearance", [0.0, 0.005, 0.02])
def test_least_standoff_keeps_the_clearance(robot: Robot, clearance: float) -> None:
    """A short approach is lengthened as required, not omitted."""
    scene = task(
        (10.0, 80.0, 80.0, 80.0), Goal(fruit="apple"), clearance=clearance,
        fruits=({"name": "apple", "center": (1.0, 0.8, 1.6), "radius": 0.04},),
    )  # fmt: skip
    result = plan(robot, scene, PlanOptions(standoff=0.0))
    assert_sound(robot, scene, result)
    assert result.grasp is not None
    least = 0.04 + float(family_of(robot).arm.half_widths[-1]) + clearance
    assert least < result.grasp.distance < least + 0.005
    spare = CoalScene(robot, scene.solids_with_goal).distances(result.grasp.standoff).min()
    assert clearance < spare < clearance + 0.005


def test_approach_with_a_locked_joint_among_more_than_three(tmp_path: Path) -> None:
    robot = load_variant("five links on a yaw", tmp_path)
    there = np.array([0.3, 0.5, 0.4, -0.6, 0.5, 0.4])
    start = there + np.array([0.2, 0.2, 0.0, 0.0, 0.2, 0.2])
    fruit = {"name": "apple", "center": tuple(robot.tool_positions(there).tolist()), "radius": 0.03}
    scene = Scene(
        name="locked", start=Start(joints_rad=tuple(start.tolist())), goal=Goal(fruit="apple"),
        fruits=(fruit,), locked_joints=("j1", "j2"),
    )  # fmt: skip
    result = plan(robot, scene, PlanOptions(step_deg=10.0))
    assert result.certificate.verified
    assert result.grasp is not None
    assert result.grasp.distance > 0.0
    assert [phase.name for phase in result.phases] == ["transit", "approach", "retreat"]
    held = [robot.joint_names.index(name) for name in scene.locked_joints]
    np.testing.assert_allclose(
        result.trajectory.position[:, held], np.tile(start[held], (result.trajectory.samples, 1))
    )


@pytest.mark.parametrize(
    ("there", "start"),
    [
        ((20.0, 49.017, 34.935, 53.6), (-4.0, 85.0, 33.0, 9.0)),
        ((20.0, 60.617, 53.394, 67.921), (54.0, 67.0, 77.0, 22.0)),
        ((20.0, 26.368, 56.306, 34.004), (-5.0, 78.0, 51.0, 44.0)),
    ],
)
def test_no_link_touches_the_fruit_before_the_approach(robot: Robot, there: Any, start: Any) -> None:
    """The shortest transits to the stand-off pass through the fruit.

    In a plan and in a tour.
    """
    point = tuple(robot.tool_positions(np.radians(there)).tolist())
    scene = task(start, Goal(fruit="apple"), fruits=({"name": "apple", "center": point, "radius": 0.04},))
    checker = CoalScene(robot, scene.solids_with_goal)
    planned = plan(robot, scene, PlanOptions(rate_hz=100.0))
    toured = plan_tour(robot, scene, PlanOptions(rate_hz=100.0))
    for trajectory, phases in ((planned.trajectory, planned.phases), (toured.trajectory, toured.legs[0].phases)):
        assert [phase.name for phase in phases] == ["transit", "approach", "retreat"]
        rows = np.flatnonzero(trajectory.time <= phases[0].end_s + 1e-9)
        assert min(checker.distances(q).min() for q in between_rows(trajectory, rows)) > 0.0


#: Thickness of the obstacles next to the last link [m].
THICK = 0.01

APPLE = Fruit(name="apple", center=(1.1, 0.6, 1.3), radius=0.035)
TUCKED = {"harvester": (0.0, 90.0, 90.0, 90.0), "orchard_harvester": (0.0, 110.0, -140.0, 60.0)}


def scene(robot: Robot, approach_deg: float, *obstacles: Capsule | Sphere) -> Scene:
    """The apple at one approach angle."""
    return Scene(
        name="tight",
        start=Start(joints_deg=TUCKED[robot.name]),
        goal=Goal(fruit="apple", approach_deg=approach_deg),
        obstacles=obstacles,
        fruits=(APPLE,),
    )


def slot(robot: Robot, approach_deg: float, room: float) -> Scene:
    """Two wires across the arm plane, above and below the last link at the fruit."""
    yaw, angle = math.atan2(APPLE.center[1], APPLE.center[0]), math.radians(approach_deg)
    _, (outward, upward, normal) = family_of(robot).plane_at(yaw)
    along = math.cos(angle) * outward + math.sin(angle) * upward
    across = math.cos(angle) * upward - math.sin(angle) * outward
    wires = []
    for side in (-1.0, 1.0):
        aside = side * (float(family_of(robot).arm.half_widths[-1]) + room + THICK)
        middle = np.array(APPLE.center) - 0.03 * along + aside * across
        ends = {"from": tuple((middle - 0.5 * normal).tolist()), "to": tuple((middle + 0.5 * normal).tolist())}
        wires.append(Capsule.model_validate({"name": f"wire {side:+g}", "radius": THICK, **ends}))
    return scene(robot, approach_deg, *wires)


@pytest.fixture(scope="module")
def orchard_arm() -> Robot:
    return load_robot("orchard_harvester")


@pytest.mark.parametrize(("approach_deg", "room"), [(-20.0, 1e-4), (35.0, 1e-4), (-20.0, 3e-4), (35.0, 6e-4)])
def test_slot_with_little_room_is_entered(orchard_arm: Robot, room: float, approach_deg: float) -> None:
    """Straight and certified; the grasp reports its room."""
    posed = slot(orchard_arm, approach_deg, room)
    found = plan(orchard_arm, posed)
    assert_sound(orchard_arm, posed, found)
    assert [phase.name for phase in found.phases] == ["transit", "approach", "retreat"]
    assert found.grasp is not None
    assert found.grasp.room == pytest.approx(room, abs=1e-6)


def test_slot_with_less_is_refused_with_the_room_there_is(orchard_arm: Robot) -> None:
    room = 0.5 * ROOMS[-1]
    with pytest.raises(
        BlockedError, match=r"best of them has a spare clearance of 0\.025 mm.*0\.05 mm are required"
    ) as no:
        plan(orchard_arm, slot(orchard_arm, 35.0, room))
    assert no.value.best_clearance_m == pytest.approx(room, abs=1e-6)
    assert no.value.needed_clearance_m == ROOMS[-1]


def test_standoff_with_small_clearance_beats_no_standoff(orchard_arm: Robot) -> None:
    """A ball is behind the wrist at the stand-off.

    The fruit is touched during the approach only, not during the whole motion.
    """
    free, room = scene(orchard_arm, 10.0), 3e-4
    options = PlanOptions(standoff=0.0)  # the shortest approach alone
    target = Target.of_fruit(World.of_scene(orchard_arm, free, options), APPLE, free, options)
    grasp = grasps(target, free.start.configuration, standoff=0.0)[0]
    origin, axes = family_of(orchard_arm).plane_at(grasp.standoff[0])
    elbow, wrist, tool = origin + family_of(orchard_arm).arm.joint_points(grasp.standoff[1:])[-3:] @ axes[:2]
    back = sum((wrist - end) / np.linalg.norm(wrist - end) for end in (elbow, tool))
    center = wrist + (float(family_of(orchard_arm).arm.half_widths[1]) + THICK + room) * back / np.linalg.norm(back)
    posed = scene(orchard_arm, 10.0, Sphere(name="ball", center=tuple(center.tolist()), radius=THICK))
    found = plan(orchard_arm, posed, options)
    assert_sound(orchard_arm, posed, found)
    assert [phase.name for phase in found.phases] == ["transit", "approach", "retreat"]
    assert found.grasp is not None
    assert found.grasp.room == pytest.approx(room, abs=1e-6)
