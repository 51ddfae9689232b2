"""Fruit and points as goals of general (non-planar) arms: certified, with a straight approach along the tool."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from any_arms import FRUITS, TRUNK, loaded_arm

import hplan
import hplan.errors as errors
from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import certify
from hplan.collision.coal_cloud import obstacle_shape
from hplan.collision.collision_bodies import body_shapes
from hplan.online.planner import Planner
from hplan.planning.grasps import Target, tool_thickness
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.planning.world import World
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere

QUICK = PlanOptions(effort="quick")
STARTS = {
    "picker": (0.0, 0.2, 1.2, -0.8, 0.0, 0.0),
    "seven": (0.0, 0.3, 0.0, 1.4, 0.0, -1.0, 0.0),
    "panda": (0.0, -0.5, 0.0, -2.2, 0.0, 1.9, 0.78),
}


@pytest.fixture(params=["picker", "seven", "panda"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm(request.param, tmp_path_factory)


def start_of(robot: Robot) -> tuple[float, ...]:
    return STARTS[{"six_axes": "picker", "seven_axes": "seven"}.get(robot.name, "panda")]


def scene_of(robot: Robot, goal: Goal, **more: Any) -> Scene:
    parts = {"obstacles": (TRUNK,), "fruits": FRUITS, **more}
    return Scene(name="x", start=Start(joints_rad=start_of(robot)), goal=goal, **parts)


def touched(found: PlanResult) -> dict[tuple[str, str], FloatArray]:
    """Pairs of bodies and solids that coal sees in contact at each millisecond, and when [s]."""
    robot, seen = found.robot, dict[tuple[str, str], list[float]]()
    shapes, data = body_shapes(robot), robot.model.createData()
    solids = [(solid.name, obstacle_shape(solid)) for solid in found.scene.solids_with_goal]
    for t in np.arange(0.0, found.trajectory.duration, 1e-3):
        pin.forwardKinematics(robot.model, data, found.trajectory.positions(np.array([t]))[0])
        for shape in shapes:
            if shape.parentJoint == 0:
                continue
            place = data.oMi[shape.parentJoint] * shape.placement
            at = coal.Transform3s(place.rotation, place.translation)
            for name, solid in solids:
                there = coal.Transform3s(solid.placement.rotation, solid.placement.translation)
                request, result = coal.CollisionRequest(), coal.CollisionResult()
                if coal.collide(shape.geometry, at, solid.geometry, there, request, result):
                    seen.setdefault((shape.name.split(":")[0], name), []).append(float(t))
    return {pair: np.array(times) for pair, times in seen.items()}


def test_fruit_is_picked_along_tool_axis(arm: Robot) -> None:
    scene = scene_of(arm, Goal(fruit="apple 0"))
    found = plan(arm, scene, QUICK)
    assert [phase.name for phase in found.phases] == ["transit", "approach", "retreat"]
    assert found.certificate.verified
    assert found.grasp is not None
    assert found.grasp.distance == pytest.approx(0.1)
    again = certify(arm, scene, found.trajectory)
    assert again.verified
    assert again.goal_contact == "approach"
    begin, end = (found.phases[1].start_s, found.phases[1].end_s)
    poses = arm.forward_kinematics(found.trajectory.positions(np.linspace(begin, end, 60)))
    assert np.abs(poses[-1, :3, 3] - FRUITS[0].center).max() < 1e-6
    axis, away = poses[-1, :3, 2], poses[:, :3, 3] - poses[-1, :3, 3]
    assert np.linalg.norm(away - (away @ axis)[:, None] * axis, axis=1).max() < 5e-4
    assert found.trajectory.position[0] == pytest.approx(start_of(arm), abs=1e-9)


def test_only_the_tool_touches_the_fruit_and_only_on_the_approach(picker: Robot) -> None:
    found = plan(picker, scene_of(picker, Goal(fruit="apple 1")), QUICK)
    pairs = touched(found)
    assert pairs.keys() <= {("wrist_3_link", "apple 1"), ("picker", "apple 1")}
    assert ("picker", "apple 1") in pairs
    assert found.certificate.contact_s is not None
    begin, end = found.certificate.contact_s
    assert all(begin <= times.min() and times.max() <= end for times in pairs.values())


@pytest.mark.parametrize("asked", [None, (-20.0, 20.0), -90.0])
def test_position_is_reached_with_any_orientation_or_requested_angle(picker: Robot, asked: Any) -> None:
    scene = scene_of(picker, Goal(position=(0.45, -0.35, 0.4), approach_deg=asked))
    found = plan(picker, scene, QUICK)
    assert found.certificate.verified
    assert certify(picker, scene, found.trajectory).verified
    assert found.trajectory.position[-1] == pytest.approx(found.grasp.goal if found.grasp else 0.0, abs=1e-9)
    assert picker.tool_positions(found.trajectory.position[-1]) == pytest.approx((0.45, -0.35, 0.4), abs=1e-6)
    if asked is not None:
        low, high = np.atleast_1d(asked)[[0, -1]]
        assert low - 1e-3 <= found.report["grasp"]["approach_deg"] <= high + 1e-3


def test_motion_at_another_angle_is_rejected(picker: Robot) -> None:
    found = plan(picker, scene_of(picker, Goal(position=(0.45, -0.35, 0.4), approach_deg=(-20.0, 20.0))), QUICK)
    other = scene_of(picker, Goal(position=(0.45, -0.35, 0.4), approach_deg=(40.0, 60.0)))
    certificate = certify(picker, other, found.trajectory)
    assert not certificate.verified
    assert any("the tool is at" in line for line in certificate.violations)


def test_where_no_approach_is_clear_the_motion_itself_leads_to_the_fruit(picker: Robot) -> None:
    found = plan(picker, scene_of(picker, Goal(fruit="apple 0")), PlanOptions(effort="quick", standoff=0.0))
    assert found.certificate.verified
    assert found.grasp is not None
    least = 0.035 + tool_thickness(picker, 0.0)
    assert least < found.grasp.distance < least + 3e-3


def test_unreachable_and_blocked_goals_are_distinguished(picker: Robot) -> None:
    with pytest.raises(errors.UnreachableError, match="beyond the reach of the stretched arm"):
        plan(picker, scene_of(picker, Goal(position=(5.0, 0.0, 0.5))))
    crate = Sphere(name="crate", center=(0.45, -0.35, 0.4), radius=0.08)
    with pytest.raises(errors.BlockedError, match="crate") as caught:
        plan(picker, scene_of(picker, Goal(position=(0.45, -0.35, 0.4)), obstacles=(crate,)))
    assert caught.value.best_clearance_m is not None
    assert caught.value.best_clearance_m < 0.0
    crate = crate.model_copy(update={"center": FRUITS[0].center, "radius": 0.05})
    found = hplan.reachable(picker, scene_of(picker, Goal(fruit="apple 0"), obstacles=(crate,)))
    assert {one.fruit: one.reason for one in found.values()} == {"apple 0": "blocked", "apple 1": None, "apple 2": None}


def test_tool_length_is_measured(picker: Robot) -> None:
    assert tool_thickness(picker, 0.0) == pytest.approx(0.0, abs=1e-9)
    world = World.build(picker, [])
    wide = Target.of_fruit(
        world, FRUITS[0], scene_of(picker, Goal(fruit=FRUITS[0].name)), hplan.PlanOptions()
    ).least_standoff
    assert wide == pytest.approx(0.035 + 2e-3)
    # A box on the flange that ends 2 cm beyond the tool frame.
    text = picker.urdf_text or picker.urdf_path.read_text()
    box = '<collision><origin xyz="0 0 0.165"/><geometry><box size="0.02 0.02 0.01"/></geometry></collision></link>'
    name = '<link name="picker">'
    longer = text.replace(name, name + box.replace("</link>", ""))
    robot = load_robot(longer, limits=picker.urdf_path.with_suffix(".limits.yaml"))
    assert tool_thickness(robot, 0.0) == pytest.approx(0.02, abs=1e-9)
    assert tool_thickness(robot, 0.01) > 0.02


@pytest.mark.parametrize("frame", [None, "wrist_2_link"])
def test_pose_has_approach_if_standoff_is_requested(picker: Robot, frame: str | None) -> None:
    q = np.array([-0.5, 0.9, 0.9, 0.3, 0.4, 0.2])
    pose = picker.forward_kinematics(q, frame)
    turn = pin.Quaternion(pose[:3, :3]).coeffs().tolist()
    goal = Goal(position=tuple(pose[:3, 3].tolist()), quaternion_xyzw=tuple(turn), frame=frame)
    scene = scene_of(picker, goal, fruits=())
    assert [phase.name for phase in plan(picker, scene, QUICK).phases] == ["transit"]
    found = plan(picker, scene, PlanOptions(effort="quick", standoff=0.06))
    assert [phase.name for phase in found.phases] == ["transit", "approach"]
    assert certify(picker, scene, found.trajectory).verified
    times = np.linspace(found.phases[1].start_s, found.phases[1].end_s, 40)
    poses = picker.forward_kinematics(found.trajectory.positions(times))
    away = poses[:, :3, 3] - poses[-1, :3, 3]
    assert np.linalg.norm(away[0]) == pytest.approx(0.06, abs=2e-3)
    assert np.abs(poses[:, :3, :3] - poses[-1, :3, :3]).max() < 2e-3
    assert np.abs(away - (away @ poses[-1, :3, 2])[:, None] * poses[-1, :3, 2]).max() < 3e-4


def test_planner_goes_to_another_fruit_while_the_arm_moves(picker: Robot) -> None:
    planner = Planner(picker, scene_of(picker, Goal(fruit="apple 0")), QUICK)
    first = planner.plan()
    planner.add(Sphere(name="ball", center=(0.1, 0.5, 0.9), radius=0.05))
    assert planner.replan().certificate.verified
    planner.aim(goal=Goal(fruit="apple 1"))
    at = 0.4 * first.phases[0].end_s
    spliced = planner.replan(at=at)
    assert spliced.certificate.verified
    assert spliced.trajectory.position[-1] != pytest.approx(first.trajectory.position[-1])
    tool = picker.tool_positions(spliced.trajectory.position)
    assert np.linalg.norm(tool - FRUITS[1].center, axis=1).min() < 1e-3
