"""Limits of what a scene may hold: more is refused before it costs time or memory, or overflows.

Far above what any orchard needs; within these limits planning takes time about linear in what the scene holds.
"""

from __future__ import annotations

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

#: Least probability of a contact that can be asked for: of 10,000 obstacles that are far it is shown.
LEAST_RISK: Final = 1e-5
