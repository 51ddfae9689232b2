"""Certified segments of motions against samples, and their motion bounds."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from any_arms import LIFT, SOLIDS, limb, loaded_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.base.arrays import FloatArray
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.compiled_clearance import body_clearances
from hplan.collision.compiled_cover import moving_arm, part_shown_clear
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compiled_placements import place_joints
from hplan.collision.compiled_twists import MOVING, TWIST, find_twists, motion_bends
from hplan.collision.distance_checker import FAR
from hplan.collision.self_pairs import self_pairs
from hplan.geometry.cloud import Cloud
from hplan.geometry.sweep import Sweep, used_up
from hplan.robot.model import Robot, load_robot
from hplan.scene.obstacles import Box, Solid, Sphere

SEEDS = st.integers(0, 2**32 - 1)

#: Two arms on the column of `LIFT`: neither body carries the other.
FORK = LIFT.replace(
    "</robot>",
    limb("left", "column_link", "revolute", "0 0 1", "0.2 0.3 0.3", '<box size="0.05 0.1 0.2"/>')
    + limb("hand", "left_link", "revolute", "1 0 0", "0 0.2 0.1", '<box size="0.1 0.05 0.1"/>')
    + "</robot>",
)

MARGIN = 1e-3


@pytest.fixture(scope="module", params=["toy", "lift", "fork", "capsules"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    if request.param == "fork":
        return load_robot(FORK, tool_frame="tool0")
    return loaded_arm(request.param, tmp_path_factory)


@pytest.fixture(scope="module")
def field(arm: Robot) -> ClearanceField:
    generator = np.random.default_rng(3)
    solids: list[Solid] = [
        *SOLIDS,
        Cloud.from_points("leaves", np.array([0.3, 0.6, 0.7]) + 0.1 * generator.normal(size=(200, 3)), 0.01),
    ]
    return ClearanceField.build(arm, solids)


def points_of(arm: Robot, field: ClearanceField, q: FloatArray) -> list[FloatArray]:
    """The corners of each body, and of capsules that cover several, in `base_link`."""
    data, found = arm.model.createData(), []
    pin.forwardKinematics(arm.model, data, q)
    for row in field.arm.bodies:
        core, joint = field.arm.points[row["first"] : row["last"]].reshape(-1, 3), int(row["joint"])
        place = data.oMi[joint + 1] if joint < arm.dof else pin.SE3.Identity()
        found.append(core @ place.rotation.T + place.translation)
    return found


def seen_from(arm: Robot, q: FloatArray, joint: int, points: FloatArray) -> FloatArray:
    """Points in the frame of a joint, -1 for the base."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    place = data.oMi[joint + 1]
    seen: FloatArray = (points - place.translation) @ place.rotation
    return seen


@given(SEEDS)
@settings(max_examples=10)
def test_twists_are_velocities(arm: Robot, field: ClearanceField, seed: int) -> None:
    generator = np.random.default_rng(seed)
    q, rates = generator.uniform(arm.lower, arm.upper), generator.uniform(-1.0, 1.0, arm.dof)
    frames = np.empty((arm.dof + 1, MOVING))
    place_joints(q, field.arm.joints, frames)
    find_twists(rates, field.arm.joints, frames)
    ahead, behind = (points_of(arm, field, q + step * rates) for step in (1e-6, -1e-6))
    for body, here, after, before in zip(collision_bodies(arm), points_of(arm, field, q), ahead, behind, strict=False):
        twist = frames[body.joint if body.joint >= 0 else arm.dof, TWIST:]
        assert twist[3:] + np.cross(twist[:3], here) == pytest.approx((after - before) / 2e-6, abs=1e-7)


@given(SEEDS)
@settings(max_examples=30)
def test_points_are_no_faster_and_bend_no_more_than_is_said(arm: Robot, field: ClearanceField, seed: int) -> None:
    generator = np.random.default_rng(seed)
    q, rates = generator.uniform(arm.lower, arm.upper), generator.uniform(-1.0, 1.0, arm.dof)
    changes = generator.uniform(-1.0, 1.0, arm.dof)
    bends = np.empty((field.count, 2))
    motion_bends(np.abs(rates), np.abs(changes), field.arrays, bends)
    assert bends[:, 0] == pytest.approx(field.reaches @ np.abs(rates))
    step = 1e-4
    times = np.array([-step, 0.0, step])
    along = q + np.outer(times, rates) + 0.5 * np.outer(times**2, changes)
    placed = [points_of(arm, field, at) for at in along]
    bodies = collision_bodies(arm)
    told = 0
    for k, (speed, bend) in enumerate(bends):
        moved, seen = k, -1
        if k >= len(placed[0]):
            pair = field.arm.pairs[k - len(placed[0])]
            moved, seen = int(pair["outer"]), bodies[pair["inner"]].joint
        before, here, after = (
            seen_from(arm, at, seen, points[moved]) for at, points in zip(along, placed, strict=True)
        )
        if bend < 1e299:
            told += k >= len(placed[0])
            assert np.linalg.norm((after - before) / (2 * step), axis=1).max() <= speed + 1e-6
            assert np.linalg.norm((after - 2 * here + before) / step**2, axis=1).max() <= bend + 1e-5
    assert told == sum(
        bodies[i].joint in (-1, *ancestors(arm, bodies[j].joint)) or bodies[j].joint in ancestors(arm, bodies[i].joint)
        for i, j in self_pairs(arm).checked
    )


def ancestors(arm: Robot, joint: int) -> list[int]:
    found = []
    while joint >= 0:
        found.append(joint)
        joint = int(arm.model.parents[joint + 1]) - 1
    return found


@given(SEEDS, st.floats(0.01, 0.6), st.floats(0.01, 0.6))
@settings(max_examples=150)
def test_parts_shown_clear_are_clear(arm: Robot, field: ClearanceField, seed: int, back: float, forward: float) -> None:
    generator = np.random.default_rng(seed)
    q = generator.uniform(arm.lower, arm.upper)
    rates = generator.uniform(-2.0, 2.0, arm.dof) * generator.choice([0.0, 1.0], arm.dof)
    bends, bounds = np.empty((field.count, 2)), field.reaches @ np.abs(rates)
    motion_bends(np.abs(rates), np.zeros(arm.dof), field.arrays, bends)
    part = part_shown_clear(q, rates, moving_arm(field.arrays, arm.dof, bends, MARGIN), back, forward)
    clear = field.link_clearances(q)
    if part.forward < 0.0:
        assert clear.min() < 1.03 * MARGIN
        return
    assert clear.min() >= MARGIN
    assert 0.0 <= part.back <= back
    assert 0.0 <= part.forward <= forward
    along = field.clearance_along(q + np.linspace(-part.back, part.forward, 41)[:, None] * rates)
    assert along.min() > 0.5 * MARGIN - 1e-9
    # No less than the reaches alone show.
    moving = (bounds > 0.0) & (clear < FAR)
    lasting = (clear - 0.5 * MARGIN) / np.where(moving, bounds, np.inf)
    least = float(lasting[moving].min(initial=np.inf))
    for shown, asked in ((part.back, back), (part.forward, forward)):
        assert shown >= min(asked, 0.97 * least, 0.97 * FAR / max(bounds.max(), 1e-9))


@pytest.fixture(scope="module")
def shells(arm: Robot) -> tuple[ClearanceField, ClearanceField]:
    """Dense shells of balls around the arm, as clouds and as single balls."""
    generator = np.random.default_rng(4)
    solids: list[list[Solid]] = [[], []]
    for number in range(8):
        rays = generator.normal(size=(700, 3))
        rays *= generator.uniform(0.2, 0.4, 3) / np.linalg.norm(rays, axis=1)[:, None]
        points = rays + generator.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.2])
        solids[0].append(Cloud.from_points(f"shell {number}", points, 0.004))
        solids[1] += [
            Sphere(name=f"{number} {k}", center=tuple(p), radius=0.004) for k, p in enumerate(points.tolist())
        ]
    return ClearanceField.build(arm, solids[0]), ClearanceField.build(arm, solids[1])


@given(SEEDS)
@settings(max_examples=150)
def test_clouds_are_their_balls(arm: Robot, shells: tuple[ClearanceField, ClearanceField], seed: int) -> None:
    clouds, balls = shells
    generator = np.random.default_rng(seed)
    q, rates = generator.uniform(arm.lower, arm.upper), generator.uniform(-2.0, 2.0, arm.dof)
    enough = generator.choice([0.03, 0.5])
    found, expected = np.empty(clouds.count), np.empty(clouds.count)
    body_clearances(q, clouds.arrays, enough, found)
    body_clearances(q, balls.arrays, enough, expected)
    # The depth is that of one ball, which depends on the order.
    assert np.maximum(found, -0.004) == pytest.approx(np.maximum(expected, -0.004), abs=1e-9)
    margin = generator.choice([MARGIN, 0.02])
    free = (generator.uniform(arm.lower, arm.upper) for _ in range(300))
    q = next((q for q in free if balls.spare_clearance(q) > margin), q)
    bends = np.empty((clouds.count, 2))
    motion_bends(np.abs(rates), np.zeros(arm.dof), clouds.arrays, bends)
    parts = [
        part_shown_clear(q, rates, moving_arm(one.arrays, arm.dof, bends, margin), 0.0, 0.6) for one in (clouds, balls)
    ]
    if parts[0].forward < 0.0 or parts[1].forward < 0.0:
        assert expected.min() < 1.03 * margin
        return
    along = balls.clearance_along(q + np.linspace(-parts[0].back, parts[0].forward, 41)[:, None] * rates)
    assert along.min() > 0.5 * margin - 1e-9
    for cloud, ball in zip(*parts, strict=True):
        assert cloud >= 0.5 * ball


def test_body_turned_to_wall_touches_it() -> None:
    urdf = '<robot name="crank"><link name="base_link"/>' + limb(
        "crank", "base_link", "revolute", "0 0 1", "0 0 0", '<sphere radius="0.05"/>'
    )
    urdf = urdf.replace('xyz="0.05 0.02 0.1" rpy="0.1 0.4 0"', 'xyz="1 0 0"').replace('rpy="0.3 -0.2 0.5"', "")
    arm = load_robot(urdf + "</robot>", tool_frame="crank_link")
    # At 0 the ball moves along the wall's face, 20 mm from it.
    wall = Box(name="wall", center=(0.43, 0.0, 0.0), size=(1.0, 4.0, 1.0))
    field = ClearanceField.build(arm, [wall])
    bends, q, rates = np.empty((field.count, 2)), np.zeros(1), np.ones(1)
    motion_bends(rates, np.zeros(1), field.arrays, bends)
    part = part_shown_clear(q, rates, moving_arm(field.arrays, 1, bends, 0.0), 1.0, 1.0)
    meets = float(np.arccos(0.98))
    assert 0.9 * meets < part.forward < meets
    assert 0.9 * meets < part.back < meets
    assert part_shown_clear(q, rates, moving_arm(field.arrays, 1, bends, 0.0), 0.15, 0.15) == (0.15, 0.15)


@given(SEEDS)
@settings(max_examples=100)
def test_a_sweep_uses_up_what_the_worst_point_of_the_ball_does(seed: int) -> None:
    generator = np.random.default_rng(seed)
    velocity, spin, direction = generator.normal(size=(3, 3))
    radius, back, forward = generator.uniform(0.0, 1.0, 3)
    sweep = Sweep(tuple(velocity), tuple(spin), radius, back, forward, 0.01, 0.02, 1e9, 0.05)
    normal = direction / np.linalg.norm(direction)
    across = np.cross(spin, normal)
    worst = radius * across / np.linalg.norm(across)  # x with the maximum n . (w x x)
    nearer = -normal @ (velocity + np.cross(spin, np.stack([worst, -worst]))).T
    expected = max(0.05, 0.025 + forward * nearer.max() + 0.02, 0.025 + back * (-nearer).max() + 0.01)
    assert used_up(sweep, tuple(direction), float(np.linalg.norm(direction))) == pytest.approx(expected)
    capped, most = sweep._replace(speed=0.1), max(0.1 * max(back, forward) + 0.025, 0.05)
    assert used_up(capped, tuple(direction), float(np.linalg.norm(direction))) <= most
