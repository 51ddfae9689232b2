"""Size limits of a scene, checked before processing large input.

They are far above the needs of any orchard; within them planning time is about linear in the size of the scene.
"""

from __future__ import annotations

from typing import Annotated, Final, TypeAlias

from pydantic import Field

#: Maximum coordinate, size, radius, clearance or standard deviation in a scene [m].
FARTHEST_M: Final = 1e4

#: A coordinate, a point or vector, a size [m]; roll, pitch and yaw [deg].
Coordinate: TypeAlias = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
Vector: TypeAlias = tuple[Coordinate, Coordinate, Coordinate]
Size: TypeAlias = Annotated[float, Field(gt=0.0, le=FARTHEST_M)]
Angles: TypeAlias = tuple[float, float, float]

#: Maximum time of a track before or after the start of the motion [s].
LONGEST_S: Final = 1e6

#: Maximum number of points of a track.
MOST_TRACK_POINTS: Final = 1_000

#: Maximum size of a scene file [bytes]. (PyYAML reads about 0.3 MB per second.)
MOST_SCENE_BYTES: Final = 8_000_000

#: Maximum number of obstacles, and of fruits.
MOST_OBSTACLES: Final = 20_000

#: Maximum number of held objects.
MOST_ATTACHED: Final = 64

#: Maximum size of a mesh or point file, and of all such files of a scene [bytes].
MOST_SHAPE_BYTES: Final = 256_000_000

#: Maximum number of triangles of a mesh, and of points of a cloud.
MOST_TRIANGLES: Final = 200_000
MOST_POINTS: Final = 2_000_000

#: Minimum contact probability that can be requested; it is provable for 10,000 distant obstacles.
LEAST_RISK: Final = 1e-5
