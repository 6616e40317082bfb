"""Calls of Python's and NumPy's own functions that kernels are full of, typed and lowered at once.

numba compiles a function of its own for each of them and for each kind of arguments, in every process anew,
which takes two seconds. What is made of other arguments is left to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numba import core
from numba.core import typing

types: Any = core.types

EXTREMES: dict[Any, str] = {max: ">", min: "<"}
"""A further number is taken where it is so against what has been found before, as in Python."""

_NUMBERS = (types.float64, types.int64, types.boolean)


def is_index(kind: Any) -> bool:
    """Whether a type is that of an integer as indices are."""
    return isinstance(kind, types.Integer) and kind.signed and kind.bitwidth == 64


def signature(called: Any, args: Sequence[Any], kws: Mapping[str, Any]) -> Any:
    """Return the types of a call, None where it is left to numba.

    Args:
        called: The function.
        args: The types of its arguments.
        kws: Those of arguments by name.
    """
    result = None
    if called is np.empty or called is np.zeros:
        if 1 <= len(args) <= 2 and len(args) + len(kws) <= 2 and set(kws) <= {"dtype"}:
            result = _array(args[0], [*args[1:], *kws.values()])
    elif called is int:
        if len(args) == 1 and not kws and args[0] in _NUMBERS:
            result = types.int64
    elif (called is max or called is min) and len(args) > 1 and not kws:
        if all(kind is types.float64 for kind in args):
            result = types.float64
        elif all(map(is_index, args)):
            result = types.int64
    return None if result is None else typing.signature(result, *args, *kws.values())


def _array(shape: Any, dtype: Sequence[Any]) -> Any:
    element = types.float64
    if dtype and isinstance(dtype[0], types.NumberClass):
        element = dtype[0].dtype
    elif dtype and getattr(dtype[0], "typing_key", None) is not float:
        return None
    dimensions = 1
    if isinstance(shape, types.BaseTuple):
        dimensions = len(shape) if all(map(is_index, shape.types)) else 0
    elif not is_index(shape):
        return None
    return types.Array(element, dimensions, "C") if dimensions and element in _NUMBERS else None


def extreme(builder: Any, called: Any, kind: Any, values: Sequence[Any]) -> Any:
    """Return the largest or smallest of numbers of LLVM's."""
    compare = builder.fcmp_ordered if kind is types.float64 else builder.icmp_signed
    found, *further = values
    for value in further:
        found = builder.select(compare(EXTREMES[called], value, found), value, found)
    return found
