"""Trajectories: samples and files, stops, jerk-limited timing, rounded corners."""

from __future__ import annotations

import csv
import itertools
import time
import tracemalloc
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from hypothesis.extra.numpy import arrays
from planned import on_cubics

from hplan.errors import InputError, OptionError, OutputError, TimingError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.limits import Limits
from hplan.robot.model import Robot, load_robot
from hplan.trajectory import rounded_path
from hplan.trajectory.braking import braking
from hplan.trajectory.corner_rounding import largest_path_deviation
from hplan.trajectory.retime import GRID_POINTS, time_path
from hplan.trajectory.speed_profile import parameter_grid
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.trajectory import Trajectory, csv_header, join_trajectories, read_csv, write_csv

HEADER = "time_s,a_pos_rad,a_vel_rad_s,a_acc_rad_s2,a_torque_nm"
FIELDS = ("time", "position", "velocity", "acceleration", "torque")


def some_trajectory(samples: int = 5, joints: tuple[str, ...] = ("base_yaw", "shoulder")) -> Trajectory:
    rng = np.random.default_rng(0)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(1e-3, 0.1, samples - 1))])
    return Trajectory(joints, time, *rng.normal(size=(4, samples, len(joints))))


def assert_equal(one: Trajectory, other: Trajectory) -> None:
    assert one.joint_names == other.joint_names
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field))


# The trajectory


def test_positions_and_states_between_rows_are_those_of_the_cubics():
    from scipy.interpolate import CubicHermiteSpline

    trajectory = some_trajectory(7)
    curve = CubicHermiteSpline(trajectory.time, trajectory.position, trajectory.velocity)
    clock = np.linspace(0.0, trajectory.duration, 200)
    np.testing.assert_allclose(trajectory.positions(clock), curve(clock), rtol=0, atol=1e-12)
    outside = trajectory.positions(np.array([-1.0, trajectory.duration + 1.0]))
    np.testing.assert_allclose(outside, trajectory.position[[0, -1]], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(some_trajectory(1).positions(np.zeros(2)), some_trajectory(1).position[[0, 0]])
    assert trajectory.velocity[0].any()
    for t in (-1e-13, 0.0, 0.3 * trajectory.duration, 0.71 * trajectory.duration):  # rounding is not before the start
        for order, values in enumerate(trajectory.state_at(t)):
            np.testing.assert_allclose(values, curve(max(t, 0.0), order), rtol=1e-9, atol=1e-9)
    for t, row in ((-1.0, 0), (trajectory.duration, -1), (trajectory.duration + 1.0, -1)):
        q, v, a = trajectory.state_at(t)
        np.testing.assert_array_equal(q, trajectory.position[row])
        assert not v.any()
        assert not a.any()
    with pytest.raises(OptionError, match="t"):
        trajectory.state_at(float("nan"))


# Backwards, and one after the other


def ending_at_rest(samples: int, begin: float, end: float, names: tuple[str, ...] = ("a", "b")) -> Trajectory:
    """A motion of all joints from one value to another."""
    share = np.linspace(0.0, 1.0, samples)[:, None] if samples > 1 else np.zeros((1, 1))
    position = np.repeat(begin + (end - begin) * share, len(names), axis=1)
    velocity = np.repeat((end - begin) * share * (1.0 - share), len(names), axis=1)
    more = np.random.default_rng(samples).normal(size=(2, samples, len(names)))
    return Trajectory(names, np.linspace(0.0, 0.4 * (samples - 1), samples), position, velocity, *more)


def test_backwards():
    trajectory = some_trajectory(7)
    back = trajectory.reversal
    assert back.duration == trajectory.duration
    np.testing.assert_allclose(back.time, trajectory.duration - trajectory.time[::-1], atol=1e-15)
    np.testing.assert_array_equal(back.position, trajectory.position[::-1])
    np.testing.assert_array_equal(back.velocity, -trajectory.velocity[::-1])
    np.testing.assert_array_equal(back.acceleration, trajectory.acceleration[::-1])
    np.testing.assert_array_equal(back.torque, trajectory.torque[::-1])
    twice = back.reversal
    np.testing.assert_allclose(twice.time, trajectory.time, atol=1e-15)
    for field in FIELDS[1:]:
        np.testing.assert_array_equal(getattr(twice, field), getattr(trajectory, field))
    assert some_trajectory(1).reversal.samples == 1


def test_one_after_the_other():
    stretches = ((5, 0.0, 1.0), (1, 1.0, 1.0), (4, 1.0, -0.5), (3, -0.5, 0.0))
    parts = [ending_at_rest(*stretch) for stretch in stretches]
    whole = join_trajectories(parts)
    assert whole.samples == 5 + 0 + 3 + 2
    assert whole.duration == pytest.approx(sum(part.duration for part in parts))
    assert (np.diff(whole.time) > 0.0).all()
    np.testing.assert_array_equal(whole.position[:5], parts[0].position)
    for field in FIELDS[1:]:
        np.testing.assert_array_equal(getattr(whole, field)[5:8], getattr(parts[2], field)[1:])
        np.testing.assert_array_equal(getattr(whole, field)[8:], getattr(parts[3], field)[1:])
    np.testing.assert_allclose(whole.time[5:8], 1.6 + parts[2].time[1:])
    assert_equal(join_trajectories(parts[:1]), parts[0])
    assert join_trajectories([ending_at_rest(1, 1.0, 1.0)] * 3).samples == 1


def test_discontinuous_motions_are_not_joined():
    first = ending_at_rest(5, 0.0, 1.0)
    with pytest.raises(InputError, match="no motion"):
        join_trajectories([])
    with pytest.raises(InputError, match="motion 1 moves other joints"):
        join_trajectories([first, ending_at_rest(5, 1.0, 2.0, ("b", "a"))])
    for gap in (0.1, -2.0 * 1e-9):
        with pytest.raises(InputError, match="motion 2 does not begin where the one before it ends") as caught:
            join_trajectories([first, first.reversal, ending_at_rest(5, gap, 2.0)])
        assert caught.value.data["motion"] == 2
    join_trajectories([first, first.reversal, ending_at_rest(5, 0.5 * 1e-9, 2.0)])
    moving = Trajectory(first.joint_names, first.time, first.position + 1.0, first.velocity + 0.1, *np.zeros((2, 5, 2)))
    with pytest.raises(InputError, match="does not begin where"):
        join_trajectories([first, moving])


# CSV


def test_file_is_rfc_4180(tmp_path):
    trajectory = some_trajectory(3)
    data = write_csv(trajectory, tmp_path / "t.csv").read_bytes()
    lines = data.decode("ascii").split("\r\n")
    assert lines[-1] == ""
    assert "\n" not in "".join(lines)
    assert lines[0] == ",".join(csv_header(trajectory.joint_names))
    assert [line.count(",") for line in lines[:-1]] == [8, 8, 8, 8]
    assert not set('"# ') & set(data.decode())


def test_columns_follow_the_header(tmp_path):
    trajectory = some_trajectory()
    path = write_csv(trajectory, tmp_path / "t.csv")
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    for name, field in zip(("pos_rad", "vel_rad_s", "acc_rad_s2", "torque_nm"), FIELDS[1:], strict=True):
        values = [float(row[f"shoulder_{name}"]) for row in rows]
        assert values == getattr(trajectory, field)[:, 1].tolist()
    assert [float(row["time_s"]) for row in rows] == trajectory.time.tolist()


@settings(max_examples=60)
@given(
    st.integers(1, 6).flatmap(
        lambda n: st.tuples(
            st.lists(st.floats(1e-300, 1e6), min_size=n - 1, max_size=n - 1),
            arrays(np.float64, (4, n, 2), elements=st.floats(allow_nan=False, allow_infinity=False)),
        )
    )
)
def test_round_trip_is_exact(tmp_path_factory, content):
    steps, values = content
    time = np.unique(np.concatenate([[0.0], np.cumsum(steps)]))
    values = values[:, : len(time)]
    trajectory = Trajectory(("a", "b_2"), time, *values)
    path = tmp_path_factory.mktemp("csv") / "t.csv"
    assert_equal(read_csv(write_csv(trajectory, path)), trajectory)


@pytest.mark.parametrize("name", ["a,b", 'say "a"', "x_pos_rad", "Gelenk ä", "two\nlines"])
def test_odd_joint_names_are_quoted(tmp_path, name):
    trajectory = some_trajectory(joints=(name, "b"))
    assert_equal(read_csv(write_csv(trajectory, tmp_path / "t.csv")), trajectory)


@pytest.mark.parametrize("text", [f"{HEADER}\n0,1,2,3,4\n1,1,2,3,4\n", f"\ufeff{HEADER}\r\n0,1,2,3,4\r\n1,1,2,3,4"])
def test_reads_files_of_other_programs(tmp_path, text):
    """Line feeds alone, a byte order mark, whole numbers, no line end at the end."""
    (tmp_path / "t.csv").write_bytes(text.encode())
    trajectory = read_csv(tmp_path / "t.csv")
    assert trajectory.joint_names == ("a",)
    assert trajectory.time.tolist() == [0.0, 1.0]
    assert trajectory.torque.tolist() == [[4.0], [4.0]]


@pytest.mark.parametrize(
    ("rows", "line", "message"),
    [
        ([], 1, "expected the columns"),
        (["time_s,a_vel_rad_s,a_pos_rad,a_acc_rad_s2,a_torque_nm"], 1, "expected the columns"),
        ([HEADER], 1, "no samples"),
        ([HEADER, "0,0,0,0,0", "1,0,0,0"], 3, "4 values, expected 5"),
        ([HEADER, "0,0,0,0,0", "1,0,0,x,0"], 3, "a_acc_rad_s2 is 'x', expected a finite number"),
        ([HEADER, "0,nan,0,0,0"], 2, "a_pos_rad is 'nan', expected a finite number"),
        ([HEADER, "0.5,0,0,0,0"], 2, "time_s is 0.5, expected 0"),
        ([HEADER, "0,0,0,0,0", "1,0,0,0,0", "1,0,0,0,0"], 4, "not later than"),
        ([HEADER, '0,"0,0,0,0'], 2, "unexpected end of data"),
    ],
)
def test_bad_files_name_the_line(tmp_path, rows, line, message):
    path = tmp_path / "t.csv"
    path.write_bytes("\r\n".join(rows).encode())
    with pytest.raises(InputError, match=message) as caught:
        read_csv(path)
    assert f"{path}, line {line}: " in caught.value.message
    assert caught.value.data["line"] == line


def test_failed_write_leaves_nothing(tmp_path):
    with pytest.raises(OutputError):
        write_csv(some_trajectory(), tmp_path / "nowhere" / "t.csv")
    (tmp_path / "t.csv").mkdir()
    with pytest.raises(OutputError, match="folder"):
        write_csv(some_trajectory(), tmp_path / "t.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["t.csv"]


PARTS = st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).map(np.array)
PERIOD = 4e-3


@settings(max_examples=60)
@given(speed=PARTS, push=PARTS, less=st.floats(0.1, 1.0))
def test_a_stop_goes_on_from_the_state_keeps_limits_and_ends_at_rest(speed, push, less):
    robot = load_robot()
    state = np.zeros(4), speed * robot.velocity_limit, push * robot.acceleration_limit
    found = braking(robot, *state, PERIOD, less * robot.acceleration_limit)
    assert found is not None
    for values, asked in zip((found.position, found.velocity, found.acceleration), state, strict=True):
        np.testing.assert_array_equal(values[0], asked)
    assert not found.velocity[-1].any()
    assert not found.acceleration[-1].any()
    most = np.maximum(less * robot.acceleration_limit, np.abs(state[2]))
    assert (np.abs(found.acceleration) <= most * (1.0 + 1e-9)).all()
    jerk = np.diff(found.acceleration, axis=0) / PERIOD
    assert (np.abs(jerk) <= robot.jerk_limit * (1.0 + 1e-6) + 1e-6).all()
    bezier, duration = found.segments
    bent = 6.0 * np.diff(bezier, n=2, axis=1) / duration[:, None, None] ** 2
    np.testing.assert_allclose(bent[:, 0], found.acceleration[:-1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(bent[:, 1], found.acceleration[1:], rtol=0, atol=1e-6)


@settings(max_examples=30)
@given(speed=PARTS)
def test_a_stop_is_quick(speed):
    """Speed by acceleration, and the jerk's ramps of the slowest joint."""
    robot = load_robot()
    zero, fast = np.zeros(4), speed * robot.velocity_limit
    found = braking(robot, zero, fast, zero, PERIOD, robot.acceleration_limit)
    ramp = robot.acceleration_limit / robot.jerk_limit
    alone = np.where(
        np.abs(fast) > ramp * robot.acceleration_limit,
        np.abs(fast) / robot.acceleration_limit + ramp,
        2.0 * np.sqrt(np.abs(fast) / robot.jerk_limit),
    )
    assert alone.max() - 2.0 * PERIOD <= found.duration <= 1.1 * alone.max() + 8.0 * PERIOD


def test_joint_that_cannot_brake(robot):
    fast, zero = robot.velocity_limit, np.zeros(4)
    assert braking(robot, zero, fast, zero, PERIOD, np.full(4, 1e-6)) is None


RATE = 250.0
FINE = 1e-4

START, GOAL = np.array([0.1, 0.2, 0.3, 0.2]), np.array([0.4, 1.2, 0.8, 1.0])


@pytest.fixture(scope="module")
def limits(robot):
    return Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)


@pytest.fixture(scope="module")
def smooth_limits(limits):
    """Without limits on jerk."""
    return replace(limits, jerk=None)


@pytest.fixture(scope="module")
def reference_path(robot, scene):
    return SplinePath.from_control_points(plan(robot, scene, PlanOptions(effort="quick")).trajectory.position[::40])


def straight(start, end, count=5):
    return SplinePath.from_control_points(np.linspace(start, end, count))


def curve(seed, robot, count=7, share=0.8):
    """A random spline within the joint limits."""
    rng = np.random.default_rng(seed)
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * share * (robot.upper - robot.lower)
    half[0] = min(half[0], 1.0)
    return SplinePath.from_control_points(middle + rng.uniform(-half, half, (count, robot.dof)))


def joint_turn(robot, joint, angle, start=0.1):
    q = np.full(robot.dof, start)
    end = q.copy()
    end[joint] += angle
    return straight(q, end)


def hermite(trajectory, step=FINE):
    """Time and position of the cubic Hermite curve through the samples, every `step` s."""
    time = np.arange(0.0, trajectory.duration + 0.5 * step, step)
    return on_cubics(trajectory, time)


def inverse_dynamics(model, q, v, a):
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])


def row_uses(trajectory, limits):
    """(samples,) maximum use of any limit, jerk between samples included."""
    shares = [np.abs(trajectory.velocity) / limits.velocity, np.abs(trajectory.acceleration) / limits.acceleration]
    if limits.torque is not None:
        shares.append(np.abs(trajectory.torque) / limits.torque)
    use = np.max(shares, axis=(0, 2))
    if limits.jerk is not None:
        jerk = jerk_uses(trajectory, limits)
        use = np.maximum(use, np.maximum(np.append(jerk, 0.0), np.append(0.0, jerk)))
    return use


def jerk_uses(trajectory, limits):
    """(samples - 1,) use of the jerk limit; acceleration is linear between samples."""
    step = np.diff(trajectory.time)[:, None]
    return (np.abs(np.diff(trajectory.acceleration, axis=0)) / step / limits.jerk).max(axis=1)


def assert_sound(trajectory, model, limits, *, rate=RATE, path=None, jerk=True):
    """Check uniform time, rest, ends, consistent columns, limits at and between samples."""
    steps = np.diff(trajectory.time)
    assert trajectory.time[0] == 0.0
    assert (steps > 0.0).all()
    np.testing.assert_allclose(trajectory.time, np.arange(trajectory.samples) / rate, rtol=1e-12)
    for row, s in ((0, 0.0), (-1, None)):
        assert not trajectory.velocity[row].any()
        assert not trajectory.acceleration[row].any()
        if path is not None:
            np.testing.assert_array_equal(trajectory.position[row], path.evaluate(path.breaks[-1] if s is None else s))
    torque = inverse_dynamics(model, trajectory.position, trajectory.velocity, trajectory.acceleration)
    np.testing.assert_allclose(trajectory.torque, torque, atol=1e-9)
    assert (np.abs(trajectory.velocity) <= 1.001 * limits.velocity + 1e-12).all()
    assert (np.abs(trajectory.acceleration) <= 1.001 * limits.acceleration + 1e-12).all()
    if limits.torque is not None:
        assert (np.abs(torque) <= 1.001 * limits.torque + 1e-12).all()
    if jerk and limits.jerk is not None:
        assert jerk_uses(trajectory, limits).max(initial=0.0) <= 1.001
    if trajectory.samples < 3:
        return
    # The samples form one cubic spline: its acceleration from positions and velocities of two samples equals the
    # column.
    h, q, w = 1.0 / rate, np.diff(trajectory.position, axis=0), trajectory.velocity
    noise = 5e-12 / h**2 * (1.0 + np.abs(trajectory.position).max()) + 1e-7
    np.testing.assert_allclose(6 * q / h**2 - (4 * w[:-1] + 2 * w[1:]) / h, trajectory.acceleration[:-1], atol=noise)
    np.testing.assert_allclose((2 * w[:-1] + 4 * w[1:]) / h - 6 * q / h**2, trajectory.acceleration[1:], atol=noise)
    # As a controller will interpolate it.
    step = min(FINE, 0.1 / rate)
    q = hermite(trajectory, step)[:200_000]
    v, a = np.diff(q, axis=0) / step, np.diff(q, 2, axis=0) / step**2
    noise = 8 * np.finfo(float).eps * np.abs(q).max()
    assert (np.abs(v) <= 1.001 * limits.velocity + noise / step).all()
    assert (np.abs(a) <= 1.001 * limits.acceleration + noise / step**2).all()
    if limits.torque is not None:
        keep = slice(None, None, max(1, len(a) // 2000))
        torque = inverse_dynamics(model, q[1:-1][keep], 0.5 * (v[1:] + v[:-1])[keep], a[keep])
        assert (np.abs(torque) <= 1.001 * limits.torque + 1e-6).all()


# Limits


@pytest.mark.parametrize("jerk", [False, True])
def test_reference_motion(robot, limits, smooth_limits, reference_path, jerk):
    kept = limits if jerk else smooth_limits
    trajectory = time_path(reference_path, robot.model, kept)
    assert_sound(trajectory, robot.model, kept, path=reference_path)
    assert (trajectory.position >= robot.lower - 1e-12).all()
    assert (trajectory.position <= robot.upper + 1e-12).all()
    assert (trajectory.position[:, 0] == trajectory.position[0, 0]).all()


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 10**6), st.integers(4, 12), st.sampled_from([60.0, 250.0, 1000.0]), st.booleans())
def test_random_motions_keep_their_limits(robot, limits, smooth_limits, seed, count, rate, with_jerk):
    path = curve(seed, robot, count)
    kept = limits if with_jerk else smooth_limits
    trajectory = time_path(path, robot.model, kept, rate_hz=rate)
    assert_sound(trajectory, robot.model, kept, rate=rate, path=path, jerk=False)


@pytest.mark.parametrize("rate", [60.0, 250.0, 1000.0])
def test_jerk_of_random_motions(robot, limits, rate):
    uses = [
        jerk_uses(time_path(curve(s, robot, 8), robot.model, limits, rate_hz=rate), limits).max() for s in range(12)
    ]
    assert max(uses) <= 1.001


def test_tight_torque_limit_slows_motion_and_holds(robot, smooth_limits):
    path = straight(START, GOAL)
    data = robot.model.createData()
    static = np.abs(
        [pin.computeGeneralizedGravity(robot.model, data, q) for q in path.evaluate(np.linspace(0, path.end, 400))]
    ).max(axis=0)
    durations = []
    for share in (1.003, 1.03, 1.3, 3.0):
        kept = replace(smooth_limits, torque=np.maximum(share * static, 5.0))
        trajectory = time_path(path, robot.model, kept)
        assert_sound(trajectory, robot.model, kept, path=path)
        durations.append(trajectory.duration)
    assert durations == sorted(durations, reverse=True)
    assert durations[0] > 1.5 * durations[-1]
    without = time_path(path, robot.model, replace(smooth_limits, torque=None))
    assert without.duration <= durations[-1] + 1e-9


def torque_bound(robot, smooth_limits, path, share):
    """Limits that make the torque binding, a fraction above gravity's."""
    data = robot.model.createData()
    static = [
        np.abs(pin.computeGeneralizedGravity(robot.model, data, q))
        for q in path.evaluate(np.linspace(0, path.end, 400))
    ]
    return Limits(
        2.0 * smooth_limits.velocity, 10.0 * smooth_limits.acceleration, np.maximum(share * np.max(static, axis=0), 3.0)
    )


@pytest.mark.parametrize("rate", [10.0, 25.0, 50.0])
def test_torque_of_motions_bound_by_it(robot, smooth_limits, rate):
    for seed in range(4):
        path = curve(seed, robot)
        kept = torque_bound(robot, smooth_limits, path, 1.3)
        assert_sound(time_path(path, robot.model, kept, rate_hz=rate), robot.model, kept, rate=rate, path=path)


def test_rows_are_near_the_path(robot, limits):
    path = curve(3, robot)
    fine = path.evaluate(np.linspace(0.0, path.end, 20001))
    trajectory = time_path(path, robot.model, limits)
    off = max(np.abs(fine - q).max(axis=1).min() for q in trajectory.position)
    window = 2.0 * (limits.acceleration / limits.jerk).max() + 2.0 / RATE
    assert off <= limits.acceleration.max() * window**2 / 24.0


@pytest.mark.parametrize("seed", [2, 7])
def test_little_is_lost_with_few_points(robot, smooth_limits, seed):
    """Excesses between two of few points are corrected locally."""
    path = curve(seed, robot)
    few, many = (
        time_path(path, robot.model, smooth_limits, grid=parameter_grid(path, points)) for points in (GRID_POINTS, 3200)
    )
    assert few.duration <= 1.015 * many.duration
    assert np.median(row_uses(few, smooth_limits)) >= 0.9


# Durations by hand


@pytest.mark.parametrize("with_jerk", [False, True])
@pytest.mark.parametrize("angle", [-1.2, 0.01, 0.1, 0.47, 1.3])
@pytest.mark.parametrize("joint", [0, 1, 3])
def test_duration_of_a_single_joint(robot, limits, smooth_limits, joint, angle, with_jerk):
    kept = replace(limits if with_jerk else smooth_limits, torque=None)
    v, a = kept.velocity[joint], kept.acceleration[joint]
    turn = abs(angle)
    fastest = 2.0 * np.sqrt(turn / a) if turn <= v * v / a else turn / v + v / a
    allowed = 4.0 / RATE + (2.0 * a / kept.jerk[joint] if with_jerk else 0.0)
    path = joint_turn(robot, joint, angle, start=1.3 if angle < 0 else 0.1)
    duration = time_path(path, robot.model, kept).duration
    assert fastest * (1 - 1e-3) <= duration <= fastest * (1 + 1e-3) + allowed


def test_share_of_the_speed(robot, limits, smooth_limits):
    path = curve(5, robot)
    free = replace(smooth_limits, torque=None)
    full = time_path(path, robot.model, free).duration
    for share in (0.5, 0.1):
        slow = free.scale(share)
        trajectory = time_path(path, robot.model, slow)
        assert_sound(trajectory, robot.model, slow, path=path)
        assert trajectory.duration == pytest.approx(full / share, rel=0.02)
    half = limits.scale(0.5)
    np.testing.assert_array_equal(half.velocity, 0.5 * limits.velocity)
    np.testing.assert_array_equal(half.acceleration, 0.25 * limits.acceleration)
    np.testing.assert_array_equal(half.jerk, 0.125 * limits.jerk)
    np.testing.assert_array_equal(half.torque, limits.torque)
    assert smooth_limits.scale(1.0).jerk is None
    assert free.scale(0.3).torque is None


@pytest.mark.parametrize(("where", "share"), [("start", (0.0, 0.0, 0.0, 1.0)), ("end", (0.0, 3.0, -3.0, 1.0))])
def test_path_with_constant_parameter_is_refused(robot, limits, where, share):
    """As in an optimized motion, which begins and ends at rest."""

    class Path:
        breaks = np.array([0.0, 1.0])

        def evaluate(self, s, derivative=0):
            part = np.polynomial.Polynomial(share).deriv(derivative)(np.asarray(s))
            return START * (derivative == 0) + np.multiply.outer(part, GOAL - START)

    with pytest.raises(TimingError, match=f"zero derivative at its {where}"):
        time_path(Path(), robot.model, limits)


# Small, closed and awkward motions


@pytest.mark.parametrize("angle", [2e-7, 1e-6, 1e-5, 1e-4])
@pytest.mark.parametrize("joint", [1, 3])
def test_tiny_motion(robot, limits, joint, angle):
    path = joint_turn(robot, joint, angle)
    trajectory = time_path(path, robot.model, limits)
    assert_sound(trajectory, robot.model, limits, path=path)
    assert 0.0 < trajectory.duration < 0.05


def there_and_back():
    out = np.linspace(START, GOAL, 7)
    return np.vstack([out, out[-2::-1]])


def with_twins(count, spread=0.0):
    rng = np.random.default_rng(1)
    middle = 0.5 * (START + GOAL) + np.array([0.0, 0.2, 0.0, 0.0])
    twins = middle + spread * rng.normal(size=(count, 4))
    return np.vstack([START, twins, GOAL - [0.0, 0.3, 0.0, 0.1], GOAL])


AWKWARD = {
    "twin control points": partial(with_twins, 2),
    "three equal control points": partial(with_twins, 3),
    "nearly equal control points": partial(with_twins, 2, 1e-6),
    "there and back": there_and_back,
    "many control points": lambda: np.linspace(START, GOAL, 90) + 1e-3 * np.random.default_rng(2).normal(size=(90, 4)),
    "a crooked step at the end": lambda: np.vstack([np.linspace(START, GOAL, 8), GOAL + np.array([1e-3, 0, -1e-3, 0])]),
    "steps of very different size": lambda: (
        START + np.cumsum(0.3 * np.logspace(-4, 0, 8)[:, None] * np.random.default_rng(3).normal(size=(8, 4)), axis=0)
    ),
}


@pytest.mark.parametrize("case", AWKWARD)
def test_awkward_paths(robot, smooth_limits, case):
    path = SplinePath.from_control_points(AWKWARD[case]())
    trajectory = time_path(path, robot.model, smooth_limits)
    assert_sound(trajectory, robot.model, smooth_limits, path=path)
    assert trajectory.duration < 12.0


# Rates and robots


@pytest.mark.parametrize("rate", [1.0, 20.0, 5000.0])
@pytest.mark.parametrize("with_jerk", [False, True])
def test_rates(robot, limits, smooth_limits, rate, with_jerk):
    kept = limits if with_jerk else smooth_limits
    path = straight(START, GOAL)
    trajectory = time_path(path, robot.model, kept, rate_hz=rate)
    assert_sound(trajectory, robot.model, kept, rate=rate, path=path, jerk=rate < 1000.0)
    fastest = time_path(path, robot.model, smooth_limits, rate_hz=2000.0).duration
    window = 2.0 * (limits.acceleration / limits.jerk).max() if with_jerk else 0.0
    assert fastest * (1 - 5e-3) <= trajectory.duration <= fastest * (1 + 5e-3) + 4.0 / rate + window


def test_motions_of_too_many_rows_are_refused_before_they_are_made(robot, scene):
    """A thousandth of full speed: half an hour, 450,000 samples."""
    begin = time.process_time()
    tracemalloc.start()
    with pytest.raises(OptionError, match=r"motion of 1\d\d\d s would have 4\d\d,\d\d\d") as error:
        plan(robot, scene, PlanOptions(speed=1e-3))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert error.value.data["option"] == "rate_hz"
    assert peak < 2e8
    assert time.process_time() - begin < 100.0  # seconds, kernels compiled in it
    with pytest.raises(OptionError, match="samples"):
        plan(robot, scene, PlanOptions(speed=1e-9))


def test_sharp_bend_does_not_slow_the_whole_motion(robot: Robot) -> None:
    """A corner rounded within 1e-4 rad must not slow the rest of the motion."""
    corner = np.array([[0.0, 0.2, 0.2, 0.2], [0.0, 0.9, 0.2, 0.9], [0.0, 0.9, 0.9, 0.9]])
    path = rounded_path(corner, 1e-4)
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    trajectory = time_path(path, robot.dynamics, limits)
    parts = [rounded_path(corner[:2], 1e-4), rounded_path(corner[1:], 1e-4)]
    apart = sum(time_path(part, robot.dynamics, limits).duration for part in parts)
    assert trajectory.duration <= 1.02 * apart
    assert (np.abs(trajectory.velocity) <= robot.velocity_limit * (1.0 + 1e-3)).all()
    assert (np.abs(trajectory.acceleration) <= robot.acceleration_limit * (1.0 + 1e-3)).all()


def frechet_distance_is_within(curve: np.ndarray, points: np.ndarray, bound: float) -> bool:
    """True if the discrete Frechet distance of dense points is within a bound."""
    near = np.linalg.norm(curve[:, None] - points[None], axis=2) <= bound
    reach = np.zeros_like(near)
    for i, j in itertools.product(*map(range, near.shape)):
        before = (i == 0 and j == 0) or reach[max(i - 1, 0) : i + 1, max(j - 1, 0) : j + 1].any()
        reach[i, j] = near[i, j] and before
    return bool(reach[-1, -1])


coordinate = st.one_of(
    st.floats(-3.0, 3.0), st.sampled_from([0.0, 1.0, 1.0 + 1e-9, 1.0 - 1e-6, 1.01, -1.0]), st.floats(-1e-6, 1e-6)
)
polylines = npst.arrays(np.float64, st.tuples(st.integers(2, 9), st.integers(1, 4)), elements=coordinate)


@settings(max_examples=300)
@given(polylines, st.sampled_from([1e-4, 1e-2, 0.1, 1.0]))
@example(np.array([[0.0], [1.0], [0.0]]), 0.1)
@example(np.array([[0.0, 0], [1, 0], [0, 1e-9], [1, 1]]), 0.01)
@example(np.array([[0.0, 0], [1, 0], [1, 1e-4], [0, 1e-4]]), 0.01)
@example(np.array([[0.0, 0], [1e-7, 0], [1e-7, 1e-7], [1, 1]]), 1e-4)
def test_path_keeps_to_the_polyline(points, deviation):
    path = rounded_path(points, deviation)
    curve = path.evaluate(np.linspace(0.0, path.end, 4000))
    assert largest_path_deviation(curve, points) <= deviation + 1e-12
    np.testing.assert_allclose(path.evaluate([0.0, path.end]), points[[0, -1]], rtol=1e-15, atol=2e-9)
    # Joint limits that the waypoints keep.
    assert (path.pieces >= points.min(axis=0) - 1e-12).all()
    assert (path.pieces <= points.max(axis=0) + 1e-12).all()
    assert (np.diff(path.breaks) > 0.0).all()
    # Every waypoint is passed, in turn: none before the one it follows.
    distance = np.linalg.norm(curve[:, None] - points[None], axis=2) <= deviation + path.end / 4000
    at = 0
    for passed in distance.T:
        assert passed[at:].any()
        at += int(passed[at:].argmax())


@settings(max_examples=40)
@given(polylines, st.sampled_from([0.03, 0.3]))
def test_path_runs_along_the_polyline(points, deviation):
    path = rounded_path(points, deviation)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assume(length < 15.0)
    step = 0.05
    curve = path.evaluate(np.linspace(0.0, path.end, 2 + int(path.end / step)))
    pieces = [
        a + (b - a) * np.linspace(0, 1, 2 + int(np.linalg.norm(b - a) / step))[:, None]
        for a, b in itertools.pairwise(points)
    ]
    assert frechet_distance_is_within(curve, np.concatenate(pieces), deviation + step)


def test_deviation_is_used():
    """At a lone corner the deviation is the allowed one after thinning."""
    path = rounded_path([[0, 0], [1, 0], [1, 1]], 0.02)
    s = np.linspace(0, path.end, 20_001)
    assert np.linalg.norm(path.evaluate(s) - [1, 0], axis=1).min() == pytest.approx(0.015, rel=1e-6)


def test_parameter_is_the_length_and_curvature_is_continuous():
    path = rounded_path([[0, 0], [1, 0], [1, 2]], 0.02)
    speed = np.linalg.norm(path.evaluate(np.linspace(0, path.end, 1000), 1), axis=1)
    assert speed.max() == pytest.approx(1.0)
    assert np.median(speed) == pytest.approx(1.0)
    for at in path.breaks[1:-1]:
        sides = path.evaluate([at - 1e-9, at + 1e-9], 2)
        np.testing.assert_allclose(sides[0], sides[1], atol=1e-5)
