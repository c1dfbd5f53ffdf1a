"""Memory fetched ahead of its use: a kernel's way to say what hardware does not guess."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def _prefetch(_: Any, array: types.Array, index: types.Integer) -> Any:
    """Types and code of a call."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = ir.IntType(32)
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        place = builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer())
        function = ir.FunctionType(ir.VoidType(), [place.type, word, word, word])
        call = builder.module.declare_intrinsic("llvm.prefetch", [place.type], function)
        read, all_levels, is_data = (ir.Constant(word, value) for value in (0, 3, 1))
        builder.call(call, [place, read, all_levels, is_data])
        return context.get_dummy_value()

    return types.void(array, index), generate


prefetch: Any = intrinsic(_prefetch)
"""``prefetch(array, index)`` asks for the cache line that holds a number of a flat array; nothing else happens."""
