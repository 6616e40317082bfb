"""Matrices of a contact of a robot at a configuration: Jacobian, mass matrix, Delassus matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import Array
from ..contact_space.inputs import FACTOR, triangle_of
from ..display import in_a_line
from ._kernels import contact_kinematics
from ._kernels.delassus_factor import delassus_factor
from ._kernels.responses import half_solve, respond
from .contact import Contact, check_contact, check_held
from .names import Stiffening, mobilities, model_of, singular_mass
from .placed_robot import ContactGeometry, PlacedRobot

_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ContactMatrices(ContactGeometry):
    """The matrices of a robot at one contact; M Δq̇ = [K h] P for an impulse P in contact axes.

    Attributes, in addition to those of `ContactGeometry`:
        mass: (nv, nv) M, with rotor inertia, of free joints.
        delassus: (3, 3) W, with held contacts, and locked and stiffened joints [1/kg].
        response: (nv, 3) Δq̇ per unit impulse in contact axes, M⁻¹Jᵀ, under the same constraints.
        held: Geometry of each held contact.
        held_response: (k, 3, 3) impulse on each held contact (world axes) per impulse in contact axes.
        factor: (3, 3) lower triangular C with W = CCᵀ, see `ImpactProblem`; None with held contacts.
        factor_scale: Size of the terms that the factor is the sum of.
    """

    mass: Array
    delassus: Array
    response: Array
    held: tuple[ContactGeometry, ...]
    held_response: Array
    factor: Array | None
    factor_scale: float | None

    def __repr__(self) -> str:
        return f"ContactMatrices(gap={self.gap:.6g}, delassus={in_a_line(self.delassus)})"


def contact_geometry(model: pin.Model, data: pin.Data, q: ArrayLike, contact: Contact) -> ContactGeometry:
    """Return position and Jacobian of a contact. Arguments, Data and errors as in `contact_matrices`."""
    check_contact("contact", contact)
    return PlacedRobot(model, data, q).geometry(contact)


def contact_matrices(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    contact: Contact,
    held: Sequence[Contact] = (),
    locked: Sequence[str | int] = (),
    stiffening: Stiffening = None,
) -> ContactMatrices:
    """Return the matrices of a contact at a configuration.

    Args:
        model: Pinocchio model, or a RobotWrapper.
        data: Its data. Changes ``data.M``, ``data.J``, ``data.oMi`` and the other fields that
            ``pin.crba`` and ``pin.computeJointJacobians`` write; ``data.oMf`` is updated only for the
            frames of the contacts.
        q: (nq,) configuration.
        contact: The contact at which the impulse acts.
        held: Contacts whose points cannot move relative to their surfaces: three bilateral rows each,
            projected out of M⁻¹. One holds a standing point foot; with ``Plane(body=…)`` it closes a loop;
            three that are not in line make a grasp. Rows may be redundant: the impulses of least norm are
            returned.
        locked: Joints, by name or id, whose velocity cannot change.
        stiffening: Of joints by control, from 0 (free) to 1 (locked), see `impact`.

    Raises:
        InputError: A q of the wrong length, not finite, or not normalised; an invalid stiffening.
        UnknownNameError: A frame or joint that the model does not have.
        ModelError: The mass matrix is not positive definite.
    """
    check_contact("contact", contact)
    placed, anchors, mobility = _placed(model, data, q, held, locked, stiffening)
    mass = placed.mass_matrix()
    geometry = placed.geometry(contact)
    columns, signs = placed.columns(contact)
    rows = np.empty((3, len(signs)))
    contact_kinematics.jacobian_by_axes(columns, signs, geometry.point, geometry.axes.ravel(), rows)
    delassus, response, held_response, lower, y = _responses(placed, mass, rows, anchors, mobility)
    factor = scale = None
    if not anchors:
        numbers = np.empty(FACTOR)
        x1, x2, x3 = geometry.point.tolist()
        delassus_factor(lower, placed.cache.parents, columns * mobility, signs, x1, x2, x3, y, numbers)
        factor, scale = triangle_of(numbers), float(numbers[-1])
    return ContactMatrices(
        geometry.point,
        geometry.gap,
        geometry.axes,
        rows[:2].T,
        rows[2],
        geometry.surface_velocity,
        mass,
        delassus,
        response,
        anchors,
        held_response,
        factor,
        scale,
    )


class ManyMatrices(NamedTuple):
    """The matrices of a robot at n contacts; M Δq̇ = Jᵀ P for impulses P (3n,) in their axes."""

    axes: Array  # (k, 3, 3) t₁, t₂, n as rows, in world axes, of the k contacts; not of joint rows
    jacobian: Array  # (3n, nv) J
    surface_velocity: Array  # (n, 3) of the surfaces, see `ContactGeometry`
    delassus: Array  # (3n, 3n) W, with held contacts, and locked and stiffened joints [1/kg]
    response: Array  # (nv, 3n) Δq̇ per unit impulse
    held: tuple[ContactGeometry, ...]  # geometry of each held contact
    held_response: Array  # (h, 3, 3n) impulse on each held contact (world axes) per impulse

    def velocity(self, v: ArrayLike) -> Array:
        """Return the (n, 3) contact velocities [m/s]."""
        return (self.jacobian @ np.asarray(v, dtype=np.float64)).reshape(-1, 3) - self.surface_velocity

    def velocity_scale(self, v: Array) -> float:
        """Return the size of the terms that `velocity` is the sum of, Σ|J||q̇| + |v_surface| [m/s]."""
        return float(np.sum(np.abs(self.jacobian) @ np.abs(v)) + np.abs(self.surface_velocity).sum())


def many_matrices(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    contacts: Sequence[Contact],
    held: Sequence[Contact] = (),
    locked: Sequence[str | int] = (),
    stiffening: Stiffening = None,
) -> ManyMatrices:
    """Return the matrices of n contacts at a configuration; other arguments as in `contact_matrices`."""
    placed, anchors, mobility = _placed(model, data, q, held, locked, stiffening)
    return checked_matrices(placed, contacts, anchors, mobility, np.zeros((0, len(mobility))))


def _placed(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    held: Sequence[Contact],
    locked: Sequence[str | int],
    stiffening: Stiffening,
) -> tuple[PlacedRobot, tuple[ContactGeometry, ...], Array]:
    """Return the robot, the geometry of the held contacts, and the mobilities (nv,) of the velocities."""
    mobility = mobilities(model_of(model), locked, stiffening)
    held = check_held(held)
    placed = PlacedRobot(model, data, q)
    return placed, tuple(placed.geometry(anchor) for anchor in held), mobility


def checked_matrices(
    placed: PlacedRobot,
    contacts: Sequence[Contact],
    anchors: tuple[ContactGeometry, ...],
    mobility: Array,
    stops: Array,
    on_surface: bool = False,
) -> ManyMatrices:
    """Return the matrices of n contacts and of joint stops, for checked arguments.

    `anchors` are held contacts, `mobility` (nv,) is that of `mobilities`. Rows `stops` (m, nv) of joint stops
    become contacts without tangential directions. For `on_surface` see `contact_kinematics.jacobian`.
    """
    mass = placed.mass_matrix()
    k, n = len(contacts), len(contacts) + len(stops)
    jacobian, geometry = np.zeros((3 * n, len(mobility))), np.zeros((n, 12))
    for i, contact in enumerate(contacts):
        geometry[i] = placed.fill_jacobian(contact, jacobian[3 * i : 3 * i + 3], on_surface)
    jacobian[3 * k + 2 :: 3] = stops
    delassus, response, held_response, _, _ = _responses(placed, mass, jacobian, anchors, mobility)
    axes = geometry[:k, :9].reshape(k, 3, 3)
    return ManyMatrices(axes, jacobian, geometry[:, 9:], delassus, response, anchors, held_response)


def _responses(
    placed: PlacedRobot, mass: Array, jacobian: Array, anchors: Sequence[ContactGeometry], mobility: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Return W (m, m), the responses of q̇ (nv, m) and of held contacts (k, 3, m), L (nv, nv) and Y (m, nv).

    They are for rows (m, nv) of a Jacobian, under the constraints of held contacts `anchors` and of
    `mobility`.
    """
    m, nv = jacobian.shape
    parents = placed.cache.parents
    y, lower = jacobian.copy(), np.empty((nv, nv))
    held_response = np.zeros((0, 3, m))
    if anchors:
        y = np.vstack([jacobian, *(anchor.axes.T @ anchor.jacobian for anchor in anchors)])
    stopped = half_solve(mass, parents, mobility, lower, y)
    if stopped >= 0:
        raise singular_mass(placed.model, stopped)
    if anchors:
        y, impulses = _project_out(y[m:], y[:m])
        held_response = impulses.reshape(-1, 3, m)
    delassus, response = np.empty((m, m)), np.empty((m, nv))
    respond(lower, parents, mobility, y, delassus, response)
    return delassus, response.T, held_response, lower, y


def _rounding(rows: Array) -> float:
    """Return the relative size of singular values of `rows` that are rounding."""
    return 32.0 * _EPS * max(rows.shape)


def independent(rows: Array) -> tuple[Array, Array, Array]:
    """Return the singular value decomposition of rows, without singular values that are rounding."""
    left, sizes, right = np.linalg.svd(rows, full_matrices=False)
    above = sizes > _rounding(rows) * sizes[0]
    return left[:, above], sizes[above], right[above]


def _project_out(anchored: Array, y: Array) -> tuple[Array, Array]:
    """Project the rows of `anchored` (k, nv) out of the rows of `y` (m, nv), both L⁻ᵀ of rows of Jacobians.

    Returns:
        The projected y (m, nv), with singular values within rounding set to zero, and the impulses (k, m) of
        least norm on the anchored rows.
    """
    tolerance = _rounding(anchored)
    left, sizes, right = independent(anchored)
    balanced = right @ y.T
    impulses = -left @ (balanced / sizes[:, None])
    rest = y - balanced.T @ right
    rest -= (rest @ right.T) @ right
    axes, lengths, directions = np.linalg.svd(rest, full_matrices=False)
    lengths = np.where(lengths > tolerance * np.linalg.norm(y), lengths, 0.0)
    return (axes * lengths) @ directions, impulses
