"""Reads a URDF's XML with the line number of every element."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

from hplan.base.data_files import robot_names, shipped_robots
from hplan.base.files import ByteBudget
from hplan.base.lazy_import import extra
from hplan.errors import RobotFileError

#: Maximum size of a URDF [bytes].
_MOST_BYTES: Final = 16_000_000


class Element(ET.Element):
    """XML element with its line number; 0 if not from a file."""

    line = 0


#: Path of a URDF that is given as text.
URDF_TEXT: Final = Path("URDF text")


def read_urdf_xml(path: Path, text: str | None = None, package_dirs: Sequence[Path] = ()) -> ET.Element:
    """Read a URDF's XML and return its root element.

    All elements are `Element`; the content is not checked further.

    Args:
        path: The file; xacro expands it first if it ends in `.xacro`.
        text: The content; None to read the file.
        package_dirs: Folders in which xacro looks for packages first.

    Raises:
        RobotFileError: The file is missing, unreadable, too large, malformed XML, has a document type, or its root is
            not `<robot>`.
        InputError: The file is xacro, and `xacrodoc` is not installed.
    """
    content = _content(path, package_dirs) if text is None else text.lstrip().encode("utf-8", "surrogatepass")
    if len(content) > _MOST_BYTES:
        raise RobotFileError(path, f"it has more than {_MOST_BYTES:,} bytes")
    root = _parsed(path, content)
    if root.tag != "robot":
        raise RobotFileError(path, f"the root element is <{root.tag}>, expected <robot>")
    return root


def is_urdf_text(source: object) -> bool:
    """True if a source is URDF text instead of a path.

    Examples:
        >>> is_urdf_text("<robot/>"), is_urdf_text("arm.urdf")
        (True, False)
    """
    return isinstance(source, str) and source.lstrip().startswith("<")


def _content(path: Path, package_dirs: Sequence[Path]) -> bytes:
    try:
        content = ByteBudget(_MOST_BYTES).read(path)
    except OSError as error:
        reason = error.strerror or str(error)
        if isinstance(error, FileNotFoundError) and str(path) == path.name and not path.suffix:
            ship = shipped_robots()
            more = [name for name in robot_names() if name not in ship]
            reason += f"; robots that ship with hplan: {', '.join(ship)}; with the extra `robots`: {', '.join(more)}"
        raise RobotFileError(path, reason) from error
    except ValueError as error:
        raise RobotFileError(path, str(error)) from error
    return _expanded(path, package_dirs).encode("utf-8") if path.suffix == ".xacro" else content


def _expanded(path: Path, package_dirs: Sequence[Path]) -> str:
    """Expand a xacro file to URDF text; package paths are resolved later."""
    with extra("xacro", f"robot file {path}: xacro needs xacrodoc", path=str(path)):
        import xacrodoc
    try:
        xacrodoc.packages.look_in([str(folder) for folder in package_dirs])
        text: str = xacrodoc.XacroDoc.from_file(str(path), resolve_packages=False).to_urdf_string()
    except Exception as error:  # xacro raises classes of its own, expat's and Python's
        raise RobotFileError(path, f"xacro refuses it: {error}") from error
    return text


def line_of(element: ET.Element) -> str:
    """Line of an element, as the beginning of a message."""
    line = getattr(element, "line", 0)
    return f"line {line}: " if line else ""


def _parsed(path: Path, content: bytes) -> ET.Element:
    parser = expat.ParserCreate()
    parser.buffer_text = True
    builder = ET.TreeBuilder(element_factory=Element)

    def start(tag: str, attributes: dict[str, str]) -> None:
        builder.start(tag, attributes).line = parser.CurrentLineNumber  # type: ignore[attr-defined]

    def declaration(_version: str, encoding: str | None, _standalone: int) -> None:
        # Only encodings that all URDF readers interpret alike: they decode as UTF-8 regardless of the declaration.
        if encoding is not None and encoding.lower() not in ("utf-8", "us-ascii", "ascii"):
            raise RobotFileError(path, f"malformed XML: unknown encoding {encoding!r}; URDF is read as UTF-8")

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
    root: ET.Element = builder.close()
    return root
