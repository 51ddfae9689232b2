"""Content hash of a compiled kernel and its dependencies, its cache key.

numba compiles into a kernel's machine code the kernels that it calls or inlines, and the values of the constants that
it reads. So the digest covers them, recursively: bytecode, options, defaults, closure values, constants, fields of
named tuples. It does not depend on file locations, modification times or comments; docstrings are constants and count.

Objects of Python's standard library, NumPy or numba count by name; `hplan.base.kernels` adds their versions. An
unknown kind of object is refused, never ignored. One dependency is invisible: a numba `overload` of a plain Python
function registered elsewhere.
"""

from __future__ import annotations

import dis
import hashlib
import sys
from collections.abc import Iterable, Iterator
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numba as nb
import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.typing.templates import Signature
from numba.extending import _Intrinsic

#: Packages whose version identifies their content.
_VERSIONED = frozenset(sys.stdlib_module_names) | {"numpy", "numba", "llvmlite"}

#: Types whose values are identified by their `repr`.
_WRITTEN_OUT = frozenset((bool, int, float, complex, str, bytes, type(None), type(...)))

#: Digest of a function itself, and the functions that it refers to.
_Own = tuple[bytes, tuple[Any, ...]]

#: Known functions; their constants were frozen at the first visit.
_SEEN: dict[Any, _Own] = {}

#: Digests of functions with all their dependencies.
_DIGESTS: dict[Any, str] = {}


class UnknownDependencyError(Exception):
    """A kernel reads an object whose identity cannot be verified."""


def code_digest(kernel: Any, *, afresh: bool = False) -> str:
    """Digest of a kernel's code and all its dependencies.

    Argument types, processor and package versions are not included.

    Args:
        kernel: Result of `numba.njit`.
        afresh: True to read constants again that were read before.

    Raises:
        UnknownDependencyError: It reads an object that is neither a number, a string, an array, a tuple, a function nor
            a class.
    """
    if afresh:
        return _digest([kernel], {})
    if kernel not in _DIGESTS:
        _DIGESTS[kernel] = _digest([kernel], _SEEN)
    return _DIGESTS[kernel]


def kernels_below(kernel: Any) -> list[Any]:
    """Compiled functions that a kernel refers to, recursively; itself first.

    Raises:
        UnknownDependencyError: It reads an object of unknown kind (`code_digest`).
    """
    found = dict.fromkeys(_iterate_dependencies([kernel], _SEEN))
    return [function for function in found if isinstance(function, Dispatcher)]


def forget() -> None:
    """Clear all cached digests."""
    _SEEN.clear()
    _DIGESTS.clear()


def value_digest(value: Any) -> str:
    """Digest of a value that a kernel may read, numba types included.

    Raises:
        UnknownDependencyError: The value is of unknown kind.
    """
    parts = _Parts()
    parts.add(value)
    return hashlib.sha256(parts.own + _digest(parts.functions, _SEEN).encode()).hexdigest()


def _digest(functions: Iterable[Any], seen: dict[Any, _Own]) -> str:
    """Digest of functions and their dependencies in visiting order; repetitions by number."""
    whole, numbers = hashlib.sha256(), dict[Any, int]()
    for function in _iterate_dependencies(functions, seen):
        if function in numbers:
            whole.update(b"again %d." % numbers[function])
        else:
            numbers[function] = len(numbers)
            whole.update(seen[function][0])
    return whole.hexdigest()


def _iterate_dependencies(functions: Iterable[Any], seen: dict[Any, _Own]) -> Iterator[Any]:
    """Iterate over functions and their dependencies, repetitions included; fills `seen`."""
    left, met = list(functions), set[Any]()
    while left:
        function = left.pop()
        if function not in met:
            met.add(function)
            if function not in seen:
                seen[function] = _own(function)
            left.extend(seen[function][1])
        yield function


def _own(function: Any) -> _Own:
    """Digest and references of a function or a numba dispatcher."""
    parts = _Parts()
    if isinstance(function, Dispatcher):
        parts.add(function.targetoptions)
        function = function.py_func
    elif isinstance(function, _Intrinsic):
        parts.add(function._prefer_literal)
        function = function._defn
    parts.add((function.__module__, function.__qualname__, function.__defaults__, function.__kwdefaults__))
    try:
        parts.add(tuple(cell.cell_contents for cell in function.__closure__ or ()))
        parts.add(function.__code__)
        for code in _codes(function.__code__):
            parts.add_read(code, function.__globals__, ("LOAD_GLOBAL", "LOAD_NAME"))
    except (UnknownDependencyError, ValueError) as error:  # ValueError: an empty cell
        raise UnknownDependencyError(f"{function.__module__}.{function.__qualname__}: {error}") from None
    return hashlib.sha256(parts.own).digest(), tuple(parts.functions)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Iterate over the code of a function and of its inner functions."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


class _Parts:
    """Unambiguous serialization of a function's parts.

    Attributes:
        own: Serialized parts, without functions.
        functions: Functions that were added.
    """

    def __init__(self) -> None:
        self.own = bytearray()
        self.functions: list[Any] = []

    def _write(self, *parts: str | bytes) -> None:
        for part in parts:
            data = part if isinstance(part, bytes) else part.encode("utf-8", "surrogatepass")
            self.own += b"%d:" % len(data) + data

    def add(self, value: Any) -> None:
        """Add a value."""
        kind = type(value)
        self._write(kind.__module__, kind.__qualname__)
        if kind in _WRITTEN_OUT:
            self._write(repr(value))
        elif isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            flags = value.flags
            self._write(repr((value.dtype.descr, value.shape, flags.c_contiguous, flags.f_contiguous, flags.aligned)))
            self._write(value.tobytes())
        elif isinstance(value, dict):
            self.add(tuple(sorted(value.items())))
        elif isinstance(value, tuple):
            if kind is not tuple:
                self.add(kind)
            if _WRITTEN_OUT.issuperset(map(type, value)):
                self._write(repr(tuple(value)))
            else:
                self._write(str(len(value)))
                for item in value:
                    self.add(item)
        elif isinstance(value, frozenset):
            self._write(repr(sorted(map(repr, value))))
        elif isinstance(value, CodeType):
            self._add_code(value)
        elif isinstance(value, nb.types.Type):
            self.add(value.name if value.key is value.name else value.key)
        elif isinstance(value, Signature):
            self.add((value.return_type, value.args, value.recvr))
        elif isinstance(value, np.dtype):
            self._write(repr(value.descr))
        elif _is_versioned(value):
            self._write(value.__name__)
        elif isinstance(value, Dispatcher | _Intrinsic | FunctionType):
            self._write(str(len(self.functions)))
            self.functions.append(value)
        elif _has_fields(value):
            self._write(value.__module__, value.__qualname__)
            self.add((value._fields, getattr(value, "_field_defaults", {})))
        elif isinstance(value, type) and issubclass(value, Exception):  # identified by its name
            self._write(value.__module__, value.__qualname__)
        else:
            raise UnknownDependencyError(f"the dependencies of {value!r} are unknown")

    def _add_code(self, code: CodeType) -> None:
        names = (code.co_name, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        counts = (code.co_flags, code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount)
        self._write(code.co_code, code.co_exceptiontable, repr((names, counts)))
        self.add(code.co_consts)

    def add_read(self, code: CodeType, scope: dict[str, Any], by: tuple[str, ...], above: tuple[str, ...] = ()) -> None:
        """Add the module-level values that code reads.

        Values of simple kinds are added if the code mentions their name, read or not, which is fast. For other values
        the instructions are examined.

        Args:
            code: The code.
            scope: Names of the module.
            by: Instructions that read a name.
            above: Modules whose examination led to this one.

        Raises:
            UnknownDependencyError: The code reads a value of unknown kind.
        """
        for name in code.co_names:
            if name not in scope:
                continue
            value = scope[name]
            self._write(name)
            if isinstance(value, ModuleType):
                self._write(value.__name__)
                inside = value.__name__.partition(".")[0] not in _VERSIONED and value.__name__ not in above
                if inside:
                    self.add_read(code, vars(value), ("LOAD_ATTR", "LOAD_METHOD"), (*above, value.__name__))
            elif (
                # Kinds that are always known, so it is harmless if the kernel does not read them.
                isinstance(value, (Dispatcher, int, float, np.number, np.ndarray, _Intrinsic))
                or _has_fields(value)
                or any(each.opname in by and each.argval == name for each in dis.get_instructions(code))
            ):
                self.add(value)


def _has_fields(value: Any) -> bool:
    """True for named tuple classes."""
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")


def _is_versioned(value: Any) -> bool:
    """True for functions and classes whose package version identifies them."""
    if isinstance(value, np.ufunc):
        return True
    named = isinstance(value, FunctionType | BuiltinFunctionType | type)
    return named and str(value.__module__).partition(".")[0] in _VERSIONED
