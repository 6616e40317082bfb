"""A lock for a cache folder, shared by all processes that use it, on one machine or on several.

A process that compiles holds the lock, so that only one process compiles a kernel that several need. The
lock is a file that names its holder, which updates the modification time every `BEAT` seconds. A lock is
taken over if its process has ended, or if it has not been updated for `STALE` seconds, by the clock of the
waiting process. If locking fails for any reason, the only consequence is that kernels are compiled twice.
"""

from __future__ import annotations

import os
import secrets
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

BEAT, STALE = 2.0, 20.0
"""Interval between updates of the lock, and time without update after which it is taken over [s]."""

PAUSE = 0.1
"""Time between checks of the lock [s]."""


class CacheLock:
    """The lock of a cache folder, which is created if necessary; `file` is the lock file."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.file = Path(folder, "pinimpact.lock")
        self._token = ""
        self._ended = threading.Event()

    @property
    def held(self) -> bool:
        """Whether this process holds the lock."""
        return self._token.startswith(f"{_owner()} ")

    def acquire(self, needless: Callable[[], bool] = lambda: False) -> None:
        """Wait for the lock and acquire it; return without it if `needless()` is true or locking fails."""
        token = f"{_owner()} {secrets.token_hex(8)}"
        seen, since = None, time.monotonic()
        while not self.held:
            try:
                self.file.parent.mkdir(parents=True, exist_ok=True)
                with open(self.file, "x") as file:
                    file.write(token)
            except FileExistsError:
                now = self._state()
                if now != seen:
                    seen, since = now, time.monotonic()
                elif now is not None and (_is_gone(now[0]) or time.monotonic() - since > STALE):
                    self._remove(now[0])
                    continue
                if needless():
                    return
                time.sleep(PAUSE)
            except OSError:
                return
            else:
                self._token, self._ended = token, threading.Event()
                threading.Thread(target=self._beat, args=(self._ended,), daemon=True).start()

    def release(self) -> None:
        """Release the lock, if this process holds it."""
        if self.held:
            self._ended.set()
            self._remove(self._token)
        self._token = ""

    def _state(self) -> tuple[str, int] | None:
        """Return the text of the lock file and its modification time [ns]; None without a lock."""
        try:
            return self.file.read_text(), self.file.stat().st_mtime_ns
        except OSError:
            return None

    def _remove(self, token: str) -> None:
        """Remove the lock of a holder, unless another process has acquired it since."""
        aside = self.file.with_suffix(f".{secrets.token_hex(8)}")
        with suppress(OSError):
            os.rename(self.file, aside)
            if aside.read_text() != token:
                with suppress(OSError):
                    os.link(aside, self.file)
            aside.unlink()

    def _beat(self, ended: threading.Event) -> None:
        while not ended.wait(BEAT):
            with suppress(OSError):
                if self.file.read_text() == self._token:
                    os.utime(self.file)


def _owner() -> str:
    return f"{socket.gethostname()} {os.getpid()}"


def _is_gone(token: str) -> bool:
    """Whether the holder was a process of this machine that has ended."""
    host, _, rest = token.partition(" ")
    pid = rest.partition(" ")[0]
    if host != socket.gethostname() or not pid.isdigit() or os.name != "posix":
        return False
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False
