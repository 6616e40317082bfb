"""One-sided derivatives of the impact of a robot. (docs/derivatives.md, 6)"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..contact_space.one_sided import fill_one_sided
from ..errors import PinimpactError
from ..geometry.plane import Plane
from ..geometry.sphere import Sphere
from ._kernels.impact_slopes import FRICTION, RESTITUTION, SURFACE
from .contact import Contact


def fill_one_sided_of_robot(
    block: Array,
    side: int,
    model: pin.Model,
    q: Array,
    v: Array,
    contact: Contact,
    evaluate: Callable[[Array, Array, Contact], Array],
) -> None:
    """Replace columns of NaN in the derivatives of an impact by their one-sided limits, to `side` 1 or −1.

    `block` (nv + 3, 2 nv + 9) is that of `ImpactDerivatives` at q (nq,) and v (nv,); `evaluate` returns it
    for other values of q, v and contact.
    """
    nv, plane, mu, speed = len(v), contact.plane, contact.friction, float(np.linalg.norm(v))
    sizes = np.concatenate([np.ones(nv), np.full(nv + 6, speed), [mu if mu > 0.0 else 1.0, 1.0]])
    if not isinstance(plane, (Plane, Sphere)):
        sizes[2 * nv + SURFACE : 2 * nv + FRICTION] = 0.0
    if callable(contact.restitution):
        sizes[2 * nv + RESTITUTION] = 0.0

    def moved(k: int, h: float) -> tuple[Array, Array] | None:
        e = np.zeros(len(sizes))
        e[k] = h
        by_q, by_v, by_surface, by_mu, by_e = np.split(e, np.array([0, nv, nv + 6, nv + 7]) + nv)
        now: dict[str, Any] = {}
        if by_surface.any():
            moving, spin = plane.velocity + by_surface[:3], plane.angular_velocity + by_surface[3:]
            now["plane"] = replace(plane, velocity=tuple(moving), angular_velocity=tuple(spin))  # type: ignore[type-var]
        if by_mu[0] != 0.0:
            now["friction"] = mu + by_mu[0]
        if by_e[0] != 0.0:
            now["restitution"] = contact.restitution + by_e[0]
        try:
            found = evaluate(pin.integrate(model, q, by_q), v + by_v, replace(contact, **now))
        except PinimpactError:
            return None
        return found[:, -1], found[:, k]

    fill_one_sided(block[:, :-1], block[:, -1], sizes, side, moved)
