"""Compilation of kernels: when it is needed, by the worker pool, from a wheel; messages to users who wait."""

from __future__ import annotations

import json
import logging
import multiprocessing
import operator
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba import types
from numba.core import event
from numba.core.registry import cpu_target
from numba.core.runtime import _nrt_python, rtsys
from rich.console import Console

import pinimpact
from pinimpact._compile import jit as decorators
from pinimpact._compile import pool, portable, waiting
from pinimpact._compile.borrowing import borrowed
from pinimpact._compile.jit import external, inlined, jit
from pinimpact._compile.operators import OperatorTypes
from pinimpact._compile.waiting import reached
from pinimpact.app.terminal import compiling_shown

SOURCE = Path(pinimpact.__file__).parent / "_compile"

LEAF = '''"""A leaf."""
from ..._compile.jit import external, inlined
FACTOR = 2.0


@inlined
def scaled(x):
    return FACTOR * x


@external
def shifted(x):
    """Shift."""
    return scaled(x) + 1.0
'''
ENTRY = '''"""Two entries."""
from ..._compile.jit import jit
from . import leaf


@jit
def first(x):
    """First."""
    return leaf.shifted(x)


@jit
def second(x):
    return 10.0 * leaf.shifted(leaf.scaled(x))
'''
OTHER = """from ..._compile.jit import jit


@jit
def third(x):
    return -x
"""
CALL = """
import json
from numba.core import event
from pinimpact.scene._kernels import entry, other
with event.install_recorder("numba:compile") as record:
    answers = entry.first(3.0), entry.second(3.0), other.third(3.0)
made = [one.data["dispatcher"].py_func.__name__ for _, one in record.buffer if one.is_start]
print(json.dumps([answers, made]))
"""


def write_package(folder: Path) -> Path:
    """Write a package, also named pinimpact, with the decorators and three small modules of kernels."""
    root = folder / "pinimpact"
    shutil.copytree(SOURCE, root / "_compile", ignore=shutil.ignore_patterns("__pycache__"))
    kernels = root / "scene" / "_kernels"
    kernels.mkdir(parents=True)
    for name, text in (("leaf", LEAF), ("entry", ENTRY), ("other", OTHER)):
        (kernels / f"{name}.py").write_text(text)
    for folder in (root, root / "scene", kernels):
        (folder / "__init__.py").write_text("")
    return root


@pytest.fixture
def package(tmp_path: Path) -> Path:
    return write_package(tmp_path)


class FirstRun(NamedTuple):
    folder: Path  # of a package
    kept: Path  # copy of the folder after the first run, which has compiled the kernels
    done: subprocess.CompletedProcess[str]


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> FirstRun:
    folder, kept = tmp_path_factory.mktemp("here"), tmp_path_factory.mktemp("kept") / "copy"
    done = python(write_package(folder))
    shutil.copytree(folder, kept)
    return FirstRun(folder, kept, done)


@pytest.fixture
def compiled(first_run: FirstRun) -> Path:
    """Return a package whose kernels are cached, always in the same folder, as the cache refers to it."""
    shutil.rmtree(first_run.folder)
    shutil.copytree(first_run.kept, first_run.folder)
    return first_run.folder / "pinimpact"


FORKED = """
import os, sys
for number, path in ((1, {out!r}), (2, {err!r})):
    os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
os.environ.update({variables!r})
import numba
numba.config.reload_config()
sys.dont_write_bytecode = True
sys.path.insert(0, {folder!r})
assert "pinimpact" not in sys.modules
exec({code!r})
"""
forks = multiprocessing.get_context("forkserver" if sys.platform != "win32" else "spawn")
forks.set_forkserver_preload(["pytest", "numba.core.event"])  # what a process takes half a second to import


def python(package: Path, code: str = CALL, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process that has imported numba and nothing of a package."""
    variables = {"NUMBA_CACHE_DIR": str(package.parent / "cache")} | variables
    if not variables.keys() <= {"NUMBA_CACHE_DIR", "TMPDIR"}:
        return started(package, code, **variables)
    with tempfile.TemporaryDirectory() as folder:
        out, err = (Path(folder, name) for name in ("out", "err"))
        whole = FORKED.format(
            out=str(out), err=str(err), variables=variables, folder=str(package.parent), code=code
        )
        process = forks.Process(target=exec, args=(whole, {"__name__": "__main__"}))
        process.start()
        process.join(300.0)
        done = subprocess.CompletedProcess(
            code, process.exitcode, *(path.read_text(encoding="utf-8") for path in (out, err))
        )
        done.check_returncode()
        return done


def started(package: Path, code: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run code in a process that has imported nothing."""
    environment = dict(
        os.environ,
        PYTHONPATH=str(package.parent),
        PYTHONDONTWRITEBYTECODE="1",  # bytecode identifies sources by size and time in whole seconds
    )
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=environment | variables,
        timeout=300.0,
    )


def call(package: Path) -> tuple[list[float], list[str]]:
    answers, made = json.loads(python(package).stdout)
    return answers, made


def edit(path: Path, old: str, new: str) -> None:
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def test_only_edited_code_and_its_callers_are_recompiled(compiled: Path, first_run: FirstRun) -> None:
    package = compiled
    leaf, entry = (package / "scene" / "_kernels" / name for name in ("leaf.py", "entry.py"))
    found = json.loads(first_run.done.stdout)
    assert found == [[7.0, 130.0, -3.0], ["first", "shifted", "scaled", "second", "third"]]
    # edits of comments, docstrings and layout, in callers and callees
    edit(
        leaf, "FACTOR = 2.0\n", '"""Docstring."""\n\nFACTOR = 2.0  # twice\n"""What a kernel doubles by."""\n'
    )
    edit(leaf, '"""Shift."""', '"""Shift,\n\n    by one.\n    """')
    edit(entry, "def second(x):\n", 'def second(x):\n    """New docstring."""\n    # and a comment\n')
    edit(package / "_compile" / "jit.py", '"""The decorators', '"""All the decorators')
    edit(package / "scene" / "_kernels" / "other.py", "-x", "-1.0 * x")
    assert call(package) == ([7.0, 130.0, -3.0], ["third"])
    # a constant of an inlined kernel of a callee in another module
    edit(leaf, "FACTOR = 2.0", "FACTOR = 3.0")
    assert call(package) == ([10.0, 280.0, -3.0], ["first", "shifted", "scaled", "second"])
    assert call(package) == ([10.0, 280.0, -3.0], [])


def test_callee_missing_in_cache_is_compiled_before_its_caller_is_loaded(compiled: Path) -> None:
    package = compiled
    for file in (package.parent / "cache").rglob("leaf.*"):
        file.unlink()
    assert call(package) == ([7.0, 130.0, -3.0], ["shifted", "scaled"])


def test_cached_files_of_other_signatures_or_sources_are_rejected(package: Path) -> None:
    both = "\nprint(other.third(2.0), other.third(2))"
    imports = "from pinimpact.scene._kernels import other"
    assert python(package, imports + both).stdout == "-2.0 -2\n"
    real, whole = sorted((package.parent / "cache").rglob("other.third*.nbc"))
    of_reals, of_integers = real.read_bytes(), whole.read_bytes()
    real.write_bytes(of_integers)
    whole.write_bytes(of_reals)
    assert python(package, imports + both).stdout == "-2.0 -2\n"
    edit(package / "scene" / "_kernels" / "other.py", "-x", "-3 * x")
    assert python(package, imports + both).stdout == "-6.0 -6\n"
    real.write_bytes(of_reals)
    assert python(package, imports + both).stdout == "-6.0 -6\n"


def test_source_edited_after_import_leaves_no_stale_kernel(package: Path) -> None:
    leaf = package / "scene" / "_kernels" / "leaf.py"
    late = (  # Python identifies sources of its bytecode by times in whole seconds
        "import os\nfrom pathlib import Path\nfrom pinimpact.scene._kernels import entry\n"
        f"leaf = Path({str(leaf)!r})\n"
        "leaf.write_text(leaf.read_text().replace('FACTOR = 2.0', 'FACTOR = 3.0'))\n"
        "os.utime(leaf, (leaf.stat().st_mtime + 2,) * 2)\n"
    )
    assert json.loads(python(package, late + CALL).stdout)[0] == [7.0, 130.0, -3.0]
    assert call(package)[0] == [10.0, 280.0, -3.0]


TEAM = """
import os, sys, time
from pinimpact._compile import pool, jit
jit.WORTH_HELP = -1.0
pool.possible_helpers = lambda: 1
shared = pool.WorkerPool.compile_with_others

def wait_for(condition):
    def waiting(self, jobs):
        end = time.monotonic() + 60.0
        while not all(condition(self, job) for job in jobs):
            assert time.monotonic() < end
            time.sleep(0.01)
    return waiting
"""
HELPER_DOES_ALL = """
pool.WorkerPool.compile_with_others = wait_for(lambda team, job: team._is_locked(job) and team._is_over(job))
"""
HELPER_DIES = """
pool._CODE = '''
import os, pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
from {} import WorkerPool
_, folder, _ = pickle.load(sys.stdin.buffer)
for job in pickle.load(sys.stdin.buffer):
    WorkerPool(folder).lock(job)
os._exit(3)
'''
locked = wait_for(lambda team, job: team._is_locked(job))
pool.WorkerPool.compile_with_others = lambda self, jobs: (locked(self, jobs), shared(self, jobs))
"""
NO_CHILD_IS_LEFT = """
try:
    sys.exit(f"a child is left: {os.waitpid(-1, os.WNOHANG)}")
except ChildProcessError:
    pass
"""


@pytest.fixture
def team(package: Path) -> Path:
    """Return the package after declaring types of arguments, next to a folder for temporary files."""
    declaration = "from ..._compile.declared import declared\n\n\n@declared(float)\n"
    edit(package / "scene" / "_kernels" / "entry.py", "@jit\ndef first", f"{declaration}@jit\ndef first")
    edit(package / "scene" / "_kernels" / "leaf.py", "@external", f"{declaration}@external")
    (package.parent / "temporary").mkdir()
    return package


def of_team(team: Path, code: str) -> tuple[list[float], list[str]]:
    done = python(team, TEAM + code, TMPDIR=str(team.parent / "temporary"))
    assert done.stderr == ""
    assert list((team.parent / "temporary").iterdir()) == []
    answers, made = json.loads(done.stdout)
    return answers, made


needs_waitpid = pytest.mark.skipif(sys.platform == "win32", reason="needs waitpid")


@needs_waitpid
def test_helpers_compile_declared_kernels(team: Path) -> None:
    assert of_team(team, HELPER_DOES_ALL + CALL + NO_CHILD_IS_LEFT) == ([7.0, 130.0, -3.0], [])
    assert call(team) == ([7.0, 130.0, -3.0], [])


@needs_waitpid
def test_waiting_process_and_helpers_share_the_tasks(team: Path) -> None:
    answers, made = of_team(team, CALL + NO_CHILD_IS_LEFT)
    assert answers == [7.0, 130.0, -3.0]
    assert len(made) == len(set(made))
    assert call(team) == ([7.0, 130.0, -3.0], [])


@needs_waitpid
def test_kernels_not_finished_by_a_helper_are_compiled_by_others(team: Path) -> None:
    answers, made = of_team(team, HELPER_DIES + CALL + NO_CHILD_IS_LEFT)
    assert answers == [7.0, 130.0, -3.0]
    assert sorted(made) == ["first", "scaled", "second", "shifted", "third"]
    shutil.rmtree(team.parent / "cache")
    fails = "pool._CODE = 'raise SystemExit(1)'\n"
    assert of_team(team, fails + CALL + NO_CHILD_IS_LEFT)[0] == [7.0, 130.0, -3.0]


@needs_waitpid
def test_interrupt_ends_helpers(team: Path) -> None:
    interrupted = (
        "def interrupt(self, jobs):\n    assert len(self._helpers) == 1\n    raise KeyboardInterrupt\n"
        "pool.WorkerPool.compile_with_others = interrupt\n"
        "from pinimpact.scene._kernels import entry\n"
        "try:\n    entry.first(3.0)\nexcept KeyboardInterrupt:\n    print('stopped')\n"
    )
    assert python(team, TEAM + interrupted + NO_CHILD_IS_LEFT).stdout == "stopped\n"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_helpers_end_with_the_process_that_started_them(team: Path) -> None:
    killed = (
        "pool._CODE += '; import time; time.sleep(300)'\n"
        "def die(self, jobs):\n    [pid] = self._helpers\n    print(pid, flush=True)\n    os._exit(0)\n"
        "pool.WorkerPool.compile_with_others = die\n"
        "from pinimpact.scene._kernels import entry\n"
        "entry.first(3.0)\n"
    )
    killed_one = python(team, TEAM + killed, TMPDIR=str(team.parent / "temporary"))
    state = Path("/proc", killed_one.stdout.strip(), "cmdline")
    end = time.monotonic() + 60.0
    while state.exists() and state.read_bytes():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_script_needs_no_main_guard_for_helpers(team: Path) -> None:
    script = team.parent / "script.py"
    script.write_text(TEAM + HELPER_DOES_ALL + CALL)
    environment = dict(os.environ, PYTHONPATH=str(team.parent), NUMBA_CACHE_DIR=str(team.parent / "cache"))
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=True, env=environment
    )
    assert (done.stdout.count("\n"), done.stderr) == (1, "")
    assert json.loads(done.stdout) == [[7.0, 130.0, -3.0], []]


def test_two_simultaneous_first_runs_with_helpers(team: Path) -> None:
    environment = dict(os.environ, PYTHONPATH=str(team.parent), NUMBA_CACHE_DIR=str(team.parent / "cache"))
    command = [sys.executable, "-c", TEAM + CALL]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) for _ in range(2)]
    answers = [json.loads(one.communicate()[0])[0] for one in both]
    assert answers == 2 * [[7.0, 130.0, -3.0]]


def test_wrongly_declared_arguments_do_not_matter(team: Path) -> None:
    edit(team / "scene" / "_kernels" / "leaf.py", "@declared(float)", "@declared(float, float)")
    edit(team / "scene" / "_kernels" / "entry.py", "@declared(float)", "@declared(bool)")
    assert of_team(team, CALL)[0] == [7.0, 130.0, -3.0]


SHARED = """
import tempfile
from pathlib import Path
from numba.core import event
from pinimpact._compile import declared, pool
from pinimpact.scene._kernels import entry
jobs = declared.jobs([(entry.first, declared.declared_types(entry.first))])
[shifted] = [job for job in jobs if job.name == "shifted"]
pool.present = pool.WorkerPool(Path(tempfile.mkdtemp()))
assert pool.present.lock(shifted)
with event.install_recorder("numba:compile") as record:
    pool.present.compile_with_others(jobs)
    pool.present = None
    assert not entry.first.overloads
    print(entry.first(3.0))
print([one.data["dispatcher"].py_func.__name__ for _, one in record.buffer if one.is_start])
"""


def test_callers_of_kernels_with_declared_result_do_not_wait(team: Path) -> None:
    leaf = team / "scene" / "_kernels" / "leaf.py"
    edit(leaf, "@declared(float)", "@declared(float, result=float)")
    # "first" is compiled while another process holds the lock of "shifted" without compiling it
    assert python(team, SHARED).stdout == "7.0\n['first', 'shifted', 'scaled']\n"
    assert call(team)[0] == [7.0, 130.0, -3.0]


def test_callee_is_compiled_after_its_caller(team: Path) -> None:
    edit(team / "scene" / "_kernels" / "leaf.py", "@declared(float)", "@declared(float, result=float)")
    alone = SHARED.replace("assert pool.present.lock(shifted)", "jobs.sort(key=lambda job: job.name)")
    kept = "    assert entry.leaf.shifted._cache.knows(shifted.types)\n"
    alone = alone.replace("    pool.present = None\n", f"    pool.present = None\n{kept}")
    assert python(team, alone).stdout == "7.0\n['first', 'shifted', 'scaled']\n"


def test_process_too_late_for_a_lock_continues_with_other_kernels(team: Path) -> None:
    edit(team / "scene" / "_kernels" / "leaf.py", "@declared(float)", "@declared(float, result=float)")
    late = (
        "jobs.sort(key=lambda job: job.name != 'shifted')\nlooks, look = [], pool.WorkerPool._is_locked\n"
        "def unseen(self, job):\n    looks.append(job)\n"
        "    return len(looks) > len(jobs) and look(self, job)\n"
        "pool.WorkerPool._is_locked = unseen\nwith event.install_recorder("
    )
    raced = SHARED.replace("with event.install_recorder(", late)
    assert python(team, raced).stdout == "7.0\n['first', 'shifted', 'scaled']\n"


def test_wrongly_declared_result_raises(team: Path) -> None:
    edit(team / "scene" / "_kernels" / "leaf.py", "@declared(float)", "@declared(float, result=int)")
    with pytest.raises(subprocess.CalledProcessError) as raised:
        python(team)
    assert "shifted: returns float64, not int64 as declared" in raised.value.stderr


def test_no_helpers_without_compiler_or_cache(team: Path) -> None:
    forbidden = TEAM + "def _helper(*_): raise AssertionError\npool._helper = _helper\n"
    plain = python(team, forbidden + CALL, NUMBA_DISABLE_JIT="1")
    assert json.loads(plain.stdout)[0] == [7.0, 130.0, -3.0]
    (team.parent / "cache").write_text("a file where a folder is wanted")
    closed = "import tempfile\ndef fail(*_, **__): raise OSError\ntempfile.TemporaryFile = fail\n"
    assert json.loads(python(team, forbidden + closed + CALL).stdout)[0] == [7.0, 130.0, -3.0]


def test_number_of_helpers(monkeypatch: pytest.MonkeyPatch) -> None:
    def possible(processors: int, executable: str | None) -> int:
        with monkeypatch.context() as here:
            here.setattr(os, "sched_getaffinity", lambda _: set(range(processors)), raising=False)
            here.setattr(sys, "executable", executable)
            return pool.possible_helpers()

    assert [possible(k, "/usr/bin/python3.11") for k in (1, 2, 3, 64)] == [0, 1, 2, pool.MOST - 1]
    assert [possible(4, other) for other in (None, "", "/opt/blender/blender")] == [0, 0, 0]
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    assert possible(4, "/usr/bin/python3.11") == 0


def test_inlined_bitcode_is_cached_and_linked_into_callers(package: Path) -> None:
    leaf = package / "scene" / "_kernels" / "leaf.py"
    edit(leaf, "external, inlined", "external, inlined_bitcode")
    edit(leaf, "@inlined", "@external\ndef half(x):\n    return 0.5 * x\n\n\n@inlined_bitcode")
    edit(leaf, "FACTOR * x", "2.0 * FACTOR * half(x)")
    assert call(package)[0] == [7.0, 130.0, -3.0]
    for file in (package.parent / "cache").rglob("entry.*"):
        file.unlink()
    assert call(package) == ([7.0, 130.0, -3.0], ["first", "second"])
    edit(leaf, "FACTOR = 2.0", "FACTOR = 3.0")
    assert call(package)[0] == [10.0, 280.0, -3.0]


FOR_ALL = {"NUMBA_CPU_NAME": portable.processor(), "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": ""}
OLD_PROCESSOR = "from pinimpact._compile import portable\nportable.runs_here = lambda: False\n"


@pytest.mark.skipif(not portable.runs_here(), reason="kernels of a wheel do not run on this processor")
def test_kernels_of_wheel_are_used_anywhere_unless_edited(package: Path, tmp_path: Path) -> None:
    assert json.loads(python(package, **FOR_ALL).stdout)[1] != []
    installed = tmp_path / "elsewhere" / "pinimpact"
    installed.parent.mkdir()
    package.rename(installed)
    before = {file: file.read_bytes() for file in installed.rglob("*.nb?")}
    assert before
    assert call(installed) == ([7.0, 130.0, -3.0], [])
    assert not list(installed.parent.rglob("cache/**/*.nb?"))
    answers, made = json.loads(python(installed, OLD_PROCESSOR + CALL).stdout)
    assert (answers, made) == ([7.0, 130.0, -3.0], ["first", "shifted", "scaled", "second", "third"])
    edit(installed / "scene" / "_kernels" / "leaf.py", "FACTOR = 2.0", "FACTOR = 3.0")
    assert call(installed) == ([10.0, 280.0, -3.0], ["first", "shifted", "scaled", "second"])
    assert {file: file.read_bytes() for file in installed.rglob("*.nb?")} == before


class Pair(NamedTuple):
    kept: np.ndarray
    factor: float


@inlined
def pair(n, factor):
    return Pair(np.full(n, 1.0), factor)


@jit
def with_references(n):
    total = Pair(np.zeros(n), 0.0)
    for k in range(n):
        one = pair(n, float(k))
        if k % 3 == 2:
            continue
        last, spare = one, total
        total = Pair(spare.kept + last.factor * last.kept, last.factor)
    return total.kept, total.factor


@jit
def refined(n):
    total = 0
    step = 0
    for k in range(n):
        last = total + step
        total = last
        step = 0.5 * k
    return total, last


def test_types_inferred_late_reach_earlier_variables() -> None:
    assert refined(5) == (3.0, 3.0)
    assert refined.signatures[0][0] == numba.int64
    assert str(refined.nopython_signatures[0].return_type) == "UniTuple(float64 x 2)"


@inlined
def longer(length, more):
    return length + 1 if more else length


@jit
def grown(n):
    length = 0  # numba types it as a literal until it has typed the loop
    for k in range(n):
        length = longer(length, k % 2 == 0)
    return length


def test_variable_updated_in_loop_is_not_typed_as_literal() -> None:
    assert grown(9) == 5


def test_cached_kernels_are_loaded_without_the_compiler(package: Path) -> None:
    imported = "\nimport sys\nprint('numba.np.linalg' in sys.modules)"
    assert python(package, CALL + imported).stdout.endswith("True\n")
    assert python(package, CALL + imported).stdout.endswith("False\n")


def allocated_and_freed(kernel: Callable[[int], Any], sizes: Iterable[int]) -> tuple[int, int]:
    """Return how many blocks of memory calls of a kernel allocate and free."""
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    for n in sizes:
        kernel(n)
    after = rtsys.get_allocation_stats()
    _nrt_python.memsys_disable_stats()
    return after.mi_alloc - before.mi_alloc, after.mi_free - before.mi_free


def test_memory_of_kernels_is_released_once() -> None:
    def check(n: int) -> None:
        kept, factor = with_references(n)
        np.testing.assert_array_equal(kept, np.full(5, 0.0 + 1.0 + 3.0 + 4.0))
        assert factor == 4.0

    allocated, freed = allocated_and_freed(check, [5, 5, 5])
    assert allocated == freed > 0


@inlined
def sums_of_rows(rows, out):
    rows, parts = borrowed((rows, Pair(out, 1.0)))
    for k in range(len(rows)):
        row = rows[k]
        parts = Pair(parts.kept[1:] if k > 0 else parts.kept, parts.factor + k)
        parts.kept[0] = parts.factor * row[1:].sum()


@jit
def sums_of_new_rows(n):
    rows, out = np.full((n, 3), 2.0), np.zeros(n)
    sums_of_rows(rows, out)
    return out, rows[0, 0]


def test_arrays_are_borrowed_for_the_duration_of_a_call() -> None:
    expected = np.cumsum([1.0, 0.0, 1.0, 2.0])[1:] * 4.0
    kept = [sums_of_new_rows(3) for _ in range(50)]
    rubbish = [np.full(3, -1.0) for _ in range(200)]
    assert len(rubbish) == 200
    for out, first in kept:
        np.testing.assert_array_equal(out, expected)
        assert first == 2.0
    allocated, freed = allocated_and_freed(sums_of_new_rows, range(1, 9))
    assert allocated == freed == 16


@external
def double_rows(rows, pair, out):
    """Allocate nothing: references are not counted."""
    parts = pair.kept[1:] if pair.factor > 0.0 else pair.kept
    for row in rows:
        first = row[0]
        for k in range(len(row)):
            row[k] *= pair.factor
        out[0] += first + parts[0]


@external
def part_of(rows, k):
    return rows[k][1:]


@external
def pair_of(rows, k):
    return Pair(rows[k], 2.0)


@external
def selected(out, order):
    return out[order].sum()


@jit
def views_and_selections(n):
    rows, out, order = np.full((n, 3), 2.0), np.zeros(n), np.arange(n)[::-1].copy()
    double_rows(rows, Pair(np.ones(2), 3.0), out)
    part, pair = part_of(rows, n - 1), pair_of(rows, 0)
    return out, part, pair, selected(out, order)


def test_references_are_counted_only_by_kernels_that_allocate_or_return_arrays() -> None:
    kept = [views_and_selections(4) for _ in range(50)]
    rubbish = [np.full(12, -1.0) for _ in range(200)]
    assert len(rubbish) == 200
    for out, part, pair, total in kept:
        np.testing.assert_array_equal(out, [4 * 3.0, 0.0, 0.0, 0.0])
        np.testing.assert_array_equal(part, [6.0, 6.0])
        np.testing.assert_array_equal(pair.kept, [6.0, 6.0, 6.0])
        assert total == 12.0
    del kept, out, part, pair
    allocated, freed = allocated_and_freed(views_and_selections, range(2, 9))
    assert allocated == freed > 0


def test_message_while_compiling_appears_in_the_first_run(compiled: Path, first_run: FirstRun) -> None:
    package = compiled
    assert first_run.done.stderr == ""  # compilation is too short for a message
    shutil.rmtree(package.parent / "cache")
    edit(package / "_compile" / "waiting.py", "SHORT = 1.0", "SHORT = 0.0")
    lines = python(package).stderr.splitlines()
    start = "pinimpact: compiling kernels for impacts and scenes, which are then cached"
    assert lines
    assert all(line.startswith(start) for line in lines)
    assert python(package).stderr == ""
    shutil.rmtree(package.parent / "cache")
    quiet = "import logging; logging.getLogger('pinimpact.compiling').setLevel('ERROR')\n"
    assert python(package, quiet + CALL).stderr == ""


def test_message_is_repeated_for_a_longer_wait_only(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(waiting, "_announced", {})
    for seconds in (0.5, 2.0, 1.5, 9.0, 9.0, 3.0):
        monkeypatch.setattr(waiting, "expected", lambda *_, seconds=seconds: seconds)
        waiting.announce([another_call], kept=True)
    assert [message.split()[-2] for message in caplog.messages] == ["2", "9"]


def test_estimated_wait_counts_all_reachable_kernels() -> None:
    names = {function.__name__ for function in reached([another_call, both])}
    assert names == {"another_call", "halved", "cubed", "one_call", "both", "product"}
    assert len(reached([both])) == 2 + 1


def test_message_without_writable_cache_folder(package: Path) -> None:
    (package.parent / "cache").write_text("a file where a folder is wanted")
    edit(package / "_compile" / "waiting.py", "SHORT = 1.0", "SHORT = 0.0")
    closed = "import tempfile\ndef fail(*_, **__): raise OSError\ntempfile.TemporaryFile = fail\n"
    answer = python(package, closed + CALL)
    assert json.loads(answer.stdout)[0] == [7.0, 130.0, -3.0]
    assert "in every process" in answer.stderr
    assert "NUMBA_CACHE_DIR" in answer.stderr


def test_damaged_cache_is_filled_again(compiled: Path) -> None:
    package = compiled
    for index in (package.parent / "cache").rglob("*.nbi"):
        index.write_bytes(index.read_bytes()[:-20])
    answers, made = call(package)
    assert answers == [7.0, 130.0, -3.0]
    assert made
    assert call(package) == (answers, [])


def test_plain_python_without_the_compiler(package: Path) -> None:
    answer = python(package, NUMBA_DISABLE_JIT="1")
    assert json.loads(answer.stdout) == [[7.0, 130.0, -3.0], []]
    assert answer.stderr == ""


def test_impacts_run_without_the_compiler() -> None:
    code = (
        "import numba, numpy, pinimpact as p; assert numba.config.DISABLE_JIT\n"
        "w = [[2, 0, .5], [0, 3, .4], [.5, .4, 1]]\n"
        "one = p.solve_impact(p.ImpactProblem(w, (1, .5, -1), .3, .5))\n"
        "many = p.solve_impacts([w], [(1, .5, -1)], .3, .5)\n"
        "robot = p.load_robot('panda')\n"
        "hand = p.Contact('panda_hand_tcp', p.Plane(), friction=.4, restitution=.5)\n"
        "q = numpy.array([0, .3, 0, -1.5, 0, 1.5, 0, .02, .02])\n"
        "hit = p.impact(robot.model, robot.data, q, numpy.eye(9)[1], hand)\n"
        "print(numpy.concatenate([one.velocity, many.velocity[0], hit.v]).tolist())"
    )
    both = [
        subprocess.run(
            [sys.executable, "-c", code.replace("assert numba", "numba") if on else code],
            capture_output=True,
            text=True,
            check=True,
            env=dict(os.environ, NUMBA_DISABLE_JIT="" if on else "1"),
        ).stdout
        for on in (True, False)
    ]
    compiled, plain = (np.array(json.loads(one)) for one in both)
    np.testing.assert_allclose(plain, compiled, rtol=1e-13, atol=1e-14)


@external
def cubed(x):
    return x * x * x


@inlined
def halved(x):
    return 0.5 * cubed(x)


@jit
def one_call(x):
    return halved(x)


@jit
def another_call(x, y):
    return halved(x) + cubed(y) + one_call(y)


def test_external_kernel_is_compiled_once() -> None:
    with event.install_recorder("numba:compile") as record:
        assert one_call(2.0) == 4.0
        assert another_call(2.0, 3.0) == 4.0 + 27.0 + 13.5
    made = [one.data["dispatcher"].py_func.__name__ for _, one in record.buffer if one.is_start]
    assert sorted(made) == ["another_call", "cubed", "halved", "one_call"]


def test_operators_on_numbers_are_typed_once() -> None:
    context = cpu_target.typing_context
    context.refresh()
    multiply, calls = context.resolve_value_type(operator.mul), []

    def resolve(*call: Any) -> Any:
        calls.append(call)
        return context.resolve_function_type(*call)

    known = OperatorTypes(SimpleNamespace(resolve_function_type=resolve))
    pairs = [(types.float32, types.literal(3)), (types.int8, types.complex128), (types.boolean, types.uint8)]
    for pair in pairs:
        typed = context.resolve_function_type(multiply, pair, {})
        assert known.resolve_function_type(multiply, pair, {}) == typed
        calls.clear()
        assert known.resolve_function_type(multiply, pair, {}) == typed
        assert not calls
    arrays = (types.float64[::1], types.float64[::1])
    for _ in range(2):
        calls.clear()
        known.resolve_function_type(multiply, arrays, {})
        assert calls


def test_kernels_can_be_called_from_numba_functions() -> None:
    @numba.njit
    def foreign(x):
        return halved(x) + one_call(x)

    assert foreign(2.0) == 8.0


def times(factor):
    @inlined
    def product(x):
        return factor * x

    return product


twice, thrice = times(2.0), times(3.0)


@jit
def both(x):
    return twice(x) + 100.0 * thrice(x)


def test_inlined_kernels_made_by_one_function_are_distinguished() -> None:
    assert both(1.0) == 302.0
    with pytest.raises(ValueError, match="defined inside a function"):
        jit(twice.py_func)


@jit
def with_array(x, n):
    return x[0] + n


def test_kernels_can_be_compiled_in_advance() -> None:
    decorators.compile_all((with_array, np.zeros(1), 1), (with_array, np.zeros((1, 1))[0], 1.0))
    with event.install_recorder("numba:compile") as record:
        assert with_array(np.ones(1), 2) == 3.0
        assert with_array(np.ones(1), 2.0) == 3.0
    assert not record.buffer


def test_command_line_shows_progress_of_compilation() -> None:
    logger = logging.getLogger("pinimpact.compiling")
    shown: list[str] = []
    with compiling_shown(Console(force_terminal=True), shown.append):
        logger.warning("%s: about %d s", "compiling", 25)
        logger.info("compiling, once: %d of %d", 3, 9)
    logger.info("nobody listens any more")
    assert shown == ["compiling: about 25 s", "compiling, once: 3 of 9, about 25 s"]
    with compiling_shown(Console(force_terminal=False), shown.append):
        logger.info("where no bar is seen, the logger goes on as it does")
    assert len(shown) == 2
    assert logger.level == logging.NOTSET
    assert logger.propagate
