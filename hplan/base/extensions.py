"""Rooms at the edge of the package that add to those below them, loaded when they are first needed.

A room below declares a table and never imports the room that fills it. The package's `__init__`, which is above all
rooms, declares which rooms fill tables; `load_extensions` imports them, and they register what they add.
"""

from __future__ import annotations

import importlib

_MODULES: list[str] = []


def declare_extension(module: str) -> None:
    """Declare a module that registers additions when it is imported."""
    if module not in _MODULES:
        _MODULES.append(module)


def load_extensions() -> None:
    """Import all declared modules; those that are loaded already cost nothing."""
    for module in _MODULES:
        importlib.import_module(module)
