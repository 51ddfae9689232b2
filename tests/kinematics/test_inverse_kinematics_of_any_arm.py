"""Inverse kinematics of any robot: what is found is at the pose, within limits, and always the same."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from any_arms import ARMS, loaded_arm
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hplan.errors as errors
from hplan.base.arrays import FloatArray
from hplan.kinematics.inverse_kinematics import SAME, inverse_kinematics
from hplan.robot.model import Robot


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm(request.param, tmp_path_factory)


def drawn(arm: Robot, seed: int) -> FloatArray:
    spread = np.random.default_rng(seed).random(arm.dof)
    inside: FloatArray = arm.lower + (0.05 + 0.9 * spread) * (arm.upper - arm.lower)
    return inside


def off(arm: Robot, q: FloatArray, pose: FloatArray, frame: str | None = None) -> tuple[float, float]:
    """How far a frame is from a pose [m, rad], by Pinocchio."""
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


def test_from_where_the_arm_stands_it_stays(arm: Robot) -> None:
    q = drawn(arm, 3)
    assert inverse_kinematics(arm, arm.forward_kinematics(q), start=q)[0] == pytest.approx(q, abs=1e-9)


def test_many_solutions_of_six_joints(tmp_path_factory: pytest.TempPathFactory) -> None:
    arm = loaded_arm("toy", tmp_path_factory)
    counts = [len(inverse_kinematics(arm, arm.forward_kinematics(drawn(arm, seed)))) for seed in range(10)]
    assert max(counts) >= 4


@pytest.mark.parametrize("seed", range(4))
def test_a_free_turn_turns_about_z_alone(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
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


def test_out_of_reach_is_said_to_be_sought_only(arm: Robot) -> None:
    far = np.eye(4)
    far[:3, 3] = 50.0
    with pytest.raises(errors.UnreachableError, match="no proof") as refused:
        inverse_kinematics(arm, far, seeds=8)
    assert refused.value.reason == "not_found"
