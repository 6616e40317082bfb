"""Checks of user input: arrays and numbers, with errors that name the field and the expected value."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Array
from .errors import InputError, UnknownNameError

T = TypeVar("T")

_DOUBLE = np.dtype(np.float64)


def with_valid(template: T, **values: Any) -> T:
    """Return a copy of a frozen dataclass with other values of some fields, which are not checked."""
    kind: Any = type(template)
    copy, given = object.__new__(kind), template.__dict__
    copy.__dict__.update({name: given[name] for name in _field_names(kind)} | values)
    return copy


@cache
def _field_names(kind: Any) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


def real_numbers(field: str, value: Any, expected: str = "an array of real numbers") -> Array:
    """Return `value` as a float64 array, or raise `InputError` naming `field`.

    Complex numbers, text, dates, bools and masked entries raise an error, although NumPy would convert them.
    """
    if type(value) is np.ndarray and value.dtype == _DOUBLE:
        return value
    if np.ma.is_masked(value):
        raise InputError(
            f"{field}: the array has masked entries; {expected} is expected, for instance .filled(0)",
            value=value,
        )
    try:
        array = np.asarray(value)
        if array.dtype.kind == "O" and not any(isinstance(x, _NOT_REAL) for x in array.flat):
            return np.asarray(array, dtype=np.float64)
        if array.dtype.kind in "fiu" or array.size == 0:
            return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError):
        pass
    raise InputError(f"{field}: {in_short(value)} given; {expected} is expected", value=value)


_NOT_REAL = (
    str,
    bytes,
    bool,
    np.bool_,
    complex,
    np.complexfloating,
    np.datetime64,
    np.timedelta64,
    type(None),
)


def real_number(field: str, value: Any) -> float:
    """Return `value` as a float, which may be NaN or infinite, or raise `InputError` naming `field`."""
    if type(value) is float:
        return value
    array = real_numbers(field, value, "a real number")
    if array.size != 1:
        raise InputError(f"{field}: shape {array.shape} given; a number is expected", value=value)
    return float(array.reshape(()))


def in_short(value: Any) -> str:
    """Return the representation of a value for messages, in one line of at most 80 characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:77]}..."


def file_path(field: str, path: Any) -> Path:
    """Return `path` as a `Path`, or raise `InputError`."""
    if not isinstance(path, (str, Path)):
        raise InputError(f"{field}: {in_short(path)} given, a path expected", value=path)
    return Path(path)


def output_file(field: str, path: str | Path) -> Path:
    """Return the path of a file to be written.

    Raises:
        InputError: A folder, a file in a missing folder, or a path that no file can have.
    """
    path = file_path(field, path)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:  # a name too long, or with characters that are not allowed
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"{field}: {in_short(str(path))} cannot be a file: {reason}", value=str(path)
        ) from error
    if path.is_dir():
        raise InputError(f"{field}: {path} is a folder; add the name of a file", value=str(path))
    if not path.absolute().parent.is_dir():
        raise InputError(
            f"{field}: there is no folder {path.absolute().parent}; create it first, or give another path",
            value=str(path),
        )
    return path


def float_array(field: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return `value` as a contiguous float64 array of `shape`, or raise `InputError` naming `field`.

    A number is accepted for shape (1,). The array is writable, because numba would compile kernels again for
    read-only arrays.
    """
    if type(value) is np.ndarray and value.dtype == _DOUBLE and value.shape == shape and value.flags.carray:
        return value
    given = real_numbers(field, value, f"an array of real numbers of shape {shape}")
    array = np.atleast_1d(given if given.flags.carray else np.array(given, order="C"))
    if array.shape != shape:
        raise InputError(f"{field}: shape {array.shape} given, {shape} expected", value=value)
    return array


def finite_array(field: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Like `float_array`, and raise `InputError` for NaN and infinity."""
    array = float_array(field, value, shape)
    squares = np.vdot(
        array, array
    )  # a fast check; it overflows for large numbers, which are then checked one by one
    if not math.isfinite(squares) and not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array)).tolist()
        first = f"{array[tuple(where[0])]} at {where[0]}"
        raise InputError(
            f"{field}: {first}; {len(where)} of {array.size} numbers are not finite", value=value
        )
    return array


def coefficient(name: str, value: Any) -> float:
    """Return `value` as a float between 0 and 1, or raise `InputError`."""
    number = _finite(name, value)
    if not 0.0 <= number <= 1.0:
        raise InputError(f"{name}: {number} is not between 0 and 1", value=value)
    return number


def at_least_zero(name: str, value: Any) -> float:
    """Return `value` as a finite float that is not negative, or raise `InputError`."""
    number = _finite(name, value)
    if number < 0.0:
        raise InputError(f"{name}: {number} is negative; it must be at least 0", value=value)
    return number


def above_zero(name: str, value: Any) -> float:
    """Return `value` as a finite float > 0, or raise `InputError`."""
    number = _finite(name, value)
    if number <= 0.0:
        raise InputError(f"{name}: {number} given; it must be above 0", value=value)
    return number


def _finite(name: str, value: Any) -> float:
    number = real_number(name, value)
    if not math.isfinite(number):
        raise InputError(f"{name}: {number} is not finite", value=value)
    return number


def level(value: Any, name: str = "level") -> float:
    """Return the level of an interval as a float above 0 and below 1, or raise `InputError`."""
    number = _finite(name, value)
    if not 0.0 < number < 1.0:
        raise InputError(f"{name}: {number} given, between 0 and 1 expected", value=value)
    return number


def counted(number: int, what: str) -> str:
    """Return a number with its noun: "1 impact", "2 impacts", "2 velocities"."""
    if number == 1:
        return f"{number} {what}"
    return f"{number} {what[:-1]}ies" if what.endswith("y") else f"{number} {what}s"


def choice(field: str, value: Any, names: Iterable[str], what: str) -> str:
    """Return `value` if it is one of the names, or raise `UnknownNameError` ("… is not `what`")."""
    names = tuple(names)
    if not isinstance(value, str) or value not in names:
        raise UnknownNameError(
            f"{field}: {in_short(value)} is not {what}; {near_matches(value, names)}", value=value
        )
    return value


def truth_value(field: str, value: Any) -> bool:
    """Return `value` as a bool if it is True or False, or raise `InputError`."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{field}: {in_short(value)} given, True or False expected", value=value)
    return bool(value)


def function(field: str, value: Any, what: str) -> Any:
    """Return `value` if it can be called, or raise `InputError` ("… is not `what`")."""
    if not callable(value):
        raise InputError(f"{field}: {in_short(value)} is not {what}", value=value)
    return value


def returned(field: str, where: str, called: Callable[..., T], *arguments: Any) -> T:
    """Return the value of a user's function, or raise `InputError` saying where it failed."""
    try:
        return called(*arguments)
    except Exception as error:
        raise InputError(f"{field}: {type(error).__name__} {where}: {error}", value=called) from error


def whole_number(field: str, value: Any, low: int, high: int | None = None) -> int:
    """Return `value` as an int from `low` to `high`, or raise `InputError`."""
    integer = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not integer or value < low or (high is not None and value > high):
        to = "" if high is None else f" to {high}"
        raise InputError(
            f"{field}: {in_short(value)} given, a whole number from {low}{to} expected", value=value
        )
    return int(value)


def as_tuple(field: str, value: Any, one: type | tuple[type, ...], what: str) -> tuple[Any, ...]:
    """Return a sequence as a tuple, and an item of type `one` as a tuple (item,), or raise `InputError`."""
    if isinstance(value, one) and not isinstance(value, bool):
        return (value,)
    try:
        return tuple(value)
    except TypeError:
        raise InputError(
            f"{field}: {in_short(value)} given, {what} or a sequence of them expected", value=value
        ) from None


def near_matches(given: Any, names: Iterable[str]) -> str:
    """Return a clause that suggests similar names, or lists the first names if none is similar."""
    names = sorted(set(names))
    name = given if isinstance(given, str) else ""
    lowered = {known.lower(): known for known in names}
    close = [lowered[match] for match in difflib.get_close_matches(name.lower(), lowered, n=5, cutoff=0.5)]
    close += [known for known in names if name and name.lower() in known.lower() and known not in close][:5]
    if close:
        return "did you mean " + ", ".join(map(repr, close[:5])) + "?"
    if not names:
        return "there are none"
    shown = ", ".join(map(repr, names[:8])) + (", …" if len(names) > 8 else "")
    return f"the names are {shown}"
