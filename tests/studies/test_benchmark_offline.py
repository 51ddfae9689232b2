"""The offline peer: its expressions say what Pinocchio and hplan's kernels say, and its motions count if certified."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from studies.benchmark.fastest import offline
from studies.benchmark.fastest.offline import SAME, SLOWER, STARTS, distinct, optimized
from studies.benchmark.fastest.peers import _path, _places
from studies.benchmark.fastest.problems import problem_of
from studies.benchmark.fastest.records import read_records
from studies.benchmark.fastest.symbolic import inverse_dynamics, link_distance, links_apart, load_casadi
from studies.benchmark.fastest.transcription import OfflineProblem, fastest
from studies.benchmark.narrow.scenes import drawn_member
from studies.benchmark.paths import PeerTask, limits_of, processed_motion

from hplan.collision.clearance_field import ClearanceField
from hplan.errors import InputError
from hplan.optimization.timed_spline import TimedSpline, even_breaks
from hplan.planning.plan import plan
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Capsule, Sphere
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import certify


@pytest.fixture(params=["harvester", "orchard_harvester", "drawn"])
def arm(request: pytest.FixtureRequest) -> Robot:
    return drawn_member(14, 2) if request.param == "drawn" else load_robot(request.param)


def test_torques_are_those_of_pinocchio(arm: Robot) -> None:
    pytest.importorskip("casadi")
    torques, data = inverse_dynamics(arm.model), arm.model.createData()
    for q, v, a in np.random.default_rng(0).uniform(-3.0, 3.0, (20, 3, arm.dof)):
        expected = pin.rnea(arm.model, data, q, v, a)
        np.testing.assert_allclose(np.array(torques(q, v, a)).ravel(), expected, atol=1e-9)


def test_distances_are_those_of_the_kernels(arm: Robot) -> None:
    """A capsule, and one of no length, which is a ball."""
    pytest.importorskip("casadi")
    random = np.random.default_rng(1)
    distances = [link_distance(arm, link) for link in range(arm.arm.link_count)]
    for number in range(40):
        first, second = random.uniform(-1.5, 1.5, (2, 3))
        ball = Sphere(name="ball", center=tuple(first), radius=0.02)
        capsule = Capsule(name="capsule", start=tuple(first), end=tuple(second), radius=0.02)
        # (The obstacle alone: parts of the arm itself come after it.)
        field = ClearanceField.of(arm, [capsule if number % 2 else ball])
        field = replace(field, solids=field.solids[:1], owner=field.owner[:1])
        q = random.uniform(arm.lower, arm.upper)
        ends = first, second if number % 2 else first
        found = [float(distance(q, *ends)) for distance in distances] - arm.arm.half_widths - 0.02
        apart = field.link_clearances(q)
        np.testing.assert_allclose(found[apart > 0.0], apart[apart > 0.0], atol=1e-9)
        assert (found[apart <= 0.0] <= 1e-5).all()


def test_distance_of_links_is_that_of_their_axes() -> None:
    pytest.importorskip("casadi")
    arm = load_robot("orchard_harvester")
    apart = links_apart(arm, 0, 2)
    # Folded back: the wrist stands beside the upper arm, and the hand points away from it.
    q = np.radians([30.0, 20.0, 150.0, 0.0])
    points = arm.arm.joint_points(q[1:])
    along, normal = np.array([np.cos(q[1]), np.sin(q[1])]), np.array([-np.sin(q[1]), np.cos(q[1])])
    assert 0.0 < (points[2] - points[0]) @ along < arm.arm.lengths[0]
    sides = (points[2:] - points[0]) @ normal
    inside = (points[2:] - points[0]) @ along
    nearest = np.abs(sides[inside > 0.0]).min()
    assert float(apart(q)) == pytest.approx(nearest, rel=0.05)


@pytest.fixture(scope="module")
def task(robot: Robot, scene: Scene) -> PeerTask:
    return PeerTask.of(robot, scene)


def offline_problem(task: PeerTask, margin: float) -> OfflineProblem:
    asked = task.problem
    limits = limits_of(task.robot)
    return OfflineProblem(task.robot, task.field, limits, asked.movable, asked.lower, asked.upper, margin)


def test_a_program_is_faster_than_its_start_and_keeps_the_limits(task: PeerTask) -> None:
    """A few pieces of the reference scene; the obstacle is kept clear of at the places looked at, and left behind."""
    pytest.importorskip("casadi")
    quick = plan(task.robot, task.scene, PlanOptions(effort="quick")).trajectory
    positions = offline.of_rows(quick).positions
    start = TimedSpline.near(positions, even_breaks(quick.duration, 40))
    found = fastest(offline_problem(task, 1e-3), start)
    assert found is not None
    assert 1.7 < found.duration < quick.duration
    clock = found.knots[3:-3]
    q, v, a = (found.path.evaluate(clock, order) for order in range(3))
    assert (np.abs(v) / task.robot.velocity_limit).max() < 1.0 + 1e-6
    assert (np.abs(a) / task.robot.acceleration_limit).max() == pytest.approx(1.0, abs=1e-5)
    assert task.field.along(q).min() == pytest.approx(1e-3, abs=1e-4)
    assert np.abs(task.robot.dynamics.torques(q, v, a) / task.robot.torque_limit).max() < 1.0
    np.testing.assert_array_equal(found.control[[0, -1]], start.control[[0, -1]])


def test_the_motion_found_is_certified_and_no_slower(
    robot: Robot, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("casadi")
    monkeypatch.setattr(offline, "ROWS_EACH", 8)
    monkeypatch.setattr(offline, "PROGRAMS", 3)
    start = plan(robot, scene, PlanOptions(effort="quick")).trajectory
    found = optimized(robot, scene, [start])
    assert found is not None
    assert certify(robot, scene, found).verified
    assert found.duration < 0.98 * start.duration


def test_starts_are_the_fastest_few_that_differ(robot: Robot, scene: Scene) -> None:
    motion = plan(robot, scene).trajectory

    def lasting(factor: float) -> Trajectory:
        return replace(motion, time=motion.time * factor)

    given = [lasting(factor) for factor in (1.05, 1.0, 1.0 + 0.5 * SAME, 1.02, 1.1, SLOWER + 0.01)]
    assert distinct(given) == [given[1], given[3]]
    assert STARTS == 2
    assert distinct([]) == []


def test_a_detour_goes_by_a_clear_configuration(records_task: tuple[object, PeerTask]) -> None:
    pytest.importorskip("ompl")
    problem, task = records_task
    places = _places(problem, task, 3)  # type: ignore[arg-type]
    assert len(places) == 3
    assert all(task.field.clearance(q) > 0.0 and q[0] == task.problem.start[0] for q in places)
    paths = [path for path in (_path(task, via) for via in places) if path is not None]
    assert paths
    for path in paths:
        np.testing.assert_array_equal(path[[0, -1]], [task.problem.start, task.problem.goal])
        assert task.field.is_clear(path, task.smallest_margin)
    assert processed_motion(task, paths[0]) is not None


@pytest.fixture(scope="module")
def records_task() -> tuple[object, PeerTask]:
    problem = problem_of(next(r for r in read_records() if r.name.startswith("discs")), None)
    return problem, PeerTask.of(problem.robot, problem.scene)


def test_without_casadi_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(InputError, match=r"hplan\[bench\]"):
        load_casadi()
