"""Clearances of general arms and verified motions, against coal at samples."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from any_arms import SOLIDS, loaded_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.base.arrays import FloatArray
from hplan.collision.coal_shapes import beyond_geometry, solid_shape
from hplan.collision.collision_bodies import body_shapes, collision_bodies
from hplan.collision.compiled_clearance import body_slopes, guessed_slopes
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compiled_motions import piece_is_clear, segment_is_clear
from hplan.collision.compiled_placements import PLACED, place_bodies
from hplan.collision.distance_checker import FAR
from hplan.collision.motion_coefficients import is_moved
from hplan.collision.self_pairs import self_pairs
from hplan.geometry.cloud import Cloud
from hplan.geometry.hull import hull_of
from hplan.robot.model import Robot
from hplan.scene.obstacles import Box, Cylinder, Solid, Sphere

SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module", params=["toy", "capsules"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm(request.param, tmp_path_factory)


@pytest.fixture(scope="module")
def solids() -> list[Solid]:
    """One solid of every kind, and enough balls and tilted boxes to form groups."""
    generator = np.random.default_rng(3)
    points = generator.normal(size=(40, 3))
    return [
        *SOLIDS,
        hull_of(np.array([0.1, -0.6, 0.9]) + 0.12 * points / np.linalg.norm(points, axis=1)[:, None], "stone"),
        Cloud.from_points("leaves", np.array([0.3, 0.6, 0.7]) + 0.1 * generator.normal(size=(300, 3)), 0.01),
        *(Sphere(name="fruit", center=tuple(generator.uniform(-1.2, 1.2, 3)), radius=0.03) for _ in range(24)),
        *(
            Box(
                name="block", center=tuple(generator.uniform(-1.2, 1.2, 3)), size=(0.1, 0.04, 0.06), rpy_deg=tuple(turn)
            )
            for turn in generator.uniform(-90.0, 90.0, (16, 3)).tolist()
        ),
    ]


def by_coal(robot: Robot, solids: list[Solid], q: FloatArray) -> FloatArray:
    """(movers,) clearances of bodies and pairs by coal, cylinders as the prisms that kernels know."""
    bodies, shapes, checked = collision_bodies(robot), body_shapes(robot), self_pairs(robot).checked
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    exact = [coal.Convex if body.kind == "cylinder" else None for body in bodies]
    placed = [(shape.geometry, data.oMi[shape.parentJoint] * shape.placement) for shape in shapes]
    for number, body in enumerate(bodies):
        if exact[number] is not None:
            hull = solid_shape(hull_of(body.core, most=len(body.core) + 14))
            placed[number] = (hull.geometry, data.oMi[shapes[number].parentJoint] * hull.placement)
    others = []
    for solid in solids:
        hulls: list[Solid] = [solid]
        if isinstance(solid, Cylinder):
            hulls = [hull_of(solid.core, most=len(solid.core) + 14)]
        elif isinstance(solid, Cloud):
            hulls = [Sphere(name="leaf", center=tuple(point), radius=solid.rounding) for point in solid.core]
        others += [(solid_shape(hull), beyond_geometry(hull)) for hull in hulls]

    def distance(
        first: tuple[coal.CollisionGeometry, pin.SE3], second: tuple[coal.CollisionGeometry, pin.SE3]
    ) -> float:
        places = [coal.Transform3s(place.rotation, place.translation) for _, place in (first, second)]
        request = coal.DistanceRequest()
        request.gjk_tolerance = 1e-9
        return float(coal.distance(first[0], places[0], second[0], places[1], request, coal.DistanceResult()))

    def clearance(place: tuple[coal.CollisionGeometry, pin.SE3]) -> float:
        return min(distance(place, (shape.geometry, shape.placement)) - beyond for shape, beyond in others)

    found = [clearance(place) if moved else np.inf for moved, place in zip(is_moved(robot), placed, strict=True)]
    return np.array([*found, *(distance(placed[i], placed[j]) for i, j in checked)])


def test_bodies_are_where_pinocchio_has_them(arm: Robot) -> None:
    field = ClearanceField.build(arm, [])
    bodies = collision_bodies(arm)
    placed, frames = np.empty(len(field.arm.bodies), PLACED), np.empty((arm.dof + 1, 12))
    for q in np.random.default_rng(0).uniform(arm.lower, arm.upper, (20, arm.dof)):
        place_bodies(q, field.arm.bodies, field.arm.joints, frames, placed)
        assert len(placed) == len(bodies)
        data = arm.model.createData()
        pin.forwardKinematics(arm.model, data, q)
        for body, row, mover in zip(bodies, placed, field.arm.bodies, strict=False):
            place = data.oMi[body.joint + 1]
            frame = frames[mover["joint"]]
            assert frame[:9].reshape(3, 3) == pytest.approx(place.rotation, abs=1e-12)
            assert frame[9:12] == pytest.approx(place.translation, abs=1e-12)
            corners = body.core @ place.rotation.T + place.translation
            away = np.linalg.norm(corners - row["centre"], axis=1).max() + body.rounding
            assert away - 1e-12 <= mover["ball_radius"] <= 1.3 * away
            along = row["along"]
            at = np.clip((corners - row["start"]) @ along / max(along @ along, 1e-30), 0.0, 1.0)
            beside = np.linalg.norm(corners - row["start"] - np.outer(at, along), axis=1).max() + body.rounding
            assert beside - 1e-12 <= mover["axis_radius"]
            assert mover["ball"] @ place.rotation.T + place.translation == pytest.approx(row["centre"])
            assert mover["axis_start"] @ place.rotation.T + place.translation == pytest.approx(row["start"])


@given(SEEDS)
@settings(max_examples=25)
def test_clearances_are_those_of_coal(arm: Robot, solids: list[Solid], seed: int) -> None:
    field = ClearanceField.build(arm, solids)
    q = np.random.default_rng(seed).uniform(arm.lower, arm.upper)
    found, expected = field.link_clearances(q), by_coal(arm, solids, q)
    apart = (expected > 0.0) & (expected < FAR)
    assert found[apart] == pytest.approx(expected[apart], rel=1e-6, abs=1e-7)
    assert (found[expected >= FAR] == FAR).all()
    assert (found[expected <= 0.0] <= 1e-9).all()


def test_grown_obstacles_and_deviations_leave_less(arm: Robot, solids: list[Solid]) -> None:
    q = np.array([0.3, 0.5, 0.4, -0.3, 0.5, 0.2])[: arm.dof]
    plain = ClearanceField.build(arm, solids).link_clearances(q)
    bodies = len(collision_bodies(arm))
    near = plain < FAR - 0.05
    grown = ClearanceField.build(arm, solids, clearance=0.01, own_clearance=0.0).link_clearances(q)
    moving = near & (np.arange(len(near)) < bodies)
    assert grown[moving] == pytest.approx(plain[moving] - 0.01, abs=1e-9)
    assert grown[bodies:] == pytest.approx(plain[bodies:])
    swaying = ClearanceField.build(arm, solids, deviation=0.01).link_clearances(q)
    bounds = 0.01 * ClearanceField.build(arm, solids).reaches.sum(axis=1)
    assert swaying[near] == pytest.approx((plain - bounds)[near], abs=1e-9)


@given(SEEDS)
@settings(max_examples=40)
def test_motions_shown_clear_are_clear(arm: Robot, solids: list[Solid], seed: int) -> None:
    field = ClearanceField.build(arm, solids)
    generator = np.random.default_rng(seed)
    start = generator.uniform(arm.lower, arm.upper)
    ends = start + generator.uniform(-0.4, 0.4, (3, arm.dof))
    along = start + np.linspace(0.0, 1.0, 40)[:, None] * (ends[2] - start)
    least = field.spare_clearances(along).min()
    shown = bool(segment_is_clear(start, ends[2], field.arrays, 1e-3))
    assert shown == field.is_clear([start, ends[2]], 1e-3)
    assert not shown or least > 5e-4
    assert shown or least < 2e-3
    for margin in (1e-3, 0.05):
        clear = field.spare_clearance(start)
        stays = bool(segment_is_clear(start, start, field.arrays, margin))
        assert stays == (clear >= margin) or abs(clear - margin) < 0.03 * margin
        assert segment_is_clear(start, ends[2], field.arrays, margin) or least < 2.0 * margin
    piece = np.stack([start, *ends])
    t = np.linspace(0.0, 1.0, 40)[:, None]
    curve = (1 - t) ** 3 * piece[0] + 3 * (1 - t) ** 2 * t * piece[1] + 3 * (1 - t) * t**2 * piece[2] + t**3 * piece[3]
    assert not piece_is_clear(piece, field.arrays, 1e-3, 0.0) or field.spare_clearances(curve).min() > 5e-4


@given(SEEDS)
@settings(max_examples=25)
def test_slopes_do_not_depend_on_guesses(arm: Robot, solids: list[Solid], seed: int) -> None:
    rng, field = np.random.default_rng(seed), ClearanceField.build(arm, solids)
    q, joints = rng.uniform(arm.lower, arm.upper), np.arange(arm.dof)
    clear, gradient = np.empty((2, field.count)), np.empty((2, field.count, arm.dof))
    body_slopes(q, field.arrays, joints, 0.3, clear[0], gradient[0])
    guesses = np.maximum(clear[0], 0.0) + rng.choice([-0.01, 1e-9, 0.01, 0.5], field.count)
    guessed_slopes(q, field.arrays, joints, 0.3, guesses, clear[1], gradient[1])
    assert (clear[0] < 0.3).any()
    np.testing.assert_array_equal(clear[1], clear[0])
    np.testing.assert_array_equal(gradient[1], gradient[0])


@given(SEEDS)
@settings(max_examples=25)
def test_gradients_are_those_of_differences(arm: Robot, solids: list[Solid], seed: int) -> None:
    field = ClearanceField.build(arm, solids)
    q = np.random.default_rng(seed).uniform(arm.lower, arm.upper)
    joints = np.array([0, 1, 2, 4, 5] if arm.dof > 4 else [0, 1, 3])
    clear, gradient = np.empty(field.count), np.empty((field.count, len(joints)))
    body_slopes(q, field.arrays, joints, FAR, clear, gradient)
    assert clear == pytest.approx(field.link_clearances(q), abs=1e-9)
    step = 1e-6
    for column, joint in enumerate(joints.tolist()):
        off = step * (np.arange(arm.dof) == joint)
        ahead, behind = field.link_clearances(q + off), field.link_clearances(q - off)
        forward, backward = (ahead - clear) / step, (clear - behind) / step
        # If the two one-sided derivatives agree, the nearest points do not jump.
        smooth = (np.abs(forward - backward) < 1e-3) & (clear < FAR - 1e-3)
        assert gradient[smooth, column] == pytest.approx(0.5 * (forward + backward)[smooth], abs=2e-3)
