from __future__ import annotations

import math

import numpy as np
import pytest

from hplan.base.arrays import FloatArray, IntArray
from hplan.planar.pages.cspace_surface import surface_net


class TestSurfaceNet:
    def test_ball(self) -> None:
        index = np.stack(np.indices((24, 24, 24)), axis=-1)
        field = np.linalg.norm(index - 11.5, axis=-1) - 8.0
        vertices, faces = surface_net(field)
        np.testing.assert_allclose(np.linalg.norm(vertices - 11.5, axis=1), 8.0, atol=0.12)
        self.assert_closed(faces)
        assert self.volume(vertices, faces) == pytest.approx(4 / 3 * math.pi * 8**3, rel=0.03)

    def test_it_is_closed_on_the_faces_of_the_grid(self) -> None:
        field = -np.ones((6, 7, 8))
        vertices, faces = surface_net(field)
        self.assert_closed(faces)
        assert self.volume(vertices, faces) == pytest.approx(5 * 6 * 7, rel=0.25)
        assert vertices.min() >= -0.01
        assert (vertices.max(axis=0) <= np.array([5, 6, 7]) + 0.01).all()

    @staticmethod
    def assert_closed(faces: IntArray) -> None:
        edges: dict[tuple[int, int], int] = {}
        for face in faces:
            for a, b in zip(face, np.roll(face, -1), strict=True):
                edges[int(a), int(b)] = edges.get((int(a), int(b)), 0) + 1
        assert all(edges.get((b, a)) == count for (a, b), count in edges.items())

    @staticmethod
    def volume(vertices: FloatArray, faces: IntArray) -> float:
        total = 0.0
        for a, b, c in ((0, 1, 2), (0, 2, 3)):
            p, q, r = (vertices[faces[:, k]] for k in (a, b, c))
            total += float(np.einsum("ij,ij->i", p, np.cross(q, r)).sum()) / 6.0
        return total
