"""The decorators of the kernels: numba's njit, each kernel compiled once, and kept on disk from then on.

`jit`: what Python calls. It is compiled on its own when it is first called.
`released`: such a one that runs without Python's lock, so that threads can share its work.
`separate`: what several kernels call and Python does not. It is compiled on its own too, and whoever calls it
    has no copy of it but its symbol. The call costs some 2 ns; where the kernel is long, each caller takes a
    second less to compile. (A kernel that calls a `jit` does the same.)
`inner`: what is small, or has one caller: its code goes into each caller and is optimized there.
`inlined`: an `inner` that must not stay a call.
`part`, `inlined_part`: such a one that takes a second to compile; it is kept on disk like the others.

Whoever waits has helpers, see `company`: what tells its types `ahead` is compiled by several at once.

The cache of a kernel holds as long as the code that it was made from: see `sources`. Where no folder is
writable, every process compiles for itself.

Whoever has to wait is told: see `waiting`.

With NUMBA_DISABLE_JIT=1 all kernels are plain Python.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, TypeVar

import numba
from numba.core import caching, compiler, dispatcher
from numba.core.compiler_lock import global_compiler_lock
from numba.core.runtime import rtsys

from . import company
from .ahead import Job, jobs, result_ahead, types_ahead
from .linking import InnerCompiler, KernelCompiler, PartCompiler, compiling, symbol_stamp, without_collecting
from .sources import PACKAGE, memory, stamp
from .waiting import COUNT, LOG, expected, tell

F = TypeVar("F", bound=Callable[..., Any])

WORTH_HELP = 3.0
"""A wait [s] in which helpers make up for the time that they take to start."""

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


def part(function: F) -> F:
    """Like `inner`, for what takes long: its code is kept, so that another process can compile it ahead."""
    return _cached(function, PartCompiler, no_cpython_wrapper=True)


def inlined_part(function: F) -> F:
    """Like `part`, for what is `inlined`."""
    return _cached(function, PartCompiler, no_cpython_wrapper=True, forceinline=True)


def separate(function: F) -> F:
    """Compile a kernel that only other kernels call on its own, once for all of them."""
    return _cached(function, no_cpython_wrapper=True)


def jit(function: F) -> F:
    """Compile a kernel that Python calls, when it is first called."""
    return _called(function)


def released(function: F) -> F:
    """Like `jit`, for a kernel that runs long: it lets Python's other threads run meanwhile."""
    return _called(function, nogil=True)


def _called(function: F, **options: Any) -> F:
    compiled = _cached(function, **options)
    if isinstance(compiled, dispatcher.Dispatcher):
        compiled.compile = _Compile(compiled)  # type: ignore[method-assign, assignment]
    return compiled


def compile_all(*calls: tuple[Any, ...]) -> None:
    """Make sure that nothing is compiled later: compile or load kernels, in the order given.

    Args:
        calls: (kernel, *arguments): a `jit`, and arguments that have the types of those to come; none where
            it tells its types `ahead`.
    """
    if all(isinstance(kernel, dispatcher.Dispatcher) for kernel, *_ in calls):  # else it is plain Python
        _compile([(kernel, _types(kernel, arguments)) for kernel, *arguments in calls])


def _types(kernel: Any, arguments: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(map(kernel.typeof_pyval, arguments)) if arguments else types_ahead(kernel)


class _Compile:
    """What compiles a kernel that Python calls, when it is first called: with helpers, if it takes long.

    Attributes:
        alone: What numba has in its place.
    """

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self.alone = kernel.compile

    def __call__(self, types: Any) -> Any:
        if not (compiling() or company.present or _together):
            _compile([(self._kernel, tuple(types))])
        return self.alone(types)


_together: list[Any] = []


@global_compiler_lock  # other threads wait
def _compile(wanted: Sequence[tuple[Any, Any]]) -> None:
    """Compile or load kernels for some types of arguments."""
    global _together
    wanted = [(kernel, types) for kernel, types in wanted if types not in kernel.overloads]
    missing: list[tuple[Any, Any]] = []
    share, helpers = None, company.possible_helpers()
    try:
        with without_collecting(), ExitStack() as stack:
            for kernel, types in wanted:
                if kernel._cache.knows(types):
                    continue
                missing.append((kernel, types))
                _together.append(kernel)
                worth = helpers and share is None and kernel._cache.on_disk
                if worth and expected(_together) > WORTH_HELP:  # helpers start while others are looked for
                    share = stack.enter_context(company.company(helpers))
            if missing:
                kept = all(kernel._cache.on_disk for kernel in _together)
                tell(_together, kept, 1 + helpers * (share is not None))
            if share is not None:
                share(jobs(missing))
            for done, (kernel, types) in enumerate(wanted, start=1):
                kernel.compile.alone(types)
                if kernel.stats.cache_misses:
                    LOG.info(COUNT, done, len(wanted))
    finally:
        _together = []


def _cached(function: F, pipeline: type[KernelCompiler] = KernelCompiler, **options: Any) -> F:
    if function.__closure__:
        raise ValueError(
            f"{function.__qualname__}: made by a function, so its symbol is not its own; see inner"
        )
    compiled = numba.njit(pipeline_class=pipeline, **_OPTIONS, **options)(function)
    if isinstance(compiled, dispatcher.Dispatcher):
        compiled._cache, compiled.is_part = _Cache(compiled), pipeline is PartCompiler
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
        envs = tuple(one for one in result._find_referenced_environments() if one.consts)
        library = result.library.serialize_using_object_code()
        return type(result.library), library, result.fndesc, result.environment, result.signature, envs

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        made, state, fndesc, env, signature, envs = payload
        if not fndesc.uid.startswith(
            symbol_stamp(fndesc.modname)
        ):  # written late, by a process that ran on other code
            return None
        codegen = target_context.codegen()
        library = made.load(codegen, state)
        entry = library.entry(target_context, fndesc, env)
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

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a kernel, without all that numba imports first, which is for what compiles."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple()  # the stamp covers the code

    def knows(self, types: Any, codegen: Any) -> bool:
        return self._index_key(types, codegen) in self._cache_file._load_index()


class _Cache(caching.NullCache):
    """The cache of a kernel, looked for on first use, for that takes time and most kernels are not used."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._disk: Any = None

    @property
    def cache_path(self) -> str | None:
        return self._find().cache_path

    @property
    def on_disk(self) -> bool:
        """Whether what is compiled is kept."""
        return isinstance(self._find(), _DiskCache)

    def knows(self, types: Any) -> bool:
        """Whether the kernel is kept for some types of arguments."""
        disk = self._find()
        return self.on_disk and disk.knows(types, self._kernel.targetctx.codegen())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = company.present.lend(self._kernel, self._job(sig)) if company.present is not None else None
        if found is None:
            found = self._load(sig, target_context)
        if found is None and company.present is not None:
            found = company.present.of_others(self._job(sig), partial(self._load, sig, target_context))
        elif found is None and not (compiling() or _together):
            tell([self._kernel], self.on_disk)
        return found

    def save_overload(self, sig: Any, cres: Any) -> None:
        told, found = result_ahead(self._kernel, tuple(sig)), cres.signature.return_type
        if told not in (None, found):
            raise TypeError(f"{self._kernel.py_func.__qualname__}: returns {found}, not {told} as told ahead")
        self._find().save_overload(sig, cres)
        if company.present is not None:
            company.present.release(self._job(sig))

    def _job(self, sig: Any) -> Any:
        function = self._kernel.py_func
        return Job(function.__module__, function.__qualname__, tuple(sig))

    def _load(self, sig: Any, target_context: Any) -> Any:
        found = self._find().load_overload(sig, target_context)
        if found is not None and found.signature.args != tuple(sig):  # two processes took one file name
            found = None
        return found

    def _find(self) -> Any:
        if self._disk is None:
            try:
                self._disk = _DiskCache(self._kernel.py_func)
            except RuntimeError:  # no writable place at all: compile in every process
                self._disk = caching.NullCache()
        return self._disk
