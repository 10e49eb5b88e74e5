"""What threads in compiled code need to share work: numbers read and changed at once, and patience.

All of it is in one total order, as all threads see it.
"""

import os
from collections.abc import Callable
from typing import Any

from llvmlite import binding as llvm_binding  # pyright: ignore
from llvmlite import ir as llvm_ir  # pyright: ignore
from numba import njit
from numba import types as numba_types
from numba.core import cgutils as code_generation
from numba.extending import intrinsic as compiled_from

# The compiler's own tools, which have no type stubs.
llvm: Any = llvm_binding
ir: Any = llvm_ir
cgutils: Any = code_generation
types: Any = numba_types
intrinsic: Any = compiled_from

Generated = tuple[Any, Callable[..., Any]]

_SIZE = 8
"""Bytes of an integer."""


def _entry(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Return the pointer to an entry of an array."""
    kind = signature.args[0]
    array = context.make_array(kind)(context, builder, arguments[0])
    return cgutils.get_item_pointer(context, builder, kind, array, [arguments[1]])


@intrinsic
def fetch_add(_: Any, array: Any, index: Any, change: Any) -> Generated:
    """Add to an entry of an integer array and return what it was before."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _entry(context, builder, signature, arguments)
        return builder.atomic_rmw("add", pointer, arguments[2], "seq_cst")

    return types.int64(array, index, types.unliteral(change)), generate


@intrinsic
def load(_: Any, array: Any, index: Any) -> Generated:
    """Return an entry of an integer array as it is now."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load_atomic(_entry(context, builder, signature, arguments), "seq_cst", _SIZE)

    return types.int64(array, index), generate


@intrinsic
def store(_: Any, array: Any, index: Any, value: Any) -> Generated:
    """Set an entry of an integer array."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _entry(context, builder, signature, arguments)
        builder.store_atomic(arguments[2], pointer, "seq_cst", _SIZE)
        return context.get_dummy_value()

    return types.void(array, index, types.unliteral(value)), generate


@intrinsic
def pause(_: Any) -> Generated:
    """Wait for some cycles, leaving the core to its other thread, where the processor knows how."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        del signature, arguments
        processor = llvm.get_default_triple().split("-")[0]
        if processor in ("x86_64", "i686"):
            kind = ir.FunctionType(ir.VoidType(), [])
            builder.call(builder.module.declare_intrinsic("llvm.x86.sse2.pause", fnty=kind), [])
        elif processor in ("aarch64", "arm64"):
            kind = ir.FunctionType(ir.VoidType(), [ir.IntType(32)])
            hint = builder.module.declare_intrinsic("llvm.aarch64.hint", fnty=kind)
            builder.call(hint, [ir.IntType(32)(1)])
        return context.get_dummy_value()

    return types.void(), generate


_HAS_YIELD = os.name == "posix"
_yield = types.ExternalFunction("sched_yield", types.int32())


@njit(nogil=True)
def give_way() -> None:
    """Let others that wait for this processor go first, where the system knows how."""
    if _HAS_YIELD:
        _yield()
