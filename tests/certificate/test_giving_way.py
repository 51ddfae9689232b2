"""Compliant obstacles: deflected by permitted links within bounds; all else is rigid."""

import itertools

import coal
import numpy as np
import pinocchio as pin
import pytest
from arm_variants import link_axes
from segments import segment_distances

from hplan.certificate.certificate import certify
from hplan.certificate.digests import scene_digest
from hplan.collision.compliant_solids import HANGING_M, maximum_deflection, pushing_links
from hplan.errors import BlockedError, ConfigurationInCollisionError, OptionError, SceneError
from hplan.planar.family_reader import family_of
from hplan.planar.grid.sections import sections_at
from hplan.planar.grids import prepare_world
from hplan.planning.plan import plan
from hplan.planning.world import World
from hplan.robot.model import load_robot
from hplan.scene.file import dump_scene, parse_scene
from hplan.scene.model import Goal
from hplan.scene.obstacles import Box, Capsule, PointCloud, Sphere
from hplan.scene.orchard import OrchardOptions, generate
from hplan.scene.orchard.options import REACHED

YIELDS = 0.02


def orchard(seed, **options):
    """Generated trees in front of the orchard arm, with compliant thin wood and fruit."""
    given = {"wood_yields": YIELDS, "yields_below": 0.012, "fruit_yields": YIELDS} | options
    zone = REACHED["orchard_harvester"]
    grown = OrchardOptions(robot="orchard_harvester", seed=seed, fruits=40, distance=1.2, fruit_zone=zone, **given)
    return generate(grown, start_deg=(0.0, 90.0, 90.0, 90.0))


#: The links on the last two joints of the orchard arm: the gripper is a link of its own.
PUSHING = ("forearm", "hand", "tool0")


def capsules(arm, configurations):
    """Link and radius of each capsule of the URDF beyond the turret, those on the last joint, and their axes."""
    shapes = [shape for shape in arm.collision_model.geometryObjects if shape.parentJoint >= 2]
    tubes = [shape for shape in shapes if isinstance(shape.geometry, coal.Cylinder)]
    links = [(arm.model.frames[tube.parentFrame].name, tube.geometry.radius) for tube in tubes]
    last = {k for k, tube in enumerate(tubes) if tube.parentJoint == arm.dof}
    data, axes = arm.model.createData(), []
    for q in configurations:
        pin.forwardKinematics(arm.model, data, q)
        places = [(data.oMi[tube.parentJoint] * tube.placement, tube.geometry.halfLength) for tube in tubes]
        axes.append([[place.act(np.array([0.0, 0.0, end * half])) for end in (-1, 1)] for place, half in places])
    return links, last, np.array(axes)


def depths(arm, scene, result, step_s=2e-3):
    """Times, and depths by link and obstacle [m]: plain distances of segments."""
    motion = result.trajectory
    clock = np.append(np.arange(0.0, motion.duration, step_s), motion.duration)
    links, last, axes = capsules(arm, motion.positions(clock))
    solids = [(o.name, o.core[0], o.core[-1], o.radius) for o in scene.obstacles]
    solids += [(f.name, np.array(f.center), np.array(f.center), f.radius) for f in scene.fruits]
    found = {}
    for (name, start, end, radius), k in itertools.product(solids, range(len(links))):
        at = np.arange(0, len(clock), 25)
        if segment_distances(axes[at, k, 0], axes[at, k, 1], start, end).min() > 0.3:
            continue
        apart = segment_distances(axes[:, k, 0], axes[:, k, 1], start, end)
        depth = radius + links[k][1] - apart
        for window in result.certificate.contacts:
            if window.fruit.name == name and k in last:
                depth[(clock >= window.begin_s) & (clock <= window.end_s)] = -np.inf
        found[links[k][0], name] = depth
    return clock, found


def with_compliance(scene, yields):
    """The scene with other compliances, by name [m]."""
    items = {
        key: tuple(
            item.model_copy(update={"yields": yields[item.name]}) if item.name in yields else item
            for item in getattr(scene, key)
        )
        for key in ("obstacles", "fruits")
    }
    return scene.model_copy(update=items)


def contact_of(result):
    """Value of `goal_contact` for a plan."""
    return "approach" if len(result.phases) > 1 else "motion"


@pytest.fixture(scope="module")
def arm():
    return load_robot("orchard_harvester")


def planned(arm, numbers, **options):
    """Scenes with plans to fruits that have a motion, and the depths (`depths`)."""
    found = []
    for seed in (1, 2):
        trees = orchard(seed, **options)
        for number in numbers:
            scene = trees.model_copy(update={"goal": Goal(fruit=trees.fruits[number].name)})
            try:
                result = plan(arm, scene)
            except BlockedError:
                continue
            found.append((scene, result, *depths(arm, scene, result)))
    return found


@pytest.fixture(scope="module")
def motions(arm):
    """Motions among compliant trees, some with contact."""
    return planned(arm, range(0, 40, 6))


@pytest.fixture(scope="module")
def hanging(arm):
    """Motions that deflect the support of a fruit among rigid trees; without its name they are blocked."""
    found = planned(arm, range(0, 40, 4), wood_yields=0.0, fruit_yields=0.0, hangs_within=0.02)
    return [one for one in found if one[1].certificate.pushes]


def test_field_and_coal_agree_on_compliance_for_each_link():
    rng, robot = np.random.default_rng(5), load_robot()
    solids = [Box(name="box", center=(0.9, 0.4, 1.2), size=(0.2, 0.2, 0.2), yields=0.01)]
    solids += PointCloud.from_points("cloud", rng.normal((1.0, -0.5, 1.2), 0.1, (300, 3)), 0.01, yields=0.015).solids
    for number in range(60):
        middle, half = rng.uniform([0.3, -1.0, 0.2], [1.6, 1.0, 2.0]), rng.normal(size=3)
        half *= 0.2 / np.linalg.norm(half)
        ends = {"from": tuple(middle - half), "to": tuple(middle + half)}
        kinds = {"radius": rng.uniform(0.003, 0.012), "yields": rng.choice([0.0, YIELDS])}
        solids.append(Capsule.model_validate({"name": f"twig {number}", **ends, **kinds}))
    world = World.build(robot, solids, clearance=0.005)
    for q in rng.uniform(robot.lower, robot.upper, (300, robot.dof)):
        left = world.checker.pair_distances(q) - world.checker.required_distance(0.005)
        by_link = left[: 3 * len(solids)].reshape(3, -1).min(axis=1)
        field = world.field.link_clearances(q, 100.0)[2:5]  # pedestal and turret come first, pairs last
        near = (by_link > -0.02) & (field > -0.02)
        np.testing.assert_allclose(field[near], by_link[near], atol=1e-6)
        assert ((by_link <= 1e-6) == (field <= 1e-6)).all()


def test_deflections_are_allowed_and_reported(motions):
    yields = {item.name: item.yields for scene, *_ in motions for item in (*scene.obstacles, *scene.fruits)}
    assert len(motions) > 5
    pushing = 0
    for _, result, clock, found in motions:
        certificate = result.certificate
        assert certificate.verified
        for (link, name), depth in found.items():
            allowed = yields[name] if link in PUSHING else 0.0
            assert depth.max() <= allowed + 1e-6, (link, name)
            told = [push for push in certificate.pushes if (push.link, push.obstacle) == (link, name)]
            deep = depth > 1e-6
            pushing += bool(deep.any())
            for push in told:
                deep &= ~((clock >= push.begin_s - 1e-9) & (clock <= push.end_s + 1e-9))
                assert push.depth_m <= allowed
            assert not deep.any(), (link, name)
            assert max((push.depth_m for push in told), default=0.0) >= depth.max() - 1e-6
    assert pushing > 10


def test_excessive_deflection_is_not_verified(arm, motions):
    """A bound on the largest depth, just above the true depth and just below it."""
    outcomes = []
    for scene, result, _, found in motions:
        (_, name), depth = max(found.items(), key=lambda item: item[1].max())
        if depth.max() < 1e-3:
            continue
        for beyond in (2e-5, -2e-5):
            other = with_compliance(scene, {name: float(depth.max()) + beyond})
            certificate = certify(arm, other, result.trajectory, goal_contact=contact_of(result))
            outcomes.append((beyond > 0.0, certificate.verified))
    assert len(outcomes) > 8
    assert not any(verified for may, verified in outcomes if not may)
    assert sum(verified for may, verified in outcomes if may) >= len(outcomes) // 4


def test_deflections_of_unverified_motion_are_exact(arm, motions):
    """The bound of each obstacle in contact is a third of the true depth."""
    seen = 0
    for scene, result, _, found in motions:
        deepest = dict[str, float]()
        for (_, name), depth in found.items():
            deepest[name] = max(deepest.get(name, 0.0), float(depth.max()))
        pushed = {name: depth for name, depth in deepest.items() if depth > 1e-3}
        if not pushed:
            continue
        less = with_compliance(scene, {name: depth / 3.0 for name, depth in pushed.items()})
        certificate = certify(arm, less, result.trajectory, goal_contact=contact_of(result))
        assert not certificate.verified
        for name, depth in pushed.items():
            seen += 1
            assert max(push.depth_m for push in certificate.pushes if push.obstacle == name) >= depth - 1e-6
    assert seen > 3


def test_other_links_may_push_only_where_they_are_named(arm, motions):
    refused = 0
    for scene, result, *_ in motions:
        if any(push.link == "forearm" for push in result.certificate.pushes):
            rigid = scene.model_copy(update={"yield_links": ("hand",)})
            refused += not certify(arm, rigid, result.trajectory).verified
            assert scene_digest(rigid) != scene_digest(scene)
    assert refused
    with pytest.raises(OptionError, match=r"'gripper'.*turret, upper_arm, forearm, hand, tool0"):
        plan(arm, scene.model_copy(update={"yield_links": ("gripper",)}))


def test_last_two_links_deflect_up_to_their_thickness():
    planar, general = load_robot(), load_robot("ur5")
    assert pushing_links(planar, None) == ("forearm", "hand")
    assert pushing_links(general, None) == ("wrist_2_link", "wrist_3_link", "ee_link")
    ball = Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.004, yields=0.5)
    assert maximum_deflection(planar, [ball], None) == pytest.approx(
        0.03 + 0.004
    )  # the axis of the hand meets the centre
    assert maximum_deflection(general, [ball], None) == 0.004
    cloud = PointCloud.from_points("cloud", np.random.default_rng(0).normal(size=(50, 3)), 0.01, yields=0.5)
    assert 0.0 < maximum_deflection(general, cloud.solids, None)[0] < cloud.solids[0].rounding


def test_sections_of_compliant_obstacles_are_smaller_for_deflecting_links():
    robot, scene = load_robot(), orchard(1)
    soft = World.build(robot, scene.solids_with_goal)
    firm = World.build(robot, [solid.model_copy(update={"yields": 0.0}) for solid in scene.solids_with_goal])
    cuts = [sections_at(robot, prepare_world(world)) for world in (soft, firm)]
    radii = [
        [
            {cut.obstacle_names[o]: r for o, r in zip(cut.obstacle_of[at], cut.radii[at], strict=True)}
            for at in (cut.links == link for link in range(3))
        ]
        for cut in cuts
    ]
    assert radii[0][0] == radii[1][0]
    for small, large in zip(radii[0][1:], radii[1][1:], strict=True):
        assert set(small) < set(large)
        assert all(small[name] <= large[name] for name in small)


def test_support_of_fruit_is_compliant_while_fruit_may_be_touched(arm, hanging):
    assert len(hanging) > 3
    for scene, result, clock, found in hanging:
        wood, windows = scene.goal_fruit.hangs_from, result.certificate.contacts
        inside = np.any([(clock >= one.begin_s) & (clock <= one.end_s) for one in windows], axis=0)
        for (link, name), depth in found.items():
            may = name in wood and link in PUSHING
            assert depth[inside].max() <= (HANGING_M if may else 0.0) + 1e-6, (link, name)
            assert depth[~inside].max(initial=-1.0) <= 1e-6, (link, name)
        pushed = {push.obstacle for push in result.certificate.pushes}
        assert pushed <= set(wood)
        assert {push["obstacle"] for push in result.report["certificate"]["pushes"]} == pushed
        contact = contact_of(result)
        assert certify(arm, scene, result.trajectory, goal_contact=contact).verified
        fruits = tuple(fruit.model_copy(update={"hangs_from": ()}) for fruit in scene.fruits)
        alone = scene.model_copy(update={"fruits": fruits})
        assert not certify(arm, alone, result.trajectory, goal_contact=contact).verified
        # Reported depths are upper bounds; a depth is true if no smaller one is feasible.
        (_, name), depth = max(((key, deep.max()) for key, deep in found.items()), key=lambda item: item[1])
        shallow = with_compliance(scene, {name: 0.5 * depth})
        assert not certify(arm, shallow, result.trajectory, goal_contact=contact).verified


def test_field_and_coal_agree_on_supports(arm, hanging):
    rng = np.random.default_rng(3)
    for scene, result, *_ in hanging[:3]:
        fruit = scene.goal_fruit
        solids = [*scene.solids_with_goal]
        near = World.build(arm, solids, clearance=0.005).allow_touch(fruit.name, fruit.hangs_from)
        both = (near, near.allow_touch(scene.fruits[3].name), World.build(arm, solids, clearance=0.005))
        grasp = result.trajectory.position[-1]
        seen = set()
        for q in grasp + 0.05 * rng.normal(size=(200, arm.dof)):
            for number, world in enumerate(both):
                left = (world.checker.pair_distances(q) - world.checker.required_distance(0.005)).min()
                assert (left <= 1e-6) == (world.field.spare_clearance(q) <= 1e-6)
                seen.add((number, bool(left <= 1e-6)))
        assert {(0, False), (2, True)} <= seen


def test_support_is_rigid_for_other_links(arm):
    q = np.array([1.0, 0.6, 0.5, 0.3])
    for link, name in enumerate(family_of(arm).arm.link_names):
        beside = family_of(arm).arm.half_widths[link] * np.array([-np.sin(q[0]), np.cos(q[0]), 0.0])
        place = link_axes(arm, q)[link].mean(axis=0) + beside
        stub = Sphere(name="stub", center=tuple(place.tolist()), radius=0.01)
        fruit = Sphere(name="fruit", center=(0.0, 0.0, 3.0), radius=0.04)
        near = World.build(arm, [stub, fruit]).allow_touch("fruit", ["stub"])
        assert (near.field.spare_clearance(q) > 0.0) == (name in pushing_links(arm, None))
        if name in pushing_links(arm, None):
            near.check_clear(q, "start")
        else:
            with pytest.raises(ConfigurationInCollisionError, match=name):
                near.check_clear(q, "start")


def test_scenes_keep_supports_of_fruit():
    scene = orchard(3, hangs_within=0.02)
    assert parse_scene(dump_scene(scene)) == scene
    assert "hangs_from" not in dump_scene(orchard(3))
    assert scene_digest(scene) != scene_digest(orchard(3))
    hung = [fruit.hangs_from for fruit in scene.fruits]
    assert all(hung)
    assert not any("trunk" in name for names in hung for name in names)
    text = dump_scene(scene)
    first = scene.fruits[0].hangs_from[0]
    one = scene.fruits[0].model_dump() | {"hangs_from": first}
    assert type(scene.fruits[0])(**one).hangs_from == (first,)
    with pytest.raises(SceneError, match=r"fruits\[0\]\.hangs_from.*'no such twig' is not among the obstacles"):
        parse_scene(text.replace(f"hangs_from: [{first}", "hangs_from: [no such twig", 1))
    near = scene.crop(0.5, scene.fruits[0].center)
    names = {one.name for one in near.obstacles}
    assert all(names.issuperset(fruit.hangs_from) for fruit in near.fruits)
    assert not any(fruit.hangs_from for fruit in scene.with_obstacles([]).fruits)
