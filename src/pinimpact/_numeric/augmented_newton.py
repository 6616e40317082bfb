"""An iteration of the method of augmented Lagrangians, by Newton's method in the velocities. (theory.md, 16)

The method (P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92, 1991)
computes from impulses f the next ones, f⁺, by

    f⁺ = P(f − u/r),   u = u_free + J w,   M w = Jᵀ f⁺.                                                 (16.3)

r > 0 is a compliance for each contact or row. For a contact whose normal impulse has the bounds l, mostly 0,
and m, mostly ∞,

    P(z) = (Π_ρ(z_t), p),   p = min(max(z_n, l), m),   ρ = μ p,                                         (16.4)

where Π_ρ is the projection onto the disc of radius ρ, or −ρσ for a contact that slides in the direction σ.
For a held contact P(z) = z; for a scalar row P is the projection onto its bounds.
Newton's method with a line search solves (16.3) for w in a few steps. Its matrix has the size of w, with
zeros for bodies that are not in contact. The iteration is in `augmented_lagrangian`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .._compile.declared import Flags, FloatRows, Floats, IntegerRows, Integers
from .._compile.interrupts import answer_signals
from .._compile.jit import always_inlined, external, inlined
from .loops import filled, flags
from .products import add, dot
from .profile import apply_within, eliminate_profile, substitute_profile
from .tolerances import TINY

STEPS = 40
"""Largest number of steps of Newton's method per iteration, and of steps of a line search."""

REUSED = 0.5
"""Factor by which a step with factors of a previous iteration is to reduce the residual."""

RESOLVED = 1e3
"""Residual of Newton's method, relative to the wanted one, at which it may end if it falls no further."""

SLOPE = 0.1
"""Slope at the end of a line search relative to that at its start."""


class Law(NamedTuple):
    """Coulomb's law and bounds for nc contacts and ns scalar rows."""

    friction: Floats  # (nc,) coefficients of friction
    slip: FloatRows  # (nc, 2) slip velocities of sliding contacts; zero for contacts that can stick
    least: Floats  # (nc,) least normal impulses, at least zero
    most: Floats  # (nc,) largest normal impulses, which may be infinite
    held: Flags  # (nc,) contacts whose impulses have no bounds
    lower: Floats  # (ns,) lower bounds of scalar impulses
    upper: Floats  # (ns,) upper bounds of scalar impulses


@inlined
def coulomb_law(friction, slip, held, lower, upper):
    """Return the `Law` of contacts whose normal impulses are at least zero; arguments as there."""
    nc = len(friction)
    return Law(friction, slip, np.zeros(nc), filled(np.empty(nc), math.inf), held, lower, upper)


@inlined
def law_of_steps(friction, lower, upper):
    """Return the `Law` of contacts that can stick and open; arguments as there."""
    nc = len(friction)
    return coulomb_law(friction, np.zeros((nc, 2)), flags(nc, False), lower, upper)


class VelocityProblem(NamedTuple):
    """A contact problem of nc contacts, three rows (t₁, t₂, n) each, and ns scalar rows, in m velocities."""

    mass: FloatRows  # (m, m) M
    inverse: FloatRows  # (m, m) its inverse
    start: Integers  # (m,) first column of each row of both that may be nonzero
    values: FloatRows  # (n, …) nonzero entries of each row of J; same columns for the rows of a contact
    columns: IntegerRows  # (n, …) their columns, in ascending order
    counts: Integers  # (n,) their numbers
    free: Floats  # (n,) u_free, velocities without impulses
    law: Law
    compliance: Floats  # (nc,) compliances of contacts relative to those of scalar rows


class Iterate(NamedTuple):
    """An iterate of Newton's method."""

    w: Floats  # (m,) change of the velocities
    u: Floats  # (n,) u_free + J w
    f: Floats  # (n,) f⁺ of (16.3)
    momentum: Floats  # (m,) M w
    residual: Floats  # (m,) M w − Jᵀ f⁺
    scale: Floats  # (m,) 1/√M_aa, which makes momenta comparable


@inlined
def rates(values, columns, counts, w, out):
    """Fill out (n,) with J w."""
    for a in range(len(out)):
        total = 0.0
        for k in range(counts[a]):
            total += values[a, k] * w[columns[a, k]]
        out[a] = total


@inlined
def add_transposed(values, columns, counts, x, out):
    """Add Jᵀ x to out (m,)."""
    for a in range(len(x)):
        for k in range(counts[a]):
            out[columns[a, k]] += values[a, k] * x[a]


@inlined
def length(x, y):
    """Return √(x² + y²), faster than `math.hypot`."""
    return math.sqrt(x * x + y * y)


@external
def impulses(law, u, before, r, out):
    """Fill out (n,) with f⁺ = P(f − u/r) of (16.3), f = `before` (n,)."""
    mu, slip, least, most, held, lower, upper = law
    nc = len(mu)
    for a in range(len(u)):
        out[a] = before[a] - u[a] / r[a]
    for i in range(nc):
        j = 3 * i
        if held[i]:
            continue
        out[j + 2] = min(max(out[j + 2], least[i]), most[i])
        radius, speed = mu[i] * out[j + 2], length(slip[i, 0], slip[i, 1])
        if speed > 0.0:
            out[j], out[j + 1] = -radius * slip[i, 0] / speed, -radius * slip[i, 1] / speed
            continue
        size = length(out[j], out[j + 1])
        if size > radius:
            out[j] *= radius / size
            out[j + 1] *= radius / size
    for i in range(len(lower)):
        out[3 * nc + i] = min(max(out[3 * nc + i], lower[i]), upper[i])


@always_inlined
def fill_derivative(law, i, z1, z2, z3, coupled, d):
    """Fill d (3, 3) with ∂P/∂z of contact i at z = (z1, z2, z3); return True instead if it is zero. (16.4)

    ∂ρ/∂z_n is left out unless `coupled`.
    """
    mu, least = law.friction[i], law.least[i]
    free = least < z3 < law.most[i] or law.held[i]
    radius = mu * min(max(z3, least), law.most[i])
    if not free and radius == 0.0:
        return True
    for a in range(3):
        for b in range(3):
            d[a, b] = 0.0
    d[2, 2], speed = 1.0 if free else 0.0, length(law.slip[i, 0], law.slip[i, 1])
    if speed > 0.0 and not law.held[i]:
        if coupled and free:
            d[0, 2], d[1, 2] = -mu * law.slip[i, 0] / speed, -mu * law.slip[i, 1] / speed
        return False
    size = length(z1, z2)
    if size <= radius or law.held[i]:  # sticks
        d[0, 0] = d[1, 1] = 1.0
        return False
    s1, s2 = z1 / size, z2 / size
    part = radius / size
    d[0, 0], d[1, 1] = part * s2 * s2, part * s1 * s1
    d[0, 1] = d[1, 0] = -part * s1 * s2
    if coupled and free:
        d[0, 2], d[1, 2] = mu * s1, mu * s2
    return False


@external
def fill_system(problem, profile, r, u, before, coupled, d, system):
    """Fill system (m, m) with the matrix of Newton's method, M + (1/r) Jᵀ ∂P J.

    Args:
        problem: The `VelocityProblem`.
        profile: First and last columns (m,) of each row, see `find_profile`.
        r: (n,) compliances.
        u: (n,) velocities.
        before: (n,) f.
        coupled: Whether ∂ρ/∂z_n is included; without it the matrix is symmetric and positive definite.
        d: (3, 3) scratch.
        system: (m, m) is overwritten.
    """
    mass, _, start, values, columns, counts, _, law, _ = problem
    first, last = profile
    m, nc, lower, upper = len(mass), len(law.friction), law.lower, law.upper
    for a in range(m):
        for b in range(first[a], last[a] + 1):
            system[a, b] = 0.0
    for a in range(m):
        for b in range(start[a], a + 1):
            system[a, b] = system[b, a] = mass[a, b]
    for i in range(nc):
        j = 3 * i
        z1, z2, z3 = before[j] - u[j] / r[j], before[j + 1] - u[j + 1] / r[j], before[j + 2] - u[j + 2] / r[j]
        if fill_derivative(law, i, z1, z2, z3, coupled, d):
            continue
        for k in range(counts[j]):
            j0, j1, j2 = values[j, k] / r[j], values[j + 1, k] / r[j], values[j + 2, k] / r[j]
            t0 = j0 * d[0, 0] + j1 * d[1, 0]
            t1 = j0 * d[0, 1] + j1 * d[1, 1]
            t2 = j0 * d[0, 2] + j1 * d[1, 2] + j2 * d[2, 2]
            row = system[columns[j, k]]
            for o in range(counts[j]):
                row[columns[j, o]] += t0 * values[j, o] + t1 * values[j + 1, o] + t2 * values[j + 2, o]
    for i in range(len(lower)):
        j = 3 * nc + i
        if lower[i] < before[j] - u[j] / r[j] < upper[i]:
            for k in range(counts[j]):
                for o in range(counts[j]):
                    system[columns[j, k], columns[j, o]] += values[j, k] * values[j, o] / r[j]


@external
def evaluate(problem, r, before, now):
    """Fill u, f⁺, M w and the residual of an `Iterate` from its w; return the relative norm of the residual.

    Momenta are scaled by 1/√M_aa. Other arguments are those of `fill_system`.
    """
    mass, _, start, values, columns, counts, free, law, _ = problem
    w, u, f, momentum, out, scale = now
    largest = square = 0.0
    rates(values, columns, counts, w, u)
    add(u, 1.0, free)
    impulses(law, u, before, r, f)
    apply_within(mass, start, w, momentum)
    for a in range(len(out)):
        out[a] = momentum[a]
        largest = max(largest, scale[a] * abs(out[a]))
    for a in range(len(f)):
        if f[a] != 0.0:
            for k in range(counts[a]):
                part = values[a, k] * f[a]
                out[columns[a, k]] -= part
                largest = max(largest, scale[columns[a, k]] * abs(part))
    for a in range(len(out)):
        square += (scale[a] * out[a]) ** 2
    return math.sqrt(square) / max(largest, TINY)


@external
def length_of_step(problem, r, before, now, du, slope, curvature):
    """Return the length t ≤ 1 of a step d at which the residual is orthogonal to d; 0 if d does not descend.

    Without ∂ρ/∂z_n this is the minimum of a convex function along d. `now` is the `Iterate` at t = 0, whose f
    is overwritten; du (n,) is J d, slope dᵀM w, curvature dᵀM d; other arguments as in `fill_system`.
    """
    law, u, f = problem.law, now.u, now.f
    trial = np.empty(len(u))
    start = slope - dot(du, f)
    if not start < 0.0:
        return 0.0
    low, high, at_low, at_high, share, side = 0.0, 1.0, start, 0.0, 1.0, 0
    for k in range(STEPS):
        for a in range(len(u)):
            trial[a] = u[a] + share * du[a]
        impulses(law, trial, before, r, f)
        here = slope + share * curvature - dot(du, f)
        if abs(here) <= SLOPE * abs(start) or (k == 0 and here <= 0.0):
            break
        # Illinois method: halve the value at the end that is kept
        if here > 0.0:
            high, at_high, at_low = share, here, (0.5 * at_low if side > 0 else at_low)
            side = 1
        else:
            low, at_low, at_high = share, here, (0.5 * at_high if side < 0 else at_high)
            side = -1
        share = low - (high - low) * at_low / (at_high - at_low)
    return share


@external
def find_profile(problem, first, last):
    """Fill the first and the last nonzero columns (m,) of each row of the factors of M + JᵀJ."""
    start, columns, counts = problem.start, problem.columns, problem.counts
    m = len(start)
    for a in range(m):
        last[a] = a
    for a in range(m):
        last[start[a]] = max(last[start[a]], a)
    for a in range(len(counts)):
        if counts[a] > 0:
            last[columns[a, 0]] = max(last[columns[a, 0]], columns[a, counts[a] - 1])
    k = 0
    for a in range(m):
        if a > 0:
            last[a] = max(last[a], last[a - 1])
        while last[k] < a:
            k += 1
        first[a] = k


@inlined
def solve_compliances(problem, profile, r, before, least, now, system, factored):
    """Solve (16.3) for w of the `Iterate` now, given f, by Newton's method.

    It stops at a relative norm `least` of the residual, which is small so that results are differentiable.
    If system (m, m) is `factored`, it contains the factors of a previous iteration, which are used as long as
    each step halves the residual: the active set is mostly the same. Return whether it contains factors at
    the end. Other arguments as in `fill_system`.
    """
    w, momentum, residual = now.w, now.momentum, now.residual
    m, previous_error, reuse = len(w), math.inf, factored
    d, md, du, slopes = np.empty(m), np.empty(m), np.empty(len(r)), np.empty((3, 3))
    for step in range(STEPS + 1):
        answer_signals()
        error = evaluate(problem, r, before, now)
        stalled = error > REUSED * previous_error
        if step == STEPS or error <= least or (stalled and not reuse and error < RESOLVED * least):
            break
        reuse = reuse and not stalled
        previous_error, share = error, 0.0
        for attempt in range(2):  # the second matrix is definite, so its step descends
            for a in range(m):
                d[a] = -residual[a]
            if reuse:
                substitute_profile(system, profile[1], d)
                share = 1.0
                break
            fill_system(problem, profile, r, now.u, before, attempt == 0, slopes, system)
            factored = eliminate_profile(system, profile[1], d)
            if not factored:
                continue
            rates(problem.values, problem.columns, problem.counts, d, du)
            apply_within(problem.mass, problem.start, d, md)
            share = length_of_step(problem, r, before, now, du, dot(d, momentum), dot(d, md))
            if share > 0.0:
                break
        add(w, share, d)
    return factored, error <= RESOLVED * least


@external
def continue_to(problem, profile, r, part, now, system):
    """Replace the solution of (16.3) from f = 0 by that for compliances `part` r with the same ∂P. (11.15)

    r (n,) is overwritten, and w of the `Iterate`. system (m, m) is overwritten with the factors of the matrix
    of Newton's method; return whether it has them. Other arguments as in `fill_system`.
    """
    law, u, w = problem.law, now.u, now.w
    nc, none, change, d = len(law.friction), np.zeros(len(r)), np.zeros(len(r)), np.empty((3, 3))
    step, growth = np.zeros(len(w)), 1.0 - 1.0 / part
    for a in range(len(r)):
        r[a] *= part
        u[a] *= part  # u/r, and ∂P with it, stay as they are
    for i in range(nc):
        j = 3 * i
        z1, z2, z3 = -u[j] / r[j], -u[j + 1] / r[j + 1], -u[j + 2] / r[j + 2]
        if not fill_derivative(law, i, z1, z2, z3, True, d):
            for a in range(3):
                change[j + a] = -growth * (d[a, 0] * z1 + d[a, 1] * z2 + d[a, 2] * z3)
    for i in range(len(law.lower)):
        j = 3 * nc + i
        if law.lower[i] < -u[j] / r[j] < law.upper[i]:
            change[j] = growth * u[j] / r[j]
    add_transposed(problem.values, problem.columns, problem.counts, change, step)
    fill_system(problem, profile, r, u, none, True, d, system)
    factored = eliminate_profile(system, profile[1], step)
    if factored:
        add(w, 1.0, step)
    return factored
