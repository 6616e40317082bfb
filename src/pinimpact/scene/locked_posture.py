"""Postures in which friction locks a contact that the motion carries on. (theory.md, 13)"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

Array = NDArray[np.float64]

SINGULAR = 1e-13
"""Part of the largest eigenvalue of W below which the robot does not move the contact at all."""

CARRIED = 1e-6
"""Part of the contact's acceleration that it has at least in the direction in which nothing moves it."""

REAL = 1e-6
"""Imaginary part of a root that is taken as zero, and by how much its equation may be missed."""


def locked_direction(
    delassus: Array, acceleration: Array, friction: float, alone: bool = True
) -> Array | None:
    """Return the direction in which a contact at rest is locked though it accelerates; None if it is not.

    With u the null vector of W no force changes uᵀa = uᵀa⁰ < 0, so the contact cannot stick. It does not open
    where a⁰₃ < 0, and slides only along a direction for which Coulomb's law has a force N ≥ 0: with
    x = a_b/k, a = (−k, kx, 0) in axes along and across u_t, these are roots of a quartic. What touches
    beside it does not move it along u either, but may let it slide: that is then for the caller to know.

    Args:
        delassus: (3, 3) W of the contact.
        acceleration: (3,) a⁰, without contact forces, of a contact at rest.
        friction: Coefficient of friction.
        alone: Whether it is the only closed contact, and no joint can rest by dry friction.

    Returns:
        (3,) u in contact axes, u₃ > 0; None wherever a force may exist.
    """
    u, still = _held_direction(delassus, acceleration, friction)
    if u is None or not still:
        return None
    tangent = math.hypot(u[0], u[1])
    if not alone or tangent <= CARRIED:
        return u
    slides = _may_slide(delassus, acceleration, friction, u[:2] / tangent, -float(u @ acceleration) / tangent)
    return None if slides else u


def full_reach(
    q: Array,
    friction: float,
    error: float,
    seen: Callable[[Array], tuple[Array, Array, Array, Array, Array]],
    moved: Callable[[Array, float], Array],
) -> Array | None:
    """Return the configuration in which nothing moves a contact along u, if it counts as there. (13.8)

    What has been taken for rest has uᵀv = 0 only there, or when it has been stopped along u. It counts as
    there if the stop is more than an error, and takes more than the motion does until it gets there.

    Args:
        q: (nq,) configuration.
        friction: Coefficient of friction.
        error: The largest change of a velocity that is an error.
        seen: Gives of a configuration W (3, 3), M⁻¹Jᵀ (nv, 3), v and a⁰ (3,) of the contact, and v̇ (nv,)
            without contact forces.
        moved: Gives the configuration after so much time from another.
    """
    left = math.inf
    while True:
        delassus, response, velocity, acceleration, joints = seen(q)
        u, still = _held_direction(delassus, acceleration, friction)
        if u is None:
            return None
        speed = float(u @ velocity)
        time = -speed / float(u @ acceleration)
        if math.isinf(left) and not still:
            changed = max(error, abs(time) * float(np.abs(joints).max()))
            if not abs(speed) * float(np.abs(response @ u).max()) > changed * float(u @ delassus @ u):
                return None
        elif not 0.0 < abs(speed) < 0.5 * left:  # as near as rounding tells, or never
            return q if still else None
        left = abs(speed)
        q = moved(q, time)


def _held_direction(delassus: Array, acceleration: Array, friction: float) -> tuple[Array | None, bool]:
    """Return the direction u in which a contact moves the least, if friction holds it and a⁰ carries it on.

    Also whether nothing moves it so. Across a planar mechanism nothing moves it, and nothing carries it.
    """
    weights, basis = np.linalg.eigh(delassus)
    along, size = basis.T @ acceleration, float(np.abs(acceleration).max())
    rounding = SINGULAR * weights[2]
    u, least = basis[:, 0], weights[0]
    if weights[0] <= rounding and abs(along[0]) * weights[1] <= size * max(CARRIED * weights[1], rounding):
        u, least = basis[:, :2] @ along[:2], weights[1]  # rounding may have mixed the two
    u = u * math.copysign(1.0, u[2]) / max(float(np.linalg.norm(u)), np.finfo(float).tiny)
    held = math.hypot(u[0], u[1]) < friction * u[2] and acceleration[2] < 0.0 < weights[2]
    carried = float(u @ acceleration) < -CARRIED * size
    return (u if held and carried else None), bool(least <= rounding)


def _may_slide(delassus: Array, acceleration: Array, friction: float, along: Array, k: float) -> bool:
    """Whether a force lets the contact slide off with −k along a tangent, and anything across."""
    axes = np.array([[along[0], along[1], 0.0], [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])
    w = axes @ delassus @ axes.T
    _, across, fall = (axes @ acceleration).tolist()
    # force N (μ/r, −μx/r, 1), r² = 1 + x²; N (w33 r + push) = −fall r, and the row across: even r + odd = 0
    push = Polynomial([friction * w[2, 0], -friction * w[2, 1]])
    turn = Polynomial([friction * w[1, 0], -friction * w[1, 1]])
    left = Polynomial([across, -k])
    even = left * w[2, 2] - fall * w[1, 2]
    odd = left * push - fall * turn
    for root in (even**2 * Polynomial([1.0, 0.0, 1.0]) - odd**2).roots():
        x = float(root.real)
        if abs(root.imag) > REAL * (1.0 + abs(x)):
            continue
        r = math.hypot(1.0, x)
        size = abs(even(x)) * r + abs(odd(x))
        if abs(even(x) * r + odd(x)) <= REAL * size and w[2, 2] * r + push(x) > 0.0:
            return True
    return False
