"""Lock of the kernel cache: one process compiles a kernel, and stale locks are taken over."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from pinimpact._compile import lock
from pinimpact._compile.lock import CacheLock
from tests.test_kernel_compiling import CALL, package, python

__all__ = ["package"]


def started(package: Path, code: str = CALL) -> subprocess.Popen[str]:
    environment = dict(
        os.environ, PYTHONPATH=str(package.parent), NUMBA_CACHE_DIR=str(package.parent / "cache")
    )
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )


def test_concurrent_first_runs_compile_each_kernel_once(package: Path) -> None:
    found = [one.communicate(timeout=300) for one in [started(package) for _ in range(4)]]
    assert [json.loads(out)[0] for out, _ in found] == 4 * [[7.0, 130.0, -3.0]]
    made = [name for out, _ in found for name in json.loads(out)[1]]
    kept = [name for name in made if name != "scaled"]  # in two kernels, maybe of different processes
    assert sorted(kept) == ["first", "second", "shifted", "third"]
    assert not list((package.parent / "cache").rglob("*.lock"))


def test_lock_of_killed_process_is_taken_over(package: Path) -> None:
    code = (
        "import os, signal\nfrom pinimpact._compile import linking\n"
        "def die(self): os.kill(os.getpid(), signal.SIGKILL)\n"
        "linking.KernelLibrary.finalize = die\n"
    )
    killed = started(package, code + CALL)
    killed.communicate(timeout=300)
    assert killed.returncode != 0
    [left] = (package.parent / "cache").rglob("*.lock")
    assert f" {killed.pid} " in left.read_text()
    assert json.loads(python(package).stdout)[0] == [7.0, 130.0, -3.0]
    assert not left.exists()


def in_thread(wanted: CacheLock) -> threading.Thread:
    thread = threading.Thread(target=wanted.acquire, daemon=True)
    thread.start()
    return thread


def test_lock_has_one_holder_and_is_passed_to_a_waiting_one(tmp_path: Path) -> None:
    one, other = CacheLock(tmp_path), CacheLock(tmp_path)
    one.acquire()
    assert one.held
    waiting = in_thread(other)
    waiting.join(3.0 * lock.PAUSE)
    assert waiting.is_alive()
    assert not other.held
    other.release()  # no effect
    assert one.file.exists()
    one.release()
    waiting.join(30.0)
    assert other.held
    assert not one.held
    other.release()
    assert not list(tmp_path.iterdir())


def test_only_locks_of_stopped_holders_are_taken_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lock, "BEAT", 0.05)
    monkeypatch.setattr(lock, "STALE", 1.0)
    one, other = CacheLock(tmp_path), CacheLock(tmp_path)
    one.acquire()
    waiting = in_thread(other)
    waiting.join(2.5 * lock.STALE)
    assert waiting.is_alive()
    one._ended.set()  # the holder stops renewing its lock
    waiting.join(30.0)
    assert other.held
    one.release()  # no effect on the lock of the other
    assert other.file.read_text() == other._token
    other.release()


def test_locks_of_ended_process_and_of_another_machine(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    mine = CacheLock(tmp_path)
    mine.file.write_text(f"{socket.gethostname()} {ended.pid} 00")
    begun = time.monotonic()
    mine.acquire()
    assert mine.held
    assert time.monotonic() - begun < lock.STALE
    mine.release()
    mine.file.write_text(f"elsewhere {ended.pid} 00")
    mine.acquire(lambda: True)  # returns without the lock, as the kernel exists by now
    assert not mine.held
    assert mine.file.exists()


def test_no_wait_if_lock_file_cannot_be_created(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("a file where a folder is wanted")
    mine = CacheLock(tmp_path / "file" / "cache")
    mine.acquire()
    assert not mine.held
    mine.release()
