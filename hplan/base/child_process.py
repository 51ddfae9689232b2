"""Python processes that hplan starts: with the same packages, and nothing from the working directory."""

from __future__ import annotations

import os
import site
import sys
from pathlib import Path

import hplan


def python_module(name: str, *arguments: str) -> list[str]:
    """The command that runs a module, unbuffered; modules in the working directory are not found (`-P`)."""
    return [sys.executable, "-P", "-u", "-m", name, *arguments]


def import_environment() -> dict[str, str]:
    """This process's environment, in which hplan is found where this process has found it."""
    parent = Path(hplan.__file__).resolve().parent.parent
    installed = {Path(folder).resolve() for folder in (*site.getsitepackages(), site.getusersitepackages())}
    if parent in installed:  # found as it is; ahead of Python's own library it might hide some of that
        return dict(os.environ)
    known = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": str(parent) if not known else os.pathsep.join([str(parent), known])}
