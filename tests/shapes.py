"""Closed surfaces for the tests, and their inside."""

from __future__ import annotations

import coal
import numpy as np

from hplan.collision.coal_shapes import solid_shape
from hplan.scene.obstacles import Solid


def blocks(filled: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The surface of the filled cells of a grid with the given planes: vertices and triangles."""
    padded = np.pad(filled, 1)
    vertices, faces = [], []
    planes = (x, y, z)
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            neighbour = np.roll(padded, 1 - 2 * side, axis=axis)
            for cell in np.argwhere(padded & ~neighbour) - 1:
                corner = []
                for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1)):
                    point = np.empty(3)
                    point[axis] = planes[axis][cell[axis] + side]
                    point[u], point[v] = planes[u][cell[u] + du], planes[v][cell[v] + dv]
                    corner.append(point)
                first = len(vertices)
                vertices += corner
                order = (0, 1, 2, 3) if side == 1 else (3, 2, 1, 0)
                faces += [[first + order[i] for i in triangle] for triangle in ((0, 1, 2), (0, 2, 3))]
    points, place = np.unique(np.array(vertices), axis=0, return_inverse=True)
    return points, place.ravel()[np.array(faces)]


def crate() -> tuple[np.ndarray, np.ndarray]:
    """An open box of 0.5 x 0.4 x 0.3 m with walls of 2 cm, standing on z = 0."""
    filled = np.ones((3, 3, 2), dtype=bool)
    filled[1, 1, 1] = False
    return blocks(
        filled, np.array([-0.25, -0.23, 0.23, 0.25]), np.array([-0.2, -0.18, 0.18, 0.2]), np.array([0, 0.02, 0.3])
    )


def torus(radius: float = 0.3, tube: float = 0.05, n: int = 32) -> tuple[np.ndarray, np.ndarray]:
    """A ring about z."""
    a = 2.0 * np.pi * np.arange(n) / n
    about, along = np.meshgrid(a, a, indexing="ij")
    across = radius + tube * np.cos(along)
    vertices = np.stack([across * np.cos(about), across * np.sin(about), tube * np.sin(along)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    p, q = i * n + j, (i + 1) % n * n + j
    r, s = (i + 1) % n * n + (j + 1) % n, i * n + (j + 1) % n
    faces = np.concatenate([np.stack([p, q, r], axis=-1).reshape(-1, 3), np.stack([p, r, s], axis=-1).reshape(-1, 3)])
    return vertices, faces


def ball(radius: float = 0.2, n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """A round surface of many triangles: the hull of points on a sphere."""
    from scipy.spatial import ConvexHull

    rng = np.random.default_rng(n)
    points = rng.normal(size=(n * n, 3))
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * corners[:, 0]).sum(axis=1) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces


def distances(solid: Solid, points: np.ndarray) -> np.ndarray:
    """Signed distances of points from a convex solid, by coal."""
    item = solid_shape(solid)
    place = coal.Transform3s(item.placement.rotation, item.placement.translation)
    bead = coal.Sphere(1e-3)
    found = [
        coal.distance(
            bead,
            coal.Transform3s(np.eye(3), point),
            item.geometry,
            place,
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
        for point in points
    ]
    return np.array(found) + 1e-3


def uncovered(solids: tuple[Solid, ...], points: np.ndarray) -> float:
    """Maximum distance of some points from the nearest solid [m]; <= 0 if inside."""
    return float(np.min([distances(solid, points) for solid in solids], axis=0).max())


def turned(vertices: np.ndarray) -> np.ndarray:
    """Out of the axes, so that no cut lies in a side."""
    c, s = np.cos(0.5), np.sin(0.5)
    about_z, about_x = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return vertices @ (about_z @ about_x).T


def surface_points(vertices: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    corners = vertices[faces]
    sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    some = rng.choice(len(faces), count, p=sizes / sizes.sum())
    weights = rng.dirichlet(np.ones(3), count)
    return np.einsum("ni,nij->nj", weights, corners[some])
