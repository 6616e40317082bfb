"""Checks of what users give: arrays and numbers, with errors that name the field and what would be right."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError


def float_array(field: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return `value` as a contiguous float64 array of `shape`, or raise `InputError` naming `field`."""
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(
            f"{field}: {value!r} is not an array of numbers; an array of shape {shape} is expected",
            field=field,
            value=value,
        ) from None
    if array.shape != shape:
        raise InputError(f"{field}: shape {array.shape} given, {shape} expected", field=field, value=value)
    return array


def finite_array(field: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Like `float_array`, and refuse NaN and infinity."""
    array = float_array(field, value, shape)
    squares = np.vdot(array, array)  # quickly finite, unless it is too large
    if not math.isfinite(squares) and not np.isfinite(array).all():
        raise InputError(
            f"{field}: {array.tolist()} holds numbers that are not finite", field=field, value=value
        )
    return array


def coefficient(name: str, value: Any) -> float:
    """Return `value` as a float between 0 and 1, or raise `InputError`."""
    number = _finite(name, value)
    if not 0.0 <= number <= 1.0:
        raise InputError(f"{name}: {number} is not between 0 and 1", field=name, value=value)
    return number


def at_least_zero(name: str, value: Any) -> float:
    """Return `value` as a finite float that is not negative, or raise `InputError`."""
    number = _finite(name, value)
    if number < 0.0:
        raise InputError(f"{name}: {number} is negative; it must be at least 0", field=name, value=value)
    return number


def above_zero(name: str, value: Any) -> float:
    """Return `value` as a finite float > 0, or raise `InputError`."""
    number = _finite(name, value)
    if number <= 0.0:
        raise InputError(f"{name}: {number} given; it must be above 0", field=name, value=value)
    return number


def _finite(name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name}: {value!r} is not a number", field=name, value=value) from None
    if not math.isfinite(number):
        raise InputError(f"{name}: {number} is not finite", field=name, value=value)
    return number


def counted(number: int, what: str) -> str:
    """Return a number of things in words: "1 impact", "2 impacts", "2 velocities"."""
    if number == 1:
        return f"{number} {what}"
    return f"{number} {what[:-1]}ies" if what.endswith("y") else f"{number} {what}s"


def near_matches(name: str, names: Iterable[str]) -> str:
    """Return a clause that offers the names closest to `name`, or how many there are if none is close."""
    names = sorted(set(names))
    lowered = {known.lower(): known for known in names}
    close = [lowered[match] for match in difflib.get_close_matches(name.lower(), lowered, n=5, cutoff=0.5)]
    close += [known for known in names if name and name.lower() in known.lower() and known not in close][:5]
    if close:
        return "did you mean " + ", ".join(map(repr, close[:5])) + "?"
    shown = ", ".join(map(repr, names[:8])) + (", …" if len(names) > 8 else "")
    return f"the names are {shown}"
