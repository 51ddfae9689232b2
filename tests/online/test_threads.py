"""Concurrent planning in threads gives the same results as sequential planning."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from planned import post, task

import hplan
from hplan.collision.coal_accuracy import CURVED
from hplan.collision.coal_scene import CoalScene
from hplan.collision.collision_bodies import collision_bodies
from hplan.planar.grid.yaw_layers import LayerCache
from hplan.planning.plan import solve_scene
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Sphere


@pytest.fixture(autouse=True)
def switching() -> Iterator[None]:
    """Threads switch as often as Python permits."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


def scenes() -> list[Scene]:
    """Different ones, so that an answer to another's question shows."""
    return [
        task((-40.0 + 3.0 * number, 30.0, 30.0, 30.0), (40.0, 30.0, 30.0, 30.0), [
            post("post", float(number), 1.2, 0.3, 2.0),
            Sphere(name="ball", center=(0.5, -1.2, 1.5), radius=0.1 + 0.01 * number),
        ])
        for number in range(4)
    ]  # fmt: skip


def at_once(jobs: list[Callable[[], Any]]) -> list[Any]:
    """Run jobs in threads that start together."""
    gate = threading.Barrier(len(jobs))

    def run(job: Callable[[], Any]) -> Any:
        gate.wait()
        return job()

    with ThreadPoolExecutor(len(jobs)) as pool:
        return list(pool.map(run, jobs))


def assert_same(found: hplan.PlanResult, expected: hplan.PlanResult) -> None:
    np.testing.assert_array_equal(found.trajectory.time, expected.trajectory.time)
    np.testing.assert_array_equal(found.trajectory.position, expected.trajectory.position)
    assert found.certificate.verified
    assert found.certificate.min_clearance_m == pytest.approx(expected.certificate.min_clearance_m, abs=1e-12)


def test_plans_with_one_robot(robot: Robot) -> None:
    options = hplan.PlanOptions(step_deg=2.0)
    expected = [hplan.plan(robot, scene, options) for scene in scenes()]
    jobs = [lambda scene=scene: hplan.plan(robot, scene, options) for scene in scenes()]
    for found, alone in zip(at_once(jobs), expected, strict=True):
        assert_same(found, alone)


def test_queries_of_one_collision_scene(robot: Robot) -> None:
    """The arm's placement must not change during a query.

    The iteration of coal for cylinders begins where the last one ended: their distances differ within its error.
    """
    scene = CoalScene(robot, scenes()[0].solids)
    pairs = np.arange(len(scene.pairs))
    workers = 4
    places = np.random.default_rng(0).uniform(robot.lower, robot.upper, (workers, robot.dof))

    def ask(q: np.ndarray) -> np.ndarray:
        answers = []
        for _ in range(300):
            scene.place(q)
            answers.append(scene.distances_of(pairs))
        return np.array(answers)

    cylinders = {body.name for body in collision_bodies(robot) if body.kind == "cylinder"}
    contacts = [scene.contact(*pair, 0.0) for pair in scene.pairs]
    errors = np.array([CURVED if {each.link, each.obstacle} & cylinders else 1e-9 for each in contacts])
    assert errors.min() < CURVED
    expected = [ask(q)[0] for q in places]
    for found, alone in zip(at_once([lambda q=q: ask(q) for q in places]), expected, strict=True):
        assert (np.abs(found - alone) <= errors).all()


def test_one_planner(robot: Robot) -> None:
    """Every plan is for one complete scene, never for a partly changed one."""
    start = scenes()[0]
    planner = hplan.Planner(robot, start, hplan.PlanOptions(step_deg=2.0))
    planner.plan()

    def move(number: int) -> None:
        for turn in range(6):
            planner.move("ball", center=(0.5, -1.2, 1.5 + 0.01 * (number + turn)))
            result = planner.replan()
            scene = result.motion.problem.scene
            assert hplan.certify(robot, scene, result.trajectory).verified

    at_once([lambda number=number: move(number) for number in range(3)])
    assert planner.last is not None
    assert planner.last.motion.problem.scene == planner.scene


def test_changes_frames_and_stops_do_not_wait_for_a_plan(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """The plan under way is of the scene that it began with; the next one waits for it."""
    planner = hplan.Planner(robot, scenes()[0])
    first = planner.plan()
    began_with, planning, go_on = planner.scene, threading.Event(), threading.Event()

    def slow(*arguments: Any, **options: Any) -> Any:
        planning.set()
        assert go_on.wait(60)
        return solve_scene(*arguments, **options)

    monkeypatch.setattr("hplan.online.planner.solve_scene", slow)
    with ThreadPoolExecutor(2) as pool:
        plan = pool.submit(planner.plan)
        assert planning.wait(60)
        planner.remove("ball")
        planner.set_cloud("seen", [(1.0, -1.0, 1.0)], radius=0.01)
        assert planner.stop_at(0.1).certificate.verified
        after = pool.submit(planner.replan)
        assert not threading.Event().wait(0.1)
        assert (plan.done(), after.done(), planner.last) == (False, False, first)
        go_on.set()
        assert plan.result(60).scene is began_with
        assert [item.name for item in after.result(60).scene.obstacles] == ["post", "seen"]


def test_frames_while_others_plan(robot: Robot) -> None:
    """Each thread's last frame is valid; the memory of frames and the plans are complete."""
    planner = hplan.Planner(robot, scenes()[0], hplan.PlanOptions(step_deg=2.0))
    planner.plan()
    frames = [np.random.default_rng(number).uniform((0.9, -1.2, 1.0), (1.1, -1.0, 1.2), (2000, 3)) for number in (0, 1)]

    def see(number: int) -> None:
        for turn in range(10):
            planner.set_cloud(f"camera {number}", frames[number] + 1e-3 * turn, radius=0.005, keep_s=1.0, time_s=turn)

    def replan() -> None:
        for _ in range(5):
            result = planner.replan()
            assert hplan.certify(robot, result.scene, result.trajectory).verified

    at_once([lambda: see(0), lambda: see(1), replan])
    for number in (0, 1):
        alone = hplan.Planner(robot, scenes()[0])
        for turn in (8, 9):
            alone.set_cloud("seen", frames[number] + 1e-3 * turn, radius=0.005, keep_s=1.0, time_s=turn)
        found = next(item for item in planner.scene.obstacles if item.name == f"camera {number}")
        assert set(map(tuple, alone.scene.obstacles[-1].points)) <= set(map(tuple, found.points))


def test_layers_are_counted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many threads that insert layers and evict others."""
    layers = LayerCache(10_000)
    words = np.zeros(16, dtype=np.uint64)

    def fill(first: int) -> None:
        for number in range(2000):
            layers._keep(f"{first + number % 97}".encode(), words)

    at_once([lambda first=first: fill(first) for first in (0, 0, 50, 100)])
    assert layers._bytes == sum(len(key) + held.nbytes for key, held in layers._held.items()) <= 10_000
