"""Results that are computed once for a model."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import pinocchio as pin

T = TypeVar("T")

Known: TypeAlias = dict[tuple[int, str], tuple[Any, tuple[int, int, int], Any]]
"""Results, by address of the model and name of the function, with the model and its sizes."""


def once(known: Known, model: pin.Model, compute: Callable[[pin.Model], T]) -> T:
    """Return `compute(model)` from `known`; it is computed once for a model, and again if it grows."""
    key, sizes = (id(model), compute.__name__), (model.njoints, model.nq, model.nv)
    entry = known.get(key)
    if entry is None or entry[0]() is not model or entry[1] != sizes:
        forget = known.pop  # bound now: at exit the module may be gone before the model
        known[key] = entry = weakref.ref(model, lambda _: forget(key, None)), sizes, compute(model)
    found: T = entry[2]
    return found
