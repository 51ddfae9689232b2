"""The C-space against coal on random scenes of every kind; faults are detected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import studies.validation.cspace as cspace
import studies.validation.random_worlds as random_worlds
from arm_variants import load_variant
from studies.validation.cspace import (
    CLOUD_TOLERANCE,
    CONTACT_TOLERANCE,
    EXAMPLES,
    KINDS,
    MOST_LOST,
    CoalWithShapes,
    kind_row,
    random_scene,
)

from hplan.collision.compiled_field import ClearanceField
from hplan.planar.family_reader import family_of
from hplan.planar.grid.grid import Grid, Occupancy
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.grid.prepared_obstacles import prepare_obstacles
from hplan.planar.grid.sections import sections_at
from hplan.robot.model import Robot

#: A bucket, a ring and a notched plate that are cut in a moment.
_QUICK_SHAPES = (3, 4, 5)


@pytest.fixture(autouse=True)
def quick_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    stock = random_worlds.stock
    monkeypatch.setattr(random_worlds, "stock", lambda number: stock(_QUICK_SHAPES[number % 3]))


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_missed_and_little_lost(robot: Robot, kind: str) -> None:
    configurations = 512 if kind == "points" else 2_000  # coal takes its time over clouds
    row = kind_row(robot, kind, 4, configurations, seed=1)
    assert not row["fault"]
    assert (row["name"], row["configurations"]) == (kind, 4 * configurations)
    assert row["missed"] == row["differing"] == 0
    assert row["examples"] == []
    assert min(row["colliding"], row["spare"]) > 0
    assert row["lost_share"] <= MOST_LOST
    assert row["widest_mm"] < 1e3 * cspace.SPARE


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_in_contact_is_free(robot: Robot, kind: str) -> None:
    """At first contact, found by bisection, the intervals forbid and the distance is nearly 0."""
    tolerance = CLOUD_TOLERANCE if kind == "points" else CONTACT_TOLERANCE
    looked_at = 0
    for number in range(3):
        scene, sector = random_scene(robot, kind, number)
        rng = np.random.default_rng(number)
        checker = CoalWithShapes(robot, scene)
        bodies = prepare_obstacles(scene.solids, clearance=scene.clearance)
        field = ClearanceField.build(robot, scene.solids, clearance=scene.clearance)
        count = 60 if kind == "points" else 300
        ends = rng.uniform(robot.lower, robot.upper, (2, count, robot.dof))
        ends[:, :, 0] = rng.uniform(*sector, count)
        hit = np.array([checker.collides(q, -tolerance) for q in ends])
        free = np.where(hit[0, :, None], ends[1], ends[0])[hit[0] != hit[1]]
        touching = np.where(hit[0, :, None], ends[0], ends[1])[hit[0] != hit[1]]
        for _ in range(34):
            middle = 0.5 * (free + touching)
            inside = checker.collides(middle, -tolerance)[:, None]
            free, touching = np.where(inside, free, middle), np.where(inside, middle, touching)
        looked_at += len(touching)
        for q in touching:
            node = Grid(q[1:], np.ones(robot.dof - 1), (1,) * (robot.dof - 1))
            sections = sections_at(robot, bodies, float(q[0]))
            assert occupancy(family_of(robot).arm, sections, node).occupied_count == 1, (number, q)
            # Hulls protrude from a mesh and balls from points; elsewhere the difference is coal's accuracy.
            assert -5e-6 - 2e-3 * (kind in ("mesh", "points")) <= field.spare_clearance(q) <= 1e-11
    assert looked_at > 20


@pytest.mark.parametrize(
    "variant",
    [
        *("shoulder aside and behind, arm turned", "one link on a yaw", "tilted plane"),
        *("plane off the yaw axis", "links next to each other, off the axis"),
    ],
)
def test_other_arms(variant: str, tmp_path: Path) -> None:
    robot = load_variant(variant, tmp_path)
    for kind in ("box", "fruits"):
        row = kind_row(robot, kind, 6, 1_000)
        assert not row["fault"]
        assert row["colliding"] > 0


def test_blind_cspace_is_caught(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    def blind(_arm: object, _sections: object, grid: Grid) -> Occupancy:
        return Occupancy.from_mask(grid, np.zeros(grid.shape, dtype=bool))

    monkeypatch.setattr(cspace, "occupancy", blind)
    row = kind_row(robot, "sphere", 2, 3_000)
    assert row["fault"]
    assert row["missed"] == row["colliding"] > EXAMPLES
    assert row["differing"] == row["lost"] == 0
    assert len(row["examples"]) == EXAMPLES
    assert {example["side"] for example in row["examples"]} == {"intervals"}
    assert all(example["distance_m"] < 0.0 and len(example["joints_rad"]) == 4 for example in row["examples"])
