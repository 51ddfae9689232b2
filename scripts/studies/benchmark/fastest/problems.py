"""The problems of the set, made from what its file says of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from studies.benchmark.fastest.records import DiscSource, PinchSource, Record, Source
from studies.benchmark.narrow.scenes import narrow_problem
from studies.benchmark.orchard_scenes import Orchard, measured_orchard
from studies.benchmark.scenes import random_scene

from hplan.errors import InputError
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Scene
from hplan.verification.digests import robot_digest

#: Seed of the planar problems.
SEED = 14

#: Decimals of the numbers that go into a digest: sines differ in the last bit from machine to machine.
_DECIMALS = 9


@dataclass(frozen=True)
class FastestProblem:
    """A problem of the set.

    Attributes:
        record: Its place in the set's file.
        robot: The arm.
        scene: Obstacles, start and goal.
    """

    record: Record
    robot: Robot
    scene: Scene


def problem_of(record: Record, trees: Path | None) -> FastestProblem:
    """The problem of a record.

    Args:
        record: What the set's file says.
        trees: Folder of measured trees; None will do for planar problems.

    Raises:
        InputError: It is not the problem that the best known duration is of, or its tree is not there.
    """
    robot, scene = made_from(record.source, record.name, trees)
    found = digest_of(robot, scene)
    if found != record.digest:
        raise InputError(
            f"{record.name}: not the problem whose best duration is known; its generator, its arm or its tree is "
            f"another now (digest {found}, expected {record.digest})",
            name=record.name,
            digest=found,
            expected=record.digest,
        )
    return FastestProblem(record, robot, scene)


def made_from(source: Source, name: str, trees: Path | None) -> tuple[Robot, Scene]:
    """Robot and scene.

    Raises:
        InputError: The tree is not there.
    """
    if isinstance(source, DiscSource):
        robot = load_robot(source.arm)
        return robot, random_scene(robot, SEED, source.number).scene
    if isinstance(source, PinchSource):
        pinch = narrow_problem(SEED, source.number, "pinch", source.arm, source.room_m)
        return pinch.robot, pinch.scene
    if trees is None:
        raise InputError(f"{name}: the folder of measured trees is not given", name=name)
    robot = load_robot(source.arm)
    orchard = _orchard(source.arm, trees / f"{source.tree}.csv", source.distance_m)
    return robot, orchard.problem(name, np.array(source.start), np.array(source.goal)).scene


@cache
def _orchard(arm: str, file: Path, distance_m: float) -> Orchard:
    return measured_orchard(load_robot(arm), file, distance_m)


def digest_of(robot: Robot, scene: Scene) -> str:
    """A digest of robot, obstacles, start and goal: 16 hexadecimal digits."""
    told = _rounded(scene.model_dump(mode="json", exclude={"name"}))
    text = json.dumps([robot_digest(robot), told], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _rounded(value: Any) -> Any:
    """The same with all numbers rounded."""
    if isinstance(value, float):
        return round(value, _DECIMALS) + 0.0
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return {key: _rounded(item) for key, item in value.items()} if isinstance(value, dict) else value


def problems_of(
    records: list[Record], trees: Path | None, progress: Callable[[int, int], None] = lambda *_: None
) -> list[FastestProblem]:
    """The problems of some records; those among measured trees only where there is a folder of them.

    Args:
        records: What the set's file says.
        trees: Folder of measured trees.
        progress: Told how many are done, and of how many.

    Raises:
        InputError: One is not the problem whose best duration is known.
    """
    kept = [record for record in records if trees is not None or record.group == "planar"]
    found = []
    for number, record in enumerate(kept):
        progress(number, len(kept))
        found.append(problem_of(record, trees))
    return found
