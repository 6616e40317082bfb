"""Derivatives of the forces of a control by the state. (docs/derivatives.md, 9)"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from .._numeric.tolerances import LITTLE
from ..arrays import Array
from ..checks import finite_array, returned
from .controls import JointPD, SampledControl, asked
from .scene import Scene

ControlJacobian = Callable[[float, Array, Array], ArrayLike]
"""jacobian(t, q, v) -> (nv, 2 nv) of the forces by q, in the tangent space, and v."""


def jacobian_of(scene: Scene) -> ControlJacobian | None:
    """Return the derivative of a control that is a function or sampled; None if it is not known."""
    control = scene.control if "control" not in scene.without else None
    if isinstance(control, JointPD):
        return control.drives(scene.model).jacobian if scene.period is not None else None
    jacobian = getattr(control, "jacobian", None)
    return jacobian if callable(jacobian) else None


def forces_by_state(jacobian: ControlJacobian, t: float, q: Array, v: Array) -> Array:
    """Evaluate a `jacobian`, and check its shape (nv, 2 nv) and values."""
    found = returned("jacobian", f"at t = {t:.6g} s", jacobian, t, q.copy(), v.copy())
    return finite_array("jacobian", found, (len(v), 2 * len(v)))


def change_of_forces(scene: Scene, h: float, t: float, state: tuple[Array, Array], x: Array) -> Array:
    """Return the change (nv, n) of the forces of a control that is a function with a `jacobian`.

    Args:
        scene: The scene of the control.
        h: Step size [s]; differences in time use a small fraction of it.
        t: Time [s].
        state: (nq,) configuration and (nv,) velocity.
        x: (2 nv + 1, n) changes of q, in the tangent space, of v, and of the time.
    """
    jacobian, control = jacobian_of(scene), scene.control
    assert jacobian is not None
    assert callable(control)
    found = forces_by_state(jacobian, t, *state) @ x[:-1]
    if x[-1].any():
        first, last = (asked(control, t + s * h, *state) for s in (-LITTLE, LITTLE))
        found += np.outer(last - first, x[-1]) / (2.0 * LITTLE * h)
    return found


class HeldForces:
    """Forces of a sampled control along a motion, and their changes (nv, n)."""

    def __init__(self, control: SampledControl, jacobian: ControlJacobian) -> None:
        self._control, self._jacobian = control, jacobian
        self._changes: list[Array] = []

    def ask(self, t: float, q: Array, v: Array, x: Array) -> None:
        """Store the change of the force if the control was evaluated at t [s], for changes x (2 nv, n)."""
        asked = self._control.asked_at
        if len(self._changes) < len(asked) and asked[len(self._changes)] == t:
            self._changes.append(forces_by_state(self._jacobian, t, q, v) @ x)

    @property
    def times(self) -> list[float]:
        """The times at which the control is evaluated or a force begins to act [s]."""
        return [*self._control.asked_at, *self._control.acts_at]

    def begins(self, t: float) -> bool:
        """Return whether a force begins to act at a time [s]."""
        k = self._number(t)
        return k >= 0 and self._control.acts_at[k] == t

    def at(self, t: float) -> tuple[Array, Array] | None:
        """Return the force (nv,) that acts from t [s] on, and its change (nv, n); None before the first."""
        k = self._number(t)
        return None if k < 0 else (self._control.forces[k], self._changes[k])

    def _number(self, t: float) -> int:
        return bisect_right(self._control.acts_at, t) - 1
