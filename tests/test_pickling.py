"""Errors and results in pickles, copies and other processes stay usable."""

from __future__ import annotations

import concurrent.futures
import copy
import dataclasses
import multiprocessing
import pickle
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from planned import fruit, task

import hplan
from hplan import errors
from hplan.collision.coal_scene import CoalScene
from hplan.errors import HplanError
from hplan.geometry.cloud import Cloud
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene
from hplan.scene.obstacles import Mesh, PointCloud

SAMPLES = [
    HplanError("what", fact=1),
    errors.InputError("what"),
    errors.RobotFileError("robot.urdf", "why"),
    errors.RobotFamilyError("robot", "elbow", "why"),
    errors.SceneError("why", path="scene.yaml", where="obstacles[0].radius", line=3, value=-1.0),
    errors.StudyError("why", path="study.yaml", where="arms[0].robot", line=3, value="ur7"),
    errors.WorkersLostError([3, 7], 20),
    errors.MovingObstacleError("crate"),
    errors.ObstacleInTimeError("crate", 1.5, ["the straight motion"]),
    errors.JointLimitError("start", "elbow", 2.0, 0.0, 1.0),
    errors.TiltedError("goal", 0.2, 0.1),
    errors.FrameError("camera", "it has no points", given=0),
    errors.ConfigurationInCollisionError("start", "forearm", "post", 0.1, 0.01),
    errors.PathInContactError(
        "in contact",
        [
            {
                "waypoint": None,
                "segment": 2,
                "fraction": 0.4,
                "link": "hand",
                "obstacle": "post",
                "depth_m": 0.01,
                "clearance_m": 0.0,
            }
        ],
    ),
    errors.OptionError("speed", 2.0, "at most 1"),
    errors.OutputError("out/motion.csv", "why"),
    errors.NotFoundError(["straight motion", "trees"], goals=2),
    errors.NotInTimeError(0.05, 0.0503, ["grasps for 8.1 ms", "trees for 42 ms"]),
    errors.PlanCancelledError(0.031),
    errors.BoundError("what", duration_s=1.0, joint="elbow"),
    errors.NoPathError("what", reached_cells=7, blockers=[{"obstacle": "post", "cells": 3}]),
    errors.UnreachableError((1.0, 2.0, 3.0), "too_far", "why", excess_m=1.0),
    errors.ApproachError(0.1, "joint_limit", "why", largest_standoff_m=0.05, joint="elbow"),
    errors.BlockedError("the fruit", 2, [{"obstacle": "post", "link": "forearm", "configurations": 2}]),
    errors.TourError([("apple", errors.UnreachableError((1.0, 2.0, 3.0), "too_far", "why"))]),
    errors.TimingError("what", joint="elbow", cause="why"),
    errors.CertificationError("what", distance_m=0.1),
    errors.StartStateError("elbow", "velocity", 9.0, 1.5, "rad/s"),
    errors.NotOnMotionError("elbow", 0.68, 1e-3, 12.5),
    errors.UnavoidableContactError(["why"], 8, -0.01, [1.0]),
    errors.DetourError(7.25, 3.0),
    errors.RunningMotionBlockedError(["why"], [1.0], None),
]


def by_pickle(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


WAYS: list[Callable[[Any], Any]] = [by_pickle, copy.copy, copy.deepcopy]


@pytest.fixture(params=WAYS, ids=["pickle", "copy", "deepcopy"])
def travelled(request: pytest.FixtureRequest) -> Callable[[Any], Any]:
    return request.param  # type: ignore[no-any-return]


def facts(error: HplanError) -> dict[str, str]:
    return {name: repr(value) for name, value in vars(error).items()}


@pytest.mark.parametrize("error", SAMPLES, ids=lambda error: error.kind)
def test_error_arrives_unchanged(error: HplanError, travelled: Callable[[Any], Any]) -> None:
    error.add_note("seen to")
    found = travelled(error)
    assert type(found) is type(error)
    assert (str(found), found.args, found.data, found.as_dict()) == (
        str(error), error.args, error.data, error.as_dict(),
    )  # fmt: skip
    assert facts(found) == facts(error)
    assert "seen to" in found.__notes__
    with pytest.raises(type(error)) as caught:
        raise found from ValueError("cause")
    assert isinstance(caught.value.__cause__, ValueError)
    assert error.__cause__ is None


def test_every_error_class_is_among_the_samples() -> None:
    kinds = {kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, HplanError)}
    assert kinds == {type(error) for error in SAMPLES}


def test_unpicklable_values_become_text() -> None:
    error = errors.OptionError("speed", lambda: 1.0, "a number")
    found = by_pickle(error)
    assert found.message == error.message
    assert "lambda" in found.value


def bad_option(_: int) -> None:
    hplan.PlanOptions(speed=2.0)


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_worker_process_hands_its_error_over(method: str) -> None:
    pool = concurrent.futures.ProcessPoolExecutor(1, mp_context=multiprocessing.get_context(method))
    with pool, pytest.raises(errors.OptionError, match="speed") as caught:
        pool.submit(bad_option, 1).result(timeout=100)
    assert caught.value.value == 2.0


def duration_of(scene: Scene) -> hplan.PlanResult:
    return hplan.plan(hplan.load_robot(), scene)


def test_worker_process_hands_its_plan_over(robot: Robot, scene: Scene) -> None:
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        found = pool.submit(duration_of, scene).result(timeout=300)
    np.testing.assert_array_equal(found.trajectory.position, hplan.plan(robot, scene).trajectory.position)
    assert hplan.certify(robot, scene, found.trajectory).verified


def arrays(value: Any, found: Any, path: str, seen: set[int]) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Every array of two objects that should be alike, with the way to it."""
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        yield path, value, found
    elif isinstance(value, Mapping):
        for key in value:
            yield from arrays(value[key], found[key], f"{path}[{key!r}]", seen)
    elif isinstance(value, (list, tuple)):
        for number, (mine, other) in enumerate(zip(value, found, strict=True)):
            yield from arrays(mine, other, f"{path}[{number}]", seen)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            each = getattr(value, field.name), getattr(found, field.name)
            yield from arrays(*each, f"{path}.{field.name}", seen)


def assert_alike(value: Any, found: Any) -> None:
    """Equal arrays throughout; read-only ones stay read-only."""
    compared = list(arrays(value, found, type(value).__name__, set()))
    assert compared
    for path, mine, other in compared:
        np.testing.assert_array_equal(other, mine, err_msg=path)
        assert other.flags.writeable == mine.flags.writeable, path


@pytest.fixture(scope="module")
def locked(robot: Robot, scene: Scene) -> hplan.PlanResult:
    return hplan.plan(robot, scene)


def test_plan_arrives_and_can_be_certified(robot: Robot, scene: Scene, locked: hplan.PlanResult) -> None:
    found = by_pickle(locked)
    assert_alike(locked, found)
    assert found.certificate == locked.certificate
    assert found.report == locked.report
    assert found.picked_fruit == locked.picked_fruit
    again = hplan.certify(found.motion.problem.robot, found.motion.problem.scene, found.trajectory)
    assert again == hplan.certify(robot, scene, locked.trajectory)
    checker = found.motion.problem.world.checker
    q = found.trajectory.position[10]
    np.testing.assert_array_equal(checker.distances(q), locked.motion.problem.world.checker.distances(q))


def test_tour_arrives(robot: Robot) -> None:
    fruits = (fruit("a", 20.0, 1.5, 1.5), fruit("b", -20.0, 1.5, 1.6))
    result = hplan.plan_tour(robot, task((0.0, 60.0, 40.0, 30.0), Goal(fruit="a"), fruits=fruits))
    found = by_pickle(result)
    assert_alike(result, found)
    assert (found.order, found.picked, found.report) == (result.order, result.picked, result.report)
    with pytest.raises(TypeError):
        found.picked["a"] = 1.0


def test_robot_arrives_and_plans(
    robot: Robot, scene: Scene, locked: hplan.PlanResult, travelled: Callable[[Any], Any]
) -> None:
    found = travelled(robot)
    assert_alike(robot, found)
    result = hplan.plan(found, scene)
    np.testing.assert_array_equal(result.trajectory.position, locked.trajectory.position)
    np.testing.assert_array_equal(result.trajectory.torque, locked.trajectory.torque)


def test_scene_with_mesh_and_points_arrives(robot: Robot, travelled: Callable[[Any], Any]) -> None:
    corners = np.array([(x, y, z) for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
             (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    obstacles = (
        Mesh.from_arrays("crate", corners, faces, position=(1.0, 0.3, 0.5)),
        PointCloud.from_points("leaves", corners, 0.01, position=(1.0, -0.4, 0.5)),
    )
    scene = task((0.0, 60.0, 40.0, 30.0), (30.0, 30.0, 30.0, 30.0), obstacles)
    found = travelled(scene)
    assert found == scene
    q = scene.start.configuration
    checker = CoalScene(robot, scene.solids)
    distances = checker.distances(q)
    np.testing.assert_array_equal(CoalScene(robot, found.solids).distances(q), distances)
    np.testing.assert_array_equal(travelled(checker).distances(q), distances)
    cloud = found.solids[-1]
    assert isinstance(cloud, Cloud)
    assert not by_pickle(cloud).core.flags.writeable


def test_planner_arrives_and_goes_on(robot: Robot, scene: Scene) -> None:
    planner = hplan.Planner(robot, scene)
    planner.plan()
    found = by_pickle(planner)
    assert found.scene == planner.scene
    found.move("ball", center=(1.0, 0.0, 1.95))
    planner.move("ball", center=(1.0, 0.0, 1.95))
    np.testing.assert_array_equal(found.replan().trajectory.position, planner.replan().trajectory.position)
