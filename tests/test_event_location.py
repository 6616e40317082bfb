"""Location of events in a step, against the roots of polynomials that its dense output represents."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from pinimpact import Scene
from pinimpact.scene._kernels.events import friction_reversal, joint_limit
from pinimpact.scene.dynamics import SceneDynamics

from .scene_models import slider

START, H = 0.3, 0.07


@numba.njit
def first_limit(work, end):
    """Call the kernel that locates the first event at a joint limit."""
    return joint_limit.first(work, end)


@numba.njit
def first_reversal(work, end):
    return friction_reversal.first(work, end)


def basis():
    """Return the basis polynomials of the dense output: θ, θ(1 − θ), θ²(1 − θ), …"""
    found, factor = [], Polynomial([0.0, 1.0])
    for k in range(7):
        found.append(factor)
        factor = factor * (Polynomial([1.0, -1.0]) if k % 2 == 0 else Polynomial([0.0, 1.0]))
    return found


MATRIX = np.array([np.pad(one.coef[1:], (0, 7 - len(one.coef[1:]))) for one in basis()]).T


def coefficients(increment):
    """Return the coefficients of a polynomial without a constant term in this basis."""
    return np.linalg.solve(MATRIX, np.pad(increment.coef[1:], (0, 8 - len(increment.coef))))


@pytest.fixture(scope="module")
def dynamics():
    model = slider()
    lower = np.full(3, -np.inf)
    lower[2] = 0.0
    model.lowerPositionLimit = lower
    model.friction = np.array([0.0, 0.0, 1.0])
    scene = Scene(model)
    return SceneDynamics(scene, model, [], [], scene.layout().limits)


def take_step(work, height):
    """Set the dense output to a step in which the third joint follows a polynomial of θ = (t − START)/H."""
    speed = height.deriv() / H
    work.step_start, work.step_length = START, H
    for end, q, v in ((0.0, work.q0, work.v0), (1.0, work.q1, work.v1)):
        q[:], v[:] = 0.0, 0.0
        q[2], v[2] = height(end), speed(end)
    work.dense_coefficients[:] = 0.0
    work.dense_coefficients[:, 2] = coefficients(height - height(0.0))
    work.dense_coefficients[:, 5] = coefficients(speed - speed(0.0))
    theta = np.linspace(0, 1, 401)
    rate, acceleration = speed(theta), (speed.deriv() / H)(theta)
    work.rate_bounds[:] = 0.0
    work.rate_bounds[:, 2] = [
        np.abs(one).max() for one in (rate, acceleration, rate - rate[0], acceleration - acceleration[0])
    ]
    work.gap_floor = 1e-12


def first_root(polynomial, to=1.0):
    """Return the first root in (0, to], or None."""
    roots = polynomial.roots()
    real = [one.real for one in roots if abs(one.imag) < 1e-12 and 0.0 < one.real <= to]
    return min(real, default=None)


numbers = st.integers(-1000, 1000).map(lambda k: 1e-3 * k)


@given(
    start=st.floats(0.01, 1.0),
    slopes=st.lists(numbers, min_size=2, max_size=7),
    cut=st.floats(0.2, 1.0),
)
def test_a_gap_closes_at_the_first_root_however_short_the_dip(dynamics, start, slopes, cut):
    work = dynamics.work
    height = Polynomial([start, *slopes])
    take_step(work, height)
    lowest = min(height(np.linspace(0, cut, 20_001)))
    time, which = first_limit(work, START + cut * H)
    if abs(lowest) < 1e-7:  # it touches, or nearly so
        return
    if lowest > 0.0:
        assert time == math.inf
        return
    root = first_root(height, cut)
    assert root is not None
    assert which == 0
    slope = abs(height.deriv()(root))
    assert time == pytest.approx(START + root * H, abs=H * (1e-9 / max(slope, 1e-4) + 1e-14))
    assert time <= START + cut * H


def test_penetration_for_a_thousandth_of_the_step_is_found(dynamics):
    """The gap (θ − 0.6)² − 2.5·10⁻⁷ is negative for 10⁻³ of the step, far from sample points."""
    work = dynamics.work
    take_step(work, Polynomial([0.36 - 2.5e-7, -1.2, 1.0]))
    time, _ = first_limit(work, START + H)
    assert time == pytest.approx(START + (0.6 - 5e-4) * H, abs=1e-10)
    take_step(work, Polynomial([0.36 + 1e-10, -1.2, 1.0]))  # positive everywhere
    assert first_limit(work, START + H)[0] == math.inf


@given(
    start=st.floats(0.01, 1.0),
    slopes=st.lists(numbers, min_size=1, max_size=5),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_a_reversal_is_where_the_velocity_vanishes(dynamics, start, slopes, sign):
    """The first one in the step, also where the velocity has its old sign again at the end; to rounding."""
    work = dynamics.work
    speed = sign * Polynomial([start, *slopes])
    take_step(work, speed.integ() * H)
    work.sliding_friction[:] = [0.0, 0.0, sign]
    time, which = first_reversal(work, START + H)
    lowest = (sign * speed)(np.linspace(0.0, 1.0, 100_001)).min()
    if lowest > 1e-9:
        assert time == math.inf
        return
    if lowest > -1e-6:  # a reversal as deep as the tolerance may be none
        return
    assert which == 2
    assert START < time <= START + H
    left, right = speed((time - START) / H - 1e-9), speed((time - START) / H + 1e-9)
    assert left * right <= 0.0 or abs(left) < 1e-12
