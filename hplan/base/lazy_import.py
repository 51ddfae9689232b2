"""Modules that a package imports but seldom uses, imported only when it does."""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any


class _Deferred(ModuleType):
    """Stands for a module until one of its attributes is asked for."""

    def __getattr__(self, name: str) -> Any:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


@contextmanager
def deferred(*names: str) -> Iterator[None]:
    """Import these modules inside the block, as `import name`, only when they are used.

    Args:
        names: Full names of modules, parents before what they contain. Modules that are there already stay.
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
    """Make a module-level `__getattr__` that loads public names on first use.

    Args:
        package: Name of the package, its `__name__`.
        homes: Modules, and the names that each of them provides, separated by spaces.
    """
    modules = {name: module for module, names in homes.items() for name in names.split()}

    def load(name: str) -> Any:
        """Load one name and keep it in the package."""
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        with without_garbage_collection():
            value = getattr(importlib.import_module(modules[name]), name)
        vars(sys.modules[package])[name] = value
        return value

    return load


#: Functions that show results, by name. The package registers them: it is above all rooms, and viewers are in the last.
VIEWERS: dict[str, Callable[..., Any]] = {}


class InNotebook:
    """Mixin of results: a notebook shows the page of the motion, playing."""

    def _repr_html_(self) -> str:
        html: str = VIEWERS["notebook_html"](self)
        return html


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Inside, garbage is not collected: imports make none, and looking for it takes a tenth of their time."""
    collected = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collected:
            gc.enable()


@contextmanager
def extra(name: str, needs: str, **data: str) -> Iterator[None]:
    """Import what an extra brings inside the block; what is not installed is an error that says how to get it.

    Args:
        needs: What needs which module, for the error: `an MCAP file needs rosbags`.

    Raises:
        InputError: Something imported in the block is not installed.
    """
    try:
        yield
    except ImportError as error:
        from hplan.errors import InputError  # `import hplan` is to cost next to nothing

        message = f"{needs}, which is not installed: pip install 'hplan[{name}]'"
        raise InputError(message, **data, extra=name) from error
