"""The contact-space impact in multiple precision, by closed forms and quadrature over the direction of slip.

With v_t = r (cos φ, sin φ), σ = v_t / r and σ⊥ = (−sin φ, cos φ), slip obeys

    dr/dP₃ = f(φ) = σᵀ(b − μAσ),        r dφ/dP₃ = g(φ) = σ⊥ᵀ(b − μAσ),

so that d ln r/dφ = f/g. In z = exp(iφ) both z²f and z²g are polynomials of degree four, and partial fractions
over the roots of z²g give ln r(φ) in logarithms and one arctangent. g is the derivative of the periodic
function b·σ − μ σᵀAσ/2, so it has real roots; φ is monotonic between two of them, φ_b (behind) and φ_a
(ahead). In the coordinate u = ln((φ − φ_b)/(φ_a − φ)) the integrands of

    P₃ = ∫ r/g dφ,   ∫ cos φ dP₃,   ∫ sin φ dP₃,   ∫ r dP₃

are analytic around the real axis up to known points, and Gauss-Legendre panels have lengths that depend on
the distance to these points. P_t, v₃ = v₃ᵒ + bᵀP_t + cP₃, the work of friction −μ∫r dP₃ and that of the
normal force follow algebraically. This module is independent of the package.

Inputs are doubles taken as exact; W is singular only if it is exactly singular.
"""

from __future__ import annotations

import bisect
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from mpmath import mp, mpc, mpf

LAWS = ("poisson", "energetic", "newton")
_ELLIPSE = 2.2  # smallest ratio of the distance of the nearest singularity to the half-length of a panel
_GROWTH = 8.0  # largest change of the logarithm of the integrand over half a panel
_NODES = (6, 8, 12, 16, 20, 24, 32, 40, 48, 56, 64, 80, 96)
_ELLIPSES = (3, 5, 8, 14, 25, 60, 1e3, 1e6)


class UnsupportedProblemError(ValueError):
    """The closed form does not support the problem, as g has a multiple root."""


@dataclass
class ReferenceSolution:
    """Solution in multiple precision, with names as in the package.

    `events` are (name, P₃) with names "end_compression", "vt=0", "stick", "slip_resumed" and
    "second_compression"; `status` and `flags` are names of members of the package's enumerations. `defect` is
    the relative residual of v = v⁻ + W P between closed form and quadrature, an estimate of the error.
    """

    velocity: tuple[mpf, mpf, mpf]
    impulse: tuple[mpf, mpf, mpf]
    compression_impulse: mpf
    restitution_impulse: mpf
    compression_work: mpf
    restitution_work: mpf
    friction_work: mpf
    events: list[tuple[str, mpf]]
    status: str
    flags: set[str]
    defect: mpf


class State(NamedTuple):
    """A point of the path: impulse, ∫ |v_t| dP₃, and tangential velocity."""

    P3: mpf
    P1: mpf
    P2: mpf
    slid: mpf
    v1: mpf
    v2: mpf


@functools.cache
def _gauss_legendre(n: int, prec: int) -> list[tuple[mpf, mpf]]:
    """Return nodes and weights of the n-point rule on [−1, 1]."""
    rule = []
    with mp.workprec(prec + 20):
        for guess in np.polynomial.legendre.leggauss(n)[0]:
            x, step = mpf(float(guess)), mpf(1)
            while True:
                p0, p1 = mpf(1), x
                for j in range(2, n + 1):
                    p0, p1 = p1, ((2 * j - 1) * x * p1 - (j - 1) * p0) / j
                slope = n * (x * p1 - p0) / (x * x - 1)
                if abs(step) < mpf(2) ** -(prec // 2 + 10):  # x has the working precision
                    break
                step = p1 / slope
                x -= step
            rule.append((x, 2 / ((1 - x * x) * slope**2)))
    return rule


class _Problem:
    """The numbers of a problem, and functions of them."""

    def __init__(self, W, v, mu, e, law: str, digits: int) -> None:
        self.a11, self.a12, self.a22 = mpf(W[0][0]), mpf(W[0][1]), mpf(W[1][1])
        self.b1, self.b2, self.c = mpf(W[0][2]), mpf(W[1][2]), mpf(W[2][2])
        self.v = tuple(mpf(x) for x in v)
        self.mu, self.e, self.law, self.digits = mpf(mu), mpf(e), law, digits
        self.scale = mp.norm(self.v)
        reach = abs(self.v[2]) if self.v[2] else self.scale
        self.zero_speed = reach * mpf(10) ** -(digits + 3)
        self.tiny = mpf(10) ** -(digits + 15)

    def f(self, co, si):
        a = self.a11 * co * co + 2 * self.a12 * co * si + self.a22 * si * si
        return self.b1 * co + self.b2 * si - self.mu * a

    def v3_slope(self, co, si):
        return self.c - self.mu * (self.b1 * co + self.b2 * si)

    def v3(self, s: State):
        return self.v[2] + self.b1 * s.P1 + self.b2 * s.P2 + self.c * s.P3

    def normal_work(self, s: State):
        total = (s.P1 * (self.v[0] + s.v1) + s.P2 * (self.v[1] + s.v2) + s.P3 * (self.v[2] + self.v3(s))) / 2
        return total + self.mu * s.slid

    def value(self, name: str, s: State):
        return s.P3 if name == "P3" else self.v3(s) if name == "v3" else self.normal_work(s)

    def singular(self) -> bool:
        with mp.workprec(4000):  # exact for doubles of usual magnitudes
            d = self.c * (self.a11 * self.a22 - self.a12**2)
            d += 2 * self.a12 * self.b1 * self.b2 - self.a11 * self.b2**2 - self.a22 * self.b1**2
            return d == 0

    def locks(self) -> bool:
        """Return whether c − bᵀA⁺b is exactly zero."""
        with mp.workprec(4000):
            if self.a11 * self.a22 != self.a12**2:
                return self.singular()
            bAb = self.a11 * self.b1**2 + 2 * self.a12 * self.b1 * self.b2 + self.a22 * self.b2**2
            return self.c * (self.a11 + self.a22) ** 2 == bAb

    def sticking_impulse(self):
        """Return A⁺b, with the exact rank of A."""
        with mp.workprec(4000):
            det = self.a11 * self.a22 - self.a12**2
        if det != 0:
            det = +det
            return (
                (self.a22 * self.b1 - self.a12 * self.b2) / det,
                (self.a11 * self.b2 - self.a12 * self.b1) / det,
            )
        trace = self.a11 + self.a22
        if trace == 0:
            return mpf(0), mpf(0)
        return (
            (self.a11 * self.b1 + self.a12 * self.b2) / trace**2,
            (self.a12 * self.b1 + self.a22 * self.b2) / trace**2,
        )

    @functools.cached_property
    def directions(self) -> _Directions:
        return _Directions(self)


class _Directions:
    """Roots of g: invariant directions φ with exponents f/g', and at most one pair off the unit circle."""

    def __init__(self, p: _Problem) -> None:
        alpha = mpc(p.a12, (p.a11 - p.a22) / 2)
        beta = mpc(p.b2, p.b1)
        self.real: list[tuple[mpf, mpf]] = []
        self.inner: tuple[mpc, mpc] | None = None  # the root inside the circle, and its residue
        size = p.mu * (abs(p.a11) + abs(p.a22)) + abs(beta)
        self.everywhere = p.mu * abs(alpha) + abs(beta) <= size * p.tiny
        if self.everywhere:
            return
        if alpha == 0:
            roots = [mp.sqrt(-mp.conj(beta) / beta)]
            roots.append(-roots[0])
            self.scale = abs(beta) / 2
        else:
            coefficients = [-p.mu * alpha, beta, mpf(0), mp.conj(beta), -p.mu * mp.conj(alpha)]
            roots = _quartic_roots(coefficients)
            self.scale = p.mu * abs(alpha) / 2
        near = mpf(2) ** (-mp.prec // 2 + 20)
        inside = []
        for z in roots:
            if abs(abs(z) - 1) < near:
                phi = mp.arg(z)
                co, si = mp.cos(phi), mp.sin(phi)
                slope = -p.b1 * co - p.b2 * si
                slope += p.mu * ((p.a11 - p.a22) * (co * co - si * si) + 4 * p.a12 * co * si)
                if abs(slope) < size * near:
                    raise UnsupportedProblemError("two invariant directions coincide")
                self.real.append((phi, p.f(co, si) / slope))
            elif abs(z) < 1:
                inside.append(z)
        self.real.sort()
        if inside:
            (z,) = inside
            F = -1j * beta / 2 * z**3 + 1j * mp.conj(beta) / 2 * z
            F += -p.mu * ((p.a11 + p.a22) / 2 * z**2 - 1j * alpha / 2 * z**4 + 1j * mp.conj(alpha) / 2)
            dG = -2 * p.mu * alpha * z**3 + 3 * beta / 2 * z**2 + mp.conj(beta) / 2
            self.inner = z, F / (1j * z * dG)

    def diverging(self, p: _Problem) -> mpf:
        """Return the direction in which slip resumes, the only root of g with f > 0."""
        return max((p.f(mp.cos(phi), mp.sin(phi)), phi) for phi, _ in self.real)[1]


def _quartic_roots(coefficients: Sequence[mpc]) -> list[mpc]:
    """Return simple roots in the working precision, by Weierstrass' iteration from those of NumPy."""
    prec = mp.prec
    with mp.workprec(3 * prec):
        poly = [x / coefficients[0] for x in coefficients]
        roots = [mpc(z) + mpc(0, 1e-30 * k) for k, z in enumerate(np.roots([complex(x) for x in poly]))]
        for _ in range(100):
            steps = []
            for k, z in enumerate(roots):
                others = [z - y for j, y in enumerate(roots) if j != k]
                value = functools.reduce(lambda total, x, z=z: total * z + x, poly)
                steps.append(value / mp.fprod(others))
            roots = [z - step for z, step in zip(roots, steps, strict=True)]
            if all(abs(step) < abs(z) * mpf(2) ** (-2 * prec) for z, step in zip(roots, steps, strict=True)):
                return roots
    raise UnsupportedProblemError("two invariant directions coincide")


class _Line:
    """A straight piece of the path: slip along an invariant direction, sticking, or no friction."""

    def __init__(self, p: _Problem, start: State, push, drift, slope, length) -> None:
        """`push` is dP_t/dP₃, `drift` dv_t/dP₃ and `slope` dv₃/dP₃."""
        self.p, self.start, self.push, self.drift, self.slope, self.length = (
            p,
            start,
            push,
            drift,
            slope,
            length,
        )

    def at(self, x) -> State:
        s = self.start
        v1, v2 = s.v1 + self.drift[0] * x, s.v2 + self.drift[1] * x
        slid = s.slid + (mp.hypot(s.v1, s.v2) + mp.hypot(v1, v2)) / 2 * x if self.p.mu else s.slid
        return State(s.P3 + x, s.P1 + self.push[0] * x, s.P2 + self.push[1] * x, slid, v1, v2)

    @property
    def rising(self) -> bool:
        return self.slope > 0

    def reach(self, name: str, target) -> State | None:
        """Return the first state in which a quantity reaches its target, or None."""
        lack = target - self.p.value(name, self.start)
        if name == "P3":
            x = lack
        elif name == "v3":
            if self.length < mp.inf and abs(self.slope * self.length - lack) <= self.p.zero_speed:
                return None  # at the end, where the next piece may be a locked contact
            if abs(lack) <= self.p.zero_speed:
                return self.start
            if self.slope == 0:
                return None
            x = lack / self.slope
        else:
            v3 = self.p.v3(self.start)
            root = v3 * v3 + 2 * self.slope * lack
            if lack == 0:
                return self.start
            if root < 0 or v3 + mp.sqrt(root) <= 0:
                return None
            x = 2 * lack / (v3 + mp.sqrt(root))
        return self.at(x) if 0 <= x <= self.length else None

    def cut(self, state: State) -> _Line:
        used = state.P3 - self.start.P3
        return _Line(self.p, state, self.push, self.drift, self.slope, self.length - used)


class _Arc:
    """Turning slip between two neighbouring invariant directions."""

    def __init__(self, p: _Problem, phi0, r0, turning: int) -> None:
        self.p = p
        two_pi = 2 * mp.pi
        roots = p.directions.real
        ahead = min(((turning * (phi - phi0)) % two_pi, phi, kappa) for phi, kappa in roots)
        behind = min(((turning * (phi0 - phi)) % two_pi, phi, kappa) for phi, kappa in roots)
        self.turning, self.span = turning, ahead[0] + behind[0]
        self.end = phi0 + turning * ahead[0]
        self.kappa_a, self.kappa_b = ahead[2], behind[2]
        self.others = [
            (mp.cos(phi), mp.sin(phi), kappa / 2) for phi, kappa in roots if phi not in (ahead[1], behind[1])
        ]
        self.inner = p.directions.inner
        self.u0 = mp.log(behind[0] / ahead[0])
        self.log_r0 = mpf(0)
        self.log_r0 = self.point(self.u0)[0] - mp.log(r0)
        self.singularities = self._singularities(two_pi)

    def _coordinate(self, phi):
        x = self.turning * (self.end - phi)  # remaining angle
        return (self.span - x) / x

    def _singularities(self, two_pi) -> list[complex]:
        found = [mpc(phi) for phi, _ in self.p.directions.real]
        if self.inner:
            z = self.inner[0]
            found += [mpc(mp.arg(z), -mp.log(abs(z))), mpc(mp.arg(z), mp.log(abs(z)))]
        places = [complex(0, math.pi)]
        for phi in found:
            nearest = phi + two_pi * mp.nint((self.end - phi.real) / two_pi)
            for k in (-2, -1, 0, 1, 2):
                x = self.turning * (self.end - nearest - k * two_pi)
                if min(abs(x), abs(self.span - x)) > mpf(2) ** (-mp.prec // 2):
                    u = mp.log((self.span - x) / x)
                    places.append(complex(float(u.real), abs(float(u.imag))))
        return places

    def room(self, u: float) -> float:
        return min(abs(u - place) for place in self.singularities)

    def point(self, u):
        """Return ln r, cos φ, sin φ and (dφ/du)/|g| at u."""
        t = mp.exp(u)
        q = self.span / (1 + t)
        xa, xb = q, t * q
        phi = self.end - self.turning * xa
        co, si = mp.cos_sin(phi)
        la, lb = 2 * mp.sin(xa / 2), 2 * mp.sin(xb / 2)
        log_r = self.kappa_a * mp.log(la) + self.kappa_b * mp.log(lb) - self.log_r0
        g = self.p.directions.scale * la * lb
        if self.others:
            square = mpf(1)
            for ck, sk, half in self.others:
                d2 = 2 - 2 * (co * ck + si * sk)
                log_r += half * mp.log(d2)
                square *= d2
            g *= mp.sqrt(square)
        if self.inner:
            root, residue = self.inner
            x = 1 - (root.real * co + root.imag * si)
            y = root.real * si - root.imag * co
            m2 = x * x + y * y
            log_r += residue.real * mp.log(m2) - residue.imag * (phi + 2 * mp.atan2(y, x))
            g *= m2 / abs(root)
        return log_r, co, si, xa * xb / (self.span * g)

    def rate(self, u) -> float:
        """Return |d ln r/du| at u."""
        _, co, si, weight = self.point(u)
        return abs(float(self.p.f(co, si) * weight))

    def step(self, u, limit):
        """Return the end of the panel that starts at u, at most `limit`."""
        h = min(float(limit - u) / 2, 200.0) if limit is not None else 200.0
        a = float(u)
        while h * _ELLIPSE > self.room(a + h):
            h /= 1.4
        start = self.rate(u)
        while h * max(start, self.rate(u + h), self.rate(u + 2 * h)) > _GROWTH:
            h /= 1.4
        end = u + 2 * mpf(h)
        return limit if limit is not None and end > limit - mpf(h) / 1000 else end

    def advance(self, state: State, u, w) -> State:
        """Return the state at w from that at u."""
        h, middle = (w - u) / 2, (w + u) / 2
        if h == 0:
            return state
        # |error| < ρ^(−2n) × the integrand on the ellipse of parameter ρ, of which r² dP₃ grows fastest
        half = max(abs(float(h)), 1e-300)
        ratio = max(self.room(float(middle)) / half, 1.5)
        largest = min(ratio + math.sqrt(ratio * ratio - 1), 1e12)
        growth = 1.5 * half * max(self.rate(middle), 0.5)
        digits = (self.p.digits + 14) * math.log(10)
        need = min(
            (digits + growth * rho) / (2 * math.log(rho)) for rho in (*_ELLIPSES, largest) if rho <= largest
        )
        n = _NODES[min(bisect.bisect_left(_NODES, need), len(_NODES) - 1)]
        total = [mpf(0)] * 4
        for x, weight in _gauss_legendre(n, mp.prec):
            log_r, co, si, per_u = self.point(middle + h * x)
            r = mp.exp(log_r)
            d = weight * r * per_u
            total[0] += d
            total[1] += d * co
            total[2] += d * si
            total[3] += d * r
        log_r, co, si, _ = self.point(w)
        r = mp.exp(log_r)
        mu = self.p.mu
        return State(
            state.P3 + h * total[0],
            state.P1 - mu * h * total[1],
            state.P2 - mu * h * total[2],
            state.slid + h * total[3],
            r * co,
            r * si,
        )

    def turning_points(self) -> list[mpf]:
        """Return u at the sign changes of dv₃/dP₃ = c − μ bᵀσ after the start."""
        p = self.p
        size = p.mu * mp.hypot(p.b1, p.b2)
        if size <= p.c:
            return []
        middle, half = mp.atan2(p.b2, p.b1), mp.acos(p.c / size)
        points = []
        for phi in (middle - half, middle + half):
            x = (self.turning * (self.end - phi)) % (2 * mp.pi)
            if 0 < x < self.span:
                u = mp.log((self.span - x) / x)
                if u > self.u0:
                    points.append(u)
        return sorted(points)


class _Panel:
    """A piece of an arc on which v₃ is monotonic."""

    def __init__(self, arc: _Arc, u, start: State, w, stop: State) -> None:
        self.arc, self.p = arc, arc.p
        self.u, self.start, self.w, self.stop = u, start, w, stop
        self._places: dict[State, mpf] = {}

    @property
    def rising(self) -> bool:
        return self.p.v3(self.stop) > self.p.v3(self.start)

    def reach(self, name: str, target) -> State | None:
        p = self.p
        first, last = p.value(name, self.start) - target, p.value(name, self.stop) - target
        size = p.zero_speed if name == "v3" else mpf(0)
        if first == 0:
            return self.start
        if (first > 0) == (last > 0) or abs(last) <= size:
            return None
        lower, upper = self.u, self.w
        u, state, miss = self.u, self.start, first
        for _ in range(200):
            log_r, co, si, per_u = self.arc.point(u)
            dP = mp.exp(log_r) * per_u
            v3 = p.v3(state)
            slope = dP * (1 if name == "P3" else p.v3_slope(co, si) if name == "v3" else v3)
            new = u - miss / slope if slope else (lower + upper) / 2
            if not lower <= new <= upper:
                new = (lower + upper) / 2
            state = self.arc.advance(state, u, new)
            done = abs(new - u) <= mpf(10) ** -(p.digits // 2 + 5) and abs(miss) < abs(first) * mpf(10) ** -8
            done = done or upper - lower <= mpf(2) ** (20 - mp.prec)
            u = new
            miss = p.value(name, state) - target
            if (miss > 0) == (first > 0):
                lower = u
            else:
                upper = u
            if done:
                self._places[state] = u
                return state
        raise ArithmeticError("event not found")

    def cut(self, state: State) -> _Panel:
        u = self.u if state is self.start else self._places[state]
        return _Panel(self.arc, u, state, self.w, self.stop)


@dataclass
class _Account:
    """Phases, restitution law and sums of an impact."""

    p: _Problem
    compressing: bool = True
    mark: State | None = None
    impulse: dict[bool, mpf] = field(default_factory=lambda: {True: mpf(0), False: mpf(0)})
    work: dict[bool, mpf] = field(default_factory=lambda: {True: mpf(0), False: mpf(0)})
    events: list[tuple[str, mpf]] = field(default_factory=list)
    flags: set[str] = field(default_factory=set)
    status: str = ""

    def close(self, state: State) -> None:
        """Add impulse and work of the phase that ends at `state`."""
        self.impulse[self.compressing] += state.P3 - self.mark.P3
        self.work[self.compressing] += self.p.normal_work(state) - self.p.normal_work(self.mark)
        self.mark = state

    def law_end(self):
        """Return the name of the quantity that ends the restitution, and its goal."""
        p = self.p
        if p.law == "poisson":
            return "P3", self.mark.P3 + p.e * self.impulse[True] - self.impulse[False]
        if p.law == "energetic":
            rest = -(p.e**2) * self.work[True] - self.work[False]
            return "work", p.normal_work(self.mark) + rest
        return "v3", -p.e * p.v[2]

    def finish(self, state: State, status: str) -> State:
        self.close(state)
        self.status = status
        return state

    def run(self, piece) -> State | None:
        """Apply the restitution law on a piece; return the final state if the impact ends on it, or None."""
        p = self.p
        while True:
            if self.compressing:
                state = piece.reach("v3", mpf(0)) if piece.rising else None
                if state is None:
                    return None
                self.close(state)
                self.events.append(("end_compression", state.P3))
                self.compressing = False
                if p.e == 0 or (p.law == "newton" and p.v[2] == 0):
                    return self.finish(state, "ENDED_AT_REST")
            else:
                state = None if piece.rising else piece.reach("v3", mpf(0))
                end = piece.reach(*self.law_end())
                if end is not None and (state is None or end.P3 <= state.P3):
                    return self.finish(end, "SEPARATED")
                if state is None:
                    return None
                self.close(state)
                self.events.append(("second_compression", state.P3))
                self.flags.add("SECOND_COMPRESSION")
                self.compressing = True
            piece = piece.cut(state)


def _slip(p: _Problem, account: _Account, state: State) -> tuple[State, bool]:
    """Integrate slip from a state with v_t ≠ 0; return its end, and whether the impact ends there."""
    phi, r = mp.atan2(state.v2, state.v1), mp.hypot(state.v1, state.v2)
    co, si = state.v1 / r, state.v2 / r
    a = (p.a22 - p.a11) * co * si + p.a12 * (co * co - si * si)
    g = p.b2 * co - p.b1 * si - p.mu * a
    size = p.mu * (p.a11 + p.a22) + mp.hypot(p.b1, p.b2)
    if abs(g) > size * p.tiny:
        arc = _Arc(p, phi, r, 1 if g > 0 else -1)
        u = arc.u0
        stops = arc.turning_points()
        low = mpf(10) ** -(p.digits + 22)
        while True:
            if 1 / (1 + mp.exp(u)) < low or mp.hypot(state.v1, state.v2) < low * r:
                break
            w = arc.step(u, next((x for x in stops if x > u), None))
            stop = arc.advance(state, u, w)
            if p.v3_slope(*arc.point((u + w) / 2)[1:3]) < 0:
                account.flags.add("JAM")
            end = account.run(_Panel(arc, u, state, w, stop))
            if end is not None:
                return end, True
            u, state = w, stop
        co, si = mp.cos_sin(arc.end)
        r = mp.hypot(state.v1, state.v2)
    return _slip_straight(p, account, state, co, si, r)


def _slip_straight(p, account, state, co, si, r) -> tuple[State, bool]:
    """Integrate slip along an invariant direction (co, si) from the speed r; return as `_slip`."""
    f, k = p.f(co, si), p.v3_slope(co, si)
    size = p.mu * (p.a11 + p.a22) + mp.hypot(p.b1, p.b2)
    f = mpf(0) if abs(f) <= size * p.tiny else f
    k = mpf(0) if abs(k) <= (size + p.c) * p.tiny else k
    if k < 0:
        account.flags.add("JAM")
    length = -r / f if f < 0 else mp.inf
    line = _Line(p, state, (-p.mu * co, -p.mu * si), (f * co, f * si), k, length)
    end = account.run(line)
    if end is not None:
        return end, True
    if length == mp.inf:
        account.status = "UNSTOPPABLE" if account.compressing else "LAW_UNREACHABLE"
        return state, True
    return line.at(length)._replace(v1=mpf(0), v2=mpf(0)), False


def _after_stop(p: _Problem, account: _Account, state: State) -> State:
    """Integrate from v_t = 0 to the end of the impact; return the final state."""
    push = p.sticking_impulse()
    if mp.hypot(*push) > p.mu * (1 + p.tiny):
        account.flags.add("SLIP_RESUMED")
        account.events.append(("slip_resumed", state.P3))
        phi = mp.atan2(p.b2, p.b1) if p.directions.everywhere else p.directions.diverging(p)
        return _slip_straight(p, account, state, mp.cos(phi), mp.sin(phi), mpf(0))[0]
    account.flags.add("STICK")
    account.events.append(("stick", state.P3))
    slope = p.c - p.b1 * push[0] - p.b2 * push[1]
    if not p.locks():
        line = _Line(p, state, (-push[0], -push[1]), (mpf(0), mpf(0)), slope, mp.inf)
        return account.run(line)
    account.flags.add("LOCKED")
    line = _Line(p, state, (-push[0], -push[1]), (mpf(0), mpf(0)), mpf(0), mp.inf)
    if account.compressing:
        if p.v3(state) < -p.zero_speed:
            account.status = "UNSTOPPABLE"
            return state
        account.close(state)
        account.events.append(("end_compression", state.P3))
        account.compressing = False
        if p.e == 0:
            return account.finish(state, "LOCKED")
    if p.law == "poisson":
        state = line.reach(*account.law_end())
    return account.finish(state, "LOCKED")


def solve_reference(W, v, mu, e, law: str = "poisson", digits: int = 50) -> ReferenceSolution:
    """Solve a contact-space problem in multiple precision.

    Args:
        W: (3, 3) symmetric, in (t₁, t₂, n); only the upper triangle is read.
        v: (3,) velocity before the impact.
        mu: Friction coefficient.
        e: Coefficient of restitution.
        law: "poisson", "energetic" or "newton".
        digits: Digits of the solution; the working precision has about thirty more.

    Raises:
        UnsupportedProblemError: If two invariant directions coincide while slip turns.
    """
    slip, approach = math.hypot(float(v[0]), float(v[1])), abs(float(v[2]))
    lost = 2 * math.log10(slip / approach) - 6 if slip and approach else 0.0
    extra = 40 * max(0, math.ceil(lost / 40))  # in coarse steps, so that quadrature rules are reused
    with mp.workdps(digits + 30 + extra):
        return _solve(_Problem(W, v, mu, e, law, digits))


def _solve(p: _Problem) -> ReferenceSolution:
    zero = mpf(0)
    start = State(zero, zero, zero, zero, p.v[0], p.v[1])
    account = _Account(p, mark=start)
    r = mp.hypot(p.v[0], p.v[1])
    jam = r > 0 and p.v3_slope(p.v[0] / r, p.v[1] / r) < 0
    if p.v[2] > 0 or (p.v[2] == 0 and not jam):
        account.status = "NO_IMPACT"
        return _report(p, account, start)
    if p.singular():
        account.flags.add("SINGULAR_DELASSUS")
    if p.v[2] == 0:
        account.flags.add("IMPACT_WITHOUT_COLLISION")
    if p.mu == 0:
        line = _Line(p, start, (zero, zero), (p.b1, p.b2), p.c, mp.inf)
        end = account.run(line)
        if end is None:
            account.status = "UNSTOPPABLE" if account.compressing else "LAW_UNREACHABLE"
            end = start
        return _report(p, account, end)
    state, over = _slip(p, account, start) if r > 0 else (start, False)
    if not over:
        if r > 0:
            account.events.append(("vt=0", state.P3))
        state = _after_stop(p, account, state)
    return _report(p, account, state)


def _report(p: _Problem, account: _Account, s: State) -> ReferenceSolution:
    velocity = (s.v1, s.v2, p.v3(s))
    defect = mpf(0)
    if account.status in ("SEPARATED", "ENDED_AT_REST", "LOCKED"):
        size = p.scale + (p.a11 + p.a22 + p.c) * s.P3
        d1 = p.v[0] + p.a11 * s.P1 + p.a12 * s.P2 + p.b1 * s.P3 - s.v1
        d2 = p.v[1] + p.a12 * s.P1 + p.a22 * s.P2 + p.b2 * s.P3 - s.v2
        defect = mp.hypot(d1, d2) / size
        if velocity[2] < 0 or abs(velocity[2]) <= p.zero_speed:
            velocity = (s.v1, s.v2, mpf(0)) if abs(velocity[2]) <= p.zero_speed else velocity
        total = (s.P1 * (p.v[0] + s.v1) + s.P2 * (p.v[1] + s.v2) + s.P3 * (p.v[2] + velocity[2])) / 2
        if total > p.scale * s.P3 * mpf(10) ** -p.digits:
            account.flags.add("ENERGY_CREATED")
    return ReferenceSolution(
        velocity=velocity,
        impulse=(s.P1, s.P2, s.P3),
        compression_impulse=account.impulse[True],
        restitution_impulse=account.impulse[False],
        compression_work=account.work[True],
        restitution_work=account.work[False],
        friction_work=-p.mu * s.slid,
        events=account.events,
        status=account.status,
        flags=account.flags,
        defect=defect,
    )
