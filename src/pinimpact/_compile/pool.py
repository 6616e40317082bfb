"""A pool of processes that compile kernels.

The process that needs kernels (the main process) starts helpers, one for each further processor. All of them
process the same list of kernels with declared argument types (`declared.jobs`). A process locks the next
kernel by a file, compiles it, and writes it to the cache. A process that needs a kernel locked by another one
waits for it or, if the type of its result is declared, calls its symbol. Helpers are optional: the main
process compiles all kernels that are not in the cache at the end, for any reason, and ends the helpers.
"""

from __future__ import annotations

import gc
import hashlib
import os
import pickle
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numba

from .declared import Job, declared_result, kernel_of
from .linking import cache_only, placeholder
from .sources import PACKAGE, ROOT, memory
from .waiting import COUNT, LOG

T = TypeVar("T")

MOST = 4
"""Maximum number of processes: more would wait for each other, and each needs 0.5 GB."""

PAUSE = 0.005
"""Time between checks of the progress of other processes [s]."""

_CODE = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); from {} import run_helper; run_helper()"
)


class WorkerPool:
    """The lock files of the processes that compile together; in the main process, with its helpers."""

    def __init__(self, folder: Path, helpers: Sequence[subprocess.Popen[bytes]] = ()) -> None:
        self._folder = folder
        self._helpers = {helper.pid: helper for helper in helpers}
        self._compiling: Job | None = None
        self._borrowed: list[tuple[Any, tuple[Any, ...]]] = []

    def _file(self, job: Job) -> Path:
        return self._folder / hashlib.sha256(str(job[:3]).encode()).hexdigest()[:32]

    def lock(self, job: Job) -> bool:
        """Lock a kernel; return False if another process has locked it."""
        try:
            with open(self._file(job), "x") as file:
                file.write(str(os.getpid()))
        except FileExistsError:
            return False
        except OSError:  # the folder is removed, so no process waits
            return True
        return True

    def release(self, job: Job) -> None:
        """Mark a kernel as cached."""
        with suppress(OSError):
            self._file(job).with_suffix(".done").touch()

    def load_from_others(self, job: Job, load: Callable[[], T | None]) -> T | None:
        """Wait for a kernel locked by another process and load it; None if this process has to compile it."""
        if self._is_compiling(job) or self.lock(job):
            return None
        while not self._is_over(job):
            time.sleep(PAUSE)
        return load()

    def _is_over(self, job: Job) -> bool:
        """Whether a locked kernel is cached, or will not be because its process has ended."""
        file = self._file(job)
        with suppress(OSError, ValueError):
            owner = self._helpers.get(int(file.read_text()))
            if owner is not None and owner.poll() is not None:
                return True
        return file.with_suffix(".done").exists()

    def borrow(self, kernel: Any, job: Job) -> Any:
        """Return a placeholder for a callee with a declared result; None for any other kernel."""
        if self._compiling is None:
            return None
        self._borrowed.append((kernel, job.types))
        result = None if self._is_compiling(job) else declared_result(kernel, job.types)
        return None if result is None else placeholder(kernel, job.types, result)

    def compile_with_others(self, jobs: Sequence[Job]) -> None:
        """Compile unlocked kernels for the cache only, each after the kernels that it needs."""
        with cache_only():
            self._compile_with_others(jobs)

    def _compile_with_others(self, jobs: Sequence[Job]) -> None:
        left = list(jobs)
        while left := [job for job in left if not self._is_locked(job)]:
            over = [self._is_locked(job) and self._is_over(job) for job in jobs]
            job = next((job for job in left if all(over[k] for k in job.needs)), None)
            if job is None:
                time.sleep(PAUSE)
                continue
            if not self.lock(job):
                continue
            LOG.info(COUNT, sum(over), len(jobs))
            self._compiling = job
            try:
                with suppress(Exception):  # invalid types; other errors are raised again by the call
                    kernel_of(job).compile(job.types)
            finally:
                self._compiling = None
                self._return_borrowed()
            self.release(job)
            if self._helpers:  # helpers end before memory becomes scarce
                gc.collect(0)

    def _return_borrowed(self) -> None:
        """Remove the placeholders, so that their kernels can be compiled in this process."""
        for kernel, types in self._borrowed:
            kernel.overloads.pop(types, None)
        for kernel in {kernel for kernel, _ in self._borrowed}:
            others = list(kernel.overloads.values())
            kernel._reset_overloads()
            for one in others:
                kernel.add_overload(one)
        self._borrowed.clear()

    def _is_compiling(self, job: Job) -> bool:
        return self._compiling is not None and self._compiling[:3] == job[:3]

    def _is_locked(self, job: Job) -> bool:
        return self._file(job).exists()


present: WorkerPool | None = None
"""The worker pool of this process, while it compiles together with others."""


def possible_helpers() -> int:
    """Return the number of possible helpers; 0 on one processor, or if no further Python can be started."""
    if getattr(sys, "frozen", False) or not Path(sys.executable or "").name.lower().startswith("python"):
        return 0
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(processors, MOST) - 1


@contextmanager
def worker_pool(helpers: int) -> Iterator[Callable[[Sequence[Job]], None]]:
    """Start helpers, which end with the context.

    Yields a function that compiles jobs (`declared.jobs`) with them. Kernels that it leaves are compiled when
    they are called.
    """
    started: list[subprocess.Popen[bytes]] = []
    with ExitStack() as stack:
        with suppress(OSError):  # no folder for locks, or no further process: compile alone
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=PACKAGE)))
            stack.callback(_end, started)
            for _ in range(helpers):
                started.append(_helper())

        def compile_with_others(jobs: Sequence[Job]) -> None:
            global present
            if started:
                for helper in started:
                    _send(helper, (numba.config.CACHE_DIR, folder, memory.known), list(jobs))
                present = WorkerPool(folder, started)
                present.compile_with_others(jobs)

        yield compile_with_others


def _end(helpers: Sequence[subprocess.Popen[bytes]]) -> None:
    global present
    present = None
    for helper in helpers:
        helper.kill()
    for helper in helpers:
        with suppress(OSError):  # it had not read all its input
            helper.communicate()


def _helper() -> subprocess.Popen[bytes]:
    """Start a helper."""
    helper = subprocess.Popen(
        [sys.executable, "-I", "-c", _CODE.format(__name__)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )
    _send(helper, [str(ROOT.parent), *(path for path in sys.path if path)])
    return helper


def _send(helper: subprocess.Popen[bytes], *messages: Any) -> None:
    assert helper.stdin is not None
    with suppress(OSError):  # it has ended already
        for one in messages:
            pickle.dump(one, helper.stdin)
        helper.stdin.flush()


def run_helper() -> None:
    """Run as a helper: compile unlocked kernels until none is left, or until the main process ends."""
    global present
    source = sys.stdin.buffer
    numba.config.CACHE_DIR, folder, known = pickle.load(source)
    memory.known.update(known)
    jobs = pickle.load(source)
    gc.disable()  # see `without_collecting`; this process ends before memory becomes scarce
    sys.modules.setdefault("scipy.linalg", None)  # type: ignore[arg-type]  # numba imports it; no kernel calls it
    threading.Thread(target=_end_with, args=(source,), daemon=True).start()
    present = WorkerPool(folder)
    present.compile_with_others(jobs)


def _end_with(source: Any) -> None:
    """End this process when the main process has ended."""
    source.read()
    os._exit(0)
