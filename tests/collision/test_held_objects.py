"""Held objects in the robot's models: shapes, masses, pairs, and errors; plans and certificates with them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from any_arms import loaded_arm

from hplan import PlanOptions, certify, check, load_robot, load_scene, plan
from hplan.apps.view.page import render_page
from hplan.apps.view.playback import Playback
from hplan.certificate.digests import robot_digest
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.held_objects import held_inertia, holding
from hplan.collision.self_pairs import self_pairs
from hplan.errors import ConfigurationInCollisionError, SceneError
from hplan.geometry.coal_hull import convex_hull_shape
from hplan.geometry.shape_outline import coal_distance
from hplan.planning.problem import Problem
from hplan.robot.model import Robot
from hplan.scene import Attached, Box, Capsule, Cylinder, Goal, Mesh, PointCloud, Scene, Sphere, Start
from hplan.scene.file import dump_scene, parse_scene, save_scene

CORNERS = [(0, 0, 0), (0.1, 0, 0), (0, 0.08, 0), (0, 0, 0.12)]
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
CRATE = Box(name="crate", center=(0.02, -0.01, 0.1), size=(0.1, 0.06, 0.12), rpy_deg=(10.0, 20.0, 30.0))
SHAPES = (
    Sphere(name="ball", center=(0.0, 0.0, 0.08), radius=0.05),
    Capsule(name="rod", start=(0.0, -0.1, 0.08), end=(0.0, 0.1, 0.1), radius=0.02),
    Cylinder(name="can", center=(0.0, 0.0, 0.1), length=0.12, radius=0.04, rpy_deg=(40.0, 0.0, 0.0)),
    CRATE,
    Mesh.from_arrays("wedge", CORNERS, FACES, position=(0.0, 0.0, 0.05)),
    PointCloud.from_points("scan", CORNERS, 0.01, position=(0.0, 0.0, 0.05)),
)
QUICK = PlanOptions(effort="quick")


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm("toy", tmp_path_factory)


def task(robot: Robot, **more: Any) -> Scene:
    rng = np.random.default_rng(3)
    middle = 0.5 * (robot.lower + robot.upper)
    ends = [tuple((middle + 0.2 * rng.uniform(-1.0, 1.0, robot.dof)).tolist()) for _ in range(2)]
    return Scene(name="task", start=Start(joints_rad=ends[0]), goal=Goal(joints_rad=ends[1]), **more)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.kind)
def test_bodies_contain_the_object_where_the_frame_is(toy: Robot, shape: Any) -> None:
    loaded = holding(toy, [Attached(object=shape)])
    bodies = [body for body in collision_bodies(loaded) if body.name == shape.name]
    assert bodies
    assert {body.joint for body in bodies} == {toy.tool_joint - 1}
    place = toy.model.frames[toy.frame_number(toy.tool_frame)].placement
    for solid in shape.solids:
        for point in solid.core:
            # A body is the hull of its core, grown: the nearest of its points is within the sum of both radii.
            local = place.act(point)
            reaches = [_distance(body.core, local) <= body.rounding + solid.excess + 1e-9 for body in bodies]
            assert any(reaches)


def _distance(core: np.ndarray, point: np.ndarray) -> float:
    if len(core) == 1:
        return float(np.linalg.norm(core[0] - point))
    shape = convex_hull_shape(core)
    return max(0.0, coal_distance(shape, pin.SE3.Identity(), coal.Sphere(1e-4), pin.SE3(np.eye(3), point)) + 1e-4)


def test_distances_are_those_of_a_shape_moved_with_the_tool(toy: Robot) -> None:
    """The checker among obstacles equals coal with the object placed by forward kinematics."""
    wall = Box(name="wall", center=(0.6, 0.0, 0.3), size=(0.1, 1.0, 1.0))
    scene = task(toy, obstacles=(wall,)).with_attached([Attached(object=CRATE, may_touch=())])
    problem = Problem.from_scene(toy, scene, QUICK)
    checker = problem.world.checker
    row = checker.mover_names.index("crate")
    for q in np.random.default_rng(0).uniform(0.5 * toy.lower, 0.5 * toy.upper, (50, toy.dof)):
        at = pin.SE3(toy.forward_kinematics(q)) * pin.SE3(CRATE.rotation, np.array(CRATE.center))
        there = pin.SE3(np.eye(3), np.array(wall.center))
        exact = coal_distance(coal.Box(*CRATE.size), at, coal.Box(*wall.size), there)
        assert checker.distances(q)[row, 0] == pytest.approx(exact, abs=1e-6)


def test_homogeneous_solids_have_their_inertia() -> None:
    mass = 3.0
    box = held_inertia(Attached(object=Box(name="b", center=(0.1, 0.2, 0.3), size=(0.1, 0.2, 0.3)), mass=mass))
    np.testing.assert_allclose(box.lever, (0.1, 0.2, 0.3), atol=1e-12)
    np.testing.assert_allclose(box.inertia, pin.Inertia.FromBox(mass, 0.1, 0.2, 0.3).inertia, atol=1e-12)
    wedge = held_inertia(Attached(object=SHAPES[4], mass=mass))
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(4), 400_000)  # uniform in a tetrahedron
    points = weights @ (np.array(CORNERS) + np.array([0.0, 0.0, 0.05]))
    away = points - points.mean(axis=0)
    spread = away.T @ away / len(points)
    np.testing.assert_allclose(wedge.lever, points.mean(axis=0), atol=2e-4)
    np.testing.assert_allclose(wedge.inertia, mass * (np.trace(spread) * np.eye(3) - spread), rtol=0.02, atol=1e-4)
    assert wedge.mass == pytest.approx(mass)


def test_torques_are_those_of_a_body_added_to_the_link(toy: Robot) -> None:
    inertia = ((0.02, 0.001, 0.0), (0.001, 0.03, 0.0), (0.0, 0.0, 0.04))
    held = Attached(object=CRATE, frame=toy.tool_frame, mass=4.0, center_of_mass=(0.1, 0.0, 0.2), inertia=inertia)
    loaded, model = holding(toy, [held]), toy.model.copy()
    frame = model.frames[model.getFrameId(toy.tool_frame)]
    body = pin.Inertia(4.0, np.array([0.1, 0.0, 0.2]), np.array(inertia))
    model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    data, rng = model.createData(), np.random.default_rng(0)
    for _ in range(20):
        q, v, a = rng.uniform(-1.0, 1.0, (3, toy.dof))
        expected = pin.rnea(model, data, q, v, a)
        np.testing.assert_allclose(loaded.dynamics.torques(q[None], v[None], a[None])[0], expected, atol=1e-9)


def test_the_same_objects_give_the_same_robot(toy: Robot) -> None:
    held = [Attached(object=CRATE)]
    loaded = holding(toy, held)
    assert holding(toy, [Attached(object=CRATE)]) is loaded
    assert holding(loaded, held) is loaded
    assert holding(loaded, []) is toy
    assert robot_digest(loaded) == robot_digest(toy)


def test_links_may_touch_the_object_only_as_permitted(toy: Robot) -> None:
    """Pairs of links stay as they are; those of the object are checked unless it moves with the link."""
    loaded = holding(toy, [Attached(object=CRATE)])
    bodies, before, after = collision_bodies(loaded), self_pairs(toy), self_pairs(loaded)
    held = next(number for number, body in enumerate(bodies) if body.name == "crate")
    assert [pair for pair in after.checked if held not in pair] == list(before.checked)
    partners = {bodies[i].name for pair in after.checked if held in pair for i in pair if i != held}
    same = {body.name for body in bodies if body.joint == bodies[held].joint}
    assert not partners & same
    chosen = sorted(partners)[0]
    fewer = self_pairs(holding(toy, [Attached(object=CRATE, may_touch=(chosen,))]))
    left = {bodies[i].name for pair in fewer.checked if held in pair for i in pair if i != held}
    assert left == partners - {chosen}


def test_an_object_that_always_touches_a_link_is_refused(toy: Robot) -> None:
    huge = Attached(object=Sphere(name="balloon", center=(0.0, 0.0, 0.0), radius=0.6))
    with pytest.raises(
        ConfigurationInCollisionError, match=r"held object 'balloon'.*name it in the object's may_touch"
    ):
        plan(toy, task(toy).with_attached([huge]), QUICK)


def test_plan_counts_the_object_and_its_mass(toy: Robot) -> None:
    scene = task(toy, clearance=0.002)
    bare = plan(toy, scene, QUICK)
    middle = bare.trajectory.positions(np.array([0.5 * bare.trajectory.duration]))[0]
    tip = toy.forward_kinematics(middle) @ np.array([0.0, 0.0, 0.3, 1.0])
    post = Sphere(name="post", center=tuple(tip[:3].tolist()), radius=0.03)
    scene = scene.with_obstacles([post])
    rod = Attached(object=Capsule(name="rod", start=(0, 0, 0.05), end=(0, 0, 0.3), radius=0.015), mass=2.0)
    held = scene.with_attached([rod])
    empty = plan(toy, scene, QUICK)
    assert not certify(toy, held, empty.trajectory).verified
    found = plan(toy, held, QUICK)
    assert found.certificate.verified
    assert certify(toy, held, found.trajectory).digests == found.certificate.digests
    assert found.certificate.digests != certify(toy, scene, found.trajectory).digests
    assert found.report["certificate"]["payload_kg"] == 2.0
    assert '"rod_0"' in render_page(toy, held, Playback.from_result(found))
    heavy = certify(toy, held.with_attached([rod.with_values(mass=500.0)]), found.trajectory)
    assert any("torque" in message for message in heavy.violations)
    assert check(toy, held, middle).in_contact


def test_planar_arm_plans_with_an_object() -> None:
    robot, scene = load_robot(), load_scene()
    held = scene.with_attached([Attached(object=Box(name="box", center=(0.1, 0, 0), size=(0.2, 0.1, 0.1)), mass=1.0)])
    found = plan(robot, held, QUICK)
    assert found.certificate.verified
    assert (
        not certify(robot, held, plan(robot, scene, QUICK).trajectory).min_clearance_m
        > found.certificate.min_clearance_m
    )


def test_object_that_cannot_touch_a_neighbour_keeps_the_clearance_from_it() -> None:
    """A ball 0.1 m from the wrist's axis is as near to the forearm at all angles of the wrist."""
    robot, scene = load_robot(), load_scene()
    near = Attached(object=Sphere(name="ball", center=(-0.3, 0.0, 0.0), radius=0.02))
    start, goal = Start(joints_deg=(0.0, 20.0, 40.0, 30.0)), Goal(joints_deg=(20.0, 30.0, 40.0, 0.0))
    scene = scene.with_values(start=start, goal=goal, obstacles=(), locked_joints=(), attached=(near,), clearance=0.03)
    certificate = plan(robot, scene).certificate
    assert 0.03 < certificate.min_clearance_m < 0.05
    assert not any("ball" in (rule.link, rule.other) for rule in certificate.pair_rules)


def test_scene_files_keep_held_objects(tmp_path: Any) -> None:
    text = """
name: held
start: {joints_deg: [0, 90, 90, 90]}
goal: {position: [1.2, 0.0, 1.6]}
attached:
  - object: {kind: capsule, name: pole, from: [0, 0, 0], to: [0.3, 0, 0], radius: 0.01}
    frame: tool0
    mass: 0.4
    may_touch: [elbow]
  - object: {kind: sphere, name: pear, center: [0, 0, 0.1], radius: 0.04}
"""
    scene = parse_scene(text)
    assert parse_scene(dump_scene(scene)) == scene
    wedge = Attached(object=SHAPES[4], mass=1.0)
    saved = save_scene(scene.with_attached([*scene.attached, wedge]), tmp_path / "scene.yaml")
    read = load_scene(saved)
    assert [item.name for item in read.attached] == ["pole", "pear", "wedge"]
    np.testing.assert_allclose(read.attached[2].object.solids[0].core, SHAPES[4].solids[0].core)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frame": "toool0"}, "no frame 'toool0'"),
        ({"may_touch": ("hnd",)}, "'hnd' is neither a link nor another held object"),
        ({"object": CRATE.with_values(name="tool0")}, "'tool0' is a frame of the robot"),
    ],
)
def test_names_that_the_robot_does_not_have_are_refused(toy: Robot, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        plan(toy, task(toy).with_attached([Attached(object=CRATE).with_values(**changes)]))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"mass": -1.0}, "mass"),
        ({"center_of_mass": (0.0, 0.0, 0.1)}, "give mass"),
        ({"mass": 1.0, "inertia": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 3.0))}, "none above the sum"),
        ({"object": CRATE.with_values(yields=0.01)}, "no yields"),
        ({"object": CRATE.with_values(sigma=0.01)}, "no sigma"),
    ],
)
def test_values_that_no_held_object_has_are_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        Attached(**{"object": CRATE, **values})


def test_names_are_unique() -> None:
    scene = load_scene()
    taken = CRATE.with_values(name=scene.obstacles[0].name)
    with pytest.raises(SceneError, match="names must differ"):
        scene.with_attached([Attached(object=taken)])
    with pytest.raises(SceneError, match="names must differ"):
        scene.with_attached([Attached(object=CRATE), Attached(object=CRATE)])


def test_robot_with_turned_joints_holds_objects() -> None:
    from toy_urdf import seven_axis_arm

    robot = load_robot(seven_axis_arm())
    endless = replace(robot, continuous=np.ones(robot.dof, dtype=np.bool_))
    turned = endless.about(np.full(robot.dof, 2.0 * np.pi))
    loaded = holding(turned, [Attached(object=CRATE)])
    np.testing.assert_allclose(loaded.lower, turned.lower)
    assert holding(loaded, []) is turned


def test_simulated_arm_carries_the_mass() -> None:
    """MuJoCo's inverse dynamics equals Pinocchio's with the object."""
    mujoco = pytest.importorskip("mujoco")
    from hplan.apps.execution.simulated_arm import SimulatedArm

    robot, scene = load_robot(), load_scene()
    shapes = [CRATE.with_values(center=(0.1, 0.0, 0.05)), SHAPES[4], SHAPES[2]]
    held = [Attached(object=shape, mass=1.0 + number) for number, shape in enumerate(shapes)]
    arm = SimulatedArm(robot, scene.with_attached(held))
    rng, lower, upper = np.random.default_rng(0), robot.lower, robot.upper
    for _ in range(10):
        q, (v, a) = lower + (upper - lower) * rng.uniform(0.3, 0.7, robot.dof), rng.uniform(-1.0, 1.0, (2, robot.dof))
        arm._data.qpos[arm._q_at], arm._data.qvel[arm._v_at], arm._data.qacc[arm._v_at] = q, v, a
        mujoco.mj_inverse(arm._model, arm._data)
        expected = holding(robot, held).dynamics.torques(q[None], v[None], a[None])[0]
        np.testing.assert_allclose(arm._data.qfrc_inverse[arm._v_at], expected, atol=1e-7)


def test_workcell_arm_holds_an_object() -> None:
    """Another arm keeps clear of it, and its mass counts."""
    from hplan import Cell, certify_cell
    from hplan.scene.cell import CellRobot, CellScene

    robot = load_robot()
    pole = Attached(object=Capsule(name="pole", start=(0.1, 0, 0), end=(1.5, 0, 0), radius=0.02), mass=1.0)

    def cell_with(attached: tuple[Attached, ...]) -> Cell:
        start = Start(joints_deg=(90.0, 0.0, 0.0, 0.0))
        left = CellRobot(name="left", robot=robot.name, position=(0, -2.5, 0), start=start, attached=attached)
        away = Start(joints_deg=(0.0, 0.0, 0.0, 0.0))
        right = CellRobot(name="right", robot=robot.name, position=(-0.5, 1.0, 0), start=away)
        return Cell.from_robots(CellScene(name="pair", robots=(left, right)), {"left": robot, "right": robot})

    empty, held = cell_with(()), cell_with((pole,))
    assert certify_cell(empty, empty.join_motions({})).verified
    found = certify_cell(held, held.join_motions({}))
    assert not found.between.verified
    assert "held object 'pole'" in found.between.violations[0]
    assert held.arm("left").robot.attached == (pole,)
    assert [item.frame for item in held.robot.attached] == ["left_tool0"]
    with pytest.raises(SceneError, match="names must differ"):
        cell_with((pole, pole))
