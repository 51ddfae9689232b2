"""Files of workcells: each on its own samples, all on one exact clock."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from hplan import certify, load_robot, plan, read_csv, write_csv
from hplan.apps.cli.main import main
from hplan.errors import HplanError, InputError, OptionError, SceneError
from hplan.planning.options import PlanOptions
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.model import Goal, Start
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track
from hplan.tour.cell_tour import plan_cell_tour
from hplan.trajectory.cubics import evaluate
from hplan.trajectory.trajectory import Trajectory
from hplan.workcell import cell as cells
from hplan.workcell.cell import Cell, certify_between, certify_cell, load_cell
from hplan.workcell.planner import plan_cell

FROM, TO = (0.0, 60.0, 20.0, 20.0), (30.0, 60.0, 20.0, 20.0)
QUICK = PlanOptions(effort="quick")


@pytest.fixture(scope="module")
def picker():
    return load_robot("orchard_harvester")


def beside(picker, aside: float = -4.0, names=("left", "right"), goal=None, lean=0.0, **more) -> Cell:
    """Two arms next to each other; the first has a goal."""
    first, second = names
    arms = (
        CellRobot(name=first, start=Start(joints_deg=FROM), goal=Goal(joints_deg=TO)),
        CellRobot(
            name=second, position=(0.0, aside, 0.0), rpy_deg=(lean, 0.0, 0.0), start=Start(joints_deg=FROM),
            goal=None if goal is None else Goal(joints_deg=goal),
        ),
    )  # fmt: skip
    return Cell.from_robots(CellScene(name="two", robots=arms, **more), dict.fromkeys(names, picker))


def foreign(picker, duration: float = 6.0, step: float = 1.0, start=FROM, goal=TO) -> Trajectory:
    """A motion of another program: a coarsely sampled quintic."""
    q0, q1 = np.radians(start), np.radians(goal)
    t = np.append(np.arange(0.0, duration - 1e-9, step), duration)
    s = t / duration
    f, fd = 10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
    fdd = (60 * s - 180 * s**2 + 120 * s**3) / duration**2
    q, v, a = q0 + np.outer(f, q1 - q0), np.outer(fd, q1 - q0), np.outer(fdd, q1 - q0)
    return Trajectory(picker.joint_names, t, q, v, a, picker.dynamics.torques(q, v, a), picker.slides)


def moving_at_its_end(motion: Trajectory, speed: float) -> Trajectory:
    velocity = motion.velocity.copy()
    velocity[-1, 0] = speed
    return replace(motion, velocity=velocity)


def rests(motion: Trajectory) -> Trajectory:
    return moving_at_its_end(motion, 0.0)


def test_file_that_ends_in_motion_and_swings_into_an_obstacle_is_not_verified(picker):
    cell, motion = beside(picker), foreign(picker)
    beyond = np.radians(np.add(TO, (10.0, 0.0, 0.0, 0.0)))
    ball = Sphere(name="ball", center=tuple(picker.tool_positions(beyond).tolist()), radius=0.03)
    cell = beside(picker, clearance=0.005, obstacles=(ball,))
    found = certify_cell(cell, {"left": moving_at_its_end(motion, -1.0)})
    assert not found.verified
    assert any("ends with joint 'base_yaw' at 1 rad/s, not at rest" in each for each in found.violations)
    assert any("'ball'" in each for each in found.arms["left"].violations)
    assert certify_cell(cell, {"left": rests(motion)}).verified


@pytest.mark.parametrize("column", ["acceleration", "torque"])
def test_columns_of_files_are_judged(picker, column):
    cell = beside(picker)
    motion = plan(picker, cell.arm("left").scene, QUICK).trajectory
    assert certify_cell(cell, {"left": motion}).verified
    found = certify_cell(cell, {"left": replace(motion, **{column: 1e3 * getattr(motion, column)})})
    assert not found.arms["left"].verified
    assert any(message.startswith(f"left: {column} reaches") for message in found.violations)
    whole = cell.join_motions({"left": motion})
    assert certify_cell(cell, whole).verified
    assert not certify_cell(cell, replace(whole, **{column: 1e3 * getattr(whole, column)})).verified


def test_each_arm_has_the_certificate_that_it_has_alone(picker):
    """Files with samples at their own times, of other durations, good ones and bad ones."""
    cell = beside(picker, goal=TO)
    files = {"left": foreign(picker, 6.0, 1.0), "right": foreign(picker, math.e, 1.0 / math.pi)}
    wild = files["right"].velocity.copy()
    wild[3] = 1e300
    for right in (files["right"], moving_at_its_end(files["right"], 0.3), replace(files["right"], velocity=wild)):
        found = certify_cell(cell, files | {"right": right})
        for name, own in (files | {"right": right}).items():
            alone = certify(cell.arm(name).robot, cell.arm(name).scene, own)
            assert found.arms[name].violations == alone.violations
            assert found.arms[name].min_clearance_m == alone.min_clearance_m
            assert found.arms[name].digests == alone.digests
        assert found.verified == (right is files["right"])
        assert found.between.verified == (right is files["right"])


def test_one_clock_holds_both_files_exactly(picker):
    """Samples at irrational times, some of them 1e-9 s or one rounding apart."""
    cell, rng = beside(picker), np.random.default_rng(4)
    files = {}
    for name, step in (("left", 1.0 / math.pi), ("right", math.sqrt(2.0) / 10.0)):
        times = np.unique(np.concatenate([[0.0, 0.1 + 0.2, 0.7 + 1e-9 * (name == "left")], np.arange(0.0, 3.0, step)]))
        times = np.unique(np.append(times, np.nextafter(0.3, 1.0 if name == "left" else 0.0)))
        q, v = rng.normal(size=(2, len(times), picker.dof))
        v[-1] = 0.0
        files[name] = Trajectory(picker.joint_names, times, q, v, v, v, picker.slides)
    clock = np.unique(np.concatenate([own.time for own in files.values()]))
    between = certify_between(cell, files, QUICK)
    merged = between.subject.motions[0][0].trajectory
    assert merged.time.tolist() == clock.tolist()
    fine = np.linspace(0.0, clock[-1], 20_001)
    for arm in cell.arms:
        own = files[arm.name]
        expected = evaluate(own.segments[0], own.time, fine)
        assert np.abs(merged.positions(fine)[:, arm.joints] - expected).max() < 1e-12
    uses = [certify(arm.robot, arm.scene, files[arm.name]).limit_use for arm in cell.arms]
    for key, value in vars(between.limit_use).items():
        assert value == max(getattr(use, key) for use in uses)


def test_samples_at_nearly_the_same_time_ask_for_no_more_room(picker):
    """With a tracking delay room grows with speed, which differences over so short a time do not give."""
    cell = beside(picker, goal=TO)
    left, right = foreign(picker, 6.0, 0.1), foreign(picker, 6.0, 0.1)
    times = right.time.copy()
    times[1:-1] = np.nextafter(times[1:-1], 9.0)
    options = PlanOptions(tracking_delay_s=0.05)
    same = certify_cell(cell, {"left": left, "right": right}, options)
    apart = certify_cell(cell, {"left": left, "right": replace(right, time=times)}, options)
    assert same.verified
    assert apart.verified
    assert apart.between.min_clearance_m == pytest.approx(same.between.min_clearance_m, abs=1e-9)


@pytest.mark.parametrize("speed", [1e-7, 0.2])
def test_who_ends_in_motion_before_another_is_compared_up_to_there(picker, speed):
    cell = beside(picker, goal=TO)
    short, long = moving_at_its_end(foreign(picker, 2.0, 0.5), speed), foreign(picker, 6.0)
    found = certify_cell(cell, {"left": short, "right": long})
    merged = found.between.subject.motions[0][0].trajectory
    if speed < 1e-6:  # counts as rest: it stays where its file ends
        assert found.verified
        after = merged.positions(np.linspace(2.0 + 1e-11, 6.0, 500))[:, cell.arm("left").joints]
        assert np.ptp(after, axis=0).max() < 1e-15
        return
    assert merged.duration == 2.0
    message = "the motion of arm 'left' ends at 2 s with joint 'base_yaw' at a speed of 0.2; its position after that is"
    assert any(message in each for each in found.between.violations)
    with pytest.raises(InputError, match="ends at 2 s with joint 'base_yaw'"):
        cell.join_motions({"left": short, "right": long})


def test_numbers_that_overflow_are_not_verified(picker):
    cell = beside(picker, goal=TO)
    files = {"left": foreign(picker), "right": foreign(picker, 5.0, 0.3)}
    for column, value in (("position", 1e300), ("velocity", -1e300), ("position", 1e7)):
        values = getattr(files["right"], column).copy()
        values[2, 1] = value
        found = certify_cell(cell, files | {"right": replace(files["right"], **{column: values})})
        assert not found.arms["right"].verified
        assert any("are not followed there" in each for each in found.between.violations)


def test_files_of_other_joints_are_refused(picker):
    cell, motion = beside(picker), foreign(picker)
    order = [1, 0, 2, 3]
    permuted = replace(motion, joint_names=tuple(motion.joint_names[k] for k in order))
    with pytest.raises(InputError, match="the motion of arm 'left' moves shoulder"):
        certify_cell(cell, {"left": permuted})
    with pytest.raises(InputError, match="no arm 'middle'"):
        certify_cell(cell, {"middle": motion})
    with pytest.raises(InputError, match="no arm 'middle'"):
        certify_cell(cell, {"left": motion}, contacts={"middle": ()})
    with pytest.raises(InputError, match="no arm 'middle'"):
        certify_cell(cell, {"left": motion}, goal_contact={"middle": "motion"})
    for wrong in ({}, {"left": "left.csv"}, [motion]):
        with pytest.raises(OptionError):
            certify_cell(cell, wrong)


def test_obstacle_that_comes_to_an_arm_that_has_arrived_is_seen(picker):
    """The other arm still moves: all of that time belongs to the motion."""
    far = np.add(picker.tool_positions(np.radians(TO)), (0.0, 0.0, 3.0)).tolist()
    track = Track(times_s=(0.0, 4.0, 5.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -3.0)))
    ball = Sphere(name="ball", center=tuple(far), radius=0.05, track=track)
    # Tracks are in the workcell's frame: the other arm's base leans a little, and is checked there, too.
    cell = beside(picker, goal=TO, obstacles=(ball,), lean=0.1)
    short = foreign(picker, 3.0, 0.5)
    names = cell.arm("right").robot.joint_names
    right = replace(short, joint_names=names)
    assert certify_cell(cell, {"left": short, "right": right}).verified
    found = certify_cell(cell, {"left": short, "right": replace(foreign(picker, 6.0), joint_names=names)})
    assert not found.verified
    assert any("at rest from 3 s on, it is clear until 4." in message for message in found.violations)


YAML = """\
format: hplan-scene/1
name: two
robots:
- name: left
  robot: orchard_harvester
  start: {joints_deg: [0, 60, 20, 20]}
  goal: {joints_deg: [30, 60, 20, 20]}
- name: right
  robot: orchard_harvester
  position: [0, -4, 0]
  start: {joints_deg: [0, 60, 20, 20]}
"""


def test_command_judges_files_as_given(picker, write, tmp_path, capsys):
    scene, folder = str(write("cell.yaml", YAML)), tmp_path / "files"
    folder.mkdir()
    good = foreign(picker)
    stands = good.cut_after(0)

    def status(left: Trajectory) -> tuple[int, list[str]]:
        write_csv(left, folder / "trajectory-left.csv")
        code = main(["certify", str(folder), scene, "--json"])
        return code, json.loads(capsys.readouterr().out)["violations"]

    write_csv(good, folder / "trajectory-left.csv")
    assert main(["certify", str(folder), scene]) == 2
    assert "trajectory-right.csv" in capsys.readouterr().err
    write_csv(stands, folder / "trajectory-right.csv")
    assert status(good) == (0, [])
    code, violations = status(moving_at_its_end(good, -1.0))
    assert code == 5
    assert any("left: the motion ends with joint 'base_yaw' at 1 rad/s" in message for message in violations)
    assert status(replace(good, torque=1e4 + good.torque))[0] == 5
    assert status(replace(good, acceleration=1e3 + good.acceleration))[0] == 5
    file = folder / "trajectory-left.csv"
    lines = write_csv(good, file).read_text().splitlines()
    tampered = {
        "nan": (2, lines[2].replace(lines[2].split(",")[1], "nan")),
        "not later than": (3, lines[2]),
        "expected the columns": (0, lines[0].replace("time_s", "time")),
        "expected 0 in the first sample": (1, "0.5" + lines[1][lines[1].index(",") :]),
        "the robot has|the arm has": (0, lines[0].replace("base_yaw", "other")),
    }
    for words, (number, line) in tampered.items():
        file.write_text("\n".join([*lines[:number], line, *lines[number + 1 :]]) + "\n")
        assert main(["certify", str(folder), scene]) == 2, words
        error = " ".join(capsys.readouterr().err.split())
        assert any(each in error for each in words.split("|")), error


@pytest.mark.parametrize("option", [["--tracking-error-m", "0.01"], ["--risk", "0.1"], ["--begin", "1"]])
def test_command_refuses_options_without_meaning(write, tmp_path, capsys, option):
    assert main(["certify", str(tmp_path), str(write("cell.yaml", YAML)), *option]) == 2
    assert option[0] in capsys.readouterr().err


def test_options_without_meaning_are_refused(picker):
    cell = beside(picker)
    for function in (plan_cell, plan_cell_tour):
        for options in ({"bound": True}, {"certify": False}, {"risk": 0.1}):
            with pytest.raises(OptionError, match=next(iter(options))):
                function(cell, PlanOptions(**options))
    with pytest.raises(SceneError, match="drop_off"):
        CellRobot(name="a", start=Start(joints_deg=FROM), every=2)


@pytest.mark.parametrize("names", [("a", "a_link"), ("a_link", "a"), ("base", "base_link"), ("turret", "a")])
def test_owners_go_by_exact_names(picker, names):
    cell = beside(picker, names=names, obstacles=(Sphere(name="a_post", center=(0.0, -2.0, 0.5), radius=0.1),))
    own = [frame.name for frame in picker.model.frames if frame.type == pin.FrameType.BODY]
    for name in names:
        assert all(cell.owner(f"{name}_{link}") == name for link in own)
    assert cell.owner("a_post") is cell.owner("base_link") is cell.owner(f"{names[0]}_") is None
    assert cell.arm_behind("a_post") is cell.arm_behind(f"{names[0]}_hand") is None
    solids = list(cells.iterate_standing(cell, names[0], 0.0))
    assert {cell.arm_behind(solid.name) for solid in solids} == {names[1]}
    assert plan_cell(cell, QUICK).certificate.verified


def test_arm_whose_joints_begin_with_its_name(picker, write):
    """A robot with an arm's name in its own: the prefix is doubled."""

    def named(text: str) -> str:
        return text.replace("base_yaw", "left_yaw").replace("tool0", "left_tool")

    write("arm.limits.yaml", named(picker.urdf_path.with_suffix(".limits.yaml").read_text(encoding="utf-8")))
    urdf = write("arm.urdf", named(picker.urdf_path.read_text(encoding="utf-8")))
    cell = beside(load_robot(urdf, tool_frame="left_tool"))
    assert cell.robot.joint_names[cell.arm("left").joints[0]] == "left_left_yaw"
    assert cell.arm("left").tool_frame == "left_left_tool"
    assert plan_cell(cell, QUICK).certificate.verified


def on_a_plate() -> str:
    """A column with an arm on a plate of 1 m."""

    def link(name: str, size: str, place: str) -> str:
        box = f'<collision><origin xyz="{place}"/><geometry><box size="{size}"/></geometry></collision>'
        inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
        return f'<link name="{name}"><inertial><mass value="1"/>{inertia}</inertial>{box}</link>'

    def joint(name: str, ends: tuple[str, str], place: str, axis: str) -> str:
        limit = '<limit lower="-3" upper="3" velocity="1" effort="500" acceleration="5"/>'
        parts = f'<parent link="{ends[0]}"/><child link="{ends[1]}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
        return f'<joint name="{name}" type="revolute">{parts}{limit}</joint>'

    return f"""<robot name="m" version="1.2">
{link("base_link", "1 1 0.02", "0 0 -0.03")}{link("column", "0.09 0.09 0.2", "0 0 0.1")}
{link("arm", "0.3 0.04 0.04", "0.15 0 0")}<link name="tool0"/>
{joint("turn", ("base_link", "column"), "0 0 0", "0 0 1")}{joint("lift", ("column", "arm"), "0 0 0.3", "0 1 0")}
<joint name="t" type="fixed"><parent link="arm"/><child link="tool0"/><origin xyz="0.3 0 0"/></joint></robot>"""


PLATES = """\
format: hplan-scene/1
name: plates
robots:
- {name: a, robot: m.urdf, start: {joints_deg: [0, -30]}, goal: {joints_deg: [90, -30]}}
- {name: b, robot: m.urdf, position: [0.99, 0, 0], start: {joints_deg: [0, -30]}, goal: {joints_deg: [-90, -30]}}
clearance: 0.02
may_touch:
- [[a, base_link], [b, base_link]]
"""


def test_links_that_touch_by_design_are_declared_and_reported(write, tmp_path, capsys):
    write("m.urdf", on_a_plate())
    scene, out = str(write("plates.yaml", PLATES)), tmp_path / "out"
    assert main(["plan", scene, "--out", str(out), "--effort", "quick"]) == 0
    assert "may touch" in capsys.readouterr().out
    declared = [[["a", "base_link"], ["b", "base_link"]]]
    assert json.loads((out / "report.json").read_text())["may_touch"] == declared
    assert main(["certify", str(out), scene]) == 0
    assert "may touch" in capsys.readouterr().out
    assert main(["certify", str(out), scene, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["may_touch"] == declared
    cell = load_cell(scene)
    assert {solid.name.rpartition(" ")[0] for solid in cells.iterate_standing(cell, "a", 0.0)} == {"b_column", "b_arm"}
    without = load_cell(write("without.yaml", PLATES.partition("may_touch")[0]))
    files = {name: read_csv(out / f"trajectory-{name}.csv") for name in ("a", "b")}
    assert not certify_cell(without, files).verified
    with pytest.raises(HplanError, match="base_link"):
        plan_cell(without, QUICK)


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ("[[a, base_link], [c, base_link]]", "'c' is not among the robots"),
        ("[[a, base_link], [a, arm]]", "both links belong to 'a'"),
        ("[[a, base_link], [b, plate]]", "'plate' is not a link of arm 'b'"),
        ("[[a, base_link]]", "may_touch"),
    ],
)
def test_declarations_of_unknown_links_are_refused(write, pair, message):
    write("m.urdf", on_a_plate())
    with pytest.raises((SceneError, InputError), match=message):
        load_cell(write("plates.yaml", PLATES.replace("[[a, base_link], [b, base_link]]", pair)))
