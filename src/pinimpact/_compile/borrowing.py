"""Arrays whose references are not counted, for kernels that access them often.

numba counts references to an array at each slice and each copy of a tuple that holds it, by atomic
operations of some 5 ns. A kernel that borrows its arguments at its start avoids this: the caller owns them
for the length of the call.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import lower_builtin, type_callable


def borrowed(array: Any) -> Any:
    """Return an array argument of a kernel without a reference count.

    Only for arguments: numba frees the arrays that a kernel allocates after their last use. Neither the array
    nor a part of it may be returned.
    """
    return array


@type_callable(borrowed)
def _type(context: Any) -> Any:
    return lambda array: array if isinstance(array, types.Array) else None


@lower_builtin(borrowed, types.Array)
def _lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    array = context.make_array(signature.return_type)(context, builder, arguments[0])
    for owner in ("meminfo", "parent"):
        setattr(array, owner, context.get_constant_null(types.voidptr))
    return array._getvalue()
