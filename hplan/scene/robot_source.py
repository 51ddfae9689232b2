"""A robot's file with the options that it is read with, as scenes name it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, field_validator

from hplan.base.checked import Positive, StrictModel
from hplan.base.data_files import robot_names
from hplan.scene.obstacle_kind import Name

#: Suffixes of robot files.
_SUFFIXES = (".urdf", ".xacro", ".xml")


def _to_text(value: Any) -> Any:
    """Write a value of a xacro argument as xacro does."""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, int | float) else value


class RobotSource(StrictModel):
    """A robot's file and the arguments of `load_robot` that it needs.

    `load_robot` takes it in place of a path. In a scene file, paths are relative to the file's folder.

    Attributes:
        urdf: URDF, xacro or MJCF file, or name of a robot.
        limits: Limits file, or name of a robot; None for the default limits.
        tool_frame: Frame at the end of the arm; None for the default frame.
        tool_tube_m: Length of a picking tube at the tool frame [m]; None for none.
        hold: Values of fixed joints [rad, m].
        package_dirs: Folders of packages and meshes.
        srdf: SRDF with the pairs of links that may touch.
        allow_neighbours: Whether links with one joint between them may touch.
        collision_from_visual: True, or the names of the links, to build collision shapes from visuals.
        group: Group of the SRDF with the moving joints; None for all joints up to the tool frame.
        group_state: Group state of the SRDF with values of held joints; None for none.
        repair_inertia: Whether inertias that no body has are mended.
        acceleration_scale: Ratio of acceleration to velocity limits, if nothing gives acceleration limits [1/s].
        xacro_args: Values of the arguments of a xacro file.

    Examples:
        >>> from hplan import load_robot
        >>> from hplan.scene.robot_source import RobotSource
        >>> load_robot(RobotSource(urdf="harvester", tool_tube_m=0.1)).tool_frame
        'tool_tube_end'
    """

    urdf: Name
    limits: Name | None = None
    tool_frame: Name | None = None
    tool_tube_m: Annotated[float, Field(ge=0.01, le=2.0)] | None = None
    hold: Mapping[str, float] = {}
    package_dirs: tuple[Name, ...] = ()
    srdf: Name | None = None
    allow_neighbours: bool = False
    collision_from_visual: bool | tuple[Name, ...] = False
    acceleration_scale: Positive | None = None
    group: Name | None = None
    group_state: Name | None = None
    repair_inertia: bool = False
    xacro_args: Mapping[str, Annotated[str, BeforeValidator(_to_text)]] = {}

    def __hash__(self) -> int:
        return hash(self.model_dump_json())

    @field_validator("urdf", "limits", "srdf", "package_dirs")
    @classmethod
    def _in_folder(cls, value: Any, info: ValidationInfo) -> Any:
        """Resolve paths in a file from its folder."""
        if isinstance(value, tuple):
            return tuple(cls._in_folder(each, info) for each in value)
        folder = Path((info.context or {}).get("folder", ""))
        return value if value is None or _is_name(value) else str(folder / value)

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of `load_robot` beside the path that differ from its defaults."""
        values = {name: getattr(self, name) for name in type(self).model_fields if name != "urdf"}
        return {name: value for name, value in values.items() if value not in (None, False, (), {})}

    def as_seen_from(self, folder: Path) -> RobotSource:
        """Return the source with paths relative to a folder."""

        def move(path: Any) -> Any:
            if isinstance(path, tuple):
                return tuple(map(move, path))
            return path if path is None or _is_name(path) else Path(os.path.relpath(path, folder)).as_posix()

        return self.copy_unchecked(
            {key: move(getattr(self, key)) for key in ("urdf", "limits", "srdf", "package_dirs")}
        )

    def to_file(self) -> str | dict[str, Any]:
        """Return the source as scene files write it: the path alone if there are no options."""
        options = {name: list(given) if isinstance(given, tuple) else given for name, given in self.options.items()}
        content = {"urdf": self.urdf} | options
        return self.urdf if len(content) == 1 else content


def _to_source(robot: Any) -> Any:
    """Convert the path of a robot file to its source."""
    is_file = isinstance(robot, str) and robot not in robot_names() and Path(robot).suffix in _SUFFIXES
    return {"urdf": robot} if is_file else robot


def _check_name(robot: str | RobotSource | None) -> str | RobotSource | None:
    if isinstance(robot, str) and robot not in robot_names():
        raise ValueError(
            f"hplan has no robot with this name; there are {', '.join(robot_names())}, and robot files "
            f"(NAME{', NAME'.join(_SUFFIXES)})"
        )
    return robot


def _is_name(text: str) -> bool:
    return (text in robot_names() and not Path(text).is_file()) or text.startswith("robot_descriptions:")


#: A robot by name, or its file with options; a text that ends like a robot file is its path.
RobotField: TypeAlias = Annotated[str | RobotSource | None, BeforeValidator(_to_source), AfterValidator(_check_name)]
