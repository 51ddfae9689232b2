"""Optional packages that register additions with lower packages, loaded on demand.

A lower package declares a table and never imports the packages that fill it. The top-level `__init__` declares the
modules that fill tables; `load_extensions` imports them, and they register their additions.
"""

from __future__ import annotations

import importlib

_MODULES: list[str] = []


def declare_extension(module: str) -> None:
    """Declare a module that registers additions when imported."""
    if module not in _MODULES:
        _MODULES.append(module)


def load_extensions() -> None:
    """Import all declared modules; already loaded modules cost nothing."""
    for module in _MODULES:
        importlib.import_module(module)
