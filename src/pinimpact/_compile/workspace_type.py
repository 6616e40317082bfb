"""Access to the fields of a `Workspace` in compiled code, by one pointer to slots of eight bytes."""

from __future__ import annotations

import functools
import hashlib
from typing import Any

from llvmlite import ir
from numba import errors, types
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
    unbox,
)

from .numba_internals import AttributeTemplate
from .sources import stamp

WIDTH = 8
"""Bytes of a slot, and of every number."""


class WorkspaceType(types.Type):
    """The numba type of a declaration.

    Its name depends on the declaration and on the code of this module: changes invalidate cached code.
    """

    def __init__(self, layout: tuple[tuple[Any, ...], ...]) -> None:
        self.layout = layout
        super().__init__(f"Workspace({hashlib.sha256((_CODE + repr(layout)).encode()).hexdigest()[:16]})")


_CODE = stamp(__name__)
_ADDRESS = ir.IntType(64)
_LOCAL: dict[str, types.Type] = {"_Size": types.int64, "_Count": types.int64, "_Integer": types.int64}
_LOCAL |= {"_Real": types.float64, "_Flag": types.boolean}


@register_model(WorkspaceType)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: WorkspaceType) -> None:
        super().__init__(manager, kind, ir.IntType(8).as_pointer())


@unbox(WorkspaceType)
def _unbox(kind: WorkspaceType, work: Any, context: Any) -> NativeValue:
    api, builder = context.pyapi, context.builder
    buffer = api.alloca_buffer()
    status = api.get_buffer(work, buffer)
    failed = builder.icmp_signed("!=", status, status.type(0))
    place = builder.load(
        builder.bitcast(buffer, ir.IntType(8).as_pointer().as_pointer())
    )  # first field of the buffer: the address of its data
    api.release_buffer(buffer)  # the workspace outlives the kernel
    return NativeValue(place, is_error=failed)


@infer_getattr
class _Typing(AttributeTemplate):
    key = WorkspaceType

    def generic_resolve(self, kind: WorkspaceType, name: str) -> types.Type | None:
        for declared, field, *rest in kind.layout:
            if declared == name:
                return _array_type(*rest) if field == "_Array" else _LOCAL[field]
        return None


def _array_type(dtype: str, dims: tuple[str | int, ...], order: str) -> types.Array:
    element: Any = types.float64 if dtype == "<f8" else types.int64
    return types.Array(element, len(dims), "C" if order == "C" else "F")


def _slot_of(kind: WorkspaceType, name: str | int) -> int:
    return next(slot for slot, (declared, *_) in enumerate(kind.layout) if declared == name)


def _slot(builder: Any, pointer: Any, slot: int, element: Any) -> Any:
    place = builder.gep(pointer, [ir.Constant(_ADDRESS, WIDTH * slot)])
    return builder.bitcast(place, element.as_pointer())


def _load_integer(builder: Any, kind: WorkspaceType, pointer: Any, name: str | int) -> Any:
    return builder.load(_slot(builder, pointer, _slot_of(kind, name), _ADDRESS))


def _packed(builder: Any, integers: list[Any]) -> Any:
    made = ir.Constant(ir.ArrayType(_ADDRESS, len(integers)), ir.Undefined)
    for place, one in enumerate(integers):
        made = builder.insert_value(made, one, place)
    return made


@lower_getattr_generic(WorkspaceType)
def _read(context: Any, builder: Any, kind: WorkspaceType, pointer: Any, name: str) -> Any:
    slot = _slot_of(kind, name)
    _, field, *rest = kind.layout[slot]
    if field == "_Real":
        return builder.load(_slot(builder, pointer, slot, ir.DoubleType()))
    value = builder.load(_slot(builder, pointer, slot, _ADDRESS))
    if field == "_Flag":
        return builder.icmp_unsigned("!=", value, ir.Constant(_ADDRESS, 0))
    if field != "_Array":
        return value
    _, dims, order = rest
    shape = [
        ir.Constant(_ADDRESS, dim) if isinstance(dim, int) else _load_integer(builder, kind, pointer, dim)
        for dim in dims
    ]
    width = ir.Constant(_ADDRESS, WIDTH)
    strides = [width]
    for length in shape[:0:-1] if order == "C" else shape[:-1]:
        strides.append(builder.mul(strides[-1], length))
    array_type = _array_type(*rest)
    array = context.make_array(array_type)(context, builder)  # its owner, `meminfo`, is null
    array.data = builder.inttoptr(value, array.data.type)
    array.itemsize = width
    array.nitems = functools.reduce(builder.mul, shape)
    array.shape = _packed(builder, shape)
    array.strides = _packed(builder, strides[::-1] if order == "C" else strides)
    return array._getvalue()


@lower_setattr_generic(WorkspaceType)
def _write(context: Any, builder: Any, signature: Any, arguments: Any, name: str) -> None:
    kind = signature.args[0]
    slot = _slot_of(kind, name)
    _, field, *rest = kind.layout[slot]
    if field in ("_Array", "_Size"):
        raise errors.NumbaTypeError(f"{name} cannot be set in a kernel")
    pointer, value = arguments
    value = context.cast(builder, value, signature.args[1], _LOCAL[field])
    if field == "_Count":
        limit = _load_integer(builder, kind, pointer, rest[0])
        with builder.if_then(builder.icmp_unsigned(">", value, limit), likely=False):
            message = f"{name} set to more than {rest[0]}"
            context.call_conv.return_user_exc(builder, ValueError, (message,))
    if field == "_Flag":
        value = builder.zext(value, _ADDRESS)
    builder.store(value, _slot(builder, pointer, slot, value.type))
