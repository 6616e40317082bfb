"""Contacts of a robot: where they are, their gap, and the matrices that an impact there needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..checks import at_least_zero, coefficient
from ..contact_space.problem import law_code
from ..errors import InputError, ModelError
from ._kernels import contact_kinematics, tree
from ._kernels.constants import AXES, KIND, POINT, RADIUS, TIP
from .names import Workspace, configuration, frame_id, free_velocities, model_of, workspace
from .surfaces import Surface, Vector, check_frame_key, vector

Array = NDArray[np.float64]
_EPS = float(np.finfo(float).eps)
_placement = pin.updateFramePlacement


@dataclass(frozen=True)
class Contact:
    """A point of a robot that may meet a surface, with its friction and restitution.

    The contact point is the frame's origin + `offset` (in the frame's axes) − `radius`·n, so a sphere of
    that radius about the offset touches the surface where the gap is zero.

    Attributes:
        frame: Frame that carries the point, by name or id.
        plane: The surface it meets, a `Plane` or another `Surface`.
        friction: Coulomb coefficient μ ≥ 0.
        restitution: Coefficient 0 ≤ e ≤ 1, or a function that returns it for an approach speed [m/s].
        law: ``"poisson"``, ``"energetic"`` or ``"newton"``.
        offset: From the frame's origin, in the frame's axes [m].
        radius: Of a spherical tip [m], 0 for a point.
        name: How reports call the contact; None for "frame on plane".

    Raises:
        InputError: A number out of its range or not finite.
        UnknownNameError: An unknown law.
    """

    frame: str | int
    plane: Surface
    friction: float = 0.0
    restitution: float | Callable[[float], float] = 0.0
    law: str = "poisson"
    offset: Vector = (0.0, 0.0, 0.0)
    radius: float = 0.0
    name: str | None = None
    constants: Array = field(init=False, repr=False, compare=False)
    law_code: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_frame_key("frame", self.frame)
        if not isinstance(self.plane, Surface):
            raise InputError(f"plane: {self.plane!r} is not a surface", field="plane", value=self.plane)
        keep = object.__setattr__
        keep(self, "friction", at_least_zero("friction", self.friction))
        if not callable(self.restitution):
            keep(self, "restitution", coefficient("restitution", self.restitution))
        keep(self, "law_code", law_code(self.law))
        keep(self, "offset", vector("offset", self.offset))
        keep(self, "radius", at_least_zero("radius", self.radius))
        constants = np.array([*self.offset, self.radius, *self.plane.constants])
        constants.setflags(write=False)
        keep(self, "constants", constants)

    @property
    def label(self) -> str:
        """The name, or what stands in for it."""
        if self.name is not None:
            return self.name
        return f"{self.frame} on {self.plane.kind if self.plane.body is None else self.plane.body}"

    def restitution_at(self, speed: float) -> float:
        """Return e for an approach speed [m/s].

        Raises:
            InputError: The contact's function returns no number between 0 and 1.
        """
        if callable(self.restitution):
            return coefficient(f"restitution({speed:.6g} m/s)", self.restitution(speed))
        return self.restitution

    def gap(self, model: pin.Model, data: pin.Data, q: ArrayLike) -> float:
        """Return the signed distance of the contact point from the surface [m], negative inside.

        Changes ``data.oMi``, ``data.liMi`` and the two frames' ``data.oMf``.

        Raises:
            InputError: A q of the wrong length or not finite.
            UnknownNameError: A frame that the model does not have.
        """
        model = model_of(model)
        space = workspace(model, data)
        pin.forwardKinematics(model, data, configuration(space, model, q))
        frame = _placement(model, data, space.frame(self.frame)).homogeneous
        carrier = None
        if self.plane.body is not None:
            carrier = _placement(model, data, space.frame(self.plane.body, "body")).homogeneous
        return float(contact_kinematics.locate(frame, carrier, self.constants)[0])


def contact_constants(model: pin.Model, contact: Contact) -> tuple[int, int, Array, Array]:
    """Return a contact's joints (of the tip, of the surface), its constants in their axes, and signs.

    The signs (nv,) are 1 for a velocity that moves the tip alone, −1 the surface alone, else 0.
    """
    frame = model.frames[frame_id(model, contact.frame)]
    tip, base, carrier = frame.parentJoint, 0, pin.SE3.Identity()
    if contact.plane.body is not None:
        body = model.frames[frame_id(model, contact.plane.body, "body")]
        base, carrier = body.parentJoint, body.placement
    k = contact.constants.copy()
    k[TIP:RADIUS] = frame.placement.act(k[TIP:RADIUS])
    k[POINT:AXES] = carrier.act(k[POINT:AXES])
    directions = k[AXES:KIND].reshape(-1, 3)
    directions[:] = directions @ carrier.rotation.T
    signs = np.zeros(model.nv)
    for joint, sign in ((tip, 1.0), (base, -1.0)):
        for support in list(model.supports[joint])[1:]:
            i = model.idx_vs[support]
            signs[i : i + model.nvs[support]] += sign
    return tip, base, k, signs


@dataclass(frozen=True, slots=True, eq=False)
class ContactGeometry:
    """Where a contact is and how its point moves.

    Attributes:
        point: (3,) contact point in world axes [m].
        gap: Signed distance of the point from the plane [m].
        axes: (3, 3) contact axes t₁, t₂, n as rows, in world axes.
        K: (nv, 2) tangential columns of Jᵀ.
        h: (nv,) normal column of Jᵀ.
        surface_velocity: (3,) what the surface does beyond its carrier, at the contact point, in contact
            axes [m/s].
    """

    point: Array
    gap: float
    axes: Array
    K: Array
    h: Array
    surface_velocity: Array

    @property
    def jacobian(self) -> Array:
        """(3, nv) J = [K h]ᵀ: velocity of the point relative to the plane's carrier, in contact axes."""
        return np.column_stack([self.K, self.h]).T

    def velocity(self, v: ArrayLike) -> Array:
        """Return the (3,) contact velocity J q̇ − v_surface in contact axes [m/s]."""
        return self.jacobian @ np.asarray(v, dtype=np.float64) - self.surface_velocity


@dataclass(frozen=True, slots=True, eq=False)
class ContactMatrices(ContactGeometry):
    """What the robot is, seen from one contact; M Δq̇ = [K h] P for an impulse P in contact axes.

    Attributes, beyond those of `ContactGeometry`:
        mass: (nv, nv) M, with rotor inertia.
        delassus: (3, 3) W, with what is held and locked taken into account [1/kg].
        response: (nv, 3) Δq̇ per unit impulse in contact axes: M⁻¹Jᵀ, with what is held and locked.
        held: Geometry of each held contact.
        held_response: (k, 3, 3) impulse on each held contact (world axes) per impulse in contact axes.
    """

    mass: Array
    delassus: Array
    response: Array
    held: tuple[ContactGeometry, ...]
    held_response: Array


def contact_geometry(model: pin.Model, data: pin.Data, q: ArrayLike, contact: Contact) -> ContactGeometry:
    """Return where a contact is and its Jacobian. Arguments, Data and errors as in `contact_matrices`."""
    model = model_of(model)
    space = workspace(model, data)
    q = configuration(space, model, q)
    check_contact("contact", contact)
    pin.computeJointJacobians(model, data, q)
    kinematic = kinematics(model, data, q, space, contact)
    rows = np.empty((3, space.nv))
    seen = np.array(contact_kinematics.jacobian(*kinematic, contact.constants, rows))
    gap, _, _, _, *point = contact_kinematics.locate(kinematic[0], kinematic[3], contact.constants)
    return ContactGeometry(np.array(point), gap, seen[:9].reshape(3, 3), rows[:2].T, rows[2], seen[9:])


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
        data: Its data. Changes ``data.M``, ``data.J``, ``data.oMi`` and what else ``pin.crba`` and
            ``pin.computeJointJacobians`` write; ``data.oMf`` is brought to q only for the frames in question.
        q: (nq,) configuration.
        contact: The contact that the impulse acts at.
        held: Contacts whose points cannot move relative to their planes: three bilateral rows each,
            projected out of M⁻¹. One holds a standing point foot; with ``Plane(body=…)`` it closes a loop;
            three that are not in line make a grasp. Rows that repeat others are allowed: of the impulses
            that do the same, the least (in norm) are given.
        locked: Joints, by name or id, whose velocity cannot change.

    Raises:
        InputError: A q of the wrong length, not finite, or not normalised.
        UnknownNameError: A frame or joint that the model does not have.
        ModelError: The mass matrix is not positive definite.
    """
    model = model_of(model)
    space = workspace(model, data)
    free = free_velocities(model, locked)
    held = check_held(held)
    seen = contact_geometry(model, data, q, contact)
    anchors = tuple(contact_geometry(model, data, q, anchor) for anchor in held)
    mass = np.array(pin.crba(model, data, np.asarray(q, dtype=np.float64)))
    loose = np.where(free[:, None] & free, mass, np.diag(np.where(free, 0.0, 1.0)))
    lower = np.zeros_like(mass)
    stopped = tree.factor(loose, space.parents, lower)
    if stopped >= 0:
        raise singular_mass(model, stopped)

    def half_solve(rows: Array) -> Array:
        """L⁻ᵀ of each row, where what is locked does not move."""
        y = np.where(free, rows, 0.0)
        tree.solve_transposed(lower, space.parents, y)
        return y

    y = half_solve(seen.jacobian)
    held_response = np.zeros((0, 3, 3))
    if anchors:
        world_rows = [anchor.axes.T @ anchor.jacobian for anchor in anchors]
        y, impulses = _project_out(half_solve(np.vstack(world_rows)), y)
        held_response = impulses.reshape(-1, 3, 3)
    delassus = y @ y.T
    response = y.copy()
    tree.solve(lower, space.parents, response)
    return ContactMatrices(
        point=seen.point,
        gap=seen.gap,
        axes=seen.axes,
        K=seen.K,
        h=seen.h,
        surface_velocity=seen.surface_velocity,
        mass=mass,
        delassus=0.5 * (delassus + delassus.T),
        response=response.T,
        held=anchors,
        held_response=held_response,
    )


def kinematics(
    model: pin.Model, data: pin.Data, q: Array, space: Workspace, contact: Contact
) -> tuple[Array, Array, NDArray[np.bool_], Array | None, Array | None, NDArray[np.bool_] | None]:
    """Return what `contact_kinematics.jacobian` takes of the contact's frame and of the plane's carrier.

    ``data.J`` and ``data.oMi`` have to be those of q already.
    """
    frame = space.frames.get(contact.frame)
    if frame is None:
        frame = space.frame(contact.frame)
    placement = _placement(model, data, frame).homogeneous
    columns = space.columns
    body = contact.plane.body
    if columns is None:
        columns = _columns_of(model, data, q, frame)
    if body is None:
        return placement, columns, space.support(frame), None, None, None
    carrier = space.frame(body, "body")
    carrier_columns = columns if space.columns is not None else _columns_of(model, data, q, carrier)
    carrier_placement = _placement(model, data, carrier).homogeneous
    return (
        placement,
        columns,
        space.support(frame),
        carrier_placement,
        carrier_columns,
        space.support(carrier),
    )


def _columns_of(model: pin.Model, data: pin.Data, q: Array, frame: int) -> Array:
    """Return (6, nv) a frame's Jacobian with respect to the world's origin, mimic joints summed."""
    rows = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    rows[:3] -= np.cross(rows[3:], data.oMf[frame].translation, axisa=0, axisc=0)
    return rows


def check_contact(field: str, value: Any) -> None:
    """Refuse what is no `Contact`."""
    if not isinstance(value, Contact):
        raise InputError(f"{field}: {value!r} is not a Contact", field=field, value=value)


def check_held(held: Contact | Sequence[Contact]) -> tuple[Contact, ...]:
    """Return the held contacts as a tuple; one alone need not be wrapped."""
    anchors = (held,) if isinstance(held, (Contact, str)) else tuple(held)
    for anchor in anchors:
        check_contact("held", anchor)
    return anchors


def singular_mass(model: pin.Model, velocity: int) -> ModelError:
    """Return the error for a mass matrix whose factorization stops at a velocity."""
    joint = next(
        name
        for name, start, count in zip(model.names, model.idx_vs, model.nvs, strict=True)
        if start <= velocity < start + count
    )
    return ModelError(
        f"model: the mass matrix is not positive definite: joint {joint!r} (velocity {velocity}) moves no "
        f"inertia; give its links inertia or model.armature[{velocity}] a rotor inertia, or lock the joint",
        field="model",
        value=joint,
    )


def _project_out(anchored: Array, y: Array) -> tuple[Array, Array]:
    """Take out of the rows of `y` what the rows of `anchored` (both L⁻ᵀ of rows of Jacobians) can balance.

    Returns:
        What is left of y, exactly zero where it is within rounding of zero, and the (rows, 3) impulses of
        least norm that balance the rest.
    """
    tolerance = 32.0 * _EPS * max(anchored.shape)
    left, sizes, right = np.linalg.svd(anchored, full_matrices=False)
    kept = sizes > tolerance * sizes[0]
    left, sizes, right = left[:, kept], sizes[kept], right[kept]
    balanced = right @ y.T
    impulses = -left @ (balanced / sizes[:, None])
    rest = y - balanced.T @ right
    rest -= (rest @ right.T) @ right
    axes, lengths, directions = np.linalg.svd(rest, full_matrices=False)
    lengths = np.where(lengths > tolerance * np.linalg.norm(y), lengths, 0.0)
    return (axes * lengths) @ directions, impulses
