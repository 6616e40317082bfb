"""An impact at many contacts in real time by steps of equal length, halved and extrapolated: (14.1), (14.2).

Plain NumPy, written apart from the solver. Only for η = 1 and 0 < e ≤ 1.
"""

import numpy as np


def step_through(w, start, friction, restitution, stiffness, h):
    """Velocities (3n,) at the contacts after the impact, first-order in h; rows are (x, y, normal)."""
    n = len(start) // 3
    v, indentation, deepest = start.copy(), np.zeros(n), np.zeros(n)
    normal = np.arange(2, 3 * n, 3)
    blocks = [w[3 * i : 3 * i + 2, 3 * i : 3 * i + 2] for i in range(n)]
    push = np.zeros(3 * n)
    while (indentation > 0.0).any() or (v[normal] < -1e-9).any():
        inside = indentation < deepest
        rate = np.where(inside, 1.0 / restitution**2, 1.0)
        indentation = indentation - h * rate * v[normal]
        deepest = np.where(indentation > 0.0, np.maximum(deepest, indentation), 0.0)
        push[normal] = stiffness * np.maximum(indentation, 0.0)
        most = friction * push[normal]
        for _ in range(2000):  # projected Gauss–Seidel on the velocities at the end of the step
            change = 0.0
            for i in np.flatnonzero(most):
                at = slice(3 * i, 3 * i + 2)
                new = push[at] - (v[at] + h * (w[at] @ push)) / (h * np.trace(blocks[i]))
                new *= min(1.0, most[i] / max(np.hypot(*new), 1e-300))
                change = max(change, np.abs(new - push[at]).max())
                push[at] = new
            for i in np.flatnonzero(most == 0.0):
                push[3 * i : 3 * i + 2] = 0.0
            if change <= 1e-11 * most.max():
                break
        v = v + h * (w @ push)
    return v


def landing(w, start, friction, restitution, stiffness, h):
    """Velocities after it, with the term of first order in h taken off, and an estimate of what is left."""
    coarse, fine, finest = (
        step_through(w, start, friction, restitution, stiffness, h / k) for k in (1, 2, 4)
    )
    first, second = 2.0 * fine - coarse, 2.0 * finest - fine
    return second, np.abs(second - first).max()
