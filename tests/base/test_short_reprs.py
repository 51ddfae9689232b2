"""What `repr` says of large objects: a line, whatever they hold."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

import hplan
from hplan.base.arrays import FloatArray, Record, readonly


@dataclass(frozen=True)
class Pair(Record):
    few: FloatArray
    many: FloatArray
    names: tuple[str, ...]
    nested: object


def test_a_record_shows_small_values_and_sizes_of_large_ones() -> None:
    inner = Pair(readonly([1.0]), readonly([2.0]), (), None)
    pair = Pair(readonly([0.5, np.pi]), readonly(np.zeros((40, 3))), ("x", "y"), inner)
    shown = "Pair(few=[0.5     , 3.141593], many=<float64 (40, 3)>, names=('x', 'y'), nested=Pair(...))"
    assert repr(pair) == shown
    assert repr(Pair(pair.few, pair.many, tuple("abcdefghij"), "x" * 300)).endswith("xx...)")
    assert "names=<10 items>" in repr(Pair(pair.few, pair.many, tuple("abcdefghij"), None))


def test_a_robot_is_its_name_and_joints(robot: hplan.Robot) -> None:
    assert repr(robot) == "<Robot 'harvester': 4 joints (base_yaw, shoulder, elbow, wrist), tool frame 'tool0'>"


def test_results_are_a_line(robot: hplan.Robot, scene: hplan.Scene) -> None:
    result = hplan.plan(robot, scene, hplan.PlanOptions(effort="quick"))
    assert re.fullmatch(r"<Trajectory: \S+ s, \d+ rows, joints base_yaw, .*>", repr(result.trajectory))
    assert len(repr(result)) < 1500
    assert len(repr(result.motion)) < 1500
