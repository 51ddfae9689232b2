"""Import paths of earlier versions, which go on working: `hplan.orchard` is `hplan.scene.orchard`."""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType

#: Packages and modules of earlier versions, and what they are now; the longest that fits counts.
MOVED = {
    "bodies": "collision",
    "cli": "apps.cli",
    "cspace": "grid",
    "execution": "apps.execution",
    "finishing": "planning.finishing",
    "lower_bound": "planning.lower_bound",
    "moving": "planning.moving",
    "orchard": "scene.orchard",
    "perception": "online",
    "planar": "kinematics",
    "planar.inverse_kinematics": "kinematics.planar_inverse_kinematics",
    "problem": "planning",
    "robot_family": "robot.family",
    "ros": "apps.ros",
    "sampling": "planning.sampling",
    "search": "grid",
    "smoothing": "optimization",
    "smoothing.round_corners": "trajectory.corner_rounding",
    "smoothing.spline": "trajectory.spline",
    "timing": "trajectory",
    "verification": "certificate",
    "view": "apps.view",
    "waypoints": "trajectory",
}


def present_name(name: str) -> str | None:
    """Today's name of a module that an earlier version had under another; None for all others."""
    package, _, inside = name.partition(".")
    first, _, rest = inside.partition(".")
    if package != "hplan" or first not in MOVED:
        return None
    if inside in MOVED:
        return f"hplan.{MOVED[inside]}"
    return f"hplan.{MOVED[first]}" + (f".{rest}" if rest else "")


class MovedModules(MetaPathFinder):
    """Finds modules under their earlier names: the same modules, not copies of them."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of a module that was moved; None for all others."""
        del path, target
        name = present_name(fullname)
        found = None if name is None else importlib.util.find_spec(name)
        if name is None or found is None:
            return None
        return ModuleSpec(fullname, _Moved(name), is_package=found.submodule_search_locations is not None)


class _Moved(Loader):
    """Loads a module by its present name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """An empty one, which `exec_module` puts the real one in the place of."""
        del spec
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Put the real module where the import looks for it."""
        sys.modules[module.__name__] = importlib.import_module(self._name)

    def get_code(self, fullname: str) -> CodeType | None:
        """Code of the real module, for `python -m`."""
        del fullname
        spec = importlib.util.find_spec(self._name)
        loader = None if spec is None else spec.loader
        return loader.get_code(self._name) if isinstance(loader, importlib.abc.InspectLoader) else None


def find_moved_modules() -> None:
    """Let Python find modules under their earlier names; done once, when `hplan` is imported.

    Before the other finders: in a package that was moved they would load a second copy of what stands in it.
    """
    if not any(isinstance(finder, MovedModules) for finder in sys.meta_path):
        sys.meta_path.insert(0, MovedModules())
