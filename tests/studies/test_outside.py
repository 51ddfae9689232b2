"""Contacts of motions by the studies' judge: all obstacles, fruit, moving obstacles."""

from __future__ import annotations

import numpy as np
import pytest
from planned import fruit, task
from studies.outside import TimedMotion, contacts, findings, path_is_clear

from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene
from hplan.scene.obstacles import Box, Capsule, Cylinder, Mesh, PointCloud, Sphere
from hplan.scene.tracks import Track

BLOCK = Box(name="block", center=(0.0, 0.0, 0.0), size=(0.1, 0.1, 0.1)).surface
STILL = TimedMotion(1.0, lambda clock: np.zeros((len(clock), 4)) + 0.5)


def scene_with(robot: Robot, kind: str, off_m: float) -> Scene:
    """An obstacle in the tool of the arm at rest, or at a distance above it."""
    at = robot.tool_positions(np.full((1, 4), 0.5))[0] + [0.0, 0.0, off_m]
    where, empty = tuple(at.tolist()), task((0.0, 0.0, 0.0, 0.0), Goal(joints_deg=(0.0, 1.0, 1.0, 1.0)), [])
    listed, shifts = tuple((at + np.array([9.0, 0.0, 0.0])).tolist()), ((0.0,) * 3, (-9.0, 0.0, 0.0), (0.0,) * 3)
    made = {
        "sphere": lambda: Sphere(name="it", center=where, radius=0.05),
        "box": lambda: Box(name="it", center=where, size=(0.1, 0.1, 0.1), rpy_deg=(10.0, 20.0, 30.0)),
        "cylinder": lambda: Cylinder(name="it", center=where, radius=0.05, length=0.1),
        "capsule": lambda: Capsule(name="it", start=where, end=tuple((at + 0.03).tolist()), radius=0.05),
        "cloud": lambda: PointCloud.from_points("it", 0.01 * np.eye(3), radius=0.02, position=where),
        "mesh": lambda: Mesh.from_arrays("it", *BLOCK, position=where, rpy_deg=(10.0, 20.0, 30.0)),
        "track": lambda: Sphere(
            name="it", center=listed, radius=0.05, track=Track(times_s=(0.0, 0.5, 1.0), shifts_m=shifts)
        ),
    }
    if kind == "fruit":
        apple = fruit("apple", 0.0, 1.0, 1.0, 0.05).model_copy(update={"center": where})
        return empty.model_copy(update={"fruits": (apple,)})
    return empty.with_obstacles([made[kind]()])


@pytest.mark.parametrize("kind", ["sphere", "box", "cylinder", "capsule", "cloud", "mesh", "track", "fruit"])
def test_contact_is_found_where_it_is(robot: Robot, kind: str) -> None:
    assert contacts(robot, scene_with(robot, kind, 0.0), STILL)[0] > 0
    assert contacts(robot, scene_with(robot, kind, 0.5), STILL) == (0, 0)


def test_paths_and_findings(robot: Robot) -> None:
    path = np.linspace(np.full(4, 0.3), np.full(4, 0.7), 50)
    assert path_is_clear(robot, scene_with(robot, "sphere", 0.6), path)
    assert not path_is_clear(robot, scene_with(robot, "sphere", 0.0), path)
    swing = TimedMotion(2.0, lambda clock: np.column_stack([0.5 * np.sin(clock), *[0.0 * clock + 0.5] * 3]))
    found = findings(robot, scene_with(robot, "sphere", 0.0), swing)
    assert found["contacts"] > 0 < found["depth_mm"]
    assert found["velocity"] == pytest.approx(0.5 / robot.velocity_limit[0], rel=1e-3)
