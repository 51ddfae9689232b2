"""Obstacles of other programs' files, in a scene's list of obstacles.

The readers are registered by suffix; `hplan.apps.ros` has them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import Field, PrivateAttr, ValidationInfo, model_validator

from hplan.base.checked import StrictModel, fault
from hplan.base.lazy_import import load_extensions
from hplan.errors import InputError
from hplan.scene.limits import Angles, Size, Vector
from hplan.scene.obstacle_kind import Name

if TYPE_CHECKING:
    from hplan.scene.obstacles import AnyObstacle

#: Reads the obstacles of a file; the options are those of `Import` that the reader takes.
Reader: TypeAlias = Callable[..., "tuple[AnyObstacle, ...]"]

#: Readers by suffix of the file, with the names of their options; the empty suffix is that of a folder.
READERS: dict[str, tuple[Reader, tuple[str, ...]]] = {}


class Import(StrictModel):
    """Obstacles read from a file: a MoveIt scene, an octomap, a cloud of a rosbag.

    Attributes:
        file: The file, its path as for a `Mesh`.
        name: Name of the obstacle, or prefix of the names of several.
        position: Origin of the file's frame in `base_link` [m].
        rpy_deg: Orientation of that frame: roll, pitch and yaw about fixed axes [deg].
        radius: Radius of the balls of a cloud [m].
        topic: Topic of a bag; None for the only one with clouds.
        time_s: Time since the start of a bag [s].
        frame: Frame of the base in a bag.
        depth: Depth of the smallest voxels of an octomap.
    """

    kind: Literal["import"] = "import"
    file: Name
    name: Name | None = None
    position: Vector | None = None
    rpy_deg: Angles | None = None
    radius: Size | None = None
    topic: Name | None = None
    time_s: Annotated[float, Field(ge=0.0)] | None = None
    frame: Name | None = None
    depth: Annotated[int, Field(ge=1, le=16)] | None = None

    _found: tuple[AnyObstacle, ...] = PrivateAttr(default=())

    @property
    def obstacles(self) -> tuple[AnyObstacle, ...]:
        """The obstacles of the file."""
        return self._found

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Import:
        load_extensions("obstacles")
        path = Path((info.context or {}).get("folder", ""), self.file)
        suffix = "" if path.is_dir() else path.suffix.lower()
        if suffix not in READERS:
            known = ", ".join(sorted(filter(None, READERS)))
            raise fault(f"expected a file with one of the suffixes {known}, or the folder of a bag", "file")
        read, taken = READERS[suffix]
        given = self.model_dump(exclude={"kind", "file"}, exclude_none=True)
        extra = next((key for key in given if key not in taken), None)
        if extra is not None:
            raise fault(f"this key has no effect for a file {self.file}; it takes {', '.join(taken)}", extra)
        if "radius" in taken and self.radius is None:
            raise fault("this key is missing: a cloud needs the radius of its balls", "radius")
        try:
            self._found = read(path, **given)
        except InputError as error:
            raise fault(str(getattr(error, "reason", error.message)), "file") from error
        return self


def flatten_imports(listed: tuple[Any, ...]) -> tuple[Any, ...]:
    """The obstacles, with those of imports in their places."""
    return tuple(each for item in listed for each in (item.obstacles if isinstance(item, Import) else (item,)))


def import_suffixes() -> set[str]:
    """Suffixes of the files that can be imported."""
    load_extensions("obstacles")
    return {suffix for suffix in READERS if suffix}
