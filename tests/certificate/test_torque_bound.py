"""Torque bounds between samples against dense sampling with Pinocchio.

Including a tilting base.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from any_arms import LIFT, loaded_arm
from arm_variants import VARIANTS, load_variant
from hypothesis import example, given, settings
from hypothesis import strategies as st
from planned import straight
from scipy.spatial.transform import Rotation, Slerp

from hplan.certificate import torque_bound
from hplan.certificate.certificate import certify
from hplan.certificate.tilted_base import largest_tilt
from hplan.certificate.torque_bound import GAP, largest_torques
from hplan.robot.family.members import HARVESTER, write_robot
from hplan.robot.model import load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.tracks import Poses, Track
from hplan.trajectory.trajectory import Trajectory


def hermite(robot, time, position, velocity):
    zero = 0.0 * position
    return Trajectory(robot.joint_names, time, position, velocity, zero, zero)


def sampled(robot, bezier, duration, count):
    """(pieces, count, dof) torques by Pinocchio at equal steps of each piece, both ends among them."""
    data = robot.model.createData()
    t = np.linspace(0.0, 1.0, count)[:, None]
    u = 1.0 - t
    found = []
    for b, h in zip(bezier, duration, strict=True):
        q = u**3 * b[0] + 3 * u**2 * t * b[1] + 3 * u * t**2 * b[2] + t**3 * b[3]
        v = 3 * (u**2 * (b[1] - b[0]) + 2 * u * t * (b[2] - b[1]) + t**2 * (b[3] - b[2])) / h
        a = 6 * (u * (b[2] - 2 * b[1] + b[0]) + t * (b[3] - 2 * b[2] + b[1])) / h**2
        found.append([pin.rnea(robot.model, data, *row) for row in zip(q, v, a, strict=True)])
    return np.array(found)


def joint_share(robot, torque):
    return (np.abs(torque).reshape(-1, robot.dof).max(axis=0) / robot.torque_limit).max()


@pytest.mark.parametrize("name", [*VARIANTS, "lift"])
def test_bound_holds_and_is_close_for_random_rows(name, tmp_path, tmp_path_factory):
    """Samples 1 ms to 1 s apart, slow and fast, with acceleration jumps; prismatic joints."""
    robot = loaded_arm(name, tmp_path_factory) if name == "lift" else load_variant(name, tmp_path)
    rng = np.random.default_rng(1)
    for apart in (1e-3, 4e-3, 0.03, 0.2, 1.0):
        time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 1.5, 6) * apart)])
        speed = rng.uniform(-2.0, 2.0, (7, robot.dof))
        position = 0.3 * rng.normal(size=robot.dof) + np.cumsum(apart * rng.uniform(-1.5, 1.5, (7, robot.dof)), axis=0)
        bezier, duration = hermite(robot, time, position, speed).segments
        bound = largest_torques(robot.dynamics, bezier, duration, robot.torque_limit)
        true = sampled(robot, bezier, duration, 400)
        assert (bound >= np.abs(true).max(axis=(0, 1)) * (1.0 - 1e-12)).all()
        share = (bound / robot.torque_limit).max()
        # Excess between samples of a 400th, near the maximum: at most the excess of a parabola through three samples.
        between = np.abs(np.diff(true, 2, axis=1)).max() / 8.0 / robot.torque_limit.min()
        assert share <= joint_share(robot, true) + GAP + 2.0 * between


def test_second_derivative_is_bounded(tmp_path, tmp_path_factory):
    """The remainder of each piece against the curvature of densely sampled torques."""
    rng = np.random.default_rng(2)
    for name in ("upright on a yaw", "five links on a yaw", "tilted plane", "lift"):
        robot = loaded_arm(name, tmp_path_factory) if name == "lift" else load_variant(name, tmp_path)
        gravity = np.linalg.norm(robot.model.gravity.linear)
        for apart, swing in ((0.01, 2.0), (0.3, 2.0), (0.3, 0.01)):
            time = np.arange(6) * apart
            position = np.cumsum(swing * apart * rng.normal(size=(6, robot.dof)), axis=0)
            motion = hermite(robot, time, position, swing * rng.normal(size=(6, robot.dof)))
            bezier, duration = motion.segments
            remainder = torque_bound._remainders(bezier, duration, robot.dynamics.sizes, gravity)
            curvature = np.abs(np.diff(sampled(robot, bezier, duration, 400), 2, axis=1)).max(axis=1) * 399.0**2
            assert (curvature / 8.0 <= remainder + 1e-4).all()


@pytest.mark.parametrize("name", ["upright on a yaw", "lift"])
def test_pieces_that_share_a_remainder_have_that_of_all(name, tmp_path, tmp_path_factory):
    """For segments at maximum speed and slow ones, each as long as any."""
    robot = loaded_arm(name, tmp_path_factory) if name == "lift" else load_variant(name, tmp_path)
    rng, sizes = np.random.default_rng(3), robot.dynamics.sizes
    for _ in range(20):
        bezier = rng.normal(size=(7, 4, robot.dof)) * 10.0 ** rng.uniform(-3.0, 0.0, (7, 1, robot.dof))
        duration = rng.uniform(0.01, 0.3, 7)
        together = torque_bound._remainders(bezier, duration, sizes, 9.81)
        pieces = zip(bezier, duration, strict=True)
        alone = [torque_bound._remainders(one[None], np.array([h]), sizes, 9.81)[0] for one, h in pieces]
        assert (together >= np.array(alone) * (1.0 - 1e-12)).all()


@pytest.mark.parametrize("speed", [0.1, 3.0])
def test_second_derivative_at_constant_speed(tmp_path, speed):
    """Dominated by gravity at low speed, by rotation at high speed."""
    robot = load_variant("upright on a yaw", tmp_path)
    for joint in range(robot.dof):
        position, velocity = np.tile([0.2, 0.4, 0.3, -0.5], (2, 1)), np.zeros((2, 4))
        velocity[:, joint], position[1, joint] = speed, position[1, joint] + speed
        bezier, duration = hermite(robot, np.array([0.0, 1.0]), position, velocity).segments
        remainder = torque_bound._remainders(bezier, duration, robot.dynamics.sizes, 9.81)[0]
        curvature = np.abs(np.diff(sampled(robot, bezier, duration, 400)[0], 2, axis=0)).max(axis=0) * 399.0**2
        assert (curvature / 8.0 <= remainder * (1.0 + 1e-3) + 1e-6).all()


def test_torque_that_jumps_at_rows_is_seen_on_both_sides(tmp_path):
    """The shoulder moves down in steps, at rest at each sample.

    Its torque is maximal just before a sample.
    """
    write_robot(replace(HARVESTER, name="weak", effort=(150.0, 115.0, 120.0, 30.0)), tmp_path / "weak.urdf")
    robot, push = load_robot(tmp_path / "weak.urdf"), 3.0
    data = robot.model.createData()
    for rate in (1000, 125, 50):
        count = rate // 5 + 1
        time = np.arange(count) / rate
        position = np.zeros((count, 4))
        position[:, 1] = 0.3 - push / (6.0 * rate**2) * np.minimum(np.arange(count), count - 6)
        motion = hermite(robot, time, position, 0.0 * position)
        rest = np.array([pin.rnea(robot.model, data, q, np.zeros(4), np.zeros(4)) for q in position])
        before_a_row = pin.rnea(robot.model, data, position[1], np.zeros(4), np.array([0.0, push, 0.0, 0.0]))
        true = before_a_row[1] / robot.torque_limit[1]
        assert true > 1.19
        scene = Scene(
            name="creeping", start=Start(joints_rad=tuple(position[0])), goal=Goal(joints_rad=tuple(position[-1]))
        )
        certificate = certify(robot, scene, replace(motion, torque=rest))
        assert true - 1e-3 <= certificate.limit_use.torque <= true + 0.02
        assert [violation.split()[0] for violation in certificate.violations] == ["torque"]


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_bound_of_one_joint_that_turns_slowly(tmp_path, joint):
    """Gravity alone: the remainder is close to the truth, so that every half of an interval needs both its ends."""
    robot, rng = load_variant("upright on a yaw", tmp_path), np.random.default_rng(7)
    limit = np.full(4, 1e9)
    limit[joint] = 1.0
    for span in rng.uniform(0.3, 3.0, 30):
        position = np.tile(rng.uniform(-2.0, 2.0, 4), (2, 1))
        position[1, joint] += span
        velocity = np.zeros((2, 4))
        velocity[:, joint] = 1.0 / 40.0
        bezier, duration = hermite(robot, np.array([0.0, 40.0 * span]), position, velocity).segments
        true = np.abs(sampled(robot, bezier, duration, 501))[..., joint].max()
        assert true * (1.0 - 1e-9) <= largest_torques(robot.dynamics, bezier, duration, limit)[joint] <= 1.001 * true


def test_without_samples_to_spare_the_bound_holds_all_the_same(robot, monkeypatch):
    rng = np.random.default_rng(4)
    time, position = np.arange(5) * 0.5, 0.5 + 0.4 * rng.uniform(-1, 1, (5, 4))
    bezier, duration = hermite(robot, time, position, rng.uniform(-1, 1, (5, 4))).segments
    true = np.abs(sampled(robot, bezier, duration, 400)).max(axis=(0, 1))
    for samples in (0, 3, 30, 300):
        monkeypatch.setattr(torque_bound, "SAMPLES", samples)
        monkeypatch.setattr(torque_bound, "SAMPLES_PER_PIECE", 0)
        assert (largest_torques(robot.dynamics, bezier, duration, robot.torque_limit) >= true).all()


@pytest.mark.parametrize("value", [1e150, 1e300, -1e308])
def test_numbers_that_overflow_give_an_infinite_bound(robot, value, recwarn):
    velocity = np.zeros((3, 4))
    velocity[1, 1] = value
    bezier, duration = hermite(robot, np.arange(3) * 4e-3, np.zeros((3, 4)), velocity).segments
    assert largest_torques(robot.dynamics, bezier, duration, robot.torque_limit).max() == np.inf
    assert not recwarn.list


ROBOT = load_robot(LIFT.replace('effort="50"', 'effort="90"'))
BEGIN, END, DURATION = np.array([0.2, 0.3, 0.1, 0.4]), np.array([0.3, 0.5, 0.2, 0.2]), 4.0
TIMES = (-1.0, 1.5, 3.0)

turns = st.tuples(*(st.floats(-40.0, 40.0),) * 3)


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
    found, clock, model = straight(ROBOT, BEGIN, END, DURATION, 5.0), np.linspace(0.0, DURATION, 60), ROBOT.model.copy()
    certificate = certify(ROBOT, scene((first, second, third)), found)
    data, worst = model.createData(), 0.0
    states = [found.state_at(t) for t in clock.tolist()]
    for state, turn in zip(states, base_at((first, second, third), clock), strict=True):
        model.gravity.linear = turn.T @ ROBOT.model.gravity.linear
        worst = max(worst, float((np.abs(pin.rnea(model, data, *state)) / ROBOT.torque_limit).max()))
    assert certificate.limit_use.torque >= worst
    assert worst <= 1.0 or any("as the base tilts" in text for text in certificate.violations)


@settings(max_examples=30)
@given(turns, turns, turns)
@example((0.0, -25.0, 0.0), (0.0, 37.0, 0.0), (0.0, 0.0, 0.0))
def test_the_largest_tilt_is_that_of_many_times(first, second, third):
    base = Poses.from_track(scene((first, second, third)).base_track)
    for begin, end in ((-3.0, -2.0), (-1.0, 1.5), (-2.0, 5.0), (4.0, 5.0)):
        rows = [time for time in base.times if begin <= time <= end]  # peaks of the tilt
        clock = np.sort(np.append(np.linspace(begin, end, 300), rows))
        seen = np.arccos(np.clip(base_at((first, second, third), clock)[:, 2, 2], -1.0, 1.0))
        assert seen.max() - 1e-7 <= largest_tilt(base, begin, end) <= seen.max() + 5e-3
    inside = largest_tilt(base, 1.6, 1.7)
    assert largest_tilt(base, 1.5, 3.0) == pytest.approx(inside)  # a piece counts as a whole


def test_base_that_turns_upright_adds_nothing():
    upright = ((0.0, 0.0, 10.0), (0.0, 0.0, 120.0), (0.0, 0.0, -40.0))
    still = certify(ROBOT, scene(((0.0, 0.0, 0.0),) * 3), straight(ROBOT, BEGIN, END, DURATION, 5.0)).limit_use
    assert certify(ROBOT, scene(upright), straight(ROBOT, BEGIN, END, DURATION, 5.0)).limit_use == still
