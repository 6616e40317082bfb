"""Declared signatures: a kernel with declared argument types is compiled in parallel with its callers.

The types precede the decorator of a kernel::

    @declared(FLOAT_ROWS, FLOATS, float, int)
    @external
    def kernel(matrix, vector, x, k): ...

They are a hint only: for other types the kernel is compiled when a caller needs it. If the type of the
result is declared too, callers are compiled without the kernel::

    @declared(FLOATS, result=float)
    @external
    def kernel(vector): ...
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Sequence
from types import FunctionType, ModuleType
from typing import Annotated, Any, NamedTuple, TypeVar, get_type_hints

import numpy as np
from numba import types
from numpy.typing import NDArray

K = TypeVar("K")

FLOATS, FLOAT_ROWS = types.float64[::1], types.float64[:, ::1]
INTEGERS, INTEGER_ROWS = types.int64[::1], types.int64[:, ::1]
FLOAT_STACK = types.float64[:, :, ::1]
FLOAT_VIEW = types.float64[:, :]  # not contiguous, such as some columns of a matrix
FLOAT_COLUMNS = types.float64[::1, :]
FLAGS = types.boolean[::1]
THREE, FOUR = types.UniTuple(types.float64, 3), types.UniTuple(types.int64, 4)
TWO_FLOATS, FOUR_FLOATS = types.UniTuple(types.float64, 2), types.UniTuple(types.float64, 4)
READONLY = types.Array(types.float64, 1, "C", readonly=True)

Floats = Annotated[NDArray[np.float64], FLOATS]
FloatRows = Annotated[NDArray[np.float64], FLOAT_ROWS]
FloatStack = Annotated[NDArray[np.float64], FLOAT_STACK]
Integers = Annotated[NDArray[np.int64], INTEGERS]
IntegerRows = Annotated[NDArray[np.int64], INTEGER_ROWS]
Flags = Annotated[NDArray[np.bool_], FLAGS]
"""Annotations of array fields of a `NamedTuple` class that occurs in declared signatures."""

_NUMBERS = {float: types.float64, int: types.int64, np.int64: types.int64, bool: types.boolean}


class Job(NamedTuple):
    """A kernel to be compiled for some argument types."""

    module: str
    name: str
    types: tuple[Any, ...]
    needs: Sequence[int] = ()  # indices of jobs to compile before: inlined bitcode, or an undeclared result


def declared(*kinds: Any, result: Any = None) -> Callable[[K], K]:
    """Declare the types of a kernel's arguments, and of its result if callers are to be compiled without it.

    A type is float, int, bool, a numba type, a `Workspace` class, or a `NamedTuple` class whose fields are
    annotated with these or with array types (`Floats`, …).
    """

    def declare(kernel: K) -> K:
        if hasattr(kernel, "py_func"):  # else it is plain Python
            kernel.declared, kernel.result = kinds, result  # type: ignore[attr-defined]
        return kernel

    return declare


def numba_type(kind: Any) -> Any:
    """Return the numba type of a type that `declared` accepts."""
    if isinstance(kind, types.Type):
        return kind
    if kind in _NUMBERS:
        return _NUMBERS[kind]
    if hasattr(kind, "numba_type"):
        return kind.numba_type
    if hasattr(kind, "__metadata__"):
        return kind.__metadata__[0]
    fields = [numba_type(one) for one in get_type_hints(kind, include_extras=True).values()]
    if all(one == fields[0] for one in fields):
        return types.NamedUniTuple(fields[0], len(fields), kind)
    return types.NamedTuple(fields, kind)


def plain_tuple(kind: Any) -> Any:
    """Return the type of a plain tuple with the field types of a `NamedTuple` class."""
    return types.BaseTuple.from_types(numba_type(kind).types)


def declared_types(kernel: Any) -> tuple[Any, ...]:
    """Return the declared types of a kernel's arguments."""
    return tuple(map(numba_type, kernel.declared))


def declared_result(kernel: Any, types: tuple[Any, ...]) -> Any:
    """Return the type of a kernel's result; None if it is not declared for these argument types."""
    result = getattr(kernel, "result", None)
    return None if result is None or types != declared_types(kernel) else numba_type(result)


def callees(function: FunctionType) -> list[Any]:
    """Return the kernels that a kernel's Python function calls directly."""
    names = function.__code__.co_names
    seen = [function.__globals__.get(name) for name in names]
    seen += [cell.cell_contents for cell in function.__closure__ or ()]
    seen += [getattr(one, name, None) for one in seen if isinstance(one, ModuleType) for name in names]
    return [one for one in seen if hasattr(one, "py_func")]


def kernel_of(job: Job) -> Any:
    """Return the kernel of a job."""
    return getattr(importlib.import_module(job.module), job.name)


def is_bitcode(kernel: Any) -> bool:
    """Whether the cached code of a kernel is bitcode that its callers inline."""
    return getattr(kernel, "is_bitcode", False)


def jobs(wanted: Iterable[tuple[Any, Any]]) -> list[Job]:
    """Return the jobs for pairs (kernel, argument types), those with the longest critical path first."""
    given = dict(wanted)
    # each kernel with its callees, through those that are compiled within their callers
    inside: dict[Any, set[Any]] = {}
    order: list[Any] = []  # callees before callers

    def visit(kernel: Any) -> None:
        if kernel not in inside:
            inside[kernel] = {kernel}  # set first: an attribute of its own name looks like a call of itself
            for one in callees(kernel.py_func):
                visit(one)
                inside[kernel] |= {one} if is_job(one) else inside[one]
            order.append(kernel)

    def is_job(kernel: Any) -> bool:
        return kernel in given or hasattr(kernel, "declared")

    for kernel in given:
        visit(kernel)
    types_of = {one: given[one] if one in given else declared_types(one) for one in order if is_job(one)}
    needs = {
        one: [
            other
            for other in types_of
            if other in inside[one] - {one} and not declared_result(other, types_of[other])
        ]
        for one in types_of
    }
    own: dict[Any, int] = {}  # size of the bytecode that is lowered with each kernel
    whole: dict[Any, int] = {}  # size of the bytecode that is optimized with it, including inlined bitcode
    for one in types_of:
        own[one] = sum(
            len(inner.py_func.__code__.co_code) for inner in inside[one] if not is_job(inner) or inner is one
        )
        whole[one] = own[one] + sum(whole.get(other, 0) for other in inside[one] - {one} if is_bitcode(other))
    critical: dict[Any, int] = {}  # size of the code on the longest path from each kernel through its callers
    for one in reversed(types_of):
        code = own[one] if is_bitcode(one) else own[one] + whole[one]
        critical[one] = code + max(
            (critical[caller] for caller in critical if one in needs[caller]), default=0
        )
    ordered = sorted(types_of, key=lambda one: -critical[one])
    place = {one: k for k, one in enumerate(ordered)}
    return [
        Job(
            one.py_func.__module__,
            one.py_func.__qualname__,
            types_of[one],
            [place[other] for other in needs[one]],
        )
        for one in ordered
    ]
