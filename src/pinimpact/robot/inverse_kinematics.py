"""Configurations at which contacts touch their surfaces, near a given one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from .._numeric.tolerances import HALF_DIGITS, LITTLE, RANK, ROUNDING
from ..arrays import Array
from ..checks import as_tuple
from ..errors import InputError
from .contact import Contact, check_contact
from .data_cache import checked_configuration, data_cache
from .forest import joint_jacobian
from .joint_limits import bounds, degrees_hint
from .matrices import contact_geometry
from .names import model_of

MAX_STEPS = 100
SHORTEST_PART = 0.01
"""Smallest fraction of a step in the line search."""
LONGEST_STEP = 0.5
"""Largest change of an angle in one step [rad]; in coordinates that only translate gaps are about linear."""
APART = 1e-4
"""Distance of derivatives whose difference is the second derivative [rad or m]: `pinocchio.dIntegrate` has
errors of 10⁻¹⁰ of the distance at angles of a milliradian."""
LEAST_BEND = LITTLE
"""Least second derivative, relative to that of the distance alone, by which a step is divided."""
STARTS = 8
"""Number of searches, from increasing distances, until one ends with contact."""


class _Found(NamedTuple):
    """State of a search: the displacement (nv,) from the given configuration, and the largest gap."""

    x: Array
    gap: float
    contact: Contact
    closed: bool


def place_in_contact(
    model: pin.Model, data: pin.Data, q: ArrayLike, contacts: Contact | Sequence[Contact]
) -> Array:
    """Return a configuration near q in which all contacts touch their surfaces.

    Among the configurations with zero gaps and joints within their limits, it is a local minimum of the
    distance from q (`pinocchio.difference`, in metres and radians), found by Newton steps.

    Args:
        model: Pinocchio model, or a RobotWrapper.
        data: Its data; `contact_matrices` lists the fields that change.
        q: (nq,) configuration to stay close to. A joint outside its limits is moved within them.
        contacts: One or several; their surfaces can be attached to bodies. Feet of a free base can be
            placed on the ground together.

    Returns:
        (nq,) with gaps of rounding size.

    Raises:
        InputError: No such configuration is found; the message has the remaining gap. No contacts, or a
            q of the wrong length, not finite or not normalised.
        UnknownNameError: A frame that the model does not have.

    Warns:
        JointLimitWarning: An angle of q looks like degrees; given once for each Data.
    """
    model = model_of(model)
    cache = data_cache(model, data)
    given = checked_configuration(cache, model, q)
    low, high = cache.bounds
    if any(degrees_hint(at) for at in given[(given < low) | (given > high)]):
        cache.warn_of_limits(given, stacklevel=3)
    wanted = as_tuple("contacts", contacts, (Contact, str), "a Contact")
    if not wanted:
        raise InputError("contacts: none given, at least one expected", value=contacts)
    for contact in wanted:
        check_contact("contacts", contact)
    search = _Search(model, data, given, wanted)
    random = np.random.default_rng(0)
    best = search.run(np.zeros(model.nv))
    for k in range(1, STARTS):
        if best.closed:
            break
        again = search.run(random.normal(scale=2.0 * k / STARTS, size=model.nv))
        if again.closed or again.gap < best.gap:
            best = again
    if not best.closed:
        best = search.run(search.nearest(best.x))
    if not best.closed:
        what = f"{best.contact.label!r} cannot be brought onto its surface"
        if len(wanted) > 1:
            what = f"the {len(wanted)} contacts cannot be brought onto their surfaces together"
        raise InputError(
            f"contacts: {what} from this q within the joint limits: a gap of {best.gap:.3g} m "
            f"remains{f' at {best.contact.label!r}' if len(wanted) > 1 else ''}; start closer, or "
            "move the surface",
            value=best.gap,
        )
    return search.configuration(best.x)


def closed_by_rounding(model: pin.Model, data: pin.Data, q: Array, contacts: Sequence[Contact]) -> Array:
    """Return q with contacts on their surfaces if they are off by rounding, whatever the joint limits."""
    search = _Search(model, data, q, contacts, limited=False)
    return search.configuration(search.close(np.zeros(model.nv)).x)


class _Search:
    """The search from one configuration; displacements x (nv,) are from there."""

    def __init__(
        self, model: pin.Model, data: pin.Data, q: Array, contacts: Sequence[Contact], limited: bool = True
    ) -> None:
        self._model = model
        self._data = data
        self._q = q
        self._contacts = contacts
        self._bounds = bounds(model) if limited else np.outer([-np.inf, np.inf], np.ones(model.nq))
        self._lower, self._upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
        self._turns = joint_jacobian(model, data, q)[3:].any(axis=0)
        for joint in range(1, model.njoints):
            at, place, count = model.idx_vs[joint], model.idx_qs[joint], model.nvs[joint]
            if model.nqs[joint] == count:
                here = q[place : place + count]
                self._lower[at : at + count] = self._bounds[0, place : place + count] - here
                self._upper[at : at + count] = self._bounds[1, place : place + count] - here

    def configuration(self, x: Array) -> Array:
        """Return q displaced by x, within the limits of its joints."""
        q = pin.integrate(self._model, self._q, x)
        return np.clip(q, *self._bounds)  # rounding may violate the limits

    def run(self, x: Array) -> _Found:
        """Close the gaps from a displacement, then reduce the displacement and keep them closed."""
        found = self.close(np.clip(x, self._lower, self._upper))
        if not found.closed:
            return found
        for _ in range(MAX_STEPS):
            step = self._shortening(found.x)
            part, longest = 1.0, (1.0 + ROUNDING) * float(np.linalg.norm(found.x))
            while part >= SHORTEST_PART:
                closer = self.close(np.clip(found.x + part * step, self._lower, self._upper))
                if closer.closed and float(np.linalg.norm(closer.x)) <= longest:
                    break
                part *= 0.25
            else:
                break
            found = closer
            if float(np.abs(step).max()) <= HALF_DIGITS:  # then the next one is rounding
                break
        return found

    def _shortening(self, x: Array) -> Array:
        """Return a step (nv,) of Newton's method from a displacement with zero gaps to the least one.

        It is reversed along directions in which the distance bends downwards, as at a maximum.
        """
        gaps, rows, _ = self._gaps(x)
        free = (x > self._lower) & (x < self._upper)
        forces = np.linalg.lstsq(rows[:, free].T, x[free], rcond=RANK)[0]
        _, sizes, axes = np.linalg.svd(rows)
        along = axes[np.count_nonzero(sizes > RANK * sizes.max(initial=0.0)) :]
        turned = [(self._gaps(x + APART * axis)[1] - rows).T @ forces / APART for axis in along]
        bent = np.eye(len(along)) - np.reshape(turned, along.shape) @ along.T
        bends, mixed = np.linalg.eigh(0.5 * (bent + bent.T))
        along, bends = mixed.T @ along, np.maximum(np.abs(bends), LEAST_BEND)
        metric = np.eye(len(x)) + (along.T * (bends - 1.0)) @ along
        centre = along.T @ ((1.0 - 1.0 / bends) * (along @ x))
        return self._least_norm(rows, rows @ x - gaps, centre, metric) - x

    def nearest(self, x: Array) -> Array:
        """Return the displacement that minimizes the sum of the squares of the gaps, from a start."""
        from scipy.optimize import least_squares

        found: Array = least_squares(
            lambda x: self._gaps(x)[0],
            np.clip(x, self._lower, self._upper),
            lambda x: self._gaps(x)[1],
            bounds=(self._lower, np.maximum(self._upper, np.nextafter(self._lower, np.inf))),
        ).x
        return found

    def close(self, x: Array) -> _Found:
        """Close the gaps by the shortest steps, shortened if the gaps do not decrease."""
        gaps, rows, size = self._gaps(x)
        for _ in range(MAX_STEPS):
            worst = float(np.abs(gaps).max())
            if worst <= ROUNDING * size:
                break
            scale = np.where(self._turns, 1.0, max(1.0, worst / LONGEST_STEP))  # translations close far gaps
            step = self._least_norm(rows, rows @ x - gaps, x, np.diag(scale**-2)) - x
            step /= max(1.0, float(np.abs(step[self._turns]).max(initial=0.0)) / LONGEST_STEP)
            part = 1.0
            while part >= SHORTEST_PART:
                trial = np.clip(x + part * step, self._lower, self._upper)
                there = self._gaps(trial)
                if float(np.abs(there[0]).max()) <= (1.0 - 0.1 * part) * worst:
                    break
                part *= 0.25
            else:
                break
            x, (gaps, rows, size) = trial, there
        i = int(np.argmax(np.abs(gaps)))
        gap = float(abs(gaps[i]))
        return _Found(x, gap, self._contacts[i], gap <= 10.0 * ROUNDING * size)

    def _gaps(self, x: Array) -> tuple[Array, Array, float]:
        """Return gaps (n,), their derivative with respect to x (n, nv), and the size for rounding [m]."""
        model, q = self._model, self.configuration(x)
        found = [contact_geometry(model, self._data, q, contact) for contact in self._contacts]
        moved = pin.dIntegrate(model, self._q, x, pin.ArgumentPosition.ARG1)
        gaps = np.array([geometry.gap for geometry in found])
        size = 1.0 + max(float(np.abs(geometry.point).max()) for geometry in found)
        return gaps, np.array([geometry.h for geometry in found]) @ moved, size

    def _least_norm(self, rows: Array, wanted: Array, centre: Array, metric: Array) -> Array:
        """Return the x within its bounds closest to a centre with rows x = wanted, by least squares.

        The square of the distance is that of a metric (nv, nv).
        """
        x = np.clip(centre, self._lower, self._upper)
        free = np.ones(len(x), dtype=bool)
        for _ in range(len(x)):
            root = np.linalg.cholesky(metric[np.ix_(free, free)])
            pulled = np.linalg.solve(root, metric[np.ix_(free, ~free)] @ (centre - x)[~free])
            scaled = np.linalg.solve(root, rows[:, free].T).T
            rest = wanted - rows[:, ~free] @ x[~free] - rows[:, free] @ centre[free] - scaled @ pulled
            moved = pulled + np.linalg.lstsq(scaled, rest, rcond=RANK)[0]
            x[free] = centre[free] + np.linalg.solve(root.T, moved)
            beyond = (x < self._lower) | (x > self._upper)
            if not beyond.any():
                break
            x = np.clip(x, self._lower, self._upper)
            free &= ~beyond
            if not free.any():
                break
        return x
