"""What the machine code of a kernel depends on, as a digest: the code that runs is the code that stands there.

numba puts into the machine code of a kernel those that it calls or has inlined, and the values of the constants that it
reads. So the digest covers them, from one to the next: bytecode, options, defaults, what closures hold, constants,
fields of named tuples. Nothing of it depends on where a file lies or when it was written, and comments do not count.

What belongs to Python's library, to NumPy or numba goes by its name; `hplan.base.kernels` adds their versions. What is
not understood is refused, never left out. The one thing unseen is an `overload` that numba has been given for a plain
Python function somewhere else.
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

#: Packages whose version says what is in them.
_VERSIONED = frozenset(sys.stdlib_module_names) | {"numpy", "numba", "llvmlite"}

#: Values that their text tells from all others of their class.
_WRITTEN_OUT = frozenset((bool, int, float, complex, str, bytes, type(None), type(...)))

#: What is known of a function: a digest of its own, and the functions that it refers to.
_Own = tuple[bytes, tuple[Any, ...]]

#: Of functions seen before: their constants were frozen then.
_SEEN: dict[Any, _Own] = {}

#: Digests of what they and all that they refer to are.
_DIGESTS: dict[Any, str] = {}


class UnknownDependencyError(Exception):
    """A kernel reads something of which nobody can say whether it is still the same."""


def code_digest(kernel: Any, *, afresh: bool = False) -> str:
    """Digest of all that a kernel's machine code depends on, but for types of arguments, processor and versions.

    Args:
        kernel: What `numba.njit` returns.
        afresh: Whether constants are read again that were read before.

    Raises:
        UnknownDependencyError: It reads what is neither a number, a text, an array, a tuple, a function nor a class.
    """
    if afresh:
        return _digest([kernel], {})
    if kernel not in _DIGESTS:
        _DIGESTS[kernel] = _digest([kernel], _SEEN)
    return _DIGESTS[kernel]


def kernels_below(kernel: Any) -> list[Any]:
    """The compiled functions that one refers to, directly or by way of others; itself first.

    Raises:
        UnknownDependencyError: As for `code_digest`.
    """
    found = dict.fromkeys(_reached([kernel], _SEEN))
    return [function for function in found if isinstance(function, Dispatcher)]


def forget() -> None:
    """Look at everything again, for whoever asks next."""
    _SEEN.clear()
    _DIGESTS.clear()


def value_digest(value: Any) -> str:
    """Digest of a value that a kernel could read, types of numba's among them.

    Raises:
        UnknownDependencyError: It is of no known kind.
    """
    parts = _Parts()
    parts.add(value)
    return hashlib.sha256(parts.own + _digest(parts.functions, _SEEN).encode()).hexdigest()


def _digest(functions: Iterable[Any], seen: dict[Any, _Own]) -> str:
    """Digest of functions and all that they refer to, in the order in which they are met; again met, by number."""
    whole, numbers = hashlib.sha256(), dict[Any, int]()
    for function in _reached(functions, seen):
        if function in numbers:
            whole.update(b"again %d." % numbers[function])
        else:
            numbers[function] = len(numbers)
            whole.update(seen[function][0])
    return whole.hexdigest()


def _reached(functions: Iterable[Any], seen: dict[Any, _Own]) -> Iterator[Any]:
    """Functions and all that they refer to, as often as they are met; what is known of them is then seen."""
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
    """What is known of a function, or of numba's object for one."""
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
    """A function's code, and that of the functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


class _Parts:
    """What a function consists of, written so that different things never look alike.

    Attributes:
        own: What was added, but for functions.
    """

    def __init__(self) -> None:
        self.own = bytearray()
        self.functions: list[Any] = []

    def _write(self, *parts: str | bytes) -> None:
        for part in parts:
            data = part if isinstance(part, bytes) else part.encode("utf-8", "surrogatepass")
            self.own += b"%d:" % len(data) + data

    def add(self, value: Any) -> None:
        """Add a value.

        Raises:
            UnknownDependencyError: It is of no known kind.
        """
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
        elif isinstance(value, type) and issubclass(value, Exception):  # raised by its name
            self._write(value.__module__, value.__qualname__)
        else:
            raise UnknownDependencyError(f"nothing is known of {value!r}")

    def _add_code(self, code: CodeType) -> None:
        names = (code.co_name, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        counts = (code.co_flags, code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount)
        self._write(code.co_code, code.co_exceptiontable, repr((names, counts)))
        self.add(code.co_consts)

    def add_read(self, code: CodeType, scope: dict[str, Any], by: tuple[str, ...], above: tuple[str, ...] = ()) -> None:
        """Add what code reads, or seems to, of a module's names.

        Whatever bears a name that the code mentions is added, be it read or not, if its kind is a simple one: that is
        quick. For others the instructions are read.

        Args:
            by: Instructions that read them.
            above: Modules that this one is examined for.

        Raises:
            UnknownDependencyError: It reads a value of no known kind.
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
                # Kinds that are always known, so that it does not matter whether a kernel really reads them.
                isinstance(value, (Dispatcher, int, float, np.number, np.ndarray, _Intrinsic))
                or _has_fields(value)
                or any(each.opname in by and each.argval == name for each in dis.get_instructions(code))
            ):
                self.add(value)


def _has_fields(value: Any) -> bool:
    """True for classes of named tuples."""
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")


def _is_versioned(value: Any) -> bool:
    """True for functions and classes of packages whose version says what is in them."""
    if isinstance(value, np.ufunc):
        return True
    named = isinstance(value, FunctionType | BuiltinFunctionType | type)
    return named and str(value.__module__).partition(".")[0] in _VERSIONED
