"""Lock of the kernel cache: one process compiles a kernel, and its lock ends with it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

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


def test_lock_of_killed_process_is_released(package: Path) -> None:
    code = (
        "import os, signal\nfrom pinimpact._compile import linking\n"
        "def die(self): os.kill(os.getpid(), signal.SIGKILL)\n"
        "linking.KernelLibrary.finalize = die\n"
    )
    killed = started(package, code + CALL)
    killed.communicate(timeout=300)
    assert killed.returncode != 0
    assert list((package.parent / "cache").rglob("*.lock"))
    assert json.loads(python(package).stdout)[0] == [7.0, 130.0, -3.0]


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
    assert one.held
    one.release()
    waiting.join(30.0)
    assert other.held
    assert not one.held
    other.release()
    assert not other.held


def test_waiting_ends_when_the_lock_is_needless(tmp_path: Path) -> None:
    one, other = CacheLock(tmp_path), CacheLock(tmp_path)
    one.acquire()
    other.acquire(lambda: True)
    assert not other.held


FORKED = """
import os, signal, sys, time
from pinimpact._compile.lock import CacheLock
mine, other = CacheLock(sys.argv[1]), CacheLock(sys.argv[1])
mine.acquire()
ready, done = os.pipe()
child = os.fork()
if child == 0:
    mine.release()  # no effect
    os.write(done, b"%d" % mine.held)
    time.sleep(60.0)
found = [os.read(ready, 1) == b"1"]
other.acquire(lambda: True)
found.append(other.held)
mine.release()
other.acquire(lambda: True)
found.append(other.held)
os.kill(child, signal.SIGKILL)
print(found)
"""


def test_forked_process_neither_releases_nor_keeps_the_lock(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", FORKED, str(tmp_path)], capture_output=True, text=True)
    assert done.stdout == "[False, False, True]\n", done.stderr


def test_no_wait_if_lock_file_cannot_be_created(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("a file where a folder is wanted")
    mine = CacheLock(tmp_path / "file" / "cache")
    mine.acquire()
    assert not mine.held
    mine.release()
