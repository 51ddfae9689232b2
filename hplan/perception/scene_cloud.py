"""A cloud of a scene that is replaced frame by frame."""

from __future__ import annotations

from collections.abc import Sequence

from hplan.base.arguments import list_of, text
from hplan.base.arrays import FloatArray
from hplan.errors import InputError
from hplan.scene.model import Scene
from hplan.scene.obstacles import PointCloud, Solid


def check_cloud_name(scene: Scene, name: str) -> None:
    """Refuse the name of what is no cloud.

    Raises:
        InputError: There is such an obstacle, or a fruit of that name.
        OptionError: It is no name.
    """
    text("name", name, "the name of the cloud")
    taken = [item for item in (*scene.obstacles, *scene.fruits) if item.name == name]
    if taken and not isinstance(taken[0], PointCloud):
        what = type(taken[0]).__name__.lower()
        raise InputError(f"{name!r} is a {what}; a cloud needs a name of its own", name=name)


def solids_named(scene: Scene, names: Sequence[str], cloud: str) -> tuple[Solid, ...]:
    """The solids of fruits and obstacles of some names.

    Args:
        scene: The scene.
        names: The names.
        cloud: The name that stands for the cloud itself, which none of them may be.

    Raises:
        InputError: There is nothing of that name, or it is the cloud.
        OptionError: They are no names.
    """
    wanted = list_of("ignore", names, str, "names of fruits and obstacles")
    if not wanted:
        return ()
    solids = scene.solids_with_goal
    known = {solid.name for solid in solids}
    for name in wanted:
        if name == cloud:
            raise InputError(f"ignore: {name!r} is the cloud itself", name=name)
        if name not in known:
            raise InputError(f"ignore: there is no fruit or obstacle {name!r}", name=name)
    return tuple(solid for solid in solids if solid.name in wanted)


def with_cloud(scene: Scene, name: str, points: FloatArray, radius: float) -> Scene:
    """The scene with the cloud of a name replaced, added, or, without points, taken away.

    Args:
        scene: The scene.
        name: Name of the cloud.
        points: (n, 3) centres of its balls [m].
        radius: Their radius [m].

    Raises:
        SceneError: There are too many points.
    """
    obstacles = list(scene.obstacles)
    place = next((number for number, obstacle in enumerate(obstacles) if obstacle.name == name), len(obstacles))
    obstacles[place : place + 1] = [PointCloud.thinned(name, points, radius)] if len(points) else []
    # The name was looked at, and the obstacle is checked: no need to check the scene again.
    return scene.model_copy(update={"obstacles": tuple(obstacles)})
