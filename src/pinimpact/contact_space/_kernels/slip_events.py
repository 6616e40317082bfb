"""Events of turning slip: where v₃, the impulse or the normal work reaches a value. (theory.md, 3.3)"""

from __future__ import annotations

import math

from ..._compile.jit import always_inlined, inlined
from .codes import IMPULSE, VELOCITY, WORK
from .slip_series import beginning, first_root, flow, halley, leap, point, settled
from .slip_works import works_around, works_so_far

HASTE = 60
"""Number of iterations after which the bracket is bisected."""


@always_inlined
def measure(series, nodes, counts, aim, x):
    """Return a quantity minus its aim at x, its slope, and the logarithmic derivative of the slope.

    Arguments as for `seek`.
    """
    j0, j1, j2, v3 = series.j0, series.j1, series.j2, series.v3
    normal = work = 0.0
    if counts == WORK and not series.around_invariant:
        work, dv3, value = works_so_far(series, nodes, x)
        slope, bend, t = flow(series, x, value)
    else:
        normal, _, _, dv3, _, t, slope, bend = point(series, x)
    if counts == IMPULSE:
        return normal - aim, slope, bend
    chord = 1.0 + t * t
    rate = (j0 + t * (j1 + t * j2)) / chord
    if counts == WORK:
        now = v3 + dv3
        if series.around_invariant:
            work, _ = works_around(series, nodes, x)
        return work - aim, slope * now, bend + slope * rate / now
    turn = (j1 + 2.0 * t * (j2 - rate)) / chord
    return (
        (v3 - aim) + dv3,
        slope * rate,
        bend + (-series.shape.sign * t if series.around_invariant else series.shape.h) * turn / rate,
    )


@inlined
def seek(series, nodes, counts, aim, f_low, f_high, high, rate):
    """Find the x in (0, high] at which a monotone quantity equals `aim`, by bracketed third-order iteration.

    Args:
        series, nodes: The `SlipSeries`, and scratch for the work.
        counts: The quantity: VELOCITY v₃, IMPULSE ΔP₃ or WORK.
        aim: Its value at the root.
        f_low, f_high: The quantity minus `aim` at 0 and at `high`; of opposite signs, or f_high = 0.
        high: End of the bracket; may be inf.
        rate: dv₃/dP₃ at 0.
    """
    if f_high == 0.0:
        return high
    low, top = 0.0, high
    # initial guess for v₃ linear in P₃
    v3 = series.v3
    span = -f_low
    if counts == WORK:
        span = -2.0 * f_low / (v3 + math.sqrt(max(0.0, v3 * v3 - 2.0 * rate * f_low)))
    elif counts == VELOCITY:
        span = -f_low / rate
    slope, bend = beginning(series)
    # P₃ finally grows like e^{−aL} where slip settles, even if it does not do so at first
    settling = -series.shape.exponent if high == math.inf else -math.inf
    x = leap(-span, slope, max(bend, settling))
    if not 0.0 < x < high:
        x = 0.5
        if high < math.inf:
            x = high * (f_low / (f_low - f_high)) if math.isfinite(f_high) else high
    for i in range(120):
        now, slope, bend = measure(series, nodes, counts, aim, x)
        if now == 0.0:
            return x
        beyond = (now > 0.0) == (f_high > 0.0) or math.isnan(now)  # NaN from inf − inf
        if beyond:
            top = x
        else:
            low = x
        # a decaying exponential with this slope would never reach the aim
        out_of_sight = not beyond and bend * now / slope > 0.9
        step = leap(now, slope, settling if out_of_sight and settling > 0.0 else bend)
        new = x + step
        if new == x:
            return x
        if not (low < new < top and i < HASTE):
            if top < math.inf and top - low <= 2.0**-52 * top:
                return x
            new = 0.5 * (low + top) if top < math.inf else 2.0 * x + 1.0
        elif settled(step, x, now, slope):
            return new
        x = new
    return x


@inlined
def seek_near(series, nodes, counts, aim, x, near):
    """Find an event by Halley's method from the guess x, without a bracket; other arguments as for `seek`.

    Return 0 if the iteration leaves (0, near], or v₃ is not monotone up to the event.
    """
    k0, k1, k2, v3, h = series.j0, series.j1, series.j2, series.v3, series.shape.h
    for _ in range(8):
        if not 0.0 < x <= near:
            return 0.0
        now, slope, bend = measure(series, nodes, counts, aim, x)
        step = halley(now, slope, bend)
        converged = settled(step, x, now, slope)
        x += step
        if converged:
            end = h * x
            monotone = first_root(k0, k1, k2, end, end) == end
            # if v₃ has an extremum at x = 0, its rate there is rounding, so it is taken in the middle
            jams = k0 + 0.5 * end * (k1 + 0.5 * end * k2) < 0.0
            falls = counts != VELOCITY and jams and v3 + point(series, x)[3] < 0.0
            return x if monotone and not falls else 0.0
    return 0.0
