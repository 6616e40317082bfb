"""Rows of a batch shared among threads, for kernels that are `jit.released`."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

from ..errors import InputError

T = TypeVar("T")

LEAST_SHARE = 32
"""Rows that are worth a call of their own."""


def in_threads(solve: Callable[[slice], T], count: int, threads: int) -> list[T]:
    """Call `solve` for slices of `count` rows, of which each thread takes the next; return what it returns.

    The first slices are long, to save calls, and the last are short, so that all threads end together: rows
    differ in what they cost, and so do the cores of a machine.

    Returns:
        what `solve` returns, in the order of the rows.
    """
    if threads == 1 or count <= LEAST_SHARE:
        return [solve(slice(0, count))]
    starts = [0]
    while starts[-1] < count:
        starts.append(min(count, starts[-1] + max(LEAST_SHARE, (count - starts[-1]) // (2 * threads))))
    shares = deque(enumerate(map(slice, starts, starts[1:])))
    results: list[Any] = [None] * len(shares)

    def work() -> None:
        while True:
            try:
                place, share = shares.popleft()
            except IndexError:  # none is left
                return
            results[place] = solve(share)

    solve(slice(0, 0))  # compiled before the threads start
    with ThreadPoolExecutor(threads - 1) as pool:
        others = [pool.submit(work) for _ in range(min(threads, len(shares)) - 1)]
        work()
        for other in others:
            other.result()
    return results


def thread_count(threads: Any) -> int:
    """Return a number of threads, or raise `InputError`."""
    if not isinstance(threads, (int, np.integer)) or threads < 1:
        raise InputError(
            f"threads: {threads!r} given, a whole number from 1 expected", field="threads", value=threads
        )
    return int(threads)
