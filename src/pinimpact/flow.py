"""The smooth flow of a scene between events: v̇ for the contacts that are closed, and what the guards look at."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ._kernels import sustained, touch
from ._kernels.sustained import FREE, HELD, SLIP, STICK
from .contacts import Contact
from .errors import SimulationError
from .lookup import frame_id
from .scene import Scene
from .surfaces import contact_axes

Array = NDArray[np.float64]

_WORLD = pin.Convention.WORLD
MODES = {FREE: "free", SLIP: "slip", STICK: "stick", HELD: "held"}
"""Names of the modes of a contact."""


class ContactPoint:
    """A contact bound to a data: where its numbers stand there, and the kernels applied to them."""

    def __init__(self, model: pin.Model, data: pin.Data, contact: Contact) -> None:
        self.contact = contact
        self.name = contact.label
        frame = model.frames[frame_id(model, contact.frame)]
        plane = contact.plane
        tip, base = frame.parentJoint, 0
        carrier = pin.SE3.Identity()
        if plane.body is not None:
            body = model.frames[frame_id(model, plane.body, "body")]
            base, carrier = body.parentJoint, body.placement
        R = carrier.rotation
        self.constants = np.concatenate(
            [
                frame.placement.act(np.array(contact.offset)),
                [contact.radius],
                carrier.act(np.array(plane.point)),
                (contact_axes(plane.normal) @ R.T).ravel(),
                R @ plane.velocity,
                R @ plane.angular_velocity,
            ]
        )
        self.weights = np.zeros(model.nv)
        for joint, weight in ((tip, 1.0), (base, -1.0)):
            for support in list(model.supports[joint])[1:]:
                i = model.idx_vs[support]
                self.weights[i : i + model.nvs[support]] += weight
        # views into the data, which pin.aba keeps up to date
        self._tip = (data.oMi[tip].rotation, data.oMi[tip].translation, data.ov[tip].vector)
        self._base = (data.oMi[base].rotation, data.oMi[base].translation, data.ov[base].vector)
        self._accelerations = (data.oa_gf[tip].vector, data.oa_gf[base].vector)
        self._jacobian = data.J
        self._data = data

    def gap_and_rate(self) -> tuple[float, float]:
        """Return the gap [m] and its rate [m/s] at the state last evaluated."""
        return touch.gap_and_rate(*self._tip, *self._base, self.constants)  # type: ignore[no-any-return]

    def curvature(self, peak: Array, h: float) -> float:
        """Return a bound of |d²gap/dt²| over a step; see the kernel."""
        R, t, _ = self._tip
        bound = touch.curvature(self._jacobian, np.abs(self.weights), R, t, self.constants, peak, h)
        if self.contact.plane.body is not None:
            S, s, _ = self._base  # the plane turns: its own levers reach as far as the contact point
            bound += touch.curvature(self._jacobian, np.abs(self.weights), S, s, self.constants, peak, h)
        return float(bound)

    def motion(self, rows: Array, velocity: Array, acceleration: Array, surface: Array) -> float:
        """Fill what a closed contact needs, see `touch.contact_motion`; return the gap [m]."""
        R, t, V = self._tip
        S, s, U = self._base
        A, B = self._accelerations
        return touch.contact_motion(  # type: ignore[no-any-return]
            R,
            t,
            V,
            A,
            S,
            s,
            U,
            B,
            self.constants,
            self._jacobian,
            self.weights,
            rows,
            velocity,
            acceleration,
            surface,
        )


class Active:
    """The numbers of some contacts and scalar rows at one state, in arrays of their own.

    Attributes:
        points: The contacts.
        scalars: (ns,) velocity index of each scalar row.
        rows: (nc, 3, nv); velocity, acceleration, surface: (nc, 3); gap: list of nc.
    """

    def __init__(self, points: list[ContactPoint], scalars: list[int], nv: int) -> None:
        count = len(points)
        self.points = points
        self.scalars = np.array(scalars, dtype=np.int64)
        self.rows = np.zeros((count, 3, nv))
        self.velocity = np.zeros((count, 3))
        self.acceleration = np.zeros((count, 3))
        self.surface = np.zeros((count, 3))
        self.gap = [0.0] * count
        self._views = [
            (point, self.rows[i], self.velocity[i], self.acceleration[i], self.surface[i])
            for i, point in enumerate(points)
        ]

    def measure(self) -> None:
        """Take the numbers from the data, at the state last evaluated without contact forces."""
        for i, (point, rows, velocity, acceleration, surface) in enumerate(self._views):
            self.gap[i] = point.motion(rows, velocity, acceleration, surface)

    def stacked(self) -> Array:
        """Return the (3 nc + ns, nv) rows of all."""
        nv = self.rows.shape[2]
        unit = np.zeros((len(self.scalars), nv))
        unit[np.arange(len(self.scalars)), self.scalars] = 1.0
        return np.vstack([self.rows.reshape(-1, nv), unit])


class Flow:
    """v̇ and the powers at a state, with the contacts that are closed in their present modes.

    Attributes:
        points: All contacts of the scene, held ones last.
        mode: Mode of each.
        active: The closed contacts, limits and stuck joints.
        force: (nc, 3) forces of the closed contacts in contact axes at the state last evaluated [N].
        scalar_force: (ns,) forces at limits and in stuck joints.
        not_unique: How many of these forces the motion does not determine.
        effective: Least effective inverse inertia of a slipping contact over that without friction.
        still: Speed [m/s] below which the direction of slip is the one remembered.
        allowance: Force [N] by which Coulomb's law may seem violated through rounding.
        margin: By how much the forces keep to Coulomb's law; negative, the modes do not hold.
        least_margin: The least since it was last set to infinity.
    """

    def __init__(self, scene: Scene, model: pin.Model, contacts: list[Contact], held: list[Contact]) -> None:
        without = scene.without
        self.model = model
        self.data = model.createData()
        self.nv = model.nv
        pin.aba(model, self.data, pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv), _WORLD)
        self.points = [ContactPoint(model, self.data, contact) for contact in (*contacts, *held)]
        self.control = None if "control" in without else scene.control
        damping = scene.joint_damping
        self.damping = damping if damping.any() and "joint damping" not in without else None
        dry = scene.joint_friction
        self.dry = dry if dry.any() and "joint friction" not in without else None
        self.dry_sign = np.zeros(model.nv)
        self.idle = np.zeros(model.nv)
        self.still = 0.0
        self.allowance = 0.0
        self.margin = self.least_margin = math.inf
        self.powers = self.control is not None or self.damping is not None or self.dry is not None
        self.set_modes([HELD if i >= len(contacts) else FREE for i in range(len(self.points))], {}, [], [])

    def set_modes(
        self,
        mode: list[int],
        reference: dict[int, Array],
        scalars: list[int],
        scalar_bounds: list[tuple[float, float]],
    ) -> None:
        """Close the contacts whose mode is not `FREE`, and the scalar rows given, within their bounds."""
        self.mode = mode
        self.closed = [i for i, m in enumerate(mode) if m != FREE]
        self.active = Active([self.points[i] for i in self.closed], scalars, self.nv)
        count = len(self.closed)
        self.modes = np.array([mode[i] for i in self.closed], dtype=np.int64)
        self.mu = np.array([self.points[i].contact.friction for i in self.closed])
        self.reference = np.array([reference.get(i, (1.0, 0.0)) for i in self.closed]).reshape(count, 2)
        self.lower = np.array([lower for lower, _ in scalar_bounds])
        self.upper = np.array([upper for _, upper in scalar_bounds])
        self.force = np.zeros((count, 3))
        self.scalar_force = np.zeros(len(scalars))
        self.not_unique = 0
        self.effective = 1.0
        self.constrained = bool(count or scalars)

    def forces_without_contact(self, t: float, q: Array, v: Array) -> Array:
        """Return the generalized forces of control, damping and sliding dry friction."""
        if not self.powers:
            return self.idle
        tau = self.idle
        if self.control is not None:
            tau = self.ask_control(t, q, v)
        if self.damping is not None:
            tau = tau - self.damping * v
        if self.dry is not None:
            tau = tau - self.dry * self.dry_sign
        return tau

    def ask_control(self, t: float, q: Array, v: Array) -> Array:
        """Return the control's forces, checked."""
        assert self.control is not None
        tau = np.asarray(self.control(t, q.copy(), v.copy()), dtype=float)
        if tau.shape != (self.nv,):
            raise SimulationError(
                f"control: an array of shape {tau.shape} came back at t = {t:.6g} s; ({self.nv},) expected",
                field="control",
                value=tau,
            )
        if not math.isfinite(tau.dot(tau)):
            raise SimulationError(
                f"control: {tau.tolist()} came back at t = {t:.6g} s, which holds numbers that are not finite",
                field="control",
                value=tau,
            )
        return tau

    def open(self, t: float, q: Array, v: Array) -> Array:
        """Evaluate without contact forces: return v̇ and leave the kinematics in the data."""
        return pin.aba(self.model, self.data, q, v, self.forces_without_contact(t, q, v), _WORLD)  # type: ignore[no-any-return]

    def __call__(self, t: float, q: Array, v: Array, out: Array) -> None:
        """Fill `out` with v̇ and the powers of control, joints, sliding friction and surfaces."""
        nv = self.nv
        tau = self.forces_without_contact(t, q, v) if self.powers else self.idle
        out[:nv] = pin.aba(self.model, self.data, q, v, tau, _WORLD)
        if self.constrained:
            active = self.active
            active.measure()
            self.not_unique, self.effective = sustained.constrain(
                pin.computeMinverse(self.model, self.data),
                out[:nv],
                active.rows,
                active.acceleration,
                active.velocity,
                self.modes,
                self.mu,
                self.reference,
                self.still,
                active.scalars,
                self.force,
                self.scalar_force,
            )
            self.margin = sustained.margin(
                self.modes, self.mu, self.force, self.lower, self.upper, self.scalar_force, self.allowance
            )
            if self.effective <= 1e-9:
                self.margin = -math.inf
            self.least_margin = min(self.least_margin, self.margin)
            out[nv + 2] = np.vdot(self.force, active.velocity)
            out[nv + 3] = np.vdot(self.force, active.surface)
        else:
            out[nv + 2] = out[nv + 3] = 0.0
        if self.powers:
            total = tau.dot(v)
            in_joints = 0.0
            if self.damping is not None:
                in_joints -= (self.damping * v).dot(v)
            if self.dry is not None:
                in_joints -= (self.dry * self.dry_sign).dot(v)
            out[nv] = total - in_joints
            out[nv + 1] = in_joints
