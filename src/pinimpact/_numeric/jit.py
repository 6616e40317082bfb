"""The decorators of the kernels: numba's njit, each kernel compiled once, and kept on disk from then on.

`jit`: what Python calls. It is compiled on its own when it is first called.
`separate`: what several kernels call and Python does not. It is compiled on its own too, and whoever calls it
    has no copy of it but its symbol. The call costs some 2 ns; where the kernel is long, each caller takes a
    second less to compile. (A kernel that calls a `jit` does the same.)
`inner`: what is small, or has one caller: its code goes into each caller and is optimized there.
`inlined`: an `inner` that must not stay a call.

The cache of a kernel holds as long as the code that it was made from: see `sources`. Where no folder is
writable, every process compiles for itself.

Whoever has to wait is told: see `waiting`.

With NUMBA_DISABLE_JIT=1 all kernels are plain Python.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numba
from numba.core import caching, compiler, dispatcher

from .linking import InnerCompiler, KernelCompiler, KernelLibrary, compiling, symbol_stamp
from .sources import PACKAGE, memory, stamp
from .waiting import LOG, tell

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS = {"fastmath": {"contract"}, "error_model": "numpy", "no_cfunc_wrapper": True}


def inner(function: F) -> F:
    """Compile a kernel that only other kernels call, in each of them."""
    compiled: F = numba.njit(no_cpython_wrapper=True, pipeline_class=InnerCompiler, **_OPTIONS)(function)
    return compiled


def inlined(function: F) -> F:
    """Like `inner`, for a kernel with one caller: to pass its many values would cost more than its code."""
    compiled: F = numba.njit(
        no_cpython_wrapper=True, forceinline=True, pipeline_class=InnerCompiler, **_OPTIONS
    )(function)
    return compiled


def separate(function: F) -> F:
    """Compile a kernel that only other kernels call on its own, once for all of them."""
    return _cached(function, no_cpython_wrapper=True)


def jit(function: F) -> F:
    """Compile a kernel that Python calls, when it is first called."""
    return _cached(function)


def compile_all(*calls: tuple[Any, ...]) -> None:
    """Make sure that nothing is compiled later: compile or load kernels, in the order given.

    Args:
        calls: (kernel, *arguments): a `jit`, and arguments that have the types of those to come.
    """
    global _together
    missing = [
        (kernel, types)
        for kernel, *arguments in calls
        if isinstance(kernel, dispatcher.Dispatcher)  # else it is plain Python
        and (types := tuple(map(kernel.typeof_pyval, arguments))) not in kernel.overloads
    ]
    _together = [kernel for kernel, _ in missing]
    try:
        for done, (kernel, types) in enumerate(missing, start=1):
            kernel.compile(types)
            if kernel.stats.cache_misses:
                LOG.info("compiling, once: %d of %d", done, len(missing))
    finally:
        _together = []


_together: Sequence[Any] = []


def _cached(function: F, **options: Any) -> F:
    if function.__closure__:
        raise ValueError(
            f"{function.__qualname__}: made by a function, so its symbol is not its own; see inner"
        )
    compiled = numba.njit(pipeline_class=KernelCompiler, **_OPTIONS, **options)(function)
    if isinstance(compiled, dispatcher.Dispatcher):
        compiled._cache = _Cache(compiled)
    result: F = compiled
    return result


class _Stamped:
    """Where a kernel is cached: by its name, and by the code that it is made from."""

    _module: str

    def get_source_stamp(self) -> str:
        memory.keep_in(self.get_cache_path())
        return stamp(self._module)

    def get_disambiguator(self) -> str:
        return PACKAGE

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        self = super().from_function(py_func, py_file)  # type: ignore[misc]
        if self is not None:
            self._module = py_func.__module__
        return self


class _CacheImpl(caching.CompileResultCacheImpl):
    _locator_classes = tuple(
        type(f"Stamped{locator.__name__}", (_Stamped, locator), {})
        for locator in caching.CompileResultCacheImpl._locator_classes
    )

    def reduce(self, result: Any) -> Any:
        library, fndesc, env, signature, *_, envs = result._reduce()
        return library, fndesc, env, signature, tuple(one for one in envs if one.consts)

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        state, fndesc, env, signature, envs = payload
        if fndesc.uid != symbol_stamp(fndesc.modname):  # written late, by a process that ran on other code
            return None
        codegen = target_context.codegen()
        library = KernelLibrary.load(codegen, state)
        entry = target_context.get_executable(library, fndesc, env)
        for one in envs:
            codegen.set_env(one.env_name, one)
        return compiler.compile_result(
            target_context=target_context,
            typing_context=target_context.typing_context,
            library=library,
            environment=env,
            entry_point=entry,
            fndesc=fndesc,
            signature=signature,
            objectmode=False,
            reload_init=(),
            referenced_envs=envs,
        )


class _DiskCache(caching.FunctionCache):
    _impl_class = _CacheImpl

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple()  # the stamp covers the code


class _Cache(caching.NullCache):
    """The cache of a kernel, looked for on first use, for that takes time and most kernels are not used."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._disk: Any = None

    @property
    def cache_path(self) -> str | None:
        return self._find().cache_path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        disk = self._find()
        found = disk.load_overload(sig, target_context)
        if found is not None and found.signature.args != tuple(sig):  # two processes took one file name
            found = None
        if found is None and not compiling():
            tell(_together or [self._kernel], isinstance(disk, _DiskCache))
        return found

    def save_overload(self, sig: Any, cres: Any) -> None:
        self._find().save_overload(sig, cres)

    def _find(self) -> Any:
        if self._disk is None:
            try:
                self._disk = _DiskCache(self._kernel.py_func)
            except RuntimeError:  # no writable place at all: compile in every process
                self._disk = caching.NullCache()
        return self._disk
