"""How far contacts displace the point of a limb that a fruit hangs from: bounds beside random pushes."""

from __future__ import annotations

import numpy as np
import pytest

import hplan.scene
from hplan.base.arrays import FloatArray
from hplan.scene import Capsule, Scene, Wood
from hplan.scene.hanging_point import HangingPoint, largest_ratio
from hplan.scene.limb_contacts import limbs_of
from hplan.scene.limb_parts import depth_and_extension, divide_limbs


def drawn(seed: int) -> tuple[FloatArray, FloatArray, float]:
    """A displacement per force, a compliance that may vanish along one axis, and a largest stiffness."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(3, 3)) * np.exp(random.normal(size=3))
    sizes, axes = np.linalg.eigh(root @ root.T)
    sizes[0] *= seed % 3 > 0
    own = (axes * sizes) @ axes.T
    moved = random.normal(size=(3, 3)) @ (own if seed % 2 else np.eye(3))
    return moved, own, float(np.exp(random.normal()) / sizes[1])


def searched(moved: FloatArray, own: FloatArray, stiffest: float) -> float:
    """The largest ratio among random normals, and among ever nearer ones to the best of them."""
    random, best, largest = np.random.default_rng(0), np.zeros(3), 0.0
    for spread in [np.inf, *np.geomspace(0.1, 1e-5, 30)]:
        normals = random.normal(size=(2000, 3))
        normals = normals if np.isinf(spread) else best + spread * normals
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        per_force = np.einsum("ni,ij,nj->n", normals, own, normals)
        ratios = np.linalg.norm(normals @ moved.T, axis=1) * np.minimum(1.0 / np.maximum(per_force, 1e-300), stiffest)
        if ratios.max() > largest:
            largest, best = float(ratios.max()), normals[ratios.argmax()]
    return largest


@pytest.mark.parametrize("seed", range(24))
def test_no_normal_exceeds_the_largest_ratio(seed: int) -> None:
    moved, own, stiffest = drawn(seed)
    found, wanted = largest_ratio(moved, own, stiffest), searched(moved, own, stiffest)
    assert wanted <= found * (1.0 + 1e-9)
    assert found < 1.1 * wanted


def test_nothing_moves_where_nothing_carries_both() -> None:
    assert largest_ratio(np.zeros((3, 3)), np.eye(3), 5.0) == 0.0


def test_rigid_wood_transmits_the_largest_force() -> None:
    assert largest_ratio(np.diag([1.0, 2.0, 3.0]), np.zeros((3, 3)), 5.0) == pytest.approx(15.0)


def tree(seed: int) -> Scene:
    """A trunk with a limb of three segments and a spur at each fork, and a fruit at one of them."""
    random, at = np.random.default_rng(seed), np.array([0.0, 0.0, 1.0])
    pieces = [Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)]
    for number in range(3):
        parent = pieces[0].name if number == 0 else f"limb {number - 1}"
        end = at + np.array([0.2, *random.normal(scale=0.1, size=2)])
        ends = tuple(at.tolist()), tuple(end.tolist())
        pieces.append(Capsule(name=f"limb {number}", start=ends[0], end=ends[1], radius=0.006, parent=parent))
        tip = tuple((end + random.normal(scale=0.08, size=3)).tolist())
        pieces.append(Capsule(name=f"spur {number}", start=ends[1], end=tip, radius=0.003, parent=f"limb {number}"))
        at = end
    place = np.array(pieces[2 * int(random.integers(1, 4))].end) - [0.0, 0.0, 0.05]
    apple = hplan.scene.Fruit(name="apple", center=tuple(place.tolist()), radius=0.035)
    start = hplan.scene.Start(joints_deg=(0.0, 90.0, 90.0, 90.0))
    goal = hplan.scene.Goal(fruit="apple")
    return Scene(name="tree", start=start, goal=goal, obstacles=tuple(pieces), fruits=(apple,), wood=Wood())


@pytest.mark.parametrize("seed", range(4))
def test_no_push_of_a_limb_displaces_a_fruit_farther_than_its_bound(seed: int) -> None:
    scene, random = tree(seed), np.random.default_rng(seed)
    assert scene.wood is not None
    limbs = limbs_of(scene.obstacles, scene.wood)
    parts = divide_limbs(limbs, scene.wood)
    depth, extension = depth_and_extension(parts)
    limits = [solid.contact_limit for solid in scene.listed_solids if solid.contact_limit is not None]
    (point,) = (limit.displacement for limit in limits if limit.displacement is not None)
    assert isinstance(point, HangingPoint)
    here = limbs.start[point.segment] + point.along * limbs.axis[point.segment]
    shares = list[float]()
    for limit in limits:
        if limit.displacement is not None or limit.depth < 5e-4:
            continue
        same = (parts.segment == limit.segment) & np.isclose(parts.along, limit.along).all(axis=1)
        row, largest = int(np.flatnonzero(same)[0]), 0.0
        for along in np.linspace(*limit.along, 7):
            places = np.stack([here, limbs.start[limit.segment] + along * limbs.axis[limit.segment]])
            modulus = random.uniform(*point.youngs_modulus)
            moved = limbs.mutual_compliance((point.segment, limit.segment), places, modulus)
            own = limbs.compliance(limit.segment, along / limbs.length[limit.segment], modulus)[:3, :3]
            normals = random.normal(size=(400, 3))
            normals /= np.linalg.norm(normals, axis=1)[:, None]
            # A part is extended along its stiff axis, so less of a push along it is deflection.
            left = 1.0 - extension[row] / depth[row] * np.abs(normals @ parts.stiff_axis[row])
            per_depth = left / np.einsum("ni,ij,nj->n", normals, own, normals)
            largest = max(largest, float((per_depth * np.linalg.norm(normals @ moved.T, axis=1)).max()))
        shares.append(largest / point(limit)[0])
        # The outer end stands for all places.
        assert point(limit)[0] == max(point(limit._replace(along=(along, along)))[0] for along in limit.along)
    assert len(shares) > 5
    assert max(shares) <= 1.0 + 1e-9
    assert max(shares) > 0.6
