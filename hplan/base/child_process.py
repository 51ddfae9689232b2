"""Command and environment of Python subprocesses that import this hplan.

They find the same packages, and nothing in the working directory.
"""

from __future__ import annotations

import os
import site
import sys
from pathlib import Path

import hplan


def python_module(name: str, *arguments: str) -> list[str]:
    """Return the command that runs a module, unbuffered.

    With `-P`, modules in the working directory are not found.
    """
    return [sys.executable, "-P", "-u", "-m", name, *arguments]


def import_environment() -> dict[str, str]:
    """Return this process's environment, with this hplan on `PYTHONPATH`."""
    parent = Path(hplan.__file__).resolve().parent.parent
    installed = {Path(folder).resolve() for folder in (*site.getsitepackages(), site.getusersitepackages())}
    if parent in installed:  # already importable; on PYTHONPATH its folder might shadow the standard library
        return dict(os.environ)
    known = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": str(parent) if not known else os.pathsep.join([str(parent), known])}
