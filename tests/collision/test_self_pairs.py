"""Pairs of bodies: different arms keep the full clearance; within one arm no sample exempts a pair."""

from __future__ import annotations

import itertools

import coal
import numpy as np
import pinocchio as pin
import pytest

from hplan import PlanOptions, check, load_robot, plan, plan_cell
from hplan.certificate.certificate import certify
from hplan.collision.coal_scene import CoalScene
from hplan.collision.collision_bodies import body_shapes, collision_bodies
from hplan.collision.self_pairs import RIGID, required_distances, self_pairs
from hplan.errors import ConfigurationInCollisionError, HplanError, InputError
from hplan.robot.several import joined_robots
from hplan.scene.cell import CellScene
from hplan.scene.model import Goal, Scene, Start
from hplan.trajectory.trajectory import Trajectory
from hplan.workcell.cell import Cell

INERTIA = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="-3" upper="3" velocity="1" effort="500" acceleration="5"/>'


def box(size: str, at: str = "0 0 0") -> str:
    return f'<collision><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></collision>'


def column_arm(at: float, column: str = "0.09 0.09 0.2", base: str = "0.1 0.1 0.2") -> str:
    """A square column that turns on a base, and an arm that is lifted."""
    return (
        f'<robot name="m" version="1.2"><link name="base_link">{box(base)}</link>'
        f'<link name="column">{INERTIA}{box(column)}</link>'
        '<joint name="turn" type="revolute"><parent link="base_link"/><child link="column"/>'
        f'<origin xyz="{at} 0 0"/><axis xyz="0 0 1"/>{LIMIT}</joint>'
        f'<link name="arm">{INERTIA}{box("0.3 0.04 0.04", "0.15 0 0")}</link>'
        '<joint name="lift" type="revolute"><parent link="column"/><child link="arm"/><origin xyz="0 0 0.3"/>'
        f'<axis xyz="0 1 0"/>{LIMIT}</joint><link name="tool0"/>'
        '<joint name="t" type="fixed"><parent link="arm"/><child link="tool0"/><origin xyz="0.3 0 0"/></joint></robot>'
    )


def beside_a_post(gap: float, clearance: float) -> Cell:
    """The column of arm a next to the base of arm b, whose column is 1 m behind."""
    robots = {"a": load_robot(column_arm(0.0)), "b": load_robot(column_arm(-1.0))}
    first = {"name": "a", "start": {"joints_deg": (0, -30)}, "goal": {"joints_deg": (90, -30)}}
    second = {"name": "b", "position": (-(0.045 + gap + 0.05), 0, 0), "start": {"joints_deg": (0, -30)}}
    return Cell.from_robots(CellScene(name="c", clearance=clearance, robots=(first, second)), robots)


@pytest.mark.parametrize(("gap", "clearance"), [(0.010, 0.0), (0.040, 0.06)])
def test_column_next_to_base_of_another_arm(gap, clearance):
    """Its corners come 18.6 mm nearer than its faces: they touch, or come nearer than the clearance."""
    cell = beside_a_post(gap, clearance)
    time = np.linspace(0.0, 4.0, 9)
    turned = time[:, None] * np.array([np.pi / 8, 0.0]) + np.radians([0.0, -30.0])
    nothing = np.zeros_like(turned)
    arm = cell.arm("a").robot
    motion = cell.join_motions({"a": Trajectory(arm.joint_names, time, turned, nothing, nothing, nothing)})
    alone = cell.task(motion.position[-1], motion.position[0], obstacles=False)
    found = certify(cell.robot, alone, motion, check_ends=False)
    true = min(
        coal.distance(
            coal.Box(0.09, 0.09, 0.2), coal.Transform3s(pin.utils.rotate("z", turn), np.zeros(3)),
            coal.Box(0.1, 0.1, 0.2), coal.Transform3s(np.eye(3), np.array([-(0.095 + gap), 0.0, 0.0])),
            coal.DistanceRequest(), coal.DistanceResult(),
        )
        for turn in np.linspace(0.0, np.pi / 2, 1001)
    )  # fmt: skip
    assert true < clearance or true < 0.0
    assert not found.verified
    assert any("link 'column' of arm 'a'" in line and "'base_link' of arm 'b'" in line for line in found.violations)
    assert found.min_clearance_m <= true + 1e-4
    if clearance:
        with pytest.raises(
            ConfigurationInCollisionError, match=r"of arm 'b' is 35 mm from link 'base_link' of arm 'a'"
        ):
            plan_cell(cell, PlanOptions(effort="quick"))


def test_arms_whose_bases_are_too_close_are_refused():
    """Also if no joint moves the bodies: the bases of both arms are a pair."""
    robot = load_robot(column_arm(0.0))
    for apart, clearance, how in ((0.08, 0.0, "20 mm deep"), (0.105, 0.02, "5 mm from")):
        robots = (
            {"name": "a", "start": {"joints_deg": (0, -30)}, "goal": {"joints_deg": (20, -30)}},
            {"name": "b", "position": (0, -apart, 0), "start": {"joints_deg": (0, -30)}},
        )
        cell = Cell.from_robots(CellScene(name="c", clearance=clearance, robots=robots), {"a": robot, "b": robot})
        with pytest.raises(ConfigurationInCollisionError, match="may_touch") as refused:
            plan_cell(cell, PlanOptions(effort="quick"))
        assert how in str(refused.value)
        assert sorted(refused.value.data["arms"]) == ["a", "b"]
        checker = CoalScene(cell.robot, (), clearance=clearance)
        distances = checker.distances(cell.configuration({}))
        (mover,) = (number for number, name in enumerate(checker.mover_names) if name == "b_base_link")
        assert distances[mover, checker.obstacle_names.index("a_base_link")] == pytest.approx(apart - 0.1, abs=1e-6)


def test_no_pair_of_two_arms_is_exempt():
    """UR5 bases 20 mm apart, whose shoulders touch at all configurations."""
    robot = load_robot("ur5")
    places = {"a": pin.SE3.Identity(), "b": pin.SE3(np.eye(3), np.array([-0.02, 0.0, 0.0]))}
    whole = joined_robots({name: (robot, place) for name, place in places.items()})
    bodies, pairs = collision_bodies(whole), self_pairs(whole)
    owners = [whole.owner_of(body.name) for body in bodies]
    assert set(owners) == {"a", "b"}
    assert all(owners[i] == owners[j] for i, j, _ in pairs.allowed)
    between = [number for number, (i, j) in enumerate(pairs.checked) if owners[i] != owners[j]]
    assert len(between) == owners.count("a") * owners.count("b")
    assert (required_distances(pairs.farthest[between], 0.3) == 0.3).all()


def test_declared_pairs_of_two_arms_may_touch():
    """Names are exact: arm `a` with a link `b_base_link` is not arm `a_b`."""
    robot, places = load_robot(column_arm(0.0)), (0.0, 0.08)
    arms = {
        name: (robot, pin.SE3(np.eye(3), np.array([0.0, y, 0.0]))) for name, y in zip(("a", "a_b"), places, strict=True)
    }
    whole = joined_robots(arms, may_touch=[(("a", "base_link"), ("a_b", "base_link"), "on one plate")])
    assert whole.owner_of("a_b_base_link") == "a_b"
    assert whole.owner_of("base_link") is None
    bodies = collision_bodies(whole)
    reasons = [
        why for i, j, why in self_pairs(whole).allowed
        if whole.owner_of(bodies[i].name) != whole.owner_of(bodies[j].name)
    ]  # fmt: skip
    assert reasons == ["may touch: on one plate"]
    for first, second in (
        (("a", "base_link"), ("a_b", "bse_link")),
        (("a", "base_link"), ("c", "base_link")),
        (("a", "base_link"), ("a", "column")),
    ):
        with pytest.raises(InputError, match="may_touch: "):
            joined_robots(arms, may_touch=[(first, second, "by design")])


def wrist(size: float) -> str:
    """Two crossed joints at one point between a box and another, and between them a small ball."""
    # Not quite on the second joint's axis, about which it would be round.
    ball = f'<collision><origin xyz="0.001 0 0"/><geometry><sphere radius="{size}"/></geometry></collision>'
    return (
        f'<robot name="w" version="1.2"><link name="base_link">{box("0.1 0.1 0.1")}</link>'
        f'<link name="cross">{INERTIA}</link><link name="hand">{INERTIA}{ball}{box("0.02 0.02 0.3", "0 0 0.3")}</link>'
        '<joint name="one" type="revolute"><parent link="base_link"/><child link="cross"/><axis xyz="1 0 0"/>'
        f'{LIMIT}</joint><joint name="two" type="revolute"><parent link="cross"/><child link="hand"/>'
        f'<origin xyz="0 0 0.06"/><axis xyz="0 1 0"/>{LIMIT}</joint><link name="tool0"/>'
        '<joint name="t" type="fixed"><parent link="hand"/><child link="tool0"/></joint></robot>'
    )


def test_bodies_that_always_touch_are_exempt_by_proof():
    robot = load_robot(wrist(0.03))
    bodies = collision_bodies(robot)
    reasons = {(bodies[i].kind, bodies[j].kind): why for i, j, why in self_pairs(robot).allowed}
    assert reasons["box", "sphere"] == "they touch at all positions of joints 'one', 'two'"


def test_samples_exempt_no_pair(monkeypatch):
    """A pair in contact at every sample stays checked where bisection does not prove that it always touches."""
    monkeypatch.setattr("hplan.collision.self_pairs._MOST_BOXES", 1)
    robot = load_robot(wrist(0.03))
    bodies, pairs = collision_bodies(robot), self_pairs(robot)
    assert ("box", "sphere") in {(bodies[i].kind, bodies[j].kind) for i, j in pairs.checked}


@pytest.mark.parametrize("clearance", [0.0, 0.01, 0.03])
def test_one_meaning_of_clearance(clearance):
    """A UR5's wrist links are 14.3 mm apart: `min_clearance_m`, `nearest` and `check` agree for any clearance."""
    robot = load_robot("ur5")
    start, goal = Start(joints_deg=(0, -90, 90, 0, 0, 0)), Goal(joints_deg=(60, -90, 90, 0, 0, 0))
    scene = Scene(name="x", robot="ur5", start=start, goal=goal, clearance=clearance)
    result = plan(robot, scene, PlanOptions(effort="quick"))
    found = result.certificate
    assert found.verified
    checker = CoalScene(robot, (), clearance=clearance)
    places = result.trajectory.positions(np.linspace(0.0, result.trajectory.duration, 300))
    true = np.min([checker.pair_distances(q) for q in places], axis=0)
    assert 0.0 < found.min_clearance_m <= true.min() + 1e-9
    assert found.nearest.distance_m >= found.min_clearance_m
    assert check(robot, scene, places).distance_m.min() >= found.min_clearance_m
    own = {(rule.link, rule.other): rule for rule in found.pair_rules if rule.required_m is not None}
    assert bool(own) == (clearance > 0.0)
    for number, (mover, other) in enumerate(checker.pairs):
        rule = own.get((checker.mover_names[mover], checker.obstacle_names[other]))
        # All pairs without a rule of their own keep the clearance; the others keep their own bound.
        assert true[number] > clearance or (rule is not None and true[number] >= rule.clearance_m - 1e-9)
    named = {frozenset((rule.link, rule.other)) for rule in found.pair_rules if rule.required_m is None}
    bodies = collision_bodies(robot)
    for i, j, why in self_pairs(robot).allowed:
        assert why == RIGID or frozenset((bodies[i].name, bodies[j].name)) in named


@pytest.mark.parametrize("clearance", [0.0, 0.06])
def test_planar_arm_lists_the_links_that_its_clearance_does_not_cover(robot, clearance):
    """Far from all obstacles, no two links that are not listed are nearer than the reported clearance."""
    shapes: dict[str, list[pin.GeometryObject]] = {}
    for shape, body in zip(body_shapes(robot), collision_bodies(robot), strict=True):
        shapes.setdefault(body.name, []).append(shape)
    data, rng = robot.model.createData(), np.random.default_rng(4)
    for q in rng.uniform(robot.lower, robot.upper, (6, robot.dof)):
        rows = np.stack([q, q])
        rest = np.zeros_like(rows)
        motion = Trajectory(robot.joint_names, np.array([0.0, 1.0]), rows, rest, rest, rest, robot.slides)
        ends = {"start": {"joints_rad": tuple(q)}, "goal": {"joints_rad": tuple(q)}}
        far = {"kind": "sphere", "name": "far", "center": (5.0, 5.0, 5.0), "radius": 0.1}
        scene = Scene.model_validate({"name": "x", **ends, "obstacles": (far,), "clearance": clearance})
        found = certify(robot, scene, motion)
        listed = {frozenset((rule.link, rule.other)) for rule in found.pair_rules}
        pin.forwardKinematics(robot.model, data, q)
        for (name, some), (other, others) in itertools.combinations(shapes.items(), 2):
            if frozenset((name, other)) not in listed:
                apart = min(distance(data, one, two) for one, two in itertools.product(some, others))
                assert apart >= found.min_clearance_m - 1e-6, (name, other)
        assert listed


def distance(data: pin.Data, one: pin.GeometryObject, other: pin.GeometryObject) -> float:
    """The distance of two shapes by coal [m]."""
    places = [data.oMi[shape.parentJoint] * shape.placement for shape in (one, other)]
    poses = [coal.Transform3s(place.rotation, place.translation) for place in places]
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(one.geometry, poses[0], other.geometry, poses[1], request, result)


def test_cell_refusal_is_typed():
    with pytest.raises(HplanError):
        plan_cell(beside_a_post(-0.01, 0.0), PlanOptions(effort="quick"))
