"""Torques on a base that tilts on its track, against Pinocchio's inverse dynamics with gravity turned."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from any_arms import LIFT
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from hplan.certificate.certificate import certify
from hplan.certificate.tilted_base import largest_tilt
from hplan.robot.model import load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.tracks import Poses, Track
from hplan.trajectory.trajectory import Trajectory, cubic_states

ROBOT = load_robot(LIFT.replace('effort="50"', 'effort="90"'))
BEGIN, END, DURATION = np.array([0.2, 0.3, 0.1, 0.4]), np.array([0.3, 0.5, 0.2, 0.2]), 4.0
TIMES = (-1.0, 1.5, 3.0)

turns = st.tuples(*(st.floats(-40.0, 40.0),) * 3)


def motion() -> Trajectory:
    u = np.linspace(0.0, 1.0, 20)[:, None]
    way = END - BEGIN
    q, v = BEGIN + (3.0 * u**2 - 2.0 * u**3) * way, 6.0 * u * (1.0 - u) / DURATION * way
    a = (6.0 - 12.0 * u) / DURATION**2 * way
    return Trajectory(ROBOT.joint_names, u[:, 0] * DURATION, q, v, a, ROBOT.dynamics.torques(q, v, a), ROBOT.slides)


def scene(rpy_deg) -> Scene:
    ends = {"start": Start(joints_rad=tuple(BEGIN.tolist())), "goal": Goal(joints_rad=tuple(END.tolist()))}
    still = ((0.0, 0.0, 0.0),) * 3
    return Scene(
        name="s", base_track=Track(times_s=TIMES, shifts_m=still, rpy_deg=rpy_deg, about=(0.0, 0.0, 0.0)), **ends
    )


def base_at(rpy_deg, clock):
    turned = Slerp(TIMES, Rotation.from_euler("xyz", rpy_deg, degrees=True))
    return turned(np.clip(clock, TIMES[0], TIMES[-1])).as_matrix()


@settings(max_examples=10)
@given(turns, turns, turns)
def test_torques_are_bounded_whatever_the_tilt(first, second, third):
    found, clock, model = motion(), np.linspace(0.0, DURATION, 60), ROBOT.model.copy()
    certificate = certify(ROBOT, scene((first, second, third)), found)
    data, worst = model.createData(), 0.0
    states = zip(*cubic_states(found.time, found.position, found.velocity, clock), strict=True)
    for state, turn in zip(states, base_at((first, second, third), clock), strict=True):
        model.gravity.linear = turn.T @ ROBOT.model.gravity.linear
        worst = max(worst, float((np.abs(pin.rnea(model, data, *state)) / ROBOT.torque_limit).max()))
    assert certificate.limit_use.torque >= worst
    assert worst <= 1.0 or any("as the base tilts" in text for text in certificate.violations)


@settings(max_examples=30)
@given(turns, turns, turns)
@example((0.0, -25.0, 0.0), (0.0, 37.0, 0.0), (0.0, 0.0, 0.0))
def test_the_largest_tilt_is_that_of_many_times(first, second, third):
    base = Poses.of(scene((first, second, third)).base_track)
    for begin, end in ((-3.0, -2.0), (-1.0, 1.5), (-2.0, 5.0), (4.0, 5.0)):
        rows = [time for time in base.times if begin <= time <= end]  # where the tilt has its peaks
        clock = np.sort(np.append(np.linspace(begin, end, 300), rows))
        seen = np.arccos(np.clip(base_at((first, second, third), clock)[:, 2, 2], -1.0, 1.0))
        assert seen.max() - 1e-7 <= largest_tilt(base, begin, end) <= seen.max() + 5e-3
    inside = largest_tilt(base, 1.6, 1.7)
    assert largest_tilt(base, 1.5, 3.0) == pytest.approx(inside)  # a piece counts as a whole


def test_a_base_that_turns_upright_adds_nothing():
    upright = ((0.0, 0.0, 10.0), (0.0, 0.0, 120.0), (0.0, 0.0, -40.0))
    still = certify(ROBOT, scene(((0.0, 0.0, 0.0),) * 3), motion()).limit_use
    assert certify(ROBOT, scene(upright), motion()).limit_use == still
