"""Contacts within segments of random motions, beside coal's distances of all pairs at all samples."""

from __future__ import annotations

from collections import defaultdict
from functools import cache

import numpy as np
import pytest

import hplan
from hplan.base.arrays import FloatArray
from hplan.certificate.clearance_proof import Advancement, point_at
from hplan.certificate.pushes import pushes_along
from hplan.collision.coal_scene import CoalScene
from hplan.scene import load_scene, with_limbs


@cache
def checker() -> CoalScene:
    scene = with_limbs(load_scene("dense-canopy"))
    return CoalScene(hplan.load_robot("harvester"), scene.solids)


def random_bezier(seed: int, rows: int = 40) -> FloatArray:
    """Cubics through a smooth random motion among the limbs, (rows, 4, dof)."""
    random, robot = np.random.default_rng(seed), hplan.load_robot("harvester")
    ends = random.uniform([-0.6, -0.1, 0.2, -0.8], [0.6, 0.7, 1.0, 0.8], (2, robot.dof))
    s = np.linspace(0.0, 1.0, 3 * rows + 1)[:, None]
    points = ends[0] + s * (ends[1] - ends[0]) + 0.1 * np.sin(3.0 * s * random.normal(size=robot.dof))
    return np.stack([points[3 * row : 3 * row + 4] for row in range(rows)])


@pytest.mark.parametrize("deviation", [0.0, 0.002])
@pytest.mark.parametrize("seed", range(6))
def test_contacts_are_those_of_all_distances(seed: int, deviation: float) -> None:
    scene, bezier = checker(), random_bezier(seed)
    rows, deviations = len(bezier), np.full((1, bezier.shape[2]), deviation)
    time = np.linspace(0.0, 1.0, rows + 1)
    search, pairs = Advancement(bezier, scene, deviations, 0.0), scene.compliant_pairs
    (sway, travel), movers = search.movers, search.mover_of[pairs]
    distances = np.empty((rows + 1, len(pairs)))
    for row in range(rows + 1):
        scene.place(point_at(bezier, float(row)))
        distances[row] = scene.distances_of(pairs) - scene.distance_errors[pairs]
    travelled = np.diff(travel[movers]).T
    nearer = np.broadcast_to(sway, travel.shape)[movers].T
    depths = np.maximum(nearer[1:], nearer[:-1]) - 0.5 * (distances[:-1] + distances[1:] - travelled)
    expected, found = (
        defaultdict[tuple[str, str, int], list[float]](list),
        defaultdict[tuple[str, str, int], list[float]](list),
    )
    for row, number in zip(*np.nonzero(depths > 1e-9), strict=True):  # a distance that excludes a contact may say 0
        mover, other = scene.pairs[int(pairs[number])]
        expected[scene.mover_names[mover], scene.obstacle_names[other], int(row)].append(float(depths[row, number]))
    contacts = pushes_along(bezier, time, scene, deviations, 0.0, None, proved=False)
    for number, push in enumerate(contacts.rows):
        if push["depth"] > 1e-9:
            key = contacts.link(number), contacts.obstacle(number), int(np.searchsorted(time, push["begin_s"]))
            found[key].append(float(push["depth"]))
    assert found.keys() == expected.keys()
    assert found
    for key, known in expected.items():
        assert sorted(found[key]) == pytest.approx(sorted(known), abs=1e-12)
