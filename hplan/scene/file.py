"""Scene files: YAML (and so JSON) to `Scene` and back.

Errors name the line.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import to_jsonable_python

from hplan.base.arguments import file_path, instance
from hplan.base.checked import StrictModel, format_key_path, plain_message, validate_part, worst_fault
from hplan.base.data_files import shipped_scene, shipped_scenes
from hplan.base.files import YAML_COMMENT, ByteBudget, cut, is_file, write_marked
from hplan.base.yaml_text import read_yaml, write_yaml
from hplan.errors import SceneError
from hplan.scene.imports import import_suffixes
from hplan.scene.limits import MOST_SCENE_BYTES, MOST_SHAPE_BYTES
from hplan.scene.model import Scene
from hplan.scene.obstacles import Mesh, PointCloud
from hplan.scene.robot_source import RobotSource

_Model = TypeVar("_Model", bound=StrictModel)


def default_scene_path() -> Path:
    """Return the file of the reference scene, Table 1 of the paper.

    Examples:
        >>> from hplan.scene import default_scene_path
        >>> default_scene_path().name
        'table-1.yaml'
    """
    return shipped_scene("table-1")


def load_scene(path: Path | str | None = None) -> Scene:
    """Read a scene file (YAML, and so JSON).

    Args:
        path: The file; None for the reference scene. A string without suffix and folder that is not a file names a
            scene shipped with hplan: `load_scene("trellis")`.

    Raises:
        SceneError: The file is missing or malformed, a key is unknown or repeated, a value has the wrong type or range,
            a mesh or point file cannot be used, or a limit of `hplan.scene.limits` is exceeded. The error names the key
            and its line.

    Examples:
        >>> from hplan.scene import load_scene
        >>> scene = load_scene()
        >>> scene.name, len(scene.obstacles)
        ('table-1', 1)
    """
    given, path = path, default_scene_path() if path is None else file_path("path", path)
    if isinstance(given, str) and given in shipped_scenes() and not is_file(path):
        path = shipped_scene(given)
    suffix = path.suffix.lower()
    if suffix not in ("", ".yaml", ".yml", ".json") and is_file(path) and suffix in import_suffixes():
        advice = f"name it in a scene file, among the obstacles: {{kind: import, file: {path.name}}}"
        raise SceneError(f"it has obstacles, but no start and goal; {advice}", path=path)
    is_name = given == path.name and not path.suffix
    return read_model(
        Scene, path, hint=f"; scenes that ship with hplan: {', '.join(shipped_scenes())}" if is_name else ""
    )


def parse_scene(text: str, *, path: Path | str | None = None) -> Scene:
    """Read a scene from YAML text.

    Errors name `path`; mesh and point files are relative to its folder.

    Raises:
        SceneError: The text is malformed or invalid, as in `load_scene`.

    Examples:
        >>> from hplan.errors import SceneError
        >>> from hplan.scene import parse_scene
        >>> text = "{name: demo, start: {joints_deg: [0, 90, 90, 90]}, goal: {position: [1.2, 0.0, 1.6]}}"
        >>> parse_scene(text).goal.position
        (1.2, 0.0, 1.6)
        >>> try:
        ...     parse_scene(text.replace("1.6", "high"))
        ... except SceneError as error:
        ...     print(error.where, error.line, error.value)
        goal.position[2] 1 high
    """
    return parse_model(Scene, instance("text", text, str), None if path is None else file_path("path", path))


def read_model(kind: type[_Model], path: Path, *, hint: str = "") -> _Model:
    """Read a YAML file of some model class, as `load_scene` reads scenes.

    Args:
        kind: Class of the content.
        path: The file.
        hint: Addition to the error for a missing file.

    Raises:
        SceneError: The file is missing, malformed or invalid; the class is `kind.error`.
    """
    hint = "" if is_file(path) else hint
    text = ByteBudget(MOST_SCENE_BYTES).text(path, lambda reason: kind.error(reason + hint, path=path))
    return parse_model(kind, text, path)


def parse_model(kind: type[_Model], text: str, path: Path | None) -> _Model:
    """Read YAML text of some model class.

    Errors name `path`; mesh and point files are relative to its folder.
    """
    if len(text) > MOST_SCENE_BYTES:
        raise kind.error(f"it has {len(text):,} characters; at most {MOST_SCENE_BYTES:,} are read", path=path)
    try:
        content, node = read_yaml(text)
    except yaml.MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        raise kind.error(f"malformed YAML: {error.problem}", path=path, line=line) from error
    if not isinstance(content, dict) or node is None:
        keys = ", ".join([*itertools.islice(kind.model_fields, 4), "..."])
        raise kind.error(f"expected a mapping of keys ({keys})", path=path)
    if kind is Scene and "robots" in content:
        raise SceneError("it has several robots: read it with load_cell", path=path, where="robots")
    try:
        folder = Path() if path is None else path.parent
        return validate_part(kind, content, {"folder": folder, "budget": ByteBudget(MOST_SHAPE_BYTES)})
    except ValidationError as error:
        first = worst_fault(error)
        below = ("kind",) if first["type"] == "union_tag_invalid" else first.get("ctx", {}).get("below", ())
        steps = _present_steps(content, (*first["loc"], *below))
        raise kind.error(
            plain_message(first, _WORDS),
            path=path,
            where=format_key_path(steps),
            line=_line_of(node, steps),
            value=None if isinstance(first["input"], dict) else first["input"],
        ) from error


def dump_scene(scene: Scene) -> str:
    """Return YAML text that `parse_scene` reads to an equal scene.

    File names are kept.

    Raises:
        SceneError: A mesh or point cloud has no file; `save_scene` writes one.

    Examples:
        >>> from hplan.scene import dump_scene, load_scene, parse_scene
        >>> scene = load_scene()
        >>> parse_scene(dump_scene(scene)) == scene
        True
    """
    instance("scene", scene, Scene, "load_scene")
    listed = [(f"obstacles[{index}]", obstacle) for index, obstacle in enumerate(scene.obstacles)]
    listed += [(f"attached[{index}].object", item.object) for index, item in enumerate(scene.attached)]
    for where, obstacle in listed:
        if isinstance(obstacle, Mesh | PointCloud) and obstacle.file is None:
            reason = f"{obstacle.name!r} was created from arrays and has no file; save_scene writes one"
            raise SceneError(reason, where=f"{where}.file")
    content: dict[str, Any] = {"format": scene.format, "name": scene.name}
    robot = scene.robot.to_file() if isinstance(scene.robot, RobotSource) else scene.robot
    content |= {} if robot is None else {"robot": robot}
    content |= _dump(scene.copy_unchecked({"robot": None}), exclude={"start", "goal", "obstacles", "fruits"})
    content |= {"start": _dump(scene.start), "goal": _dump(scene.goal)}
    for key, items in (("obstacles", scene.obstacles), ("fruits", scene.fruits)):
        content[key] = [
            _dump(item, exclude={"sigma"} if item.sigma == 0.0 or item.covariance else None) for item in items
        ]
    return write_yaml(content)


def _dump(part: BaseModel, exclude: set[str] | None = None) -> dict[str, Any]:
    """Dump a part of a scene as in a file.

    Fields that pydantic excludes from dumps, for digests, are added if they are given.
    """
    content = part.model_dump(mode="json", by_alias=True, exclude_none=True, exclude=exclude)
    for key, field in type(part).model_fields.items():
        value = getattr(part, key)
        if field.exclude and value != field.default:
            is_part = isinstance(value, BaseModel)
            content[key] = _dump(value) if is_part else to_jsonable_python(value, exclude_none=True)
    return content


def save_scene(scene: Scene, path: Path | str) -> Path:
    """Write a scene file atomically, replacing an existing one.

    Meshes and point clouds made of arrays are written to its folder as `STEM-NUMBER-NAME.ply`. File names relative to
    another folder, also those of a robot's file, are rewritten relative to this one.

    Raises:
        OutputError: A file cannot be written.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from hplan.scene import load_scene, save_scene
        >>> scene = load_scene()
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = save_scene(scene, Path(folder, "copy.yaml"))
        ...     load_scene(path) == scene
        True
    """
    return stage_scene(scene, path, path)


def stage_scene(scene: Scene, path: Path | str, final: Path | str) -> Path:
    """Write a scene file as `save_scene` does, at a path that it is moved from.

    Args:
        final: Path of the scene file after the move: other files are named relative to its folder.

    Raises:
        OutputError: A file cannot be written.
    """
    instance("scene", scene, Scene, "load_scene")
    path, final = file_path("path", path), file_path("path", final)
    listed = [*scene.obstacles, *(item.object for item in scene.attached)]
    taken = {shape.path for shape in listed if isinstance(shape, Mesh | PointCloud)}
    written = [
        _with_file(shape, (path, final), index, taken) if isinstance(shape, Mesh | PointCloud) else shape
        for index, shape in enumerate(listed)
    ]
    count = len(scene.obstacles)
    held = zip(scene.attached, written[count:], strict=True)
    changes: dict[str, Any] = {
        "obstacles": tuple(written[:count]),
        "attached": tuple(item.copy_unchecked({"object": shape}) for item, shape in held),
    }
    if isinstance(scene.robot, RobotSource):
        changes["robot"] = scene.robot.as_seen_from(path.absolute().parent)
    return write_marked(path, dump_scene(scene.copy_unchecked(changes)), YAML_COMMENT)


def _with_file(
    obstacle: Mesh | PointCloud, scene_paths: tuple[Path, Path], index: int, taken: Collection[Path | None]
) -> Mesh | PointCloud:
    """Return the obstacle with a file that a scene finds at the second path, written next to the first.

    A new file does not take the path of another obstacle (`taken`).
    """
    scene_path, folder = scene_paths[1], scene_paths[1].absolute().parent
    if obstacle.file is None:
        plain = "".join(sign if sign.isalnum() or sign in "-_." else "-" for sign in obstacle.name)
        stem = f"{cut(scene_path.stem)}-{index}-{cut(plain)}"
        others = (f"{stem}-{number}.ply" for number in itertools.count(2))
        file = next(name for name in itertools.chain([f"{stem}.ply"], others) if folder / name not in taken)
        obstacle.write(scene_paths[0].absolute().parent / file)
    else:
        file = obstacle.file
        if obstacle.path is not None and (folder / file).absolute() != obstacle.path:
            file = Path(os.path.relpath(obstacle.path, folder)).as_posix()
    return obstacle.copy_unchecked({"file": file})


def _present_steps(content: Any, location: Sequence[int | str]) -> list[int | str]:
    """Part of pydantic's location that exists in the file.

    Pydantic adds the tag of a union, and missing keys.
    """
    steps: list[int | str] = []
    for step in location:
        if isinstance(content, dict):
            if step in content:
                content = content[step]
            elif content.get("kind") == step:
                continue
            else:
                steps.append(step)
                break
        elif isinstance(content, tuple) and isinstance(step, int) and step < len(content):
            content = content[step]
        else:
            break
        steps.append(step)
    return steps


def _line_of(node: yaml.Node, steps: Sequence[int | str]) -> int:
    """1-based line of the deepest node along `steps` in the file."""
    line = node.start_mark.line
    for step in steps:
        if isinstance(node, yaml.MappingNode):
            found = [(key, value) for key, value in node.value if key.value == step]
            if not found:
                break
            line, node = found[0][0].start_mark.line, found[0][1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int):
            node = node.value[step]
            line = node.start_mark.line
    return int(line) + 1


#: Replacements of pydantic's words in messages about scene files.
_WORDS = {"a valid tuple": "a list", "a valid string": "text", "Tuple should have": "list should have"}
