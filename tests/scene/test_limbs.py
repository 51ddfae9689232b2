"""Limbs: their graph, and their compliance beside a numerical integration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from limb_reference import mutual_compliance

from hplan.base.arrays import FloatArray
from hplan.errors import SceneError
from hplan.scene import Capsule
from hplan.scene.limbs import TWIST_RATIO, Limbs, find_parents

MODULUS = 3e9


def random_chain(seed: int) -> list[Capsule]:
    """A clamped chain of four thin segments in random directions."""
    random = np.random.default_rng(seed)
    at = np.zeros(3)
    chain = [Capsule(name="trunk", start=(0.0, 0.0, -1.0), end=(0.0, 0.0, 0.0), radius=0.02)]
    for number in range(4):
        step = random.normal(size=3)
        end = at + step * random.uniform(0.05, 0.3) / np.linalg.norm(step)
        chain.append(
            Capsule(
                name=f"twig {number}", start=tuple(at.tolist()), end=tuple(end.tolist()),
                radius=random.uniform(0.002, 0.007), parent="trunk" if number == 0 else f"twig {number - 1}",
            )
        )  # fmt: skip
        at = end
    return chain


def skew(d: FloatArray) -> FloatArray:
    return np.array([[0.0, -d[2], d[1]], [d[2], 0.0, -d[0]], [-d[1], d[0], 0.0]])


def integrated(chain: list[Capsule], points: tuple[FloatArray, FloatArray], lengths: list[float]) -> FloatArray:
    """(6, 6) displacement and rotation at the first point by force and moment at the second, by the midpoint rule."""
    found = np.zeros((6, 6))
    for twig, part in zip(chain[1:], lengths, strict=False):
        start, end = np.array(twig.start), np.array(twig.end)
        axis = (end - start) / np.linalg.norm(end - start)
        bend = MODULUS * 0.25 * math.pi * twig.radius**4
        soft = (np.eye(3) - np.outer(axis, axis) + np.outer(axis, axis) / TWIST_RATIO) / bend
        for s in (np.arange(1500) + 0.5) / 1500.0 * part:
            at = start + s * axis
            first, second = (np.hstack([skew(point - at), np.eye(3)]) for point in points)
            found += first.T @ soft @ second * part / 1500.0
    return found


@pytest.mark.parametrize("seed", range(3))
def test_compliance_is_the_integral_over_the_path(seed: int) -> None:
    chain = random_chain(seed)
    limbs = Limbs.of(chain)
    last = limbs.names.index("twig 3")
    point = limbs.start[last] + 0.7 * (limbs.end[last] - limbs.start[last])
    lengths = [*limbs.length[1:4], 0.7 * limbs.length[last]]
    wanted = integrated(chain, (point, point), lengths)
    found = limbs.compliance(last, 0.7, MODULUS)
    for rows in (slice(0, 3), slice(3, 6)):
        for columns in (slice(0, 3), slice(3, 6)):
            size = np.abs(wanted[rows, columns]).max()
            np.testing.assert_allclose(found[rows, columns], wanted[rows, columns], atol=1e-5 * size)


def test_mutual_compliance_is_the_integral_over_the_shared_path() -> None:
    chain = random_chain(5)
    limbs = Limbs.of(chain)
    numbers = limbs.names.index("twig 3"), limbs.names.index("twig 1")
    points = np.stack([limbs.end[numbers[0]], 0.5 * (limbs.start + limbs.end)[numbers[1]]])
    lengths = [float(limbs.length[1]), 0.5 * float(limbs.length[2])]
    wanted = integrated(chain, (points[0], points[1]), lengths)[:3, :3]
    found = mutual_compliance(limbs, numbers, points, MODULUS)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())
    # A force on one limb displaces the other as much as the reverse.
    back = mutual_compliance(limbs, numbers[::-1], points[::-1], MODULUS)
    np.testing.assert_allclose(found, back.T, atol=1e-12 * np.abs(wanted).max())


def test_derivative_along_an_axis() -> None:
    limbs = Limbs.of(random_chain(1))
    number, at, step = np.array([limbs.names.index("twig 2")]), np.array([0.03]), 1e-5
    slope = limbs.compliance_along(number, at)[1][0]
    ends = [limbs.compliance_along(number, at + side * step)[0][0] for side in (1.0, -1.0)]
    wanted = (ends[0] - ends[1]) / (2.0 * step)
    np.testing.assert_allclose(slope, wanted, atol=1e-6 * np.abs(wanted).max())


def test_stress_of_a_cantilever() -> None:
    trunk = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
    twig = Capsule(name="twig", start=(0.0, 0.0, 1.0), end=(0.4, 0.0, 1.0), radius=0.004, parent="trunk")
    limbs = Limbs.of([trunk, twig])
    stress = limbs.stress_per_force(np.array([1]), np.array([[0.3, 0.0, 1.0]]))
    assert stress[0] == pytest.approx(0.3 * 0.004 / (0.25 * math.pi * 0.004**4))


def test_segments_are_turned_towards_their_root() -> None:
    trunk = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
    twig = Capsule(name="twig", start=(0.4, 0.0, 1.0), end=(0.02, 0.0, 1.0), radius=0.004, parent="trunk")
    limbs = Limbs.of([twig, trunk])
    assert limbs.start[0].tolist() == [0.02, 0.0, 1.0]
    assert limbs.joint[0].tolist() == [0.0, 0.0, 1.0]
    assert limbs.path(0) == (0,)
    assert limbs.path(1) == ()


def test_parents_are_found_from_the_trunk_on() -> None:
    trunk = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
    branch = Capsule(name="branch", start=(0.03, 0.0, 1.0), end=(0.5, 0.0, 1.1), radius=0.01)
    twig = Capsule(name="twig", start=(0.5, 0.0, 1.1), end=(0.7, 0.1, 1.2), radius=0.004)
    alone = Capsule(name="alone", start=(0.5, 0.5, 1.1), end=(0.7, 0.6, 1.2), radius=0.004)
    assert find_parents([alone, twig, branch, trunk]) == {"branch": "trunk", "twig": "branch"}
    assert find_parents([]) == {}


def test_a_limb_is_not_its_own_ancestor() -> None:
    one = Capsule(name="one", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 1.0), radius=0.004, parent="other")
    other = Capsule(name="other", start=(0.0, 0.0, 1.0), end=(0.0, 0.0, 2.0), radius=0.004, parent="one")
    with pytest.raises(SceneError, match="among its own ancestors"):
        Limbs.of([one, other])
