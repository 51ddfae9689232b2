"""Reads a URDF's XML with the line number of every element."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

from hplan.base.data_files import robot_names, shipped_robots
from hplan.base.files import ByteBudget
from hplan.base.lazy_import import extra
from hplan.errors import RobotFileError
from hplan.robot.xml_element import Element

#: Maximum size of a URDF [bytes].
_MOST_URDF_BYTES: Final = 16_000_000


#: Path of a URDF that is given as text.
URDF_TEXT: Final = Path("URDF text")


def read_urdf_xml(
    path: Path,
    text: str | None = None,
    package_dirs: Sequence[Path] = (),
    xacro_args: Mapping[str, str] | None = None,
) -> Element:
    """Read a URDF's XML and return its root element.

    All elements are `Element`; the content is not checked further. A MuJoCo model is read as a URDF
    (`hplan.robot.mjcf`).

    Args:
        path: The file; xacro expands it first if it ends in `.xacro`.
        text: The content; None to read the file.
        package_dirs: Folders in which xacro looks for packages first.
        xacro_args: Values of the arguments of a xacro file, by name.

    Raises:
        RobotFileError: The file is missing, unreadable, too large, malformed XML, has a document type, or its root is
            not `<robot>` or `<mujoco>`; MuJoCo refuses its model; xacro needs an argument or a package that is missing,
            or arguments are given without xacro.
        InputError: The file is xacro, and `xacrodoc` is not installed, or MJCF without `mujoco`.
    """
    if xacro_args and (text is not None or path.suffix != ".xacro"):
        raise RobotFileError(path, f"it is not xacro, and takes no arguments such as {next(iter(xacro_args))!r}")
    if text is None:
        content = _content(path, package_dirs, xacro_args or {})
    else:
        content = text.lstrip().encode("utf-8", "surrogatepass")
    if len(content) > _MOST_URDF_BYTES:
        raise RobotFileError(path, f"it has more than {_MOST_URDF_BYTES:,} bytes")
    root = _parse(path, content)
    if root.tag == "mujoco":
        from hplan.robot.mjcf import urdf_of_mjcf  # loads MuJoCo

        return urdf_of_mjcf(path, text)
    if root.tag != "robot":
        raise RobotFileError(path, f"the root element is <{root.tag}>, expected <robot>, or <mujoco> of MJCF")
    root.is_made = text is not None or path.suffix == ".xacro"
    return root


def is_urdf_text(source: object) -> bool:
    """True if a source is URDF text instead of a path.

    Examples:
        >>> is_urdf_text("<robot/>"), is_urdf_text("arm.urdf")
        (True, False)
    """
    return isinstance(source, str) and source.lstrip().startswith("<")


def _content(path: Path, package_dirs: Sequence[Path], xacro_args: Mapping[str, str]) -> bytes:
    try:
        content = ByteBudget(_MOST_URDF_BYTES).read(path)
    except OSError as error:
        reason = error.strerror or str(error)
        if isinstance(error, FileNotFoundError) and str(path) == path.name and not path.suffix:
            ship = shipped_robots()
            more = [name for name in robot_names() if name not in ship]
            reason += f"; robots that ship with hplan: {', '.join(ship)}; with the extra `robots`: {', '.join(more)}"
        raise RobotFileError(path, reason) from error
    except ValueError as error:
        raise RobotFileError(path, str(error)) from error
    return _expand_xacro(path, package_dirs, xacro_args).encode("utf-8") if path.suffix == ".xacro" else content


def _expand_xacro(path: Path, package_dirs: Sequence[Path], xacro_args: Mapping[str, str]) -> str:
    """Expand a xacro file to URDF text; package paths are resolved later.

    Packages are looked for in the given folders, around the file, and where ROS has them.
    """
    with extra("xacro", f"robot file {path}: xacro needs xacrodoc", path=str(path)):
        import xacrodoc
    xacrodoc.packages.reset()  # packages of the same name may be elsewhere for another file
    known: dict[str, Path] = {}
    while True:
        try:
            xacrodoc.packages.update_package_cache(known)
            document = xacrodoc.XacroDoc.from_file(str(path), subargs=dict(xacro_args), resolve_packages=False)
            text: str = document.to_urdf_string()
        except Exception as error:  # xacro raises classes of its own, expat's and Python's
            missing = re.search(r"Package not found: (\S+)", str(error))
            folder = None if missing is None or missing[1] in known else package_folder(path, package_dirs, missing[1])
            if missing is None or folder is None:
                raise RobotFileError(path, f"xacro refuses it: {error}{_xacro_advice(path, str(error))}") from error
            known[missing[1]] = folder
            continue
        return text


def _xacro_advice(path: Path, message: str) -> str:
    """End of a message about xacro: the option that would help."""
    if "Package not found" in message:
        return "; package_dirs=[FOLDER] (--package-dir FOLDER) names the folders of packages"
    declared = re.findall(r"<xacro:arg\s[^>]*?name=[\"']([^\"']+)", path.read_text(encoding="utf-8", errors="replace"))
    if not declared and "argument" not in message:
        return ""
    names = f"; its arguments are {', '.join(dict.fromkeys(declared))}" if declared else ""
    return f"{names}; xacro_args={{NAME: VALUE}} (--xacro NAME:=VALUE) gives one"


def package_folder(path: Path, package_dirs: Sequence[Path], name: str) -> Path | None:
    """Folder of a ROS package near a file, or None.

    By its name or its `package.xml`.
    """
    for folder in (*package_dirs, *folders_around(path)):
        for place in (folder, folder / name, *_packages_in(folder)):
            if (place.name == name and place.is_dir()) or _package_name(place) == name:
                return place
    return None


def folders_around(path: Path) -> list[Path]:
    """Folder of a robot file and the four above it.

    Empty for a text.
    """
    return [] if path == URDF_TEXT else [path.resolve().parent, *path.resolve().parents[1:5]]


def _packages_in(folder: Path) -> list[Path]:
    """Folders of the packages directly in a folder."""
    try:
        return sorted(file.parent for file in folder.glob("*/package.xml"))
    except OSError:
        return []


def _package_name(folder: Path) -> str | None:
    """Name in a folder's `package.xml`."""
    try:
        found = re.search(r"<name>\s*([^<\s]+)\s*</name>", (folder / "package.xml").read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        return None
    return None if found is None else found[1]


def line_of(element: ET.Element) -> str:
    """Line of an element, as the beginning of a message."""
    line = getattr(element, "line", 0)
    return f"line {line}: " if line else ""


def _parse(path: Path, content: bytes) -> Element:
    parser = expat.ParserCreate()
    parser.buffer_text = True
    declared = ["utf-16"] if content.startswith((b"\xff\xfe", b"\xfe\xff")) else ["utf-8"]
    builder = ET.TreeBuilder(element_factory=Element)

    def start(tag: str, attributes: dict[str, str]) -> None:
        builder.start(tag, attributes).line = parser.CurrentLineNumber  # type: ignore[attr-defined]

    def declaration(_version: str, encoding: str | None, _standalone: int) -> None:
        if encoding is not None:
            declared.append(encoding.lower())

    def document_type(*_: Any) -> None:
        reason = f"line {parser.CurrentLineNumber}: it has a document type; URDF readers differ on its entities"
        raise RobotFileError(path, reason)

    parser.StartElementHandler = start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.XmlDeclHandler = declaration
    parser.StartDoctypeDeclHandler = document_type
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise RobotFileError(path, f"malformed XML: {error}") from error
    root: Element = builder.close()  # type: ignore[assignment]
    root.encoding = declared[-1]
    return root
