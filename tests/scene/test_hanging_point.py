"""How far a fruit on its stalk and limb can be displaced: bounds beside random pushes."""

from __future__ import annotations

import numpy as np
import pytest
from limb_reference import mutual_compliance

import hplan.scene
from hplan.scene import Capsule, Scene, Wood
from hplan.scene.hanging_point import HangingPoint
from hplan.scene.limb_contacts import limbs_of
from hplan.scene.limb_parts import depth_and_extension, divide_limbs


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
        bound = point.displacement_by_work(0.5 * limit.depth * limit.force, 0.0)
        for along in np.linspace(*limit.along, 7):
            places = np.stack([here, limbs.start[limit.segment] + along * limbs.axis[limit.segment]])
            modulus = random.uniform(*point.youngs_modulus)
            moved = mutual_compliance(limbs, (point.segment, limit.segment), places, modulus)
            own = limbs.compliance(limit.segment, along / limbs.length[limit.segment], modulus)[:3, :3]
            normals = random.normal(size=(400, 3))
            normals /= np.linalg.norm(normals, axis=1)[:, None]
            # A part is extended along its stiff axis, so less of a push along it is deflection.
            deflection = limit.depth - extension[row] * limit.depth / depth[row] * np.abs(
                normals @ parts.stiff_axis[row]
            )
            force = deflection / np.einsum("ki,ij,kj->k", normals, own, normals)
            largest = max(largest, float((force * np.linalg.norm(normals @ moved.T, axis=1)).max()))
        shares.append(largest / bound)
    assert len(shares) > 5
    assert max(shares) <= 1.0
    assert max(shares) > 0.2


def test_work_on_a_fruit_may_swing_it_alone_or_bend_its_limb() -> None:
    scene = tree(0)
    limits = [solid.contact_limit for solid in scene.listed_solids if solid.contact_limit is not None]
    (point,) = (limit.displacement for limit in limits if limit.displacement is not None)
    assert isinstance(point, HangingPoint)
    hung_at = point.limbs.start[point.segment] + point.along * point.limbs.axis[point.segment]
    length, weight = np.linalg.norm(np.array(scene.fruits[0].center) - hung_at), 9.81 * limits[-1].mass
    for angle in (0.1, 0.5, 1.0):  # the chord and the energy of a pendulum, at any angle
        chord, energy = 2.0 * length * np.sin(0.5 * angle), weight * length * (1.0 - np.cos(angle))
        assert chord <= point.displacement_by_work(0.0, energy)
    modulus = point.youngs_modulus[0]
    limb = point.limbs.compliance(point.segment, point.along / point.limbs.length[point.segment], modulus)[:3, :3]
    for normal in np.linalg.eigh(limb)[1].T:  # a static force on the softest limb
        bent = 0.5 * float(np.linalg.norm(limb @ normal))
        assert bent <= point.displacement_by_work(0.0, 0.5 * 0.5 * bent)
