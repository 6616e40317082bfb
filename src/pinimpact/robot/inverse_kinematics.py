"""Configurations at which contacts touch their surfaces, near a given one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from .._numeric.tolerances import HALF_DIGITS, RANK, ROUNDING
from ..arrays import Array
from ..checks import as_tuple
from ..errors import InputError
from .contact import Contact, check_contact
from .data_cache import checked_configuration, data_cache
from .joint_limits import bounds, degrees_hint
from .matrices import contact_geometry
from .names import model_of

MAX_STEPS = 100
SHORTEST_PART = 0.01
"""Smallest fraction of a Gauss–Newton step in the line search."""
LONGEST_STEP = 0.5
"""Largest change of a coordinate in one step, except for the position of a free base, in which the problem is
linear."""
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
    distance from q (`pinocchio.difference`, in metres and radians), found by Gauss–Newton steps.

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
        self._longest = np.full(model.nv, LONGEST_STEP)
        for joint in range(1, model.njoints):
            at, place, count = model.idx_vs[joint], model.idx_qs[joint], model.nvs[joint]
            if model.nqs[joint] == count:
                here = q[place : place + count]
                self._lower[at : at + count] = self._bounds[0, place : place + count] - here
                self._upper[at : at + count] = self._bounds[1, place : place + count] - here
            elif model.joints[joint].shortname() == "JointModelFreeFlyer":
                self._longest[at : at + 3] = np.inf

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
            gaps, rows, _ = self._gaps(found.x)
            step = self._least_norm(rows, rows @ found.x - gaps, 0.0) - found.x
            if float(np.abs(step).max()) <= HALF_DIGITS:
                break
            part, distance = 1.0, float(np.linalg.norm(found.x))
            while part >= SHORTEST_PART:
                closer = self.close(np.clip(found.x + part * step, self._lower, self._upper))
                if closer.closed and float(np.linalg.norm(closer.x)) < distance:
                    break
                part *= 0.25
            else:
                break
            found = closer
        return found

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
            step = self._least_norm(rows, rows @ x - gaps, x) - x
            step /= max(1.0, float(np.max(np.abs(step) / self._longest)))
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

    def _least_norm(self, rows: Array, wanted: Array, centre: Array | float) -> Array:
        """Return the x within its bounds closest to a centre with rows x = wanted, by least squares."""
        x = np.clip(centre + np.zeros(len(self._lower)), self._lower, self._upper)
        free = np.ones(len(x), dtype=bool)
        for _ in range(len(x)):
            start = (centre + np.zeros(len(x)))[free]
            rest = wanted - rows[:, ~free] @ x[~free] - rows[:, free] @ start
            x[free] = start + np.linalg.lstsq(rows[:, free], rest, rcond=RANK)[0]
            beyond = (x < self._lower) | (x > self._upper)
            if not beyond.any():
                break
            x = np.clip(x, self._lower, self._upper)
            free &= ~beyond
            if not free.any():
                break
        return x
