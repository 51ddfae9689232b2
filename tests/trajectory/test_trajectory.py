from __future__ import annotations

import csv

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hplan.errors import InputError, OptionError, OutputError
from hplan.trajectory.trajectory import Trajectory, csv_header, joined, read_csv, write_csv

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


def test_positions_between_rows_are_on_the_cubics():
    from scipy.interpolate import CubicHermiteSpline

    trajectory = some_trajectory(7)
    curve = CubicHermiteSpline(trajectory.time, trajectory.position, trajectory.velocity)
    clock = np.linspace(0.0, trajectory.duration, 200)
    np.testing.assert_allclose(trajectory.positions(clock), curve(clock), rtol=0, atol=1e-12)
    outside = trajectory.positions(np.array([-1.0, trajectory.duration + 1.0]))
    np.testing.assert_allclose(outside, trajectory.position[[0, -1]], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(some_trajectory(1).positions(np.zeros(2)), some_trajectory(1).position[[0, 0]])


def test_states_are_those_of_the_cubics():
    from scipy.interpolate import CubicHermiteSpline

    trajectory = some_trajectory(5)
    curve = CubicHermiteSpline(trajectory.time, trajectory.position, trajectory.velocity)
    assert trajectory.velocity[0].any()
    for t in (-1e-13, 0.0, 0.3 * trajectory.duration, 0.71 * trajectory.duration):  # rounding is not before the begin
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
    back = trajectory.reversed
    assert back.duration == trajectory.duration
    np.testing.assert_allclose(back.time, trajectory.duration - trajectory.time[::-1], atol=1e-15)
    np.testing.assert_array_equal(back.position, trajectory.position[::-1])
    np.testing.assert_array_equal(back.velocity, -trajectory.velocity[::-1])
    np.testing.assert_array_equal(back.acceleration, trajectory.acceleration[::-1])
    np.testing.assert_array_equal(back.torque, trajectory.torque[::-1])
    twice = back.reversed
    np.testing.assert_allclose(twice.time, trajectory.time, atol=1e-15)
    for field in FIELDS[1:]:
        np.testing.assert_array_equal(getattr(twice, field), getattr(trajectory, field))
    assert some_trajectory(1).reversed.samples == 1


def test_one_after_the_other():
    stretches = ((5, 0.0, 1.0), (1, 1.0, 1.0), (4, 1.0, -0.5), (3, -0.5, 0.0))
    parts = [ending_at_rest(*stretch) for stretch in stretches]
    whole = joined(parts)
    assert whole.samples == 5 + 0 + 3 + 2
    assert whole.duration == pytest.approx(sum(part.duration for part in parts))
    assert (np.diff(whole.time) > 0.0).all()
    np.testing.assert_array_equal(whole.position[:5], parts[0].position)
    for field in FIELDS[1:]:
        np.testing.assert_array_equal(getattr(whole, field)[5:8], getattr(parts[2], field)[1:])
        np.testing.assert_array_equal(getattr(whole, field)[8:], getattr(parts[3], field)[1:])
    np.testing.assert_allclose(whole.time[5:8], 1.6 + parts[2].time[1:])
    assert_equal(joined(parts[:1]), parts[0])
    assert joined([ending_at_rest(1, 1.0, 1.0)] * 3).samples == 1


def test_what_does_not_go_on_is_not_joined():
    first = ending_at_rest(5, 0.0, 1.0)
    with pytest.raises(InputError, match="no motion"):
        joined([])
    with pytest.raises(InputError, match="motion 1 moves other joints"):
        joined([first, ending_at_rest(5, 1.0, 2.0, ("b", "a"))])
    for gap in (0.1, -2.0 * 1e-9):
        with pytest.raises(InputError, match="motion 2 does not go on where the one before it ends") as caught:
            joined([first, first.reversed, ending_at_rest(5, gap, 2.0)])
        assert caught.value.data["motion"] == 2
    joined([first, first.reversed, ending_at_rest(5, 0.5 * 1e-9, 2.0)])
    moving = Trajectory(first.joint_names, first.time, first.position + 1.0, first.velocity + 0.1, *np.zeros((2, 5, 2)))
    with pytest.raises(InputError, match="does not go on"):
        joined([first, moving])


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


def test_columns_are_where_the_header_says(tmp_path):
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
def test_reads_what_others_write(tmp_path, text):
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
        ([HEADER, "0,0,0,0,0", "1,0,0,0,0", "1,0,0,0,0"], 4, "no later than"),
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
