"""Folders of the files shipped with hplan, installed or in a checkout."""

from __future__ import annotations

from pathlib import Path

#: Suffix of a limits file, in place of `.urdf`.
LIMITS_SUFFIX = ".limits.yaml"

_PACKAGE = Path(__file__).resolve().parents[1]


def urdf_dir() -> Path:
    """Folder of the shipped robots.

    It is in the package (wheel) or next to the package (checkout).
    """
    installed = _PACKAGE / "urdf"
    return installed if installed.is_dir() else _PACKAGE.parent / "urdf"


def shipped_robots() -> list[str]:
    """Names of the shipped robots."""
    return sorted(path.stem for path in urdf_dir().glob("*.urdf"))


def robot_names() -> list[str]:
    """Names of all known robots.

    These are the shipped robots and the robots of example-robot-data; for the latter only the limits files ship.
    """
    return sorted(path.name.removesuffix(LIMITS_SUFFIX) for path in urdf_dir().glob(f"*{LIMITS_SUFFIX}"))


def shipped_limits(name: str) -> Path:
    """Limits file of a known robot."""
    return urdf_dir() / f"{name}{LIMITS_SUFFIX}"


def scenes_dir() -> Path:
    """Folder of the shipped scenes."""
    return _PACKAGE / "scenes"


def shipped_scenes() -> list[str]:
    """Names of the shipped scenes."""
    return sorted(path.stem for path in scenes_dir().glob("*.yaml"))


def shipped_scene(name: str) -> Path:
    """File of a shipped scene."""
    return scenes_dir() / f"{name}.yaml"


def view_asset(name: str) -> str:
    """Text of a file of the animated page: HTML, style or script."""
    return (_PACKAGE / "apps" / "view" / "assets" / name).read_text(encoding="utf-8")
