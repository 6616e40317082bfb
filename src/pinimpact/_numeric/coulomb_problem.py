"""Contact problems with Coulomb's law and bounded scalar rows, and their solver. (theory.md, 11)

    u = u_free + W f,
    contacts:     0 ≤ f_3 − l ⟂ u_3 ≥ 0,  |f_t| ≤ μ f_3,  f_t = −μ f_3 u_t/|u_t| where u_t ≠ 0,
    scalar rows:  lower ≤ f ≤ upper,  u = 0 between them, u ≥ 0 at lower, u ≤ 0 at upper.

Either u are velocities and f impulses, or u accelerations and f forces. The friction of a sliding contact is
opposite to its given direction of slip σ, for any u_t. With De Saxcé's s = μ|u_t| this is a cone
complementarity problem: f in K and u + s n in the dual cone; for sliding contacts K is a half-line and
s = μ σ·u_t.

The alternating direction method of multipliers approaches a solution (J. Carpentier, Q. Le Lidec, L. Montaut,
From compliant to rigid contact simulation, RSS 2024); Newton's method on the active set then converges to
rounding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .._compile.declared import FLAGS, FLOAT_ROWS, FLOATS, INTEGERS, Flags, FloatRows, Floats, declared
from .._compile.interrupts import answer_signals
from .._compile.jit import external, inlined
from .cone_program import cholesky, substitute
from .elimination import largest_of
from .least_norm import least_norm
from .loops import assign, flags, repeated
from .products import apply
from .tolerances import COMPLIANCE, COMPUTED, EXACT, NEAR, ROUNDOFF, SMALL, TINY
from .tolerances import USABLE as USABLE  # re-exported

SYSTEM = (FLOAT_ROWS, FLOATS, FLOAT_ROWS, FLOATS, FLOATS, FLAGS, FLOATS, FLOATS, FLOATS)
"""Types of W, u_free, slip velocities, friction, least normal forces, held, lower, upper bounds, forces."""

ITERATIONS = 2000
"""Largest number of iterations of the method of multipliers."""

PENALTY, FACTOR, IMBALANCE = 1.0, 10.0, 10.0
"""Initial penalty ρ (rows are scaled to a diagonal of one), the factor by which it changes, and the ratio of
the residuals of f = y and of u above which it changes."""

LONG = 500
"""Number of iterations after which Newton's method is tried at any residual, and not only below `NEAR`."""

POLISH = 8
"""Largest number of steps of Newton's method per trial."""

SOFTER = 1e-2, 1e-3, 1e-4, 2.0 * SMALL
"""Successive compliances, relative to the largest diagonal entry of W, where the smallest one does not
converge from the given start: the largest one determines which forces are at their bounds."""

AS_FORCES_SAY = np.int64(-1)
"""State of a contact in `linearize`: open or closed as its force and acceleration imply."""


@inlined
def into_cone(x, b, mu, least, directions, slides):
    """Project the force x[b : b + 3] onto its cone, or half-line if it slides, with x[b + 2] ≥ least."""
    k = b // 3
    if slides:
        s1, s2 = directions[k, 0], directions[k, 1]
        push = max(least, (x[b + 2] - mu * (s1 * x[b] + s2 * x[b + 1])) / (1.0 + mu * mu))
        x[b], x[b + 1], x[b + 2] = -mu * push * s1, -mu * push * s2, push
        return
    length, push = math.hypot(x[b], x[b + 1]), x[b + 2]
    if length > mu * push:  # on the cone's surface, or at its tip
        push = max(0.0, (mu * length + push) / (1.0 + mu * mu))
    push = max(push, least)
    if length > mu * push:
        x[b], x[b + 1] = x[b] * mu * push / length, x[b + 1] * mu * push / length
    x[b + 2] = push


class Scaled(NamedTuple):
    """The problem scaled by `scale`."""

    w: FloatRows  # (3 nc + ns, 3 nc + ns) W
    rates: Floats  # (3 nc + ns,) u_free
    mu: Floats  # (nc,) coefficients of friction
    held: Flags  # (nc,) contacts without bounds
    slides: Flags  # (nc,) contacts that slide
    directions: FloatRows  # (nc, 2) of their slip
    low: Floats  # (nc + ns,) least normal forces and lower bounds
    high: Floats  # (ns,) upper bounds


@inlined
def _scaled(delassus, free, velocity, mu, least, held, lower, upper, d, scale_a, scale_f):
    """Return the `Scaled` problem for the scales of `scale`."""
    nc, ns, size = len(mu), len(lower), len(free)
    w, rates = np.empty((size, size)), np.empty(size)
    for a in range(size):
        rates[a] = scale_a[a] * free[a]
        for b in range(size):
            w[a, b] = d[a] * delassus[a, b] * d[b]
    directions, slides = np.zeros((nc, 2)), flags(nc, False)
    low, high = np.empty(nc + ns), np.empty(ns)
    for i in range(nc):
        low[i] = least[i] / scale_f[3 * i + 2]
        speed = math.hypot(velocity[i, 0], velocity[i, 1])
        slides[i] = speed > 0.0 and mu[i] > 0.0 and not held[i]
        if slides[i]:
            directions[i, 0], directions[i, 1] = velocity[i, 0] / speed, velocity[i, 1] / speed
    for i in range(ns):
        low[nc + i], high[i] = lower[i] / scale_f[3 * nc + i], upper[i] / scale_f[3 * nc + i]
    return Scaled(w, rates, mu, held, slides, directions, low, high)


@inlined
def _fill_factor(w, penalty, factor):
    """Fill the Cholesky factor of W + (ρ + ε) 1 for the penalty ρ."""
    for a in range(len(w)):
        for b in range(a + 1):
            factor[a, b] = w[a, b]
        factor[a, a] += penalty + COMPLIANCE
    cholesky(factor)


@inlined
def _multipliers_step(scaled, penalty, factor, f, y, z, shift):
    """Take a step of the method of multipliers; return the residuals of f = y and of u.

    Forces f, their projections y and multipliers z are (3 nc + ns,), De Saxcé's s, `shift`, is (nc,); all are
    updated. `factor` is that of `_fill_factor`.
    """
    nc, mu, held, directions = len(shift), scaled.mu, scaled.held, scaled.directions
    apart = moved = 0.0
    for a in range(len(f)):
        f[a] = COMPLIANCE * f[a] + z[a] + penalty * y[a] - scaled.rates[a]
    for i in range(nc):
        f[3 * i + 2] -= shift[i]
    substitute(factor, f)
    before = y.copy()
    for a in range(len(f)):
        y[a] = f[a] - z[a] / penalty
    for i in range(nc):
        if not held[i]:
            into_cone(y, 3 * i, mu[i], scaled.low[i], directions, scaled.slides[i])
    for a in range(3 * nc, len(f)):
        y[a] = min(max(y[a], scaled.low[a - 2 * nc]), scaled.high[a - 3 * nc])
    for a in range(len(f)):
        z[a] += penalty * (y[a] - f[a])
        apart, moved = max(apart, abs(f[a] - y[a])), max(moved, penalty * abs(y[a] - before[a]))
    for i in range(nc):
        b, last = 3 * i, shift[i]
        if scaled.slides[i]:
            shift[i] = mu[i] * (directions[i, 0] * z[b] + directions[i, 1] * z[b + 1])
        elif not held[i]:
            shift[i] = mu[i] * math.hypot(z[b], z[b + 1])
        moved = max(moved, abs(shift[i] - last))
    return apart, moved


@declared(*SYSTEM, result=float)
@external
def solve_coulomb(delassus, free, velocity, mu, least, held, lower, upper, x):
    """Solve a contact problem for forces x, starting from the given x, or zero if its residual is smaller.

    Args:
        delassus: (m, m) W for nc contacts (t₁, t₂, n), then ns scalar rows; m = 3 nc + ns.
        free: (m,) u_free.
        velocity: (nc, 2) slip velocities of sliding contacts; zero for contacts that can stick.
        mu: (nc,) coefficients of friction.
        least: (nc,) least normal forces l ≥ 0.
        held: (nc,) contacts whose forces have no bounds.
        lower: (ns,) lower bounds of scalar forces, which may be infinite.
        upper: (ns,) upper bounds.
        x: (m,) initial forces; overwritten with the solution.

    Returns:
        The residual of the law relative to u_free; above `tolerances.USABLE` if no solution was found.
    """
    nc, size = len(mu), len(free)
    system = delassus, free, velocity, mu, least, held, lower, upper
    d, scale_a, scale_f, a_now = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    loads = np.empty(size)  # magnitude of u, also where u_free is zero and only `least` acts
    for a in range(size):
        loads[a] = abs(free[a])
        for i in range(nc):
            loads[a] += abs(delassus[a, 3 * i + 2]) * least[i]
    if scale(delassus, loads, nc, d, scale_a, scale_f) == 0.0:
        for a in range(size):
            x[a] = 0.0
        return 0.0
    scales = a_now, scale_a, scale_f
    scaled = _scaled(*system, d, scale_a, scale_f)
    f, y, z, shift = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(nc)
    if not residual(*system, x, *scales) <= residual(*system, f, *scales):
        assign(x, f)
    for a in range(size):
        y[a] = f[a] = x[a] / scale_f[a]
    factor, penalty, changed, next_try = np.empty((size, size)), PENALTY, True, 0
    trial, best = x.copy(), math.inf
    for iteration in range(ITERATIONS + 1):
        answer_signals()
        if iteration == next_try:
            next_try = min(iteration + max(4, iteration // 4), ITERATIONS)
            for a in range(size):
                trial[a] = y[a] * scale_f[a]
            now, before = residual(*system, trial, *scales), math.inf
            while EXACT < now < 0.5 * before and (before < math.inf or now <= NEAR or iteration >= LONG):
                before = now
                now = newton(*system, trial, *scales)
            if now < best:
                best = now
                assign(x, trial)
            if best <= COMPUTED:
                break
        if changed:
            _fill_factor(scaled.w, penalty, factor)
        apart, moved = _multipliers_step(scaled, penalty, factor, f, y, z, shift)
        changed = iteration % 10 == 9 and (apart > IMBALANCE * moved or moved > IMBALANCE * apart)
        if changed:
            penalty *= FACTOR if apart > moved else 1.0 / FACTOR
    return best


@declared(*SYSTEM, FLOATS)
@external
def solve_compliant(delassus, free, velocity, mu, least, held, lower, upper, x, compliance):
    """Solve as `solve_coulomb`; of several solutions compute the limit of small compliances. (11.12)

    With W + ε C in place of W solutions are isolated. Those for two values of ε are extrapolated to ε = 0,
    where Newton's method converges to the nearest solution. If the first one is not found, solutions for
    decreasing larger ε lead to it. C is diagonal, up to a factor `compliance` (nc,) for the rows of contacts
    and 1 for scalar rows. The initial x should have the symmetry of the problem.
    """
    size, unit = len(free), 0.0
    for a in range(3 * len(mu)):
        unit = max(unit, delassus[a, a])
    unit /= max(largest_of(compliance, 0), TINY)
    system = free, velocity, mu, least, held, lower, upper
    soft, far, start = delassus.copy(), np.empty(size), x.copy()
    soften(delassus, 2.0 * SMALL * unit, compliance, soft)
    if solve_coulomb(soft, *system, x) > USABLE:
        assign(x, start)
        for part in SOFTER:
            soften(delassus, part * unit, compliance, soft)
            solve_coulomb(soft, *system, x)
    assign(far, x)
    soften(delassus, SMALL * unit, compliance, soft)
    solve_coulomb(soft, *system, x)
    for a in range(size):
        x[a] += x[a] - far[a]
    return solve_coulomb(delassus, *system, x)


@inlined
def soften(delassus, unit, compliance, soft):
    """Fill the diagonal of soft (m, m) with that of W + ε C, ε = `unit`."""
    for a in range(len(soft)):
        soft[a, a] = delassus[a, a] + unit * (compliance[a // 3] if a < 3 * len(compliance) else 1.0)


@declared(*SYSTEM, FLOATS, FLOATS, FLOATS)
@external
def residual(delassus, free, velocity, mu, least, held, lower, upper, x, accelerations, scale_a, scale_f):
    """Return the largest residual of Coulomb's law over the rows, scaled by `scale`; infinite if not finite.

    `accelerations` (m,) is overwritten with u = u_free + W x. Other arguments as in `solve_coulomb`.
    """
    nc, ns = len(mu), len(lower)
    size = 3 * nc + ns
    apply(delassus, x, accelerations)
    worst = 0.0
    for a in range(size):
        accelerations[a] += free[a]
        if not abs(accelerations[a]) < math.inf:
            return math.inf
    for i in range(nc):
        b = 3 * i
        fn, an = x[b + 2] / scale_f[b], accelerations[b + 2] * scale_a[b]
        f1, f2 = x[b] / scale_f[b], x[b + 1] / scale_f[b]
        a1, a2 = accelerations[b] * scale_a[b], accelerations[b + 1] * scale_a[b]
        if held[i]:
            worst = max(worst, abs(an), abs(a1), abs(a2))
            continue
        worst = max(worst, abs(fn - max(least[i] / scale_f[b], fn - an)))
        if mu[i] == 0.0:
            continue
        speed = math.hypot(velocity[i, 0], velocity[i, 1])
        if speed > 0.0:
            worst = max(
                worst,
                abs(f1 + mu[i] * fn * velocity[i, 0] / speed),
                abs(f2 + mu[i] * fn * velocity[i, 1] / speed),
            )
            continue
        g1, g2 = f1 - a1, f2 - a2  # the projection of f − a onto the disc is f
        limit, length = mu[i] * max(fn, 0.0), math.hypot(g1, g2)
        if length > limit:
            g1, g2 = g1 * limit / length, g2 * limit / length
        worst = max(worst, abs(f1 - g1), abs(f2 - g2))
    for i in range(ns):
        b = 3 * nc + i
        f, rate = x[b] / scale_f[b], accelerations[b] * scale_a[b]
        worst = max(worst, abs(f - min(max(f - rate, lower[i] / scale_f[b]), upper[i] / scale_f[b])))
    return worst


@declared(FLOAT_ROWS, FLOATS, int, FLOATS, FLOATS, FLOATS, result=float)
@external
def scale(delassus, free, contacts, d, scale_a, scale_f):
    """Fill scales, equal for the rows of a contact so that cones keep their shape; return the unit.

    Args:
        delassus: (m, m) W, whose first rows are three per contact.
        free: (m,) u_free.
        contacts: Number of contacts.
        d: (m,) is overwritten with the factors that make the diagonal of W at most one.
        scale_a: (m,) is overwritten with the factors of accelerations.
        scale_f: (m,) is overwritten with the units of forces.

    Returns:
        The unit max |d u_free|; if it is zero the last two are not filled.
    """
    size = len(free)
    largest = unit = 0.0
    for a in range(size):
        largest = max(largest, delassus[a, a])
    for i in range(contacts):
        softest = max(delassus[3 * i, 3 * i], delassus[3 * i + 1, 3 * i + 1])
        softest = max(softest, delassus[3 * i + 2, 3 * i + 2])
        for a in range(3 * i, 3 * i + 3):
            d[a] = 1.0 / math.sqrt(max(softest, ROUNDOFF * largest))
    for a in range(3 * contacts, size):
        d[a] = 1.0 / math.sqrt(max(delassus[a, a], ROUNDOFF * largest))
    for a in range(size):
        unit = max(unit, abs(d[a] * free[a]))
    if unit > 0.0:
        for a in range(size):
            scale_a[a], scale_f[a] = d[a] / unit, d[a] * unit
    return unit


@declared(*SYSTEM, FLOATS, FLOATS, FLOATS)
@external
def newton(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f):
    """Refine forces x to rounding by Newton's method on their active set; return the residual.

    Other arguments as in `residual`; x is kept where a step does not reduce the residual.
    """
    best = residual(delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f)
    if not 0.0 < best < math.inf:
        return best
    size = len(free)
    system, right, step = np.empty((size, size)), np.empty(size), np.empty(size)
    trial, no_basis, undecided = x.copy(), np.empty((0, size)), repeated(len(mu), AS_FORCES_SAY)
    for _ in range(POLISH):
        answer_signals()
        linearize(
            *(delassus, free, velocity, mu, least, held, lower, upper, trial, a_now, scale_a, scale_f),
            *(undecided, system, right),
        )
        least_norm(system, right, COMPUTED, step, no_basis)
        for a in range(size):
            trial[a] += step[a] * scale_f[a]
        now = residual(
            delassus, free, velocity, mu, least, held, lower, upper, trial, a_now, scale_a, scale_f
        )
        if now < best:
            best = now
            assign(x, trial)
        if now <= ROUNDOFF or not now < 10.0 * best:
            break
    return best


@declared(*SYSTEM, FLOATS, FLOATS, FLOATS, INTEGERS, FLOAT_ROWS, FLOATS)
@external
def linearize(
    delassus, free, velocity, mu, least, held, lower, upper, x, a_now, scale_a, scale_f, closed, system, right
):
    """Fill the equations `system` · step = `right` of Newton's method at forces x with accelerations a_now.

    They are scaled as in `residual`. `closed` (nc,) is 1 for closed contacts (which stick if at rest), 0 for
    open ones, and `AS_FORCES_SAY` to decide by forces and accelerations.
    """
    nc, ns = len(mu), len(lower)
    size = 3 * nc + ns
    for a in range(size):
        for b in range(size):
            system[a, b] = 0.0
    for i in range(nc):
        b = 3 * i
        fn, an = x[b + 2] / scale_f[b], a_now[b + 2] * scale_a[b]
        given = closed[i] >= 0
        lowest = least[i] / scale_f[b]
        opens = not held[i] and (closed[i] == 0 if given else fn - an <= lowest)
        if opens and lowest == 0.0:
            for r in range(b, b + 3):
                system[r, r], right[r] = 1.0, -x[r] / scale_f[r]
            continue
        if opens:
            system[b + 2, b + 2], right[b + 2] = 1.0, lowest - fn
        else:
            for k in range(size):
                system[b + 2, k] = scale_a[b] * delassus[b + 2, k] * scale_f[k]
            right[b + 2] = -an
        speed = math.hypot(velocity[i, 0], velocity[i, 1])
        f1, f2 = x[b] / scale_f[b], x[b + 1] / scale_f[b]
        if not held[i] and (speed > 0.0 or mu[i] == 0.0):
            s1 = velocity[i, 0] / speed if speed > 0.0 else 0.0
            s2 = velocity[i, 1] / speed if speed > 0.0 else 0.0
            system[b, b], system[b, b + 2], right[b] = 1.0, mu[i] * s1, -f1 - mu[i] * fn * s1
            system[b + 1, b + 1], system[b + 1, b + 2], right[b + 1] = (
                1.0,
                mu[i] * s2,
                -f2 - mu[i] * fn * s2,
            )
            continue
        a1, a2 = a_now[b] * scale_a[b], a_now[b + 1] * scale_a[b]
        g1, g2 = f1 - a1, f2 - a2
        if held[i] or given or math.hypot(g1, g2) <= mu[i] * fn:  # sticks
            for k in range(size):
                system[b, k] = scale_a[b] * delassus[b, k] * scale_f[k]
                system[b + 1, k] = scale_a[b] * delassus[b + 1, k] * scale_f[k]
            right[b], right[b + 1] = -a1, -a2
        else:  # incipient slip: f_t = μ f_n g/|g|, g = f_t − a_t
            length = math.hypot(g1, g2)
            u1, u2 = g1 / length, g2 / length
            share = mu[i] * fn / length
            right[b], right[b + 1] = -f1 + mu[i] * fn * u1, -f2 + mu[i] * fn * u2
            for k in range(size):
                h1 = -scale_a[b] * delassus[b, k] * scale_f[k] + (1.0 if k == b else 0.0)
                h2 = -scale_a[b] * delassus[b + 1, k] * scale_f[k] + (1.0 if k == b + 1 else 0.0)
                across = u1 * h2 - u2 * h1
                system[b, k] = (1.0 if k == b else 0.0) + share * u2 * across
                system[b + 1, k] = (1.0 if k == b + 1 else 0.0) - share * u1 * across
            system[b, b + 2] -= mu[i] * u1
            system[b + 1, b + 2] -= mu[i] * u2
    for i in range(ns):
        b = 3 * nc + i
        f, rate = x[b] / scale_f[b], a_now[b] * scale_a[b]
        low, high = lower[i] / scale_f[b], upper[i] / scale_f[b]
        if f - rate <= low:
            system[b, b], right[b] = 1.0, low - f
        elif f - rate >= high:
            system[b, b], right[b] = 1.0, high - f
        else:
            for k in range(size):
                system[b, k] = scale_a[b] * delassus[b, k] * scale_f[k]
            right[b] = -rate
