"""Durations compared with the fastest known motions of 200 problems.

The file `best_known.json` has the source of each problem, the best known duration and its planner. The straight motion
of each problem is in contact: discs in the plane of the default arm and of the orchard arm, pinches for both and for
randomly drawn arms, all with a locked base; and measured trees, one at a time, with all joints. A digest of robot and
scene verifies that the problem is unchanged. A motion counts only if hplan certifies it. The file also has durations of
RRTConnect's paths, of detours and of IPOPT on the whole timed motion; these are no longer run.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from studies.harness import Row, Study, StudyConfig, evenly_chosen
from studies.measure import planned
from studies.planar_problems import pinch, random_scene
from studies.trees import Orchard, measured_orchard

from hplan.certificate.digests import robot_digest
from hplan.errors import InputError
from hplan.planning.options import EFFORT_NAMES, PlanOptions
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Scene

#: The file that comes with the project.
BEST_KNOWN = Path(__file__).with_name("best_known.json")

#: Seed of the planar problems; decimals that go into a digest, as sines differ in the last bit from machine to machine.
SEED, _DECIMALS = 14, 9


class FastestProblem(NamedTuple):
    """A problem: its record, arm and scene."""

    record: dict[str, Any]
    robot: Robot
    scene: Scene


def group_of(record: dict[str, Any]) -> str:
    """The group of a problem in the summary."""
    return "trees" if record["kind"] == "tree" else "planar"


def problem_of(record: dict[str, Any], trees: Path | None) -> FastestProblem:
    """The problem of an entry of the set's file; planar problems need no folder of trees."""
    robot, scene = _made(record, trees)
    found, name = digest_of(robot, scene), record["name"]
    if found != record["digest"]:
        raise InputError(
            f"{name}: not the problem whose best duration is known; its generator, its arm or its tree is another now "
            f"(digest {found}, expected {record['digest']})",
            name=name,
            digest=found,
            expected=record["digest"],
        )
    return FastestProblem(record, robot, scene)


def _made(record: dict[str, Any], trees: Path | None) -> tuple[Robot, Scene]:
    if record["kind"] == "discs":
        robot = load_robot(record["arm"])
        return robot, random_scene(robot, SEED, record["number"]).scene
    if record["kind"] == "pinch":
        return pinch(SEED, record["number"], record["arm"], record["room_m"])
    if trees is None:
        raise InputError(f"{record['name']}: the folder of measured trees is not given", name=record["name"])
    orchard = _orchard(record["arm"], trees / f"{record['tree']}.csv", record["distance_m"])
    ends = np.array(record["start"]), np.array(record["goal"])
    return load_robot(record["arm"]), orchard.between(record["name"], *ends)


@cache
def _orchard(arm: str, file: Path, distance_m: float) -> Orchard:
    return measured_orchard(load_robot(arm), file, distance_m)


def digest_of(robot: Robot, scene: Scene) -> str:
    """A digest of robot, obstacles, start and goal: 16 hexadecimal digits."""
    content = _rounded(scene.model_dump(mode="json", exclude={"name"}))
    return hashlib.sha256(json.dumps([robot_digest(robot), content], sort_keys=True).encode()).hexdigest()[:16]


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, _DECIMALS) + 0.0
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return {key: _rounded(item) for key, item in value.items()} if isinstance(value, dict) else value


def read_records(path: Path = BEST_KNOWN) -> list[dict[str, Any]]:
    """The records of all problems in the file."""
    found: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["problems"]
    return found


def improve(rows: Iterable[Row]) -> int:
    """Write durations shorter than the best known; returns their number.

    Call it only on request: a run alone leaves the file unchanged.
    """
    records, improved = read_records(), 0
    best = {row["name"]: row for row in rows if row.get("improved")}
    for record in records:
        if record["name"] in best:
            row, improved = best[record["name"]], improved + 1
            record |= {"duration_s": round(row["best_s"], 9), "by": row["by"]}
    lines = ",\n".join(json.dumps(record) for record in records)
    BEST_KNOWN.write_text(f'{{"format": "hplan-best-known/1", "problems": [\n{lines}\n]}}\n', encoding="utf-8")
    return improved


def _problems(config: StudyConfig) -> Iterable[FastestProblem]:
    records = [record for record in read_records() if config.trees is not None or group_of(record) == "planar"]
    return [problem_of(record, config.trees) for record in evenly_chosen(records, config.count, group_of)]


def _row(_: StudyConfig, problem: FastestProblem) -> Row:
    """The motion with each effort, to the best known."""
    record, robot, scene = problem
    row: Row = {"name": record["name"], "group": group_of(record), "certified": True, "fault": False}
    found: dict[str, float | None] = {}
    planned(robot, scene, PlanOptions(effort="quick"))  # the first plan fills the caches of a scene
    for effort in EFFORT_NAMES:
        one = planned(robot, scene, PlanOptions(effort=effort))[1]
        found[effort] = one.get("duration_s") if one["certified"] else None
        row |= {f"{effort}_ms": one["ms"], f"{effort}_s": found[effort]}
        row["certified"] &= one["certified"]
        row["fault"] |= one.get("fault", False)
    # A duration is shorter than another only by more than this part of it.
    shorter = 1e-9
    known_s = record["duration_s"] * (1.0 - shorter)
    best_s, by = min((known_s, record["by"]), *((s, who) for who, s in found.items() if s is not None))
    improved = best_s < known_s
    best_s = best_s if improved else record["duration_s"]
    row |= {f"to_best_{who}": None if s is None else s / best_s for who, s in found.items()}
    return row | {"best_s": best_s, "by": by, "improved": improved}


FASTEST = Study(
    "fastest",
    "durations with each effort to the best known, whoever found it (--trees for those among trees)",
    _row,
    (
        *("certified", *(f"to_best_{effort}" for effort in EFFORT_NAMES), *(f"{effort}_ms" for effort in EFFORT_NAMES)),
        *("improved", "by"),
    ),
    problems=_problems,
    by="group",
    count=(None, 3),
    warm=3,
)
