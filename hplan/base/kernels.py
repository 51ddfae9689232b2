"""Functions compiled by numba, once, and kept on disk next to their source.

What is on disk is found by what its machine code depends on (`hplan.base.kernel_digest`), the types of the arguments,
the processor, and the versions of Python, NumPy and numba: files may be copied, moved, touched and shared by processes,
and none is ever out of date. Each bears a checksum, which is checked before anything else in it. Whatever is the
matter with them or with the disk, kernels are compiled, and a `KernelCacheWarning` says so once.

A kernel that is not tiny is compiled once, and called by its name: numba alone would put all that a kernel
calls into it, and compile it again there, which takes most of the time. A name tells the code; those called are loaded
before it.

A wheel may bring kernels (`scripts/build_wheel.py`), compiled for most processors of the last ten years. They are
looked for first, and used where the versions are those that they were made with and the processor can run them.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import sys
import tempfile
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar, cast

import llvmlite
import llvmlite.binding as ll
import numba as nb
import numpy as np
from numba.core.caching import NullCache, _CacheLocator
from numba.core.compiler import Compiler, CompileResult
from numba.core.runtime import _nrt_python
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

from hplan.base import forking  # noqa: F401  # a fork waits for what compiles
from hplan.base.kernel_digest import UnknownDependencyError, code_digest, forget, kernels_below, value_digest
from hplan.base.kernel_turns import LISTENERS, end_turn, wait_for_turn

P = ParamSpec("P")
R = TypeVar("R")

#: Settings of numba that make other machine code of the same kernel.
_SETTINGS = ("OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT")

#: How machine code is put together: another number for another way.
_MANNER = 1

#: Kernels of no more instructions are put into those that call them.
_TINY = 60

#: Kernels that came with the package, and the file there that says what they were compiled for.
_SHIPPED, _MADE_FOR = Path(__file__).parents[1] / "kernels", "made_for.txt"

#: By architecture, the processor that they are compiled for, and what another one must have to run them.
_PORTABLE = {
    "x86_64": ("x86-64-v3", ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")),
    "aarch64": ("generic", ("neon",)),
}

#: Length of a checksum [bytes].
_CHECKSUM = 32

#: Kernels that were called so far, once for each combination of types: loaded or compiled.
_ASKED: list[Any] = []

#: Warnings given already.
_GIVEN: set[str] = set()


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A compiled function, for Python and other kernels to call.

    It gets no entry for C, which would take a fifteenth of the time to compile. Division by zero gives inf or NaN, as
    in NumPy: looking for zeros would keep loops from being made fast. Python's lock is released while one runs, so that
    other threads go on. Every combination of argument types is
    compiled on its own. Read-only arrays are a type of their own, and so is every number written out in a call from
    kernel to kernel; so a kernel is called with the same kinds everywhere. Arrays go in named tuples; one taken out of
    a tuple, or given to an inlined function, is counted at about 10 ns: before a loop, not in it.
    """
    options = {"no_cfunc_wrapper": True, "error_model": "numpy", "nogil": True, "pipeline_class": _NamedByContent}
    compiled: Callable[P, R] = nb.njit(**options)(function)
    _keep_on_disk(compiled)
    return compiled


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """A function put into each kernel that calls it: for a few lines whose many arguments cost more than they do."""
    compiled: Callable[P, R] = nb.njit(inline="always", pipeline_class=_NamedByContent)(function)
    _keep_on_disk(compiled)
    return compiled


def any_int(number: int) -> int:
    """A constant that kernels may pass to one another without having the one called compiled for this very number."""
    return cast(int, np.int64(number))


class KernelCacheWarning(UserWarning):
    """Compiled kernels cannot be read from disk or kept there."""


def _keep_on_disk(compiled: Any) -> None:
    """Let a function that numba compiles be kept on disk.

    Args:
        compiled: What `numba.njit` returns; a plain function where compiling is switched off.
    """
    if hasattr(compiled, "enable_caching"):
        compiled._cache = _DiskCache(compiled)


def can_be_kept(compiled: Any) -> bool:
    """True if there is a place on disk for what a function is compiled to."""
    cache = getattr(compiled, "_cache", None)
    return isinstance(cache, _DiskCache) and any(map(_takes_files, cache.folders()))


def is_kept(compiled: Any) -> bool:
    """True if a function, as it stands with all that it calls, is on disk, compiled for this processor."""
    cache = getattr(compiled, "_cache", None)
    return isinstance(cache, _DiskCache) and cache.holds_any()


class _NamedByContent(Compiler):  # type: ignore[misc]
    """numba's compiler, where symbols are the same in each process: they end in a digest instead of a count."""

    def _compile_bytecode(self) -> Any:
        identity = self.state.func_id
        with suppress(UnknownDependencyError):
            identity.unique_id = code_digest(identity.func)[:16]
            identity.unique_name = f"{identity.func_qualname}${identity.unique_id}"
        return super()._compile_bytecode()


class _Called(NamedTuple):
    """A kernel that others call by name, for some types of arguments."""

    module: str
    function: str
    code: str
    types: tuple[Any, ...]

    @classmethod
    def of(cls, compiled: Any, types: Any) -> _Called:
        """As what numba has compiled is known.

        Raises:
            UnknownDependencyError: As for `hplan.base.kernel_digest.code_digest`.
        """
        function = compiled.py_func
        return cls(function.__module__, function.__qualname__, code_digest(compiled), tuple(types))


#: By symbol, the kernels of this process that are called by name.
_CALLED: dict[str, _Called] = {}

#: What is put into those that call such a kernel.
_NOTHING = ll.parse_assembly("")


class _Key(NamedTuple):
    """What the machine code of a function for some types of arguments depends on: digests, and the function's name."""

    function: str
    code: str
    machine: str
    types: str

    @property
    def for_any_types(self) -> str:
        """How names of files begin."""
        return f"{self.function}-{self.code[:16]}-{self.machine[:8]}-"

    @property
    def file_name(self) -> str:
        """Name of its file."""
        return f"{self.for_any_types}{self.types[:16]}.nbc"

    def checksum(self, data: bytes | memoryview) -> bytes:
        """Of the data and of the key: data of another key are as good as damaged."""
        whole = hashlib.sha256("-".join(self).encode())
        whole.update(data)
        return whole.digest()


class _DiskCache(NullCache):  # type: ignore[misc]
    """Where numba looks for a function before it compiles it, and what keeps it afterwards.

    There is a file for each combination of types of arguments: a checksum, then what numba has pickled. Files are put
    there as a whole, and are not changed any more.
    """

    def __init__(self, compiled: Any) -> None:
        self._compiled = compiled

    def folders(self) -> list[Path]:
        """Where files may be: all are read from, the first that takes files is written to."""
        source = self._compiled.py_func.__code__.co_filename
        name = _CacheLocator.get_suitable_cache_subpath(source)
        if nb.config.CACHE_DIR:
            return [Path(nb.config.CACHE_DIR, name)]
        of_user = Path(AppDirs(appname="numba", appauthor=False).user_cache_dir, name)
        return [Path(source).parent / "__pycache__", of_user] if Path(source).exists() else [of_user]

    def holds_any(self) -> bool:
        """True if there is anything for this processor."""
        key = self._key(())
        return key is not None and any(_named(folder, each.for_any_types) for folder, each in self._places(key))

    def _places(self, key: _Key) -> list[tuple[Path, _Key]]:
        """Where to read, in turn, and by what key."""
        own = [(folder, key) for folder in self.folders()]
        machine = _shipped(_target(self._compiled.targetctx.codegen()))
        return own if machine is None else [(_SHIPPED, key._replace(machine=machine)), *own]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code compiled for these types; None where there is none, or none that is whole."""
        _name_memory_functions()
        _ASKED.append(self._compiled)
        key = self._key(sig)
        found = None if key is None else self._kept(key, sig, target_context)
        if found is None and key is not None and self._may_keep(wait_for_turn, key):
            found = self._kept(key, sig, target_context)
        if found is None:
            function = self._compiled.py_func
            for told in LISTENERS:
                told(f"{function.__module__.removeprefix('hplan.')}.{function.__name__}", len(_ASKED))
        return found

    def _may_keep(self, action: Callable[[Path, str], bool | None], key: _Key) -> bool:
        """What is done with the file in the first folder that takes files; False where none does."""
        for folder in self.folders():
            with suppress(OSError):
                return bool(action(folder, key.file_name))
        return False

    def _kept(self, key: _Key, sig: Any, target_context: Any) -> Any:
        """What is on disk; None where nothing is, or nothing that is whole."""
        for folder, each in self._places(key):
            try:
                return self._loaded(_read(folder, each), sig, target_context)
            except (FileNotFoundError, NotADirectoryError):
                continue
            except Exception as error:  # whatever numba says of what it cannot take
                reason = f"{type(error).__name__}: {error}"
                _warn_once(f"compiled kernels in {folder} cannot be read ({reason}); they are compiled anew", "read")
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled for these types, if that can be done."""
        key = self._key(sig)
        if key is None:
            return
        try:
            self._keep(key, sig, data)
        finally:
            self._may_keep(end_turn, key)

    def _keep(self, key: _Key, sig: Any, data: Any) -> None:
        by_name, calls = not _is_tiny(data), _calls(data)
        if by_name:
            data.library._shared_module = _NOTHING
        kept: bytes | None = None
        try:
            kept = dumps((calls, by_name, _reduced(data)))
        except RuntimeError as error:  # numba has the function, but not its machine code
            _warn_once(f"a compiled kernel cannot be kept: {error}", "unknown")
        if by_name:
            _call_by_name(data, _Called.of(self._compiled, sig))
        if kept is None:
            return
        # Constants that were changed since they were first read are in the code, or are not: nobody knows.
        if key != self._key(sig, afresh=True) or data.library.has_dynamic_globals:
            return
        errors = []
        for folder in self.folders():
            try:
                _write(folder / key.file_name, key.checksum(kept) + kept)
            except OSError as error:
                errors.append(error)
                continue
            if not self._compiled.py_func.__closure__:  # functions that differ by what they hold share a name
                _remove_others(folder, key)
            return
        _warn_once(
            "compiled kernels cannot be kept: neither the package's folder nor the user's cache folder can be written "
            f"({errors[-1]}). They are compiled in every run, which takes most of a minute; NUMBA_CACHE_DIR names "
            "another folder",
            "kept",
        )

    def flush(self) -> None:
        """Look at everything again: numba is asked to compile anew."""
        forget()

    def _loaded(self, kept: memoryview, sig: Any, target_context: Any) -> Any:
        """What was kept, and what it calls."""
        calls, by_name, reduced = pickle.loads(kept)
        libraries = self._libraries_of(calls)
        entry = reduced[1].llvm_cpython_wrapper_name  # looked for where the bitcode says that there is one
        target_context.codegen()._engine._defined_symbols.add(entry)
        loaded = CompileResult._rebuild(target_context, *reduced)
        loaded.library._linking_libraries += libraries  # they are there as long as what calls them
        if by_name:
            _call_by_name(loaded, _Called.of(self._compiled, sig))
        return loaded

    def _libraries_of(self, calls: list[_Called]) -> list[Any]:
        """Machine code of kernels that are called by name, loaded or compiled now.

        Raises:
            LookupError: One of them is none of those that the function refers to.
        """
        below = {_Called.of(each, ()): each for each in kernels_below(self._compiled)} if calls else {}
        libraries = []
        for called in calls:
            compiled = below[called._replace(types=())]
            compiled.compile(called.types)
            libraries.append(compiled.overloads[called.types].library)
        return libraries

    def _key(self, types: Any, *, afresh: bool = False) -> _Key | None:
        function = self._compiled.py_func
        name = f"{Path(function.__code__.co_filename).stem}.{function.__qualname__}"[:150]
        machine = _machine(_target(self._compiled.targetctx.codegen()))
        try:
            code = code_digest(self._compiled, afresh=afresh)
            return _Key(re.sub(r"[^\w.]", "_", name), code, machine, value_digest(tuple(types)))
        except UnknownDependencyError as error:
            _warn_once(f"a compiled kernel cannot be kept: {error}", "unknown")
            return None


@lru_cache
def _name_memory_functions() -> None:
    """Let machine code find what allocates arrays. All else that numba would refresh now is for compiling."""
    for name, address in _nrt_python.c_helpers.items():
        ll.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


def _is_tiny(data: Any) -> bool:
    """True if a compiled function is put into those that call it."""
    blocks = data.library.get_function(data.fndesc.mangled_name).blocks
    instructions = (1 for block in blocks for _ in block.instructions)
    return sum(islice(instructions, _TINY + 1)) <= _TINY


def _calls(data: Any) -> list[_Called]:
    """The kernels that a compiled function calls by name."""
    functions = data.library._final_module.functions
    return [_CALLED[each.name] for each in functions if each.is_declaration and each.name in _CALLED]


def _reduced(data: Any) -> tuple[Any, ...]:
    """What numba keeps of a compiled function, without what would only have modules of numba's imported.

    Environments hold constants that machine code reads; those of numba's own functions seldom hold any, and making one
    imports its module, `numba.np.arraymath` with all of scipy.linalg.
    """
    *whole, environments = data._reduce()
    needed = (each for each in environments if each.consts or not each.globals["__name__"].startswith("numba."))
    return (*whole, tuple(needed))


def _call_by_name(data: Any, called: _Called) -> None:
    """Have a compiled function called by name."""
    data.library._shared_module = _NOTHING
    _CALLED[data.fndesc.mangled_name] = called


@lru_cache
def _target(codegen: Any) -> tuple[Any, ...]:
    """What numba compiles for: triple, processor, features."""
    return tuple(codegen.magic_tuple())


@lru_cache
def _machine(target: tuple[Any, ...]) -> str:
    """Digest of processor, versions and settings."""
    versions = (_MANNER, _TINY, sys.implementation.cache_tag, nb.__version__, llvmlite.__version__, np.__version__)
    return value_digest((target, versions, tuple(str(getattr(nb.config, name, None)) for name in _SETTINGS)))


def made_for() -> str:
    """What kernels are compiled for here, as a wheel that brings some says it."""
    python = "CPython {}.{}".format(*sys.version_info)
    numbers = f"{python}, numba {nb.__version__}, llvmlite {llvmlite.__version__}, NumPy {np.__version__}"
    return f"{numbers}, {ll.get_default_triple()}, manner {_MANNER}"


def portable_processor() -> dict[str, str]:
    """Settings of numba's, as environment variables, with which it compiles for every processor that wheels are for.

    Raises:
        LookupError: There are no wheels with kernels for this architecture.
    """
    return {"NUMBA_CPU_NAME": _PORTABLE[ll.get_default_triple().partition("-")[0]][0], "NUMBA_CPU_FEATURES": ""}


@lru_cache
def _shipped(target: tuple[Any, ...]) -> str | None:
    """Digest of what the kernels that came with the package are compiled for; None where they are of no use here."""
    try:
        brought = (_SHIPPED / _MADE_FOR).read_text(encoding="utf-8").strip()
    except OSError:
        return None
    if nb.config.CPU_NAME is not None:  # for which processor is decided already
        return None
    triple = target[0]
    processor, needed = _PORTABLE.get(triple.partition("-")[0], (None, ()))
    features = ll.get_host_cpu_features()
    lacking = [name for name in needed if not features.get(name)]
    if brought != made_for() or lacking or processor is None:
        here = f"this processor has no {', '.join(lacking)}" if brought == made_for() else f"here is {made_for()}"
        _warn_once(f"kernels came with hplan for {brought}; {here}: they are compiled when first called", "shipped")
        return None
    return _machine((triple, processor, ""))


def _named(folder: Path, beginning: str) -> list[str]:
    """Names of files in a folder that begin so."""
    with suppress(OSError):
        names = [path.name for path in folder.iterdir() if path.suffix in (".nbc", ".nbi")]
        return [name for name in names if name.startswith(beginning)]
    return []


def _takes_files(folder: Path) -> bool:
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        return True
    return False


def _read(folder: Path, key: _Key) -> memoryview:
    """What numba has pickled."""
    data = memoryview((folder / key.file_name).read_bytes())
    if data[:_CHECKSUM] != key.checksum(data[_CHECKSUM:]):
        raise ValueError(f"{key.file_name} is damaged")
    return data[_CHECKSUM:]


def _write(path: Path, data: bytes) -> None:
    """Put a file in its place, as a whole or not at all, whoever does the same."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.name}.{os.urandom(8).hex()}")
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise


def _remove_others(folder: Path, key: _Key) -> None:
    """Remove what the function was before."""
    for name in _named(folder, f"{key.function}-"):
        if not name.startswith(f"{key.function}-{key.code[:16]}-"):
            with suppress(OSError):
                (folder / name).unlink()


def _warn_once(message: str, what: str) -> None:
    """Warn of what cannot be done with kernels on disk, for the first kernel alone."""
    if what not in _GIVEN:
        _GIVEN.add(what)
        warnings.warn(message, KernelCacheWarning, stacklevel=2)
