"""Interrupts and other signals during long kernels."""

from __future__ import annotations

import os
import signal
import subprocess
import time

import numba
import numpy as np
import pytest

from pinimpact._compile.threads import MAX_ROWS, in_threads
from pinimpact.contact_space._kernels.plastic import impulses_together
from pinimpact.contact_space._kernels.propagation import propagate
from pinimpact.contact_space._kernels.propagation_steps import step_through

pytestmark = pytest.mark.skipif(
    os.name != "posix" or numba.config.DISABLE_JIT, reason="signals of POSIX, and compiled kernels"
)

FEW = 6
"""Number of contacts for which kernels are fast."""


def corners(n):
    """Return J of a box that lands on n corners, and the velocities of these."""
    places = np.random.default_rng(n).uniform(-1.0, 1.0, (n, 2))
    rows = np.zeros((n, 3, 6))
    for row, (x, y) in zip(rows, places, strict=True):
        row[:, :3] = np.eye(3)
        row[:, 3:] = [[0, -0.5, -y], [0.5, 0, x], [y, -x, 0]]
    rows = rows.reshape(3 * n, 6)
    return rows, rows @ [0.5, 0.1, -1.0, 0, 0, 0]


def together(n):
    rows, v = corners(n)
    impulse = np.empty(3 * n)
    impulses_together(rows @ rows.T, v, np.full(n, 0.5), np.zeros(n), np.ones(n), impulse)
    return impulse


def events(n):
    rows, v = corners(n)
    w, mu = rows @ rows.T, np.full(n, 0.5)
    after, impulse, works, counts = np.empty(3 * n), np.empty(3 * n), np.empty((n, 3)), np.zeros(5, np.int64)
    nothing = np.empty((0, 5)), np.empty((0, 6 * n + 1))
    propagate(w, v, mu, mu, np.ones(n), 1.0, 1e-16, 10_000, after, impulse, works, counts, *nothing)
    return impulse


def steps(n):
    rows, v = corners(n)
    mu, stiffness = np.full(n, 0.5), 1.0 / (rows[2::3] ** 2).sum(axis=1)
    impulse, works, path = np.empty(3 * n), np.empty((n, 3)), np.empty((0, 3 * n + 1))
    step_through(rows, v, mu, mu, stiffness, 1.0, 1e-13, 10**6, impulse, works, path)
    return impulse


def send(name, after):
    """Start a process that sends a signal to this one after a time [s]."""
    return subprocess.Popen(["/bin/sh", "-c", f"sleep {after}; kill -{name} {os.getpid()}"])


def wait_for(kernel, many, sender, finished):
    """Call a kernel, note that it has finished, and wait for the signal, which must not meet another test."""
    kernel(many)
    finished.append(True)
    sender.wait()
    time.sleep(1.0)


@pytest.mark.parametrize(("kernel", "many"), [(together, 700), (events, 250), (steps, 800)])
def test_interrupt_ends_long_kernel(kernel, many):
    """With `many` contacts a kernel takes seconds."""
    before, finished = kernel(FEW), []  # compiled
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # background processes may ignore it
    sender, begun = send("INT", 0.5), time.perf_counter()
    try:
        with pytest.raises(KeyboardInterrupt):
            wait_for(kernel, many, sender, finished)
        assert not finished
        assert time.perf_counter() - begun < 2.0
    finally:
        sender.wait()
        signal.signal(signal.SIGINT, handler)
    np.testing.assert_array_equal(kernel(FEW), before)


def test_handled_signals_do_not_affect_kernels():
    before, seen = together(60), []
    handler = signal.signal(signal.SIGUSR1, lambda *_: seen.append(True))
    try:
        sender = send("USR1", 0.1)
        while not seen:
            np.testing.assert_array_equal(together(60), before)
        sender.wait()
    finally:
        signal.signal(signal.SIGUSR1, handler)


@pytest.mark.parametrize("threads", [1, 3])
def test_batches_are_divided_into_short_parts(threads):
    lengths = in_threads(lambda rows: rows.stop - rows.start, 10 * MAX_ROWS, threads)
    assert sum(lengths) == 10 * MAX_ROWS
    assert max(lengths) <= MAX_ROWS
