"""Derivatives of the impact of a robot. (docs/derivatives.md, 5)"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..checks import above_zero, finite_array
from ..contact_space.derivatives import Boundary, differentiate, empty_slopes
from ..contact_space.inputs import FACTOR, NO_FACTOR
from ..contact_space.one_contact import solve_inputs
from ..contact_space.problem import delassus_upper
from ..errors import InputError, ModelError
from ..geometry._kernels.constants import PLANE, SPHERE
from ..status import Status
from ._kernels import configuration_slopes as kernel
from ._kernels.impact_slopes import impact_slopes
from ._kernels.responses import half_solve
from ._kernels.tree import solve
from .contact import Contact, check_contact, check_held
from .data_cache import DataCache, data_cache
from .forest import Forest, frame_placement
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


class _Joints(NamedTuple):
    """Of each velocity its joint, of each joint the one that it stands on, and `DataCache.parents`."""

    of_velocity: NDArray[np.int64]
    parent: NDArray[np.int64]
    parents: NDArray[np.int64]


_JOINTS: WeakKeyDictionary[DataCache, _Joints] = WeakKeyDictionary()
_WORLD = np.eye(3)
_TURNING_AXES = ("Composite", "Universal", "SphericalZYX", "Ellipsoid", "Mimic", "mimic")


def _joints(model: pin.Model, data: Any) -> _Joints:
    """Return the joints of a model that can be differentiated."""
    cache = data_cache(model, data)
    found = _JOINTS.get(cache)
    if found is not None:
        return found
    if isinstance(data, Forest):
        raise InputError("data: a Forest given; a pinocchio Data is expected", field="data", value=data)
    check_joints(model)
    of_velocity = np.repeat(np.arange(model.njoints), model.nvs)
    found = _JOINTS[cache] = _Joints(of_velocity, np.array(model.parents, dtype=np.int64), cache.parents)
    return found


def check_joints(model: pin.Model) -> None:
    """Refuse joints whose axes, in the joint's own, depend on q."""
    for name, joint in zip(model.names, model.joints, strict=True):
        kind = joint.shortname()
        if any(word in kind for word in _TURNING_AXES):
            raise ModelError(
                f"model: joint {name!r} is a {kind}, whose axes turn within the joint; derivatives are not "
                "available for it",
                field="model",
                value=name,
            )


class _Robot:
    """The motions and inertias of a robot at a configuration."""

    def __init__(self, joints: _Joints, model: pin.Model, data: pin.Data, q: Array) -> None:
        pin.crba(model, data, q, pin.Convention.WORLD)  # for oYcrb, which the other convention leaves out
        self.J = np.ascontiguousarray(data.J.reshape(6, -1))
        self.joint, self.parent, self.parents = joints
        self.inertia = np.array([inertia.toDynamicParameters() for inertia in data.oYcrb])
        self.scratch = np.empty((2 * len(self.parent), 6))

    def of_velocity(self, ends: NDArray[np.int64], at: Array, x: Array) -> Array:
        """Return ∂(J x)/∂q (3, nv); see `velocity_slopes`."""
        out = np.empty((3, len(x)))
        kernel.velocity_slopes(self.J, self.joint, self.parent, ends, at, x, False, self.scratch, out)
        return out

    def add_force(self, ends: NDArray[np.int64], at: Array, force: Array, out: Array) -> None:
        """Add ∂(JᵀP)/∂q to `out` (nv, nv)."""
        kernel.force_slopes(self.J, self.joint, self.parent, ends, at, force, out)


def _respond(
    mass: Array,
    parents: NDArray[np.int64],
    free: NDArray[np.bool_],
    rows: Array,
    forces: Array,
    slip: Array,
) -> Array:
    """Solve M x = f + rowsᵀλ, rows x = −slip, for columns (nv, n), with x = 0 where it is not free."""
    if not len(rows):
        lower, columns = np.empty_like(mass), np.ascontiguousarray(forces.T)
        half_solve(mass, parents, free.astype(np.float64), lower, columns)
        solve(lower, parents, columns)
        return columns.T
    found = np.zeros_like(forces)
    mass, forces, rows = mass[np.ix_(free, free)], forces[free], rows[:, free]
    n, m = len(mass), len(rows)
    matrix = np.block([[mass, rows.T], [rows, np.zeros((m, m))]])
    solution = np.linalg.lstsq(matrix, np.vstack([forces, -slip]), rcond=1e-12)[0]
    found[free] = solution[:n]
    return found


def _place(
    model: pin.Model, data: pin.Data, contact: Contact, geometry: ContactGeometry, turns: bool
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return the joints of tip and surface, where the contact is, and the surface's axes in the world."""
    frame, body, _ = data_cache(model, data).contact(contact.frame, contact.plane.body)
    plane, n = contact.plane, geometry.axes[2]
    centre = geometry.point + contact.radius * n
    base, rotation, origin = 0, _WORLD, np.array(plane.origin)
    moves = plane.velocity, plane.angular_velocity
    if plane.body is not None:
        carrier = frame_placement(model, data, body)
        base, rotation, origin = model.frames[body].parentJoint, carrier.rotation, carrier.act(origin)
        moves = rotation @ plane.velocity, rotation @ plane.angular_velocity
    rate = 0.0
    if plane.code == SPHERE:
        away = centre - origin
        rate = float(np.copysign(1.0 / np.linalg.norm(away), n @ away))
    at = np.concatenate(
        (geometry.axes.ravel(), centre, geometry.point, origin, *moves, (contact.radius, rate, turns))
    )
    tip = model.frames[frame].parentJoint
    return np.array([tip, base]), at, rotation


def check_differentiable(contact: Contact) -> None:
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
        check_differentiable(one)
    matrices = contact_matrices(model, data, q, contact, held, locked)
    joints = _joints(model, data)
    v = finite_array("v", v, (len(matrices.h),))
    check_at_rest(matrices.held, held, v)
    J = matrices.jacobian
    impulse, slopes, boundary = _in_contact_space(contact, matrices, v)
    free = free_velocities(model, locked)
    robot = _Robot(joints, model, data, np.asarray(q, dtype=np.float64))
    return _assembled(model, data, robot, contact, held, matrices, J, free, v, impulse, slopes, boundary)


def impact_rows(
    model: pin.Model,
    data: pin.Data,
    q: ArrayLike,
    v: ArrayLike,
    contact: Contact,
    dt: float,
    held: Sequence[Contact] = (),
    locked: Sequence[str | int] = (),
) -> tuple[Array, Array]:
    """Return what an impact would come to, as rows for a controller: (q̇⁺, P) = A v̇ + b.

    v̇ is the acceleration of this tick, so that the velocity before an impact at its end is v + v̇ dt, at the
    present configuration. (docs/derivatives.md, D28)

    Args:
        model: As in `impact_derivatives`, with its errors.
        data: Likewise.
        q: (nq,) configuration.
        v: (nv,) velocity.
        contact: The contact that may collide.
        dt: Length of the tick [s].
        held: Contacts that hold during the impact.
        locked: Joints whose velocity the impact does not change.

    Returns:
        A (nv + 3, nv) and b (nv + 3,) of the velocity after the impact and of the impulse on the robot in
        world axes [N s]; columns without derivative are NaN.
    """
    dt = above_zero("dt", dt)
    check_contact("contact", contact)
    held = check_held(held)
    matrices = contact_matrices(model, data, q, contact, held, locked)
    v = finite_array("v", v, (len(matrices.h),))
    check_at_rest(matrices.held, held, v)
    impulse, slopes, _ = _in_contact_space(contact, matrices, v)
    by_v = slopes[:, :3] @ matrices.jacobian
    to_robot = np.vstack([matrices.response, matrices.axes.T])
    rows, now = to_robot @ by_v, to_robot @ impulse
    rows[: len(v)] += np.eye(len(v))
    now[: len(v)] += v
    return dt * rows, now


def _in_contact_space(contact: Contact, matrices: ContactMatrices, v: Array) -> tuple[Array, Array, Boundary]:
    """Return P (3,) in contact axes and its slopes (3, 11), see `INPUTS` of the kernel, and their flags."""
    velocity, scale = matrices.velocity(v), matrices.velocity_scale(v)
    speed = max(-float(velocity[2]), 0.0)
    slope = _slope_of_restitution(contact, speed)
    mu, e, law = float(contact.friction), contact.restitution_at(speed), contact.law_code
    factor = NO_FACTOR
    if matrices.factor is not None and matrices.factor_scale:
        (c11, _, _), (c21, c22, _), (c31, c32, c33) = matrices.factor.tolist()
        factor = np.array([c11, c21, c22, c31, c32, c33, matrices.factor_scale])
    slopes, boundary = empty_slopes(1)
    numbers, codes = np.empty((1, 7)), np.empty((1, 3), dtype=np.int64)
    coefficients = np.array([[mu], [e], [scale]])
    differentiate(
        *(matrices.delassus[None], velocity[None], coefficients[0], coefficients[1], law, coefficients[2]),
        *(factor.reshape(-1, FACTOR), (numbers, codes, slopes, boundary)),
    )
    if codes[0, 0] > Status.LOCKED:
        v1, v2, v3 = velocity.tolist()
        solve_inputs((*delassus_upper(matrices.delassus), v1, v2, v3, mu, e, law, scale, factor))
    of_impulse = slopes[0, 3:]
    of_impulse[:, 2] -= slope * of_impulse[:, 10]
    return numbers[0, 3:6], of_impulse, Boundary(boundary[0])


_UPPER = np.triu_indices(3)


def _assembled(
    model: pin.Model,
    data: pin.Data,
    robot: _Robot,
    contact: Contact,
    held: tuple[Contact, ...],
    matrices: ContactMatrices,
    J: Array,
    free: NDArray[np.bool_],
    v: Array,
    impulse: Array,
    slopes: Array,
    boundary: Boundary,
) -> ImpactDerivatives:
    """Return the derivatives from those in contact space. (D17)–(D21)"""
    R, Y = matrices.axes, matrices.response
    nv = len(v)
    ends, at, surface_axes = _place(model, data, contact, matrices, True)
    y, push = np.ascontiguousarray(Y.T), impulse @ R
    change, forces, turned = np.empty((9, nv)), np.empty((nv, nv)), np.empty((3, nv))
    impact_slopes(
        *(robot.J, robot.joint, robot.parent, robot.inertia, ends, at, y, v, impulse, push, robot.scratch),
        *(np.empty((3, nv, nv)), np.empty((3, 3, nv)), change, forces, turned),
    )
    rows = np.zeros((0, nv))
    slip = rows
    if held:
        anchors = [_place(model, data, a, g, False) for a, g in zip(held, matrices.held, strict=True)]
        rows = np.vstack([g.axes.T @ g.jacobian for g in matrices.held])
        moved = np.array([[robot.of_velocity(e, a, x) for e, a, _ in anchors] for x in y])
        moved = moved.reshape(3, len(rows), nv)
        pushes = matrices.held_response  # [h, world axis, i]
        of_rows = pushes.reshape(-1, 3).T @ moved  # [j, i, k]
        change[3:] += (of_rows + of_rows.transpose(1, 0, 2))[_UPPER]
        slip = np.tensordot(impulse, moved, 1)
        for (e, a, _), on_held in zip(anchors, pushes @ impulse, strict=True):
            robot.add_force(e, a, on_held, forces)
    # P by the data, in contact axes: q, v, the surface, μ and e
    by_velocity = slopes[:, :3]
    arm = matrices.point - at[kernel.ORIGIN : kernel.ORIGIN + 3]
    spin = by_velocity @ (R @ pin.skew(arm) @ surface_axes)
    parts = slopes[:, :9] @ change, by_velocity @ J, -by_velocity @ (R @ surface_axes), spin, slopes[:, 9:]
    of_impulse = np.concatenate(parts, axis=1)
    of_v, of_world = Y @ of_impulse, R.T @ of_impulse
    of_v[:, :nv] += _respond(matrices.mass, robot.parents, free, rows, forces, slip)
    of_v[:, nv : 2 * nv] += np.eye(nv)
    of_world[:, :nv] += turned
    by_q, by_v, by_surface = slice(nv), slice(nv, 2 * nv), slice(2 * nv, 2 * nv + 6)
    return ImpactDerivatives(
        v=v + Y @ impulse,
        dv_dq=of_v[:, by_q],
        dv_dv=of_v[:, by_v],
        dv_dfriction=of_v[:, -2],
        dv_drestitution=of_v[:, -1],
        dv_dsurface=of_v[:, by_surface],
        dP_dq=of_world[:, by_q],
        dP_dv=of_world[:, by_v],
        dP_dfriction=of_world[:, -2],
        dP_drestitution=of_world[:, -1],
        dP_dsurface=of_world[:, by_surface],
        boundary=boundary,
    )
