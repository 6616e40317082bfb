"""Handling of signals, such as Ctrl-C, while a kernel runs."""

from __future__ import annotations

from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic


@intrinsic
def _answer_signals(typing_context):
    def generate(context, builder, signature, arguments):
        name, i32 = "PyErr_CheckSignals", ir.IntType(32)
        known = builder.module.globals.get(name)
        check = known or ir.Function(builder.module, ir.FunctionType(i32, []), name)
        raised = builder.icmp_signed("!=", builder.call(check, []), i32(0))
        with builder.if_then(raised, likely=False):
            context.call_conv.return_exc(builder)  # callers return as well, up to Python
        return context.get_dummy_value()

    return types.void(), generate


def _in_python() -> None:
    """Do nothing: the interpreter handles signals itself."""


answer_signals = _in_python if config.DISABLE_JIT else _answer_signals
"""Handle pending signals; an exception raised by a handler ends all running kernels.

Call it in loops that can take a second; a call takes nanoseconds. After an exception, output arguments are
partly written, and arrays that the kernels allocated are not freed. Do not call it in `jit.released`
kernels: the global interpreter lock must be held."""
