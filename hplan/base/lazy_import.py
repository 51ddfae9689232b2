"""Deferred imports of rarely used modules and registered additions.

A package that lower packages must not import registers its additions in their tables when it is imported. The top-level
`__init__` declares such modules, and `load_extensions` imports them.
"""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any

_MODULES: dict[str, list[str]] = {}


def declare_extension(module: str, subject: str = "robots") -> None:
    """Declare a module that registers additions of a subject when imported."""
    if module not in _MODULES.setdefault(subject, []):
        _MODULES[subject].append(module)


def load_extensions(subject: str = "robots") -> None:
    """Import all modules declared for a subject; already loaded modules cost nothing."""
    for module in _MODULES.get(subject, ()):
        importlib.import_module(module)


class _Deferred(ModuleType):
    """Placeholder of a module until the first access to an attribute."""

    def __getattr__(self, name: str) -> Any:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


@contextmanager
def defer_imports(*names: str) -> Iterator[None]:
    """Import modules inside the block lazily: `import name` defers to first use.

    Args:
        names: Full module names, parents before children. Modules that are loaded already stay.
    """
    made = {name: _Deferred(name) for name in names if name not in sys.modules}
    for name, module in made.items():
        parent, _, child = name.rpartition(".")
        if parent in made:
            setattr(made[parent], child, module)
    sys.modules.update(made)
    try:
        yield
    finally:
        for name, module in made.items():
            if sys.modules.get(name) is module:
                del sys.modules[name]


def lazy_names(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return a module-level `__getattr__` that loads public names on first use.

    Args:
        package: Name of the package, its `__name__`.
        homes: For each module the names that it provides, separated by spaces.
    """
    modules = {name: module for module, names in homes.items() for name in names.split()}

    def load(name: str) -> Any:
        """Load one name and store it in the package."""
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        with without_garbage_collection():
            value = getattr(importlib.import_module(modules[name]), name)
        vars(sys.modules[package])[name] = value
        return value

    return load


#: Viewer functions by name. The top-level package registers them, since viewers belong to the last subpackage.
VIEWERS: dict[str, Callable[..., Any]] = {}


class InNotebook:
    """Mixin of results: a notebook displays the animated page of the motion."""

    def _repr_html_(self) -> str:
        html: str = VIEWERS["notebook_html"](self)
        return html


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Disable garbage collection inside the block.

    Imports create no garbage, and the search for it takes a tenth of their time.
    """
    collected = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collected:
            gc.enable()


@contextmanager
def extra(name: str, needs: str, **data: str) -> Iterator[None]:
    """Import an optional dependency inside the block, or explain its installation.

    Args:
        name: Name of the extra.
        needs: Statement for the error, for example `an MCAP file needs rosbags`.
        data: Further facts of the error.

    Raises:
        InputError: A module imported in the block is not installed.
    """
    try:
        yield
    except ImportError as error:
        from hplan.errors import InputError  # keeps `import hplan` fast

        message = f"{needs}, which is not installed: pip install 'hplan[{name}]'"
        raise InputError(message, **data, extra=name) from error
