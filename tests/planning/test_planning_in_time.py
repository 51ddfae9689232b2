"""Plans among moving obstacles: waiting, going around, going first; judged by coal."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from any_arms import loaded_arm
from arm_variants import least_by_coal
from fitted_arms import box, fitted
from planned import assert_within_limits, task

from hplan.certificate.certificate import certify
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.motion_coefficients import is_moved
from hplan.errors import ConfigurationInCollisionError, ObstacleInTimeError
from hplan.online.planner import Planner
from hplan.planning.in_time import among_poses, without_moving
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.planning.schedule import (
    CHANGES,
    LEVELS,
    STEP_S,
    USED,
    MovingField,
    PathInTime,
    earliest_schedule,
    room_to_change,
)
from hplan.robot.model import Robot
from hplan.scene.attached import Attached
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Sphere
from hplan.scene.tracks import Drift, Track
from hplan.trajectory.trajectory import Phase, scale_motion

START, GOAL = (0.0, 0.0, 0.0, 0.0), (0.0, 45.0, 60.0, 70.0)
BEHIND = Sphere(name="behind", center=(-1.5, 0.0, 1.0), radius=0.1)
PLANAR = {"locked_joints": ("base_yaw",)}


def on_the_way(robot: Robot) -> np.ndarray:
    """Position of the tool in the middle of the motion."""
    return robot.tool_positions(np.radians([0.0, 20.0, 30.0, 35.0]))


def ball(robot: Robot, *points: tuple[float, tuple[float, float, float]], radius: float = 0.2) -> Sphere:
    times, shifts = zip(*points, strict=True)
    center = tuple(on_the_way(robot).tolist())
    return Sphere(name="ball", center=center, radius=radius, track=Track(times_s=times, shifts_m=shifts))


def assert_sound(robot: Robot, scene: Scene, result: PlanResult) -> None:
    motion = result.trajectory
    assert result.certificate.verified
    assert result.report["certificate"]["verified"]
    assert least_by_coal(robot, scene, result.trajectory) > 0.0
    assert_within_limits(robot, motion)
    np.testing.assert_allclose(motion.position[0], scene.start.configuration, atol=1e-12)
    if scene.goal.listed_joints() is not None:
        np.testing.assert_allclose(motion.position[-1], scene.goal.configuration, atol=1e-9)
    assert [result.phases[0].start_s, result.phases[-1].end_s] == [0.0, motion.duration]


def test_moving_obstacle_off_the_path_changes_nothing(robot):
    scene = task(START, GOAL, [ball(robot, (0.0, (0.0, 3.0, 0.0)), (1.0, (0.0, 1.0, 0.0)))], **PLANAR)
    result = plan(robot, scene)
    alone = plan(robot, without_moving(scene))
    assert_sound(robot, scene, result)
    assert result.trajectory.duration == alone.trajectory.duration
    assert result.report["in_time"]["waits_s"] == 0.0
    assert result.report["scene"] == scene.name
    assert result.motion.problem.scene is scene


def test_arm_passes_before_approaching_obstacle(robot):
    """An obstacle arrives and stays: going around it later takes longer than going first."""
    comes = ball(robot, (0.0, (0.0, 2.0, 0.0)), (1.3, (0.0, 0.0, 0.0)))
    scene = task(START, GOAL, [comes], **PLANAR)
    result = plan(robot, scene)
    around = plan(robot, scene.snapshot(1.3))
    assert_sound(robot, scene, result)
    assert result.trajectory.duration < around.trajectory.duration - 0.1
    assert result.certificate.clear_until_s == math.inf


def wall(gone_s: float) -> Box:
    """A wall through the arm's plane above the start, that goes up and away."""
    up = Track(times_s=(0.0, gone_s, gone_s + 0.5), shifts_m=((0, 0, 0.0), (0, 0, 0.0), (0, 3.0, 0.0)))
    return Box(name="wall", center=(1.9, 0.0, 1.4), size=(3.0, 0.1, 0.2), track=up)


def test_arm_waits_without_detour(robot):
    scene = task(START, GOAL, [wall(1.0)], **PLANAR)
    result = plan(robot, scene)
    assert_sound(robot, scene, result)
    told = result.report["in_time"]
    assert told["waits_s"] > 0.3 or told["slows_down"]
    # Waiting until nothing moves any more, and then going, takes longer.
    assert result.trajectory.duration < scene.at_rest_s + told["at_full_speed_s"]
    assert result.trajectory.duration > told["at_full_speed_s"]


def test_arm_avoids_obstacle_that_blocks_for_long(robot):
    low = ball(robot, (0.0, (0.0, 0.0, 0.0)), (30.0, (0.0, 0.0, 0.01)))
    scene = task(START, GOAL, [low], **PLANAR)
    result = plan(robot, scene)
    assert_sound(robot, scene, result)
    assert "around" in result.report["in_time"]["path"]
    assert result.trajectory.duration < 3.0


def test_permanent_obstacle_is_named(robot):
    scene = task(START, GOAL, [wall(1.0)], **PLANAR)
    stays = scene.obstacles[0].track.model_copy(update={"shifts_m": ((0, 0, 0.0), (0, 0, 0.001), (0, 0, 0.002))})
    scene = scene.with_obstacles([scene.obstacles[0].model_copy(update={"track": stays})])
    with pytest.raises(ObstacleInTimeError) as caught:
        plan(robot, scene)
    assert caught.value.obstacle == "wall"
    assert 0.0 <= caught.value.at_s < 3.0
    assert caught.value.exit_status == 6
    assert "wall" in caught.value.message


def test_obstacle_that_hits_start_is_named(robot):
    end = robot.tool_positions(np.radians(START))
    there = Sphere(
        name="it",
        center=tuple(end.tolist()),
        radius=0.1,
        track=Track(times_s=(0.0, 1.0), shifts_m=((0, 0, 0.0), (0, 0, 0.1))),
    )
    with pytest.raises(ObstacleInTimeError) as caught:
        plan(robot, task(START, GOAL, [there], **PLANAR))
    assert caught.value.obstacle == "it"
    # Static obstacles there raise their usual error.
    with pytest.raises(ConfigurationInCollisionError):
        plan(robot, task(START, GOAL, [wall(0.1), there.model_copy(update={"track": None, "name": "still"})]))


def test_base_moves_slowly_along_the_row(robot):
    """A row of posts moves past the creeping base while the arm swings."""
    creep = Track(times_s=(0.0, 10.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 2.0, 0.0)))
    end = on_the_way(robot)
    post = Sphere(name="post", center=(float(end[0]), 0.45, float(end[2])), radius=0.2)
    scene = task(START, GOAL, [post], base_track=creep, **PLANAR)
    result = plan(robot, scene)
    assert_sound(robot, scene, result)
    # The same scene with the post moved the other way.
    back = Track(times_s=(0.0, 10.0), shifts_m=((0.0, 0.0, 0.0), (0.0, -2.0, 0.0)))
    other = task(START, GOAL, [post.model_copy(update={"track": back})], **PLANAR)
    assert least_by_coal(robot, other, result.trajectory) == pytest.approx(
        least_by_coal(robot, scene, result.trajectory), abs=1e-9
    )


def test_fruit_is_picked_while_something_passes(robot):
    """All phases have the new timing; the contact stays at its place on the path."""
    apple = Fruit(name="apple", center=(1.3, 0.3, 1.5), radius=0.04)
    still = task(START, Goal(fruit="apple"), [], fruits=(apple,))
    first = plan(robot, still)
    middle = robot.tool_positions(first.trajectory.position[first.trajectory.samples // 3])
    track = Track(times_s=(0.0, 0.6, 1.2), shifts_m=((0.0, 0.0, 1.2), (0.0, 0.0, 0.0), (0.0, 0.0, 1.2)))
    passes = Sphere(name="it", center=tuple(middle.tolist()), radius=0.15, track=track)
    scene = task(START, Goal(fruit="apple"), [passes], fruits=(apple,))
    result = plan(robot, scene)
    assert_sound(robot, scene, result)
    assert [phase.name for phase in result.phases] == [phase.name for phase in first.phases]
    assert result.certificate.contact_s is not None
    reached = result.picked_fruit["apple"]
    np.testing.assert_allclose(
        robot.tool_positions(result.trajectory.positions(np.array([reached]))[0]),
        robot.tool_positions(result.grasp.goal),
        atol=2e-3,
    )


@pytest.mark.parametrize("base", [False, True])
@pytest.mark.parametrize("rests_s", [0.2, 4.0])
def test_moving_fruit_is_picked_once_it_rests(robot, rests_s, base):
    """Swinging fruit, or fruit on the tree that the vehicle drives up to."""
    apple = Fruit(name="apple", center=(1.3, 0.5, 1.5), radius=0.04)
    towards = ((0.0, 0.0, 0.0), (0.0, -0.2, 0.0))
    if base:
        track = Track(times_s=(0.0, rests_s), shifts_m=tuple((x, -y, z) for x, y, z in towards))
        scene = task(START, Goal(fruit="apple"), [BEHIND], fruits=(apple,), base_track=track)
    else:
        moves = apple.model_copy(update={"track": Track(times_s=(0.0, rests_s), shifts_m=towards)})
        scene = task(START, Goal(fruit="apple"), [BEHIND], fruits=(moves,))
    result = plan(robot, scene)
    assert_sound(robot, scene, result)
    begin_s, _ = result.certificate.contact_s
    assert begin_s >= rests_s
    reached = result.trajectory.positions([result.picked_fruit["apple"]])[0]
    np.testing.assert_allclose(robot.tool_positions(reached), (1.3, 0.3, 1.5), atol=2e-3)
    assert certify(robot, scene, result.trajectory).verified
    # A fruit that rests later than the grasp may not be touched there, whatever windows are given.
    later = scene.starting_at(-(result.picked_fruit["apple"] - rests_s + 0.05))
    contacts = [replace(each, fruit=later.goal_fruit) for each in result.certificate.contacts]
    for check_ends in (True, False):
        assert not certify(robot, later, result.trajectory, contacts=contacts, check_ends=check_ends).verified
    assert result.scale_speed(0.5).certificate.verified


def test_planner_picks_a_moving_fruit(robot):
    track = Track(times_s=(100.0, 103.0), shifts_m=((0.0, 0.2, 0.0), (0.0, 0.0, 0.0)))
    apple = Fruit(name="apple", center=(1.3, 0.3, 1.5), radius=0.04, track=track)
    planner = Planner(robot, task(START, Goal(fruit="apple"), [BEHIND], fruits=(apple,)))
    first = planner.plan(begins_s=100.3)
    kept = planner.replan(at=100.8, now=100.6)
    assert kept.is_kept
    assert planner.replan(at=101.0, now=100.9).is_kept
    begin_s, _ = kept.certificate.contact_s
    assert kept.begins_s + begin_s >= 103.0
    planner.move("apple", track=track.starting_at(-1.0))  # it comes to rest later
    later = planner.replan(at=101.3, now=101.1)
    assert not later.is_kept
    assert later.certificate.verified
    assert later.begins_s + later.certificate.contact_s[0] >= 104.0
    assert first.trajectory.duration < later.begins_s + later.trajectory.duration - 100.3


def test_poses_of_movement_are_closely_spaced(robot):
    scene = task(START, GOAL, [ball(robot, (0.0, (0, 0, 0.0)), (2.0, (0, 0.3, 0.0))), wall(1.0)], **PLANAR)
    among = among_poses(scene, 0.0, 2.0)
    assert not among.moves
    centers = np.array([item.center for item in among.obstacles if item.name.startswith("ball")])
    assert len(centers) >= 0.3 / 0.03
    steps = np.linalg.norm(np.diff(centers, axis=0), axis=1)
    assert steps.max() < 0.031
    np.testing.assert_allclose(centers[[0, -1]], on_the_way(robot) + np.array([[0, 0, 0], [0, 0.3, 0]]), atol=1e-12)
    assert len({item.name for item in among.obstacles}) == len(among.obstacles)


def test_parts_that_only_tracking_errors_bring_together(tmp_path):
    """A mast that the upper arm touches only with a tracking error."""
    mast = box((0.05, 0.05, 0.8), (0.3, 0.0, 1.2))
    robot = fitted(tmp_path, {"turret": [mast]}, high=(20.0, 60.0, 30.0))
    item = ball(robot, (0.0, (0.0, -1.5, 0.0)), (0.5, (0.0, 1.5, 0.0)))
    scene = task(START, (0.0, 15.0, 50.0, 20.0), [item])
    motion = plan(robot, without_moving(scene), PlanOptions(effort="quick")).trajectory
    exact, off = (
        ClearanceField.build(robot, [], deviation=error).spare_clearance(motion.position[0]) for error in (0.0, 0.2)
    )
    assert exact > 0.0 > off
    field = MovingField(robot, scene, sigmas=3.0, tracking_error=0.2)
    assert PathInTime(motion, field, step_s=STEP_S, spare_s=0.0).clear(0)[0]


def test_cells_that_are_clear_are_clear_all_the_time(robot):
    scene = task(START, GOAL, [ball(robot, (0.0, (0.0, -1.5, 0.0)), (0.5, (0.0, 1.5, 0.0)))], **PLANAR)
    motion = plan(robot, without_moving(scene), PlanOptions(effort="quick")).trajectory
    field = MovingField(robot, scene, sigmas=3.0, tracking_error=0.0)
    spare_s, count = 0.06, 0
    cells = PathInTime(motion, field, step_s=STEP_S, spare_s=spare_s)
    for row in range(12):
        clear = cells.clear(row)
        count += clear.sum()
        for time_s in row * STEP_S + np.linspace(-0.5 * STEP_S - spare_s, 0.5 * STEP_S + spare_s, 9):
            assert (field.field_at(max(time_s, 0.0)).clearance_along(cells.configurations[clear]) > 0.0).all()
    assert 0.3 < count / (12 * len(cells.configurations)) < 1.0


def test_load_too_heavy_for_a_tilting_base_is_told_once_for_each_path(tmp_path_factory):
    ur5 = loaded_arm("ur5", tmp_path_factory)
    tilting = Track(
        times_s=(0.0, 2.0), shifts_m=((0.0, 0.0, 0.0),) * 2, rpy_deg=((0.0, 0.0, 0.0), (60.0, 0.0, 0.0)),
        about=(0.0, 0.0, 0.0),
    )  # fmt: skip
    bag = Attached(object=Sphere(name="bag", center=(0.0, 0.0, 0.1), radius=0.05), mass=9.0)
    scene = Scene(
        name="tilting", start=Start(joints_rad=(0.0, -1.5, 1.0, 0.0, 0.0, 0.0)),
        goal=Goal(joints_rad=(1.0, -1.0, 1.2, 0.1, 0.0, 0.0)), base_track=tilting, attached=(bag,),
    )  # fmt: skip
    with pytest.raises(ObstacleInTimeError, match=r"torque reaches .* as the base tilts") as failed:
        plan(ur5, scene, PlanOptions(effort="quick"))
    assert failed.value.obstacle is None
    assert len(failed.value.tried) == len(set(failed.value.tried))


def test_uncertain_moving_obstacle_is_passed_with_more_clearance(robot):
    certain = ball(robot, (0.0, (0.0, -1.0, 0.0)), (1.0, (0.0, 1.0, 0.0)))
    away = [
        MovingField(robot, task(START, GOAL, [item]), sigmas=2.0, tracking_error=0.0)
        .field_at(0.0)
        .clearance_along(np.zeros((1, 4)), 9.0)
        for item in (certain, certain.model_copy(update={"sigma": 0.01}))
    ]
    moved = is_moved(robot)
    assert moved.sum() == 3  # pedestal and turret stay in place, and are checked apart
    np.testing.assert_allclose((away[0] - away[1])[:, moved], 0.02, atol=1e-9)


def test_speed_changes_where_acceleration_and_torque_have_room(robot):
    """By the equations of motion, for a barely strong enough arm."""
    motion = plan(robot, task(START, GOAL, [], **PLANAR), PlanOptions(effort="quick")).trajectory
    arm = replace(robot, torque_limit=1.02 * np.abs(motion.torque).max(axis=0))
    stations = 9
    room = room_to_change(motion, arm, stations)
    rows = np.searchsorted(motion.time, np.linspace(0.0, motion.duration, stations)).clip(max=motion.samples - 1)
    expected = np.ones_like(room)
    for (station, level, change), _ in np.ndenumerate(room):
        q, v, a = (values[rows[station]] for values in (motion.position, motion.velocity, motion.acceleration))
        speed, rate = level / LEVELS, (change - CHANGES) / (LEVELS * STEP_S)
        acceleration = speed**2 * a + rate * v
        torque = arm.dynamics.torques(q[None], speed * v[None], acceleration[None])[0]
        limit = np.maximum(USED * arm.torque_limit, np.abs(arm.dynamics.gravity(q[None])[0]))
        within = (np.abs(acceleration) <= USED * arm.acceleration_limit).all() and (np.abs(torque) <= limit).all()
        expected[station, level, change] = within or change == CHANGES
    assert (room == expected).all()
    assert 0.2 < room.mean() < 0.98


class Window:
    """Cells of a path whose middle is blocked until a row."""

    def __init__(self, stations: int, opens: int) -> None:
        self.configurations = np.zeros((stations, 1))
        self._opens = opens

    def clear(self, row: int) -> np.ndarray:
        clear = np.ones(len(self.configurations), dtype=np.bool_)
        middle = len(clear) // 2
        clear[middle - 1 : middle + 2] = row >= self._opens
        return clear


@pytest.mark.parametrize("at_rest", [True, False], ids=["from rest", "in motion"])
def test_earliest_schedule_against_a_search_of_all(at_rest):
    """On a small grid: breadth first over all states in plain Python."""
    duration = 0.3
    for opens in (0, 4, 9, 15):
        cells = Window(61, opens)
        room = np.ones((61, LEVELS + 1, 2 * CHANGES + 1), dtype=np.bool_)
        found = earliest_schedule(cells, duration, room, at_rest_s=opens * STEP_S, at_rest=at_rest)
        unit = STEP_S / (2 * LEVELS)
        places = math.ceil(duration / unit - 1e-9)

        def station(place, duration=duration, unit=unit):
            return min(int(np.rint(place * unit / duration * 60)), 60)

        states, row = {(0, 0 if at_rest else LEVELS)}, 0
        while states and not any(place == places for place, _ in states):
            before, after, following = cells.clear(row), cells.clear(row + 1), set()
            for place, speed in states:
                top = LEVELS if (place, speed) == (0, 0) else speed + CHANGES
                for new in range(max(0, speed - CHANGES), min(LEVELS, top) + 1):
                    to, middle = min(place + speed + new, places), min(place + (3 * speed + new) // 4, places)
                    if (
                        before[station(place) : station(middle) + 1].all()
                        and after[station(middle) : station(to) + 1].all()
                    ):
                        following.add((to, new))
            states, row = following, row + 1
        assert (found is None) == (not states)
        if found is None:  # in motion it cannot wait
            assert not at_rest
            continue
        assert len(found.time) - 1 == row
        assert at_rest or found.speed[0] == 1.0
        assert found.place[0] == 0.0
        assert found.place[-1] == duration
        assert (np.diff(found.place) >= 0.0).all()
        # Without room to change the speed it starts late, at full speed.
        fixed = room.copy()
        fixed[:] = False
        fixed[:, :, CHANGES] = True
        late = earliest_schedule(cells, duration, fixed, at_rest_s=opens * STEP_S, at_rest=at_rest)
        if not at_rest:
            assert late is None or late.time[-1] == pytest.approx(duration, abs=2.0 * STEP_S)
            continue
        assert late.time[-1] >= found.time[-1]
        assert late.waiting_s == pytest.approx(late.time[-1] - duration, abs=2.0 * STEP_S)
    assert earliest_schedule(Window(61, 10**6), duration, room, at_rest_s=1.0) is None


def test_phases_by_another_clock_hold_all_that_they_held(robot):
    """From the last sample before the start to the first one after the end."""
    motion, random = plan(robot, task(START, GOAL, **PLANAR)).trajectory, np.random.default_rng(0)
    retimed = scale_motion(motion, [(0.0, 0.4), (0.3, 1.0), (0.6, 0.5)], robot)
    clock, time = retimed.clock, retimed.trajectory.time
    for ends in (
        *np.sort(random.uniform(0.0, motion.duration, (20, 2))),
        np.sort(random.choice(clock, 2)),
        clock[[0, -1]],
    ):
        phase = Phase("any", *ends.tolist()).retime(retimed.clock, retimed.trajectory.time)
        first = max(row for row, when in enumerate(clock) if when <= ends[0] + 1e-9)
        last = min(row for row, when in enumerate(clock) if when >= ends[1] - 1e-9)
        assert phase.start_s == (time[first] if ends[0] > 0.0 else 0.0)
        assert phase.end_s == (time[last] if ends[1] < motion.duration else time[-1])


def test_arm_at_its_goal_is_told_what_comes(robot: Robot) -> None:
    """A motion of no duration has no timing: the error names what the arm touches at once."""
    place = tuple(robot.tool_positions(np.radians(GOAL)).tolist())
    track = Track(times_s=(0.0, 1.0), shifts_m=((0.0,) * 3, (0.0, 0.0, 1.0)), drift=Drift(radius_m=0.2))
    near = Sphere(name="near", center=(place[0], place[1], place[2] + 0.3), radius=0.1, track=track)
    with pytest.raises(ObstacleInTimeError) as caught:
        plan(robot, task(GOAL, GOAL, [near]))
    assert caught.value.obstacle == "near"
