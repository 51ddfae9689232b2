"""Motions and scenes for pages, and the commands of a page."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.trajectory.trajectory import Trajectory

needs_chromium = pytest.mark.skipif(shutil.which("chromium") is None, reason="headless chromium is not installed")


def steady_motion(robot: Robot, goal: Sequence[float], duration: float = 2.0, rows: int = 501) -> Trajectory:
    """From zero to a configuration at one speed."""
    time = np.linspace(0.0, duration, rows)
    position = (time / duration)[:, None] * np.asarray(goal)
    nothing = np.zeros_like(position)
    return Trajectory(robot.joint_names, time, position, nothing, nothing, nothing)


def orchard(**changes: Any) -> Scene:
    """A ripe fruit to pick and a green one."""
    ripe = Fruit(name="ripe", center=(1.2, 0.3, 1.4), radius=0.04)
    green = Fruit(name="green", center=(1.3, 0.2, 1.1), radius=0.04)
    content: dict[str, Any] = {"name": "orchard", "fruits": (ripe, green), **changes}
    return Scene(**{"start": Start(joints_deg=(0.0,) * 4), "goal": Goal(fruit="ripe"), **content})


def commands_of(page: str) -> list[dict[str, Any]]:
    """The draw commands that a page sends to its viewer."""
    found = re.search(r'<script type="application/json" id="commands">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    commands: list[dict[str, Any]] = json.loads(found.group(1))
    return commands


def objects(commands: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Objects by their paths."""
    return {c["path"]: c["object"] for c in commands if c["type"] == "set_object"}


def animation_of(commands: list[dict[str, Any]]) -> dict[str, Any]:
    """The animation."""
    (animation,) = [c for c in commands if c["type"] == "set_animation"]
    return animation
