"""Matrices of a contact of a robot at a configuration: Jacobian, mass matrix, Delassus matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..contact_space.inputs import FACTOR, triangle_of
from ..display import in_a_line
from ._kernels import contact_kinematics
from ._kernels.delassus_factor import delassus_factor
from ._kernels.responses import half_solve, respond
from .contact import WORLD, Contact, check_contact, check_held
from .data_cache import DataCache, checked_configuration, data_cache
from .forest import frame_placement, mass_matrix
from .names import free_velocities, model_of, singular_mass
from .pinocchio_bridge import contact_columns

Array = NDArray[np.float64]
_EPS = float(np.finfo(float).eps)
_WORLD = pin.Convention.WORLD


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ContactGeometry:
    """Position, axes and Jacobian of a contact.

    Attributes:
        point: (3,) contact point in world axes [m].
        gap: Signed distance of the point from the surface [m].
        axes: (3, 3) contact axes t₁, t₂, n as rows, in world axes.
        K: (nv, 2) tangential columns of Jᵀ.
        h: (nv,) normal column of Jᵀ.
        surface_velocity: (3,) velocity of the surface relative to its body, at the contact point, in contact
            axes [m/s].
    """

    point: Array
    gap: float
    axes: Array
    K: Array
    h: Array
    surface_velocity: Array

    def __repr__(self) -> str:
        return f"ContactGeometry(point={in_a_line(self.point)}, gap={self.gap:.6g})"

    @property
    def jacobian(self) -> Array:
        """(3, nv) J = [K h]ᵀ: velocity of the point relative to the surface's carrier, in contact axes."""
        return np.column_stack([self.K, self.h]).T

    def velocity(self, v: ArrayLike) -> Array:
        """Return the (3,) contact velocity J q̇ − v_surface in contact axes [m/s]."""
        return self.jacobian @ np.asarray(v, dtype=np.float64) - self.surface_velocity

    def velocity_scale(self, v: ArrayLike) -> float:
        """Return the size of the terms that `velocity` is the sum of, Σ|J||q̇| + |v_surface| [m/s]."""
        moving = np.abs(self.jacobian) @ np.abs(np.asarray(v, dtype=np.float64))
        return float(np.sum(moving + np.abs(self.surface_velocity)))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ContactMatrices(ContactGeometry):
    """The matrices of a robot at one contact; M Δq̇ = [K h] P for an impulse P in contact axes.

    Attributes, in addition to those of `ContactGeometry`:
        mass: (nv, nv) M, with rotor inertia.
        delassus: (3, 3) W, with held contacts and locked joints [1/kg].
        response: (nv, 3) Δq̇ per unit impulse in contact axes: M⁻¹Jᵀ, with held contacts and locked joints.
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
    model = model_of(model)
    cache = data_cache(model, data)
    q = checked_configuration(cache, model, q)
    check_contact("contact", contact)
    cache.joint_jacobian(model, data, q)
    kinematic = kinematics(model, data, q, cache, contact)
    rows = np.empty((3, cache.nv))
    geometry = np.array(contact_kinematics.jacobian(*kinematic, contact.constants, rows))
    gap, _, _, _, *point = contact_kinematics.locate(*kinematic[:2], contact.constants)
    numbers = geometry[:9].reshape(3, 3), rows[:2].T, rows[2], geometry[9:]
    return ContactGeometry(np.array(point), gap, *numbers)


def contact_matrices(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    contact: Contact,
    held: Sequence[Contact] = (),
    locked: Sequence[str | int] = (),
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

    Raises:
        InputError: A q of the wrong length, not finite, or not normalised.
        UnknownNameError: A frame or joint that the model does not have.
        ModelError: The mass matrix is not positive definite.
    """
    model = model_of(model)
    free = free_velocities(model, locked)
    held = check_held(held)
    geometry = contact_geometry(model, data, q, contact)
    anchors = tuple(contact_geometry(model, data, q, anchor) for anchor in held)
    cache = data_cache(model, data)
    at = np.asarray(q, dtype=np.float64)
    _, _, columns, signs = kinematics(model, data, at, cache, contact)
    columns = columns.copy(order="F")  # crba writes them
    mass = mass_matrix(model, data, at)
    rows = np.empty((3, cache.nv))
    axes = np.ascontiguousarray(geometry.axes).ravel()
    contact_kinematics.jacobian_by_axes(columns, signs, geometry.point, axes, rows)
    geometry = replace(geometry, K=rows[:2].T, h=rows[2])
    delassus, response, held_response, lower, y = _responses(model, cache, mass, rows, anchors, free)
    factor = scale = None
    if not anchors:
        numbers = np.empty(FACTOR)
        x1, x2, x3 = geometry.point.tolist()
        delassus_factor(lower, cache.parents, columns, signs * free, x1, x2, x3, y, numbers)
        factor, scale = triangle_of(numbers), float(numbers[-1])
    return ContactMatrices(
        point=geometry.point,
        gap=geometry.gap,
        axes=geometry.axes,
        K=geometry.K,
        h=geometry.h,
        surface_velocity=geometry.surface_velocity,
        mass=mass,
        delassus=delassus,
        response=response,
        held=anchors,
        held_response=held_response,
        factor=factor,
        factor_scale=scale,
    )


class ManyMatrices(NamedTuple):
    """The matrices of a robot at n contacts; M Δq̇ = Jᵀ P for impulses P (3n,) in their axes.

    Attributes:
        axes: (k, 3, 3) contact axes t₁, t₂, n as rows, in world axes; joint rows, which have none, come after
            the k contacts.
        jacobian: (3n, nv) J.
        surface_velocity: (n, 3) of the surfaces, see `ContactGeometry`.
        delassus: (3n, 3n) W, with held contacts and locked joints [1/kg].
        response: (nv, 3n) Δq̇ per unit impulse.
        held: Geometry of each held contact.
        held_response: (h, 3, 3n) impulse on each held contact (world axes) per impulse.
    """

    axes: Array
    jacobian: Array
    surface_velocity: Array
    delassus: Array
    response: Array
    held: tuple[ContactGeometry, ...]
    held_response: Array

    def velocity(self, v: ArrayLike) -> Array:
        """Return the (n, 3) contact velocities [m/s]."""
        return (self.jacobian @ np.asarray(v, dtype=np.float64)).reshape(-1, 3) - self.surface_velocity


def many_matrices(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    contacts: Sequence[Contact],
    held: Sequence[Contact] = (),
    locked: Sequence[str | int] = (),
) -> ManyMatrices:
    """Return the matrices of n contacts at a configuration.

    Args:
        model: As in `contact_matrices`.
        data: Likewise.
        q: (nq,) configuration.
        contacts: The contacts.
        held: Held contacts, see `contact_matrices`.
        locked: Joints whose velocity cannot change.
    """
    model = model_of(model)
    free = free_velocities(model, locked)
    held = check_held(held)
    cache = data_cache(model, data)
    q = checked_configuration(cache, model, q)
    anchors = tuple(contact_geometry(model, data, q, anchor) for anchor in held)
    return checked_matrices(model, data, q, contacts, anchors, free, np.zeros((0, cache.nv)))


def checked_matrices(
    model: pin.Model,
    data: pin.Data,
    q: Array,
    contacts: Sequence[Contact],
    anchors: tuple[ContactGeometry, ...],
    free: NDArray[np.bool_],
    stops: Array,
) -> ManyMatrices:
    """Return the matrices of n contacts and of joint stops, for checked arguments.

    Args:
        model: As in `contact_matrices`.
        data: Likewise.
        q: (nq,) configuration.
        contacts: The contacts.
        anchors: Geometry of each held contact.
        free: (nv,) False for locked velocities.
        stops: (m, nv) rows of joint stops, which are like contacts without tangential directions.
    """
    cache = data_cache(model, data)
    mass = cache.mass_matrix(model, data, q, _WORLD)
    k, n = len(contacts), len(contacts) + len(stops)
    jacobian, geometry = np.zeros((3 * n, cache.nv)), np.zeros((n, 12))
    for i, contact in enumerate(contacts):
        kinematic = kinematics(model, data, q, cache, contact)
        rows = jacobian[3 * i : 3 * i + 3]
        geometry[i] = contact_kinematics.jacobian(*kinematic, contact.constants, rows)
    jacobian[3 * k + 2 :: 3] = stops
    delassus, response, held_response, _, _ = _responses(model, cache, mass, jacobian, anchors, free)
    axes = geometry[:k, :9].reshape(k, 3, 3)
    return ManyMatrices(axes, jacobian, geometry[:, 9:], delassus, response, anchors, held_response)


def contact_points(model: pin.Model, data: pin.Data, q: Array, contacts: Sequence[Contact]) -> Array:
    """Return the points (n, 3) of contacts in world axes [m], at the configuration of the last matrices."""
    cache = data_cache(model, data)
    placed = ((kinematics(model, data, q, cache, contact), contact.constants) for contact in contacts)
    return np.array([contact_kinematics.locate(*k[:2], constants)[4:7] for k, constants in placed])


def _responses(
    model: pin.Model,
    cache: DataCache,
    mass: Array,
    jacobian: Array,
    anchors: Sequence[ContactGeometry],
    free: NDArray[np.bool_],
) -> tuple[Array, Array, Array, Array, Array]:
    """Return W, the response of q̇ to impulses, and that of held contacts, for rows (m, nv) of a Jacobian.

    Also returns L and Y (m, nv).
    """
    m, nv = jacobian.shape
    y, lower = jacobian.copy(), np.empty((nv, nv))
    held_response = np.zeros((0, 3, m))
    if anchors:
        y = np.vstack([jacobian, *(anchor.axes.T @ anchor.jacobian for anchor in anchors)])
    stopped = half_solve(mass, cache.parents, free, lower, y)
    if stopped >= 0:
        raise singular_mass(model, stopped)
    if anchors:
        y, impulses = _project_out(y[m:], y[:m])
        held_response = impulses.reshape(-1, 3, m)
    delassus, response = np.empty((m, m)), np.empty((m, nv))
    respond(lower, cache.parents, y, delassus, response)
    return delassus, response.T, held_response, lower, y


def kinematics(
    model: pin.Model, data: pin.Data, q: Array, cache: DataCache, contact: Contact
) -> tuple[Array, Array, Array, Array]:
    """Return the arguments of `contact_kinematics.jacobian` for the frames of contact and surface.

    ``data.J`` and ``data.oMi`` must be those of q.
    """
    body = contact.plane.body
    frame, carrier, signs = cache.contacts.get((contact.frame, body)) or cache.contact(contact.frame, body)
    placement = frame_placement(model, data, frame).homogeneous
    carried = WORLD if body is None else frame_placement(model, data, carrier).homogeneous
    columns = cache.columns
    if columns is None:
        columns = contact_columns(model, data, q, frame, carrier)
    return placement, carried, columns, signs


def _project_out(anchored: Array, y: Array) -> tuple[Array, Array]:
    """Project the rows of `anchored` out of the rows of `y` (both L⁻ᵀ of rows of Jacobians).

    Returns:
        The remaining y, exactly zero where it is within rounding of zero, and the (rows, 3) impulses of
        least norm that balance the rest.
    """
    tolerance = 32.0 * _EPS * max(anchored.shape)
    left, sizes, right = np.linalg.svd(anchored, full_matrices=False)
    above = sizes > tolerance * sizes[0]
    left, sizes, right = left[:, above], sizes[above], right[above]
    balanced = right @ y.T
    impulses = -left @ (balanced / sizes[:, None])
    rest = y - balanced.T @ right
    rest -= (rest @ right.T) @ right
    axes, lengths, directions = np.linalg.svd(rest, full_matrices=False)
    lengths = np.where(lengths > tolerance * np.linalg.norm(y), lengths, 0.0)
    return (axes * lengths) @ directions, impulses
