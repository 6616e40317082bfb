"""The decorators of kernels: numba's njit, with each kernel compiled once and cached on disk.

`jit`: for kernels called from Python, compiled on their first call.
`released`: like `jit`, without the global interpreter lock, so that several threads can call it.
`external`: for kernels called by several kernels, not from Python. They are compiled separately, and callers
    refer to their symbols. A call costs about 2 ns; for a long kernel this saves a second of compilation per
    caller. (Kernels call a `jit` kernel in the same way.)
`inlined`: for small kernels, or with one caller. Their code is inlined in each caller and optimized there.
`always_inlined`: like `inlined`, without leaving the decision to LLVM.
`inlined_bitcode`, `always_inlined_bitcode`: the same for kernels that take a second to compile; their
    bitcode is cached on disk.

Kernels with a declared signature (`declared`) are compiled by several processes at once (`pool`).

A cached kernel is valid as long as the code from which it was compiled is unchanged (`sources`). If no folder
is writable, every process compiles. Messages during compilation are those of `waiting`.

With NUMBA_DISABLE_JIT=1 all kernels are plain Python. With PINIMPACT_PLAIN_NUMBA=1, or with a numba that
`linking` does not support, plain numba compiles them (`plain`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any, TypeVar

import numba
from numba.types import unliteral

from . import plain
from .declared import Job, declared_types, jobs, kernel_of
from .waiting import COUNT, LOG, announce, expected

WHY_PLAIN = plain.reason()
if not WHY_PLAIN:
    from . import cache, pool
    from .linking import BitcodeCompiler, InlinedCompiler, KernelCompiler, compiling, without_collecting
    from .numba_internals import global_compiler_lock
elif not numba.config.DISABLE_JIT:
    plain.warn(WHY_PLAIN)

F = TypeVar("F", bound=Callable[..., Any])

WORTH_HELP = 3.0
"""Estimated compilation time above which helper processes are started [s]."""

_OPTIONS = {"fastmath": {"contract"}, "error_model": "numpy"}


def inlined(function: F) -> F:
    """Compile a kernel within each of the kernels that call it."""
    return _compiled(function)


def always_inlined(function: F) -> F:
    """Like `inlined`, for a kernel whose many arguments would cost more to pass than its code."""
    return _compiled(function, forceinline=True)


def inlined_bitcode(function: F) -> F:
    """Like `inlined`, for long kernels: their bitcode is cached, so that another process can compile it."""
    return _bitcode(function)


def always_inlined_bitcode(function: F) -> F:
    """Like `inlined_bitcode`, for `always_inlined` kernels."""
    return _bitcode(function, forceinline=True)


def external(function: F) -> F:
    """Compile separately, once, a kernel that only other kernels call."""
    if WHY_PLAIN:
        return _compiled(function)
    return _cached(function, KernelCompiler, no_cpython_wrapper=True)


def jit(function: F) -> F:
    """Compile a kernel that Python calls, when it is first called."""
    return _called(function)


def released(function: F) -> F:
    """Like `jit`, for long-running kernels: other Python threads can run meanwhile."""
    return _called(function, nogil=True)


def _compiled(function: F, **options: Any) -> F:
    """Compile a kernel in each of its callers."""
    if not WHY_PLAIN:
        options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": InlinedCompiler}
    return _typed(numba.njit(**_OPTIONS, **options)(function))


def _bitcode(function: F, **options: Any) -> F:
    if WHY_PLAIN:
        return _compiled(function, **options)
    return _cached(function, BitcodeCompiler, no_cpython_wrapper=True, **options)


def _called(function: F, **options: Any) -> F:
    if WHY_PLAIN:
        plainly: F = numba.njit(**_OPTIONS, **options)(function)
        with suppress(RuntimeError):  # no folder is writable
            getattr(plainly, "enable_caching", bool)()
            plainly.is_called = True  # type: ignore[attr-defined]
        return plainly
    compiled: Any = _cached(function, KernelCompiler, **options)
    if hasattr(compiled, "py_func"):
        compiled.compile = _Compile(compiled)
        compiled.is_called = True
    return compiled


def _cached(function: F, pipeline: Any, **options: Any) -> F:
    if function.__closure__:
        raise ValueError(
            f"{function.__qualname__}: defined inside a function, so its symbol is not unique; define it in "
            "a module, or use `inlined`"
        )
    compiled: Any = numba.njit(pipeline_class=pipeline, no_cfunc_wrapper=True, **_OPTIONS, **options)(
        function
    )
    if hasattr(compiled, "py_func"):
        compiled._cache, compiled.is_bitcode = cache.KernelCache(compiled), pipeline is BitcodeCompiler
    return _typed(compiled)


def _typed(compiled: Any) -> Any:
    """Return a kernel that other kernels call with literals as numbers: their values would be types."""
    if hasattr(compiled, "py_func"):
        compiled.get_call_template = partial(_type_call, compiled.get_call_template)
    return compiled


def _type_call(typed: Callable[..., Any], arguments: Sequence[Any], named: dict[str, Any]) -> Any:
    """Type a call of a kernel by numba's method."""
    return typed(tuple(map(unliteral, arguments)), named)


def compile_all(*calls: tuple[Any, ...]) -> None:
    """Compile or load kernels in the order given, so that their later calls compile nothing.

    Args:
        calls: Tuples of a `jit` kernel and arguments of the types of later calls, or a kernel alone if its
            signature is declared.
    """
    if not all(hasattr(kernel, "py_func") for kernel, *_ in calls):
        return  # they are plain Python
    wanted = [(kernel, _types(kernel, arguments)) for kernel, *arguments in calls]
    if WHY_PLAIN:
        for kernel, types in wanted:
            kernel.compile(types)
    else:
        _compile(wanted)


def is_declared(item: Any) -> bool:
    """Whether something is a kernel that Python calls, with declared argument types."""
    return bool(getattr(item, "is_called", False)) and hasattr(item, "declared")


def kept_in(kernels: Sequence[Any]) -> str | None:
    """Return the common cache folder of some kernels; None if they are not cached on disk."""
    paths = [kernel._cache.cache_path for kernel in kernels if hasattr(kernel, "_cache")]
    return None if not paths or None in paths else os.path.commonpath(paths)


def _types(kernel: Any, arguments: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(map(kernel.typeof_pyval, arguments)) if arguments else declared_types(kernel)


class _Compile:
    """Compiles a kernel that Python calls on its first call, with helper processes if it takes long."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self.alone = kernel.compile

    def __call__(self, types: Any) -> Any:
        if not (compiling() or pool.present or _together):
            _compile([(self._kernel, tuple(types))])
        return self.alone(types)


_together: list[Any] = []
"""The kernels that are being compiled together."""


def _compile(wanted: Sequence[tuple[Any, Any]]) -> None:
    """Compile or load kernels for some types of arguments."""
    with global_compiler_lock:  # other threads wait
        _compile_locked([(kernel, types) for kernel, types in wanted if types not in kernel.overloads])


def _compile_locked(wanted: Sequence[tuple[Any, Any]]) -> None:
    global _together
    helpers = pool.possible_helpers()
    try:
        with without_collecting(), ExitStack() as stack:
            missing = _missing(wanted)
            stack.enter_context(cache.session(bool(missing), _all_kept(jobs(missing))))
            missing = _missing(missing)
            _together = [kernel for kernel, _ in missing] or [kernel for kernel, _ in wanted]
            if missing:
                kept = all(kernel._cache.on_disk for kernel in _together)
                helped = bool(helpers) and kept and expected(_together) > WORTH_HELP
                announce(_together, kept, 1 + helpers * helped)
                if helped:
                    stack.enter_context(pool.worker_pool(helpers))(jobs(missing))
            for done, (kernel, types) in enumerate(wanted, start=1):
                kernel.compile.alone(types)
                if kernel.stats.cache_misses:
                    LOG.info(COUNT, done, len(wanted))
    finally:
        _together = []


def _missing(wanted: Sequence[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """Return the kernels that are not cached."""
    return [(kernel, types) for kernel, types in wanted if not kernel._cache.knows(types)]


def _all_kept(needed: Sequence[Job]) -> Callable[[], bool]:
    """Return a function that returns whether all kernels are cached; a cached one is not checked again."""
    left = list(needed)

    def all_kept() -> bool:
        while left and kernel_of(left[-1])._cache.knows(left[-1].types):
            left.pop()
        return not left

    return all_kept
