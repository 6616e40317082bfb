"""Arrays whose references are not counted, for kernels that allocate arrays and read others often.

numba counts references to an array at each slice and each copy of a tuple that holds it, by atomic
operations of about 5 ns. A kernel that borrows its arguments at its start avoids this: the caller owns them
for the duration of the call. (Kernels that allocate nothing are compiled without counts, see `linking`.)
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import lower_builtin, type_callable


def borrowed(array: Any) -> Any:
    """Return an array argument of a kernel, or a tuple of them, without reference counts.

    For arguments only: numba frees the arrays that a kernel allocates after their last counted use. Neither
    the array nor a part of it may be returned.
    """
    return array


@type_callable(borrowed)
def _type(context: Any) -> Any:
    return lambda array: array if isinstance(array, (types.Array, types.BaseTuple)) else None


@lower_builtin(borrowed, types.Array)
@lower_builtin(borrowed, types.BaseTuple)
def _lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return _without_owner(context, builder, signature.return_type, arguments[0])


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.BaseTuple):
        for i, field in enumerate(kind.types):
            part = _without_owner(context, builder, field, builder.extract_value(value, i))
            value = builder.insert_value(value, part, i)
        return value
    if not isinstance(kind, types.Array):
        return value
    array = context.make_array(kind)(context, builder, value)
    for owner in ("meminfo", "parent"):
        setattr(array, owner, context.get_constant_null(types.voidptr))
    return array._getvalue()
