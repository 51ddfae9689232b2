"""Finds the mesh files of a URDF.

Handles packages, relative names, missing files and COLLADA units.
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import coal
import numpy as np

from hplan.base.files import is_file, note_input
from hplan.robot.faults import Faults
from hplan.robot.urdf_xml import folders_around, line_of, package_folder

#: Names that begin with a package's name: ROS's and Gazebo's.
_PACKAGE_SCHEMES: Final = ("package://", "model://")


class MeshFinder:
    """Finds the mesh files of one URDF.

    A mesh of a package is searched as NAME/FILE and then as FILE in the given folders, in the URDF's folder and the
    four above it, in the folder of the package of that name around them, and in the ROS package folders; a relative
    name in the URDF's folder, and then in the same folders.
    """

    def __init__(self, path: Path, package_dirs: Sequence[Path]) -> None:
        ros = [Path(folder) for folder in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if folder]
        prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        ros += [Path(folder) / "share" for folder in prefixes if folder]
        self._path = path
        self._package_dirs = package_dirs
        self._folders = [*package_dirs, *folders_around(path), *ros]
        self._packages: dict[str, Path | None] = {}

    def find(self, name: str) -> Path | None:
        """File of a mesh; None if it is not found.

        Pinocchio may know the address of a missing one.
        """
        if name.startswith(_PACKAGE_SCHEMES):
            within = name.partition("://")[2].lstrip("/")
            package, _, inside = within.partition("/")
            found = next(
                filter(is_file, (folder / part for part in (within, inside) for folder in self._folders)), None
            )
            if found is None:
                if package not in self._packages:
                    self._packages[package] = package_folder(self._path, self._package_dirs, package)
                folder = self._packages[package]
                found = None if folder is None or not is_file(folder / inside) else folder / inside
            return found
        plain = name.removeprefix("file://")
        folders, names = [self._path.parent, *self._folders], dict.fromkeys((plain, plain.replace("\\", "/")))
        found = next(filter(is_file, (folder / part for part in names for folder in folders)), None)
        installed = re.search(r"/share/([^/]+/.+)", plain)  # on another machine
        return self.find(f"{_PACKAGE_SCHEMES[0]}{installed[1]}") if found is None and installed is not None else found

    def locate(self, root: ET.Element, faults: Faults) -> bool:
        """Write mesh files and units; return True if anything changed.

        They are written into the elements.

        Args:
            root: Root element of the URDF; changed in place.
            faults: Collector; a missing collision mesh is a fault.
        """
        changed = False
        for mesh in root.iter("mesh"):
            name = mesh.get("filename", "")
            found = self.find(name)
            if found is None:
                if not _is_foreign(name):
                    looked = ", ".join(map(str, self._folders)) or "no folder, because the URDF was given as text"
                    faults.add(
                        f"{line_of(mesh)}mesh {name!r} is not found; looked for in {looked}, with and without the "
                        "package's name; package_dirs=[FOLDER] (--package-dir FOLDER) names the folders of packages"
                    )
                continue
            if name.startswith(_PACKAGE_SCHEMES) or not is_file(self._path.parent / name.removeprefix("file://")):
                note_input(found)
                mesh.set("filename", str(found.resolve()))
                changed = True
            unit = _collada_unit(found)
            if unit != 1.0:
                scale = [float(word) for word in mesh.get("scale", "1 1 1").split()]
                mesh.set("scale", " ".join(repr(unit * number) for number in scale))
                changed = True
        return changed

    def drop_missing_visuals(self, root: ET.Element, *, tries: bool) -> tuple[tuple[str, str], ...]:
        """Remove visuals with missing meshes; return their link and file names.

        Args:
            root: Root element of the URDF; changed in place.
            tries: Whether unreadable meshes count as missing.
        """
        found = list[tuple[str, str]]()
        for link in root.findall("link"):
            for visual in link.findall("visual"):
                mesh = visual.find("geometry/mesh")
                name = "" if mesh is None else mesh.get("filename", "")
                if not name or _is_foreign(name):
                    continue
                file = self.find(name)
                if file is None or (tries and not is_mesh(file)):
                    link.remove(visual)
                    found.append((str(link.get("name")), name))
        return tuple(found)

    def links_without_mesh(self, root: ET.Element, *, tries: bool) -> tuple[str, ...]:
        """Names of the links with a visual and a missing collision mesh.

        Args:
            root: Root element of the URDF.
            tries: Whether unreadable meshes count as missing.
        """

        def is_broken(mesh: ET.Element) -> bool:
            file = self.find(mesh.get("filename", ""))
            return file is None or (tries and not is_mesh(file))

        return tuple(
            str(link.get("name"))
            for link in root.findall("link")
            if link.find("visual") is not None and any(map(is_broken, link.findall("collision/geometry/mesh")))
        )


def is_mesh(file: Path) -> bool:
    """True if coal can read a mesh from a file.

    With finite vertices.
    """
    try:
        mesh = coal.MeshLoader().load(str(file), np.ones(3))
        return bool(mesh.num_tris) and bool(np.isfinite(np.asarray(mesh.vertices())).all())
    except (RuntimeError, ValueError):
        return False


def _is_foreign(name: str) -> bool:
    """True for an address of another kind, which Pinocchio may know."""
    return ":" in name and not name.startswith((*_PACKAGE_SCHEMES, "file://"))


def _collada_unit(file: Path) -> float:
    """Unit of a COLLADA file [m]; 1 for other files.

    Pinocchio's reader ignores it.
    """
    if file.suffix.lower() != ".dae":
        return 1.0
    # The unit is in the head of the file.
    with file.open("rb") as stream:
        head = stream.read(16_384)
    found = re.search(rb"<unit\b[^>]*?\bmeter\s*=\s*[\"']([0-9.eE+-]+)[\"']", head)
    try:
        unit = 1.0 if found is None else float(found[1])
    except ValueError:
        return 1.0
    return unit if unit > 0.0 else 1.0
