"""Limits of what a scene may hold: more is refused before it costs time or memory, or overflows.

Far above what any orchard needs; within these limits planning takes time about linear in what the scene holds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, TypeAlias

from pydantic import Field

#: No coordinate, size, radius, clearance or standard deviation in a scene is larger than this [m].
FARTHEST_M: Final = 1e4

#: A coordinate, a point or vector, and a size [m]; roll, pitch and yaw [deg].
Coordinate: TypeAlias = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
Vector: TypeAlias = tuple[Coordinate, Coordinate, Coordinate]
Size: TypeAlias = Annotated[float, Field(gt=0.0, le=FARTHEST_M)]
Angles: TypeAlias = tuple[float, float, float]

#: No time of a track is farther from the begin of the motion than this [s].
LONGEST_S: Final = 1e6

#: Most points of a track.
MOST_TRACK_POINTS: Final = 1_000

#: Most bytes of a scene file. (PyYAML reads about 0.3 MB a second.)
MOST_SCENE_BYTES: Final = 8_000_000

#: Most obstacles, and most fruits.
MOST_OBSTACLES: Final = 20_000

#: Most bytes of a mesh or point file, and of all such files of a scene.
MOST_SHAPE_BYTES: Final = 256_000_000

#: Most triangles of a mesh, and most points of a cloud.
MOST_TRIANGLES: Final = 200_000
MOST_POINTS: Final = 2_000_000


class ByteBudget:
    """Bytes that files may still have, one after the other."""

    def __init__(self, most: int) -> None:
        """Begin with `most` bytes."""
        self.most = self._left = most

    def read(self, path: Path) -> bytes:
        """Read a file; of one that is too large, or a device without end, not more than is left.

        Raises:
            OSError: It cannot be read.
            ValueError: It is too large, or its name cannot be that of a file; says the size and the limit.
        """
        with path.open("rb") as file:
            content = file.read(self._left + 1)
        if len(content) > self._left:
            size = max(path.stat().st_size, len(content))
            before = self.most - self._left
            others = f", and the files before it {before:,}" if before else ""
            raise ValueError(f"{path} has {size:,} bytes or more{others}; at most {self.most:,} are read")
        self._left -= len(content)
        return content
