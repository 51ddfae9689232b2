"""What pushed limbs carry along, beside the compliance between random points and normals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from limb_reference import mutual_compliance
from scene.test_wood import TRUNK, TWIG, limit_of, random_tree

from hplan.scene import Box, Capsule, Fruit, Wood
from hplan.scene.hanging_point import HangingPoint
from hplan.scene.limb_contacts import contact_solids, limbs_of
from hplan.scene.limb_parts import Pushables, depth_and_extension, divide_limbs
from hplan.scene.limb_sweeps import carried_along
from hplan.scene.limbs import Limbs


def farthest_move(pushed: int, point: tuple[int, float], parts: Pushables, limbs: Limbs, random: Any) -> float:
    """Largest displacement of a point on a limb per depth of a part, over many normals and a random place of the part.

    Args:
        pushed: The part, pushed to its whole depth.
        point: Segment of the point, and distance from its start [m].
    """
    depth, extension = depth_and_extension(parts)
    segment, along = int(parts.segment[pushed]), float(random.uniform(*parts.along[pushed]))
    pair = (point[0], segment), (point[1], along)
    places = np.stack([limbs.start[s] + at * limbs.axis[s] for s, at in zip(*pair, strict=True)])
    moved = mutual_compliance(limbs, pair[0], places, Wood().stiffest)
    own = limbs.compliance(segment, along / float(limbs.length[segment]), Wood().stiffest)[:3, :3]
    normals = np.concatenate([random.normal(size=(200, 3)), np.linalg.eigh(own)[1].T])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    # A body at the whole depth in the extended part is less deep in the limb itself.
    left = 1.0 - extension[pushed] / depth[pushed] * np.abs(normals @ parts.stiff_axis[pushed])
    force = np.maximum(left, 0.0) / np.maximum(np.einsum("ki,ij,kj->k", normals, own, normals), 1e-12)
    return float((force * np.linalg.norm(normals @ moved.T, axis=1)).max())


@pytest.mark.parametrize("seed", range(3))
def test_nothing_moves_farther_than_its_bound(seed: int) -> None:
    tree, wood, random = random_tree(seed), Wood(), np.random.default_rng(seed)
    limbs = limbs_of(tree, wood)
    parts = divide_limbs(limbs, wood)
    depth, _ = depth_and_extension(parts)
    stiffness = parts.force / np.maximum(depth, 1e-12)
    carried, nearest = carried_along(parts, stiffness, parts, limbs, wood), 0.0
    chosen = random.permutation(len(carried.pushed))[:400]
    for pushed, item, ratio in zip(*(column[chosen].tolist() for column in carried), strict=True):
        if depth[pushed] <= 0.0:
            continue
        point = int(parts.segment[item]), float(random.uniform(*parts.along[item]))
        found = farthest_move(pushed, point, parts, limbs, random)
        assert found <= ratio * (1.0 + 1e-6)
        nearest = max(nearest, found / ratio)
    assert nearest > 0.5


@pytest.mark.parametrize("seed", range(3))
def test_no_fruit_hangs_from_a_point_that_moves_farther_than_its_bound(seed: int) -> None:
    tree, wood, random = random_tree(seed), Wood(), np.random.default_rng(seed)
    limbs = limbs_of(tree, wood)
    parts, roots, nearest = divide_limbs(limbs, wood), limbs.roots(), 0.0
    stiffness = parts.force / np.maximum(depth_and_extension(parts)[0], 1e-12)
    limits = {
        (limit.segment, limit.along): limit
        for solids in contact_solids(tree, (), wood).values()
        for solid in solids
        if isinstance(solid, Capsule) and (limit := solid.contact_limit) is not None and limit.depth > 0.0
    }
    for row, (pushed, span) in enumerate(zip(parts.segment.tolist(), parts.along.tolist(), strict=True)):
        limit, same = limits.get((pushed, tuple(span))), np.flatnonzero(roots == roots[pushed])
        if limit is None or roots[pushed] < 0:
            continue
        for segment in random.choice(same, min(len(same), 8), replace=False).tolist():
            along = float(random.uniform(0.0, limbs.length[segment]))
            point = HangingPoint(limbs, segment, along, np.zeros((3, 3)), (wood.stiffest, wood.stiffest))
            found = farthest_move(row, (segment, along), parts, limbs, random)
            work = 0.5 * float(stiffness[row])  # of a deflection of 1 m
            bound = point.displacement_by_work(work, 0.0)
            assert found <= bound * (1.0 + 1e-6)
            nearest = max(nearest, found / bound)
    assert nearest > 0.8


def test_a_limb_does_not_press_its_tip_onto_a_rigid_obstacle() -> None:
    box = Box(name="box", center=(0.42, 0.1, 1.0), size=(0.08, 0.18, 0.3))  # 6 mm beside the tip
    free, beside = (
        {limit_of(part).along: part.yields for part in contact_solids(all_of, (), Wood())["twig"][1:]}
        for all_of in ((TRUNK, TWIG), (TRUNK, TWIG, box))
    )
    middle = [along for along in beside if along[1] < 0.35 and beside[along] > 0.0]
    assert middle
    for low, _ in middle:
        # A force at x displaces the tip of a cantilever of the length l by (3 l - x) / (2 x) times the deflection.
        depth = max(depth for along, depth in beside.items() if along[0] == low)
        assert depth * (3.0 * 0.4 - low) / (2.0 * low) <= 0.006
    assert max(beside[along] for along in middle) < 0.5 * max(free[along] for along in free if along[1] < 0.35)


def test_a_fruit_on_a_pushed_limb_is_not_pressed_onto_a_rigid_obstacle() -> None:
    below = Box(name="box", center=(0.4, 0.08, 1.44), size=(0.1, 0.09, 0.05))
    apple = Fruit(name="apple", center=(0.4, 0.0, 0.96), radius=0.03)
    beside = Box(name="box", center=(0.4, 0.08, 0.95), size=(0.1, 0.09, 0.05))  # 5 mm beside the apple
    deepest = [
        max(part.yields for part in contact_solids((TRUNK, TWIG, *boxes), (apple,), Wood())["twig"][1:])
        for boxes in ((), (below,), (beside,))
    ]
    assert deepest[0] == deepest[1]
    assert deepest[2] <= 0.005 < deepest[0]
