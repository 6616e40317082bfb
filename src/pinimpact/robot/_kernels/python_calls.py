"""Calls from a kernel into Python: of a bound C++ function on buffers that the kernel fills and reads.

The global interpreter lock is held while a kernel runs, and its C interface is linked by name as numba's own
code links it. Functions and arguments are created once, so a call costs as much as from Python, without the
interpreter. A kernel cannot propagate an error: the error is stored, and `raise_kept_error` raises it when
the kernel has returned.
"""

from __future__ import annotations

import ctypes

from llvmlite import binding, ir
from numba import config, types
from numba.extending import intrinsic

from ..._compile.jit import inlined

_KEPT = "pinimpact_kept_error"
_kept = (ctypes.c_void_p * 3)()  # type, value and traceback, as PyErr_Fetch hands them out
binding.add_symbol(_KEPT, ctypes.addressof(_kept))

_call_object = types.ExternalFunction("PyObject_CallObject", types.intp(types.intp, types.intp))
_release = types.ExternalFunction("Py_DecRef", types.void(types.intp))


@intrinsic
def _keep_error(typing_context):
    """Store the interpreter's error, replacing one that was not raised."""

    def generate(context, builder, signature, arguments):
        word, i32 = context.get_value_type(types.intp), ir.IntType(32)
        fetch = _declared(builder, "PyErr_Fetch", [word.as_pointer()] * 3)
        release = _declared(builder, "Py_DecRef", [word])
        kept = context.get_c_value(builder, ir.ArrayType(word, 3), _KEPT)
        places = [builder.gep(kept, [i32(0), i32(k)]) for k in range(3)]
        forgotten = [builder.load(place) for place in places]
        builder.call(fetch, places)
        for item in forgotten:
            builder.call(release, [item])
        return context.get_dummy_value()

    return types.void(), generate


def _declared(builder, name, arguments):
    known = builder.module.globals.get(name)
    return known or ir.Function(builder.module, ir.FunctionType(ir.VoidType(), arguments), name)


def _call(function, arguments):
    """Call a Python object with a tuple of arguments, both given by address; return False if it raises.

    With NUMBA_DISABLE_JIT the error propagates at once.
    """
    result = _call_object(function, arguments)
    if result == 0:
        _keep_error()
        return False
    _release(result)
    return True


def _call_in_python(function, arguments):
    called, given = (ctypes.cast(int(item), ctypes.py_object).value for item in (function, arguments))
    called(*given)
    return True


call = _call_in_python if config.DISABLE_JIT else inlined(_call)


def raise_kept_error():
    """Raise the error that a call from a kernel has stored, if there is one."""
    error = tuple(_kept)
    if error[0] is not None:
        _kept[:] = [None, None, None]
        restore = ctypes.pythonapi.PyErr_Restore
        restore.argtypes, restore.restype = (ctypes.c_void_p,) * 3, None
        restore(*error)  # takes the references over; ctypes raises what it finds set
