"""Functions compiled by numba once and cached on disk.

The files are in `__pycache__` next to the source, or in the user's cache folder. The key is all that the code depends
on: source code (`hplan.base.kernel_digest`), argument types, processor, and the versions of Python, NumPy and numba. So
files may be copied, moved, touched and shared by processes, and are never out of date. Each has a checksum that is
verified before anything else is read. If cache or disk fails, kernels are compiled, and one `KernelCacheWarning` says
so.

A kernel that is not tiny is compiled once and called by name. numba by itself would inline all callees and compile them
again in each caller, which takes most of the time. A name identifies the code; callees are loaded before their caller.

A wheel may contain kernels (`scripts/build_wheel.py`), compiled for most processors of the last ten years. They are
preferred if their versions match and the processor can run them.
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
from hplan.base.log import LOG

P = ParamSpec("P")
R = TypeVar("R")

#: numba settings that change the machine code of a kernel.
_SETTINGS = ("OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT")

#: Version of hplan's way to assemble machine code.
_MANNER = 2

#: Kernels with at most this number of instructions are inlined into their callers.
_TINY = 60

#: Folder of the shipped kernels, and the file in it that names their target.
_SHIPPED, _MADE_FOR = Path(__file__).parents[1] / "kernels", "made_for.txt"

#: By architecture: processor that wheels are compiled for, and the features required to run their kernels.
_PORTABLE = {
    "x86_64": ("x86-64-v3", ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")),
    "aarch64": ("generic", ("neon",)),
}

#: Length of a checksum [bytes].
_CHECKSUM = 32

#: Kernels called until now, loaded or compiled, one entry for each combination of types.
_ASKED: list[Any] = []

#: Warnings already issued.
_GIVEN: set[str] = set()


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function for calls from Python and from other kernels.

    It has no C entry point, which would take 1/15 of the compile time. Division by zero gives inf or NaN, as in NumPy;
    checks for zero would prevent vectorized loops. The global interpreter lock is released during a call, so other
    threads continue. Each combination of argument types is compiled separately. Read-only arrays are a type of their
    own, and so is each literal number in a call between kernels; so use the same argument kinds in all calls. Arrays
    are passed in named tuples. Taking an array out of a tuple, or passing it to an inlined function, costs about 10 ns
    for reference counting: do it before a loop, not inside.
    """
    options = {"no_cfunc_wrapper": True, "error_model": "numpy", "nogil": True, "pipeline_class": _NamedByContent}
    compiled: Callable[P, R] = nb.njit(**options)(function)
    _keep_on_disk(compiled)
    return compiled


def inline(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function into each kernel that calls it.

    For a few lines whose many arguments cost more than the computation.
    """
    compiled: Callable[P, R] = nb.njit(inline="always", pipeline_class=_NamedByContent)(function)
    _keep_on_disk(compiled)
    return compiled


def any_int(number: int) -> int:
    """Return a constant that does not specialize callee kernels."""
    return cast(int, np.int64(number))


class KernelCacheWarning(UserWarning):
    """Compiled kernels cannot be read from disk or stored there."""


def _keep_on_disk(compiled: Any) -> None:
    """Attach the disk cache to a compiled function.

    Args:
        compiled: Result of `numba.njit`; a plain function if compilation is disabled.
    """
    if hasattr(compiled, "enable_caching"):
        compiled._cache = _DiskCache(compiled)


def can_be_kept(compiled: Any) -> bool:
    """True if some cache folder of the function is writable."""
    cache = getattr(compiled, "_cache", None)
    return isinstance(cache, _DiskCache) and any(map(_takes_files, cache.folders()))


def is_kept(compiled: Any) -> bool:
    """True if the disk cache holds the current code for this processor.

    Callees are part of the code.
    """
    cache = getattr(compiled, "_cache", None)
    return isinstance(cache, _DiskCache) and cache.holds_any()


def _mangle_record(record: nb.types.Record) -> tuple[str, tuple[str]]:
    """Name and arguments of a record type in symbols: a digest of its fields.

    numba writes a number there that it gives to types as it meets them, which is another one in each process. Kernels
    that are stored and call one another by symbol would call a kernel for another record.
    """
    return type(record).__name__, (hashlib.sha256(record.name.encode()).hexdigest()[:16],)


nb.types.Record.mangling_args = property(_mangle_record)


class _NamedByContent(Compiler):  # type: ignore[misc]
    """numba's compiler with reproducible symbols: a digest replaces the counter."""

    def _compile_bytecode(self) -> Any:
        identity = self.state.func_id
        with suppress(UnknownDependencyError):
            identity.unique_id = code_digest(identity.func)[:16]
            identity.unique_name = f"{identity.func_qualname}${identity.unique_id}"
        return super()._compile_bytecode()


class _Called(NamedTuple):
    """A kernel called by name, for one combination of argument types."""

    module: str
    function: str
    code: str
    types: tuple[Any, ...]

    @classmethod
    def build(cls, compiled: Any, types: Any) -> _Called:
        """Make the entry of a compiled function.

        Raises:
            UnknownDependencyError: It reads an object of unknown kind (`code_digest`).
        """
        function = compiled.py_func
        return cls(function.__module__, function.__qualname__, code_digest(compiled), tuple(types))


#: Kernels of this process that are called by name, by symbol.
_CALLED: dict[str, _Called] = {}

#: Module linked into the callers of such a kernel: empty.
_NOTHING = ll.parse_assembly("")


class _Key(NamedTuple):
    """Cache key of a function for some argument types.

    It consists of the function's name and digests.
    """

    function: str
    code: str
    machine: str
    types: str

    @property
    def for_any_types(self) -> str:
        """Prefix of the file names."""
        return f"{self.function}-{self.code[:16]}-{self.machine[:8]}-"

    @property
    def file_name(self) -> str:
        """Name of the cache file."""
        return f"{self.for_any_types}{self.types[:16]}.nbc"

    def checksum(self, data: bytes | memoryview) -> bytes:
        """Checksum of data and key: data of another key count as damaged."""
        whole = hashlib.sha256("-".join(self).encode())
        whole.update(data)
        return whole.digest()


class _DiskCache(NullCache):  # type: ignore[misc]
    """numba's cache interface: loads functions before compilation, stores them after.

    There is one file for each combination of argument types: a checksum, then numba's pickle. Files are written
    atomically and never changed.
    """

    def __init__(self, compiled: Any) -> None:
        self._compiled = compiled

    def folders(self) -> list[Path]:
        """Cache folders: all are read, the first writable one is written."""
        source = self._compiled.py_func.__code__.co_filename
        name = _CacheLocator.get_suitable_cache_subpath(source)
        if nb.config.CACHE_DIR:
            return [Path(nb.config.CACHE_DIR, name)]
        of_user = Path(AppDirs(appname="numba", appauthor=False).user_cache_dir, name)
        return [Path(source).parent / "__pycache__", of_user] if Path(source).exists() else [of_user]

    def holds_any(self) -> bool:
        """True if a file for this processor exists, for any types."""
        key = self._key(())
        return key is not None and any(
            _list_cache_files(folder, each.for_any_types) for folder, each in self._places(key)
        )

    def _places(self, key: _Key) -> list[tuple[Path, _Key]]:
        """Folders to read in order, each with its key."""
        own = [(folder, key) for folder in self.folders()]
        machine = _shipped_digest(_target(self._compiled.targetctx.codegen()))
        return own if machine is None else [(_SHIPPED, key._replace(machine=machine)), *own]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the code for these types; None if no intact file exists."""
        _name_memory_functions()
        _ASKED.append(self._compiled)
        key = self._key(sig)
        found = None if key is None else self._load_from_disk(key, sig, target_context)
        if found is None and key is not None and self._may_keep(wait_for_turn, key):
            found = self._load_from_disk(key, sig, target_context)
            if found is not None:  # else `save_overload` ends the turn
                self._may_keep(end_turn, key)
        if found is None:
            function = self._compiled.py_func
            LOG.info("compiling kernel %s.%s", function.__module__, function.__name__)
            for told in LISTENERS:
                told(f"{function.__module__.removeprefix('hplan.')}.{function.__name__}", len(_ASKED))
        return found

    def _may_keep(self, action: Callable[[Path, str], bool | None], key: _Key) -> bool:
        """Result of an action on the file in the first writable folder.

        False if no folder is writable.
        """
        for folder in self.folders():
            with suppress(OSError):
                return bool(action(folder, key.file_name))
        return False

    def _load_from_disk(self, key: _Key, sig: Any, target_context: Any) -> Any:
        """Load the code from disk; None if no intact file exists."""
        for folder, each in self._places(key):
            try:
                return self._restore(_read(folder, each), sig, target_context)
            except (FileNotFoundError, NotADirectoryError):
                continue
            except Exception as error:  # numba raises arbitrary exceptions for data it cannot read
                reason = f"{type(error).__name__}: {error}"
                _warn_once(f"compiled kernels in {folder} cannot be read ({reason}); they are compiled again", "read")
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the code compiled for these types, if possible."""
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
            kept = dumps((calls, by_name, _reduce_compiled(data)))
        except RuntimeError as error:  # numba has the function, but not its machine code
            _warn_once(f"a compiled kernel cannot be cached: {error}", "unknown")
        if by_name:
            _call_by_name(data, _Called.build(self._compiled, sig))
        if kept is None:
            return
        # If a constant has changed since it was first read, the code may hold either value.
        if key != self._key(sig, afresh=True) or data.library.has_dynamic_globals:
            return
        errors = []
        for folder in self.folders():
            try:
                _write(folder / key.file_name, key.checksum(kept) + kept)
            except OSError as error:
                errors.append(error)
                continue
            if not self._compiled.py_func.__closure__:  # closures with different values share a name
                _remove_others(folder, key)
            return
        _warn_once(
            "compiled kernels cannot be cached: neither the package's folder nor the user's cache folder is writable "
            f"({errors[-1]}). They are compiled in every run, which takes almost a minute; set NUMBA_CACHE_DIR to "
            "another folder",
            "kept",
        )

    def flush(self) -> None:
        """Clear the digests: numba is to compile again."""
        forget()

    def _restore(self, kept: memoryview, sig: Any, target_context: Any) -> Any:
        """Restore a stored function together with its callees."""
        calls, by_name, reduced = pickle.loads(kept)
        libraries = self._libraries_of(calls)
        entry = reduced[1].llvm_cpython_wrapper_name  # looked up if the bitcode declares it
        target_context.codegen()._engine._defined_symbols.add(entry)
        loaded = CompileResult._rebuild(target_context, *reduced)
        loaded.library._linking_libraries += libraries  # callees live as long as their caller
        if by_name:
            _call_by_name(loaded, _Called.build(self._compiled, sig))
        return loaded

    def _libraries_of(self, calls: list[_Called]) -> list[Any]:
        """Libraries of the kernels called by name, loaded or compiled now.

        Raises:
            LookupError: A called kernel is not among the dependencies of the function.
        """
        below = {_Called.build(each, ()): each for each in kernels_below(self._compiled)} if calls else {}
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
            _warn_once(f"a compiled kernel cannot be cached: {error}", "unknown")
            return None


@lru_cache
def _name_memory_functions() -> None:
    """Register the symbols of numba's array allocator.

    numba's own refresh would register further symbols that only compilation needs.
    """
    for name, address in _nrt_python.c_helpers.items():
        ll.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


def _is_tiny(data: Any) -> bool:
    """True if a compiled function is inlined into its callers."""
    blocks = data.library.get_function(data.fndesc.mangled_name).blocks
    instructions = (1 for block in blocks for _ in block.instructions)
    return sum(islice(instructions, _TINY + 1)) <= _TINY


def _calls(data: Any) -> list[_Called]:
    """Kernels that a compiled function calls by name."""
    functions = data.library._final_module.functions
    return [_CALLED[each.name] for each in functions if each.is_declaration and each.name in _CALLED]


def _reduce_compiled(data: Any) -> tuple[Any, ...]:
    """State of a compiled function as numba pickles it, without superfluous environments.

    Environments hold the constants that machine code reads. The environments of numba's own functions are mostly empty,
    and loading one imports its module: `numba.np.arraymath`, with all of scipy.linalg.
    """
    *whole, environments = data._reduce()
    needed = (each for each in environments if each.consts or not each.globals["__name__"].startswith("numba."))
    return (*whole, tuple(needed))


def _call_by_name(data: Any, called: _Called) -> None:
    """Register a compiled function for calls by name."""
    data.library._shared_module = _NOTHING
    _CALLED[data.fndesc.mangled_name] = called


@lru_cache
def _target(codegen: Any) -> tuple[Any, ...]:
    """Compilation target of numba: triple, processor, features."""
    return tuple(codegen.magic_tuple())


@lru_cache
def _machine(target: tuple[Any, ...]) -> str:
    """Digest of processor, versions and settings."""
    versions = (_MANNER, _TINY, sys.implementation.cache_tag, nb.__version__, llvmlite.__version__, np.__version__)
    return value_digest((target, versions, tuple(str(getattr(nb.config, name, None)) for name in _SETTINGS)))


def made_for() -> str:
    """Compilation target of this machine, as written in a wheel."""
    python = "CPython {}.{}".format(*sys.version_info)
    numbers = f"{python}, numba {nb.__version__}, llvmlite {llvmlite.__version__}, NumPy {np.__version__}"
    return f"{numbers}, {ll.get_default_triple()}, manner {_MANNER}"


def portable_processor() -> dict[str, str]:
    """Environment variables that make numba compile for all processors of a wheel.

    Raises:
        LookupError: No wheels with kernels exist for this architecture.
    """
    return {"NUMBA_CPU_NAME": _PORTABLE[ll.get_default_triple().partition("-")[0]][0], "NUMBA_CPU_FEATURES": ""}


@lru_cache
def _shipped_digest(target: tuple[Any, ...]) -> str | None:
    """Digest of the target of the shipped kernels; None if unusable here."""
    try:
        brought = (_SHIPPED / _MADE_FOR).read_text(encoding="utf-8").strip()
    except OSError:
        return None
    if nb.config.CPU_NAME is not None:  # the user has selected a processor
        return None
    triple = target[0]
    processor, needed = _PORTABLE.get(triple.partition("-")[0], (None, ()))
    features = ll.get_host_cpu_features()
    lacking = [name for name in needed if not features.get(name)]
    if brought != made_for() or lacking or processor is None:
        here = f"this processor lacks {', '.join(lacking)}" if brought == made_for() else f"this is {made_for()}"
        _warn_once(
            f"the kernels shipped with hplan are for {brought}; {here}: kernels are compiled when first called",
            "shipped",
        )
        return None
    return _machine((triple, processor, ""))


def _list_cache_files(folder: Path, beginning: str) -> list[str]:
    """Names of the cache files in a folder that start with `beginning`."""
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
    """Read a file and return its pickle."""
    data = memoryview((folder / key.file_name).read_bytes())
    if data[:_CHECKSUM] != key.checksum(data[_CHECKSUM:]):
        raise ValueError(f"{key.file_name} is damaged")
    return data[_CHECKSUM:]


def _write(path: Path, data: bytes) -> None:
    """Write a file atomically, also against concurrent writers."""
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
    """Remove the files of earlier versions of the function."""
    for name in _list_cache_files(folder, f"{key.function}-"):
        if not name.startswith(f"{key.function}-{key.code[:16]}-"):
            with suppress(OSError):
                (folder / name).unlink()


def _warn_once(message: str, what: str) -> None:
    """Issue a warning about the disk cache, once for each kind."""
    if what not in _GIVEN:
        _GIVEN.add(what)
        warnings.warn(message, KernelCacheWarning, stacklevel=2)
