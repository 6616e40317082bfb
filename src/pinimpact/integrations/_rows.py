"""Impacts of many rows and their derivatives, as functions of NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..contact_space.batch import solve_impacts
from ..contact_space.laws import law_code
from ..errors import InputError
from ..robot.batch import impacts
from ..robot.contact import Contact, check_contact, check_held
from ..robot.derivatives import impact_derivatives
from ..robot.names import free_velocities, model_of
from ..scene.joint_charts import coordinate_rates, joint_table

Of = TypeVar("Of")


def refuse_single_precision(kind: Any, name: str, remedy: str) -> None:
    """Raise `InputError` if the dtype of an argument is not float64."""
    if "float64" not in str(kind):
        raise InputError(f"{name}: {kind} given, double precision expected; {remedy}", value=kind)


class ContactRows:
    """v⁺ (…, 3) and P (…, 3) of impacts in contact space, from W (…, 3, 3), v° (…, 3), μ (…) and e (…)."""

    names = ("delassus", "velocity", "friction", "restitution")
    inputs = (2, 1, 0, 0)  # number of axes of one row of each

    def __init__(self, law: str) -> None:
        law_code(law)  # raises an error for an unknown law here instead of in a callback
        self.law = law

    def outputs(self, shapes: Sequence[tuple[int, ...]]) -> tuple[int, int]:
        """Return the lengths of v⁺ and P; raise `InputError` for wrong shapes of W and v°."""
        _check_shapes(self.names, shapes, ((3, 3), (3,), (), ()))
        return 3, 3

    def values(self, *given: Array) -> tuple[Array, ...]:
        """Return v⁺ and P."""
        lead, (w, v, mu, e) = _rows(given, self.inputs)
        batch = solve_impacts(w, v, mu, e, self.law)
        return _reshaped((batch.velocity, batch.impulse), lead)

    def slopes(self, *given: Array) -> tuple[Array, ...]:
        """Return v⁺ and P, the derivatives of v⁺ with respect to each argument, and those of P."""
        lead, (w, v, mu, e) = _rows(given, self.inputs)
        batch = solve_impacts(w, v, mu, e, self.law, derivatives=True)
        d = batch.derivatives
        assert d is not None
        of_v = d.dv_ddelassus, d.dv_dv, d.dv_dfriction, d.dv_drestitution
        of_impulse = d.dP_ddelassus, d.dP_dv, d.dP_dfriction, d.dP_drestitution
        return _reshaped((batch.velocity, batch.impulse, *of_v, *of_impulse), lead)


class RobotRows:
    """v⁺ (…, nv) of a robot's impacts at a contact, from q (…, nq), v (…, nv), μ (…) and e (…).

    If `own` is true, the restitution of the contact, which may be a function e(v), replaces the argument e.
    """

    names = ("q", "v", "friction", "restitution")
    inputs = (1, 1, 0, 0)

    def __init__(
        self,
        model: pin.Model,
        data: pin.Data,
        contact: Contact,
        own: bool,
        held: Sequence[Contact],
        locked: Sequence[str | int],
    ) -> None:
        check_contact("contact", contact)  # raises errors here instead of in a callback
        self.model, self.data, self.contact, self.own = model_of(model), data, contact, own
        free_velocities(self.model, locked)
        self.options: dict[str, Any] = {"held": check_held(held), "locked": locked}
        self.table = joint_table(self.model)

    def coefficients(self, friction: Any, restitution: Any) -> tuple[Any, Any]:
        """Return μ and e as given, or those of the contact, with 0 for a function e(v)."""
        mu = self.contact.friction if friction is None else friction
        if not self.own:
            return mu, restitution
        return mu, 0.0 if callable(self.contact.restitution) else self.contact.restitution

    def outputs(self, shapes: Sequence[tuple[int, ...]]) -> tuple[int]:
        """Return the length of v⁺; raise `InputError` for wrong lengths of q and v."""
        _check_shapes(self.names, shapes, ((self.model.nq,), (self.model.nv,), (), ()))
        return (self.model.nv,)

    def values(self, *given: Array) -> tuple[Array, ...]:
        """Return v⁺, NaN for rows without a solution."""
        lead, (q, v, mu, e) = _rows(given, self.inputs)
        restitution = None if self.own else e
        hits = impacts(self.model, self.data, q, v, self.contact, mu, restitution, **self.options)
        return _reshaped((hits.v,), lead)

    def slopes(self, *given: Array) -> tuple[Array, ...]:
        """Return v⁺ and its derivatives with respect to q, v, μ and e; NaN for rows without a solution."""
        lead, rows = _rows(given, self.inputs)
        count, nq, nv = len(rows[0]), self.model.nq, self.model.nv
        shapes = (nv,), (nv, nq), (nv, nv), (nv,), (nv,)
        found = tuple(np.full((count, *shape), np.nan) for shape in shapes)
        solved = np.isfinite(self.values(*rows)[0]).all(axis=1)
        for i in np.flatnonzero(solved).tolist():
            q, v, mu, e = (row[i] for row in rows)
            restitution = self.contact.restitution if self.own else float(e)
            contact = replace(self.contact, friction=float(mu), restitution=restitution)
            d = impact_derivatives(self.model, self.data, q, v, contact, **self.options)
            rates = coordinate_rates(self.table, q, nv)
            # left inverse of the orthogonal columns: changes of q off the configuration space have no effect
            by_coordinates = d.dv_dq @ (rates / (rates**2).sum(axis=0)).T
            for out, value in zip(
                found, (d.v, by_coordinates, d.dv_dv, d.dv_dfriction, d.dv_drestitution), strict=True
            ):
                out[i] = value
        return _reshaped(found, lead)


class RowFunctions(Generic[Of]):
    """The functions of `pinimpact.integrations.jax` and `pinimpact.integrations.torch`.

    Args:
        call: Function that evaluates rows and their derivatives for arrays of the library.
    """

    def __init__(self, call: Callable[..., tuple[Of, ...]]) -> None:
        self._call = call

    def solve_impacts(
        self, delassus: Any, velocity: Any, friction: Any, restitution: Any, law: str = "poisson"
    ) -> tuple[Of, Of]:
        """Return v⁺ (..., 3) and P (..., 3) of impacts in contact space, by the method "exact".

        Args:
            delassus: (..., 3, 3) symmetric W [1/kg]; derivatives use the symmetric part of a change.
            velocity: (..., 3) contact velocities before the impact [m/s].
            friction: (...) coefficients μ.
            restitution: (...) coefficients e.
            law: Restitution law of all rows.

        Raises:
            InputError: Single precision, or wrong shapes.
            UnknownNameError: Unknown law.
        """
        after, impulse = self._call(ContactRows(law), delassus, velocity, friction, restitution)
        return after, impulse

    def impact(
        self,
        model: pin.Model,
        data: pin.Data,
        q: Any,
        v: Any,
        contact: Contact,
        friction: Any = None,
        restitution: Any = None,
        held: Sequence[Contact] = (),
        locked: Sequence[str | int] = (),
    ) -> Of:
        """Return the velocities (..., nv) of a robot after impacts.

        Derivatives with respect to q are those along the configuration space: a change of the length of a
        quaternion has no effect.

        Args:
            model: Pinocchio model, or a RobotWrapper.
            data: Its data, which are overwritten.
            q: (..., nq) configurations.
            v: (..., nv) velocities before the impact.
            contact: The contact that collides: a point or a sphere on a Plane or a Sphere.
            friction: (...) coefficients μ; None: that of the contact.
            restitution: (...) coefficients e; None: that of the contact.
            held: Contacts that hold during the impact, as in `impact_derivatives`.
            locked: Joints whose velocity the impact does not change.

        Raises:
            InputError: Single precision, wrong shapes, or a contact without derivatives.
            UnknownNameError: A joint in `locked` that the model does not have.
        """
        rows = RobotRows(model, data, contact, restitution is None, held, locked)
        (after,) = self._call(rows, q, v, *rows.coefficients(friction, restitution))
        return after


def _check_shapes(
    names: Sequence[str], shapes: Sequence[tuple[int, ...]], expected: Sequence[tuple[int, ...]]
) -> None:
    leads = []
    for name, shape, own in zip(names, shapes, expected, strict=True):
        leads.append(tuple(shape[: len(shape) - len(own)]))
        if tuple(shape[len(leads[-1]) :]) != own:
            text = ", ".join(map(str, own))
            raise InputError(f"{name}: shape {tuple(shape)} given, (..., {text}) expected", value=shape)
    try:
        np.broadcast_shapes(*leads)
    except ValueError:
        given = ", ".join(f"{name} {lead}" for name, lead in zip(names, leads, strict=True))
        raise InputError(f"{names[0]}: leading shapes {given} given, a common one expected") from None


def _rows(given: Sequence[Array], axes: Sequence[int]) -> tuple[tuple[int, ...], list[Array]]:
    """Return the common leading shape of the arguments, and the arguments with one leading axis."""
    arrays = [np.asarray(array, dtype=np.float64) for array in given]
    shapes = [array.shape[: array.ndim - n] for array, n in zip(arrays, axes, strict=True)]
    lead = np.broadcast_shapes(*shapes)
    rows = []
    for array, n in zip(arrays, axes, strict=True):
        own = array.shape[array.ndim - n :]
        rows.append(np.ascontiguousarray(np.broadcast_to(array, lead + own)).reshape(-1, *own))
    return lead, rows


def _reshaped(arrays: Sequence[Array], lead: tuple[int, ...]) -> tuple[Array, ...]:
    return tuple(np.reshape(array, lead + array.shape[1:]) for array in arrays)
