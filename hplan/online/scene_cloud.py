"""A point cloud of a scene that is replaced frame by frame."""

from __future__ import annotations

from collections.abc import Sequence

from hplan.base.arguments import list_of, text
from hplan.errors import InputError, OptionError
from hplan.scene.model import Scene
from hplan.scene.obstacles import PointCloud, Solid


def check_cloud_name(scene: Scene, name: str) -> None:
    """Refuse a cloud name that an obstacle or fruit already has.

    Raises:
        InputError: An obstacle that is not a cloud, or a fruit, has that name.
        OptionError: `name` is not a name.
    """
    text("name", name, "the name of the cloud")
    taken = [item for item in (*scene.obstacles, *scene.fruits) if item.name == name]
    if taken and not isinstance(taken[0], PointCloud):
        what = type(taken[0]).__name__.lower()
        raise InputError(f"{name!r} is a {what}; a cloud must have its own name", name=name)


def solids_named(scene: Scene, names: Sequence[str], cloud: str, time_s: float | None) -> tuple[Solid, ...]:
    """Solids of named fruits and obstacles in the base frame.

    Moving ones are placed at `time_s`.

    Args:
        cloud: Name of the cloud itself, which must not be among `names`.
        time_s: Time on the clock of the scene's tracks [s]; None if the named items are static.

    Raises:
        InputError: A name is unknown, or it is the cloud's name.
        OptionError: A value of `names` is not a name; or a named item moves and `time_s` is missing.
    """
    wanted = list_of("ignore", names, str, "names of fruits and obstacles")
    if not wanted:
        return ()
    known = {item.name for item in (*scene.obstacles, *scene.fruits)}
    for name in wanted:
        if name == cloud:
            raise InputError(f"ignore: {name!r} is the cloud itself", name=name)
        if name not in known:
            raise InputError(f"ignore: there is no fruit or obstacle {name!r}", name=name)
    named = scene.copy_unchecked(
        {key: tuple(item for item in getattr(scene, key) if item.name in wanted) for key in ("obstacles", "fruits")}
    )
    if named.moves:
        if time_s is None:
            expected = "the time of the frame on the clock of the scene's tracks: a body to ignore moves"
            raise OptionError("time_s", None, expected)
        named = named.at(time_s)
    return named.listed_solids


def with_cloud(scene: Scene, name: str, cloud: PointCloud | None) -> Scene:
    """Return the scene with a cloud replaced or added; None removes it."""
    obstacles = list(scene.obstacles)
    place = next((number for number, obstacle in enumerate(obstacles) if obstacle.name == name), len(obstacles))
    obstacles[place : place + 1] = [] if cloud is None else [cloud]
    # Name and obstacle are checked: no need to check the scene again.
    return scene.copy_unchecked({"obstacles": tuple(obstacles)})
