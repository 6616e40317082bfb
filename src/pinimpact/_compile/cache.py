"""Disk cache of kernels, keyed by name, argument types and a hash of the code (`sources`).

A kernel that is not in the cache may be in the wheel, compiled for the processors of `portable`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from typing import Any

from . import pool, portable
from .declared import Job, declared_result
from .linking import symbol_stamp
from .lock import CacheLock
from .numba_internals import CompileResultCacheImpl, FunctionCache, NullCache, compile_result, rtsys
from .sources import PACKAGE, memory, stamp
from .waiting import LOG, SHORT


class _Stamped:
    """Cache location of a kernel, valid for one hash of its code."""

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


class _CacheImpl(CompileResultCacheImpl):
    _locator_classes = tuple(
        type(f"Stamped{locator.__name__}", (_Stamped, locator), {})
        for locator in CompileResultCacheImpl._locator_classes
    )

    def reduce(self, result: Any) -> Any:
        envs = tuple(one for one in result._find_referenced_environments() if one.consts)
        library = result.library.serialize_using_object_code()
        return type(result.library), library, result.fndesc, result.environment, result.signature, envs

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        library_type, state, fndesc, env, signature, envs = payload
        # a process that imported another version of the code may have written the file
        if not fndesc.uid.startswith(symbol_stamp(fndesc.modname)):
            return None
        codegen = target_context.codegen()
        library = library_type.load(codegen, state)
        entry = library.entry(target_context, fndesc, env)
        for one in envs:
            codegen.set_env(one.env_name, one)
        return compile_result(
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


class _DiskCache(FunctionCache):
    _impl_class = _CacheImpl

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a kernel without the imports that numba needs for compilation only."""
        rtsys.initialize(target_context)
        try:
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)
        except Exception:  # unpickling a damaged file may raise any
            self.flush()
            return None

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple()  # the stamp already depends on the code

    def knows(self, types: Any, codegen: Any) -> bool:
        try:
            known = self._cache_file._load_index()
        except Exception:
            self.flush()
            return False
        return self._index_key(types, codegen) in known


class _WheelCacheImpl(_CacheImpl):
    _locator_classes = tuple(
        type(f"Wheel{locator.__name__}", (locator,), {"ensure_cache_path": lambda self: None})
        for locator in _CacheImpl._locator_classes
        if "InTree" in locator.__name__
    )


class _WheelCache(_DiskCache):
    """The kernels of a wheel, in the folders of their modules, whether these are writable or not."""

    _impl_class = _WheelCacheImpl

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        machine, _, _ = codegen.magic_tuple()
        return sig, (machine, portable.processor(), "")

    def flush(self) -> None:
        """Do nothing: the files of a wheel are not changed."""


class _NoWheel(NullCache):
    """An empty cache, used instead of a `_WheelCache` whose kernels cannot run here."""

    def knows(self, types: Any, codegen: Any) -> bool:
        return False


@cache
def lock() -> CacheLock | None:
    """Return the lock of the cache folder; None if no folder is writable."""
    try:
        return CacheLock(_DiskCache(_place).cache_path)
    except RuntimeError:
        return None


def _place() -> None:
    """Identify the cache folder to be locked: that of this function's module."""


_in_session = False


@contextmanager
def session(missing: bool, needless: Callable[[], bool]) -> Iterator[None]:
    """Hold the lock of the cache folder within the context, if kernels are `missing`.

    Waiting for the lock ends early if `needless` returns true, which means that all kernels are cached.
    """
    global _in_session
    _in_session = True
    try:
        if missing:
            _hold_lock(needless)
        yield
    finally:
        _in_session = False
        found = lock()
        if found is not None:
            found.release()


def _hold_lock(needless: Callable[[], bool] = lambda: False) -> bool:
    """Wait for the lock of a session; return whether other processes may have cached kernels meanwhile."""
    found = lock()
    if not _in_session or found is None or found.held:
        return False
    begun, said = time.monotonic(), False

    def enough() -> bool:
        nonlocal said
        if not said and time.monotonic() - begun > SHORT:
            said = True
            LOG.warning("%s: waiting for a process that compiles kernels to %s", PACKAGE, found.file.parent)
        return needless()

    found.acquire(enough)
    return True


class KernelCache(NullCache):
    """The cache of a kernel, opened on first use: opening takes time, and most kernels are not used."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._disk: Any = None
        self._wheel: Any = None

    @property
    def cache_path(self) -> str | None:
        return self._find().cache_path

    @property
    def on_disk(self) -> bool:
        """Whether compiled kernels are stored on disk."""
        return isinstance(self._find(), _DiskCache)

    def knows(self, types: Any) -> bool:
        """Whether the kernel is cached for some types of arguments."""
        codegen = self._kernel.targetctx.codegen()
        return (self.on_disk and self._disk.knows(types, codegen)) or self._find_wheel().knows(types, codegen)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = pool.present.borrow(self._kernel, self._job(sig)) if pool.present is not None else None
        if found is None:
            found = self._load(sig, target_context)
        if found is None and pool.present is not None:
            found = pool.present.load_from_others(self._job(sig), partial(self._load, sig, target_context))
        elif found is None and _hold_lock():
            found = self._load(sig, target_context)
        return found

    def save_overload(self, sig: Any, cres: Any) -> None:
        given, found = declared_result(self._kernel, tuple(sig)), cres.signature.return_type
        if given not in (None, found):
            raise TypeError(f"{self._kernel.py_func.__qualname__}: returns {found}, not {given} as declared")
        self._find().save_overload(sig, cres)
        if pool.present is not None:
            pool.present.release(self._job(sig))

    def _job(self, sig: Any) -> Any:
        function = self._kernel.py_func
        return Job(function.__module__, function.__qualname__, tuple(sig))

    def _load(self, sig: Any, target_context: Any) -> Any:
        found = self._find().load_overload(sig, target_context)
        if found is None:
            found = self._find_wheel().load_overload(sig, target_context)
        if found is not None and found.signature.args != tuple(sig):  # two processes chose the same file name
            found = None
        return found

    def _find_wheel(self) -> Any:
        """Return the cache of the wheel's kernels, which is empty if they cannot run on this processor."""
        if self._wheel is None:
            self._wheel = _NoWheel()
            if portable.runs_here():
                with suppress(RuntimeError):  # the package is in an archive
                    self._wheel = _WheelCache(self._kernel.py_func)
        return self._wheel

    def _find(self) -> Any:
        if self._disk is None:
            try:
                self._disk = _DiskCache(self._kernel.py_func)
            except RuntimeError:  # no folder is writable: every process compiles
                self._disk = NullCache()
        return self._disk
