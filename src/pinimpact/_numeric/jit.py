"""The decorators of the kernels: numba's njit, with a disk cache that never goes stale or in the way."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import caching, dispatcher

F = TypeVar("F", bound=Callable[..., Any])


def _sources_digest() -> str:
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parents[1].rglob("_*/*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


_DIGEST = _sources_digest()


class _Stamp:
    """Stamp with the sources of all kernels: numba itself watches only the caller's, not its callees'."""

    def get_source_stamp(self) -> str:
        return _DIGEST


class _CacheImpl(caching.CompileResultCacheImpl):
    _locator_classes = tuple(
        type(f"Stamped{locator.__name__}", (_Stamp, locator), {})
        for locator in caching.CompileResultCacheImpl._locator_classes
    )


class _Cache(caching.FunctionCache):
    _impl_class = _CacheImpl


_OPTIONS = {"fastmath": {"contract"}, "error_model": "numpy"}


def inner(function: F) -> F:
    """Compile a kernel that only other kernels call: without what Python would need, which saves seconds."""
    compiled: F = numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **_OPTIONS)(function)
    return compiled


def inlined(function: F) -> F:
    """Like `inner`, for a kernel with one caller: to pass its many values would cost more than its code."""
    compiled: F = numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True, **_OPTIONS)(
        function
    )
    return compiled


def jit(function: F) -> F:
    """Compile `function` on first call; cached on disk where a place is writable."""
    compiled = numba.njit(**_OPTIONS)(function)
    if isinstance(compiled, dispatcher.Dispatcher):
        with contextlib.suppress(RuntimeError):  # no writable place at all: compile in every process
            compiled._cache = _Cache(function)
    return compiled
