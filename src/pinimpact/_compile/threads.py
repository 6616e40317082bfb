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

MIN_ROWS = 32
"""Minimum number of rows per call."""

MAX_ROWS = 4096
"""Maximum number of rows per call, so that Ctrl-C is handled within some tenths of a second."""


@functools.cache
def _helpers() -> ThreadPoolExecutor:
    """Return a pool with at most one thread per core.

    Its threads are reused, because on busy cores a new thread starts on the core of its caller.
    """
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="pinimpact")


if hasattr(os, "register_at_fork"):  # a forked process has no threads of its parent
    os.register_at_fork(after_in_child=_helpers.cache_clear)


def in_threads(solve: Callable[[slice], T], count: int, threads: int) -> list[T]:
    """Call `solve` for slices of `count` rows in several threads, and return its results in order.

    A thread that is done takes the next slice. The first slices are long, to save calls, and the last ones
    short, so that all threads end together although rows differ in cost and cores in speed.
    """
    if count <= (MAX_ROWS if threads == 1 else MIN_ROWS):
        return [solve(slice(0, count))]
    starts = [0]
    while starts[-1] < count:
        rows = (count - starts[-1]) // (2 * threads)
        starts.append(min(count, starts[-1] + min(max(MIN_ROWS, rows), MAX_ROWS)))
    tasks = deque(enumerate(map(slice, starts, starts[1:])))
    results: list[Any] = [None] * len(tasks)

    def work() -> None:
        while True:
            try:
                place, rows = tasks.popleft()
            except IndexError:  # none is left
                return
            results[place] = solve(rows)

    solve(slice(0, 0))  # compiles the kernel before the threads start
    others = [_helpers().submit(work) for _ in range(min(threads, len(tasks)) - 1)]
    try:
        work()
    finally:
        tasks.clear()  # not empty if an error was raised
        begun = [other for other in others if not other.cancel()]
        wait(begun)
    for other in begun:
        other.result()
    return results


def thread_count(threads: Any) -> int:
    """Return a number of threads, or raise `InputError`."""
    return whole_number("threads", threads, 1)
