"""Inverse kinematics: planar arms in closed form, general arms from many starts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from any_arms import ARMS, loaded_arm
from arm_variants import VARIANTS, axis_points, load_variant
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hplan.errors as errors
from hplan.base.arrays import FloatArray, readonly
from hplan.errors import UnreachableError
from hplan.kinematics.inverse_kinematics import SAME, inverse_kinematics
from hplan.planar.chain import FreeChain
from hplan.planar.family_reader import family_of, with_planar_arm
from hplan.planar.inverse_kinematics import AXIS_YAWS, reach
from hplan.robot.model import Robot

EXACT = 1e-9
SMALL = [name for name, (_, _, _, axes) in VARIANTS.items() if len(axes) in (2, 3)]


@pytest.fixture(scope="module")
def variants(tmp_path_factory):
    return {name: load_variant(name, tmp_path_factory.mktemp("arm")) for name in VARIANTS}


def with_arm(robot: Robot, **changes) -> Robot:
    """The robot with other lengths or limits of its planar joints."""
    arm = replace(family_of(robot).arm, **{key: readonly(value) for key, value in changes.items()})
    yaw = slice(0, robot.dof - arm.link_count)
    lower = readonly(np.concatenate([robot.lower[yaw], arm.lower]))
    upper = readonly(np.concatenate([robot.upper[yaw], arm.upper]))
    return with_planar_arm(replace(robot, lower=lower, upper=upper), arm)


def random_arm(robot: Robot, rng: np.random.Generator) -> Robot:
    lower = rng.uniform(-3.0, 1.0, 3)
    return with_arm(
        robot,
        lengths=rng.uniform(0.1, 1.0, 3),
        signs=rng.choice([-1.0, 1.0], 3),
        offsets=rng.uniform(-3.0, 3.0, 3),
        lower=lower,
        upper=lower + rng.uniform(0.05, 3.0, 3),
    )


def approach_of(robot: Robot, q: np.ndarray) -> np.ndarray:
    arm = family_of(robot).arm
    return (arm.signs * q[..., family_of(robot).arm_slice] + arm.offsets).sum(axis=-1)


def elbow_side(robot: Robot, q: np.ndarray) -> np.ndarray:
    arm = family_of(robot).arm
    return np.sign(np.sin((arm.signs * q[..., family_of(robot).arm_slice] + arm.offsets)[..., 1]))


def turned(difference: np.ndarray) -> np.ndarray:
    """Angles up to whole turns."""
    return np.abs(np.angle(np.exp(1j * difference)))


def assert_reached(robot: Robot, candidates, position) -> None:
    q = candidates.configurations
    assert len(q)
    assert not q.flags.writeable
    np.testing.assert_allclose(family_of(robot).tool_positions(q), np.tile(position, (len(q), 1)), rtol=0.0, atol=EXACT)
    assert ((q >= robot.lower) & (q <= robot.upper)).all()
    assert turned(approach_of(robot, q) - candidates.approach).max() < EXACT
    assert (np.abs(candidates.approach) <= np.pi).all()
    apart = np.abs(q[:, None] - q[None]).max(axis=-1) + np.eye(len(q))
    assert apart.min() > 1e-8


def nearest(candidates, q) -> float:
    return float(np.abs(candidates.configurations - q).max(axis=1).min())


def scan(robot: Robot, point: complex, angles: np.ndarray) -> np.ndarray:
    """(angles,) True if the planar tool reaches a point with the last link's angle."""
    arm = family_of(robot).arm
    l1, l2, l3 = arm.lengths
    found = np.zeros(len(angles), dtype=bool)
    for i, angle in enumerate(angles):
        wrist = point - l3 * np.exp(1j * angle)
        cos = (abs(wrist) ** 2 - l1**2 - l2**2) / (2 * l1 * l2)
        if abs(cos) > 1.0:
            continue
        for bend in (np.arccos(cos), -np.arccos(cos)):
            first = np.angle(wrist / (l1 + l2 * np.exp(1j * bend)))
            relative = np.array([first, bend, angle - first - bend])
            q = arm.signs * (relative - arm.offsets)
            q += 2 * np.pi * np.ceil((arm.lower - q) / (2 * np.pi))
            found[i] |= bool((q <= arm.upper).all())
    return found


# Reachable points


@pytest.mark.parametrize("name", SMALL)
def test_every_configuration_is_found(variants, name):
    robot, rng = variants[name], np.random.default_rng(1)
    three = family_of(robot).arm.link_count == 3
    for q in rng.uniform(robot.lower, robot.upper, (40, robot.dof)):
        position = axis_points(robot, q)[-1]
        angle = float(np.degrees(approach_of(robot, q)))
        given_angle = reach(robot, position, approach_deg=angle, start=q)
        assert_reached(robot, given_angle, position)
        assert nearest(given_angle, q) < 1e-6
        every = reach(robot, position, count=64)
        assert_reached(robot, every, position)
        for candidate in every.configurations[:: max(1, len(every.configurations) // 5)]:
            np.testing.assert_allclose(axis_points(robot, candidate)[-1], position, rtol=0.0, atol=EXACT)
        if not three:
            assert nearest(every, q) < 1e-6
            continue
        same = elbow_side(robot, every.configurations) == elbow_side(robot, q)
        if family_of(robot).has_yaw:
            same &= np.abs(every.configurations[:, 0] - q[0]) < 1e-6
        gap = turned(every.approach[same] - approach_of(robot, q)).min()
        assert gap < 8.0 * np.pi / 64


@pytest.mark.parametrize("name", SMALL)
def test_several_positions_give_configurations_of_each(variants, name):
    robot, rng = variants[name], np.random.default_rng(3)
    rows = rng.uniform(robot.lower, robot.upper, (6, robot.dof))
    positions = robot.tool_positions(rows)
    found = reach(robot, [*positions, (50.0, 0.0, 0.0)], count=16).configurations
    tools = robot.tool_positions(found)
    apart = np.linalg.norm(tools[:, None] - positions, axis=2)
    assert apart.min(axis=1).max() < 1e-6
    for number, position in enumerate(positions):
        alone = reach(robot, position, count=1).configurations  # the ends of all continua
        here = found[apart[:, number] < 1e-6]
        ends = np.abs(alone[:, None] - here).max(axis=2).min(axis=1)
        assert np.sort(ends)[: max(1, len(ends) - 1)].max() < 1e-6  # one of them is a sample
    with pytest.raises(UnreachableError, match=r"cannot reach \(50"):
        reach(robot, [(50.0, 0.0, 0.0), (60.0, 0.0, 0.0)])


def test_harvester_grid_is_found(robot):
    """Including joints at limits, stretched elbows and points above the axis."""
    grid = np.radians(np.arange(0.0, 91.0, 15.0))
    for theta in np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3):
        q = np.array([0.4, *theta])
        position = robot.tool_positions(q)
        found = reach(robot, position, approach_deg=float(np.degrees(theta.sum())), start=q)
        assert_reached(robot, found, position)
        assert nearest(found, q) < 1e-6
        assert_reached(robot, reach(robot, position, start=q), position)


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32 - 1))
def test_random_arms(robot, seed):
    rng = np.random.default_rng(seed)
    arm = random_arm(robot, rng)
    q = rng.uniform(arm.lower, arm.upper)
    # Some joints at their limits, where intervals end or are single points.
    q = np.where(rng.random(4) < 0.3, rng.choice([arm.lower, arm.upper]), q)
    position = family_of(arm).tool_positions(q)
    assert_reached(arm, reach(arm, position), position)
    given_angle = reach(arm, position, approach_deg=float(np.degrees(approach_of(arm, q))), start=q)
    assert_reached(arm, given_angle, position)
    assert nearest(given_angle, q) < 1e-5


@settings(max_examples=40, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32 - 1))
def test_feasible_directions_against_a_scan(robot, seed):
    rng = np.random.default_rng(seed)
    arm = random_arm(robot, rng)
    point = complex(*rng.uniform(-1.5, 1.5, 2))
    chain = FreeChain.build(family_of(arm).arm, (0, 1, 2), np.zeros(3))
    spans = chain.feasible_directions(np.array([point]), np.zeros(1))
    angles = rng.uniform(-np.pi, np.pi, 400)
    inside = np.zeros(400, dtype=bool)
    for low, high in spans:
        assert low <= high <= low + 2.0 * np.pi
        inside |= (angles - low) % (2.0 * np.pi) <= high - low
    np.testing.assert_array_equal(inside, scan(arm, point, angles))


def test_point_on_the_yaw_axis(robot):
    wide = with_arm(robot, lower=[-3.0] * 3, upper=[3.0] * 3)
    position = np.array([0.0, 0.0, 2.0])
    every = reach(wide, position)
    assert_reached(wide, every, position)
    assert len(np.unique(every.configurations[:, 0])) == AXIS_YAWS
    start = np.array([0.7, 0.0, 0.0, 0.0])
    assert set(reach(wide, position, start=start).configurations[:, 0]) == {0.7}


def test_approach_interval(robot):
    position = robot.tool_positions([0.2, 0.4, 0.5, 0.5])
    whole = reach(robot, position).approach
    low, high = np.degrees([whole.min(), whole.max()])
    middle = 0.5 * (low + high)
    part = reach(robot, position, approach_deg=(middle, high + 50.0))
    assert_reached(robot, part, position)
    assert np.degrees([part.approach.min(), part.approach.max()]) == pytest.approx([middle, high])
    again = reach(robot, position, approach_deg=(middle + 360.0, high + 410.0))
    np.testing.assert_allclose(again.configurations, part.configurations, rtol=0.0, atol=1e-12)


# Locked joints


@pytest.mark.parametrize("name", ["upright on a yaw", "shoulder aside and behind, arm turned", "tilted plane"])
@pytest.mark.parametrize("locked", [(0,), (1,), (-1,), (-2,), (0, -1), (-1, -2), (0, 1, 2)])
def test_locked_joints_keep_their_values(variants, name, locked):
    robot, rng = variants[name], np.random.default_rng(2)
    joints = sorted({j % robot.dof for j in locked})
    names = [robot.joint_names[j] for j in joints]
    for _ in range(10):
        start, q = rng.uniform(robot.lower, robot.upper, (2, robot.dof))
        q[joints] = start[joints]
        position = robot.tool_positions(q)
        found = reach(robot, position, start=start, locked=names)
        assert_reached(robot, found, position)
        np.testing.assert_array_equal(found.configurations[:, joints], np.tile(start[joints], (len(found.approach), 1)))
        angle = float(np.degrees(approach_of(robot, q)))
        assert nearest(reach(robot, position, start=start, locked=names, approach_deg=angle), q) < 1e-6


@pytest.mark.parametrize("name", ["plane off the yaw axis", "links next to each other, off the axis"])
def test_points_nearer_to_the_yaw_axis_than_the_plane(variants, name):
    """Just outside there are two yaws, with the point ahead and behind.

    Inside, the error gives the distance.
    """
    robot = variants[name]
    _, across = family_of(robot).shoulder_from_axis
    assert abs(across) > 0.1
    height = family_of(robot).plane_origin[2] + 0.9
    direction = np.array([math.cos(0.3), math.sin(0.3)])
    outside = np.append(family_of(robot).yaw_axis + (abs(across) + 1e-3) * direction, height)
    found = reach(robot, outside, count=8)
    assert_reached(robot, found, outside)
    yaws = np.unique(found.configurations[:, 0].round(6))
    assert len(yaws) == 2
    assert np.diff(yaws) == pytest.approx(2.0 * math.acos(abs(across) / (abs(across) + 1e-3)), abs=1e-5)
    for part in (0.0, 0.5, 0.99):
        inside = np.append(family_of(robot).yaw_axis + part * abs(across) * direction, height)
        with pytest.raises(UnreachableError, match="closer to the yaw axis than the arm plane") as caught:
            reach(robot, inside)
        assert caught.value.reason == "off_plane"
        assert caught.value.data["beside_m"] == pytest.approx((1.0 - part) * abs(across), abs=1e-12)


# Other numbers of joints


def test_not_found_is_not_unreachable(variants):
    """Just in reach of the stretched arm, which no grid angle reaches.

    Only "not found" is claimed.
    """
    robot = variants["five links on a yaw"]
    direction = np.array([np.cos(0.3), 0.0, np.sin(0.3)])
    with pytest.raises(UnreachableError, match="j0, j1 at grid values") as caught:
        reach(robot, family_of(robot).plane_origin + (family_of(robot).arm.lengths.sum() - 1e-9) * direction)
    assert caught.value.reason == "not_found"


# Unreachable points


def test_approach_out_of_reach(robot):
    position = robot.tool_positions([0.2, 0.4, 0.5, 0.5])
    with pytest.raises(UnreachableError) as caught:
        reach(robot, position, approach_deg=-90.0)
    assert caught.value.reason == "approach"
    assert caught.value.data["approach_deg"] == [-90.0, -90.0]
    ((low, high),) = caught.value.data["reachable_deg"]
    whole = np.degrees(reach(robot, position).approach)
    assert (low, high) == pytest.approx((whole.min(), whole.max()))
    assert reach(robot, position, approach_deg=(low, low)).approach == pytest.approx(np.radians([low]))


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32 - 1))
def test_limits_in_the_way(robot, seed):
    """Moving the named limits by the stated amount makes the point reachable; less does not."""
    rng = np.random.default_rng(seed)
    arm = random_arm(robot, rng)
    while True:
        position = rng.uniform([-1.5, -1.5, -0.5], [1.5, 1.5, 1.8])
        try:
            reach(arm, position)
        except UnreachableError as error:
            if error.reason != "joint_limit":
                continue
            fault = error
            break
    assert fault.data["passed"][0] == {key: fault.data[key] for key in ("joint", "limit_deg", "excess_deg")}
    assert fault.data["joint"] in fault.message

    def relaxed(share: float) -> Robot:
        lower, upper = np.array(family_of(arm).arm.lower), np.array(family_of(arm).arm.upper)
        for entry in fault.data["passed"]:
            index = family_of(arm).arm.joint_names.index(entry["joint"])
            by, limit = share * np.radians(entry["excess_deg"]), np.radians(entry["limit_deg"])
            if abs(limit - lower[index]) < 1e-9:
                lower[index] -= by
            else:
                assert limit == pytest.approx(upper[index])
                upper[index] += by
        return with_arm(arm, lower=lower, upper=upper)

    reach(relaxed(1.0 + 1e-3), position)
    with pytest.raises(UnreachableError):
        reach(relaxed(0.98), position)


def test_yaw_limit_excludes_solutions(robot):
    lower, upper = np.array(robot.lower), np.array(robot.upper)
    lower[0], upper[0] = -1.0, 1.0
    narrow = replace(robot, lower=readonly(lower), upper=readonly(upper))
    with pytest.raises(UnreachableError) as caught:
        reach(narrow, robot.tool_positions([1.1, 0.2, 0.3, 0.3]))
    assert caught.value.data["joint"] == "base_yaw"
    assert caught.value.data["excess_deg"] == pytest.approx(np.degrees(0.1))


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm(request.param, tmp_path_factory)


def drawn(arm: Robot, seed: int) -> FloatArray:
    spread = np.random.default_rng(seed).random(arm.dof)
    inside: FloatArray = arm.lower + (0.05 + 0.9 * spread) * (arm.upper - arm.lower)
    return inside


def off(arm: Robot, q: FloatArray, pose: FloatArray, frame: str | None = None) -> tuple[float, float]:
    """Distance of a frame from a pose [m, rad], by Pinocchio."""
    there = arm.forward_kinematics(q, frame)
    turn = pin.log3(there[:3, :3].T @ pose[:3, :3])
    return float(np.linalg.norm(there[:3, 3] - pose[:3, 3])), float(np.linalg.norm(turn))


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 10_000))
def test_solutions_are_at_the_pose_and_within_limits(arm: Robot, seed: int) -> None:
    start, pose = drawn(arm, seed), arm.forward_kinematics(drawn(arm, seed + 1))
    found = inverse_kinematics(arm, pose, start=start)
    assert not found.flags.writeable
    for q in found:
        assert max(off(arm, q, pose)) <= 1e-6
    assert (found >= arm.lower).all()
    assert (found <= arm.upper).all()
    times = (np.abs(found - start) / arm.velocity_limit).max(axis=1)
    assert (np.diff(times) >= -1e-8).all()
    apart = np.abs(found[:, None] - found).max(axis=2) + np.eye(len(found))
    assert apart.min() >= SAME
    assert (inverse_kinematics(arm, pose, start=start) == found).all()


def test_arm_at_goal_stays(arm: Robot) -> None:
    q = drawn(arm, 3)
    assert inverse_kinematics(arm, arm.forward_kinematics(q), start=q)[0] == pytest.approx(q, abs=1e-9)


def test_many_solutions_of_six_joints(tmp_path_factory: pytest.TempPathFactory) -> None:
    arm = loaded_arm("toy", tmp_path_factory)
    counts = [len(inverse_kinematics(arm, arm.forward_kinematics(drawn(arm, seed)))) for seed in range(10)]
    assert max(counts) >= 4


@pytest.mark.parametrize("seed", range(4))
def test_free_turn_turns_about_z_alone(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    arm = loaded_arm("seven", tmp_path_factory)
    pose = arm.forward_kinematics(drawn(arm, seed))
    turns = []
    for q in inverse_kinematics(arm, pose, free_turn=True):
        there = arm.forward_kinematics(q)
        assert there[:3, 2:] == pytest.approx(pose[:3, 2:], abs=1e-6)
        turns.append(off(arm, q, pose)[1])
    assert max(turns) > 0.1


def test_locked_joints_and_those_beyond_the_frame_keep_their_values(tmp_path_factory: pytest.TempPathFactory) -> None:
    arm = loaded_arm("seven", tmp_path_factory)
    q, start = drawn(arm, 1), drawn(arm, 2)
    locked, start[2] = arm.joint_names[2], q[2]
    pose = arm.forward_kinematics(q)
    for found in inverse_kinematics(arm, pose, start=start, locked=[locked]):
        assert found[2] == start[2]
        assert max(off(arm, found, pose)) <= 1e-6
    wrist = arm.model.frames[arm.model.getFrameId(arm.joint_names[5])].name
    pose = arm.forward_kinematics(q, wrist)
    for found in inverse_kinematics(arm, pose, start=start, frame=wrist):
        assert found[6] == start[6]
        assert max(off(arm, found, pose, wrist)) <= 1e-6


def test_unreachable_goal_reports_search_only(arm: Robot) -> None:
    far = np.eye(4)
    far[:3, 3] = 50.0
    with pytest.raises(errors.UnreachableError, match="does not prove") as refused:
        inverse_kinematics(arm, far, seeds=8)
    assert refused.value.reason == "not_found"
