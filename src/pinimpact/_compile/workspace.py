"""Arrays and numbers that kernels and Python share by name.

A subclass of `Workspace` declares the fields, from which memory, checks and access are derived::

    class Pendulum(Workspace):
        nv = size("velocities")
        active = count("nv", "number of drives")
        length = real("of the rod [m]")
        torque = reals("active", meaning="of the drives [N m]")
        mass_matrix = reals("nv", "nv", order="F", given=True, meaning="in the memory of the library")

Python and kernels both read `work.torque` and `work.length`, and set `work.length = 2.0`.

In compiled code a workspace is one pointer to slots of eight bytes in the order of the declaration. A slot
holds the value of a size, count or number, or the address of an array. The shape of an array consists of
sizes and counts, and stays within its memory: kernels cannot change sizes, and a count is checked against its
limit when it is set. (Passing a workspace to a kernel takes 0.2 µs longer than passing an integer; numba's
`structref` takes 0.5 µs, and its code counts references.)
"""

from __future__ import annotations

import array
import ctypes
import functools
import math
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, NamedTuple, NoReturn, TypeVar, overload

import numpy as np
from numba.extending import typeof_impl
from numpy.typing import NDArray

from .workspace_type import WIDTH, WorkspaceType

T = TypeVar("T")
Declared = TypeVar("Declared", bound="_Field[Any]")


class _Field(Generic[T]):
    """A declared field, with its index in the memory (`slot`) and its description (`meaning`)."""

    name: str
    slot: int

    def __init__(self, meaning: str) -> None:
        self.meaning = meaning

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self: Declared, work: None, owner: type) -> Declared: ...
    @overload
    def __get__(self, work: Workspace, owner: type) -> T: ...
    def __get__(self, work: Workspace | None, owner: type) -> Any:
        raise NotImplementedError

    def __set__(self, work: Workspace, value: Any) -> None:
        raise AttributeError(f"{self.name} cannot be set; it is fixed when the workspace is created")

    def layout(self) -> tuple[Any, ...]:
        """Return the part of the declaration on which compiled code depends."""
        return (self.name, type(self).__name__)


class _Size(_Field[int]):
    def __get__(self, work: Workspace | None, owner: type) -> Any:
        return self if work is None else work.integers.item(self.slot)


class _Count(_Size):
    def __init__(self, limit: str, meaning: str) -> None:
        super().__init__(meaning)
        self.limit = limit

    def __set__(self, work: Workspace, value: int) -> None:
        limit = getattr(work, self.limit)
        if not 0 <= value <= limit:
            raise ValueError(f"{self.name}: {value} given, 0 to {self.limit} = {limit} expected")
        work.integers[self.slot] = value

    def layout(self) -> tuple[Any, ...]:
        return (*super().layout(), self.limit)


class _Real(_Field[float]):
    def __get__(self, work: Workspace | None, owner: type) -> Any:
        return self if work is None else work.numbers.item(self.slot)

    def __set__(self, work: Workspace, value: float) -> None:
        work.numbers[self.slot] = value


class _Integer(_Size):
    def __set__(self, work: Workspace, value: int) -> None:
        work.integers[self.slot] = value


class _Flag(_Field[bool]):
    def __get__(self, work: Workspace | None, owner: type) -> Any:
        return self if work is None else work.integers.item(self.slot) != 0

    def __set__(self, work: Workspace, value: bool) -> None:
        work.integers[self.slot] = value


class _Array(_Field[NDArray[Any]]):
    def __init__(
        self, dtype: type, dims: tuple[str | int, ...], order: str, given: bool, meaning: str
    ) -> None:
        super().__init__(meaning)
        self.dtype = np.dtype(dtype)
        self.dims = dims
        self.order = order
        self.given = given
        self.counts: tuple[int, ...] = ()  # slots of the counts in its shape

    def __get__(self, work: Workspace | None, owner: type) -> Any:
        if work is None:
            return self
        if self.counts:
            used = tuple([work.integers.item(slot) for slot in self.counts])
            known = work.used.get(self.name)
            if known is not None and known[0] == used:
                return known[1]
            part = self._in_use(work)
            work.used[self.name] = used, part
            return part
        whole = work.arrays.get(self.name)
        return work.whole(self) if whole is None else whole

    def _in_use(self, work: Workspace) -> NDArray[Any]:
        """Return the part that is in use according to the counts."""
        shape = tuple(dim if isinstance(dim, int) else getattr(work, dim) for dim in self.dims)
        return work.whole(self).ravel()[: math.prod(shape)].reshape(shape)

    def layout(self) -> tuple[Any, ...]:
        return (*super().layout(), self.dtype.str, self.dims, self.order)


def size(meaning: str) -> _Size:
    """Declare a length, set when the workspace is created; `Workspace.enlarge` can increase it."""
    return _Size(meaning)


def count(limit: str, meaning: str) -> _Count:
    """Declare a variable length of at most the size `limit`; initially zero."""
    return _Count(limit, meaning)


def real(meaning: str) -> _Real:
    """Declare a number; initially zero."""
    return _Real(meaning)


def integer(meaning: str) -> _Integer:
    """Declare an integer; initially zero."""
    return _Integer(meaning)


def flag(meaning: str) -> _Flag:
    """Declare a truth value; initially false."""
    return _Flag(meaning)


def reals(*dims: str | int, meaning: str, order: str = "C", given: bool = False) -> _Array:
    """Declare an array of float64.

    Args:
        dims: Its shape: names of sizes or counts, or integers. Memory is allocated for the limits of counts;
            the part in use is contiguous and at the start.
        meaning: Its description.
        order: "C", or "F" for column-major.
        given: Whether the array is an argument of the constructor instead of being allocated.
    """
    return _Array(float, dims, order, given, meaning)


def integers(*dims: str | int, meaning: str, given: bool = False) -> _Array:
    """Declare an array of int64, like `reals`."""
    return _Array(np.int64, dims, "C", given, meaning)


class Workspace(array.array):
    """The memory of declared fields, as described in the module.

    The base class is an array of the slots: numba distinguishes subclasses of `array.array` without a call
    into Python, but takes all subclasses of `bytearray` for the first one that it has seen.

    Args:
        sizes: The value of each size.
        arrays: Arrays by name, required for fields with ``given=True``; others are allocated as zeros.

    Raises:
        ValueError: Sizes or arrays that differ from the declaration.
    """

    fields: ClassVar[dict[str, _Field[Any]]] = {}
    numba_type: ClassVar[WorkspaceType]
    _declared: ClassVar[list[tuple[_Array, tuple[str | int, ...]]]] = []
    _numbers: ClassVar[NDArray[np.int64]]

    def __init_subclass__(cls) -> None:
        cls.fields = {name: item for name, item in vars(cls).items() if isinstance(item, _Field)}
        for slot, field in enumerate(cls.fields.values()):
            field.slot = slot
        limits = {name: getattr(field, "limit", name) for name, field in cls.fields.items()}
        cls._declared = [  # arrays, with the shape of their memory
            (field, tuple(limits.get(dim, dim) for dim in field.dims))  # type: ignore[arg-type]
            for field in cls.fields.values()
            if isinstance(field, _Array)
        ]
        for field, dims in cls._declared:
            names = [name for name, limit in zip(field.dims, dims, strict=True) if name != limit]
            field.counts = tuple({cls.fields[str(name)].slot for name in names})
        numbers = [f.slot for f in cls.fields.values() if not isinstance(f, _Array) and type(f) is not _Size]
        cls._numbers = np.array(numbers, dtype=np.int64)
        cls.numba_type = WorkspaceType(tuple(field.layout() for field in cls.fields.values()))

    def __new__(cls, sizes: Mapping[str, int], arrays: Mapping[str, NDArray[Any]]) -> Any:
        return super().__new__(cls, "q", bytes(WIDTH * len(cls.fields)))

    def __init__(self, sizes: Mapping[str, int], arrays: Mapping[str, NDArray[Any]]) -> None:
        # from an address: views with a reference to `self` would be a cycle that the garbage collector cannot
        # see, since it does not traverse NumPy arrays
        memory = (ctypes.c_int64 * len(self)).from_address(self.buffer_info()[0])
        self.integers = np.ctypeslib.as_array(memory)
        self.numbers = self.integers.view(np.float64)
        self._fixed = memoryview(self)  # prevents a reallocation of the memory
        self.arrays: dict[str, NDArray[Any]] = dict(arrays)
        self.used: dict[str, tuple[tuple[int, ...], NDArray[Any]]] = {}
        self._given = tuple(arrays)
        for field, shape in self._lay_out(dict(sizes)).given:
            array = arrays[field.name]
            _check(field, array, shape)
            self.integers[field.slot] = array.__array_interface__["data"][0]

    def _lay_out(self, sizes: dict[str, int]) -> _Plan:
        """Allocate the memory of the arrays that are not given, as zeros, and return its layout."""
        plan = _plan(type(self), tuple(sizes.items()), self._given)
        self.arrays = {name: self.arrays[name] for name in self._given}
        self.used.clear()
        for slot, value in plan.sizes:
            self.integers[slot] = value
        self._sizes, self._places = sizes, plan.places
        self._allocated = np.zeros(plan.length)
        self.integers[plan.slots] = self._allocated.__array_interface__["data"][0] + plan.offsets
        return plan

    def whole(self, field: _Array) -> NDArray[Any]:
        """Return an array with its full memory, including the part not in use."""
        array = self.arrays.get(field.name)
        if array is None:
            place, shape = self._places[field.name]
            part = self._allocated[place : place + math.prod(shape)].view(field.dtype)
            array = self.arrays[field.name] = part.reshape(shape, order="C" if field.order == "C" else "F")
        return array

    def enlarge(self, sizes: Mapping[str, int]) -> None:
        """Increase some sizes and keep all values; views taken before are not updated.

        Only for sizes that are limits of counts and occur in allocated arrays: their part in use is at the
        start of the memory and keeps its place.
        """
        grown = {name: value for name, value in sizes.items() if value > self._sizes[name]}
        if not grown:
            return
        allocated = [field for field, _ in self._declared if field.name in self._places]
        before = [self.whole(field).ravel(order="K") for field in allocated]
        self._lay_out(self._sizes | grown)
        for field, old in zip(allocated, before, strict=True):
            self.whole(field).ravel(order="K")[: old.size] = old

    def values(self) -> tuple[dict[str, int], NDArray[np.int64], NDArray[np.float64]]:
        """Return the sizes and copies of all numbers and allocated arrays."""
        return self._sizes, self.integers[self._numbers], self._allocated.copy()

    def set_values(self, values: tuple[dict[str, int], NDArray[np.int64], NDArray[np.float64]]) -> None:
        """Restore the result of `values`, including sizes that `enlarge` has changed since."""
        sizes, numbers, allocated = values
        if sizes != self._sizes:
            self._lay_out(sizes)
        self.integers[self._numbers] = numbers
        self._allocated[:] = allocated

    def __reduce_ex__(self, *arguments: Any) -> NoReturn:
        raise TypeError("a workspace holds addresses of memory; it cannot be copied or pickled")

    __copy__ = __deepcopy__ = __reduce_ex__

    def __repr__(self) -> str:
        rows = [f"{type(self).__name__}:"]
        for name, field in self.fields.items():
            value = getattr(self, name)
            rows.append(f"  {name} = {value.shape if isinstance(field, _Array) else value}: {field.meaning}")
        return "\n".join(rows)


class _Plan(NamedTuple):
    """The layout of the arrays of a workspace."""

    sizes: list[tuple[int, int]]  # slot and value of each size
    given: list[tuple[_Array, tuple[int, ...]]]  # given arrays and their shapes
    places: dict[str, tuple[int, tuple[int, ...]]]  # allocated arrays: start in the memory, and shape
    length: int  # length of the memory of allocated arrays
    slots: NDArray[np.int64]  # slots of the addresses of allocated arrays
    offsets: NDArray[np.int64]  # their starts in the memory [bytes]


@functools.lru_cache(maxsize=128)
def _plan(kind: type[Workspace], sizes: tuple[tuple[str, int], ...], names: tuple[str, ...]) -> _Plan:
    """Return the layout for sizes, and for the names of the given arrays."""
    fields, values = kind.fields, dict(sizes)
    declared = [name for name, field in fields.items() if type(field) is _Size]
    if set(values) != set(declared):
        raise ValueError(f"sizes: {sorted(values)} given, {sorted(declared)} expected")
    unknown = [name for name in names if not isinstance(fields.get(name), _Array)]
    if unknown:
        raise ValueError(f"arrays: {unknown} given, which are not declared")
    given, places, length = [], {}, 0
    for field, dims in kind._declared:
        shape = tuple(values[dim] if isinstance(dim, str) else dim for dim in dims)
        if field.name in names:
            given.append((field, shape))
        elif field.given:
            raise ValueError(f"{field.name}: missing ({field.meaning})")
        else:
            places[field.name] = length, shape
            length += math.prod(shape)
    return _Plan(
        [(fields[name].slot, value) for name, value in sizes],
        given,
        places,
        length,
        np.array([fields[name].slot for name in places], dtype=np.int64),
        np.array([WIDTH * place for place, _ in places.values()], dtype=np.int64),
    )


def _check(field: _Array, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Raise an error for an array that differs from its declaration."""
    contiguous = array.flags.c_contiguous if field.order == "C" else array.flags.f_contiguous
    if array.shape != shape or array.dtype != field.dtype or not (contiguous and array.flags.aligned):
        raise ValueError(
            f"{field.name}: {array.dtype}, shape {array.shape}, strides {array.strides} given; "
            f"{field.dtype}, shape {shape}, in order {field.order} expected ({field.meaning})"
        )


@typeof_impl.register(Workspace)
def _typeof(work: Workspace, context: Any) -> WorkspaceType:
    return work.numba_type
