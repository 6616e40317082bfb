"""Calls from a kernel into Python: of a bound C++ function on buffers that the kernel fills and reads.

The interpreter's lock is held while a kernel runs, and its C interface is linked by name as numba's own code
links it. Neither function nor arguments are made anew, so a call costs what it costs from Python, less the
interpreter.
"""

from __future__ import annotations

from numba import types

from ..._numeric.jit import inner

_call_object = types.ExternalFunction("PyObject_CallObject", types.intp(types.intp, types.intp))
_release = types.ExternalFunction("Py_DecRef", types.void(types.intp))
_forget_error = types.ExternalFunction("PyErr_Clear", types.void())


@inner
def call(function, arguments):
    """Call a Python object with a tuple of arguments, both given by address; return False if it raises."""
    result = _call_object(function, arguments)
    if result == 0:
        _forget_error()
        return False
    _release(result)
    return True
