"""The study of motions past what moves: its scenes, its judge, its baseline, its table."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from arm_variants import coal_distances
from studies.benchmark.moving import splices
from studies.benchmark.moving.judge import least_distance
from studies.benchmark.moving.measure import measure
from studies.benchmark.moving.safe_intervals import _search, safe_interval_motion
from studies.benchmark.moving.scenes import KINDS, kind_of, moving_scene
from studies.benchmark.tables import moving as tables

from hplan.collision.clearance_field import ClearanceField
from hplan.moving.obstacles_at import without_moving


def test_scenes_follow_from_seed_and_number(robot):
    for number in (0, 3, 6):
        scene = moving_scene(robot, 0, number)
        assert scene == moving_scene(robot, 0, number)
        (moving,) = [item for item in scene.obstacles if item.track is not None]
        assert moving.name == kind_of(number)
        assert bool(scene.locked_joints) == (number // len(KINDS) % 2 == 0)


@pytest.mark.parametrize("number", [1, 3])
def test_the_judge_sees_what_coal_sees_at_each_time(robot, number):
    scene = moving_scene(robot, 0, number)
    start, goal = scene.start.configuration, scene.goal.configuration
    times = np.linspace(0.0, 2.0, 9)

    def positions(clock):
        return start + np.clip(clock / 2.0, 0.0, 1.0)[:, None] * (goal - start)

    wanted = min(
        coal_distances(robot, q, scene.at(time).obstacles).min()
        for time, q in zip(times.tolist(), positions(times), strict=True)
    )
    assert least_distance(robot, scene, positions, 2.0, 0.25) == pytest.approx(wanted, abs=1e-6)


def test_safe_intervals_are_searched_for_the_earliest_arrival():
    """On a line of five nodes, the middle of which is open for a while: it waits before it, and no longer."""
    open_times = {2: [(1.0, 1.4), (3.0, math.inf)]}

    def intervals(node):
        return open_times.get(node[0], [(0.0, math.inf)]) if 0 <= node[0] <= 4 else []

    takes = {(-1,): 0.25, (1,): 0.25}
    times, nodes, _ = _search((4,), takes, intervals, lambda node: 0.25 * abs(4 - node[0]))
    assert times[-1] == pytest.approx(1.5)
    assert [node for node, _ in itertools.groupby(nodes)] == [(0,), (1,), (2,), (3,), (4,)]
    open_times[2] = [(3.0, math.inf)]
    assert _search((4,), takes, intervals, lambda node: 0.0)[0][-1] == pytest.approx(3.5)
    open_times[2] = []
    assert _search((4,), takes, intervals, lambda node: 0.0) is None


def test_a_motion_by_safe_intervals_is_clear_at_its_nodes(robot):
    scene = moving_scene(robot, 0, 1)
    still = ClearanceField.of(robot, without_moving(scene).solids)
    grid = safe_interval_motion(robot, scene, still)
    np.testing.assert_allclose(grid.position[[0, -1]], [scene.start.configuration, scene.goal.configuration])
    for time, q in zip(grid.time.tolist(), grid.position, strict=True):
        # Times are looked at 50 ms apart, at which what moves may come so much nearer.
        assert coal_distances(robot, q, scene.at(time).obstacles).min() > -0.08
    speeds = np.abs(np.diff(grid.position, axis=0)) / np.diff(grid.time)[:, None]
    assert (speeds <= robot.velocity_limit + 1e-9).all()


def test_the_table_of_a_small_run(robot):
    results = measure(robot, seed=0, scenes=2, progress=lambda *_: None)
    assert results["scenes"] == 2
    assert results["at_fault"] == []
    found = tables.tables(results)
    assert {len(row) for row in found[0].rows} == {len(found[0].columns)}
    assert found[0].rows[0][0] == "all"


def test_splices_among_what_crosses_are_looked_at(robot):
    rows = splices.walk(robot, 0, 0, steps=3)
    told = splices.numbers(rows)
    assert told["steps"] == len(rows) == 3
    assert told["certified"] == sum("certified" in row for row in rows)
    assert told["contacts"] == told["stops_contacts"] == told["told_stops_contacts"] == 0
    assert told["largest_jumps"][0] < 1e-9
