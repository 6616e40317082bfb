"""Kernels as they are compiled against the same functions in Python."""

from __future__ import annotations

import gc
import math
import sys
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from pinimpact._compile.linking import KernelCompiler

compiled = numba.njit(pipeline_class=KernelCompiler, error_model="numpy")


def items(a, b, k):
    """Items of arrays, from the front and from the back, and by a tuple."""
    at = (k, -1)
    b[-1, k] = a[at] + 2
    b[at] += a[k][-2] * a[-1][k]
    return a[k, -2], b[0, -1], a[-k, k]


def cube(a, i):
    """Items and rows of three dimensions, and rows of rows."""
    page = a[i]
    row = page[-1]
    again = a[-1, i]
    again[0] = 7
    return page[0, 1], row[-1], len(row), page.shape[1], a[i, 1][2], again[0], a.shape[2]


def integers(n):
    found = np.zeros(n, dtype=np.int64)
    for i in range(n):
        found[i] = 3 * i - 1
    return found[-1] + found[1]


def loops(n, step):
    """Ranges of all kinds, and what their variables hold when they are over."""
    found = np.zeros(9)
    last = -5
    for i in range(n):
        found[0] += i
        last = i
    for i in range(2, n):
        found[1] += i
    for i in range(n - 1, -1, -1):
        found[2] = 10 * found[2] + i
    for i in range(0, n, 2):
        found[3] += i * i
    for i in range(n, 0, step):
        found[4] += i
    for i in range(n):
        for j in range(i, n):
            if j == 3:
                break
            found[5] += i * j
    each = range(1, n, 1)
    for _ in range(2):
        for i in each:
            found[6] += i
    found[7], found[8] = last, len(range(0, n, 3))
    return found


def numbers(x, y, i, j):
    """Sums and comparisons of numbers, of two types and of what is known."""
    return (
        x + y,
        x - i,
        2 * x,
        i * j - 3,
        x / y,
        j / x,
        1 / y,
        x < y,
        x <= i,
        x != y,
        x == 1,
        i > j,
        i != 2,
        x != x,
        (i, x, j)[-2],
        -x * i,
    )


def owned(n):
    """A row of an array that nobody else holds any more."""
    a = np.ones((n, 3))
    row = a[1]
    a = np.full((n, 3), 5.0)
    for i in range(3):
        row[i] += i
    return row


def taken(a, n):
    """An argument whose name is used again, and one that is handed back."""
    b = a
    for i in range(n):
        a = np.full(2, float(i))
        b[0] += a[1]
    return a, b


def early(a):
    """Variables that only one branch sets, and a loop at the very start."""
    while a[0] > 0.0:
        step = a[1]
        a[0] -= step
    c = 0.0
    if a[0] < -1.0:
        c = math.sqrt(-a[0])
    return a[0], c


class Pair(NamedTuple):
    """Arrays that are handed over together."""

    rows: np.ndarray
    last: np.ndarray
    factor: float


def of_tuple(pair, n):
    """Arrays of a tuple: read, written, kept in other names, and handed back."""
    rows, last = pair.rows, pair[1]
    row = pair.rows[1]
    kept = last
    for i in range(n):
        last = np.full(2, float(i))
        pair.rows[0, i] += pair.factor + last[1]
        row[i] -= pair[0][0, 0]
    again = pair
    return rows, kept, last, again.rows[0], row


def made_here(n):
    """Arrays of tuples that are gone when they are used."""
    pair = Pair(np.ones((n, 3)), np.full(3, 2.0), 3.0)
    row, last = pair.rows[1], pair.last
    pair = Pair(np.full((n, 3), 5.0), np.full(3, 7.0), 3.0)
    for i in range(3):
        row[i] += i + pair.rows[0, 0]
    return row, last


def new_arrays(n, k):
    """New arrays of all types of numbers, dimensions and ways to say them."""
    a, b, c = np.zeros(n), np.zeros((n, 3), dtype=np.int64), np.zeros((2, n, k), np.float64)
    d, e, f = np.empty((n, k), dtype=float), np.empty(n, np.bool_), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        e[i] = i % 2 == 0
        for j in range(k):
            d[i, j] = 10 * i + j
    c[1, -1, -1] = a.size + b.size + c.size + d.size + e.size
    return (
        a,
        b,
        c,
        d,
        e,
        f,
        d.sum(),
        c[1].strides,
        b.itemsize + e.itemsize,
        d.T.copy(),
        np.zeros((0, n)).shape,
    )


def extremes(x, y, i, j):
    """Largest and smallest of numbers, the first of which stays where none is larger."""
    return (
        max(x, y),
        max(y, x),
        min(x, y, 2.0),
        min(2.0, y, x),
        max(i, j, 1),
        min(i, j),
        max(i, 2.5),
        min(x, j),
        max((x, y)),
        int(x > 1.0),
        int(j),
        int(2.0 * y) if y == y else 0,
    )


def reshaped(a, n):
    """Views in other shapes: of arguments, of what is made here, and of both in turn."""
    rows = a.reshape((n, 3))
    rows[-1, 1] = 7.0
    cube = np.arange(4.0 * n).reshape(2, n, 2)
    return (
        rows.T[1, 0],
        rows[1:].reshape((3, n - 1))[1, -1],
        cube[1, 0, 1],
        cube.reshape(-1)[3],
        a[-2],
        rows.shape[1],
    )


def half(pair):
    """Take arrays that are lent."""
    return 0.5 * pair.rows[1, -1] + pair.last[-1] + pair.factor + len(pair.rows) * pair.last.size


def sums(a, b, flags, numbers):
    """Take arrays of several orders, dimensions and types."""
    for k in range(len(numbers)):
        numbers[k] += 1 if flags[k] else 0
    return a[1, 0] + 10 * a[0, -1] + b[1, 0, -1] + a.shape[1] + b[-1].size + numbers.sum()


def lent(a, b, flags, numbers, n):
    """Arrays lent to other kernels: arguments, rows and new ones."""
    pair = Pair(np.full((n, 3), 2.0), b[0, 1], 1.0)
    for i in range(n):
        pair = Pair(pair.rows, np.full(n, half(pair)), 0.5 * i)
    return half(pair), sums(a, b, flags, numbers), sums(a[:, 1:], b, flags[::2], numbers), half(pair)


half, sums = compiled(half), compiled(sums)

CASES = [
    (new_arrays, lambda: (3, 2)),
    (extremes, lambda: (1.5, math.nan, 2, 7)),
    (extremes, lambda: (-0.0, 0.0, -2, -2)),
    (extremes, lambda: (math.inf, -3.7, 0, 1)),
    (
        lent,
        lambda: (
            np.arange(12.0).reshape(4, 3).T,
            np.arange(12.0).reshape(2, 3, 2),
            np.array([True, False, True, True]),
            np.arange(2),
            4,
        ),
    ),
    (items, lambda: (np.arange(12.0).reshape(3, 4), np.ones((3, 4)), 1)),
    (items, lambda: (np.arange(12.0).reshape(4, 3).T, np.ones((4, 3)).T, 2)),
    (items, lambda: (np.arange(24.0).reshape(3, 8)[:, ::2], np.ones((4, 4))[:, 1:], 1)),
    (cube, lambda: (np.arange(24.0).reshape(2, 4, 3), 1)),
    (cube, lambda: (np.arange(24.0).reshape(2, 4, 3), -2)),
    (integers, lambda: (4,)),
    (loops, lambda: (5, -2)),
    (loops, lambda: (0, 1)),
    (loops, lambda: (-3, 2)),
    (numbers, lambda: (1.5, 0.0, 2, 7)),
    (numbers, lambda: (math.nan, -2.0, 2, 2)),
    (numbers, lambda: (1.0, math.inf, -1, 7)),
    (taken, lambda: (np.array([1.0, 2.0]), 3)),
    (taken, lambda: (np.array([1.0, 2.0]), 0)),
    (of_tuple, lambda: (Pair(np.arange(6.0).reshape(2, 3), np.ones(2), 0.5), 3)),
    (of_tuple, lambda: (Pair(np.arange(6.0).reshape(2, 3), np.ones(2), 0.5), 0)),
    (made_here, lambda: (4,)),
    (early, lambda: (np.array([2.5, 2.0]),)),
    (early, lambda: (np.array([0.1, 2.0]),)),
    (reshaped, lambda: (np.arange(12.0), 4)),
    (reshaped, lambda: (np.arange(20.0)[5:], 5)),
]


def parts(arguments):
    """Arguments, with what is in their tuples."""
    return [part for one in arguments for part in (one if isinstance(one, tuple) else (one,))]


@pytest.mark.parametrize(("function", "arguments"), CASES)
def test_a_kernel_does_what_python_does(function, arguments):
    ours, theirs = arguments(), arguments()
    with np.errstate(all="ignore"):
        theirs = [np.float64(one) if isinstance(one, float) else one for one in theirs]  # 1/0 is no error
        expected = function(*theirs)
    found = compiled(function)(*ours)
    if not isinstance(expected, tuple):
        found, expected = (found,), (expected,)
    for one, other in zip(found, expected, strict=True):
        assert np.array_equal(one, other, equal_nan=True)
        assert np.array_equal(np.signbit(one), np.signbit(other))
    for one, other in zip(parts(ours), parts(theirs), strict=True):  # what was written into arguments
        assert np.array_equal(one, other, equal_nan=True)


@pytest.mark.parametrize("shape", [(2, 3), (0, 5), (-2, -2), (4, 0)])
def test_a_shape_of_another_size_is_an_error(shape):
    kernel = compiled(lambda a, m, n: a.reshape((m, n))[0, 0])
    assert kernel(np.ones(4), 2, 2) == 1.0
    with pytest.raises(ValueError, match="total size"):
        kernel(np.ones(4), *shape)


def test_what_a_kernel_returns_outlives_it():
    kernel = compiled(owned)
    rows = [kernel(n) for n in range(2, 50)]
    gc.collect()
    rubbish = [np.full((n, 3), -1.0) for n in range(2, 50)]
    assert all(np.array_equal(row, [1.0, 2.0, 3.0]) for row in rows)
    assert len(rubbish) == len(rows)


@compiled
def first_row(rows):
    """Hand back a part of an argument."""
    return rows[0]


@compiled
def handed_on(n):
    """A row of an array that nobody but a callee has handed back."""
    return first_row(np.full((n, 3), 4.0))


def test_what_a_callee_hands_back_of_its_arguments_outlives_it():
    rows = [handed_on(n) for n in range(2, 50)]
    gc.collect()
    rubbish = [np.full((n, 3), -1.0) for n in range(2, 50)]
    assert all(np.array_equal(row, [4.0, 4.0, 4.0]) for row in rows)
    assert len(rubbish) == len(rows)


def test_references_to_arguments_are_left_as_they_were():
    a, pair = np.ones(2), Pair(np.ones((2, 3)), np.ones(2), 1.0)
    kernels = compiled(taken), compiled(of_tuple)

    def call():
        kernels[0](a, 2)
        kernels[1](pair, 2)

    call()
    before = [sys.getrefcount(one) for one in (a, pair.rows, pair.last)]
    for _ in range(10):
        call()
    assert [sys.getrefcount(one) for one in (a, pair.rows, pair.last)] == before


def test_what_comes_out_of_a_tuple_outlives_it():
    kernel = compiled(made_here)
    found = [kernel(n) for n in range(2, 50)]
    gc.collect()
    rubbish = [np.full((n, 3), -1.0) for n in range(2, 50)]
    assert all(np.array_equal(row, [6.0, 7.0, 8.0]) for row, _ in found)
    assert all(np.array_equal(last, [2.0, 2.0, 2.0]) for _, last in found)
    assert len(rubbish) == len(found)


def ways(a, n, which):
    """Arrays made before, within and after branches and loops, and what is left of each."""
    if n > 8:
        return a[2]
    first = np.full(3, 1.0)
    kept, row = first, a[1]
    pair = Pair(np.full((2, 3), 2.0), first, 0.5)
    if which < 0:
        return first
    for i in range(n):
        inside = np.full(3, float(i))
        row = pair.rows[i % 2]
        row[0] += inside[1]
        kept = inside
    after = np.full(3, pair.rows[1, 0])
    again = pair.rows[0]
    while after[0] > 6.0:
        after[0] -= first[0]
        if which > 1:
            return pair.last
    return (kept, again, after)[which] if which < 2 else row


@pytest.mark.parametrize(("n", "which"), [(4, -1), (4, 0), (0, 0), (4, 1), (8, 2), (9, 2), (1, 2)])
def test_an_array_lives_as_long_as_anything_looks_at_it(n, which):
    a = np.ones((3, 3))
    kernel, before = compiled(ways), sys.getrefcount(a)
    rows = [kernel(a, n, which) for _ in range(50)]
    gc.collect()
    rubbish = [np.full(3, -1.0) for _ in range(500)]
    expected = ways(a, n, which)
    assert all(np.array_equal(row, expected) for row in rows)
    assert len(rubbish) == 500
    del rows, expected
    assert sys.getrefcount(a) == before


def kept_until_the_end(n):
    """Arrays and tuples that are there from start to end, and nothing else."""
    a, b = np.full(n, 1.0), np.full((n, 3), 2.0)
    pair = Pair(b, a, 1.0)
    total = 0.0
    for i in range(n):
        row = pair.rows[i]
        total += row[1] + pair.last[i]
    return total


def test_all_memory_is_given_back():
    kernel = compiled(kept_until_the_end)
    made = compiled(ways)
    a = np.ones((3, 3))
    kernel(3), made(a, 3, 2)
    gc.collect()
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()
    for n in range(20):
        kernel(n)
        for which in (-1, 0, 1, 2):
            made(a, n, which)
    after = rtsys.get_allocation_stats()
    _nrt_python.memsys_disable_stats()
    assert after.alloc - before.alloc == after.free - before.free
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free > 0
