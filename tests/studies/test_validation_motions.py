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
import studies.validation.episodes as episodes
import studies.validation.grazing as grazing
import studies.validation.workcells as workcells
import studies.validation.yielding as yielding
from script_loader import SCRIPTS
from studies.harness import Asked, Study, plain, run, summary
from studies.validation.arms import DrawnArm, named_arm
from studies.validation.episodes import MOTIONS, run_case, shifted
from studies.validation.grazing import GRAZING
from studies.validation.judge import Motion, Moves, Window, contacts, things_of
from studies.validation.soak import SOAK
from studies.validation.worlds import World
from studies.validation.yielding import YIELDING

from hplan.planning.cell import Cell, CellCertificate
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
    monkeypatch.setattr(episodes, "WORLDS", 2)
    monkeypatch.setattr(episodes, "patience_s", 60.0)
    for module in (episodes, grazing):
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


def line(drawn: DrawnArm, start: Any, end: Any, duration_s: float = 0.5) -> Motion:
    """A straight motion."""
    times = np.arange(0.0, duration_s, 5e-4)
    return Motion(drawn.arm.joints, times, np.linspace(start, end, len(times)))


def tool(drawn: DrawnArm, q: Any) -> Any:
    return drawn.robot.tool_positions(np.asarray(q))


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: item["kind"])
def test_contact_with_an_obstacle_is_found(harvester: DrawnArm, item: dict[str, Any]) -> None:
    motion = line(harvester, (0.0, 0.2, 0.3, 0.4), (1.0, 1.0, 0.9, 0.8))
    middle = tool(harvester, motion.values[len(motion.values) // 2])
    found = contacts(harvester.arm, motion, things_of([placed(item, middle)]))
    assert found
    assert {contact.second for contact in found} == {"o"}
    assert all(contact.depth_m > 1e-3 and 0.15 < contact.time_s < 0.3 for contact in found)
    assert not contacts(harvester.arm, motion, things_of([placed(item, middle + 3.0)]))


@pytest.mark.parametrize("of_base", [False, True])
def test_what_moves_is_where_its_track_has_it(harvester: DrawnArm, of_base: bool) -> None:
    """It is at the tool from 2.5 s to 3 s on the clock of the tracks, and 2 m away until 2 s."""
    q = (0.0, 0.2, 0.3, 0.4)
    turn = {"rpy_deg": ((0.0, 0.0, 0.0), (0.0, 0.0, 40.0), (0.0, 0.0, 40.0)), "about": (0.0, 0.0, 0.0)}
    track = {"times_s": (2.0, 2.5, 3.0), "shifts_m": ((0.0, 0.0, 0.0), (1.0, -2.0, 0.0), (1.0, -2.0, 0.0)), **turn}
    there = Moves(track).at(np.array([2.5]))[0]
    if of_base:
        item, base = placed(ITEMS[0], there[:3, :3] @ tool(harvester, q) + there[:3, 3]), Moves(track)
    else:
        item, base = placed(ITEMS[0], there[:3, :3].T @ (tool(harvester, q) - there[:3, 3]), track=track), None
    still = line(harvester, q, q)
    assert not contacts(harvester.arm, still, things_of([item]), base=base, begin_s=1.4)
    first = min(contact.time_s for contact in contacts(harvester.arm, still, things_of([item]), base=base, begin_s=2.1))
    assert 0.3 < first < 0.4


def test_fruit_may_be_touched_in_its_window_by_the_last_link_alone(harvester: DrawnArm) -> None:
    motion = line(harvester, (0.0, 0.2, 0.3, 0.4), (0.0, 0.3, 0.4, 0.5))
    fruit = things_of([placed(ITEMS[0], tool(harvester, motion.values[-1]))])
    first = min(contact.time_s for contact in contacts(harvester.arm, motion, fruit))
    assert not contacts(harvester.arm, motion, fruit, windows=[Window("o", first, 1.0)])
    assert contacts(harvester.arm, motion, fruit, windows=[Window("o", first + 1e-3, 1.0)])
    assert contacts(harvester.arm, motion, fruit, windows=[Window("another", first, 1.0)])
    elbow = harvester.arm.places(harvester.arm.configurations(motion.names, motion.values[-1:])[0])
    k = next(k for k, body in enumerate(harvester.arm.bodies) if body.joint == harvester.arm.last_joint - 1)
    on_link = things_of([placed(ITEMS[0], elbow[k].act(harvester.arm.bodies[k].middle))])
    assert contacts(harvester.arm, motion, on_link, windows=[Window("o", 0.0, 1.0)])


def test_what_hplan_is_not_told_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The planner gets all obstacles at a distance of 5 m."""
    whole = World.scene

    def elsewhere(world: World) -> Any:
        return whole(replace(world, items=tuple(shifted(item, np.full(3, 5.0)) for item in world.items)))

    monkeypatch.setattr(World, "scene", elsewhere)
    tally = run_case(0, CASE)
    assert any(fault["kind"] == "plan" and fault["depth_m"] > 1e-3 for fault in tally.faults)


@pytest.mark.parametrize("verified", [None, True, False])
def test_a_wrong_certificate_is_counted(monkeypatch: pytest.MonkeyPatch, verified: bool | None) -> None:
    if verified is not None:
        monkeypatch.setattr(grazing, "certify", lambda *_: SimpleNamespace(verified=verified))
    tallies = [grazing.graze(0, number) for number in range(4)]
    looked = sum((tally.looked for tally in tallies), Counter())
    assert min(looked["grazing"], looked["clear"]) > 0
    wrong = {None: 0, True: looked["grazing"], False: looked["clear"]}
    assert sum(len(tally.faults) for tally in tallies) == wrong[verified]


@pytest.mark.parametrize("wrong", [False, True])
def test_a_wrong_certificate_of_a_workcell_is_found(monkeypatch: pytest.MonkeyPatch, wrong: bool) -> None:
    """Two harvesters next to each other: every file is certified for bases far from each other."""
    monkeypatch.setattr(workcells, "draw_arm", lambda *_: named_arm("orchard_harvester"))
    monkeypatch.setattr(workcells, "named_arm", lambda _: named_arm("orchard_harvester"))
    few = {"KINDS": 1, "MOTIONS": 2, "PLACES": 3, "SETS": 2, "ARMS": (2, 2), "OWN": 0.0, "TAMPERED": 0.0}
    for name, value in few.items():
        monkeypatch.setattr(workcells, name, value)
    if wrong:
        certified = workcells.certify_cell

        def elsewhere(cell: Cell, *files: object, **options: object) -> CellCertificate:
            arms = [arm.model_copy(update={"position": (9.0 * k, 0.0, 0.0)}) for k, arm in enumerate(cell.scene.robots)]
            scene = cell.scene.model_copy(update={"robots": tuple(arms), "obstacles": ()})
            robots = {arm.name: named_arm("orchard_harvester").robot for arm in arms}
            return certified(Cell.of(scene, robots), *files, **options)

        monkeypatch.setattr(workcells, "certify_cell", elsewhere)
    tallies = [workcells.judged_cells(0, number) for number in range(2)]
    near = sum(fault["kind"].startswith("nearer") for tally in tallies for fault in tally.faults)
    assert sum(tally.looked.total() for tally in tallies) > 2
    assert (near > 0) == wrong
    assert wrong or not any(tally.faults for tally in tallies)


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_what_is_pushed_too_deep_is_found(monkeypatch: pytest.MonkeyPatch, times: float) -> None:
    """The planner gets twice the compliance; case 5 deflects a fruit's support."""

    def planned(robot: Any, scene: Any, options: Any) -> Any:
        more = {
            key: tuple(item.model_copy(update={"yields": times * item.yields}) for item in getattr(scene, key))
            for key in ("obstacles", "fruits")
        }
        return plan(robot, scene.model_copy(update=more), options)

    monkeypatch.setattr(yielding, "plan", planned)
    tally = yielding.among_yielding(0, 5, sorted((SCRIPTS / "examples" / "trees").glob("*.csv")))
    assert bool(tally.faults) == (times > 1.0)
    assert min(tally.looked_in.values()) > 0
    assert {"pushes", "grazing", "pushes of what the fruit hangs from"} == set(tally.looked_in)


@pytest.mark.parametrize("study", [MOTIONS, GRAZING, YIELDING, SOAK], ids=lambda study: study.name)
def test_studies(study: Study) -> None:
    rows = list(run(study, Asked(count=1, first=CASE, values={"minutes": (0.02,)})))
    assert [row["fault"] for row in rows] == [False]
    assert json.loads(json.dumps(plain(rows)))
    assert re.search(r"motions: \d+\. .* At fault: none\.$", summary(study, rows)[-2])


#: A case with motions in most of its worlds.
CASE = 8
