"""Running motions to a changed fruit: contact is allowed with the original alone."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
from arm_variants import coal_distances
from planned import fruit, post, task
from script_loader import load_script

from hplan.certificate.certificate import Certificate, certify
from hplan.errors import HplanError, InputError
from hplan.online.planner import Planner
from hplan.online.splice import SplicedResult
from hplan.planar.family_reader import family_of
from hplan.planning.plan import plan
from hplan.planning.report import write_report
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.file import load_scene, save_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal
from hplan.scene.obstacles import Box, Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import Trajectory, write_csv

APPLE = fruit("apple", 20.0, 1.5, 1.4)
SCENE = task((-20.0, 45.0, 45.0, 30.0), Goal(fruit="apple"), [post("post", 0.0, 1.2, 0.0, 0.9)], fruits=(APPLE,))


@functools.cache
def picking(robot: Robot) -> PlanResult:
    return plan(robot, SCENE)


def a_planner(robot: Robot) -> Planner:
    """A planner whose motion to the apple runs."""
    planner = Planner(robot, SCENE)
    planner.last = picking(robot)
    return planner


def in_the_hand(robot: Robot, trajectory: Trajectory, time_s: float) -> tuple[float, float, float]:
    """Middle of the last link at a time."""
    q = trajectory.positions(np.array([time_s]))[0]
    points, (origin, axes) = (
        family_of(robot).arm.joint_points(q[family_of(robot).arm_slice]),
        family_of(robot).plane_at(family_of(robot).yaw_of(q)),
    )
    x, y, z = (origin + 0.5 * (points[-1] + points[-2]) @ axes[:2]).tolist()
    return x, y, z


def without_apple(planner: Planner) -> None:
    running = planner.last.trajectory
    planner.aim(goal=Goal(joints_rad=tuple(running.position[-1].tolist())))
    planner.remove("apple")


def test_fruit_seen_elsewhere_is_an_obstacle(robot: Robot) -> None:
    planner = a_planner(robot)
    at_s = picking(robot).certificate.contact_s[0]
    moved = APPLE.model_copy(update={"center": in_the_hand(robot, picking(robot).trajectory, at_s + 0.05)})
    planner.scene = planner.scene.model_copy(update={"fruits": (moved,)})
    stop = planner.stop_at(at_s + 0.02, now=at_s)
    assert not stop.certificate.verified
    assert not certify(robot, planner.scene, stop.trajectory, check_ends=False).verified
    with pytest.raises(HplanError):
        planner.replan(at=at_s + 0.02, now=at_s)


def test_obstacle_of_the_fruits_name_is_an_obstacle(robot: Robot) -> None:
    planner = a_planner(robot)
    at_s = picking(robot).certificate.contact_s[0]
    without_apple(planner)
    planner.add(Sphere(name="apple", center=in_the_hand(robot, picking(robot).trajectory, at_s + 0.05), radius=0.1))
    assert not planner.stop_at(at_s + 0.02, now=at_s).certificate.verified


def test_obstacle_in_base_is_reported_for_stops(robot: Robot) -> None:
    scene = load_scene("table-1")
    planner = Planner(robot, scene)
    planner.plan()
    planner.add(Box(name="inside", center=(0.0, 0.0, 0.3), size=(0.05, 0.05, 0.1)))
    stop = planner.stop_at(0.5, now=0.3)
    again = certify(robot, planner.scene, stop.trajectory, check_ends=False)
    assert not stop.certificate.verified
    assert stop.certificate.violations == again.violations
    assert "'inside'" in stop.certificate.violations[0]


@pytest.mark.parametrize("seed", range(16))
def test_random_stops_among_changed_fruit_are_clear(robot: Robot, seed: int) -> None:
    """Certified stops touch only the goal's fruit, by coal every 0.5 ms."""
    random = np.random.default_rng(seed)
    planner, running = a_planner(robot), picking(robot)
    motion, contact_s = running.trajectory, running.certificate.contact_s
    at_s = random.uniform(contact_s[0] - 0.1, motion.duration)
    kind = seed % 4
    ball: Fruit | Sphere = APPLE
    if kind == 1:  # near its previous position
        ball = APPLE.model_copy(update={"center": tuple(np.add(APPLE.center, random.normal(0.0, 0.03, 3)).tolist())})
    elif kind == 2:  # anywhere about the last link
        near = np.array(in_the_hand(robot, motion, random.uniform(at_s, motion.duration)))
        ball = APPLE.model_copy(update={"center": tuple((near + random.normal(0.0, 0.15, 3)).tolist())})
    elif kind == 3:
        without_apple(planner)
        ball = Sphere(name="apple", center=tuple((APPLE.center + random.normal(0.0, 0.1, 3)).tolist()), radius=0.05)
        planner.add(ball)
    if kind in (1, 2):
        planner.scene = planner.scene.model_copy(update={"fruits": (ball,)})
    stop = planner.stop_at(min(at_s + 0.02, motion.duration), now=at_s)
    if kind == 0:
        assert stop.certificate.verified, stop.certificate.violations
        return
    among = SCENE.with_obstacles([Sphere(name="ball", center=ball.center, radius=ball.radius)])
    row = int(np.searchsorted(stop.trajectory.time, at_s + 1e-9)) - 1
    left = stop.trajectory.cut_before(row)
    # The tool does not protrude from the last link's capsule: the links suffice.
    clock = np.append(np.arange(0.0, left.duration, 5e-4), left.duration)
    least = min(float(coal_distances(robot, q, among.obstacles).min()) for q in left.positions(clock))
    assert stop.certificate.verified == (least > 0.0) or abs(least) < 1e-3


def test_splice_reports_contact_window_of_new_motion(robot: Robot) -> None:
    planner = a_planner(robot)
    kept = planner.replan(at=0.3, now=0.2)
    assert kept.is_kept
    near = APPLE.model_copy(update={"center": fruit("apple", 20.0, 1.5, 1.42).center})
    planner.scene = planner.scene.model_copy(update={"fruits": (near,)})
    new = planner.replan(at=0.4, now=0.3)
    assert not new.is_kept
    for result in (kept, new):
        again = certify(robot, result.scene, result.trajectory)
        assert again.verified
        assert again.contact_s == pytest.approx(result.certificate.contact_s, abs=1e-9)


PEAR = fruit("pear", -20.0, 1.5, 1.4)
AWAY = Track(times_s=(4.0, 9.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 0.5, 0.0)))
PASSING = Sphere(name="passing", center=(-1.5, 0.0, 1.0), radius=0.1, track=AWAY)


def leaving_the_apple(robot: Robot, goal: Goal, *obstacles: Sphere) -> tuple[Planner, SplicedResult]:
    """A planner that leaves the apple, redirected before the tool is in it."""
    planner = Planner(robot, SCENE.model_copy(update={"fruits": (APPLE, PEAR)}).with_obstacles(obstacles))
    begin_s, end_s = planner.plan(begins_s=5.0).certificate.contact_s
    planner.aim(goal=goal)
    new = planner.replan(at=5.0 + end_s - 0.01, now=5.0 + begin_s - 0.05)
    assert not new.is_kept
    return planner, new


def agrees(
    robot: Robot, planner: Planner, trajectory: Trajectory, certificate: Certificate, row_s: float = 0.0
) -> None:
    """The certificate agrees with `certify` for the same contacts, and fails without them.

    A window carried over from a faster motion begins at one of its samples, with a larger allowance for curvature
    between them. `certify` finds the goal's window from the samples of the motion itself, and may find an earlier
    start, by less than two of the faster motion's samples, measured here.
    """
    assert certificate.verified, certificate.violations
    scene = planner.scene.starting_at(planner.last.begins_s)
    given = {"check_ends": False, "rest_to_rest": False}
    again = certify(robot, scene, trajectory, contacts=certificate.contacts, **given)
    assert again.verified, again.violations
    assert [at.fruit for at in again.contacts] == [at.fruit for at in certificate.contacts]
    found, held = (np.array([at.span_s for at in each.contacts]).reshape(-1, 2) for each in (again, certificate))
    if row_s > 0.0:
        assert -1e-9 <= held[-1, 0] - found[-1, 0] < 2.0 * row_s - 1e-9
        found[-1, 0] = held[-1, 0]
    np.testing.assert_allclose(found, held, atol=1e-9)
    others = scene.model_copy(update={"goal": Goal(joints_rad=tuple(trajectory.position[-1].tolist()))})
    assert not certify(robot, others, trajectory, **given).verified


@pytest.mark.parametrize(
    "goal", [Goal(joints_deg=(-20.0, 45.0, 45.0, 30.0)), Goal(fruit="pear")], ids=["joints", "pear"]
)
@pytest.mark.parametrize("obstacles", [(), (PASSING,)], ids=["still", "moving"])
def test_splice_holds_the_contact_that_it_leaves(robot: Robot, goal: Goal, obstacles: tuple[Sphere, ...]) -> None:
    planner, new = leaving_the_apple(robot, goal, *obstacles)
    picked = ["apple"] if goal.fruit is None else ["apple", "pear"]
    assert [contact.fruit.name for contact in new.certificate.contacts] == picked
    assert new.certificate.contacts[0].begin_s == pytest.approx(0.05, abs=5e-3)
    assert new.certificate.contacts[0].end_s <= new.seam_s + 1e-9
    agrees(robot, planner, new.trajectory, new.certificate)
    told = new.report["certificate"]["contacts"]
    assert [at["fruit"] for at in told] == picked
    later = planner.stop_at(new.begins_s + 0.4, now=new.begins_s)
    scaled, row_s = new.scale_speed(0.5), 0.0 if goal.fruit is None else 2.0 * float(np.diff(new.trajectory.time).max())
    assert [contact.fruit.name for contact in scaled.certificate.contacts] == picked
    for slow, most_s in ((new.stop_at(0.3), 0.0), (scaled, row_s), (later, 0.0)):
        assert slow.certificate.contacts[0].fruit == APPLE
        agrees(robot, planner, slow.trajectory, slow.certificate, most_s)
    # And on while the tool is in the apple.
    in_s = new.begins_s + new.certificate.contacts[0].begin_s + 0.1
    kept = planner.replan(at=in_s + 0.02, now=in_s)
    assert kept.is_kept
    agrees(robot, planner, kept.trajectory, kept.certificate)
    planner.aim(goal=Goal(joints_deg=(-30.0, 45.0, 45.0, 30.0)))
    again = planner.replan(at=new.begins_s + new.seam_s, now=in_s)
    assert [contact.fruit.name for contact in again.certificate.contacts] == ["apple"]
    agrees(robot, planner, again.trajectory, again.certificate)
    # Out of it nothing is left of that.
    out = planner.replan(at=new.begins_s + new.seam_s + 0.1, now=new.begins_s + new.seam_s + 0.05)
    assert out.certificate.contacts == ()


def test_contact_that_is_given_is_with_the_very_fruit(robot: Robot) -> None:
    _, new = leaving_the_apple(robot, Goal(joints_deg=(-20.0, 45.0, 45.0, 30.0)))
    moved = APPLE.model_copy(update={"center": tuple(np.add(APPLE.center, (0.0, 0.0, 0.002)).tolist())})
    elsewhere = new.scene.model_copy(update={"fruits": (moved, PEAR)})
    shown = certify(robot, elsewhere, new.trajectory, contacts=new.certificate.contacts)
    assert not shown.verified
    assert shown.contacts == ()
    with pytest.raises(InputError, match="contacts"):
        certify(robot, new.scene, new.trajectory, contacts=[new.certificate.contact_s])


@pytest.mark.parametrize(
    ("told", "status"), [(None, 0), ([], 5), ([{"fruit": "plum", "begin_s": 0, "end_s": 1}], 2), (7, 2)]
)
def test_folder_of_a_splice_is_certified(robot: Robot, tmp_path: Path, told: object, status: int) -> None:
    _, new = leaving_the_apple(robot, Goal(joints_deg=(-20.0, 45.0, 45.0, 30.0)))
    certificate = new.report["certificate"] | ({} if told is None else {"contacts": told})
    write_csv(new.trajectory, tmp_path / "trajectory.csv")
    write_report({**new.report, "certificate": certificate, "given": {}}, tmp_path / "report.json")
    save_scene(new.scene, tmp_path / "scene.yaml")
    assert load_script("certify").main([str(tmp_path)]) == status
