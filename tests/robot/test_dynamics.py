"""Torques of whole motions against Pinocchio's, one state at a time."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arm_variants import VARIANTS, load_variant

from hplan.robot.dynamics import InverseDynamics


def random_inertia(rng):
    points = rng.normal(size=(20, 3))
    spread = points.T @ points / 20
    return pin.Inertia(rng.uniform(0.1, 5.0), rng.normal(size=3), np.trace(spread) * np.eye(3) - spread)


def random_model(seed):
    """A tree of joints that turn and slide about any axis, gravity and rotors in any direction and size."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    kinds = [
        pin.JointModelRX,
        pin.JointModelRY,
        pin.JointModelRZ,
        pin.JointModelPX,
        pin.JointModelPY,
        pin.JointModelPZ,
        lambda: pin.JointModelRevoluteUnaligned(unit(rng)),
        lambda: pin.JointModelPrismaticUnaligned(unit(rng)),
    ]
    for number in range(int(rng.integers(1, 8))):
        parent = int(rng.integers(0, model.njoints))
        place = pin.SE3(pin.Quaternion(*unit(rng, 4)).toRotationMatrix(), rng.normal(size=3))
        joint = model.addJoint(parent, kinds[rng.integers(len(kinds))](), place, f"j{number}")
        model.appendBodyToJoint(joint, random_inertia(rng), pin.SE3.Random())
    model.armature = rng.uniform(0.0, 2.0, model.nv)
    model.gravity.linear = rng.normal(scale=5.0, size=3)
    return model


def unit(rng, size=3):
    vector = rng.normal(size=size)
    return vector / np.linalg.norm(vector)


def assert_as_pinocchio(model, rng, count=20):
    dynamics, data = InverseDynamics.of(model), model.createData()
    q = np.array([pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq)) for _ in range(count)])
    v, a = 3.0 * rng.normal(size=(2, count, model.nv))
    expected = [pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)]
    np.testing.assert_allclose(dynamics.torques(q, v, a), expected, rtol=1e-10, atol=1e-10)
    gravity = [pin.computeGeneralizedGravity(model, data, row) for row in q]
    np.testing.assert_allclose(dynamics.gravity(q), gravity, rtol=1e-10, atol=1e-10)
    return dynamics


@pytest.mark.parametrize("name", VARIANTS)
def test_arms_of_the_family(name, tmp_path):
    dynamics = assert_as_pinocchio(load_variant(name, tmp_path).model, np.random.default_rng(0))
    assert dynamics.bodies is not None


def test_the_harvester(robot):
    assert_as_pinocchio(robot.model, np.random.default_rng(1), 200)


@pytest.mark.parametrize("seed", range(30))
def test_random_trees(seed):
    dynamics = assert_as_pinocchio(random_model(seed), np.random.default_rng(seed))
    assert dynamics.bodies is not None


def test_joints_without_one_fixed_axis_are_left_to_pinocchio():
    model = pin.buildSampleModelHumanoid()
    assert assert_as_pinocchio(model, np.random.default_rng(2)).bodies is None
    wheel = pin.Model()
    wheel.addJoint(0, pin.JointModelRUBZ(), pin.SE3.Identity(), "wheel")
    assert InverseDynamics.of(wheel).bodies is None


def test_no_rows_and_rows_with_gaps(robot):
    dynamics = InverseDynamics.of(robot.model)
    assert dynamics.torques(np.empty((0, 4)), np.empty((0, 4)), np.empty((0, 4))).shape == (0, 4)
    q, v, a = np.random.default_rng(3).normal(size=(3, 10, 4))
    np.testing.assert_array_equal(dynamics.torques(q[::2], v[::2], a[::2]), dynamics.torques(q, v, a)[::2])
    wide = np.asfortranarray(q)
    np.testing.assert_array_equal(dynamics.torques(wide, v, a), dynamics.torques(q, v, a))


def test_what_was_read_cannot_be_changed(robot):
    with pytest.raises(ValueError, match="read-only"):
        InverseDynamics.of(robot.model).bodies[0, 0, 0] = 1.0
