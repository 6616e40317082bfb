"""Derivatives of the impact of a robot. (docs/derivatives.md, 5)"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..checks import finite_array
from ..contact_space.derivatives import Boundary, Derivatives
from ..contact_space.problem import ImpactProblem
from ..contact_space.solve import solve_impact
from ..errors import InputError, ModelError
from ..geometry._kernels.constants import PLANE, SPHERE
from ._kernels import configuration_slopes as kernel
from .contact import Contact, check_contact, check_held
from .data_cache import data_cache
from .forest import Forest, frame_placement, joint_jacobian
from .held import check_at_rest
from .matrices import ContactGeometry, ContactMatrices, contact_matrices
from .names import free_velocities, model_of

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ImpactDerivatives:
    """How q̇⁺ and the impulse P of an impact change; by q in the tangent space, as Pinocchio integrates.

    Columns that have no derivative hold NaN, see `boundary`.

    Attributes:
        v: (nv,) q̇⁺.
        dv_dq, dv_dv: (nv, nv) ∂q̇⁺/∂q and ∂q̇⁺/∂q̇.
        dv_dfriction, dv_drestitution: (nv,) ∂q̇⁺/∂μ and ∂q̇⁺/∂e.
        dv_dsurface: (nv, 6) ∂q̇⁺ by the surface's velocity and angular velocity, in its own axes.
        dP_dq, dP_dv: (3, nv) ∂P/∂q and ∂P/∂q̇, of the impulse in world axes.
        dP_dfriction, dP_drestitution: (3,) ∂P/∂μ and ∂P/∂e.
        dP_dsurface: (3, 6) ∂P by the surface's velocity and angular velocity.
        boundary: Flags of `Boundary`.
    """

    v: Array
    dv_dq: Array
    dv_dv: Array
    dv_dfriction: Array
    dv_drestitution: Array
    dv_dsurface: Array
    dP_dq: Array
    dP_dv: Array
    dP_dfriction: Array
    dP_drestitution: Array
    dP_dsurface: Array
    boundary: Boundary

    def __repr__(self) -> str:
        return f"ImpactDerivatives(nv={len(self.v)}, boundary={self.boundary!r})"


class _Robot:
    """The motions and inertias of a robot at a configuration, for `configuration_slopes`."""

    def __init__(self, model: pin.Model, data: pin.Data, q: Array) -> None:
        self.J = np.ascontiguousarray(joint_jacobian(model, data, q))
        self.parent = np.array(model.parents, dtype=np.int64)
        self.joint = np.repeat(np.arange(model.njoints), model.nvs)
        inertias = [pin.Inertia.Zero() for _ in range(model.njoints)]
        for i in range(model.njoints - 1, 0, -1):
            inertias[i] += data.oMi[i].act(model.inertias[i])
            if self.parent[i] > 0:
                inertias[self.parent[i]] += inertias[i]
        self.inertia = np.array([inertia.toDynamicParameters() for inertia in inertias])
        self._scratch = np.empty((2 * model.njoints, 6))

    def of_mass(self, x: Array) -> Array:
        """Return ∂(M x)/∂q (nv, nv)."""
        out = np.empty((len(x), len(x)))
        kernel.mass_slopes(self.J, self.joint, self.parent, self.inertia, x, self._scratch, out)
        return out

    def of_velocity(self, ends: NDArray[np.int64], at: Array, x: Array, relative: bool = False) -> Array:
        """Return ∂(J x)/∂q (3, nv); see `velocity_slopes`."""
        out = np.empty((3, len(x)))
        kernel.velocity_slopes(self.J, self.joint, self.parent, ends, at, x, relative, self._scratch, out)
        return out

    def of_axes(self, ends: NDArray[np.int64], at: Array, vector: Array) -> Array:
        """Return how a vector (3,) that is fixed in the contact axes changes with q, (3, nv) in the world."""
        out = np.empty((3, len(self.joint)))
        kernel.turn_slopes(self.J, self.joint, self.parent, ends, at, vector, out)
        return out

    def add_force(self, ends: NDArray[np.int64], at: Array, force: Array, out: Array) -> None:
        """Add ∂(JᵀP)/∂q to `out` (nv, nv)."""
        kernel.force_slopes(self.J, self.joint, self.parent, ends, at, force, out)


def _check_joints(model: pin.Model, data: Any) -> None:
    """Refuse joints whose axes, in the joint's own, depend on q."""
    if isinstance(data, Forest):
        raise InputError("data: a Forest given; a pinocchio Data is expected", field="data", value=data)
    for name, joint in zip(model.names, model.joints, strict=True):
        kind = joint.shortname()
        if any(word in kind for word in _TURNING_AXES):
            raise ModelError(
                f"model: joint {name!r} is a {kind}, whose axes turn within the joint; derivatives are not "
                "available for it",
                field="model",
                value=name,
            )


_TURNING_AXES = ("Composite", "Universal", "SphericalZYX", "Ellipsoid", "Mimic", "mimic")


def _respond(mass: Array, rows: Array, free: NDArray[np.bool_], forces: Array, slip: Array) -> Array:
    """Solve M x = f + rowsᵀλ, rows x = −slip, for columns (nv, n), with x = 0 where it is not free."""
    found = np.zeros_like(forces)
    mass, forces = mass[np.ix_(free, free)], forces[free]
    if not len(rows):
        found[free] = np.linalg.solve(mass, forces)
        return found
    rows = rows[:, free]
    n, m = len(mass), len(rows)
    matrix = np.block([[mass, rows.T], [rows, np.zeros((m, m))]])
    solution = np.linalg.lstsq(matrix, np.vstack([forces, -slip]), rcond=1e-12)[0]
    found[free] = solution[:n]
    return found


def _place(
    model: pin.Model, data: pin.Data, contact: Contact, geometry: ContactGeometry, turns: bool
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return the joints of tip and surface, where the contact is, and the surface's axes in the world."""
    cache = data_cache(model, data)
    frame = cache.frame(contact.frame)
    tip, base, carrier = model.frames[frame].parentJoint, 0, pin.SE3.Identity()
    placement = frame_placement(model, data, frame)
    if contact.plane.body is not None:
        body = cache.frame(contact.plane.body, "body")
        base, carrier = model.frames[body].parentJoint, frame_placement(model, data, body)
    n = geometry.axes[2]
    centre, origin = placement.act(np.array(contact.offset)), carrier.act(np.array(contact.plane.origin))
    away = float(np.linalg.norm(centre - origin))
    rate = 1.0 / away if contact.plane.code == SPHERE else 0.0
    rotation = carrier.rotation
    at = np.concatenate(
        [
            *(geometry.axes.ravel(), centre, geometry.point, origin),
            *(rotation @ contact.plane.velocity, rotation @ contact.plane.angular_velocity),
            *([contact.radius, rate, float(turns)],),
        ]
    )
    if float(n @ (centre - origin)) < 0.0 and rate > 0.0:
        at[kernel.ROUND] = -rate
    return np.array([tip, base]), at, rotation


def _check(contact: Contact) -> None:
    """Refuse contacts whose kinematics are not differentiated."""
    what = ""
    if contact.rim > 0.0:
        what = "a rim"
    elif contact.plane.code not in (PLANE, SPHERE):
        what = f"a {contact.plane.kind}"
    if what:
        raise InputError(
            f"contact: {contact.label!r} has {what}, for which derivatives are not available; they are for "
            "points and spheres in contact with a Plane or a Sphere",
            field="contact",
            value=contact,
        )


def _slope_of_restitution(contact: Contact, speed: float) -> float:
    """Return de/d(approach speed), 0 for a number."""
    if not callable(contact.restitution):
        return 0.0
    slope = getattr(contact.restitution, "slope", None)
    if not callable(slope):
        raise InputError(
            "restitution: a function of the approach speed without derivative; give it an attribute `slope`, "
            "a function that returns de/dv for a speed",
            field="restitution",
            value=contact.restitution,
        )
    return float(slope(speed))


def impact_derivatives(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contact: Contact,
    held: Sequence[Contact] = (),
    locked: Sequence[str | int] = (),
) -> ImpactDerivatives:
    """Return the exact derivatives of the impact of a robot at one contact.

    Args:
        model: Pinocchio model, or a RobotWrapper.
        data: Its data; `contact_matrices` lists the fields that change.
        q: (nq,) configuration.
        v: (nv,) velocity before the impact.
        contact: The contact that collides: a point or a sphere on a Plane or Sphere. A `restitution` that is
            a function needs an attribute ``slope``, its derivative by the approach speed [s/m].
        held: Contacts that hold during the impact, points and spheres on Planes and Spheres too.
        locked: Joints, by name or id, whose velocity the impact does not change.

    Raises:
        InputError: As `impact`; a contact or a function e without derivatives; several contacts.
        UnknownNameError: A frame or joint that the model does not have.
        ModelError: The mass matrix is not positive definite; joints whose axes turn within the joint.
        UnstoppableApproachError: No normal impulse can stop the approach.
        LawError: The restitution law cannot be met.
    """
    model = model_of(model)
    check_contact("contact", contact)
    held = check_held(held)
    for one in (contact, *held):
        _check(one)
    matrices = contact_matrices(model, data, q, contact, held, locked)
    _check_joints(model, data)
    q, v = np.asarray(q, dtype=np.float64), finite_array("v", v, (len(matrices.h),))
    check_at_rest(matrices.held, held, v)
    velocity = matrices.velocity(v)
    speed = max(-float(velocity[2]), 0.0)
    problem = ImpactProblem(
        *(matrices.delassus, velocity, contact.friction, contact.restitution_at(speed), contact.law),
        velocity_scale=matrices.velocity_scale(v),
        factor=matrices.factor,
        factor_scale=matrices.factor_scale,
    )
    slope = _slope_of_restitution(contact, speed)
    solution = solve_impact(problem, derivatives=True)
    d = solution.derivatives
    assert d is not None
    robot = _Robot(model, data, q)
    by_velocity = d.dP_dv
    if slope:
        by_velocity = by_velocity - np.outer(d.dP_drestitution, [0.0, 0.0, slope])
    free = free_velocities(model, locked)
    return _assembled(model, data, robot, contact, held, matrices, free, v, solution.impulse, by_velocity, d)


def _assembled(
    model: pin.Model,
    data: pin.Data,
    robot: _Robot,
    contact: Contact,
    held: tuple[Contact, ...],
    matrices: ContactMatrices,
    free: NDArray[np.bool_],
    v: Array,
    impulse: Array,
    by_velocity: Array,
    d: Derivatives,
) -> ImpactDerivatives:
    """Return the derivatives from those in contact space. (D17)–(D21)"""
    R, J, Y = matrices.axes, matrices.jacobian, matrices.response
    ends, at, surface_axes = _place(model, data, contact, matrices, True)
    anchors = [_place(model, data, a, g, False) for a, g in zip(held, matrices.held, strict=True)]
    columns = [np.ascontiguousarray(y) for y in Y.T]
    G = np.array([robot.of_velocity(ends, at, y) for y in columns])  # [j, i, k]: G(y_j)_i by q_k
    D = np.array([robot.of_mass(y) for y in columns])
    change = G + G.transpose(1, 0, 2) - np.einsum("mi,jmk->jik", Y, D)
    forces = -np.tensordot(impulse, D, 1)
    robot.add_force(ends, at, R.T @ impulse, forces)
    rows = np.zeros((0, len(v)))
    slip = rows
    if anchors:
        rows = np.vstack([g.axes.T @ g.jacobian for g in matrices.held])
        moved = np.array([[robot.of_velocity(e, a, y) for e, a, _ in anchors] for y in columns])
        pushes = matrices.held_response  # [h, world axis, i]
        turned = np.einsum("hai,jhak->jik", pushes, moved)
        change += turned + turned.transpose(1, 0, 2)
        slip = np.tensordot(impulse, moved, 1).reshape(-1, len(v))
        for (e, a, _), push in zip(anchors, pushes @ impulse, strict=True):
            robot.add_force(e, a, push, forces)
    # P by the data, in contact axes
    dP_dq = by_velocity @ robot.of_velocity(ends, at, v, True) + np.einsum(
        "kij,ijm->km", d.dP_ddelassus, change
    )
    dP_dv = by_velocity @ J
    arm = matrices.point - at[kernel.ORIGIN : kernel.ORIGIN + 3]
    material = R @ np.hstack([surface_axes, -pin.skew(arm) @ surface_axes])
    dP_dsurface = -by_velocity @ material
    dv_dq = _respond(matrices.mass, rows, free, forces, slip) + Y @ dP_dq
    return ImpactDerivatives(
        v=v + Y @ impulse,
        dv_dq=dv_dq,
        dv_dv=np.eye(len(v)) + Y @ dP_dv,
        dv_dfriction=Y @ d.dP_dfriction,
        dv_drestitution=Y @ d.dP_drestitution,
        dv_dsurface=Y @ dP_dsurface,
        dP_dq=R.T @ dP_dq + robot.of_axes(ends, at, R.T @ impulse),
        dP_dv=R.T @ dP_dv,
        dP_dfriction=R.T @ d.dP_dfriction,
        dP_drestitution=R.T @ d.dP_drestitution,
        dP_dsurface=R.T @ dP_dsurface,
        boundary=d.boundary,
    )
