"""Arrays and numbers that kernels share by name: one declaration gives memory, checks and access.

A subclass of `Workspace` declares the fields::

    class Pendulum(Workspace):
        nv = size("velocities")
        active = count("nv", "number of drives")
        length = real("of the rod [m]")
        torque = reals("active", meaning="of the drives [N m]")
        mass_matrix = reals("nv", "nv", order="F", given=True, meaning="in the memory of the library")

Python and kernels both read `work.torque`, `work.length` and write `work.length = 2.0`.

In compiled code a workspace is one pointer to slots of eight bytes in the order of the declaration: the
value of a size, count or number, or the address of an array. The shape of an array consists of sizes and
counts, so code cannot read beyond it: kernels do not change sizes, and a count is checked against its limit
whenever it is set. (Passing a workspace to a kernel costs 0.2 µs more than passing an integer; numba's
`structref` 0.5 µs, with code that counts references.)
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
    """One name of a declaration, with its index in the memory (`slot`) and its description (`meaning`)."""

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
        raise AttributeError(f"{self.name} cannot be set; it was given when the workspace was made")

    def layout(self) -> tuple[Any, ...]:
        """The part of the declaration on which compiled code depends."""
        return (self.name, type(self).__name__)


class _Size(_Field[int]):
    def __get__(self, work: Workspace | None, owner: type) -> Any:
        return self if work is None else work.integers.item(self.slot)


class _Count(_Size):
    def __init__(self, limit: str, meaning: str) -> None:
        super().__init__(meaning)
        self.limit = limit

    def __set__(self, work: Workspace, value: int) -> None:
        if not 0 <= value <= getattr(work, self.limit):
            raise ValueError(f"{self.name}: {value} set, at most {self.limit} = {getattr(work, self.limit)}")
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
        self.counts: tuple[int, ...] = ()  # slots of those in its shape

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
    """Declare a length that is given when the workspace is created; see `Workspace.enlarge`."""
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

    Its shape consists of sizes or counts by name, or integers. With counts it has room for their limits, and
    the part in use is at its front, contiguous. The order is "C", or "F" for column-major. The memory of one
    that is `given` is given when the workspace is created.
    """
    return _Array(float, dims, order, given, meaning)


def integers(*dims: str | int, meaning: str, given: bool = False) -> _Array:
    """Declare an array of int64, like `reals`."""
    return _Array(np.int64, dims, "C", given, meaning)


class Workspace(array.array):
    """The memory that a declaration describes; see the module.

    It is an array of the slots: numba distinguishes the classes of such buffers without a call into Python,
    but not those of bytearrays, of which it knows only the first class that it has seen. It is made with the
    value of each size, and with arrays to use, which are required where `given`; others are allocated, and
    zero. Raises `ValueError` for anything else than declared.
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
        cls._declared = [  # with the sizes that bound their shape
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
        # views that refer to it would keep it for ever: the garbage collector does not follow NumPy's arrays
        memory = (ctypes.c_int64 * len(self)).from_address(self.buffer_info()[0])
        self.integers = np.ctypeslib.as_array(memory)
        self.numbers = self.integers.view(np.float64)
        self._fixed = memoryview(self)  # keeps the memory from being moved
        self.arrays: dict[str, NDArray[Any]] = dict(arrays)
        self.used: dict[str, tuple[tuple[int, ...], NDArray[Any]]] = {}
        self._handed = tuple(arrays)
        for field, shape in self._lay_out(dict(sizes)).handed:
            array = arrays[field.name]
            _check(field, array, shape)
            self.integers[field.slot] = array.__array_interface__["data"][0]

    def _lay_out(self, sizes: dict[str, int]) -> _Plan:
        """Make the memory of the allocated arrays, zero; return its layout."""
        plan = _plan(type(self), tuple(sizes.items()), self._handed)
        self.arrays = {name: self.arrays[name] for name in self._handed}
        self.used.clear()
        for slot, value in plan.sizes:
            self.integers[slot] = value
        self._sizes, self._places = sizes, plan.places
        self._made = np.zeros(plan.room)
        self.integers[plan.slots] = self._made.__array_interface__["data"][0] + plan.offsets
        return plan

    def whole(self, field: _Array) -> NDArray[Any]:
        """Return an array with its full length."""
        array = self.arrays.get(field.name)
        if array is None:
            place, shape = self._places[field.name]
            part = self._made[place : place + math.prod(shape)].view(field.dtype)
            array = self.arrays[field.name] = part.reshape(shape, order="C" if field.order == "C" else "F")
        return array

    def enlarge(self, sizes: Mapping[str, int]) -> None:
        """Increase some sizes and keep all values; only sizes that limit counts, of allocated arrays.

        The part of an array in use is at its front, by the counts. Views taken before are not updated.
        """
        grown = {name: value for name, value in sizes.items() if value > self._sizes[name]}
        if not grown:
            return
        made = [field for field, _ in self._declared if field.name in self._places]
        before = [self.whole(field).ravel(order="K") for field in made]
        self._lay_out(self._sizes | grown)
        for field, old in zip(made, before, strict=True):
            self.whole(field).ravel(order="K")[: old.size] = old

    def values(self) -> tuple[dict[str, int], NDArray[np.int64], NDArray[np.float64]]:
        """Return a copy of all values, without those of arrays that were given."""
        return self._sizes, self.integers[self._numbers], self._made.copy()

    def set_values(self, values: tuple[dict[str, int], NDArray[np.int64], NDArray[np.float64]]) -> None:
        """Set all to `values` of the same sizes, except for those that `enlarge` grows, which it takes."""
        sizes, numbers, made = values
        if sizes != self._sizes:
            self._lay_out(sizes)
        self.integers[self._numbers] = numbers
        self._made[:] = made

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
    handed: list[tuple[_Array, tuple[int, ...]]]  # the given arrays, and their shapes
    places: dict[str, tuple[int, tuple[int, ...]]]  # of allocated arrays: position in the memory, and shape
    room: int  # number of values of all of them
    slots: NDArray[np.int64]  # slots of their addresses, and bytes from the start of the memory
    offsets: NDArray[np.int64]


@functools.lru_cache(maxsize=128)
def _plan(kind: type[Workspace], sizes: tuple[tuple[str, int], ...], handed: tuple[str, ...]) -> _Plan:
    """Return the layout for these sizes, with the given arrays by name."""
    fields, values = kind.fields, dict(sizes)
    declared = [name for name, field in fields.items() if type(field) is _Size]
    if set(values) != set(declared):
        raise ValueError(f"sizes: {sorted(values)} given, {sorted(declared)} expected")
    unknown = [name for name in handed if not isinstance(fields.get(name), _Array)]
    if unknown:
        raise ValueError(f"arrays: {unknown} given, which are not declared")
    given, places, room = [], {}, 0  # what is made stands one after the other
    for field, dims in kind._declared:
        shape = tuple(values[dim] if isinstance(dim, str) else dim for dim in dims)
        if field.name in handed:
            given.append((field, shape))
        elif field.given:
            raise ValueError(f"{field.name}: missing ({field.meaning})")
        else:
            places[field.name] = room, shape
            room += math.prod(shape)
    return _Plan(
        [(fields[name].slot, value) for name, value in sizes],
        given,
        places,
        room,
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
