"""Loads on limbs: bounds beside the forces that coal's contacts and beam theory give, and combined contacts."""

from __future__ import annotations

import math
from itertools import product
from types import SimpleNamespace
from typing import Any, cast

import coal
import numpy as np
import pinocchio as pin
import pytest
from limb_reference import mutual_compliance

import hplan
from hplan.base.arrays import FloatArray, IntArray
from hplan.certificate import goal_displacement as goal_displacement_module
from hplan.certificate.goal_displacement import (
    Grasp,
    capture_violations,
    contacts_to_slow,
    displacement_at,
    goal_displacement,
)
from hplan.certificate.limb_loads import (
    gentle_speeds,
    load_violations,
    shared_limb_violations,
)
from hplan.certificate.segment_contacts import CONTACT, SegmentContacts
from hplan.collision.coal_arm import arm_parts
from hplan.collision.compliant_solids import pushing_links
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene import Capsule, Scene, Wood, load_scene, with_limbs
from hplan.scene.hanging_point import HangingPoint
from hplan.scene.limb_contacts import limbs_of
from hplan.scene.limbs import Limbs
from hplan.scene.obstacle_kind import ContactLimit

#: Fruits that no quick search finds a motion to without pushing limbs.
PUSHING = ("fruit 16", "fruit 36")

LIMIT = ContactLimit(0.02, 6.0, 1e7, 3, 2, (0.1, 0.2), 4.0, 6e6, 0.0, 500.0, 10.0, 3e7, None, 0.0, 0.02, 0.0, 0.0)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return hplan.load_robot("harvester")


@pytest.fixture(scope="module")
def orchard() -> Scene:
    return with_limbs(load_scene("dense-canopy"))


@pytest.fixture(scope="module")
def plans(robot: Robot, orchard: Scene) -> list[PlanResult]:
    """Motions to fruit that push limbs and other fruit."""
    quick = hplan.PlanOptions(effort="quick")
    found = [hplan.plan(robot, orchard.with_values(goal=hplan.scene.Goal(fruit=fruit)), quick) for fruit in PUSHING]
    return [result for result in found if any(push.force_n for push in result.certificate.pushes or ())]


def seen_forces(robot: Robot, scene: Scene, result: PlanResult, count: int = 150) -> dict[tuple[str, str], float]:
    """Largest force of each link on each limb, from coal's depth and normal and the compliance there [N]."""
    assert scene.wood is not None
    limbs, model = limbs_of(scene.obstacles, scene.wood), robot.model
    data, names = model.createData(), pushing_links(robot, scene.yield_links)
    shapes = [(name, shape) for name, own in arm_parts(robot, 0.0, 0.0).links.items() for shape in own if name in names]
    found: dict[tuple[str, str], float] = {}
    for q in result.trajectory.positions(np.linspace(0.0, result.trajectory.duration, count)):
        pin.forwardKinematics(model, data, q)
        for (name, shape), number in product(shapes, np.flatnonzero(~limbs.clamped).tolist()):
            place = data.oMi[shape.parentJoint] * shape.placement
            force = contact_force(limbs, number, shape.geometry, place, scene.wood.stiffest)
            if force > 0.0:
                key = name, limbs.names[number]
                found[key] = max(found.get(key, 0.0), force)
    return found


def contact_force(
    limbs: Limbs, number: int, geometry: coal.CollisionGeometry, place: pin.SE3, youngs_modulus: float
) -> float:
    """Force that takes a limb out of a shape along coal's normal [N]; 0 without a contact."""
    axis, length = limbs.axis[number], float(limbs.length[number])
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).toRotationMatrix()
    there = coal.Transform3s(turn, 0.5 * (limbs.start + limbs.end)[number])
    result = coal.DistanceResult()
    solid = coal.Capsule(float(limbs.radius[number]), length)
    depth = -coal.distance(
        geometry, coal.Transform3s(place.rotation, place.translation), solid, there, coal.DistanceRequest(), result
    )
    if depth <= 0.0:
        return 0.0
    normal, point = np.array(result.normal), np.array(result.getNearestPoint2())
    along = float(np.clip((point - limbs.start[number]) @ axis, 0.0, length))
    compliance = limbs.compliance(number, along / length, youngs_modulus)[:3, :3]
    return depth / float(normal @ compliance @ normal)


def test_forces_are_below_their_bounds(robot: Robot, orchard: Scene, plans: list[PlanResult]) -> None:
    assert len(plans) >= 2
    assert orchard.wood is not None
    seen = 0
    for result in plans:
        scene = result.scene
        bounds: dict[tuple[str, str], float] = {}
        for push in result.certificate.pushes or ():
            if push.force_n is not None:
                key = push.link, push.obstacle
                bounds[key] = max(bounds.get(key, 0.0), push.force_n)
        assert result.certificate.verified
        assert max(bounds.values(), default=0.0) <= orchard.wood.contact_force
        forces = seen_forces(robot, scene, result)
        for key, force in forces.items():
            assert force <= bounds[key]
        seen += len(forces)
    assert seen >= 2


def test_certificate_of_the_file_is_that_of_the_plan(robot: Robot, plans: list[PlanResult]) -> None:
    result = plans[0]
    goal_contact = result.certificate.goal_contact
    assert goal_contact is not None
    again = hplan.certify(robot, result.scene, result.trajectory, goal_contact=goal_contact)
    assert again.verified
    assert result.report["certificate"]["wood"]["contact_force"] == 10.0


def test_depths_in_whole_fruit_are_below_their_bounds(robot: Robot, plans: list[PlanResult]) -> None:
    result = plans[-1]
    contacts = result.certificate.pushes_by_segment
    fruits = {fruit.name: fruit for fruit in result.scene.fruits}
    links, model, data = arm_parts(robot, 0.0, 0.0).links, robot.model, robot.model.createData()
    seen = extended = 0
    for number, push in enumerate(contacts.rows):
        if push["limit"] < 0 or contacts.obstacle(number) not in fruits:
            continue
        fruit, deepest = fruits[contacts.obstacle(number)], 0.0
        for q in result.trajectory.positions(np.linspace(push["begin_s"], push["end_s"], 5)):
            pin.forwardKinematics(model, data, q)
            for shape in links[contacts.link(number)]:
                place = data.oMi[shape.parentJoint] * shape.placement
                at = coal.Transform3s(place.rotation, place.translation)
                ball, there = coal.Sphere(fruit.radius), coal.Transform3s(np.eye(3), np.array(fruit.center))
                request, found = coal.DistanceRequest(), coal.DistanceResult()
                deepest = max(deepest, -coal.distance(shape.geometry, at, ball, there, request, found))
        assert deepest <= push["whole_depth"] + 1e-9
        assert push["whole_depth"] <= push["depth"] + 2e-3
        seen += deepest > 0.0
        extended += push["whole_depth"] < 0.8 * push["depth"]
    assert seen >= 5
    assert extended >= 5


def test_nothing_pushes_the_goal_fruit(orchard: Scene, plans: list[PlanResult]) -> None:
    for result in plans:
        goal = result.scene.goal.fruit
        assert goal not in {push.obstacle for push in result.certificate.pushes or ()}
    one, other = (orchard.with_values(goal=hplan.scene.Goal(fruit=fruit)) for fruit in PUSHING)
    rigid, soft = ([solid for solid in scene.solids_with_goal if solid.name == PUSHING[0]] for scene in (one, other))
    assert [(solid.meets, solid.yields) for solid in rigid] == [("all", 0.0)]
    assert {solid.meets for solid in soft} == {"others", "pushing"}
    assert [s for s in one.without_goal_fruit.solids_with_goal if s.name == PUSHING[0]] == soft


def test_smaller_limits_refuse_the_motion(robot: Robot, plans: list[PlanResult]) -> None:
    result = max(
        plans, key=lambda plan: max((push.force_n or 0.0 for push in plan.certificate.pushes or ()), default=0)
    )
    assert result.scene.wood is not None
    found = hplan.certify(
        robot,
        result.scene.with_values(wood=result.scene.wood.with_values(contact_force=0.2, fruit_force=0.2)),
        result.trajectory,
    )
    assert not found.verified


def contacts_of(
    *limits: ContactLimit,
    share: float = 1.0,
    speed: float = 0.0,
    link: str = "tool0",
    joint: int = 4,
    span_s: tuple[float, float] = (1.0, 1.1),
    name: str = "branch 1",
    whole_depth: float = 0.0,
) -> SegmentContacts:
    """A contact with each of some limbs or fruit."""
    rows = np.zeros(len(limits), CONTACT)
    rows["limit"], rows["joint"], rows["share"], rows["speed"] = np.arange(len(limits)), joint, share, speed
    rows["depth"] = [share * limit.depth for limit in limits]
    rows["begin_s"], rows["end_s"] = span_s
    rows["whole_depth"] = whole_depth
    return SegmentContacts(rows, (link,), (name,), limits)


def push_of(share: float, speed: float, link: str = "tool0", joint: int = 4, **changes: float) -> SegmentContacts:
    return contacts_of(LIMIT._replace(**changes), share=share, speed=speed, link=link, joint=joint)


def violations(robot: Robot, *contacts: SegmentContacts) -> list[str]:
    return list(load_violations(robot, SegmentContacts.join(contacts)))


def test_an_impact_counts(robot: Robot) -> None:
    assert not violations(robot, push_of(1.0, 0.9))  # 6 + 3.6 N
    (found,) = violations(robot, push_of(1.0, 1.2))
    assert "exerts up to 10.8 N on 'branch 1', 4.8 N of it by its speed" in found


def test_slower_motions_keep_the_limits() -> None:
    assert gentle_speeds(push_of(1.0, 0.9), 2.0, 0.1) is None
    speeds = gentle_speeds(push_of(1.0, 2.0), 2.0, 0.1)
    assert speeds is not None
    factor = speeds[np.abs(speeds[:, 0] - 1.05).argmin(), 1]
    assert factor == pytest.approx(0.93 * 0.5)
    assert speeds[0, 1] == speeds[-1, 1] == 1.0
    assert gentle_speeds(push_of(1.0, 60.0), 2.0, 0.1) is None


def test_stresses_of_different_limbs_add_up(robot: Robot) -> None:
    pushes = [push_of(1.0, 0.0, segment=number) for number in range(4)]
    assert not violations(robot, *pushes[:3])
    (found,) = violations(robot, *pushes)
    assert "40 MPa" in found
    # Contacts with one segment are one load, and limbs with another root are separate.
    assert not violations(robot, *pushes[:1] * 4)
    others = [push_of(1.0, 0.0, segment=number, root=number) for number in range(4)]
    assert not violations(robot, *others)


def test_links_that_share_no_joint_may_squeeze_a_limb(robot: Robot) -> None:
    neighbours = [push_of(0.2, 0.0), push_of(0.2, 0.0, "forearm", 3)]
    assert not violations(robot, *neighbours)
    (found,) = violations(robot, push_of(0.2, 0.0), push_of(0.2, 0.0, "upper_arm", 2))
    assert "from two sides" in found
    later = push_of(0.2, 0.0, "upper_arm", 2).shift(0.2)
    assert not violations(robot, push_of(0.2, 0.0), later)


def test_two_arms_do_not_push_one_limb() -> None:
    one, other = push_of(0.2, 0.0), push_of(0.2, 0.0, root=5)
    assert not list(shared_limb_violations({"left": one, "right": other}))
    (found,) = shared_limb_violations({"left": one, "right": one})
    assert found.startswith("'left' and 'right' push")


def test_the_goal_moves_with_its_limb() -> None:
    trunk = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
    twig = Capsule(name="twig", start=(0.0, 0.0, 1.0), end=(0.4, 0.0, 1.0), radius=0.004, parent="trunk")
    fruit = hplan.scene.Fruit(name="apple", center=(0.35, 0.0, 0.95), radius=0.04)
    start = hplan.scene.Start(joints_deg=(0.0, 90.0, 90.0, 90.0))
    scene = Scene(
        name="twig", start=start, goal=hplan.scene.Goal(fruit="apple"), obstacles=(trunk, twig), fruits=(fruit,),
        wood=Wood(),
    )  # fmt: skip
    limits = {solid.name: solid.contact_limit for solid in scene.listed_solids if solid.contact_limit is not None}
    apple, tip = limits["apple"], limits["twig"]
    assert apple is not None
    assert tip is not None
    push = contacts_of(tip, name="twig")
    moved = displacement_at(push, Grasp("apple", apple, 1.05, 1.05))
    # The work of this push could swing the fruit alone.
    point = apple.displacement
    assert isinstance(point, HangingPoint)
    swung = math.sqrt(2.0 * float(push.loads.force[0]) * tip.depth * float(np.linalg.eigvalsh(point.swing)[-1]))
    assert moved > max(swung, 0.6 * tip.depth)
    # It comes to rest.
    assert displacement_at(push, Grasp("apple", apple, 0.9, 0.9)) == 0.0
    later = [displacement_at(push, Grasp("apple", apple, time_s, time_s)) for time_s in (1.05, 2.0, 4.0, 40.0)]
    assert later == sorted(later, reverse=True)
    assert later[1] < moved
    assert later[-1] < 1e-3
    # A contact that becomes deeper again does work again.
    again = SegmentContacts.join([contacts_of(tip, share=share, name="twig", span_s=(t, t + 0.1))
                                  for share, t in ((1.0, 1.0), (0.5, 1.1), (1.0, 1.2))])  # fmt: skip
    twice = displacement_at(again, Grasp("apple", apple, 1.25, 1.25))
    assert twice == pytest.approx(math.sqrt(1.5) * moved)
    # While it becomes deeper, its force grows.
    steps = SegmentContacts.join([contacts_of(tip, share=n / 100, name="twig", span_s=(n / 100, (n + 1) / 100))
                                  for n in range(1, 101)])  # fmt: skip
    gradual = displacement_at(steps, Grasp("apple", apple, 1.0, 1.0))
    assert gradual == pytest.approx(math.sqrt(0.505) * moved)


def hanging_apple() -> ContactLimit:
    """The contact limit of an apple on a twig."""
    trunk = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
    twig = Capsule(name="twig", start=(0.0, 0.0, 1.0), end=(0.4, 0.0, 1.0), radius=0.004, parent="trunk")
    apple = hplan.scene.Fruit(name="apple", center=(0.35, 0.02, 0.95), radius=0.04)
    at = hplan.scene.Start(joints_deg=(0.0, 90.0, 90.0, 90.0)), hplan.scene.Goal(joints_deg=(0.0, 90.0, 90.0, 90.0))
    scene = Scene(name="twig", start=at[0], goal=at[1], obstacles=(trunk, twig), fruits=(apple,), wood=Wood())
    limits = {solid.name: solid.contact_limit for solid in scene.listed_solids if solid.meets != "others"}
    found = limits["apple"]
    assert found is not None
    return found


def test_a_pushed_fruit_moves_no_farther_than_its_bound() -> None:
    apple = hanging_apple()
    point = apple.displacement
    assert isinstance(point, HangingPoint)
    at = point.limbs.start[point.segment] + point.along * point.limbs.axis[point.segment]
    random, largest = np.random.default_rng(4), 0.0
    for _ in range(2000):
        modulus = random.uniform(*point.youngs_modulus)
        limb = mutual_compliance(point.limbs, (point.segment, point.segment), np.stack([at, at]), modulus)
        compliance = limb + random.uniform(1.0, 1.0 / 0.6) * point.swing
        normal, depth = random.normal(size=3), random.uniform(0.0, apple.depth)
        normal /= np.linalg.norm(normal)
        force = depth / (normal @ compliance @ normal)
        moved = float(np.linalg.norm(force * compliance @ normal))
        bound = point.displacement_by_work(0.0, 0.5 * force * depth)
        assert moved <= bound
        largest = max(largest, moved / bound)
    assert largest > 0.7


def test_the_push_of_a_fruit_counts_until_its_grasp() -> None:
    apple = hanging_apple()
    point = apple.displacement
    assert isinstance(point, HangingPoint)
    push = contacts_of(apple, share=0.5, speed=0.3, name="apple", whole_depth=0.01)
    force, thrown = 0.5 * apple.force + apple.swing * 0.3**2, 2.0 * apple.mass * 0.3**2
    moved = point.displacement_by_work(0.0, force * 0.01 + thrown)
    assert displacement_at(push, Grasp("apple", apple, 1.1, 3.0)) == pytest.approx(moved)
    # A fruit that was released swings, and comes to rest.
    later = moved * math.sqrt(1.05 / 0.95) * math.exp(-1.9 * apple.decay_rate)
    assert displacement_at(push, Grasp("apple", apple, 1.2, 3.0)) == pytest.approx(min(moved, later))
    # The fruit may be met as several solids.
    twice = contacts_of(apple, apple, share=0.5, speed=0.3, name="apple", whole_depth=0.01)
    assert displacement_at(twice, Grasp("apple", apple, 1.1, 3.0)) == pytest.approx(moved)
    # Nothing of that depends on the hand being above the fruit, within the extended part only.
    above = contacts_of(apple, share=0.5, speed=0.3, name="apple")
    assert displacement_at(above, Grasp("apple", apple, 1.1, 3.0)) == 0.0


def test_contacts_that_displace_the_goal_by_their_speed_are_slowed(monkeypatch: pytest.MonkeyPatch) -> None:
    apple, subject = hanging_apple(), SimpleNamespace()
    grasp = Grasp("apple", apple, 1.1, 3.0)
    monkeypatch.setattr(goal_displacement_module, "grasps_in", lambda _: [grasp])

    def displaced(share: float, speed: float) -> tuple[float, tuple[IntArray, FloatArray] | None]:
        subject.pushes_by_segment = contacts_of(apple, share=share, speed=speed, name="apple", whole_depth=share * 0.01)
        return displacement_at(subject.pushes_by_segment, grasp), contacts_to_slow(cast(Any, subject))

    most, speed = apple.capture_range, 0.4
    moved, slower = displaced(0.05, speed)
    assert moved > most
    assert slower is not None
    assert slower[0].tolist() == [0]
    assert displaced(0.05, speed * slower[1][0])[0] <= most * (1.0 + 1e-9)
    moved, slower = displaced(0.05, 0.0)
    assert moved < most
    assert slower is not None
    assert not len(slower[0])
    assert displaced(1.0, 0.0)[1] is None


def test_what_one_part_does_counts_for_a_later_grasp(plans: list[PlanResult]) -> None:
    certificate = plans[-1].certificate
    assert certificate.subject is not None
    found = goal_displacement(certificate.subject)
    assert found is not None
    assert certificate.goal_displacement_m == found.moved_m
    assert capture_violations(found) == []
    (words,) = capture_violations(found._replace(moved_m=0.031, beyond_m=0.011))
    assert "by up to 31 mm at the grasp; allowed: 20 mm" in words


def test_the_goal_moves_with_a_limb_that_is_pressed_against_its_own() -> None:
    trunk = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
    twig = Capsule(name="twig", start=(0.0, 0.0, 1.0), end=(0.4, 0.0, 1.0), radius=0.004, parent="trunk")
    apple = hplan.scene.Fruit(name="apple", center=(0.35, 0.0, 0.95), radius=0.04)
    at = hplan.scene.Start(joints_deg=(0.0, 90.0, 90.0, 90.0)), hplan.scene.Goal(fruit="apple")
    for gap, moves in ((0.004, True), (0.3, False)):
        height = 1.008 + gap
        other = Capsule(
            name="other", start=(0.0, 0.0, height), end=(0.4, 0.0, height), radius=0.004, parent="trunk"
        )  # fmt: skip
        scene = Scene(name="two", start=at[0], goal=at[1], obstacles=(trunk, twig, other), fruits=(apple,), wood=Wood())
        limits = {solid.name: solid.contact_limit for solid in scene.listed_solids if solid.contact_limit is not None}
        assert limits["other"].root != limits["apple"].root
        assert (limits["apple"].root in limits["other"].roots) is moves
        found = displacement_at(contacts_of(limits["other"], name="other"), Grasp("apple", limits["apple"], 1.0, 1.05))
        assert (found > 1e-3) is moves
        # A fruit on wood that does not bend is displaced by what is pressed against itself.
        beside = limits["other"]._replace(roots=frozenset(), fruits=frozenset({"apple"} if moves else ()))
        found = displacement_at(contacts_of(beside, name="other"), Grasp("apple", limits["apple"], 1.0, 1.05))
        assert (found > 1e-3) is moves


def test_the_goal_moves_with_other_fruit_on_its_limb() -> None:
    trunk = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
    twig = Capsule(name="twig", start=(0.0, 0.0, 1.0), end=(0.4, 0.0, 1.0), radius=0.004, parent="trunk")
    apples = tuple(
        hplan.scene.Fruit(name=name, center=(x, 0.0, 0.95), radius=0.04) for name, x in (("far", 0.35), ("near", 0.25))
    )
    start = hplan.scene.Start(joints_deg=(0.0, 90.0, 90.0, 90.0))
    goal = hplan.scene.Goal(fruit="far")
    scene = Scene(name="twig", start=start, goal=goal, obstacles=(trunk, twig), fruits=apples, wood=Wood())
    limits = {solid.name: solid.contact_limit for solid in scene.listed_solids if solid.contact_limit is not None}
    far, near = limits["far"], limits["near"]
    assert far is not None
    assert near is not None
    push = contacts_of(near, name="near", whole_depth=near.depth)
    moved = displacement_at(push, Grasp("far", far, 1.05, 1.05))
    assert moved > near.depth
    # Half as deep, with half the force, a quarter of the work is done.
    half = contacts_of(near, share=0.5, name="near", whole_depth=0.5 * near.depth)
    assert displacement_at(half, Grasp("far", far, 1.05, 1.05)) == pytest.approx(0.5 * moved)


def test_limits_refuse_no_motion_that_touches_nothing(robot: Robot) -> None:
    scene, checked = load_scene("orchard-row"), 0
    for fruit in ("fruit 02", "fruit 07", "fruit 14", "fruit 23"):
        task = scene.with_values(goal=hplan.scene.Goal(fruit=fruit))
        result = hplan.plan(robot, task)
        contact = result.certificate.goal_contact or "approach"
        found = hplan.certify(robot, with_limbs(task), result.trajectory, goal_contact=contact)
        assert found.verified
        assert found.digests is not None
        assert result.certificate.digests is not None
        assert found.digests.scene != result.certificate.digests.scene
        checked += 1
    assert checked == 4
