"""Rows of a batch shared among threads, for kernels that are `jit.released`."""

from __future__ import annotations

import functools
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeVar

from ..checks import whole_number

T = TypeVar("T")

LEAST_SHARE = 32
"""Smallest number of rows per call."""

MOST_SHARE = 4096
"""Largest number of rows per call: after some tenths of a second at the most Ctrl-C is answered."""


@functools.cache
def _helpers() -> ThreadPoolExecutor:
    """Return the waiting threads; there are never more of them than cores.

    They are kept, because on busy cores a new thread starts on the core of its caller.
    """
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="pinimpact")


if hasattr(os, "register_at_fork"):  # a child of the process has none of its threads
    os.register_at_fork(after_in_child=_helpers.cache_clear)


def in_threads(solve: Callable[[slice], T], count: int, threads: int) -> list[T]:
    """Call `solve` for slices of `count` rows, and return its results in order; a thread takes the next one.

    The first slices are long, to save calls, and the last ones short, so that all threads end together: rows
    differ in cost, and cores in speed.
    """
    if count <= (MOST_SHARE if threads == 1 else LEAST_SHARE):
        return [solve(slice(0, count))]
    starts = [0]
    while starts[-1] < count:
        share = (count - starts[-1]) // (2 * threads)
        starts.append(min(count, starts[-1] + min(max(LEAST_SHARE, share), MOST_SHARE)))
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
    others = [_helpers().submit(work) for _ in range(min(threads, len(shares)) - 1)]
    try:
        work()
    finally:
        shares.clear()  # there are some left where an error was raised
        begun = [other for other in others if not other.cancel()]
        wait(begun)
    for other in begun:
        other.result()
    return results


def thread_count(threads: Any) -> int:
    """Return a number of threads, or raise `InputError`."""
    return whole_number("threads", threads, 1)
