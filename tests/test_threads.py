"""How rows of a batch are shared among threads."""

from __future__ import annotations

import threading

import pytest

from pinimpact._numeric.threads import in_threads


@pytest.mark.parametrize("threads", [1, 2, 3, 200])
@pytest.mark.parametrize("count", [0, 1, 33, 1000, 12345])
def test_every_row_is_solved_once_and_results_come_in_order(count, threads):
    shares = in_threads(lambda rows: range(rows.start, rows.stop), count, threads)
    assert [row for share in shares for row in share] == list(range(count))


def test_a_thread_that_is_slow_leaves_its_rows_to_the_others():
    """The thread with the first rows waits until all others are solved, which nobody but the other can do."""
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
def test_an_error_is_raised_whichever_thread_meets_it(bad):
    def solve(rows):
        if rows.start <= bad < rows.stop:
            raise IndexError("row")

    with pytest.raises(IndexError, match="row"):
        in_threads(solve, 1000, 3)
