"""Both distance back ends answer the questions of `DistanceChecker` alike."""

from __future__ import annotations

import numpy as np
import pytest
from any_arms import SOLIDS, loaded_arm

from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.distance_checker import FAR, DistanceChecker
from hplan.geometry.cloud import Cloud
from hplan.geometry.hull import hull_of
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene.obstacles import Cylinder, Solid, Sphere

#: coal's tolerance, and distances that either side may call contact [m].
TOLERANCE = 2e-6

#: Clearances beyond all of the scenes [m].
ALL = 100.0

#: The displacement bounds of the back ends differ by at most this fraction.
SWAYS_DIFFER = 0.01


@pytest.fixture(scope="module", params=["panda", "ur5", "harvester"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    if request.param == "harvester":
        return request.getfixturevalue("robot")
    return loaded_arm(request.param, tmp_path_factory)


def solids() -> list[Solid]:
    """One solid of every kind; the fruit may give way."""
    rng = np.random.default_rng(3)
    points = rng.normal(size=(40, 3))
    return [
        *SOLIDS,
        hull_of(np.array([0.1, -0.6, 0.9]) + 0.12 * points / np.linalg.norm(points, axis=1)[:, None], "stone"),
        Cloud.from_points("leaves", np.array([0.3, 0.6, 0.7]) + 0.1 * rng.normal(size=(300, 3)), 0.01),
        Sphere(name="fruit", center=(0.4, -0.3, 0.5), radius=0.05, yields=0.02, sigma=0.004),
    ]


def back_ends(world: World) -> tuple[DistanceChecker, DistanceChecker]:
    return world.field, world.checker


def most_excess(robot: Robot) -> float:
    """Largest amount by which the kernels' bodies and cylinders may be nearer than coal's [m]."""
    posts = max(solid.excess for solid in SOLIDS if isinstance(solid, Cylinder))
    return posts + 2.0 * max(body.growth for body in collision_bodies(robot))


@pytest.mark.parametrize(
    ("clearance", "deviation", "touched"),
    [(0.0, 0.0, None), (0.015, 0.0, None), (0.01, 0.004, None), (0.01, 0.002, "ball")],
    ids=["contact", "clearance", "tracking error", "may touch"],
)
def test_back_ends_agree(arm: Robot, clearance: float, deviation: float, touched: str | None) -> None:
    world = World.build(arm, solids(), clearance=clearance, tracking_error=deviation, sigmas=2.0)
    compiled, coal = back_ends(world if touched is None else world.allow_touch(touched))
    q = np.random.default_rng(7).uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi), (150, arm.dof))
    by_kernels, by_coal = (checker.spare_clearances(q, ALL) for checker in (compiled, coal))
    assert by_kernels.shape == by_coal.shape == (len(q),)
    near = TOLERANCE + SWAYS_DIFFER * float(world.checker.required_distances[1].max())
    assert (by_kernels <= np.maximum(by_coal, 0.0) + near).all()
    far = near + most_excess(arm)
    apart = by_coal > far
    assert apart.sum() >= 5
    assert (by_kernels[apart] >= by_coal[apart] - far).all()
    for margin in (0.0, 0.005):
        masks = compiled.in_collision(q, margin=margin), coal.in_collision(q, margin=margin)
        decided = (by_coal < margin - near) | (by_coal > margin + far)
        np.testing.assert_array_equal(masks[0][decided], masks[1][decided])
        assert masks[1].any()
        assert not masks[1].all()
    for checker, found in ((compiled, by_kernels), (coal, by_coal)):
        assert checker.spare_clearance(q[0]) == pytest.approx(min(found[0], FAR), abs=TOLERANCE)


def test_no_obstacles_and_no_configurations(arm: Robot) -> None:
    for checker in back_ends(World.build(arm, ())):
        assert checker.spare_clearance(0.5 * (arm.lower + arm.upper), 1e-3) == 1e-3
        assert checker.spare_clearances(np.zeros((0, arm.dof))).shape == (0,)
        assert checker.in_collision(np.zeros((0, arm.dof))).shape == (0,)


def test_spare_clearance_of_world_is_a_close_bound_of_coals(arm: Robot) -> None:
    """The compiled distances decide where they are clear of the obstacles; they are lower bounds."""
    world = World.build(arm, solids(), clearance=0.01, tracking_error=0.002)
    q = np.random.default_rng(8).uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi), (40, arm.dof))
    free = q[world.checker.spare_clearances(q) > 0.0]
    assert len(free)
    sway = SWAYS_DIFFER * float(world.checker.required_distances[1].max())
    for row in free:
        found, exact = world.check_clear(row, "here"), min(world.checker.spare_clearance(row, ALL), FAR)
        assert exact - sway - most_excess(arm) - TOLERANCE <= found <= exact + sway + TOLERANCE
