"""Mass with dry friction under F(t) = A sin(ωt + φ) + c: closed forms between events, which are bracketed."""

from __future__ import annotations

import math

from scipy.optimize import brentq


class Swing:
    """The force F(t) and its integrals."""

    def __init__(self, amplitude, pace, phase, mean):
        self.A, self.w, self.phi, self.c = amplitude, pace, phase, mean

    def force(self, t):
        return self.A * math.sin(self.w * t + self.phi) + self.c

    def impulse(self, a, b):
        lift = math.cos(self.w * a + self.phi) - math.cos(self.w * b + self.phi)
        return self.A / self.w * lift + self.c * (b - a)

    def path(self, a, b):
        """Return ∫ impulse(a, s) ds from a to b, the path of a unit mass."""
        swing = math.sin(self.w * a + self.phi) - math.sin(self.w * b + self.phi)
        swing = self.A / self.w**2 * swing + self.A / self.w * math.cos(self.w * a + self.phi) * (b - a)
        return swing + 0.5 * self.c * (b - a) ** 2


def stick_slip(load, limit, duration, x=0.0, v=0.0, mass=1.0):
    """Return the final position and velocity, and the number of starts of slip.

    Events are bracketed on a grid of a thousandth of the period.
    """
    grid = 2.0 * math.pi / load.w / 1000.0
    t, slips = 0.0, 0
    while t < duration:
        if v == 0.0:
            if abs(load.force(t)) < limit:
                a = t
                while a < duration and abs(load.force(a + grid)) < limit:
                    a += grid
                if a >= duration:
                    return x, 0.0, slips
                t = brentq(lambda s: abs(load.force(s)) - limit, a, a + grid, xtol=1e-15)
                if t >= duration:
                    return x, 0.0, slips
            slips += 1
            sign = math.copysign(1.0, load.force(t))
        else:
            sign = math.copysign(1.0, v)
        start, first = t, v

        def speed(s, start=start, first=first, sign=sign):
            return sign * (first + (load.impulse(start, s) - sign * limit * (s - start)) / mass)

        b = start + grid
        while b < duration and speed(b) > 0.0:
            b += grid
        t = b
        if speed(b) <= 0.0:
            a = b - grid if b - grid > start else start + 1e-6 * grid
            t = brentq(speed, a, b, xtol=1e-15) if speed(a) > 0.0 else a
        t = min(t, duration)
        x += first * (t - start) + (load.path(start, t) - 0.5 * sign * limit * (t - start) ** 2) / mass
        v = sign * speed(t) if t >= duration else 0.0
        if t < duration and abs(load.force(t)) >= limit:  # slip reverses without sticking
            v = math.copysign(1e-300, load.force(t))
            slips += 1
    return x, v, slips
