"""A depth camera: frames of points as one beside an arm would deliver them, by rays cast into a scene's true solids.

A pinhole camera looks along its z axis, x to the right and y down. Every pixel has one ray, along its middle; a frame
is an organised cloud, row by row, with rows of NaN where nothing is within range. Depths have noise of a standard
deviation that grows with their square, and a fraction of all returns are outliers, evenly spread between the camera and
the range. The arm is in the picture as the capsules of its links and the hulls of turret and pedestal.

Each solid is drawn over the pixels that a ball about it can cover, the nearest surface stays: a depth buffer. Solids
that are convex hulls are drawn by their facets, without their rounding.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hplan.base.arrays import FloatArray
from hplan.base.kernels import kernel
from hplan.scene.obstacles import Box, Capsule, Solid, Sphere
from hplan.scene.solids import Hull

#: Least depth that is measured [m].
NEAREST_M: Final = 0.1

#: Kinds of primitives, in their first column; a capsule of no length is a ball. A hull's numbers are where its facets
#: begin and end.
_CAPSULE, _HULL = 0.0, 1.0


@dataclass(frozen=True)
class DepthCamera:
    """A pinhole depth camera that stands still.

    Attributes:
        position: Where it is, in `base_link` [m].
        target: What its axis goes through [m].
        width: Pixels of a row.
        height: Rows.
        view_deg: Horizontal angle of view [deg].
        sigma_m: Standard deviation of a depth of 1 m [m]; it grows with the square of the depth.
        outliers: Fraction of the returns that are anywhere in front of the camera.
        range_m: Largest depth that is measured [m].
    """

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    width: int = 640
    height: int = 480
    view_deg: float = 87.0
    sigma_m: float = 2e-3
    outliers: float = 0.02
    range_m: float = 6.0

    @property
    def pose(self) -> FloatArray:
        """(4, 4) camera to `base_link`."""
        along = np.subtract(self.target, self.position)
        along = along / np.linalg.norm(along)
        right = np.cross(along, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([right, np.cross(along, right), along])
        pose[:3, 3] = self.position
        return pose

    @property
    def focal(self) -> float:
        """Focal length [pixels]."""
        return 0.5 * self.width / math.tan(math.radians(0.5 * self.view_deg))

    def depths(self, solids: Sequence[Solid]) -> FloatArray:
        """(height, width) true depths of solids [m]; infinite where there is none within range."""
        pose = self.pose
        primitives, facets = _primitives(solids, pose)
        depth = np.full((self.height, self.width), np.inf)
        _draw(primitives, facets, self.focal, depth)
        depth[depth > self.range_m] = np.inf
        return depth

    def frame(self, solids: Sequence[Solid], random: np.random.Generator) -> NDArray[np.float32]:
        """(height * width, 3) points of a frame, in the camera's frame [m], NaN where nothing is within range."""
        depth = self.depths(solids)
        depth += random.normal(size=depth.shape) * self.sigma_m * np.where(np.isfinite(depth), depth, 0.0) ** 2
        strays = np.isfinite(depth) & (random.random(depth.shape) < self.outliers)
        depth[strays] = random.uniform(NEAREST_M, self.range_m, int(strays.sum()))
        depth[~np.isfinite(depth)] = np.nan
        across = (np.arange(self.width) + 0.5 - 0.5 * self.width) / self.focal
        down = (np.arange(self.height) + 0.5 - 0.5 * self.height) / self.focal
        points = np.stack([depth * across, depth * down[:, None], depth], axis=-1)
        return points.reshape(-1, 3).astype(np.float32)


def ground(size_m: float = 12.0) -> Box:
    """A floor."""
    return Box(name="ground", center=(0.0, 0.0, -0.05), size=(size_m, size_m, 0.1))


def camera_of(count: int, **values: object) -> DepthCamera:
    """A camera of about so many pixels, three wide to two high, beside the arm, above the shoulder."""
    width = round(math.sqrt(1.5 * count))
    fields = {"position": (-0.35, 0.5, 1.7), "target": (1.4, 0.0, 0.9), "width": width, "height": round(count / width)}
    return DepthCamera(**{**fields, **values})  # type: ignore[arg-type]


def _primitives(solids: Sequence[Solid], pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solids as rows of numbers in the camera's frame, and the facets of hulls."""
    rotation, position = pose[:3, :3], pose[:3, 3]
    rows, facets, count = [], [np.zeros((0, 4))], 0
    for solid in solids:
        if isinstance(solid, Sphere | Capsule):
            ends = (solid.core[[0, -1]] - position) @ rotation
            rows.append([_CAPSULE, *ends[0], *ends[1], solid.rounding, 0.0, 0.0])
            continue
        hull = _box_planes(solid) if isinstance(solid, Box) else solid.planes if isinstance(solid, Hull) else None
        if hull is None:
            raise TypeError(f"a camera sees no {type(solid).__name__}")
        planes = np.column_stack([hull[:, :3] @ rotation, hull[:, 3] - hull[:, :3] @ position])
        core = (solid.core - position) @ rotation
        centre = 0.5 * (core.min(axis=0) + core.max(axis=0))
        radius = float(np.linalg.norm(core - centre, axis=1).max())
        rows.append([_HULL, *centre, *centre, radius, count, count + len(planes)])
        facets.append(planes)
        count += len(planes)
    return np.array(rows, dtype=np.float64).reshape(-1, 10), np.concatenate(facets)


def _box_planes(box: Box) -> FloatArray:
    """(6, 4) outward normals of a box's faces and their offsets."""
    normals = np.concatenate([box.rotation.T, -box.rotation.T])
    return np.column_stack([normals, normals @ np.array(box.center) + 0.5 * np.tile(box.size, 2)])


@kernel
def _span(centre: float, depth: float, radius: float) -> tuple[float, float]:
    """Least and largest slope of rays that meet a ball, seen along one axis."""
    distance = math.hypot(centre, depth)
    if distance <= 1.0001 * radius:
        return -math.inf, math.inf
    middle, half = math.atan2(centre, depth), math.asin(radius / distance)
    low, high = middle - half, middle + half
    right = 0.5 * math.pi - 1e-3
    return (math.tan(low) if low > -right else -math.inf), (math.tan(high) if high < right else math.inf)


@kernel
def _pixels(row: FloatArray, axis: int, focal: float, count: int) -> tuple[int, int]:
    """First and one past the last pixel, along a side of the picture, that a primitive may cover."""
    low, high = math.inf, -math.inf
    for end in (1, 4):
        least, most = _span(row[end + axis], row[end + 2], row[7])
        low, high = min(low, least), max(high, most)
    first = 0.0 if low == -math.inf else max(0.0, math.floor(low * focal + 0.5 * count - 0.5))
    last = float(count) if high == math.inf else min(float(count), math.ceil(high * focal + 0.5 * count + 0.5))
    return int(min(first, float(count))), int(max(last, 0.0))


@kernel
def _draw(primitives: FloatArray, facets: FloatArray, focal: float, depth: FloatArray) -> None:
    """Draw primitives into a picture of depths."""
    height, width = depth.shape
    for p in range(primitives.shape[0]):
        row = primitives[p]
        if max(row[3], row[6]) + row[7] < NEAREST_M:
            continue
        left, right = _pixels(row, 0, focal, width)
        top, bottom = _pixels(row, 1, focal, height)
        for v in range(top, bottom):
            y = (v + 0.5 - 0.5 * height) / focal
            for u in range(left, right):
                x = (u + 0.5 - 0.5 * width) / focal
                if row[0] == _CAPSULE:
                    at = _capsule_depth(x, y, row)
                else:
                    at = _hull_depth(x, y, facets, int(row[8]), int(row[9]))
                if NEAREST_M < at < depth[v, u]:
                    depth[v, u] = at


@kernel
def _capsule_depth(x: float, y: float, row: FloatArray) -> float:
    """Depth at which the ray through (x, y, 1) first meets a capsule; infinite where it does not."""
    ax, ay, az, radius = row[1], row[2], row[3], row[7]
    ux, uy, uz = row[4] - ax, row[5] - ay, row[6] - az
    best = math.inf
    uu, du, dd = ux * ux + uy * uy + uz * uz, x * ux + y * uy + uz, x * x + y * y + 1.0
    au = ax * ux + ay * uy + az * uz
    ad, aa = ax * x + ay * y + az, ax * ax + ay * ay + az * az
    a = uu * dd - du * du
    if uu > 0.0 and a > 1e-12 * uu * dd:
        # The cylinder about the axis, between its ends.
        b, c = du * au - uu * ad, uu * aa - au * au - radius * radius * uu
        h = b * b - a * c
        if h < 0.0:
            return math.inf
        t = (-b - math.sqrt(h)) / a
        along = t * du - au
        if 0.0 <= along <= uu and t > 0.0:
            best = t
    for end in range(2):
        ex, ey, ez = ax + end * ux, ay + end * uy, az + end * uz
        ed = ex * x + ey * y + ez
        h = ed * ed - dd * (ex * ex + ey * ey + ez * ez - radius * radius)
        if h >= 0.0:
            t = (ed - math.sqrt(h)) / dd
            if t > 0.0:
                best = min(best, t)
    return best


@kernel
def _hull_depth(x: float, y: float, facets: FloatArray, first: int, last: int) -> float:
    """Depth at which the ray through (x, y, 1) enters a hull; infinite where it does not, or begins inside."""
    enter, leave = -math.inf, math.inf
    for f in range(first, last):
        slope = facets[f, 0] * x + facets[f, 1] * y + facets[f, 2]
        if slope < 0.0:
            enter = max(enter, facets[f, 3] / slope)
        elif slope > 0.0:
            leave = min(leave, facets[f, 3] / slope)
        elif facets[f, 3] < 0.0:
            return math.inf
    return enter if 0.0 < enter <= leave else math.inf
