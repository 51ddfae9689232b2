"""Several arms on one clock: planned, certified, judged by Pinocchio and coal."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from studies.outside import between_arms

from hplan import load_robot, plan, read_csv
from hplan.apps.cli.main import main
from hplan.base.deadline import TimeIsUpError
from hplan.certificate.clearance_proof import point_at
from hplan.certificate.motion_bound import motion_of_movers
from hplan.collision.coal_scene import CoalScene
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.self_pairs import self_pairs
from hplan.errors import (
    CertificationError,
    ConfigurationInCollisionError,
    InputError,
    NotFoundError,
    OptionError,
    PlanCancelledError,
    SceneError,
)
from hplan.planning.options import PlanOptions
from hplan.robot.several import joined_robots
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.file import load_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Start
from hplan.scene.obstacles import Sphere
from hplan.workcell.cell import Cell, certify_cell, load_cell
from hplan.workcell.planner import _CellPlanner, plan_cell, replan_cell

FROM, TO = (-40.0, 60.0, 60.0, 60.0), (40.0, 60.0, 60.0, 60.0)


def facing(robot, distance: float, start=TO, goal=FROM, **more) -> Cell:
    """Two harvesters facing each other; if close, their straight motions collide."""
    left = CellRobot(name="left", start=Start(joints_deg=FROM), goal=Goal(joints_deg=TO))
    right = CellRobot(
        name="right", position=(distance, 0.0, 0.0), rpy_deg=(0.0, 0.0, 180.0), start=Start(joints_deg=start),
        goal=None if goal is None else Goal(joints_deg=goal),
    )  # fmt: skip
    return Cell.from_robots(CellScene(name="two", robots=(left, right), **more), {"left": robot, "right": robot})


def apart(cell: Cell, q: np.ndarray) -> float:
    """Minimum distance of two bodies of different arms, by Pinocchio and coal."""
    model, geometry = cell.robot.model, between_arms(cell)
    data, seen = model.createData(), geometry.createData()
    found = []
    for each in q:
        pin.computeDistances(model, data, geometry, seen, each)
        found.append(min(result.min_distance for result in seen.distanceResults))
    return min(found)


@pytest.mark.parametrize("moving", ["left", "right", "both"])
def test_two_arms_approach_by_at_most_the_bound(robot, moving):
    """Distances between all points of bodies of either, while one moves or both do."""
    cell, rng = facing(robot, 3.0), np.random.default_rng(3)
    robot, bodies = cell.robot, collision_bodies(cell.robot)
    scene = CoalScene(robot, [])
    still = [joint for arm in cell.arms if moving not in (arm.name, "both") for joint in arm.joints]
    bezier = cell.configuration({}) + np.cumsum(rng.normal(size=(40, 4, robot.dof)) * 0.03, axis=1)
    bezier[20:] = np.linspace(bezier[20:, 0], bezier[20:, -1], 4, axis=1)  # half of the pieces do not bend
    bezier[:, :, still] = bezier[:, :1, still]
    # A cylinder is the same wherever it turns about its own axis: its centre stands for it.
    cores = [body.core.mean(axis=0)[None] if body.kind == "cylinder" else body.core for body in bodies]
    mover_of, moved, _ = motion_of_movers(scene, bezier, np.zeros((1, robot.dof)))
    data, used = [robot.model.createData() for _ in range(2)], 0.0
    for piece in range(len(bezier)):
        for each, end in zip(data, (0.0, 1.0), strict=True):
            pin.forwardKinematics(robot.model, each, point_at(bezier[piece : piece + 1], end))
        points = [
            [
                core @ each.oMi[body.joint + 1].rotation.T + each.oMi[body.joint + 1].translation
                for body, core in zip(bodies, cores, strict=True)
            ]
            for each in data
        ]
        for mover, (i, j) in zip(mover_of[-len(self_pairs(robot).checked) :], self_pairs(robot).checked, strict=True):
            if cell.owner(bodies[i].name) != cell.owner(bodies[j].name):
                before, after = (np.linalg.norm(at[i][:, None] - at[j], axis=2) for at in points)
                change = float(np.abs(after - before).max())
                assert change <= moved[mover, piece] + 1e-9
                used = max(used, change / max(moved[mover, piece], 1e-9))
    assert used > 0.5


def every(motion, step_s: float = 5e-4) -> np.ndarray:
    return motion.positions(np.arange(0.0, motion.duration + step_s, step_s))


def test_joined_robots_are_the_robots(robot):
    picker = load_robot("orchard_harvester")
    place = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 1.0), np.array([0.5, 1.0, 0.2]))
    whole = joined_robots({"b": (robot, place), "a": (picker, pin.SE3.Identity())})
    assert whole.joint_names[: picker.dof] == tuple(f"a_{name}" for name in picker.joint_names)
    for key in ("lower", "upper", "velocity_limit", "acceleration_limit", "torque_limit", "continuous"):
        assert getattr(whole, key).tolist() == [*getattr(picker, key).tolist(), *getattr(robot, key).tolist()]
    rng = np.random.default_rng(0)
    q = rng.uniform(whole.lower, whole.upper, (20, whole.dof))
    v, a = rng.normal(size=(2, 20, whole.dof))
    own = q[:, picker.dof :]
    tools = whole.forward_kinematics(q, "b_tool0")
    assert np.allclose(tools, place.homogeneous @ robot.forward_kinematics(own), atol=1e-12)
    upright = whole.dynamics.torques(q, v, a)[:, : picker.dof]
    assert np.allclose(upright, picker.dynamics.torques(*(x[:, : picker.dof] for x in (q, v, a))), atol=1e-9)
    tilted = pin.Model(robot.model)
    tilted.gravity.linear = place.rotation.T @ robot.model.gravity.linear
    states = zip(own, v[:, picker.dof :], a[:, picker.dof :], strict=True)
    expected = [pin.rnea(tilted, tilted.createData(), *state) for state in states]
    assert np.allclose(whole.dynamics.torques(q, v, a)[:, picker.dof :], expected, atol=1e-9)


def test_distant_arms_move_simultaneously(robot):
    result = plan_cell(facing(robot, 3.0, obstacles=(Sphere(name="post", center=(1.5, 0.0, 0.5), radius=0.2),)))
    assert result.certificate.verified
    assert result.how == "at once"
    assert result.trajectory.duration == max(each.trajectory.duration for each in result.alone.values())
    for name, own in result.trajectories.items():
        alone = result.alone[name].trajectory
        assert np.allclose(own.positions(alone.time), alone.position, atol=1e-9)
        assert np.allclose(own.torque[0], alone.torque[0], atol=1e-6)


@pytest.mark.parametrize("clearance", [0.0, 0.03])
def test_arms_in_each_others_way_go_around_each_other(robot, clearance):
    cell = facing(robot, 1.1, clearance=clearance)
    alone = {arm.name: plan_alone(arm) for arm in cell.arms}
    assert apart(cell, every(cell.join_motions(alone))) < 1e-6
    assert not certify_cell(cell, alone).verified
    result = plan_cell(cell)
    assert result.certificate.verified
    assert result.how == "around each other"
    assert apart(cell, every(result.trajectory)) > clearance
    assert result.trajectory.duration < 1.3 * max(result.report["alone_s"].values())
    assert certify_cell(cell, result.trajectories).verified


def plan_alone(arm):
    return plan(arm.robot, arm.scene).trajectory


@pytest.mark.parametrize("error", [CertificationError("none"), TimeIsUpError()])
def test_one_begins_later_where_that_is_all_there_is(robot, monkeypatch, error):
    def none(*_):
        raise error

    monkeypatch.setattr("hplan.workcell.planner._CellPlanner._plan_together", none)
    result = plan_cell(facing(robot, 1.1, start=FROM, goal=TO))
    assert result.certificate.verified
    assert result.how == "one later"
    assert apart(result.cell, every(result.trajectory)) > 0.0
    assert result.trajectory.duration < sum(result.report["alone_s"].values())


@pytest.mark.parametrize("right", [{"start": FROM, "goal": TO}, {"start": (0.0, 60.0, 60.0, 60.0), "goal": None}])
def test_arms_avoid_resting_arms_and_make_room(robot, monkeypatch, right):
    """Each is at the other's goal; or one blocks the other."""

    def none(*_):
        raise CertificationError("none")

    monkeypatch.setattr("hplan.workcell.planner._CellPlanner._plan_together", none)
    result = plan_cell(facing(robot, 0.8, **right))
    assert result.certificate.verified
    assert apart(result.cell, every(result.trajectory)) > 0.0
    assert result.how == "around each other"
    for arm in result.cell.arms:
        own = result.trajectories[arm.name].position
        assert np.allclose(own[0], arm.robot.joints_of(arm.scene.start, "start"))
        assert np.allclose(own[-1], arm.robot.joints_of(arm.scene.goal, "goal"))


def test_grazing_arms_are_not_verified(robot):
    """The arm that waits is put so near that the other's motion reaches it by 1 to 5 mm, or passes."""
    rng = np.random.default_rng(5)
    moving = plan_alone(facing(robot, 3.0).arm("left"))
    for _ in range(2):
        at = tuple(rng.uniform([-20.0, 30.0, 30.0, 30.0], [20.0, 70.0, 70.0, 70.0]))

        def least(distance: float, at=at) -> tuple[Cell, float]:
            cell = facing(robot, distance, start=at, goal=None)
            return cell, apart(cell, every(cell.join_motions({"left": moving}), 0.01))

        near, far = 0.7, 3.5
        for _ in range(14):
            middle = 0.5 * (near + far)
            near, far = (near, middle) if least(middle)[1] > 1e-6 else (middle, far)
        for deeper, verified in ((rng.uniform(1e-3, 5e-3), False), (-4e-3, True)):
            cell, distance = least(far - deeper)
            assert (distance > 1e-6) == verified
            assert certify_cell(cell, {"left": moving}, check_ends=False).between.verified == verified


def test_stops_are_certified(robot):
    result = plan_cell(facing(robot, 1.1))
    rng = np.random.default_rng(1)
    for t in rng.uniform(0.0, result.trajectory.duration, 8).tolist():
        for arm in (None, "left", "right"):
            stop = result.stop_at(t, arm)
            assert stop.certificate.verified
            assert stop.stopped in ((arm,), ("left", "right"))
            assert apart(result.cell, every(stop.trajectory, 2e-3)) > 0.0
            row = int(np.searchsorted(result.trajectory.time, t - 1e-9))
            assert np.allclose(stop.trajectory.position[:row], result.trajectory.position[:row], atol=1e-9)
    with pytest.raises(InputError, match="no arm 'third'"):
        result.stop_at(0.5, "third")


@pytest.mark.parametrize("goal", [(30.0, 20.0, 80.0, 60.0), None])
def test_one_arm_goes_elsewhere_while_the_other_goes_on(robot, goal):
    result = plan_cell(facing(robot, 1.1))
    rng = np.random.default_rng(2)
    for t in rng.uniform(0.0, result.trajectory.duration, 4).tolist():
        changed = replan_cell(result, t, "left", None if goal is None else Goal(joints_deg=goal))
        assert changed.certificate.verified
        assert changed.stopped == ()
        assert apart(changed.cell, every(changed.trajectory, 2e-3)) > 0.0
        times = result.trajectory.time
        right, before = result.trajectories["right"].position, times < t
        assert np.allclose(changed.trajectories["right"].positions(times), right, atol=1e-9)
        assert np.allclose(changed.trajectory.positions(times)[before], result.trajectory.position[before], atol=1e-9)
        assert np.allclose(changed.trajectories["left"].position[-1], np.radians(TO if goal is None else goal))


def test_all_stop_where_one_cannot_go_elsewhere(robot):
    there = (0.0, 60.0, 60.0, 60.0)
    result = plan_cell(facing(robot, 0.8, start=there, goal=None))
    stop = replan_cell(result, 0.5, "left", Goal(joints_deg=there))
    assert stop.certificate.verified
    assert stop.stopped == ("left",)
    assert stop.trajectory.duration < result.trajectory.duration
    with pytest.raises(InputError):
        replan_cell(result, 0.5, "left", Goal(joints_deg=(0.0, 60.0, 60.0)))
    with pytest.raises(PlanCancelledError):
        replan_cell(result, 0.5, "left", cancel=lambda: True)


def test_all_stop_where_time_is_up(robot, monkeypatch):
    def late(*_):
        raise TimeIsUpError

    result = plan_cell(facing(robot, 1.1))
    monkeypatch.setattr("hplan.workcell.planner.Timetable.set_out", late)
    stop = replan_cell(result, 0.5, "left")
    assert stop.certificate.verified
    assert stop.stopped == ("left", "right")


def test_each_arm_picks_its_fruit(robot):
    scene = load_scene("trellis")
    low, high = scene.fruits[0], scene.fruits[5]
    arms = (
        CellRobot(name="left", start=scene.start, goal=Goal(fruit=low.name)),
        CellRobot(name="right", position=(0.0, -4.0, 0.0), start=scene.start, goal=Goal(fruit=f"{high.name} there")),
    )
    x, y, z = high.center
    there = Fruit(name=f"{high.name} there", center=(x, y - 4.0, z), radius=high.radius)
    everything = CellScene(name="s", robots=arms, obstacles=scene.obstacles, fruits=(*scene.fruits, there))
    result = plan_cell(Cell.from_robots(everything, {"left": robot, "right": robot}))
    assert result.certificate.verified
    for name, fruit in (("left", low), ("right", there)):
        (contact,) = result.certificate.arms[name].contacts
        assert contact.fruit.name == fruit.name
        times = np.linspace(contact.begin_s, contact.end_s, 400)
        tools = result.cell.robot.forward_kinematics(result.trajectory.positions(times), f"{name}_tool0")[:, :3, 3]
        assert np.linalg.norm(tools - fruit.center, axis=1).min() < 2e-3
    for t in np.linspace(0.1, result.trajectory.duration, 6):
        stop = result.stop_at(float(t))
        assert stop.certificate.verified
        for name, own in result.certificate.arms.items():
            for window in stop.certificate.arms[name].contacts:
                assert window.begin_s >= own.contacts[0].begin_s - 1e-9


def test_tilted_base_has_the_gravity_of_the_cell(robot):
    arm = CellRobot(name="hung", position=(0, 0, 2.5), rpy_deg=(180, 0, 0), start=Start(joints_deg=FROM),
                    goal=Goal(joints_deg=TO))  # fmt: skip
    result = plan_cell(Cell.from_robots(CellScene(name="s", robots=(arm,)), {"hung": robot}))
    assert result.certificate.verified
    result.cell.robot.forward_kinematics(result.trajectory.position, result.cell.arm("hung").tool_frame)
    q = result.trajectory.position[:1]
    model = pin.Model(robot.model)
    model.gravity.linear = -model.gravity.linear
    expected = pin.computeGeneralizedGravity(model, model.createData(), q[0])
    assert np.allclose(result.trajectory.torque[0], expected, atol=1e-6)


YAML = """\
format: hplan-scene/1
name: two
robots:
- name: left
  start: {joints_deg: [-40, 60, 60, 60]}
  goal: {joints_deg: [40, 60, 60, 60]}
- name: right
  robot: orchard_harvester
  position: [3, 0, 0]
  rpy_deg: [0, 0, 180]
  start: {joints_deg: [0, 90, 90, 90]}
  goal: {position: [2.0, 0.3, 1.2]}
  drop_off: {position: [2.0, 0.3, 1.2]}
obstacles:
- {name: post, kind: sphere, center: [0.0, -1.5, 1.2], radius: 0.1}
"""


def test_files(write):
    cell = load_cell(write("cell.yaml", YAML))
    assert cell.arm("right").robot.name == load_robot("orchard_harvester").name
    assert np.allclose(cell.arm("right").scene.goal.position, (1.0, -0.3, 1.2))
    assert cell.arm("right").drop_off.position == cell.arm("right").scene.goal.position
    assert (cell.arm("left").drop_off, cell.arm("right").every) == (None, 1)
    assert plan_cell(cell).certificate.verified
    with pytest.raises(SceneError, match="several robots: read it with load_cell"):
        load_scene(write("same.yaml", YAML))
    with pytest.raises(SceneError, match=r"robots: .*missing"):
        load_cell(write("one.yaml", "format: hplan-scene/1\nname: s\n"))
    with pytest.raises(SceneError, match=r"line 7, robots\[1\].name"):
        load_cell(write("names.yaml", YAML.replace("name: right", "name: left")))
    with pytest.raises(SceneError, match=r"robots\[1\].drop_off.fruit: a drop-off is given by joints"):
        load_cell(write("drop.yaml", YAML.replace("drop_off: {position: [2.0, 0.3, 1.2]}", "drop_off: {fruit: a}")))
    with pytest.raises(SceneError, match=r"robots\[0\].goal"):
        load_cell(write("goal.yaml", YAML.replace("goal: {joints_deg: [40, 60, 60, 60]}", "goal: {fruit: none}")))


def test_wrong_values(robot):
    cell = facing(robot, 3.0)
    with pytest.raises(InputError, match="there is no robot for arm 'right'"):
        Cell.from_robots(cell.scene, {"left": robot})
    with pytest.raises(OptionError, match="cell"):
        plan_cell(cell.scene)
    with pytest.raises(OptionError, match="bound"):
        plan_cell(cell, PlanOptions(bound=True))
    with pytest.raises(InputError, match="has a goal"):
        plan_cell(Cell.from_robots(facing(robot, 3.0, goal=None).scene.model_copy(
            update={"robots": tuple(r.model_copy(update={"goal": None}) for r in cell.scene.robots)}
        ), {"left": robot, "right": robot}))  # fmt: skip
    with pytest.raises(InputError, match="moves"):
        cell.join_motions({"left": cell.join_motions({})})
    with pytest.raises(ConfigurationInCollisionError, match=r"of arm 'right' .*of arm 'left'"):
        plan_cell(facing(robot, 0.7, start=(40.0, 60.0, 60.0, 60.0), goal=(-40.0, 60.0, 60.0, 60.0)))
    with pytest.raises(NotFoundError):
        plan_cell(cell, PlanOptions(deadline_s=1e-4))


def test_arm_without_jerk_limits_leaves_the_others_theirs(robot):
    without = replace(robot, jerk_limit=None)
    whole = joined_robots({"a": (robot, pin.SE3.Identity()), "b": (without, pin.SE3.Identity())})
    assert whole.jerk_limit[: robot.dof].tolist() == robot.jerk_limit.tolist()
    assert whole.jerk_limit[robot.dof :].min() > 1e3 * robot.acceleration_limit.max()
    assert joined_robots({"b": (without, pin.SE3.Identity())}).jerk_limit is None


def test_idle_arms_stay(robot):
    result = plan_cell(facing(robot, 3.0, goal=None))
    assert np.ptp(result.trajectories["right"].position, axis=0).max() == 0.0
    assert not math.isinf(result.certificate.between.min_clearance_m)


def test_command_writes_each_arms_file(write, tmp_path, capsys):
    scene, out = write("cell.yaml", YAML), tmp_path / "out"
    assert main(["plan", str(scene), "--out", str(out), "--quiet", "--mcap"]) == 0
    assert (out / "motion.mcap").read_bytes()[1:5] == b"MCAP"
    cell = load_cell(scene)
    motions = {arm.name: read_csv(out / f"trajectory-{arm.name}.csv") for arm in cell.arms}
    assert certify_cell(cell, motions).verified
    assert certify_cell(cell, read_csv(out / "trajectory.csv")).verified
    report = json.loads((out / "report.json").read_text())
    assert report["makespan_s"] == pytest.approx(max(motion.duration for motion in motions.values()))
    least = min(mm for mm in (report["between_arms_mm"], *report["arms_mm"].values()) if mm is not None)
    assert f"keeps at least {np.floor(100.0 * least) / 100.0:.2f} mm at all times" in (out / "scene.html").read_text()
    assert main(["certify", str(out), str(scene)]) == main(["certify", str(out / "trajectory.csv"), str(scene)]) == 0
    assert capsys.readouterr().out.count("verified") == 2
    near = write("near.yaml", YAML.replace("[3, 0, 0]", "[1.4, 0, 0]"))
    assert main(["certify", str(out), str(near), "--any-ends", "--json"]) == 5
    assert "between arms" in json.loads(capsys.readouterr().out)["violations"][0]
    assert main(["plan", str(scene), "--out", str(out), "--bound"]) == 2
    assert "several robots" in capsys.readouterr().err
    assert (out / "trajectory.csv").exists()


def test_fruits_are_picked_around_each_other(robot, monkeypatch):
    """Without independent motions: transits are planned together, then the approaches."""
    scheduled = _CellPlanner._schedule
    monkeypatch.setattr(_CellPlanner, "_schedule", lambda *given: scheduled(*given) if len(given) > 3 else None)
    monkeypatch.setattr(_CellPlanner, "_in_turn", lambda *_: None)
    fruits = tuple(Fruit(name=n, center=(1.2, y, 1.6), radius=0.04) for n, y in (("a", 0.3), ("b", -2.3)))
    arms = tuple(
        CellRobot(name=n, position=(0.0, y, 0.0), start=Start(joints_deg=(0.0, 60.0, 60.0, 60.0)), goal=Goal(fruit=f))
        for n, y, f in (("left", 0.0, "a"), ("right", -2.0, "b"))
    )
    result = plan_cell(
        Cell.from_robots(CellScene(name="s", robots=arms, fruits=fruits), dict.fromkeys(("left", "right"), robot))
    )
    assert result.how == "around each other"
    assert result.certificate.verified
    assert apart(result.cell, every(result.trajectory, 4e-3)) > 0.0
    for name, fruit in zip(("left", "right"), fruits, strict=True):
        tools = result.cell.robot.forward_kinematics(every(result.trajectory, 4e-3), f"{name}_tool0")[:, :3, 3]
        assert np.linalg.norm(tools - fruit.center, axis=1).min() < 2e-3
