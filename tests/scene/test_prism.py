"""Prisms about cylinders, by points of the cylinder and by the hull of their corners."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from hplan.scene.obstacles import Cylinder
from hplan.scene.prism import ERROR, FEWEST_SIDES, MOST_SIDES
from hplan.scene.solids import hull_of

ANGLES = st.floats(-360.0, 360.0)


@settings(max_examples=40)
@given(st.floats(1e-3, 5.0), st.floats(1e-4, 5.0), st.tuples(ANGLES, ANGLES, ANGLES))
def test_a_prism_holds_its_cylinder_and_little_more(length, radius, rpy):
    can = Cylinder(name="can", center=(1.0, -2.0, 3.0), length=length, radius=radius, rpy_deg=rpy)
    found, excess = can.hull, can.excess
    angles = np.linspace(0.0, 2.0 * np.pi, 721)
    rim = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(721)])
    ends = np.concatenate([rim + np.array([0.0, 0.0, side * 0.5 * length]) for side in (-1.0, 1.0)])
    points = ends @ can.rotation.T + np.array(can.center)
    heights = points @ found.planes[:, :3].T - found.planes[:, 3]
    assert heights.max() <= 1e-12
    assert heights.max(axis=0).min() >= -1e-4 * radius  # every facet touches it
    local = (found.core - can.center) @ can.rotation
    np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), radius + excess, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.abs(local[:, 2]), 0.5 * length, rtol=1e-9, atol=1e-12)
    sides = len(found.core) // 2
    assert FEWEST_SIDES <= sides <= MOST_SIDES
    assert excess <= (ERROR if sides < MOST_SIDES else 1.3e-3 * radius)
    assert can.solids == (can,)


def test_facets_and_edges_are_those_of_the_hull():
    can = Cylinder(name="can", center=(0.3, 0.2, 0.1), length=0.2, radius=0.03, rpy_deg=(10.0, 20.0, 30.0))
    found, hull = can.hull, hull_of(can.core)

    def rounded(rows):
        return sorted(map(tuple, np.round(rows, 9) + 0.0))

    assert rounded(found.planes) == rounded(hull.planes)
    middles = [edges[:, :3] + 0.5 * edges[:, 3:] for edges in (found.edges, hull.edges)]
    assert rounded(middles[0]) == rounded(middles[1])
    corners = found.core[found.faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    spanned = ((corners.mean(axis=1) - can.center) * outward).sum(axis=1) / 6.0
    assert spanned.min() > 0.0
    assert spanned.sum() == pytest.approx(ConvexHull(can.core).volume, rel=1e-9)
    assert not any(array.flags.writeable for array in (found.core, found.planes, found.edges))
    assert can.hull is found
