"""A lock for a cache folder, shared by all processes that use it.

A process that compiles holds the lock, so that only one process compiles a kernel that several need. The
lock ends with its process. Where files cannot be locked, the only consequence is that kernels are compiled
twice.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

PAUSE = 0.1
"""Time between attempts to acquire the lock [s]."""


class CacheLock:
    """The lock of a cache folder, which is created if necessary; `file` is the lock file."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.file = Path(folder, "pinimpact.lock")
        self._held: tuple[int, int] | None = None  # process and open file

    @property
    def held(self) -> bool:
        """Whether this process, not the one that it was forked from, holds the lock."""
        return self._held is not None and self._held[0] == os.getpid()

    def acquire(self, needless: Callable[[], bool] = lambda: False) -> None:
        """Wait for the lock and acquire it; return without it if `needless()` is true or locking fails."""
        if self.held:
            return
        with suppress(ImportError, OSError):
            from fcntl import LOCK_EX, LOCK_NB, flock

            self.file.parent.mkdir(parents=True, exist_ok=True)
            with self.file.open("a") as file:
                while True:
                    with suppress(BlockingIOError):
                        flock(file, LOCK_EX | LOCK_NB)
                        self._held = os.getpid(), os.dup(file.fileno())  # has the same lock
                        return
                    if needless():
                        return
                    time.sleep(PAUSE)

    def release(self) -> None:
        """Release the lock, if this process holds it."""
        if self._held is not None and self.held:
            from fcntl import LOCK_UN, flock

            flock(self._held[1], LOCK_UN)  # a process forked since then may have the file open, too
            os.close(self._held[1])
        self._held = None
