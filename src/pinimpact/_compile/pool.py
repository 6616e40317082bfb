"""A pool of processes that compile kernels.

The process that needs kernels starts helpers, one for each further processor. All of them process one list of
kernels with declared argument types, those with the most dependants first. A process takes the next kernel by
locking it with a file, compiles it, and writes it to the cache. A process that needs a kernel locked by
another waits for it or, if its result is declared, calls its symbol. Helpers are optional: kernels that are
not in the cache, for any reason, are compiled by the process that waits, and it ends its helpers when it is
done.
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
from .linking import stand_in, to_be_kept_only
from .sources import PACKAGE, ROOT, memory
from .waiting import COUNT, LOG

T = TypeVar("T")

MOST = 4
"""Largest number of processes: more would wait for each other, and each takes 0.5 GB."""

PAUSE = 0.005
"""Time between checks of the progress of others [s]."""

_HELP = "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); from {} import help_out; help_out()"


class WorkerPool:
    """The locks, in a folder, of the processes that compile together.

    The process that waits for the kernels also has the other processes, its helpers.
    """

    def __init__(self, folder: Path, helpers: Sequence[subprocess.Popen[bytes]] = ()) -> None:
        self._folder = folder
        self._helpers = {helper.pid: helper for helper in helpers}
        self._at_work: Job | None = None
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
        except OSError:  # the folder is gone; so is whoever would wait
            return True
        return True

    def release(self, job: Job) -> None:
        """Mark a kernel as cached."""
        with suppress(OSError):
            self._file(job).with_suffix(".done").touch()

    def of_others(self, job: Job, load: Callable[[], T | None]) -> T | None:
        """Load a kernel of other processes from the cache; None if none, or if this process locked it."""
        if self._is_at_work(job) or self.lock(job):
            return None
        while not self._is_over(job):
            time.sleep(PAUSE)
        return load()

    def _is_over(self, job: Job) -> bool:
        """Whether a locked kernel is in the cache, or will not be."""
        claimed = self._file(job)
        with suppress(OSError, ValueError):
            owner = self._helpers.get(int(claimed.read_text()))
            if owner is not None and owner.poll() is not None:
                return True
        return claimed.with_suffix(".done").exists()

    def borrow(self, kernel: Any, job: Job) -> Any:
        """Return a placeholder for another kernel with a declared result; else None."""
        if self._at_work is None:
            return None
        self._borrowed.append((kernel, job.types))
        result = None if self._is_at_work(job) else declared_result(kernel, job.types)
        return None if result is None else stand_in(kernel, job.types, result)

    def compile_with_others(self, jobs: Sequence[Job]) -> None:
        """Compile unlocked kernels for the cache only, when their dependencies are done."""
        with to_be_kept_only():
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
            self._at_work = job
            try:
                with suppress(Exception):  # invalid types; other errors occur again at the call
                    kernel_of(job).compile(job.types)
            finally:
                self._at_work = None
                self._return_borrowed()
            self.release(job)
            if self._helpers:  # not in helpers, which end before it matters
                gc.collect(0)

    def _return_borrowed(self) -> None:
        """Forget the placeholders, so that their kernels can be compiled here."""
        for kernel, types in self._borrowed:
            kernel.overloads.pop(types, None)
        for kernel in {kernel for kernel, _ in self._borrowed}:
            others = list(kernel.overloads.values())
            kernel._reset_overloads()
            for one in others:
                kernel.add_overload(one)
        self._borrowed.clear()

    def _is_at_work(self, job: Job) -> bool:
        return self._at_work is not None and self._at_work[:3] == job[:3]

    def _is_locked(self, job: Job) -> bool:
        return self._file(job).exists()


present: WorkerPool | None = None
"""The worker pool of this process."""


def possible_helpers() -> int:
    """Return how many helpers are possible: none on one processor, or if Python cannot be restarted."""
    if getattr(sys, "frozen", False) or not Path(sys.executable or "").name.lower().startswith("python"):
        return 0
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(processors, MOST) - 1


@contextmanager
def worker_pool(helpers: int) -> Iterator[Callable[[Sequence[Job]], None]]:
    """Start helpers, which wait for kernels until the context ends.

    Yields a function that compiles jobs, see `declared.jobs`, with them; kernels that remain are compiled
    later.
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
        with suppress(OSError):  # what it has not read
            helper.communicate()


def _helper() -> subprocess.Popen[bytes]:
    """Start a helper."""
    helper = subprocess.Popen(
        [sys.executable, "-I", "-c", _HELP.format(__name__)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )
    _send(helper, [str(ROOT.parent), *(path for path in sys.path if path)])
    return helper


def _send(helper: subprocess.Popen[bytes], *messages: Any) -> None:
    assert helper.stdin is not None
    with suppress(OSError):  # it has died already
        for one in messages:
            pickle.dump(one, helper.stdin)
        helper.stdin.flush()


def help_out() -> None:
    """Run as a helper: compile unlocked kernels until none is left or no process waits any more."""
    global present
    source = sys.stdin.buffer
    numba.config.CACHE_DIR, folder, known = pickle.load(source)
    memory.known.update(known)
    jobs = pickle.load(source)
    gc.disable()  # see `linking`; it ends before that matters
    sys.modules.setdefault("scipy.linalg", None)  # type: ignore[arg-type]  # numba's; no kernel calls it
    threading.Thread(target=_end_with, args=(source,), daemon=True).start()
    present = WorkerPool(folder)
    present.compile_with_others(jobs)


def _end_with(source: Any) -> None:
    """End this process when the one that waits has ended."""
    source.read()
    os._exit(0)
