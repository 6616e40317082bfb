"""Distribution of the rows of a batch among threads."""

from __future__ import annotations

import os
import signal
import threading
import warnings

import pytest

from pinimpact._compile.threads import in_threads


@pytest.mark.parametrize("threads", [1, 2, 3, 200])
@pytest.mark.parametrize("count", [0, 1, 33, 1000, 12345])
def test_each_row_is_solved_once_with_results_in_order(count, threads):
    shares = in_threads(lambda rows: range(rows.start, rows.stop), count, threads)
    assert [row for share in shares for row in share] == list(range(count))


def test_rows_of_slow_thread_are_solved_by_others():
    """The thread with the first rows waits until the other thread has solved three quarters of all rows."""
    count, solved, rest = 1000, [], threading.Event()

    def solve(rows):
        if rows.stop > 0 and rows.start == 0:
            assert rest.wait(timeout=10.0)
        solved.append(rows.stop - rows.start)
        if sum(solved) >= 3 * count // 4:
            rest.set()

    in_threads(solve, count, 2)
    assert sum(solved) == count


@pytest.mark.parametrize("bad", [0, 999])
def test_error_in_any_thread_is_raised(bad):
    def solve(rows):
        if rows.start <= bad < rows.stop:
            raise IndexError("row")

    with pytest.raises(IndexError, match="row"):
        in_threads(solve, 1000, 3)


def test_threads_are_reused_and_no_more_than_cores():
    before = threading.active_count()
    for _ in range(20):
        in_threads(lambda rows: None, 1000, 50)
    assert threading.active_count() <= before + os.cpu_count()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_forked_process_starts_its_own_threads():
    """Threads of the parent do not exist in the child, which would wait for them for ever."""
    other = threading.Event()

    def solve(rows):
        if rows.start > 0:
            other.set()
        elif rows.stop > 0:
            other.wait()

    in_threads(solve, 1000, 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # about forks with threads
        child = os.fork()
    if child == 0:
        signal.alarm(10)
        other.clear()
        in_threads(solve, 1000, 2)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
