"""Cubics, quintics and lines between samples against SciPy's polynomials; their bounds."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pinocchio as pin
import pytest
from any_arms import LIFT, loaded_arm
from scipy.interpolate import BPoly

from hplan.certificate.clearance_proof import point_at
from hplan.certificate.goal_contact import largest_rates
from hplan.certificate.limit_use import _peaks, limit_use
from hplan.certificate.motion_bound import fastest, motion_of_movers
from hplan.certificate.torque_bound import GAP, largest_torques
from hplan.collision.coal_scene import CoalScene
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.model import Robot, load_robot
from hplan.scene.obstacles import Sphere
from hplan.trajectory.cubics import Interpolation
from hplan.trajectory.trajectory import Trajectory

CURVES: tuple[Interpolation, ...] = get_args(Interpolation)


def rows_of(robot: Robot, rng: np.random.Generator, apart_s: float, curve: Interpolation) -> tuple[Trajectory, BPoly]:
    """Seven random samples, and the polynomials between them by SciPy."""
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 1.5, 6) * apart_s)])
    shape = (7, robot.dof)
    position = 0.3 * rng.normal(size=robot.dof) + np.cumsum(apart_s * rng.uniform(-1.5, 1.5, shape), axis=0)
    velocity, acceleration = rng.uniform(-2.0, 2.0, shape), rng.uniform(-8.0, 8.0, shape)
    zero = np.zeros(shape)
    motion = Trajectory(robot.joint_names, time, position, velocity, acceleration, zero, robot.slides, curve)
    given = {"linear": [position], "cubic": [position, velocity], "quintic": [position, velocity, acceleration]}
    return motion, BPoly.from_derivatives(time, list(np.stack(given[curve], axis=1)))


def dense(motion: Trajectory, count: int = 201) -> np.ndarray:
    """Times within each segment, some close to its ends, none at a sample."""
    inner = np.linspace(1e-9, 1.0 - 1e-9, count)
    return (motion.time[:-1, None] + np.diff(motion.time)[:, None] * inner).ravel()


@pytest.mark.parametrize("curve", CURVES)
def test_states_are_scipys(curve: Interpolation) -> None:
    robot, rng = load_robot(), np.random.default_rng(1)
    for apart_s in (2e-3, 0.1, 1.0):
        motion, true = rows_of(robot, rng, apart_s, curve)
        clock = dense(motion, 11)
        np.testing.assert_allclose(motion.positions(clock), true(clock), rtol=0, atol=1e-12)
        states = [motion.state_at(t) for t in clock.tolist()]
        for order in range(3):
            expected = true.derivative(order)(clock) if order else true(clock)
            size = np.abs(expected).max() + 1.0
            np.testing.assert_allclose([state[order] for state in states], expected, rtol=0, atol=1e-6 * size)
        bezier, _ = motion.segments
        places = np.linspace(0.0, 6.0, 40)
        expected = true(np.interp(places, np.arange(7), motion.time))
        np.testing.assert_allclose([point_at(bezier, place) for place in places], expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(motion.end_velocities, true.derivative(1)([0.0, motion.time[-1]]), atol=1e-9)
        there = motion.reversal.positions(motion.duration - clock)
        if curve != "quintic" or apart_s < 1.0:
            np.testing.assert_allclose(there, true(clock), rtol=0, atol=1e-9)


@pytest.mark.parametrize("curve", CURVES)
def test_largest_values_are_those_of_dense_samples(curve: Interpolation) -> None:
    robot, rng = load_robot(), np.random.default_rng(2)
    middle = 0.5 * (robot.lower + robot.upper)
    for apart_s in (2e-3, 0.1, 1.0, 5.0):
        for _ in range(5):
            motion, true = rows_of(robot, rng, apart_s, curve)
            bezier, duration = motion.segments
            peaks, clock = _peaks(np.ascontiguousarray(bezier), duration, middle), dense(motion, 2001)
            seen = np.abs(np.stack([true(clock) - middle, true(clock, 1), true(clock, 2)])).max(axis=1)
            assert (peaks >= seen * (1.0 - 1e-6)).all()
            assert (peaks <= seen * (1.0 + 1e-4) + 1e-9).all()
            assert (fastest(bezier, duration).max(axis=0) >= seen[1] * (1.0 - 1e-6)).all()
            rates, pushes = largest_rates(bezier)
            assert ((rates / duration[:, None]).max(axis=0) >= seen[1] * (1.0 - 1e-6)).all()
            assert ((pushes / duration[:, None] ** 2).max(axis=0) >= seen[2] * (1.0 - 1e-6)).all()


@pytest.mark.parametrize(("curve", "larger"), [("cubic", "acceleration"), ("cubic", "torque"), ("quintic", "torque")])
def test_uses_are_those_of_dense_samples_and_of_the_columns(curve: Interpolation, larger: str) -> None:
    robot, rng = load_robot(), np.random.default_rng(6)
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
    limit = getattr(robot, f"{larger}_limit")
    for _ in range(5):
        motion, true = rows_of(robot, rng, 0.05, curve)
        clock = dense(motion, 2001)
        states = true(clock), true(clock, 1), true(clock, 2)
        # A column that does not shape the curve may hold larger values.
        motion = replace(motion, **{larger: rng.uniform(0.0, 40.0, motion.position.shape) * limit})
        found = limit_use(robot, motion, *motion.segments)
        seen = {
            "position": np.abs(states[0] - middle) / half,
            "velocity": np.abs(states[1]) / robot.velocity_limit,
            "acceleration": np.abs(states[2]) / robot.acceleration_limit,
            "torque": np.abs(robot.dynamics.torques(*states)) / robot.torque_limit,
        }
        for name, values in seen.items():
            expected = float(values.max())
            if name != "position":
                column = np.abs(getattr(motion, name)) / getattr(robot, f"{name}_limit")
                expected = max(expected, float(column.max()))
            assert expected * (1.0 - 1e-6) <= getattr(found, name) <= expected * (1.0 + 1e-4) + 2.0 * GAP


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("rotor", [0.0, 30.0])
def test_torques_are_bounded(curve: Interpolation, rotor: float) -> None:
    """Heavy rotors, whose torque has the fourth derivative, which cubics do not have."""
    for robot in (load_robot(), load_robot(LIFT)):
        rng, model = np.random.default_rng(3), robot.model.copy()
        model.armature = np.full(robot.dof, rotor)
        dynamics, data = InverseDynamics.build(model), model.createData()
        for apart_s in (4e-3, 0.05, 0.3):
            motion, true = rows_of(robot, rng, apart_s, curve)
            bound = largest_torques(dynamics, *motion.segments, robot.torque_limit)
            clock = dense(motion)
            states = zip(true(clock), true(clock, 1), true(clock, 2), strict=True)
            seen = np.abs([pin.rnea(model, data, *state) for state in states]).max(axis=0)
            assert (bound >= seen * (1.0 - 1e-6)).all()
            share = (bound / robot.torque_limit).max()
            assert share <= 1.02 * (seen / robot.torque_limit).max() + GAP


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("name", ["harvester", "toy"])
def test_bodies_travel_no_farther_than_their_bound(
    curve: Interpolation, name: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    robot = load_robot() if name == "harvester" else loaded_arm(name, tmp_path_factory)
    checker, rng = CoalScene(robot, [Sphere(name="far", center=(9.0, 0.0, 1.0), radius=0.1)]), np.random.default_rng(4)
    first = len(checker.pairs) - len(checker.parts.own)
    for apart_s in (0.05, 0.5):
        motion, _ = rows_of(robot, rng, apart_s, curve)
        bezier, _ = motion.segments
        mover_of, moved, _ = motion_of_movers(checker, bezier, np.zeros((1, robot.dof)))
        travel = np.column_stack([np.zeros(len(moved)), np.cumsum(moved, axis=1)])
        places = np.linspace(0.0, 6.0, 600)
        distances = np.array([checker.pair_distances(point_at(bezier, place)) for place in places])[:, :first]
        gone = np.array([np.interp(places, np.arange(7), each) for each in travel])[mover_of[:first]].T
        for lag in (1, 7, 60):
            change = np.abs(distances[lag:] - distances[:-lag])
            assert (change <= gone[lag:] - gone[:-lag] + 1e-6).all()


def test_curve_that_does_not_exist_is_refused() -> None:
    motion, _ = rows_of(load_robot(), np.random.default_rng(5), 0.1, "cubic")
    with pytest.raises(Exception, match="interpolation"):
        replace(motion, interpolation="septic")  # type: ignore[arg-type]
