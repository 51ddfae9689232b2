"""Tilt of the tool as a distance: against Pinocchio, finite differences and samples of motions."""

from __future__ import annotations

import numpy as np
import pytest
from any_arms import loaded_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.base.arrays import FloatArray
from hplan.collision.compiled_bodies import TILT_AS_M
from hplan.collision.compiled_clearance import body_slopes
from hplan.collision.compiled_cover import moving_arm, part_shown_clear
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compiled_twists import motion_bends
from hplan.collision.distance_checker import FAR
from hplan.robot.model import Robot
from hplan.robot.upright import UprightTool

SEEDS, MARGIN = st.integers(0, 2**32 - 1), 1e-3


@pytest.fixture(scope="module", params=["toy", "lift", "panda"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm(request.param, tmp_path_factory)


def tool_near(arm: Robot, rng: np.random.Generator, q: FloatArray) -> UprightTool:
    """A random axis that is tilted a little less than allowed at a configuration."""
    axis, up = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    tool = UprightTool(tuple(axis), tuple(up), np.pi)
    return tool._replace(max_tilt_rad=tool.tilt_of(arm.forward_kinematics(q)) + rng.uniform(0.02, 0.4))


def tilts(arm: Robot, tool: UprightTool, rows: FloatArray) -> FloatArray:
    """(n,) angles by Pinocchio."""
    return np.array([tool.tilt_of(pose) for pose in arm.forward_kinematics(rows)])


@given(SEEDS, st.sampled_from([0.0, 0.01]))
@settings(max_examples=40)
def test_distance_and_slope_are_those_of_the_angle(arm: Robot, seed: int, deviation: float) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(arm.lower, arm.upper)
    tool = tool_near(arm, rng, q)
    field = ClearanceField.build(arm, [], upright=tool, deviation=deviation)
    scale, turning = TILT_AS_M / tool.max_tilt_rad, np.count_nonzero(~np.array(arm.slides))
    expected = scale * (tool.max_tilt_rad - tilts(arm, tool, q[None])[0] - turning * deviation)
    assert field.link_clearances(q)[-1] == pytest.approx(min(expected, FAR), abs=1e-9)
    clear, slopes = np.empty(field.count), np.empty((field.count, arm.dof))
    body_slopes(q, field.arrays, np.arange(arm.dof), FAR, clear, slopes)
    steps = 1e-6 * np.eye(arm.dof)
    expected = -scale * (tilts(arm, tool, q + steps) - tilts(arm, tool, q - steps)) / 2e-6
    assert slopes[-1] == pytest.approx(expected, abs=1e-5 * scale)


@given(SEEDS, st.floats(0.01, 0.6), st.floats(0.01, 0.6))
@settings(max_examples=100)
def test_parts_shown_upright_are_upright(arm: Robot, seed: int, back: float, forward: float) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(arm.lower, arm.upper)
    rates = rng.uniform(-2.0, 2.0, arm.dof) * rng.choice([0.0, 1.0], arm.dof)
    tool = tool_near(arm, rng, q)
    field = ClearanceField.build(arm, [], upright=tool)
    bends = np.empty((field.count, 2))
    motion_bends(np.abs(rates), np.zeros(arm.dof), field.arrays, bends)
    part = part_shown_clear(q, rates, moving_arm(field.arrays, arm.dof, bends, MARGIN), back, forward)
    if part.forward < 0.0:
        assert field.spare_clearance(q) < 1.03 * MARGIN
        return
    along = tilts(arm, tool, q + np.linspace(-part.back, part.forward, 41)[:, None] * rates)
    assert along.max() < tool.max_tilt_rad


@given(SEEDS)
@settings(max_examples=60)
def test_verified_motions_are_upright_and_others_are_not(arm: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(arm.lower, arm.upper)
    tool = tool_near(arm, rng, q)
    end = np.clip(q + rng.uniform(-0.3, 0.3, arm.dof), arm.lower, arm.upper)
    free, upright = (ClearanceField.build(arm, [], upright=each) for each in (None, tool))
    worst = tilts(arm, tool, q + np.linspace(0.0, 1.0, 201)[:, None] * (end - q)).max()
    if upright.is_clear([q, end], 1e-6):
        assert worst < tool.max_tilt_rad
    elif free.is_clear([q, end], 1e-6):
        assert worst > tool.max_tilt_rad - 1e-3
