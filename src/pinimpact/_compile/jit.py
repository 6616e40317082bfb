"""The decorators of kernels: numba's njit, with each kernel compiled once and cached on disk.

`jit`: called from Python. It is compiled when it is first called.
`released`: the same, without the global interpreter lock, so that threads can share its work.
`external`: called by several kernels, not from Python. It is compiled separately, and callers refer to its
    symbol. The call costs some 2 ns; if the kernel is long, this saves a second of compilation per caller. (A
    kernel that calls a `jit` does the same.)
`inlined`: small, or with one caller: its code is inlined in each caller and optimized there.
`always_inlined`: the same, if it must not remain a call.
`inlined_bitcode`, `always_inlined_bitcode`: the same, for kernels that take a second to compile; their
    bitcode is cached on disk.

Kernels with a declared signature (`declared`) are compiled by several processes at once: see `pool`.

The cache of a kernel is valid as long as the code from which it was compiled: see `sources`. If no folder is
writable, every process compiles for itself.

See `waiting` for the messages during compilation.

With NUMBA_DISABLE_JIT=1 all kernels are plain Python. With PINIMPACT_PLAIN_NUMBA=1, or if numba differs from
what `linking` needs, plain numba compiles them: see `plain`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import Any, TypeVar

import numba

from . import plain
from .declared import Job, declared_types, jobs, kernel_of
from .waiting import COUNT, LOG, announce, expected

WHY_PLAIN = plain.reason()
if not WHY_PLAIN:
    from . import cache, pool
    from .linking import InnerCompiler, KernelCompiler, PartCompiler, compiling, without_collecting
    from .numba_internals import global_compiler_lock
elif not numba.config.DISABLE_JIT:
    plain.warn(WHY_PLAIN)

F = TypeVar("F", bound=Callable[..., Any])

WORTH_HELP = 3.0
"""A compilation time [s] from which on helper processes are worth their start."""

_OPTIONS = {"fastmath": {"contract"}, "error_model": "numpy"}


def inlined(function: F) -> F:
    """Compile a kernel that only other kernels call, in each of them."""
    return _compiled(function)


def always_inlined(function: F) -> F:
    """Like `inlined`, for a kernel with one caller whose many arguments would cost more than its code."""
    return _compiled(function, forceinline=True)


def inlined_bitcode(function: F) -> F:
    """Like `inlined`, for long kernels: their bitcode is cached, so that another process can compile it."""
    return _part(function)


def always_inlined_bitcode(function: F) -> F:
    """Like `inlined_bitcode`, for `always_inlined` kernels."""
    return _part(function, forceinline=True)


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
        options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": InnerCompiler}
    compiled: F = numba.njit(**_OPTIONS, **options)(function)
    return compiled


def _part(function: F, **options: Any) -> F:
    if WHY_PLAIN:
        return _compiled(function, **options)
    return _cached(function, PartCompiler, no_cpython_wrapper=True, **options)


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
            f"{function.__qualname__}: defined inside a function, so its symbol is not unique; see inner"
        )
    compiled: Any = numba.njit(pipeline_class=pipeline, no_cfunc_wrapper=True, **_OPTIONS, **options)(
        function
    )
    if hasattr(compiled, "py_func"):
        compiled._cache, compiled.is_part = cache.KernelCache(compiled), pipeline is PartCompiler
    return compiled


def compile_all(*calls: tuple[Any, ...]) -> None:
    """Compile or load kernels in the order given, so that nothing is compiled later.

    A call is (kernel, *arguments): a `jit`, and arguments of the types of later calls, none if they are
    `declared`.
    """
    if not all(hasattr(kernel, "py_func") for kernel, *_ in calls):
        return  # it is plain Python
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
    """Return the common cache folder of some kernels; None if nothing is kept."""
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
    """Return a function that says whether all kernels are cached by now; it asks of each until it is."""
    left = list(needed)

    def all_kept() -> bool:
        while left and _is_kept(left[-1]):
            left.pop()
        return not left

    return all_kept


def _is_kept(job: Job) -> bool:
    kernel: Any = kernel_of(job)
    return kernel._cache.knows(job.types)
