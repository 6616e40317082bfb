"""Rows of a batch shared among threads, for kernels that are `jit.released`."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

from ..errors import InputError

T = TypeVar("T")


def in_threads(solve: Callable[[slice], T], count: int, threads: int) -> list[T]:
    """Call `solve` for the slices that threads share `count` rows in; return what it returns, in order."""
    share = -(-count // threads)
    shares = [slice(start, start + share) for start in range(0, count, share)] if share else []
    if len(shares) <= 1:
        return [solve(slice(0, count))]
    solve(slice(0, 0))  # compiled before the threads start
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(solve, shares))


def thread_count(threads: Any) -> int:
    """Return a number of threads, or raise `InputError`."""
    if not isinstance(threads, (int, np.integer)) or threads < 1:
        raise InputError(
            f"threads: {threads!r} given, a whole number from 1 expected", field="threads", value=threads
        )
    return int(threads)
