"""Checked closed surfaces and point sets, from files or arrays.

Files are read with trimesh, which is imported for the first file. Errors are `ValueError` with the fault and the
expected input; the scene adds the key path.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import DECIMAL
from hplan.base.arrays import FloatArray, IntArray, as_array, frozen, readonly
from hplan.base.files import ByteBudget, write_text
from hplan.geometry.convex_decomposition import Pieces, convex_pieces
from hplan.scene.limits import FARTHEST_M, MOST_POINTS, MOST_TRIANGLES

_T = TypeVar("_T")


class _Cached:
    """Equality by arrays, and a cache of derived data.

    Meshes are decomposed and trees built only once.
    """

    arrays: tuple[FloatArray | IntArray, ...]
    _made: dict[Any, Any]

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and all(
            np.array_equal(mine, theirs) for mine, theirs in zip(self.arrays, other.arrays, strict=True)
        )

    __hash__ = None  # type: ignore[assignment]

    def cache(self, key: Any, make: Callable[[], _T]) -> _T:
        """Return the cached result of `make` for a key."""
        if key not in self._made:
            self._made[key] = make()
        found: _T = self._made[key]
        return found

    @property
    def digest(self) -> str:
        """SHA-256 of the arrays, as hexadecimal digits; cached."""
        return self.cache("digest", self._sha256)

    def _sha256(self) -> str:
        found = hashlib.sha256()
        for array in self.arrays:
            found.update(f"{array.dtype.kind}{array.shape}".encode())
            found.update(np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes())
        return found.hexdigest()


@dataclass(frozen=True, eq=False)
class Surface(_Cached):
    """A closed surface of triangles.

    Attributes:
        vertices: (n, 3) vertices, in the unit of the file.
        faces: (m, 3) triangles, counter-clockwise as seen from outside.
    """

    vertices: FloatArray
    faces: IntArray
    _made: dict[Any, Any] = field(default_factory=dict, repr=False)

    @property
    def arrays(self) -> tuple[FloatArray | IntArray, ...]:  # type: ignore[override]
        """Arrays that define equality."""
        return self.vertices, self.faces

    @classmethod
    def from_arrays(cls, vertices: ArrayLike, faces: ArrayLike) -> Surface:
        """Return a surface of (n, 3) vertices and (m, 3) triangles.

        Coincident vertices are merged.

        Raises:
            ValueError: The surface is empty, not finite, not closed, flat or inside out.
        """
        # The unit may be millimetres: `Mesh` checks the size again after scaling.
        points = _checked_points(vertices, "vertices", 1e3 * FARTHEST_M)
        try:
            corners = as_array(faces)
        except ValueError as error:
            raise ValueError("faces should be (m, 3) whole numbers, got rows of different lengths") from error
        if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu":
            raise ValueError(f"faces should be (m, 3) whole numbers, got {corners.dtype} of shape {corners.shape}")
        if len(corners) == 0:
            raise ValueError("the mesh is empty: it has no triangles")
        if len(corners) > MOST_TRIANGLES:
            raise ValueError(f"the mesh has {len(corners)} triangles; simplify it to at most {MOST_TRIANGLES}")
        if corners.min() < 0 or corners.max() >= len(points):
            raise ValueError(f"a triangle refers to vertex {corners.max()}, but the mesh has {len(points)} vertices")
        points, place = np.unique(points, axis=0, return_inverse=True)
        corners = place.ravel()[corners]
        corners = corners[(corners != corners[:, [1, 2, 0]]).all(axis=1)]
        _check_closed(points, corners)
        points = points - 0.0
        used, index = np.unique(corners, return_inverse=True)
        return cls(readonly(points[used]), readonly(index.reshape(-1, 3), np.int64))

    def pieces(self, scale: float) -> Pieces:
        """Convex parts whose union contains the solid, in metres; cached."""
        return self.cache(scale, lambda: convex_pieces(self.vertices * scale, self.faces))


@dataclass(frozen=True, eq=False)
class PointSet(_Cached):
    """A set of points.

    Attributes:
        points: (n, 3) points [m].
        left_out: Number of rows of the file with a non-finite value.
        may_merge: True if near points may be merged; False for points that were thinned before.
    """

    points: FloatArray
    left_out: int = 0
    may_merge: bool = True
    _made: dict[Any, Any] = field(default_factory=dict, repr=False)

    @property
    def arrays(self) -> tuple[FloatArray | IntArray, ...]:  # type: ignore[override]
        """Arrays that define equality."""
        return (self.points,)

    @classmethod
    def from_points(cls, points: ArrayLike, *, left_out: int = 0, may_merge: bool = True) -> PointSet:
        """Return a set of (n, 3) points; arguments are the attributes.

        Raises:
            ValueError: The set is empty or too large, or a value is not finite.
        """
        found = _checked_points(points, "points", FARTHEST_M)
        if len(found) > MOST_POINTS:
            raise ValueError(
                f"the cloud has {len(found)} points; downsample it to at most {MOST_POINTS}, in voxels about its radius"
            )
        return cls(frozen(found), left_out, may_merge)


def read_surface(path: Path, budget: ByteBudget) -> Surface:
    """Read a mesh file.

    Raises:
        ValueError: The file is too large or unreadable, or its surface is not closed, flat or inside out.
    """
    loaded = _load(path, budget, (".stl", ".ply", ".obj", ".off"), "mesh")
    faces = getattr(loaded, "faces", None)
    if faces is None or len(faces) == 0:
        raise ValueError("the mesh is empty: it has no triangles")
    return Surface.from_arrays(loaded.vertices, np.asarray(faces))


def read_points(path: Path, budget: ByteBudget) -> PointSet:
    """Read a point file, or the vertices of a mesh.

    Rows with a non-finite value, as cameras write them, are dropped and counted.

    Raises:
        ValueError: The file is unreadable, empty or too large, or has no finite point.
    """
    loaded = _load(path, budget, (".ply", ".xyz"), "point")
    vertices = loaded if isinstance(loaded, np.ndarray) else getattr(loaded, "vertices", None)
    points = np.zeros((0, 3)) if vertices is None else np.asarray(vertices, dtype=np.float64)
    finite = np.isfinite(points).all(axis=-1)
    if len(points) and not finite.any():
        raise ValueError(f"none of {len(points)} points is finite")
    return PointSet.from_points(points[finite], left_out=len(points) - int(finite.sum()))


def write_shape(data: Surface | PointSet, path: Path) -> Path:
    """Write a surface or points as a PLY file with exact numbers.

    Raises:
        OutputError: The file cannot be written.
    """
    points = data.arrays[0]
    text = io.StringIO()
    text.write(f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n")
    text.write("".join(f"property double {axis}\n" for axis in "xyz"))
    if isinstance(data, Surface):
        text.write(f"element face {len(data.faces)}\nproperty list uchar int vertex_indices\n")
    text.write("end_header\n")
    np.savetxt(text, points, fmt="%.17g")
    if isinstance(data, Surface):
        np.savetxt(text, np.insert(data.faces, 0, 3, axis=1), fmt="%d")
    return write_text(path, text.getvalue())


def _load(path: Path, budget: ByteBudget, formats: tuple[str, ...], what: str) -> Any:
    """Read a mesh or point cloud with trimesh.

    Returns the (n, 3) points of an XYZ file.
    """
    if path.suffix.lower() not in formats:
        raise ValueError(f"{path.name!r} is not a readable {what} file; convert it to one of {', '.join(formats)}")
    try:
        content = budget.read(path)
    except OSError as error:
        raise ValueError(f"cannot read {os.fspath(path)}: {error.strerror or error}") from error
    except ValueError as error:
        raise ValueError(f"cannot read {os.fspath(path)!r}: {error}") from error
    if not content.strip():
        raise ValueError(f"{os.fspath(path)} is empty")
    if path.suffix.lower() == ".xyz":
        return _read_xyz(content, os.fspath(path))
    {".ply": _check_ply_rows, ".obj": _check_corners, ".stl": _check_corners}.get(path.suffix.lower(), _accept)(
        content, os.fspath(path)
    )
    import trimesh

    try:
        loaded = trimesh.load(
            io.BytesIO(content),
            file_type=path.suffix.lower()[1:],
            process=False,
            force="mesh" if what == "mesh" else None,
        )
    except Exception as error:  # trimesh raises arbitrary exceptions of its parsers
        raise ValueError(
            f"{os.fspath(path)} is not a complete {path.suffix} file ({type(error).__name__}: {error})"
        ) from error
    return loaded


def _read_xyz(content: bytes, name: str) -> FloatArray:
    """(n, 3) points of an XYZ text: its first three columns.

    All rows must have the same number of columns. trimesh treats commas as blanks, so it would read a number with a
    decimal comma as two numbers.
    """
    comments = ["#", *(["//"] if b"//" in content else [])]
    try:
        with warnings.catch_warnings(action="ignore"):  # a file without rows is refused below
            rows = np.loadtxt(io.BytesIO(content), comments=comments, ndmin=2, encoding="utf-8-sig")
    except ValueError as error:
        raise ValueError(f"{name}, {_xyz_fault(content, comments)}") from error
    if rows.size and rows.shape[1] < 3:
        raise ValueError(f"{name} has {rows.shape[1]} columns; expected x y z, separated by spaces")
    return np.ascontiguousarray(rows[:, :3]) if rows.size else np.zeros((0, 3))


def _xyz_fault(content: bytes, comments: Sequence[str]) -> str:
    """First invalid line of an XYZ text, and its fault."""
    columns = 0
    for number, line in enumerate(content.decode("utf-8-sig", "replace").splitlines(), start=1):
        for mark in comments:
            line = line.partition(mark)[0]
        words = line.split()
        for word in words:
            if DECIMAL.fullmatch(word) is None and word.lower().lstrip("+-") not in ("nan", "inf", "infinity"):
                hint = "; use decimal points, and spaces between columns" if "," in word or ";" in word else ""
                return f"line {number}: {word[:40]!r} is not a number{hint}"
        if words and len(words) != (columns := columns or len(words)):
            return f"line {number} has {len(words)} columns, the lines before have {columns}"
    return "expected rows of numbers, x y z first"


def _check_ply_rows(content: bytes, name: str) -> None:
    """Refuse an ASCII PLY file whose rows contradict its header.

    trimesh truncates rows that are too long, reads a file that ends early as a smaller one, and reads text as binary
    numbers if the second line is not the format.
    """
    head, mark, body = content.partition(b"end_header")
    words = [line.split() for line in head.decode("latin-1").splitlines()]
    if words[1:] and words[1][:1] != ["format"]:  # trimesh would read text as binary numbers
        raise ValueError(f"{name}, line 2: expected the format of the PLY file, got {' '.join(words[1])[:40]!r}")
    if not mark or ["format", "ascii"] not in [line[:2] for line in words]:
        return
    counts, columns = list[int](), list[int]()
    for line in words:
        if line[:1] == ["element"] and len(line) == 3 and line[2].isdigit():
            counts.append(int(line[2]))
            columns.append(0)
        elif line[:1] == ["property"] and columns:
            columns[-1] += -(10**6) if line[1:2] == ["list"] else 1
    rows = body.splitlines()[1:]
    while rows and not rows[-1].strip():
        rows.pop()
    if len(rows) != sum(counts):
        raise ValueError(f"{name}: expected {sum(counts)} rows after the header, got {len(rows)}")
    first = 0
    for count, expected in zip(counts, columns, strict=True):
        for number in range(first, first + count if expected > 0 else first):
            if len(found := rows[number].split()) != expected:
                raise ValueError(
                    f"{name}: row {number + 1} after the header has {len(found)} columns, expected {expected}"
                )
        first += count


def _check_corners(content: bytes, name: str) -> None:
    """Refuse an OBJ or ASCII STL file with uneven vertex rows.

    trimesh reads such rows as one list of numbers, so a coordinate may move to another vertex.
    """
    if b"\0" in content[:1000]:  # a binary file has no rows
        return
    expected = 0
    for number, line in enumerate(content.splitlines(), start=1):
        words = line.partition(b"#")[0].split()
        if words[:1] in ([b"v"], [b"vertex"]) and len(words) != (expected := expected or max(len(words), 4)):
            raise ValueError(f"{name}, line {number}: a vertex has {len(words) - 1} numbers, expected {expected - 1}")


def _accept(_content: bytes, _name: str) -> None:
    """Check nothing."""


def _checked_points(points: ArrayLike, what: str, farthest: float) -> FloatArray:
    try:
        found = as_array(points).astype(np.float64, order="C", casting="same_kind")
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{what} should be (n, 3) numbers") from error
    if found.size == 0:
        raise ValueError(f"there are no {what}")
    if found.ndim != 2 or found.shape[1] != 3:
        raise ValueError(f"{what} should be (n, 3) numbers, got shape {found.shape}")
    largest = max(float(found.max()), -float(found.min()))
    if not math.isfinite(largest):
        bad = ~np.isfinite(found).all(axis=1)
        first = int(bad.argmax())
        raise ValueError(f"{int(bad.sum())} of {len(found)} {what} are not finite; the first is number {first}")
    if largest > farthest:
        raise ValueError(f"{what} have coordinates of {largest:.3g}; expected metres, at most {farthest:g}")
    return found


def _check_closed(points: FloatArray, faces: IntArray) -> None:
    """Refuse a surface that does not bound a solid."""
    if len(faces) == 0:
        raise ValueError("the mesh is empty: all of its triangles are points or lines")
    size = np.ptp(points, axis=0)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    _, edge = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    edge = edge.ravel()
    balance, uses = np.bincount(edge, forward), np.bincount(edge)
    if (uses % 2 == 1).any():
        holes = int((uses % 2 == 1).sum())
        raise ValueError(
            f"the mesh is open: {holes} edges have a triangle on one side only; close its holes, so that it bounds "
            "a solid"
        )
    if (balance != 0).any():
        raise ValueError(
            f"the triangles of the mesh have no consistent orientation: at {int((balance != 0).sum())} edges "
            "neighbours disagree about the outside; make the orientation consistent"
        )
    a, b, c = (points[faces[:, i]] - points.mean(axis=0) for i in range(3))
    volume = float((a * np.cross(b, c)).sum() / 6.0)
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    thickness = float(np.ptp(points @ axes.T, axis=0).min())
    if abs(volume) <= 1e-15 * float(size.max()) ** 3 or thickness <= 1e-6 * float(size.max()):
        raise ValueError(f"the mesh is flat: sides {size.tolist()}, volume {volume:.3g}; an obstacle needs a volume")
    if volume < 0.0:
        raise ValueError(f"the mesh is inside out: its volume is {volume:.3g}; flip its faces")
