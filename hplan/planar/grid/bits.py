"""Hardware bit counting for numba kernels."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def _unary_bit_operation(name: str, *flags: bool) -> Any:
    """Wrap an LLVM intrinsic that maps a 64-bit word to a count."""

    @intrinsic
    def operation(typing_context: Any, word: Any) -> Any:
        del typing_context
        if word != types.uint64:
            return None

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            del context, signature
            word_type = ir.IntType(64)
            signature_types = [word_type, *(ir.IntType(1) for _ in flags)]
            function = builder.module.declare_intrinsic(name, [word_type], ir.FunctionType(word_type, signature_types))
            return builder.call(function, [arguments[0], *(ir.IntType(1)(int(f)) for f in flags)])

        return types.int64(types.uint64), generate

    return operation


#: Number of set bits of a uint64.
popcount = _unary_bit_operation("llvm.ctpop")

#: Index of the lowest set bit of a non-zero uint64.
lowest_bit = _unary_bit_operation("llvm.cttz", True)
