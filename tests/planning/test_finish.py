"""Given paths among obstacles: certified, or refused with the place of contact."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from any_arms import loaded_arm
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import certify
from hplan.collision.coal_scene import CoalScene
from hplan.errors import HplanError, InputError, MovingObstacleError, NotInTimeError, OptionError, PathInContactError
from hplan.planning.finish import finish
from hplan.planning.options import PlanOptions
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Obstacle, Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.corner_rounding import largest_path_deviation

QUICK = PlanOptions(effort="quick")

#: A configuration of each arm: its first joint turns to both sides from there.
MIDDLE = {
    "harvester": np.radians([20.0, 45.0, 40.0, 30.0]),
    "panda": np.array([0.2, -0.3, 0.0, -1.8, 0.0, 1.6, 0.8]),
    "ur5": np.array([0.2, -1.0, 1.2, -1.7, -1.57, 0.0]),
}


@pytest.fixture(scope="module", params=list(MIDDLE))
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Robot, FloatArray]:
    name = request.param
    robot = load_robot() if name == "harvester" else loaded_arm(name, tmp_path_factory)
    return robot, MIDDLE[name]


@pytest.fixture(scope="module")
def harvester() -> tuple[Robot, FloatArray]:
    return load_robot(), MIDDLE["harvester"]


def scene_of(robot: Robot, *obstacles: Obstacle, **more: object) -> Scene:
    rest = tuple([0.0] * robot.dof)
    keys = {"start": Start(joints_rad=rest), "goal": Goal(joints_rad=rest), "obstacles": obstacles}
    return Scene.model_validate({"format": "hplan-scene/1", "name": "path", **keys, **more})


def swing(middle: FloatArray, half: float = 0.3) -> FloatArray:
    """A straight motion of the first joint, with the configuration in its middle."""
    turn = half * np.eye(len(middle))[0]
    return np.array([middle - turn, middle + turn])


def zigzag(middle: FloatArray, amplitude: float = 0.1, count: int = 7) -> FloatArray:
    """The swing in steps, with another joint moving back and forth."""
    first, last = swing(middle)
    points = np.linspace(first, last, count)
    points[1:-1:2, -1] += amplitude
    points[2:-1:2, -1] -= amplitude
    return points


def ball_at(robot: Robot, q: FloatArray, distance: float, ahead: float = 0.15) -> Sphere:
    """A ball before the tool at a signed distance from the arm, by coal."""
    tool = robot.tool_positions(q[None])[0]
    out = np.append(tool[:2] / np.linalg.norm(tool[:2]), 0.0)
    centre = tuple((tool + ahead * out).tolist())
    near = CoalScene(robot, Sphere(name="ball", center=centre, radius=0.01).solids).distances(q)[:, 0].min()
    return Sphere(name="ball", center=centre, radius=float(0.01 + near - distance))


def far_ball(robot: Robot, q: FloatArray) -> Sphere:
    return ball_at(robot, q, 0.1, 0.3)


def check(robot: Robot, result: PlanResult, points: FloatArray) -> None:
    """Check the certificate, from the first to the last waypoint, independently."""
    assert result.certificate.verified
    assert result.trajectory.position[[0, -1]] == pytest.approx(points[[0, -1]], abs=1e-9)
    assert certify(robot, result.scene, result.trajectory).verified


def test_zigzags_are_shortened_and_certified(arm: tuple[Robot, FloatArray]) -> None:
    robot, middle = arm
    points, scene = zigzag(middle), scene_of(arm[0], far_ball(*arm))
    found = finish(robot, scene, points, QUICK)
    check(robot, found, points)
    given = found.report["given"]
    assert (given["waypoints"], given["moved_segments"]) == (7, [])
    assert given["length_finished_rad"] < 0.8 * given["length_rad"]
    again = finish(robot, scene, np.repeat(points, 2, axis=0).tolist(), QUICK)
    assert (again.trajectory.position == found.trajectory.position).all()


def test_shape_of_path_is_preserved(arm: tuple[Robot, FloatArray]) -> None:
    robot, middle = arm
    points = zigzag(middle)
    found = finish(robot, scene_of(robot, far_ball(*arm)), points, QUICK, keep_within_rad=0.02)
    check(robot, found, points)
    assert largest_path_deviation(found.trajectory.position, points) <= 0.02 + 1e-3
    assert found.report["given"]["length_finished_rad"] > 0.9 * found.report["given"]["length_rad"]


def test_contact_in_the_middle_of_a_motion(arm: tuple[Robot, FloatArray]) -> None:
    robot, middle = arm
    start, goal = swing(middle, 0.5)
    before = start + 0.2 * (start - middle)
    ball = ball_at(robot, middle, -0.01)
    with pytest.raises(PathInContactError) as refused:
        finish(robot, scene_of(robot, ball), [before, start, start, goal], QUICK)
    error = refused.value
    assert (error.waypoint, error.segment, error.obstacle) == (None, 3, "ball")
    checker, between = CoalScene(robot, ball.solids), np.linspace(start, goal, 301)
    deepest = -min(checker.distances(q)[:, 0].min() for q in between)
    assert error.depth_m >= deepest - 1e-5
    at = start + error.fraction * (goal - start)
    assert error.depth_m == pytest.approx(-checker.distances(at)[:, 0].min(), abs=1e-9)
    assert "between waypoints 3 and 4" in error.message
    assert error.exit_status == 5


def test_contact_at_a_waypoint(arm: tuple[Robot, FloatArray]) -> None:
    robot, middle = arm
    start, goal = swing(middle)
    with pytest.raises(PathInContactError) as refused:
        finish(robot, scene_of(robot, ball_at(robot, middle, -1e-3)), [start, middle, goal], QUICK)
    error = refused.value
    assert (error.waypoint, error.segment, error.obstacle, len(error.places)) == (2, None, "ball", 1)
    assert error.depth_m == pytest.approx(1e-3, abs=1e-5)
    with pytest.raises(PathInContactError) as refused:
        finish(robot, scene_of(robot, ball_at(robot, goal, -1e-3)), [start, goal], QUICK)
    assert refused.value.waypoint == 2


@pytest.mark.parametrize("depth", [2e-5, 1e-4, 1e-3])
def test_grazing_contact_is_found(arm: tuple[Robot, FloatArray], depth: float) -> None:
    robot, middle = arm
    with pytest.raises(PathInContactError) as refused:
        finish(robot, scene_of(robot, ball_at(robot, middle, -depth)), swing(middle), QUICK)
    assert refused.value.depth_m >= 0.5 * depth


@pytest.mark.parametrize(("back", "fraction"), [(False, 4.0 / 7.0), (True, 3.0 / 7.0)])
def test_near_miss_does_not_hide_a_contact(harvester: tuple[Robot, FloatArray], back: bool, fraction: float) -> None:
    robot, middle = harvester
    start, goal = middle - 0.4 * np.eye(4)[0], middle + 0.3 * np.eye(4)[0]
    near = ball_at(robot, start, 5e-4, 0.05).model_copy(update={"name": "near"})
    path = [goal, start] if back else [start, goal]
    with pytest.raises(PathInContactError) as refused:
        finish(robot, scene_of(robot, near, ball_at(robot, middle, -1e-3, 0.05)), path, QUICK)
    assert refused.value.obstacle == "ball"
    assert refused.value.fraction == pytest.approx(fraction, abs=0.01)


@pytest.mark.parametrize("keep", [None, 0.02])
def test_path_with_small_clearance_is_pushed_away(arm: tuple[Robot, FloatArray], keep: float | None) -> None:
    robot, middle = arm
    start, goal = swing(middle)
    scene = scene_of(robot, ball_at(robot, middle, 2e-3), clearance=5e-3)
    found = finish(robot, scene, [start, middle, goal], QUICK, keep_within_rad=keep)
    check(robot, found, np.array([start, goal]))
    assert found.report["given"]["moved_segments"] == [1, 2]
    assert found.certificate.min_clearance_m >= 0.0
    assert found.certificate.nearest is not None
    assert found.certificate.nearest.distance_m >= 5e-3


def test_locked_joints_stay_when_it_is_moved_away(harvester: tuple[Robot, FloatArray]) -> None:
    robot, middle = harvester
    start, goal = swing(middle)
    scene = scene_of(robot, ball_at(robot, middle, 2e-3), clearance=5e-3, locked_joints=("shoulder", "wrist"))
    found = finish(robot, scene, [start, start, middle, goal], QUICK)
    assert found.report["given"]["moved_segments"] == [2, 3]  # as they were given, the repeated one counted
    assert found.certificate.verified
    np.testing.assert_allclose(np.ptp(found.trajectory.position[:, [1, 3]], axis=0), 0.0, atol=1e-12)


def test_deadline_with_time_enough_changes_nothing(harvester: tuple[Robot, FloatArray]) -> None:
    robot, middle = harvester
    (start, goal), up = swing(middle), np.array([0.0, -0.7, 0.6, 0.0])
    scene, path = scene_of(robot, ball_at(robot, middle, -0.05)), [start, start + up, goal + up, goal]
    found, timed = (finish(robot, scene, path, PlanOptions(deadline_s=deadline_s)) for deadline_s in (None, 300.0))
    np.testing.assert_array_equal(timed.trajectory.position, found.trajectory.position)
    with pytest.raises(NotInTimeError):
        finish(robot, scene, path, PlanOptions(deadline_s=1e-3))


@pytest.mark.parametrize("waypoint", [1, 2])
def test_ends_that_are_too_close_are_refused(harvester: tuple[Robot, FloatArray], waypoint: int) -> None:
    robot, middle = harvester
    ends = swing(middle)
    with pytest.raises(PathInContactError, match="too close") as refused:
        finish(robot, scene_of(robot, ball_at(robot, ends[waypoint - 1], 2e-3), clearance=5e-3), ends, QUICK)
    error = refused.value
    assert (error.waypoint, error.clearance_m) == (waypoint, 5e-3)
    assert error.depth_m == pytest.approx(3e-3, abs=1e-5)


@settings(max_examples=12, deadline=None)
@given(distance=st.floats(-3e-3, 3e-3), seed=st.integers(0, 99))
def test_nothing_in_contact_is_verified(distance: float, seed: int) -> None:
    """For any path at any distance: certified by coal, too, or refused."""
    robot, middle = load_robot(), MIDDLE["harvester"]
    rng = np.random.default_rng(seed)
    ball = ball_at(robot, middle, distance)
    points = np.vstack([swing(middle)[:1], middle + 0.05 * rng.uniform(-1, 1, (3, 4)), swing(middle)[1:]])
    checker = CoalScene(robot, ball.solids)
    fine = np.vstack([np.linspace(a, b, 100) for a, b in itertools.pairwise(points)])
    touches = checker.in_collision(fine).any()
    try:
        found = finish(robot, scene_of(robot, ball), points, QUICK)
    except HplanError:
        return
    assert not touches
    assert not checker.in_collision(found.trajectory.position).any()


def test_scenes_that_do_not_fit(harvester: tuple[Robot, FloatArray]) -> None:
    robot, middle = harvester
    with pytest.raises(InputError, match="locked") as refused:
        finish(robot, scene_of(robot, locked_joints=(robot.joint_names[0],)), swing(middle), QUICK)
    assert refused.value.data["waypoint"] == 2
    track = Track(times_s=(0.0, 1.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    moving = Sphere(name="cart", center=(0.0, 3.0, 0.0), radius=0.1, track=track)
    with pytest.raises(MovingObstacleError):
        finish(robot, scene_of(robot, moving), swing(middle), QUICK)
    start = Start(joints_rad=(0.0,) * 4, velocity_rad_s=(0.1, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="in motion"):
        finish(robot, scene_of(robot, start=start), swing(middle), QUICK)
    with pytest.raises(OptionError):
        finish(robot, scene_of(robot), swing(middle), QUICK, keep_within_rad=0.0)
