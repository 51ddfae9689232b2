"""Permitted depths of limbs and fruit, beside the compliance at random points and normals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hplan.certificate.digests import scene_digest
from hplan.errors import SceneError
from hplan.scene import (
    Box,
    Capsule,
    Fruit,
    Goal,
    LimbLimits,
    Scene,
    Start,
    Sway,
    Wood,
    dump_scene,
    load_scene,
    parse_scene,
    with_limbs,
)
from hplan.scene.limb_contacts import contact_solids, limbs_of
from hplan.scene.limb_parts import depth_and_extension, divide_limbs, lateral_depth
from hplan.scene.obstacle_kind import ContactLimit
from hplan.scene.wood import LARGE_ROTATION_FORCE, MOST_ROTATION, STATIC_SHARE

TRUNK = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
TWIG = Capsule(name="twig", start=(0.0, 0.0, 1.0), end=(0.4, 0.0, 1.0), radius=0.004, parent="trunk")
REST = Start(joints_deg=(0.0, 90.0, 90.0, 90.0)), Goal(joints_deg=(0.0, 90.0, 90.0, 90.0))


def random_tree(seed: int, count: int = 25) -> tuple[Capsule, ...]:
    """A trunk with crooked branches."""
    random = np.random.default_rng(seed)
    tree = [TRUNK]
    for number in range(count):
        parent = tree[int(random.integers(len(tree)))]
        start = np.array(parent.start) + random.uniform(0.3, 1.0) * (np.array(parent.end) - np.array(parent.start))
        step = random.normal(size=3)
        end = start + random.uniform(0.05, 0.4) * step / np.linalg.norm(step)
        radius = min(0.9 * parent.radius, random.uniform(0.002, 0.009))
        tree.append(Capsule(name=f"b {number}", start=tuple(start), end=tuple(end), radius=radius, parent=parent.name))
    return tuple(tree)


def scene_of(obstacles: tuple[Capsule | Box, ...], wood: Wood | None = None, fruits: tuple[Fruit, ...] = ()) -> Scene:
    return Scene(
        name="wood",
        start=REST[0],
        goal=REST[1],
        obstacles=obstacles,
        fruits=fruits,
        wood=Wood() if wood is None else wood,
    )


def limit_of(solid: object) -> ContactLimit:
    limit = getattr(solid, "contact_limit", None)
    assert isinstance(limit, ContactLimit)
    return limit


@pytest.mark.parametrize("seed", range(4))
def test_no_normal_finds_more_than_the_permitted_force(seed: int) -> None:
    tree, wood, random = random_tree(seed), Wood(), np.random.default_rng(seed)
    limbs, checked = limbs_of(tree, wood), 0
    for solids in contact_solids(tree, (), wood).values():
        for solid in solids:
            if solid.meets != "pushing" or solid.yields == 0.0:
                continue
            limit = limit_of(solid)
            axis, length = limbs.axis[limit.segment], float(limbs.length[limit.segment])
            extension = 0.5 * (np.linalg.norm(solid.core[1] - solid.core[0]) - (limit.along[1] - limit.along[0]))
            for _ in range(20):
                at = random.uniform(*limit.along)
                normal = random.normal(size=3)
                normal /= np.linalg.norm(normal)
                compliance = limbs.compliance(limit.segment, at / length, wood.stiffest)[:3, :3]
                needed = max(0.0, limit.depth - float(extension) * abs(float(normal @ axis)))
                force = needed / float(normal @ compliance @ normal)
                assert force <= STATIC_SHARE * wood.contact_force * (1.0 + 1e-9)
                assert force <= limit.force * (1.0 + 1e-9)
                point = limbs.start[limit.segment] + at * axis
                stress = force * float(limbs.stress_per_force(np.array([limit.segment]), point[None])[0])
                assert stress <= min(limit.stress, STATIC_SHARE * wood.wood_stress) * (1.0 + 1e-9)
                checked += 1
    assert checked > 300


def test_tip_of_a_cantilever() -> None:
    wood = Wood(contact_force=1.0)
    tip = contact_solids((TRUNK, TWIG), (), wood)["twig"][-1]
    rigidity = wood.stiffest * 0.25 * math.pi * 0.004**4
    compliance = 0.4**3 / (3.0 * rigidity)
    # The tip of the last part moves farther than its first point, for which the depth is.
    at = limit_of(tip).along
    first = at[0] ** 3 / (3.0 * rigidity)
    assert STATIC_SHARE * first <= limit_of(tip).depth * (1.0 + LARGE_ROTATION_FORCE * MOST_ROTATION**2)
    assert limit_of(tip).depth <= STATIC_SHARE * compliance
    # Along its axis the twig is rigid: the part reaches as much farther as it yields.
    assert tip.core[:, 0].max() == pytest.approx(0.4 + limit_of(tip).depth)


def test_near_the_root_a_limb_is_rigid() -> None:
    parts = contact_solids((TRUNK, TWIG), (), Wood())["twig"]
    assert parts[0].meets == "others"
    depths = [part.yields for part in parts[1:]]
    assert depths == sorted(depths)
    assert depths[0] < 0.002
    assert depths[-1] > 0.03


def test_other_links_meet_the_whole_limb() -> None:
    whole = contact_solids((TRUNK, TWIG), (), Wood())["twig"][0]
    assert whole.core.tolist() == TWIG.core.tolist()
    assert whole.yields == 0.0


def test_a_limb_is_not_pushed_into_a_rigid_obstacle() -> None:
    box = Box(name="box", center=(0.35, 0.1, 1.0), size=(0.2, 0.18, 0.3))  # 6 mm beside the twig
    free, beside = (
        {limit_of(part).along: part.yields for part in contact_solids(all_of, (), Wood())["twig"][1:]}
        for all_of in ((TRUNK, TWIG), (TRUNK, TWIG, box))
    )
    assert max(free.values()) > 0.03
    # A part that is pushed at one end moves farther at the other one.
    assert 0.0045 < max(depth for along, depth in beside.items() if along[1] > 0.3) <= 0.006


def test_a_limb_bends_its_neighbour_too() -> None:
    other = Capsule(name="other", start=(0.0, 0.02, 1.0), end=(0.4, 0.02, 1.0), radius=0.004, parent="trunk")
    wood = Wood(contact_force=2.0, wood_stress_mpa=1e3)
    alone, both = (contact_solids(all_of, (), wood)["twig"][-1] for all_of in ((TRUNK, TWIG), (TRUNK, TWIG, other)))
    assert 0.012 < both.yields < alone.yields
    assert limit_of(both).force == pytest.approx(STATIC_SHARE * wood.contact_force)
    assert limit_of(both).stress < limit_of(alone).stress


def test_fruit_swings_but_is_not_pulled_off() -> None:
    fruit = Fruit(name="apple", center=(0.1, 0.0, 0.94), radius=0.04)
    whole, part = contact_solids((TRUNK, TWIG), (fruit,), Wood())["apple"]
    assert whole.core.tolist() == [[0.1, 0.0, 0.94]]
    limit = limit_of(part)
    assert 0.02 < limit.depth <= 0.06
    assert limit.force <= STATIC_SHARE * Wood().fruit_force
    # Above and below it is about as large as it yields: the limb is stiff there.
    assert part.core[:, 2].max() > 0.94 + 0.7 * limit.depth


def test_fruit_about_the_axis_of_a_limb_does_not_yield() -> None:
    fruit = Fruit(name="apple", center=(0.1, 0.0, 1.0), radius=0.04)
    assert "apple" not in contact_solids((TRUNK, TWIG), (fruit,), Wood())


def test_fruit_far_from_wood_does_not_yield() -> None:
    fruit = Fruit(name="apple", center=(0.3, 0.0, 0.8), radius=0.04)
    assert "apple" not in contact_solids((TRUNK, TWIG), (fruit,), Wood())


def test_scene_files_keep_limbs() -> None:
    scene = scene_of((TRUNK, TWIG), Wood(contact_force=5.0))
    read = parse_scene(dump_scene(scene))
    assert read == scene
    assert read.wood == Wood(contact_force=5.0)
    assert scene_digest(read) == scene_digest(scene)
    assert scene_digest(scene.with_values(wood=Wood())) != scene_digest(scene)


def test_without_limits_limbs_change_nothing() -> None:
    plain = load_scene("orchard-row")
    grown = with_limbs(plain).with_values(wood=None)
    assert any(piece.parent for piece in grown.obstacles if isinstance(piece, Capsule))
    assert [solid.core.tolist() for solid in grown.solids] == [solid.core.tolist() for solid in plain.solids]
    assert scene_digest(grown) == scene_digest(plain)


def test_solids_of_derived_scenes_are_kept() -> None:
    scene = with_limbs(load_scene("orchard-row"))
    other = scene.with_values(goal=scene.goal.copy_unchecked({"fruit": scene.fruits[3].name}))
    first = {solid.name: solid for solid in scene.listed_solids if solid.meets == "pushing"}
    assert first
    goal = first.pop(scene.fruits[3].name)
    assert all(any(solid is one for one in other.listed_solids) for solid in first.values())
    assert goal.yields > 0.0


def test_goal_fruit_is_not_pushed_before_its_approach() -> None:
    """After a push it would swing, away from where the hand closes."""
    scene = with_limbs(load_scene("orchard-row"))
    other = scene.with_values(goal=scene.goal.copy_unchecked({"fruit": scene.fruits[3].name}))
    for one, goal, fruit in ((scene, scene, other), (other, other, scene)):
        (rigid,) = (solid for solid in one.listed_solids if solid.name == goal.goal.fruit)
        assert (rigid.meets, rigid.yields) == ("all", 0.0)
        assert rigid.contact_limit is not None
        pushed = [solid for solid in one.listed_solids if solid.name == fruit.goal.fruit]
        assert [solid.meets for solid in pushed] == ["others", "pushing"]
        assert pushed[1].yields > 0.0


def test_a_limb_without_its_parent_is_clamped_at_its_start() -> None:
    second = Capsule(name="second", start=(0.4, 0.0, 1.0), end=(0.6, 0.0, 1.0), radius=0.003, parent="twig")
    third = Capsule(name="third", start=(0.6, 0.0, 1.0), end=(0.8, 0.0, 1.0), radius=0.003, parent="second")
    scene = scene_of((TRUNK, TWIG, second, third))
    cropped = scene.with_obstacles([second, third])
    assert [piece.parent for piece in cropped.obstacles if isinstance(piece, Capsule)] == [None, "second"]
    deepest = [max(solid.yields for solid in one.listed_solids if solid.name == "third") for one in (scene, cropped)]
    assert deepest[1] < deepest[0]


def test_parents_must_be_capsules_of_the_scene() -> None:
    with pytest.raises(SceneError, match="'trunk' is not among the capsules") as found:
        scene_of((TWIG,))
    assert found.value.where == "obstacles[0].parent"


def test_limits_need_limbs() -> None:
    with pytest.raises(SceneError, match="no capsule has a parent; with_limbs"):
        scene_of((TRUNK,))
    with pytest.raises(SceneError, match="the scene has no capsules"):
        scene_of(())


def test_young_modulus_is_an_interval() -> None:
    with pytest.raises(SceneError, match="expected the minimum first, got 5 and 2"):
        Wood(youngs_modulus_gpa=(5.0, 2.0))


def test_wires_and_posts_are_no_limbs() -> None:
    scene = with_limbs(load_scene("trellis"))
    parents = {piece.name: piece.parent for piece in scene.obstacles if isinstance(piece, Capsule)}
    assert any(parents.values())
    assert not any(parent for name, parent in parents.items() if name.startswith(("wire", "post")))
    assert all(limb.meets == "all" for limb in scene.listed_solids if limb.name.startswith("wire"))


FORK = Capsule(name="fork", start=(0.2, 0.0, 1.0), end=(0.2, 0.0, 1.3), radius=0.003, parent="twig")
OTHER = Capsule(name="shoot", start=(0.0, 0.0, 1.9), end=(0.4, 0.0, 1.9), radius=0.004, parent="trunk")
APPLE = Fruit(name="apple", center=(0.4, 0.0, 1.84), radius=0.03)


def limits_of(wood: Wood) -> dict[str, list[ContactLimit]]:
    found = contact_solids((TRUNK, TWIG, FORK, OTHER), (APPLE,), wood)
    return {name: [limit_of(solid) for solid in solids if solid.contact_limit] for name, solids in found.items()}


def test_limits_by_name_replace_those_of_the_scene() -> None:
    usual = limits_of(Wood())
    limits = (LimbLimits(names=("tw*",), contact_force=2.0), LimbLimits(names=("apple",), fruit_force=1.0))
    other = limits_of(Wood(limits=limits))
    assert other["shoot"] == usual["shoot"] == limits_of(Wood(contact_force=10.0))["shoot"]
    assert {limit.most_force for limit in other["twig"]} == {2.0}
    assert [limit[:3] for limit in other["twig"]] == [limit[:3] for limit in limits_of(Wood(contact_force=2.0))["twig"]]
    assert other["apple"][0].most_force == 1.0
    assert other["apple"][0].force <= STATIC_SHARE < usual["apple"][0].force


def test_the_stress_limit_of_a_limb_holds_for_all_contacts_that_bend_it() -> None:
    other = limits_of(Wood(limits=(LimbLimits(names=("twig",), wood_stress_mpa=5.0),)))
    assert {limit.most_stress for name in ("twig", "fork") for limit in other[name]} == {5e6}
    assert {limit.most_stress for limit in other["shoot"]} == {30e6}
    assert max(limit.stress for limit in other["fork"]) <= STATIC_SHARE * 5e6
    assert max(limit.stress for limit in limits_of(Wood())["fork"]) > STATIC_SHARE * 5e6


def test_a_limb_of_softer_wood_yields_more_and_is_one_limb() -> None:
    soft = LimbLimits(names=("twig", "fork"), youngs_modulus_gpa=(0.5, 1.0))
    found, all_soft = limits_of(Wood(limits=(soft,))), limits_of(Wood(youngs_modulus_gpa=(0.5, 1.0)))
    for name in ("twig", "fork"):
        assert [limit[:10] for limit in found[name]] == [limit[:10] for limit in all_soft[name]]
    assert found["shoot"] == limits_of(Wood())["shoot"]
    with pytest.raises(SceneError, match="are one limb, which has one Young's modulus"):
        scene_of((TRUNK, TWIG, FORK), Wood(limits=(LimbLimits(names=("fork",), youngs_modulus_gpa=(0.5, 1.0)),)))


def test_limits_by_name_are_saved_scaled_and_part_of_the_digest() -> None:
    limits = (LimbLimits(names=("twig", "sh*"), contact_force=2.0), LimbLimits(names=("shoot",), contact_force=3.0))
    scene = scene_of((TRUNK, TWIG, OTHER), Wood(limits=limits))
    assert parse_scene(dump_scene(scene)) == scene
    assert scene_digest(scene) != scene_digest(scene_of((TRUNK, TWIG, OTHER)))
    assert scene.wood is not None
    assert [scene.wood.of(name).contact_force for name in ("twig", "shoot", "trunk")] == [2.0, 3.0, 10.0]
    assert [scene.wood.scale(0.5).of(name).contact_force for name in ("twig", "shoot", "trunk")] == [1.0, 1.5, 5.0]
    assert not any(
        s.yields for solids in contact_solids(scene.obstacles, (), scene.wood.as_rigid).values() for s in solids
    )


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("{names: twigs, contact_force: 2}", r"wood.limits\[0\].names"),
        ("{names: twig}", r"wood.limits\[0\]"),
        ("{names: [], contact_force: 2}", r"wood.limits\[0\].names"),
        ("{names: twig, contact_force: -2}", r"wood.limits\[0\].contact_force"),
        ("{names: twig, youngs_modulus_gpa: [2, 1]}", r"wood.limits\[0\].youngs_modulus_gpa"),
        ("{names: twig, force: 2}", r"wood.limits\[0\].force"),
    ],
)
def test_limits_that_cannot_hold_are_refused(text: str, where: str) -> None:
    good = dump_scene(scene_of((TRUNK, TWIG), Wood(contact_force=5.0)))
    with pytest.raises(SceneError, match=where):
        parse_scene(good.replace("limits: []", f"limits: [{text}]"))


def test_limits_for_no_limb_are_refused() -> None:
    wood = Wood(limits=(LimbLimits(names=("twig", "twigs"), contact_force=2.0),))
    with pytest.raises(SceneError, match="'twigs' is the name of no limb or fruit"):
        with_limbs(scene_of((TRUNK, TWIG)), wood)


def test_nothing_that_grows_from_a_swaying_limb_is_pushed() -> None:
    """The push would bend the swaying limb, too, whose stress no certificate covers."""
    spur = Capsule(name="spur", start=(0.3, 0.0, 1.0), end=(0.3, 0.2, 1.0), radius=0.003, parent="twig")
    leaf = Capsule(name="leaf", start=(0.3, 0.1, 1.0), end=(0.3, 0.1, 1.1), radius=0.002, parent="spur")
    other = TWIG.copy_unchecked({"name": "other", "start": (0.0, 0.0, 1.5), "end": (-0.4, 0.0, 1.5)})
    apple = Fruit(name="apple", center=(0.3, 0.15, 0.95), radius=0.03, hangs_from=("spur",))
    still = contact_solids((TRUNK, TWIG, spur, leaf, other), (apple,), Wood())
    assert {name for name, solids in still.items() if len(solids) > 1} >= {"twig", "spur", "other", "apple"}
    swaying = TWIG.copy_unchecked({"sway": Sway(direction=(0.0, 1.0, 0.0), amplitude_m=0.02)})
    found = contact_solids((TRUNK, swaying, spur, leaf, other), (apple,), Wood())
    assert found.keys() == {"other"}
    assert [solid.yields for solid in found["other"]] == [solid.yields for solid in still["other"]]


def test_a_limb_that_is_stiffest_off_its_axis_is_not_rigid() -> None:
    limb = Capsule(name="limb", start=(0.0, 0.0, 1.0), end=(0.4, 0.0, 1.0), radius=0.004, parent="trunk")
    bent = Capsule(name="bent", start=(0.4, 0.0, 1.0), end=(0.48, 0.05, 1.0), radius=0.004, parent="limb")
    limbs, wood = limbs_of((TRUNK, limb, bent), Wood()), Wood()
    parts = divide_limbs(limbs, wood)
    parts = parts.at(parts.segment == limbs.names.index("bent"))
    stiffest = np.linalg.eigh(parts.compliance[0])[1][:, :, 0]
    assert (np.abs(np.einsum("kj,kj->k", stiffest, parts.stiff_axis)) < 0.95).all()
    depth, extension = depth_and_extension(parts)
    assert (depth > 0.3 * lateral_depth(parts)).all()
    assert (extension > depth).any()
