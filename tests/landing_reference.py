"""Reference for impacts at several contacts: (14.1), (14.2) by constant steps with Richardson extrapolation.

Independent of the solver: semi-implicit Euler, with friction by projected Gauss–Seidel in the forces. For
η = 1 and 0 < e ≤ 1.
"""

import numba
import numpy as np


@numba.njit
def step_through(w, start, friction, restitution, stiffness, h):
    """Return the velocities (3n,) at the contacts after the impact, of first order in h.

    Args:
        w: (3n, 3n) Delassus matrix; rows of a contact are x, y, normal.
        start: (3n,) velocities before the impact [m/s].
        friction, restitution, stiffness: (n,) coefficients of the contacts.
        h: Step size of the clock.
    """
    n = len(start) // 3
    v, push = start.copy(), np.zeros(3 * n)
    indentation, deepest, most = np.zeros(n), np.zeros(n), np.zeros(n)
    while True:
        pressed = False
        for i in range(n):
            pressed = pressed or indentation[i] > 1e-8 or v[3 * i + 2] < -1e-8
        if not pressed:
            return v
        strongest = 0.0
        for i in range(n):
            approach, e2 = -h * v[3 * i + 2], restitution[i] ** 2
            if approach > 0.0:
                # closing the gap at rate 1, reloading to the largest indentation at rate 1/e², then at rate 1
                gap = min(approach, max(-indentation[i], 0.0))
                again = min(approach - gap, max(deepest[i] - max(indentation[i], 0.0), 0.0) * e2)
                indentation[i] += gap + again / e2 + (approach - gap - again)
            else:
                unloading = min(-approach, max(indentation[i], 0.0) * e2)
                indentation[i] -= unloading / e2 + (-approach - unloading)
            deepest[i] = max(deepest[i], indentation[i]) if indentation[i] > 0.0 else 0.0
            push[3 * i + 2] = stiffness[i] * max(indentation[i], 0.0)
            most[i] = friction[i] * push[3 * i + 2]
            strongest = max(strongest, most[i])
        for i in range(n):
            length = np.hypot(push[3 * i], push[3 * i + 1])
            if length > most[i]:
                push[3 * i] *= most[i] / length
                push[3 * i + 1] *= most[i] / length
        after = v + h * (w @ push)
        for _ in range(2000):  # projected Gauss–Seidel on the velocities at the end of the step
            change = 0.0
            for i in range(n):
                x, y = 3 * i, 3 * i + 1
                if most[i] > 0.0:
                    give = h * (w[x, x] + w[y, y])
                    fx, fy = push[x] - after[x] / give, push[y] - after[y] / give
                    length = np.hypot(fx, fy)
                    if length > most[i]:
                        fx, fy = fx * most[i] / length, fy * most[i] / length
                    dx, dy = fx - push[x], fy - push[y]
                    push[x], push[y] = fx, fy
                    change = max(change, abs(dx) + abs(dy))
                    for k in range(3 * n):
                        after[k] += h * (w[k, x] * dx + w[k, y] * dy)
            if change <= 1e-8 * strongest:
                break
        v = after


def landing(w, start, friction, restitution, stiffness, h):
    """Return the velocities after the impact, extrapolated to second order in h, and an error estimate."""
    coarse, fine, finest = (
        step_through(w, start, friction, restitution, stiffness, h / k) for k in (1, 2, 4)
    )
    first, second = 2.0 * fine - coarse, 2.0 * finest - fine
    return second, np.abs(second - first).max()
