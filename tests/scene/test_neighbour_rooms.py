"""Limbs and fruit with something behind their neighbours, compared with the equilibrium of all contacts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
import pytest
from limb_reference import Touch, compliance_of_touches, forces_in_equilibrium
from scipy.optimize import lsq_linear

from hplan.base.arrays import FloatArray
from hplan.scene import Capsule, Fruit, Wood
from hplan.scene.limb_contacts import contact_solids, limbs_of
from hplan.scene.limb_parts import hanging_fruits, pendulum_stiffness
from hplan.scene.limbs import Limbs
from hplan.scene.obstacle_kind import ContactLimit, Convex, Solid

TRUNK = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
UP = np.array([0.0, 0.0, 1.0])


def capsule(name: str, start: FloatArray, end: FloatArray, radius: float, parent: str | None = None) -> Capsule:
    return Capsule(name=name, start=tuple(start.tolist()), end=tuple(end.tolist()), radius=radius, parent=parent)


def unit(vector: FloatArray) -> FloatArray:
    found: FloatArray = vector / np.linalg.norm(vector)
    return found


def crooked_limb(
    name: str, random: np.random.Generator, touch: FloatArray, across: FloatArray, radius: float
) -> list[Capsule]:
    """A limb of up to three segments past a point, normal to a direction, and the stand that it grows from."""
    along = unit(np.array([1.0, *random.uniform(-0.5, 0.5, 2)]))
    along = unit(along - (along @ across) * across)
    start, end = touch - random.uniform(0.1, 0.3) * along, touch + random.uniform(0.02, 0.1) * along
    stand = capsule(f"stand of {name}", start - 0.4 * UP, start, 0.009)
    parts = [stand, capsule(name, start, end, radius, stand.name)]
    for number in range(int(random.integers(0, 3))):
        bent = unit(along + 0.6 * random.normal(size=3))
        start, end = end, end + random.uniform(0.05, 0.15) * bent
        parts.append(capsule(f"{name} {number}", start, end, 0.9 * parts[-1].radius, parts[-1].name))
    return parts


def hanging_apple(name: str, center: FloatArray, radius: float) -> tuple[list[Capsule], Fruit]:
    """An apple on a bough that does not bend, far from everything else."""
    bough = center + (radius + 0.02 + 0.009) * UP
    side = np.array([0.0, 0.3, 0.0])
    held = [capsule(f"stand of {name}", bough + side + 0.5 * UP, bough + side, 0.02)]
    held.append(capsule(f"bough of {name}", bough + side, bough - side, 0.009, held[0].name))
    return held, Fruit(name=name, center=tuple(center.tolist()), radius=radius, hangs_from=(held[1].name,))


def random_scenery(random: np.random.Generator, kinds: Sequence[str]) -> tuple[list[Capsule], list[Fruit]]:
    """A limb or an apple that is pushed, neighbours of some kinds, and a post behind or beside the first one."""
    obstacles, fruits, middle = [TRUNK], list[Fruit](), np.array([0.35, 0.0, 1.0])
    if kinds[0] == "fruit":
        size = random.uniform(0.03, 0.04)
        held, fruit = hanging_apple("pushed", middle, size)
        obstacles, fruits = obstacles + held, [fruit]
    else:
        size = random.uniform(0.003, 0.006)
        obstacles.append(capsule("pushed", np.array([0.0, 0.0, 1.0]), np.array([0.4, 0.0, 1.0]), size, "trunk"))
        middle = np.array([random.uniform(0.2, 0.4), 0.0, 1.0])
    turn = random.uniform(0.0, 2.0 * np.pi)
    for number, kind in enumerate(kinds[1:]):
        angle = turn + number * random.uniform(0.7, 2.5)
        away = np.array([0.0, np.cos(angle), np.sin(angle)])
        gap = random.uniform(0.0, 0.01)
        if "fruit" in (kind, kinds[0]) and random.random() < 0.5:
            gap = 0.0
        radius = random.uniform(0.03, 0.04) if kind == "fruit" else random.uniform(0.002, 0.006)
        near = middle + (size + gap + radius) * away
        if kind == "fruit":
            held, fruit = hanging_apple(f"other {number}", near, radius)
            obstacles, fruits = obstacles + held, [*fruits, fruit]
        else:
            obstacles += crooked_limb(f"other {number}", random, near, away, radius)
        if number == 0:
            aside = unit(away + random.uniform(-1.0, 1.0) * np.cross(away, [1.0, 0.0, 0.0]))
            post = near + (radius + random.uniform(0.0, 0.02) + 0.02) * aside
            post += np.array([random.uniform(-0.05, 0.05), 0.0, 0.0])
            across = 0.1 * unit(np.cross(aside, random.normal(size=3)))
            obstacles.append(capsule("post", post - across, post + across, 0.02))
    return obstacles, fruits


def touches_of(obstacles: Sequence[Capsule], fruits: Sequence[Fruit], limbs: Limbs) -> list[Touch] | None:
    """Contacts at the nearest points of all pairs, and at more points of limbs; None if limbs touch at rest."""
    bodies = list[tuple[int | str | None, FloatArray, float, str]]()
    for piece in obstacles:
        number = limbs.names.index(piece.name) if piece.name in limbs.names else -1
        body = None if number < 0 or limbs.clamped[number] else number
        bodies.append((body, np.array([piece.start, piece.end]), piece.radius, piece.name))
    bodies += [(fruit.name, np.array([fruit.center, fruit.center]), fruit.radius, fruit.name) for fruit in fruits]
    related, found = limbs.related(), list[Touch]()
    for one, other in combinations(bodies, 2):
        names, numbers = {one[3], other[3]}, [limbs.names.index(b[3]) for b in (one, other) if b[3] in limbs.names]
        is_limb = len(numbers) == 2
        if one[0] is other[0] is None or (is_limb and related[tuple(numbers)]) or f"bough of {other[3]}" in names:
            continue
        points_of_one = np.linspace(one[1][0], one[1][1], 4) if is_limb else ()
        for part in (one[1], *(np.stack([at, at]) for at in points_of_one)):
            along, across = part[1] - part[0], other[1][1] - other[1][0]
            s, t = lsq_linear(np.stack([along, -across], axis=1), other[1][0] - part[0], (0.0, 1.0)).x
            points = np.stack([part[0] + s * along, other[1][0] + t * across])
            distance = float(np.linalg.norm(points[1] - points[0]))
            gap = max(0.0, distance - one[2] - other[2])
            if gap == 0.0 and is_limb:
                return None
            if gap < 0.06:
                found.append(Touch((one[0], other[0]), points, (points[1] - points[0]) / distance, gap))
    return found


def permitted_pushes(
    solids: Sequence[Solid], limbs: Limbs, fruits: Sequence[Fruit], normals: FloatArray, random: np.random.Generator
) -> Iterator[tuple[ContactLimit, Touch]]:
    """Pushes about along some normals, each to the whole depth that is permitted in its direction."""
    for solid in solids:
        if not isinstance(solid, Convex) or solid.meets != "pushing":
            continue
        limit = solid.contact_limit
        if limit is None or limit.depth <= 0.0:
            continue
        for _ in range(4):
            normal = unit(random.choice(normals) + random.uniform(0.0, 1.0) * random.normal(size=3))
            if limit.mass > 0.0:
                fruit = next(each for each in fruits if each.name == solid.name)
                center = np.array(fruit.center)
                depth = limit.depth - float(((center - solid.core) @ normal).max())
                push = Touch((None, solid.name), np.stack([center, center]), normal, -depth)
            else:
                axis, length = limbs.axis[limit.segment], limit.along[1] - limit.along[0]
                extension = 0.5 * (float(np.linalg.norm(solid.core[-1] - solid.core[0])) - length)
                depth = limit.depth - extension * abs(float(normal @ axis))
                at = limbs.start[limit.segment] + random.choice([*limit.along, random.uniform(*limit.along)]) * axis
                push = Touch((None, limit.segment), np.stack([at, at]), normal, -depth)
            if depth > 1e-6:
                yield limit, push


#: Bodies, the first one pushed, and a share of the permitted force that some push with neighbours takes.
CASES = [
    (("limb", "fruit"), 0.6), (("limb", "limb"), 0.6), (("fruit", "limb"), 0.6), (("limb", "limb", "fruit"), 0.6),
    (("limb", "limb", "limb"), 0.05), (("fruit", "limb", "fruit"), 0.6),
]  # fmt: skip


@pytest.mark.parametrize(("kinds", "share"), CASES)
def test_no_push_takes_more_than_the_permitted_force(kinds: Sequence[str], share: float) -> None:
    random, wood, ratios, with_neighbours = np.random.default_rng(0), Wood(), list[float](), list[float]()
    for _ in range(60):
        obstacles, fruits = random_scenery(random, kinds)
        limbs = limbs_of(obstacles, wood)
        touches = touches_of(obstacles, fruits, limbs)
        if touches is None:
            continue
        hanging = hanging_fruits(fruits, limbs, wood)
        pendulums = {
            name: (np.eye(3) - np.outer(stalk, stalk)) / stiffness
            for name, stalk, stiffness in zip(
                hanging.names, hanging.stiff_axis, pendulum_stiffness(hanging).tolist(), strict=True
            )
        }
        known = limbs, pendulums, float(random.choice([wood.softest, wood.stiffest]))
        among, gaps = compliance_of_touches(touches, touches, *known), [touch.gap for touch in touches]
        solids = contact_solids(obstacles, fruits, wood)["pushed"]
        normals = np.array([touch.normal for touch in touches])
        for limit, push in permitted_pushes(solids, limbs, fruits, np.concatenate([normals, -normals]), random):
            by_push, own = (compliance_of_touches([push], each, *known) for each in (touches, [push]))
            compliance = np.block([[own, by_push], [by_push.T, among]])
            forces = forces_in_equilibrium(compliance, np.array([push.gap, *gaps]))
            ratios.append(float(forces[0]) / limit.force)
            if forces[1:].max(initial=0.0) > 0.05 * forces[0]:
                with_neighbours.append(ratios[-1])
    assert len(ratios) > 60
    assert max(ratios) <= 1.0 + 1e-9
    assert max(with_neighbours) > share


@pytest.mark.parametrize("is_fruit", [True, False])
def test_a_limb_is_not_pushed_against_a_neighbour_that_touches_a_post(is_fruit: bool) -> None:
    twig = capsule("twig", np.array([0.0, 0.0, 1.0]), np.array([0.4, 0.0, 1.0]), 0.004, "trunk")
    radius = 0.035 if is_fruit else 0.004
    beside = np.array([0.35, 0.004 + 0.002 + radius, 1.0])  # a gap of 2 mm
    held, fruits = list[Capsule](), tuple[Fruit, ...]()
    if is_fruit:
        held, apple = hanging_apple("apple", beside, radius)
        fruits = (apple,)
    else:
        root = beside - np.array([0.3, 0.0, 0.0])
        held = [capsule("stand", root - 0.4 * UP, root, 0.009), capsule("other", root, beside, radius, "stand")]
    across = 0.1 * UP
    deepest = list[float]()
    for gap in (0.0, 0.2):
        behind = beside + np.array([0.0, radius + gap + 0.02, 0.0])
        post = capsule("post", behind - across, behind + across, 0.02)
        tips = contact_solids((TRUNK, twig, *held, post), fruits, Wood())["twig"][-1:]
        deepest.append(max(tip.contact_limit.depth for tip in tips if isinstance(tip, Convex) and tip.contact_limit))
    assert deepest[0] <= 0.002 < 0.0025 < deepest[1]


def test_fruit_behind_a_pushed_neighbour_of_a_limb_may_be_displaced() -> None:
    twig = capsule("twig", np.array([0.0, 0.0, 1.0]), np.array([0.4, 0.0, 1.0]), 0.004, "trunk")
    held, apple = hanging_apple("apple", np.array([0.35, 0.041, 1.0]), 0.035)
    more, behind = hanging_apple("behind", np.array([0.35, 0.12, 1.0]), 0.035)
    tip = contact_solids((TRUNK, twig, *held, *more), (apple, behind), Wood())["twig"][-1]
    assert isinstance(tip, Convex)
    assert tip.contact_limit is not None
    assert tip.contact_limit.fruits == {"apple", "behind"}
