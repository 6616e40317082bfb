"""Arrays as arguments of kernels: where their numbers are, and how many.

numba passes all that it knows of an array, seven values for a vector and nine for a matrix, which each caller
takes out of what holds the array and each callee puts together again: half of the instructions of kernels.
Two and three of them are enough where the array is contiguous and lives as long as the call. It does, unless
the kernel returns an array, which might be its argument: such a kernel takes its arguments numba's way.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from llvmlite import ir
from numba import core
from numba.core.datamodel import models
from numba.extending import NativeValue, register_model, unbox

types: Any = core.types

ARRAY = ("meminfo", "parent", "nitems", "itemsize", "data", "shape", "strides")
"""The fields of an array, as they are known here."""

MEMINFO, PARENT, NITEMS, ITEMSIZE, DATA, SHAPE, STRIDES = range(len(ARRAY))

_WIDTHS = {types.float64: 8, types.int64: 8, types.boolean: 1}
"""Bytes of the numbers that arrays hold."""


@cache
def counted(models: Any, kind: Any) -> bool:
    """Whether references to what a type stands for, or to a part of it, are counted."""
    found: bool = models[kind].contains_nrt_meminfo()
    return found


@cache
def has_fields(models: Any, kind: Any, fields: tuple[str, ...]) -> bool:
    """Whether a type is laid out with these fields."""
    return tuple(getattr(models[kind], "_fields", ())) == fields


class Lent(types.Type):
    """An argument that is, or holds, an array lent for the length of a call.

    It is told apart from what is not lent by its hash only: whoever looks for a kernel that takes such
    arguments finds one that has them lent.
    """

    def __init__(self, kind: Any) -> None:
        self.kind = kind
        super().__init__(f"Lent({kind})")

    def __eq__(self, other: object) -> bool:
        return bool(self.kind == (other.kind if isinstance(other, Lent) else other))

    def __hash__(self) -> int:
        return hash((Lent, self.kind))


def lent_arguments(manager: Any, arguments: tuple[Any, ...], result: Any) -> tuple[Any, ...]:
    """Return as what a kernel takes arguments of these types.

    Args:
        manager: Of numba's data models.
        arguments: Their types.
        result: The type that it returns.
    """
    if counted(manager, result):
        return arguments
    return tuple(_lent(manager, kind) for kind in arguments)


def _lent(manager: Any, kind: Any) -> Any:
    if isinstance(kind, types.BaseTuple):
        lent = any(isinstance(_lent(manager, one), Lent) for one in kind.types)
    else:
        array = isinstance(kind, types.Array) and has_fields(manager, kind, ARRAY)
        lent = array and kind.layout != "A" and kind.dtype in _WIDTHS and kind.ndim > 0
    return Lent(kind) if lent else kind


@register_model(Lent)
def _model(manager: Any, lent: Lent) -> Any:
    kind = lent.kind
    if isinstance(kind, types.Array):
        return _Array(manager, kind)
    parts = [_lent(manager, one) for one in kind.types]
    same = isinstance(kind, (types.UniTuple, types.NamedUniTuple))
    return manager[types.UniTuple(parts[0], len(parts)) if same else types.Tuple(parts)]


class _Array(models.ArrayModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind)
        self._array = kind

    def get_argument_type(self) -> tuple[Any, ...]:
        elements = self.get_value_type().elements
        return (elements[DATA], *elements[SHAPE].elements)

    def as_argument(self, builder: Any, value: Any) -> tuple[Any, ...]:
        shape = [builder.extract_value(value, (SHAPE, k)) for k in range(self._array.ndim)]
        return (builder.extract_value(value, DATA), *shape)

    def from_argument(self, builder: Any, value: Any) -> Any:
        data, *shape = value
        form, integer = self.get_value_type(), shape[0].type
        width = ir.Constant(integer, _WIDTHS[self._array.dtype])
        strides = [width]
        for length in shape[:0:-1] if self._array.layout == "C" else shape[:-1]:
            strides.append(builder.mul(strides[-1], length))
        if self._array.layout == "C":
            strides.reverse()
        count = shape[0]
        for length in shape[1:]:
            count = builder.mul(count, length)
        nobody = ir.Constant(form.elements[0], None)
        made = ir.Constant(form, ir.Undefined)
        for place, one in (
            *enumerate((nobody, nobody, count, width, data)),
            *(((SHAPE, k), length) for k, length in enumerate(shape)),
            *(((STRIDES, k), stride) for k, stride in enumerate(strides)),
        ):
            made = builder.insert_value(made, one, place)
        return made


@unbox(Lent)
def _unbox(lent: Lent, value: Any, context: Any) -> NativeValue:
    return context.unbox(lent.kind, value)
