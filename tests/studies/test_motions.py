"""The judge of certified motions finds contacts, and only contacts.

It gets the files that are handed out.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import studies.validation.compliance as compliance
import studies.validation.grazing as grazing
import studies.validation.motions as motions
from script_loader import SCRIPTS
from studies.harness import Study, StudyConfig, plain, run, summary
from studies.validation.compliance import YIELDING
from studies.validation.grazing import GRAZING
from studies.validation.judge import PoseTrack, SampledMotion, Window, contacts, read_obstacles
from studies.validation.motions import MOTIONS, run_case
from studies.validation.random_arms import DrawnArm, named_arm
from studies.validation.random_worlds import World, shifted
from studies.validation.soak import SOAK

from hplan.planning.plan import plan

#: A corner of a cube by its place, and the cube's faces, counter-clockwise from outside.
CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
FACES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                  [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip

ITEMS: list[dict[str, Any]] = [
    {"kind": "sphere", "radius": 0.05},
    {"kind": "box", "size": (0.2, 0.1, 0.3), "rpy_deg": (10.0, 20.0, 30.0)},
    {"kind": "capsule", "radius": 0.02},
    {"kind": "cylinder", "radius": 0.05, "length": 0.3, "rpy_deg": (90.0, 0.0, 0.0)},
    {"kind": "mesh", "vertices": 0.1 * CORNERS, "faces": FACES, "rpy_deg": (0.0, 45.0, 0.0)},
    # A cube with a dent to its middle is not convex.
    {"kind": "mesh", "vertices": 0.1 * np.vstack([CORNERS, [[0.0, 0.0, 0.1]]]),
     "faces": np.vstack([FACES[:-2], [[1, 5, 8], [5, 7, 8], [7, 3, 8], [3, 1, 8]]])},
    {"kind": "points", "points": 0.02 * CORNERS, "radius": 0.02},
]  # fmt: skip


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few worlds, in which motions are found however long kernels take."""
    monkeypatch.setattr(motions, "WORLDS", 2)
    monkeypatch.setattr(motions, "time_limit_s", 60.0)
    for module in (motions, grazing):
        monkeypatch.setattr(module, "warm_up", lambda: None)


@pytest.fixture(scope="module")
def harvester() -> DrawnArm:
    return named_arm("orchard_harvester")


def placed(item: dict[str, Any], at: Any, **more: Any) -> dict[str, Any]:
    """An item somewhere."""
    at = np.asarray(at)
    if item["kind"] == "capsule":
        return {"name": "o", **item, "from": at, "to": at + 0.1, **more}
    return {"name": "o", **item, "position" if item["kind"] in ("mesh", "points") else "center": at, **more}


def line(drawn: DrawnArm, start: Any, end: Any, duration_s: float = 0.5) -> SampledMotion:
    """A straight motion."""
    times = np.arange(0.0, duration_s, 5e-4)
    return SampledMotion(drawn.arm.joints, times, np.linspace(start, end, len(times)))


def tool(drawn: DrawnArm, q: Any) -> Any:
    return drawn.robot.tool_positions(np.asarray(q))


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: item["kind"])
def test_contact_with_an_obstacle_is_found(harvester: DrawnArm, item: dict[str, Any]) -> None:
    motion = line(harvester, (0.0, 0.2, 0.3, 0.4), (1.0, 1.0, 0.9, 0.8))
    middle = tool(harvester, motion.values[len(motion.values) // 2])
    found = contacts(harvester.arm, motion, read_obstacles([placed(item, middle)]))
    assert found
    assert {contact.second for contact in found} == {"o"}
    assert all(contact.depth_m > 1e-3 and 0.15 < contact.time_s < 0.3 for contact in found)
    assert not contacts(harvester.arm, motion, read_obstacles([placed(item, middle + 3.0)]))


@pytest.mark.parametrize("of_base", [False, True])
def test_tracked_obstacle_is_where_its_track_puts_it(harvester: DrawnArm, of_base: bool) -> None:
    """It is at the tool from 2.5 s to 3 s on the clock of the tracks, and 2 m away until 2 s."""
    q = (0.0, 0.2, 0.3, 0.4)
    turn = {"rpy_deg": ((0.0, 0.0, 0.0), (0.0, 0.0, 40.0), (0.0, 0.0, 40.0)), "about": (0.0, 0.0, 0.0)}
    track = {"times_s": (2.0, 2.5, 3.0), "shifts_m": ((0.0, 0.0, 0.0), (1.0, -2.0, 0.0), (1.0, -2.0, 0.0)), **turn}
    there = PoseTrack(track).at(np.array([2.5]))[0]
    if of_base:
        item, base = placed(ITEMS[0], there[:3, :3] @ tool(harvester, q) + there[:3, 3]), PoseTrack(track)
    else:
        item, base = placed(ITEMS[0], there[:3, :3].T @ (tool(harvester, q) - there[:3, 3]), track=track), None
    still = line(harvester, q, q)
    assert not contacts(harvester.arm, still, read_obstacles([item]), base=base, start_time_s=1.4)
    first = min(
        contact.time_s
        for contact in contacts(harvester.arm, still, read_obstacles([item]), base=base, start_time_s=2.1)
    )
    assert 0.3 < first < 0.4


def test_fruit_may_be_touched_in_its_window_by_the_last_link_alone(harvester: DrawnArm) -> None:
    motion = line(harvester, (0.0, 0.2, 0.3, 0.4), (0.0, 0.3, 0.4, 0.5))
    fruit = read_obstacles([placed(ITEMS[0], tool(harvester, motion.values[-1]))])
    first = min(contact.time_s for contact in contacts(harvester.arm, motion, fruit))
    assert not contacts(harvester.arm, motion, fruit, windows=[Window("o", first, 1.0)])
    assert contacts(harvester.arm, motion, fruit, windows=[Window("o", first + 1e-3, 1.0)])
    assert contacts(harvester.arm, motion, fruit, windows=[Window("another", first, 1.0)])
    elbow = harvester.arm.places(harvester.arm.configurations(motion.names, motion.values[-1:])[0])
    k = next(k for k, body in enumerate(harvester.arm.bodies) if body.joint == harvester.arm.last_joint - 1)
    on_link = read_obstacles([placed(ITEMS[0], elbow[k].act(harvester.arm.bodies[k].middle))])
    assert contacts(harvester.arm, motion, on_link, windows=[Window("o", 0.0, 1.0)])


def test_obstacle_hidden_from_hplan_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The planner gets all obstacles at a distance of 5 m."""
    whole = World.scene

    def elsewhere(world: World) -> Any:
        return whole(replace(world, items=tuple(shifted(item, np.full(3, 5.0)) for item in world.items)))

    monkeypatch.setattr(World, "scene", elsewhere)
    tally = run_case(0, CASE)
    assert any(fault["kind"] == "plan" and fault["depth_m"] > 1e-3 for fault in tally.faults)


@pytest.mark.parametrize("verified", [None, True, False])
def test_wrong_certificate_is_counted(monkeypatch: pytest.MonkeyPatch, verified: bool | None) -> None:
    if verified is not None:
        monkeypatch.setattr(
            grazing, "certify", lambda *_, **__: SimpleNamespace(verified=verified, min_clearance_m=0.0)
        )
    tallies = [grazing.graze(0, number) for number in range(4)]
    checked = sum((tally.checked for tally in tallies), Counter())
    assert min(checked["grazing"], checked["clear"]) > 0
    wrong = {None: 0, True: checked["grazing"], False: checked["clear"]}
    assert sum(len(tally.faults) for tally in tallies) == wrong[verified]


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_excessive_deflection_is_found(monkeypatch: pytest.MonkeyPatch, times: float) -> None:
    """The planner gets twice the compliance; case 5 deflects a fruit's support."""

    def planned(robot: Any, scene: Any, options: Any) -> Any:
        more = {
            key: tuple(item.model_copy(update={"yields": times * item.yields}) for item in getattr(scene, key))
            for key in ("obstacles", "fruits")
        }
        return plan(robot, scene.model_copy(update=more), options)

    monkeypatch.setattr(compliance, "plan", planned)
    tally = compliance.check_deflections(0, 5, sorted((SCRIPTS / "examples" / "trees").glob("*.csv")))
    assert bool(tally.faults) == (times > 1.0)
    assert min(tally.checked_in.values()) > 0
    assert {"deflections", "grazing", "deflections of supports"} == set(tally.checked_in)


@pytest.mark.parametrize("study", [MOTIONS, GRAZING, YIELDING, SOAK], ids=lambda study: study.name)
def test_studies(study: Study) -> None:
    rows = list(run(study, StudyConfig(count=1, first=CASE, values={"minutes": (0.02,)})))
    assert [row["fault"] for row in rows] == [False]
    assert json.loads(json.dumps(plain(rows)))
    assert re.search(r"motions: \d+\. .* At fault: none\.$", summary(study, rows)[-2])


#: A case with motions in most of its worlds.
CASE = 8
