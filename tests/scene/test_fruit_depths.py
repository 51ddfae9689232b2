"""Depths of fruit among neighbours, compared with the equilibrium of the pushed fruit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from hplan.base.arrays import FloatArray
from hplan.scene import Capsule, Fruit, Wood
from hplan.scene.fruit_depths import Pendulum, deepest_push, push_among
from hplan.scene.limb_contacts import RoundedHull, contact_solids
from hplan.scene.neighbours import Neighbours

TRUNK = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 1.2), radius=0.03)
LIMB = Capsule(name="limb", start=(0.0, 0.0, 1.0), end=(1.0, 0.0, 1.0), radius=0.009, parent="trunk")
POST = Capsule(name="post", start=(0.52, 0.0, 0.5), end=(0.52, 0.0, 0.95), radius=0.02)
APPLE = Fruit(name="apple", center=(0.4, 0.0, 0.93), radius=0.035, hangs_from="limb")
OTHER = Fruit(name="other", center=(0.465, 0.0, 0.935), radius=0.03, hangs_from="limb")


def random_direction(random: np.random.Generator) -> FloatArray:
    found = random.normal(size=3)
    return found / np.linalg.norm(found)


def random_case(random: np.random.Generator) -> tuple[Pendulum, Neighbours]:
    """A fruit with a few neighbours, none of them above it, some of them soft."""
    stalk = random_direction(random)
    count, length = int(random.integers(1, 5)), float(random.uniform(0.04, 0.08))
    directions = np.array([random_direction(random) for _ in range(count)])
    directions[directions @ stalk < 0.0] *= -1.0
    gap = np.where(random.random(count) < 0.5, 0.0, random.uniform(0.0, 0.03, count))
    stiffness = np.where(random.random(count) < 0.6, np.inf, 10.0 ** random.uniform(0.5, 3.0, count))
    none, many = np.full(count, -1), np.full(count, np.inf)
    near = Neighbours(np.zeros(count, dtype=np.int64), gap, stiffness, np.where(np.isinf(stiffness), 0.0, 1.0), many,
                      none, none, directions, none, np.zeros(count))  # fmt: skip
    return Pendulum(stalk, length, 0.8 * length, float(random.uniform(20.0, 80.0))), near


def force_of(fruit: Pendulum, near: Neighbours, more_compliant: FloatArray, push: FloatArray, depth: float) -> float:
    """Force that pushes a fruit by a depth in a direction, from the equilibrium of all contacts.

    The forces minimize the complementary energy.
    """
    across = np.eye(3) - np.outer(fruit.stalk, fruit.stalk)
    compliance = across / fruit.stiffness + more_compliant
    normals = np.concatenate([push[None], -near.direction])
    soft = np.append(0.0, np.where(np.isinf(near.stiffness), 0.0, 1.0 / near.stiffness))
    matrix = normals @ compliance @ normals.T + np.diag(soft + 1e-9)
    root = np.linalg.cholesky(matrix)
    return float(nnls(root.T, np.linalg.solve(root, np.append(depth, -near.gap)))[0][0])


@pytest.mark.parametrize("limb_bends", [False, True])
def test_no_direction_finds_more_than_the_permitted_force(limb_bends: bool) -> None:
    random, ratios = np.random.default_rng(int(limb_bends)), list[float]()
    for _ in range(400):
        fruit, near = random_case(random)
        push = push_among(fruit, float(random.uniform(0.2, 1.0)) * fruit.depth, near)
        # Neighbours that the fruit does not reach stop limbs alone.
        stops = near.at(push.reached) if limb_bends else near
        root = 0.1 * random.normal(size=(3, 3)) * limb_bends
        for _ in range(20):
            direction = random_direction(random)
            depth = push.permitted_depth(direction)
            if depth > 1e-6:
                ratios.append(force_of(fruit, stops, root @ root.T, direction, depth) / fruit.stiffness / push.depth)
    assert len(ratios) > 1000
    assert max(ratios) <= 1.0 + 1e-4
    assert max(ratios) > 0.95


def test_a_fruit_that_rests_against_a_wall_may_be_pushed_away_and_past_it() -> None:
    stalk = np.array([0.0, 0.0, -1.0])
    none, zero = np.array([-1]), np.zeros(1)
    far, towards_it = np.array([np.inf]), np.array([[1.0, 0.0, 0.0]])
    wall = Neighbours(none, zero, far, zero, far, none, none, towards_it, none, zero)
    push = deepest_push(Pendulum(stalk, 0.05, 0.04, 40.0), wall)
    assert push.depth == 0.04
    directions = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    towards, past, away = map(push.permitted_depth, directions)
    assert (towards, past, away) == pytest.approx((0.0, 0.04, 0.04), abs=1e-12)


def test_a_fruit_that_swings_up_is_stopped_by_a_neighbour_of_unknown_direction() -> None:
    """It moves by more than its deflection, which is horizontal."""
    length, none, zero = 0.05, np.array([-1]), np.zeros(1)
    fruit, far = Pendulum(np.array([0.0, 0.0, -1.0]), length, 0.8 * length, 40.0), np.array([np.inf])
    moved = np.hypot(fruit.depth, length - np.sqrt(length**2 - fruit.depth**2))
    for part in (0.999, 1.001):
        cloud = Neighbours(none, np.array([part * moved]), far, zero, far, none, none, np.zeros((1, 3)), none, zero)
        assert (deepest_push(fruit, cloud).depth == fruit.depth) == (part > 1.0)


def test_a_fruit_that_hardly_swings_is_not_pushed() -> None:
    fruit, near = random_case(np.random.default_rng(0))
    push = deepest_push(fruit._replace(depth=0.0), near)
    assert push.depth == push.permitted_depth(near.direction[0]) == 0.0


def test_a_fruit_is_not_pushed_against_one_that_is_stopped_itself() -> None:
    part = contact_solids((TRUNK, LIMB, POST), (APPLE, OTHER), Wood())["apple"][-1]
    assert isinstance(part, RoundedHull)
    offset = part.core[:, 0] - APPLE.center[0]
    towards, away = part.yields + offset.min(), part.yields - offset.max()
    assert towards <= 0.005  # the gap between the other one and the post
    assert away >= 0.8 * part.yields > 0.02


def test_fruit_behind_a_pushed_neighbour_may_be_displaced() -> None:
    behind = Fruit(name="behind", center=(0.53, 0.0, 0.935), radius=0.03, hangs_from="limb")
    limit = contact_solids((TRUNK, LIMB), (APPLE, OTHER, behind), Wood())["apple"][-1].contact_limit
    assert limit is not None
    assert limit.fruits == {"other", "behind"}


def test_a_fruit_between_walls_moves_by_the_gap() -> None:
    stalk, both = np.array([0.0, 0.0, -1.0]), np.full(3, -1)
    angles = np.radians([0.0, 120.0, 240.0])
    around = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    rigid = np.full(3, np.inf)
    near = Neighbours(both, np.full(3, 0.004), rigid, np.zeros(3), rigid, both, both, around, both, np.zeros(3))
    push = deepest_push(Pendulum(stalk, 0.05, 0.04, 40.0), near)
    assert 0.0015 <= push.mean_depth <= 0.004
