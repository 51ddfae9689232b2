"""Plan the same tasks with other processors' code, and compare.

NumPy, OpenBLAS, the C library and numba choose their code by the processor, and sums in another order differ in their
last bits. Each of them runs with the code of an older processor, in a process of its own, and the results are compared
with an ordinary run's: choices (nodes, grasps, orders, numbers of samples) and numbers.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_EPILOG = """\
exit status:
  0  all choices are the same, and no number differs by more than --tolerance
  5  some are not
"""

#: Fruits of the tour that is planned.
_TOUR = ("fruit 01", "fruit 02", "fruit 03", "fruit 06", "fruit 09")


def variants() -> dict[str, dict[str, str]]:
    """The environment of each variant, by its name."""
    # A private module of NumPy, unchanged since 2.0, lists the features that NumPy can do without.
    from numpy._core import _multiarray_umath as core

    optional = [name for name in core.__cpu_dispatch__ if core.__cpu_features__[name]]
    numpy = {"NPY_DISABLE_CPU_FEATURES": " ".join(optional)} if optional else {}
    # Features to disable in glibc; its sine has code of its own for these.
    c_library = "glibc.cpu.hwcaps=-AVX2,-AVX2_Usable,-FMA,-FMA_Usable,-FMA4,-FMA4_Usable"
    library = {"GLIBC_TUNABLES": c_library}
    numba = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    kinds = {
        "numpy": numpy,
        "openblas-nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
        "openblas-haswell": {"OPENBLAS_CORETYPE": "Haswell"},
        "openblas-skylakex": {"OPENBLAS_CORETYPE": "SkylakeX"},
        "libc": library,
        "numba": numba,
    }
    return {**kinds, "all": {**numpy, **kinds["openblas-nehalem"], **library, **numba}}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=_EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="VARIANT", help=f"of {', '.join(variants())} (default: all)")
    parser.add_argument(
        "--tolerance",
        type=float,
        default=0.0,
        metavar="X",
        help="largest difference, of numbers beyond 1 in parts of the largest of their array (default: 0)",
    )
    parser.add_argument("--cache", type=Path, metavar="DIR", help="where numba keeps its code (default: nowhere)")
    parser.add_argument("--write", type=Path, help=argparse.SUPPRESS)
    parser.add_argument(
        "--run", nargs=argparse.REMAINDER, metavar="COMMAND", help="run a command in the first variant's environment"
    )
    arguments = parser.parse_args(argv)
    if arguments.write is not None:
        np.savez(arguments.write, **dict(_planned()))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        # Code that numba keeps for one processor is not for another.
        cache = {"NUMBA_CACHE_DIR": str(arguments.cache or Path(folder) / "cache")}
        if arguments.run:
            environment = os.environ | variants()[(arguments.names or ["all"])[0]] | cache
            return subprocess.run(arguments.run, env=environment, check=False).returncode
        ordinary = _run({}, Path(folder) / "ordinary.npz")
        equal = True
        for name in arguments.names or variants():
            other = _run(variants()[name] | cache, Path(folder) / f"{name}.npz")
            differences = list(_differences(ordinary, other, arguments.tolerance))
            equal = equal and not differences
            print(f"{name:20}{'the same' if not differences else ''}", *differences, sep="\n    ", flush=True)
    return 0 if equal else 5


def _run(environment: dict[str, str], file: Path) -> dict[str, NDArray]:
    """The plans of a process with this environment."""
    subprocess.run([sys.executable, __file__, "--write", file], env=os.environ | environment, check=True)
    with np.load(file) as arrays:
        return dict(arrays)


def _differences(one: dict[str, NDArray], other: dict[str, NDArray], tolerance: float) -> Iterator[str]:
    """In words, one for each array."""
    for name, values in one.items():
        if values.shape != other[name].shape:
            yield f"{name}: shape {values.shape} and {other[name].shape}"
        elif values.dtype.kind != "f":
            if (values != other[name]).any():
                yield f"{name}: {values.tolist()} and {other[name].tolist()}"
        else:
            difference = float(np.abs(values - other[name]).max(initial=0.0) / np.abs(values).max(initial=1.0))
            if not difference <= tolerance:
                yield f"{name}: {difference:.2g}"


def _planned() -> Iterator[tuple[str, NDArray]]:
    """Arrays of choices and numbers, by name."""
    from hplan import PlanOptions, TourOptions, load_robot, load_scene, plan, plan_tour
    from hplan.base.data_files import scenes_dir

    scenes = {path.stem: load_scene(path) for path in sorted(scenes_dir().glob("*.yaml"))}
    tasks = [(name, scene, PlanOptions()) for name, scene in scenes.items()]
    tasks += [
        ("turning", scenes["table-1"].with_values(locked_joints=()), PlanOptions()),
        ("shortest", scenes["table-1"], PlanOptions(objective="length")),
        ("dense", scenes["table-1"], PlanOptions(method="dense", step_deg=3.0)),
    ]
    for name, scene, options in tasks:
        result = plan(load_robot(scene.robot), scene, options)
        yield f"{name} grid path", result.grid_path
        yield f"{name} origin", np.array(result.motion.origin)
        if result.search is not None and result.search.path is not None:
            yield f"{name} nodes", result.search.path
        if result.grasp is not None:
            yield f"{name} grasp", result.grasp.goal
        yield f"{name} position", result.trajectory.position
        yield f"{name} velocity", result.trajectory.velocity
        yield f"{name} torque", result.trajectory.torque
        yield f"{name} clearance", np.array(result.certificate.min_clearance_m)
    for order in ("best", "nearest"):
        tour = plan_tour(load_robot(), scenes["tour"], fruits=_TOUR, tour=TourOptions(order=order))
        yield f"tour {order} order", np.array(tour.order)
        yield f"tour {order} position", tour.trajectory.position


if __name__ == "__main__":
    sys.exit(main())
