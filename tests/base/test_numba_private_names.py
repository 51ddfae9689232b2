"""Names of numba that are not part of its public interface, one test each.

`hplan.base.kernels`, `kernel_digest` and `forking` rely on them. If a new release of numba fails here, raise the upper
bound in pyproject.toml only after these names are replaced.
"""

from __future__ import annotations

import importlib
from typing import Any

import llvmlite.binding as ll
import numba as nb
import numpy as np
import pytest
from numba.extending import intrinsic

SINCE = f"numba {nb.__version__} has no {{}}, which hplan.base.{{}} relies on"

#: Module, name in it, and the module of hplan that imports it.
IMPORTED = [
    ("numba.core.caching", "NullCache", "kernels"),
    ("numba.core.caching", "_CacheLocator.get_suitable_cache_subpath", "kernels"),
    ("numba.core.compiler", "Compiler._compile_bytecode", "kernels"),
    ("numba.core.compiler", "CompileResult._reduce", "kernels"),
    ("numba.core.compiler", "CompileResult._rebuild", "kernels"),
    ("numba.core.compiler_lock", "global_compiler_lock", "forking"),
    ("numba.core.dispatcher", "Dispatcher", "kernel_digest"),
    ("numba.core.runtime._nrt_python", "c_helpers", "kernels"),
    ("numba.core.serialize", "dumps", "kernels"),
    ("numba.core.typing.templates", "Signature", "kernel_digest"),
    ("numba.extending", "_Intrinsic", "kernel_digest"),
    ("numba.misc.appdirs", "AppDirs", "kernels"),
]

#: Where in a compiled function an attribute is, and its name.
OF_COMPILED = [
    ("library", "_final_module"),
    ("library", "_linking_libraries"),
    ("library", "_shared_module"),
    ("library", "has_dynamic_globals"),
    ("library", "get_function"),
    ("fndesc", "mangled_name"),
    ("fndesc", "llvm_cpython_wrapper_name"),
]

SETTINGS = ("OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "CACHE_DIR")


@pytest.fixture(scope="module")
def compiled() -> Any:
    """A function that numba has compiled by itself."""

    @nb.njit
    def add_one(number: int) -> int:
        return number + 1

    add_one(1)
    return add_one


def _has(value: Any, path: str) -> bool:
    for name in path.split("."):
        if not hasattr(value, name):
            return False
        value = getattr(value, name)
    return True


@pytest.mark.parametrize(("module", "name", "used_by"), IMPORTED)
def test_name_is_importable(module: str, name: str, used_by: str) -> None:
    assert _has(importlib.import_module(module), name), SINCE.format(f"{module}.{name}", used_by)


@pytest.mark.parametrize("name", ["_cache", "enable_caching", "overloads", "py_func", "targetoptions", "targetctx"])
def test_dispatcher_has_attribute(compiled: Any, name: str) -> None:
    assert hasattr(compiled, name), SINCE.format(f"Dispatcher.{name}", "kernels")


@pytest.mark.parametrize(("part", "name"), OF_COMPILED)
def test_compiled_function_has_attribute(compiled: Any, part: str, name: str) -> None:
    (result,) = compiled.overloads.values()
    assert _has(result, f"{part}.{name}"), SINCE.format(f"CompileResult.{part}.{name}", "kernels")


def test_code_generator_lists_its_symbols(compiled: Any) -> None:
    engine = compiled.targetctx.codegen()._engine
    assert isinstance(engine._defined_symbols, set), SINCE.format("JITCPUCodegen._engine._defined_symbols", "kernels")


def test_compiler_names_functions_by_their_identity(compiled: Any) -> None:
    identity = importlib.import_module("numba.core.bytecode").FunctionIdentity.from_function(compiled.py_func)
    for name in ("func", "unique_id", "unique_name", "func_qualname"):
        assert hasattr(identity, name), SINCE.format(f"FunctionIdentity.{name}", "kernels")


def test_symbols_name_records_by_their_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    """The arguments of the type, and nothing else of it, are in the symbol."""
    record = nb.from_dtype(np.dtype([("x", np.float64)]))
    mangle = importlib.import_module("numba.core.itanium_mangler").mangle

    def symbol(name: str) -> str:
        monkeypatch.setattr(nb.core.types.Record, "mangling_args", property(lambda _: ("Record", (name,))))
        return str(mangle("kernel", (record,)))

    needed = SINCE.format("types.Record.mangling_args that symbols are named by", "kernels")
    assert symbol("one").replace("3one", "3two") == symbol("two") != symbol("one"), needed


def test_intrinsic_has_its_definition() -> None:
    @intrinsic
    def nothing(typing_context: Any, number: Any) -> Any:
        return None

    for name in ("_defn", "_prefer_literal"):
        assert hasattr(nothing, name), SINCE.format(f"_Intrinsic.{name}", "kernel_digest")


def test_cache_has_the_methods_that_a_dispatcher_calls() -> None:
    public = {name for name in dir(importlib.import_module("numba.core.caching").NullCache) if name[0] != "_"}
    assert public >= {"cache_path", "load_overload", "save_overload", "enable", "disable", "flush"}, (
        SINCE.format("a cache of the known methods", "kernels")
    )  # fmt: skip


@pytest.mark.parametrize("name", SETTINGS)
def test_setting_exists(name: str) -> None:
    assert hasattr(nb.config, name), SINCE.format(f"config.{name}", "kernels")


def test_symbols_can_be_added() -> None:
    assert callable(ll.add_symbol), "llvmlite has no binding.add_symbol, which hplan.base.kernels relies on"
