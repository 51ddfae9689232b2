"""coal's distances against exact ones: never above them by more than what the proof takes off."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from hplan.certificate.certificate import certify
from hplan.collision.coal_accuracy import CURVED, ITERATION, PARALLEL, SIZE, distance_errors
from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import solid_shape
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Cylinder, Sphere
from hplan.trajectory.trajectory import Trajectory


def turned(z, rng):
    """(3, 3) rotation with a given last axis."""
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def segments_apart(a, b, c, d):
    """Distance of two segments that are apart in their common plane, or nearly, in long doubles."""
    a, b, c, d = (np.asarray(point, dtype=np.longdouble) for point in (a, b, c, d))

    def from_segment(point, begin, end):
        along = end - begin
        share = np.clip(((point - begin) @ along) / (along @ along), 0.0, 1.0)
        return np.sqrt(((point - begin - share * along) ** 2).sum())

    return min(from_segment(a, c, d), from_segment(b, c, d), from_segment(c, a, b), from_segment(d, a, b))


def capsule_object(radius, length):
    return pin.GeometryObject("capsule", 0, 0, pin.SE3.Identity(), coal.Capsule(radius, length))


@pytest.mark.parametrize(("first", "second"), [(1.0, 1.0), (1.0, 0.05), (0.05, 0.05), (0.005, 1.0), (0.005, 0.005)])
def test_nearly_parallel_capsules(first, second):
    rng, worst, radius = np.random.default_rng(3), 0.0, 0.01
    obstacle = Capsule(name="c", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, second), radius=radius)
    allowed = distance_errors([capsule_object(radius, first)], [obstacle], [])[0]
    for _ in range(1500):
        angle = 10.0 ** rng.uniform(-8.5, -6.5) / (first * second) * rng.choice([-1.0, 1.0])
        along, aside = np.eye(3)[:2]
        other = along * np.cos(angle) + aside * np.sin(angle)
        center = aside * rng.uniform(0.03, 0.1) + along * rng.uniform(-0.5, 0.5) * (first + second)
        ends = [0.5 * first * along, 0.5 * second * other]
        true = segments_apart(-ends[0], ends[0], center - ends[1], center + ends[1]) - 2 * np.longdouble(radius)
        found = coal.distance(
            coal.Capsule(radius, first), coal.Transform3s(turned(along, rng), np.zeros(3)),
            coal.Capsule(radius, second), coal.Transform3s(turned(other, rng), center),
            coal.DistanceRequest(), coal.DistanceResult(),
        )  # fmt: skip
        worst = max(worst, float(found - true))
    assert worst <= allowed
    # What is allowed for is really there.
    assert worst > 0.8 * PARALLEL / max(first, second)


@pytest.mark.parametrize("size", [1.0, 1e2, 1e4])
def test_capsules_above_large_boxes(size):
    rng = np.random.default_rng(4)
    box = Box(name="b", center=(0.0, 0.0, -0.5 * size), size=(size,) * 3)
    allowed = distance_errors([capsule_object(0.05, 1.0)], [box], [])[0]
    assert allowed >= SIZE * size
    placed = solid_shape(box)
    for _ in range(500):
        along = rng.normal(size=3)
        along /= np.linalg.norm(along)
        gap = 10.0 ** rng.uniform(-5.0, 0.0)
        center = np.array([*rng.uniform(-0.3, 0.3, 2) * size, gap + 0.05 + 0.5 * abs(along[2])])
        if size < 10.0:
            center[:2] = 0.0
        found = coal.distance(
            coal.Capsule(0.05, 1.0), coal.Transform3s(turned(along, rng), center),
            placed.geometry, coal.Transform3s(placed.placement.rotation, placed.placement.translation),
            coal.DistanceRequest(), coal.DistanceResult(),
        )  # fmt: skip
        if size >= 10.0 or abs(along[2]) > 0.9:
            assert found - gap <= allowed


def from_cylinder(points, cylinder):
    """Distances of (k, 3) points from a cylinder that stands on z at the origin."""
    beyond = np.abs(points[:, 2]) - 0.5 * cylinder.length
    outside = np.hypot(points[:, 0], points[:, 1]) - cylinder.radius
    return np.hypot(np.maximum(beyond, 0.0), np.maximum(outside, 0.0))


def least_along(start, end, cylinder):
    """Distance of a segment from it, a convex function along the segment, by ever finer rasters."""
    low, high = 0.0, 1.0
    for _ in range(12):
        share = np.linspace(low, high, 33)
        apart = from_cylinder(start + share[:, None] * (end - start), cylinder)
        at = int(apart.argmin())
        low, high = share[max(at - 1, 0)], share[min(at + 1, 32)]
    return apart.min()


@pytest.mark.parametrize("farthest", [0.05, 10.0])
@pytest.mark.parametrize("sizes", [(0.003, 0.5), (1.0, 100.0)])
def test_capsules_about_cylinders(sizes, farthest):
    rng, over = np.random.default_rng(6), []
    for _ in range(300):
        length, radius = np.exp(rng.uniform(*np.log(sizes), 2))
        can = Cylinder(name="c", center=(0.0, 0.0, 0.0), length=length, radius=radius)
        placed, reach = solid_shape(can).geometry, rng.uniform(0.05, 1.5)
        allowed = distance_errors([capsule_object(0.05, reach)], [can], [])[0]
        along, away = rng.normal(size=(2, 3)) * [1.0, 1.0, rng.choice([0.0, 1.0])]
        along, away = (ray / np.linalg.norm(ray) for ray in (along, away))
        shares = rng.permutation([1.0, rng.random(), 1.0])[:2]  # on the side, an end, or the rim between them
        aside = shares[0] * radius * away[:2] / np.linalg.norm(away[:2])
        start = np.append(aside, np.copysign(shares[1] * 0.5 * length, away[2])) + away * (
            0.05 + farthest * rng.random()
        )
        end = start + along * reach
        expected = least_along(start, end, can) - 0.05
        found = coal.distance(
            coal.Capsule(0.05, reach), coal.Transform3s(turned(along, rng), 0.5 * (start + end)),
            placed, coal.Transform3s(np.eye(3), np.zeros(3)), coal.DistanceRequest(), coal.DistanceResult(),
        )  # fmt: skip
        if expected > 0.0:
            assert found - expected <= allowed
            over.append(found - expected)
        else:
            assert found <= 1e-6
    assert len(over) > 100
    # What is allowed for is needed, far away.
    assert max(over) > (0.0 if farthest < 1.0 else 0.3 * CURVED)


def test_one_for_each_pair(robot):
    obstacles = [
        Sphere(name="s", center=(3.0, 0.0, 0.0), radius=0.5),
        Capsule(name="c", start=(3.0, 0.0, 0.0), end=(3.0, 0.0, 0.01), radius=0.1),
        Box(name="b", center=(3.0, 0.0, 0.0), size=(30.0, 40.0, 0.1)),
    ]
    checker = CoalScene(robot, obstacles)
    errors = checker.distance_errors
    assert errors.shape == (len(checker.pairs),)
    table = errors[: 3 * len(checker.link_names)].reshape(-1, 3)
    lengths = robot.arm.lengths
    np.testing.assert_allclose(table[:, 1] - table[:, 0], PARALLEL / lengths, atol=2e-9)
    np.testing.assert_allclose(table[:, 2], ITERATION + 50.0 * SIZE, rtol=1e-4)
    np.testing.assert_array_equal(checker.touching("s").distance_errors, errors)


def test_the_proof_takes_them_off(robot, monkeypatch):
    """At rest, half of what there is to spare is shown: of the distance, less the error."""
    zero = np.zeros((1, 4))
    still = Trajectory(
        robot.joint_names, np.zeros(1), zero, zero, zero, robot.dynamics.torques(zero, zero, zero), robot.slides
    )
    ball = Sphere(name="s", center=(1.0, 0.0, 1.0), radius=0.2)
    rest = (0.0,) * 4
    scene = Scene(name="s", start=Start(joints_rad=rest), goal=Goal(joints_rad=rest), obstacles=(ball,))
    found = certify(robot, scene, still)
    errors = CoalScene(robot, scene.solids).distance_errors
    assert found.verified
    assert found.min_clearance_m == pytest.approx(0.5 * (found.nearest.distance_m - errors[0]), rel=1e-9)
    wide = CoalScene(robot, scene.solids)
    wide.distance_errors = errors + found.nearest.distance_m
    assert not certify(robot, scene, still, checker=wide).verified
